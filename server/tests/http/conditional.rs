//! Conditions, ranges, codings, and what the responses say.

use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};

use crate::client::{BIG, Server, padded_glb};

#[test]
fn content_says_what_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::with_files(folder.path());
    let base = server.base();
    let immutable = server.get(&format!("{base}a.glb"), &[]);
    assert_eq!((immutable.status, immutable.body == padded_glb(5000)), (200, true));
    assert_eq!(immutable.field("cache-control"), "public, max-age=31536000, immutable");
    assert_eq!(immutable.field("content-type"), "model/gltf-binary");
    assert_eq!((immutable.field("accept-ranges"), immutable.field("vary")), ("bytes", "accept-encoding"));
    assert!(immutable.field("server-timing").starts_with("content;desc="), "{immutable:?}");
    assert!(immutable.field("etag").starts_with('"') && immutable.field("last-modified").ends_with(" GMT"));
    let revalidated = server.get("/worlds/w/files/a.glb", &[]);
    assert_eq!((revalidated.status, revalidated.field("cache-control")), (200, "no-cache"));
    assert_eq!(revalidated.field("etag"), immutable.field("etag"));
    let head = server.ask("HEAD", &format!("{base}a.glb"), &[]);
    assert_eq!((head.status, head.field("content-length"), head.body.len()), (200, "5000", 0));
    assert_eq!(head.field("etag"), immutable.field("etag"));
    // Escapes, a folder, and a link that stays inside.
    assert_eq!(server.get(&format!("{base}a%20b.glb"), &[]).body, padded_glb(0));
    assert_eq!(server.get(&format!("{base}sub/data.bin"), &[]).body, b"data");
    assert_eq!(server.get(&format!("{base}inside.glb"), &[]).body, padded_glb(5000));
    // Another world's identity, or another version of this world's.
    let other = base.replace(|c: char| c.is_ascii_digit(), "0");
    assert_eq!(server.get(&format!("{other}a.glb"), &[]).status, 404);
    for method in ["POST", "DELETE", "PUT", "BREW"] {
        let refused = server.ask(method, &format!("{base}a.glb"), &[]);
        assert_eq!((refused.status, refused.field("allow")), (405, "GET,HEAD"), "{method}");
        assert_eq!(refused.field("content-type"), "application/problem+json");
    }
}

#[test]
fn conditions_in_their_order() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::with_files(folder.path());
    let target = "/worlds/w/files/a.glb";
    let first = server.get(target, &[]);
    let (etag, modified) = (first.field("etag").to_owned(), first.field("last-modified").to_owned());
    let (etag, modified) = (etag.as_str(), modified.as_str());
    let weak = format!("\"other\", W/{etag}");
    let (long_ago, weak) = ("Mon, 01 Jan 1990 00:00:00 GMT", weak.as_str());
    for (fields, status) in [
        (vec![("if-none-match", etag)], 304),
        (vec![("if-none-match", weak)], 304),
        (vec![("if-none-match", "*")], 304),
        (vec![("if-none-match", "\"other\"")], 200),
        (vec![("if-modified-since", modified)], 304),
        (vec![("if-modified-since", long_ago)], 200),
        (vec![("if-modified-since", "yesterday")], 200),
        (vec![("if-none-match", "\"other\""), ("if-modified-since", modified)], 200),
        (vec![("if-match", etag)], 200),
        (vec![("if-match", "\"other\"")], 412),
        (vec![("if-match", weak)], 412),
        (vec![("if-match", "*")], 200),
        (vec![("if-unmodified-since", modified)], 200),
        (vec![("if-unmodified-since", long_ago)], 412),
        (vec![("if-match", etag), ("if-none-match", etag)], 304),
        (vec![("range", "bytes=0-9")], 206),
        (vec![("range", "bytes=0-9"), ("if-none-match", etag)], 304),
        (vec![("range", "bytes=0-9"), ("if-range", etag)], 206),
        (vec![("range", "bytes=0-9"), ("if-range", modified)], 206),
        (vec![("range", "bytes=0-9"), ("if-range", weak)], 200),
        (vec![("range", "bytes=0-9"), ("if-range", "\"other\"")], 200),
        (vec![("range", "bytes=0-9"), ("if-range", long_ago)], 200),
        (vec![("range", "bytes=5000-")], 416),
        (vec![("range", "bytes=0-1,5-9")], 200),
    ] {
        let answer = server.get(target, &fields);
        assert_eq!(answer.status, status, "{fields:?}");
        match status {
            304 => assert!(answer.body.is_empty() && answer.field("etag") == etag, "{answer:?}"),
            416 => assert_eq!(answer.field("content-range"), "bytes */5000"),
            206 => assert_eq!((answer.field("content-range"), answer.body.len()), ("bytes 0-9/5000", 10)),
            200 => assert_eq!(answer.body.len(), 5000),
            _ => assert_eq!(answer.field("content-type"), "application/problem+json"),
        }
    }
    // A changed file is another content, under the address that is asked for again.
    let changed = vec![b'x'; 5000];
    std::fs::write(folder.path().join("a.glb"), &changed).unwrap();
    let answer = server.get(target, &[("if-none-match", etag)]);
    assert_eq!((answer.status, answer.body == changed), (200, true));
}

