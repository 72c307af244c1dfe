use glam::{DVec2, DVec3};

use super::*;
use crate::surface::Surfaces;

fn opened(bytes: &[u8]) -> Result<Vec<Surfaces>, String> {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("a.ply");
    std::fs::write(&file, bytes).expect("written");
    let source = PlyFile::open(&file, Up::Z).map_err(|error| error.to_string())?;
    (0..source.pieces()).map(|piece| source.load(piece).map_err(|error| error.to_string())).collect()
}

/// A square with colours and coordinates, one face of four corners with a colour of its own if `of_face`.
fn square(format: &str, of_face: bool) -> Vec<u8> {
    let colour = if of_face { "property uchar red\nproperty uchar green\nproperty uchar blue\n" } else { "" };
    let mut out = format!(
        "ply\r\nformat {format} 1.0\ncomment TextureFile absent.png\nobj_info x\nelement vertex 4\nproperty double x\nproperty float y\n\
         property short z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nproperty float s\nproperty float t\n\
         element face 1\nproperty list uchar int vertex_indices\n{colour}element edge 1\nproperty int vertex1\nend_header\n"
    )
    .into_bytes();
    let is_big = format == "binary_big_endian";
    let mut put = |mut bytes: Vec<u8>, text: String| {
        if format == "ascii" {
            out.extend(text.into_bytes());
        } else {
            if is_big {
                bytes.reverse();
            }
            out.extend(bytes);
        }
    };
    for (x, y) in [(0.0_f64, 0.0_f32), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)] {
        put(x.to_le_bytes().to_vec(), format!("{x} "));
        put(y.to_le_bytes().to_vec(), format!("{y} "));
        put(7_i16.to_le_bytes().to_vec(), "7 ".to_owned());
        for value in [10_u8, 20, 30] {
            put(vec![value], format!("{value} "));
        }
        put((x as f32 / 2.0).to_le_bytes().to_vec(), format!("{} ", x / 2.0));
        put(y.to_le_bytes().to_vec(), format!("{y}\n"));
    }
    put(vec![4], "4 ".to_owned());
    for index in 0..4_i32 {
        put(index.to_le_bytes().to_vec(), format!("{index} "));
    }
    for value in [200_u8, 100, 50].into_iter().take(if of_face { 3 } else { 0 }) {
        put(vec![value], format!("{value} "));
    }
    put(Vec::new(), "\n".to_owned());
    put(0_i32.to_le_bytes().to_vec(), "0\n".to_owned());
    out
}

#[test]
fn text_and_both_orders_of_bytes_hold_the_same() {
    for of_face in [false, true] {
        let all = ["ascii", "binary_little_endian", "binary_big_endian"].map(|format| opened(&square(format, of_face)));
        let first = all[0].as_ref().expect("a square")[0].triangles.clone();
        assert_eq!(first.len(), 2);
        assert_eq!(first[0].corners, [DVec3::new(0.0, 0.0, 7.0), DVec3::new(2.0, 0.0, 7.0), DVec3::new(2.0, 1.0, 7.0)]);
        assert_eq!(first[0].uv, [DVec2::new(0.0, 1.0), DVec2::new(1.0, 1.0), DVec2::new(1.0, 0.0)]);
        assert_eq!(first[0].tint, [if of_face { [200, 100, 50] } else { [10, 20, 30] }; 3]);
        for found in &all {
            let found = &found.as_ref().expect("a square")[0];
            assert_eq!(found.triangles, first);
            assert!(found.left_out.iter().any(|said| said.contains("1 of edge")), "{:?}", found.left_out);
            assert!(found.left_out.iter().any(|said| said.contains("\"absent.png\"")), "{:?}", found.left_out);
        }
    }
}

#[test]
fn strips_restart_and_face_one_way() {
    let text = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n\
        element tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n0 2 0\n9 0 1 2 3 4 -1 0 1 2\n";
    let triangles = &opened(text.as_bytes()).expect("strips")[0].triangles;
    assert_eq!(triangles.len(), 4);
    for t in triangles {
        assert!((t.corners[1] - t.corners[0]).cross(t.corners[2] - t.corners[0]).z > 0.0);
    }
}

#[test]
fn any_cut_and_any_claim_is_an_error_or_fewer_triangles() {
    for format in ["ascii", "binary_little_endian", "binary_big_endian"] {
        let whole = square(format, true);
        for end in 0..whole.len() {
            if let Ok(pieces) = opened(&whole[..end]) {
                assert!(format == "ascii" && pieces.iter().map(|piece| piece.triangles.len()).sum::<usize>() <= 2);
            }
        }
    }
}

#[test]
fn faults_are_named_with_their_place() {
    let header = |lines: &str| format!("ply\nformat ascii 1.0\n{lines}end_header\n");
    let vertex = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
    let face = "element face 1\nproperty list uchar int vertex_index\n";
    let body = "0 0 0\n1 0 0\n0 1 0\n";
    for (text, part) in [
        ("plx\n".to_owned(), "line 1: no \"ply\""),
        ("ply\nformat ascii 1.0\n".to_owned(), "the end; expected end_header"),
        ("ply\nend_header\n".to_owned(), "no format"),
        ("ply\nformat zip 1.0\n".to_owned(), "line 2"),
        (header("element vertex many\n"), "line 3: \"element vertex many\""),
        (
            header("element vertex 18446744073709551615\nproperty float x\n"),
            "18446744073709551615 of vertex in 0 bytes",
        ),
        (header("property float x\n"), "line 3"),
        (header("element vertex 1\nproperty quad x\n"), "line 4: \"property quad x\""),
        (header("element vertex 1\nproperty float x\nproperty float y\n") + "1 2\n", "without x, y and z"),
        (header(vertex) + body, "a.ply: no triangles"),
        (header(&format!("{vertex}{face}")) + body + "3 0 1\n", "line 13: the end of the line; expected vertex_index"),
        (header(&format!("{vertex}{face}")) + body + "-3 0 1 2\n", "-3 items of vertex_index"),
        (header(&format!("{vertex}{face}")) + body + "3 0 one 2\n", "\"one\"; expected a number"),
        (header(&format!("{vertex}{face}")) + body, "1 of face in 18 bytes"),
        (header(&format!("{vertex}{face}")) + body + "\n\n\n", "the end; expected another face"),
    ] {
        let message = opened(text.as_bytes()).err().unwrap_or_default();
        assert!(message.contains(part) && message.contains("a.ply"), "{text:?}: {message:?}");
    }
    let text = header(&format!("{vertex}{face}")) + body + "3 0 1 -5\n";
    assert!(opened(text.as_bytes()).expect("a face")[0].triangles[0].corners[2].is_nan());
}
