//! Paths that try to leave the world's folder, and requests that are none.

use std::io::{Read, Write};
use std::net::Shutdown;
use std::sync::atomic::{AtomicUsize, Ordering};

use foresight_traces::random::SplitMix64;

use crate::client::{Answer, Server};

/// What comes after `/worlds/w/files/`.
const PATHS: [&str; 74] = [
    "..",
    "../",
    "../outside",
    "../../etc/passwd",
    "../../../../../../../../etc/passwd",
    "sub/../../x",
    "sub/../a.glb",
    "./a.glb",
    "sub/./data.bin",
    ".",
    "/etc/passwd",
    "//etc/passwd",
    "///etc/passwd",
    "sub//data.bin",
    "sub/",
    "sub",
    "a.glb/",
    "a.glb/x",
    "%2e%2e/outside",
    "%2e%2e%2foutside",
    "%2E%2E%2Foutside",
    "..%2foutside",
    "..%2Foutside",
    "..%5coutside",
    "%2e%2e%5coutside",
    "..\\outside",
    "sub\\data.bin",
    "sub%5cdata.bin",
    "sub%2fdata.bin",
    "%2fetc%2fpasswd",
    "%2Fetc/passwd",
    "%252e%252e%252foutside",
    "%252e%252e/outside",
    "..%252foutside",
    "%25252e%25252e/outside",
    "..%c0%afoutside",
    "%c0%ae%c0%ae/outside",
    "%e0%80%ae%e0%80%ae/outside",
    "..%ef%bc%8foutside",
    "%uff0e%uff0e/outside",
    "..;/outside",
    "..%3b/outside",
    "..%00/outside",
    "a.glb%00",
    "a.glb%00.json",
    "%00",
    "a%0a.glb",
    "a%0d%0ax-injected:%201",
    "a%7f.glb",
    ".hidden",
    "%2ehidden",
    "sub/.hidden",
    ".git/config",
    "passwd",
    "up/outside",
    "up",
    "sub/top/etc/passwd",
    "outside.txt",
    "a.glb:$DATA",
    "a.glb::$INDEX_ALLOCATION",
    "c:/windows/win.ini",
    "C%3a%5cwindows%5cwin.ini",
    "file:///etc/passwd",
    "file:%2f%2f%2fetc%2fpasswd",
    "http://127.0.0.1/",
    "~root/x",
    "~/x",
    "...",
    ".../x",
    "....//....//etc/passwd",
    "..%",
    "%",
    "%zz",
    "A.GLB",
];

/// The answer to these bytes.
fn raw(server: &Server, request: &[u8]) -> Vec<u8> {
    let mut stream = server.connect();
    // The server may answer and close before all is written.
    let _ = stream.write_all(request);
    let mut bytes = Vec::new();
    let _ = stream.read_to_end(&mut bytes);
    bytes
}

#[test]
fn no_path_leaves_the_folder() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("world");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(parent.path().join("outside"), "secret").unwrap();
    let server = Server::with_files(&folder);
    let base = server.base();
    for path in PATHS {
        for prefix in ["/worlds/w/files/", base.as_str()] {
            let request = format!("GET {prefix}{path} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n");
            let bytes = raw(&server, request.as_bytes());
            let answer = Answer::parse(&bytes);
            assert!([400, 404].contains(&answer.status), "{path}: {answer:?}");
            let text = String::from_utf8_lossy(&bytes);
            assert!(
                !text.contains("secret") && !text.contains("root:") && !text.contains("x-injected"),
                "{path}: {text}"
            );
        }
    }
    // In the world's place.
    for target in
        ["/worlds/../files/a.glb", "/worlds/%2e%2e/files/a.glb", "/worlds/w%2ffiles/a.glb", "/worlds//files/a.glb"]
    {
        assert_eq!(server.get(target, &[]).status, 404, "{target}");
    }
    let long = format!("/worlds/w/files/{}", "a/".repeat(2000));
    assert_eq!(server.get(&long, &[]).status, 404);
    assert_eq!(server.get("/health/live", &[]).status, 200);
}

#[test]
fn what_is_no_request_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::with_files(folder.path());
    let many: String = (0..200).map(|i| format!("x-{i}: 1\r\n")).collect();
    for (name, request, status) in [
        ("long target", format!("GET /{} HTTP/1.1\r\nhost: a\r\nconnection: close\r\n\r\n", "a".repeat(10_000)), "414"),
        ("long field", format!("GET / HTTP/1.1\r\nhost: a\r\nx: {}\r\n\r\n", "a".repeat(200_000)), "431"),
        ("many fields", format!("GET / HTTP/1.1\r\nhost: a\r\n{many}\r\n"), "431"),
        ("no version", "GET /\r\n\r\n".to_owned(), "400"),
        ("no HTTP", "\u{0}\u{1}\u{2}\r\n\r\n".to_owned(), "400"),
        (
            "two lengths",
            "POST / HTTP/1.1\r\nhost: a\r\ncontent-length: 1\r\ncontent-length: 2\r\n\r\nab".to_owned(),
            "400",
        ),
        ("folded field", "GET / HTTP/1.1\r\nhost: a\r\nx: 1\r\n y\r\n\r\n".to_owned(), "400"),
        ("negative length", "POST / HTTP/1.1\r\nhost: a\r\ncontent-length: -1\r\n\r\n".to_owned(), "400"),
    ] {
        let bytes = raw(&server, request.as_bytes());
        let line = String::from_utf8_lossy(&bytes[..bytes.len().min(60)]).into_owned();
        assert_eq!(line.split(' ').nth(1), Some(status), "{name}: {line}");
    }
    // Ends of requests that never come, and connections that say nothing.
    for request in
        [&b""[..], b"G", b"GET / HTTP/1.1\r\n", b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\xff\xff\xff\xff\xff\xff\xff\xff\xff"]
    {
        let mut stream = server.connect();
        stream.write_all(request).unwrap();
        drop(stream);
    }
    assert_eq!(server.get("/health/live", &[]).status, 200);
}

