//! Health, metrics, documentation, and the page.

use crate::client::Server;

#[test]
fn what_operators_and_readers_find() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::with_files(folder.path());
    let text = |target: &str| {
        let answer = server.get(target, &[]);
        assert_eq!(answer.status, 200, "{target}");
        (answer.field("content-type").to_owned(), String::from_utf8(answer.body).unwrap())
    };
    assert_eq!(text("/health/live").1, "live\n");
    assert_eq!(text("/health/ready").1, "ready\n");
    let (media, document) = text("/openapi.json");
    assert_eq!(media, "application/json");
    for path in
        ["/worlds", "/worlds/{name}", "/worlds/{name}/{identity}/{path}", "/worlds/{name}/files/{path}", "/metrics"]
    {
        assert!(document.contains(&format!("\"{path}\":")), "{path}");
    }
    let (_, docs) = text("/docs/");
    assert!(docs.contains("swagger-ui") && !docs.contains("https://"), "{docs}");
    assert!(text("/docs/swagger-ui-bundle.js").1.len() > 100_000);
    let (media, page) = text("/");
    assert!(
        media.starts_with("text/html") && page.contains("/worlds/w") && page.contains("files/tileset.json"),
        "{page}"
    );
    let (_, facts) = text("/worlds/w");
    assert!(facts.contains("\"content\":\"files\"") && facts.contains("\"representations\":3"), "{facts}");
    assert_eq!(server.get("/worlds/x", &[]).status, 404);
}

#[test]
fn metrics_count_what_happened() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::with_files(folder.path());
    let target = "/worlds/w/files/a.glb";
    let etag = server.get(target, &[]).field("etag").to_owned();
    server.get(target, &[("if-none-match", &etag)]);
    server.get(target, &[("if-none-match", "\"other\"")]);
    server.get(target, &[("range", "bytes=0-99")]);
    server.get("/worlds/w/files/none.glb", &[]);
    for (name, count) in [
        ("foresight_content_responses_total{status=\"200\"}", 2.0),
        ("foresight_content_responses_total{status=\"206\"}", 1.0),
        ("foresight_content_responses_total{status=\"304\"}", 1.0),
        ("foresight_content_responses_total{status=\"404\"}", 1.0),
        ("foresight_revalidations_hit_total", 1.0),
        ("foresight_revalidations_missed_total", 1.0),
        ("foresight_store_misses_total", 1.0),
        ("foresight_store_hits_total", 3.0),
        ("foresight_content_sent_bytes_total", 10_100.0),
        ("foresight_content_completed_total", 3.0),
        ("foresight_content_active", 0.0),
    ] {
        assert_eq!(server.metric(name), count, "{name}");
    }
}
