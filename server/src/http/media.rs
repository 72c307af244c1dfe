//! Media types by the ending of a file's name.

use axum::http::HeaderValue;

/// What `mime_guess` does not know, or calls otherwise than the registry does.
const OWN: [(&str, &str); 18] = [
    ("b3dm", "application/octet-stream"),
    ("bin", "application/octet-stream"),
    ("cmpt", "application/octet-stream"),
    ("czml", "application/json"),
    ("geojson", "application/geo+json"),
    ("glb", "model/gltf-binary"),
    ("gltf", "model/gltf+json"),
    ("i3dm", "application/octet-stream"),
    ("json", "application/json"),
    ("ktx2", "image/ktx2"),
    ("pnts", "application/octet-stream"),
    ("spz", "application/octet-stream"),
    ("subtree", "application/octet-stream"),
    ("terrain", "application/vnd.quantized-mesh"),
    ("vctr", "application/octet-stream"),
    ("webp", "image/webp"),
    ("gz", "application/gzip"),
    ("zst", "application/zstd"),
];

/// The media type of a file; `application/octet-stream` if its ending is not known.
pub(super) fn of(name: &str) -> HeaderValue {
    let ending = name.rsplit('/').next().and_then(|file| file.rsplit_once('.')).map_or("", |(_, ending)| ending);
    match OWN.iter().find(|(known, _)| known.eq_ignore_ascii_case(ending)) {
        Some(&(_, media)) => HeaderValue::from_static(media),
        None => mime_guess::from_ext(ending)
            .first_raw()
            .map_or(HeaderValue::from_static("application/octet-stream"), HeaderValue::from_static),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_tilesets_hold() {
        for (name, media) in [
            ("tileset.json", "application/json"),
            ("a/b.GLB", "model/gltf-binary"),
            ("0/0/0.subtree", "application/octet-stream"),
            ("t.png", "image/png"),
            ("t.jpg", "image/jpeg"),
            ("t.ktx2", "image/ktx2"),
            ("LICENSE", "application/octet-stream"),
            ("a.b/c", "application/octet-stream"),
        ] {
            assert_eq!(of(name), media, "{name}");
        }
    }
}