/// What the malformed requests are made from.
const SEEDS: [&[u8]; 8] = [
    b"GET /worlds HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n",
    b"GET /worlds/w/files/a.glb HTTP/1.1\r\nhost: localhost\r\nrange: bytes=0-9, 5-, -7\r\nif-range: \"a\"\r\nconnection: close\r\n\r\n",
    b"HEAD /worlds/w/files/big.glb?session=%41 HTTP/1.1\r\nhost: a\r\nif-none-match: \"1-2\", W/\"3\", *\r\npriority: u=1, i\r\n\r\n",
    b"GET /worlds/w/0123456789abcdef/sub/data.bin HTTP/1.1\r\nhost: a\r\naccept-encoding: gzip;q=0.5, br;q=1, *;q=0\r\n\r\n",
    b"POST /sessions HTTP/1.1\r\nhost: a\r\ncontent-type: application/json\r\ncontent-length: 12\r\n\r\n{\"type\":\"h\"}",
    b"POST /sessions/x/frames HTTP/1.1\r\nhost: a\r\ntransfer-encoding: chunked\r\n\r\n5\r\n[1,2]\r\n0\r\n\r\n",
    b"OPTIONS /worlds HTTP/1.1\r\nhost: a\r\norigin: http://b\r\naccess-control-request-method: GET\r\n\r\n",
    b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\x06\x04\0\0\0\0\0\0\x03\0\0\0\x64\0\0\x05\x01\x05\0\0\0\x01\x82\x86\x84\x41\0",
];

/// Bytes that mean something in a request.
const AWKWARD: &[u8] = b"\r\n\0 :/%;,=\"-\xff";

/// A request with some bytes changed, repeated, left out or put in.
fn malformed(random: &mut SplitMix64) -> Vec<u8> {
    let below = |random: &mut SplitMix64, n: usize| (random.bits() % n.max(1) as u64) as usize;
    let mut bytes = SEEDS[below(random, SEEDS.len())].to_vec();
    for _ in 0..=below(random, 6) {
        let at = below(random, bytes.len());
        match below(random, 6) {
            0 => bytes[at] = random.bits() as u8,
            1 => bytes.insert(at, AWKWARD[below(random, AWKWARD.len())]),
            2 => drop(bytes.remove(at)),
            3 => bytes.truncate(at.max(1)),
            4 => {
                let part = bytes[at..(at + below(random, 40)).min(bytes.len())].to_vec();
                let times = 1 + below(random, 20);
                bytes.splice(at..at, part.repeat(times));
            }
            _ => bytes.splice(at..at, SEEDS[below(random, SEEDS.len())].iter().copied()).for_each(drop),
        }
        bytes.truncate(60_000);
        if bytes.is_empty() {
            bytes.push(b'G');
        }
    }
    bytes
}

/// 10⁵ of them in the long tests.
#[test]
fn malformed_requests_are_answered_or_closed() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::with_files(folder.path());
    let full = std::env::var_os("FORESIGHT_FULL").is_some_and(|value| value == "1");
    let each = if full { 25_000 } else { 500 };
    let answered = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        for seed in 0..4 {
            let (server, answered) = (&server, &answered);
            scope.spawn(move || {
                let mut random = SplitMix64::new(seed);
                for _ in 0..each {
                    let request = malformed(&mut random);
                    let mut stream = server.connect();
                    // The server may have closed by then.
                    let _ = stream.write_all(&request).and_then(|()| stream.shutdown(Shutdown::Write));
                    let mut bytes = Vec::new();
                    match stream.read_to_end(&mut bytes) {
                        Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {
                            panic!("neither answered nor closed: {:?}", String::from_utf8_lossy(&request))
                        }
                        _ => {}
                    }
                    if bytes.starts_with(b"HTTP/1.1 ") {
                        answered.fetch_add(1, Ordering::Relaxed);
                        assert_ne!(bytes.get(9), Some(&b'5'), "{:?}", String::from_utf8_lossy(&bytes));
                    }
                }
            });
        }
    });
    assert!(answered.load(Ordering::Relaxed) > each, "{answered:?}");
    assert_eq!(server.get("/health/live", &[]).status, 200);
    assert!(!server.log().contains("panicked"), "{}", server.log());
}