#[test]
fn ranges_are_slices() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::with_files(folder.path());
    let big = padded_glb(BIG);
    let filler = Server::start("city:blocks=2", &[]);
    let base = filler.base();
    let whole = filler.get(&format!("{base}{}", "city.glb"), &[]);
    assert_eq!(whole.status, 404);
    let mut runner = TestRunner::new(Config { cases: 64, failure_persistence: None, ..Config::default() });
    let positions = (0..BIG as u64 + 5000, 0..BIG as u64 + 5000, 0..3u8);
    runner
        .run(&positions, |(a, b, form)| {
            let (first, last) = (a.min(b), a.max(b));
            let header = match form {
                0 => format!("bytes={first}-{last}"),
                1 => format!("bytes={first}-"),
                _ => format!("bytes=-{first}"),
            };
            let length = big.len() as u64;
            let expected = match form {
                0 => first..(last + 1).min(length),
                1 => first..length,
                _ => length.saturating_sub(first)..length,
            };
            let answer = server.get("/worlds/w/files/big.glb", &[("range", &header)]);
            if expected.start >= expected.end {
                prop_assert_eq!(answer.status, 416);
            } else {
                prop_assert_eq!(answer.status, 206);
                prop_assert!(answer.body == big[expected.start as usize..expected.end as usize], "{}", header);
            }
            Ok(())
        })
        .unwrap();
}

#[test]
fn codings_lie_beside_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::with_files(folder.path());
    let get = |accepted: &str| server.get("/worlds/w/files/a.glb", &[("accept-encoding", accepted)]);
    let (plain, brotli, gzip) = (get("identity"), get("gzip, br"), get("gzip;q=1, br;q=0.5"));
    assert_eq!((plain.field("content-encoding"), plain.body.len()), ("", 5000));
    assert_eq!((brotli.field("content-encoding"), brotli.body.as_slice()), ("br", b"brotli".as_slice()));
    assert_eq!((gzip.field("content-encoding"), gzip.body.as_slice()), ("gzip", b"\x1f\x8bgzip".as_slice()));
    let etags = [&plain, &brotli, &gzip].map(|answer| answer.field("etag"));
    assert!(etags[0] != etags[1] && etags[1] != etags[2]);
    for answer in [&plain, &brotli, &gzip] {
        assert_eq!((answer.field("vary"), answer.field("content-type")), ("accept-encoding", "model/gltf-binary"));
    }
    // Not there in zstd; the compressed file under its own name is a file; one stored compressed says so.
    assert_eq!(get("zstd").field("content-encoding"), "");
    let itself = server.get("/worlds/w/files/a.glb.gz", &[]);
    assert_eq!((itself.field("content-encoding"), itself.field("content-type")), ("", "application/gzip"));
    let inner = server.get("/worlds/w/files/inflated.json", &[]);
    assert_eq!((inner.field("content-encoding"), inner.field("content-type")), ("gzip", "application/json"));
}

