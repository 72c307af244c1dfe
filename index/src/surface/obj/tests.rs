use glam::{DVec2, DVec3};

use super::*;
use crate::orthoview::raster::Surface;

fn opened(files: &[(&str, &str)], up: Up) -> (tempfile::TempDir, Result<ObjFile, SurfaceError>) {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, text) in files {
        std::fs::write(folder.path().join(name), text).expect("written");
    }
    let source = ObjFile::open(&folder.path().join("a.obj"), up);
    (folder, source)
}

#[test]
fn faces_materials_colours_and_coordinates() {
    let text = "# a square and a triangle\nmtllib a.mtl\nv 0 0 0 1 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\n\
        usemtl red\nf 1/1 2/2/9 3/3 4//7\nusemtl other\nf -4 -3 \\\n -2\nl 1 2\n";
    let library = "newmtl red\nKd 1 0 0\nmap_Kd absent.png\nnewmtl green\nKd 0 0.5 0\n";
    let (_folder, source) = opened(&[("a.obj", text), ("a.mtl", library)], Up::Y);
    let source = source.expect("an OBJ");
    let piece = source.load(0).expect("readable");
    assert_eq!(piece.triangles.len(), 3);
    let [first, _, last] = [0, 1, 2].map(|at| &piece.triangles[at]);
    // y up in the file: the square stands.
    assert_eq!(first.corners, [DVec3::ZERO, DVec3::new(2.0, 0.0, 0.0), DVec3::new(2.0, 0.0, 1.0)]);
    assert_eq!(first.uv, [DVec2::new(0.0, 1.0), DVec2::new(1.0, 1.0), DVec2::new(1.0, 0.0)]);
    assert_eq!((first.tint[0], first.tint[1], first.two_sided), ([255, 0, 0], [255; 3], true));
    assert_eq!(last.corners, [DVec3::ZERO, DVec3::new(2.0, 0.0, 0.0), DVec3::new(2.0, 0.0, 1.0)]);
    let colour = |t: &Triangle| piece.materials.colour(t.material, DVec2::ZERO, 0.0);
    assert_eq!((colour(first), colour(last)), (Some([1.0, 0.0, 0.0]), Some([1.0; 3])));
    for part in ["\"absent.png\", which is not there", "\"other\", which no library has", "1 points, lines"] {
        assert!(piece.left_out.iter().any(|said| said.contains(part)), "{part}: {:?}", piece.left_out);
    }
}

#[test]
fn faults_name_the_line() {
    for (text, part) in [
        ("v 0 0 0\nv 1 0\n", "line 2: \"v 1 0\"; expected v with three numbers"),
        ("v 0 0 zero\n", "line 1"),
        ("v 0 0 0\nf 1 2\n", "line 2: \"f 1 2\"; expected f with 3"),
        ("v 0 0 0\nf 1 2 x/1\n", "line 2: \"f 1 2 x/1\"; expected corners"),
        ("v 0 0 0\n\n\u{1}\u{2}\n", "line 3"),
        ("v 0 0 0\n", "a.obj: no triangles; expected a mesh"),
        ("v 0 0 0\nl 1 1\n", "no triangles (left out: 1 points, lines"),
        ("", "a.obj: no triangles"),
    ] {
        let (_folder, source) = opened(&[("a.obj", text)], Up::Z);
        let fault = match source {
            Ok(source) => source.read(0).expect_err(text).to_string(),
            Err(error) => error.to_string(),
        };
        assert!(fault.contains(part) && fault.contains("a.obj"), "{text:?}: {fault}");
    }
}

#[test]
fn corners_that_name_no_vertex_are_no_numbers() {
    let (_folder, source) = opened(
        &[(
            "a.obj",
            "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\nf 1 2 9\nf 0 1 2\nf -9223372036854775808 1 2\nf 1/9 2/0 1\n",
        )],
        Up::Z,
    );
    let triangles = source.expect("an OBJ").triangles(0).expect("readable");
    assert_eq!(triangles.iter().filter(|t| t.corners.iter().any(|c| c.is_nan())).count(), 4);
    assert_eq!(triangles[4].uv, [DVec2::ZERO; 3]);
}

#[test]
fn a_large_file_is_cut_into_pieces_that_add_up() {
    let mut text = String::from("v 0 0 0\nv 1 0 0\nv 0 1 0\nmtllib a.mtl\n");
    let faces = PIECE_TRIANGLES + 10;
    for at in 0..faces {
        if at == faces / 2 {
            text.push_str("usemtl red\n");
        }
        text.push_str("f 1 2 -1\n");
    }
    let (_folder, source) = opened(&[("a.obj", &text), ("a.mtl", "newmtl red\nKd 1 0 0\n")], Up::Z);
    let source = source.expect("an OBJ");
    assert_eq!(source.pieces(), 2);
    let pieces = [0, 1].map(|piece| source.load(piece).expect("readable"));
    assert_eq!(pieces[0].triangles.len() + pieces[1].triangles.len(), faces);
    let red = |piece: &super::super::Surfaces| {
        let is_red = |t: &&Triangle| piece.materials.colour(t.material, DVec2::ZERO, 0.0) == Some([1.0, 0.0, 0.0]);
        piece.triangles.iter().filter(is_red).count()
    };
    assert_eq!([red(&pieces[0]), red(&pieces[1])], [PIECE_TRIANGLES - faces / 2, 10], "the material goes on");
}