#[test]
fn worlds_without_content_have_filler() {
    let server = Server::start("city:blocks=2", &[]);
    let facts = String::from_utf8(server.get("/worlds", &[]).body).unwrap();
    assert!(facts.contains("\"content\":\"generated filler\"") && facts.contains("\"entry\":null"), "{facts}");
    let world = foresight_server::http::worlds::HostedWorld::open("city:blocks=2").unwrap();
    let base = server.base();
    assert_eq!(base, format!("/worlds/w/{}/", world.identity()));
    let tree = &world.world.tree;
    for rep in [0, tree.representations() as u32 - 1].map(foresight_scheduler::lod_tree::RepId) {
        let target = format!("{base}{}", world.uri(rep));
        let whole = server.get(&target, &[]);
        assert_eq!((whole.status, whole.body.len() as u64), (200, tree.wire_bytes(rep)));
        assert_eq!(whole, whole.clone());
        let part = server.get(&target, &[("range", "bytes=101-333")]);
        assert_eq!((part.status, part.body.as_slice()), (206, &whole.body[101..=333]));
        assert_eq!(server.get(&target, &[("if-none-match", whole.field("etag"))]).status, 304);
    }
    assert_eq!(server.get(&format!("{base}no/such.glb"), &[]).status, 404);
}

#[test]
fn pages_of_other_origins_may_read() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::with_files(folder.path());
    let origin = ("origin", "https://viewer.example");
    let answer = server.get("/worlds/w/files/a.glb", &[origin]);
    assert_eq!(answer.field("access-control-allow-origin"), "*");
    for name in ["etag", "content-range", "server-timing"] {
        assert!(answer.field("access-control-expose-headers").contains(name), "{answer:?}");
    }
    let asked = ("access-control-request-headers", "foresight-session, range, if-none-match");
    let leave =
        server.ask("OPTIONS", "/worlds/w/files/a.glb", &[origin, ("access-control-request-method", "GET"), asked]);
    assert_eq!(leave.status, 200);
    for name in ["foresight-session", "range", "if-none-match", "authorization"] {
        assert!(leave.field("access-control-allow-headers").contains(name), "{leave:?}");
    }
}

#[test]
fn priorities_are_read_and_told() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::with_files(folder.path());
    for (given, told) in [("u=0, i", "u=0, i"), ("i;x=2,u=6", "u=6, i"), ("u=9", "u=3"), ("(", "u=3")] {
        assert_eq!(server.get("/worlds/w/files/big.glb", &[("priority", given)]).field("priority"), told, "{given}");
    }
    assert_eq!(server.get("/worlds/w/files/a.glb", &[]).field("priority"), "");
}

#[test]
fn many_requests_on_one_connection_of_http_2() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::with_files(folder.path());
    let url = server.url("/worlds/w/files/");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let client = reqwest::Client::builder().http2_prior_knowledge().build().unwrap();
        let requests = (0..200).map(|i| {
            let (name, bytes) = if i % 10 == 0 { ("big.glb", BIG) } else { ("a.glb", 5000) };
            let request = client.get(format!("{url}{name}"));
            async move {
                let response = request.send().await.unwrap();
                assert_eq!((response.status().as_u16(), response.version()), (200, reqwest::Version::HTTP_2));
                assert!(response.bytes().await.unwrap() == padded_glb(bytes));
            }
        });
        futures_util::future::join_all(requests).await;
    });
    assert!(server.metric("foresight_http_connections_active") <= 2.0);
}
