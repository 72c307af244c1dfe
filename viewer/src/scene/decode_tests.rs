use super::*;
use foresight_index::format::glb;
use foresight_index::format::orthoview::{Encoding, encode};
use foresight_index::orthoview::connectivity::{Thresholds, links};
use foresight_index::orthoview::raster::{self, Drawn};
use foresight_index::orthoview::texture::Materials;
use foresight_index::uris::UriTableBuilder;
use foresight_index::world::WorldKind;
use foresight_scheduler::lod_tree::{LodTreeBuilder, Representation};
use std::path::{Path, PathBuf};

/// A part of the shared data, or `None` (said, and a failure under CI) where it is absent.
fn data(part: &str) -> Option<PathBuf> {
    let beside = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data"));
    let path = std::env::var_os("FORESIGHT_DATA").map_or(beside, PathBuf::from).join(part);
    if path.exists() {
        return Some(path);
    }
    assert!(std::env::var_os("CI").is_none(), "{} is absent", path.display());
    println!("skipped: {} is absent", path.display());
    None
}

const PITCH: f64 = 0.25;

/// An octree of 4 × 4 × 2 leaves of 8 m, far from the origin of the world.
fn octree() -> Octree {
    Octree::of(DVec3::new(6.4e6, -3.0, 100.0), 8.0, [2, 2, 1]).expect("an octree")
}

/// A stored world of one leaf's orthoview, or of one geometry.
fn stored_world(direction: Option<Direction>, uri: (&str, &str), bytes: u64) -> (World, Source) {
    let mut tree = LodTreeBuilder::default();
    let mut uris = UriTableBuilder::default();
    tree.open().expect("a node");
    let direction = direction.map(Direction::code);
    let (wire_bytes, decoded_bytes) = (u32::try_from(bytes).expect("small"), 1 << 12);
    tree.add(Representation { wire_bytes, decoded_bytes, error: 1.0, prerequisite: None, direction }).expect("one");
    let (folder, name) = (uris.intern(uri.0), uris.intern(uri.1));
    uris.push(folder, name);
    tree.close(Some(octree().bounds(Cell { level: 0, place: [1, 1, 0] })), 1.0).expect("a leaf");
    let mut world = foresight_index::world::built_in_city();
    (world.kind, world.tree, world.uris) = (WorldKind::Built, tree.finish().expect("a tree"), uris.finish());
    (world, Source::in_folder(Path::new("absent"), Placing::Stored { octree: octree(), pixel: PITCH }))
}

/// Two triangles that slope through the leaf, and a wall in it.
fn content() -> Vec<Triangle> {
    let low = octree().bounds(Cell { level: 0, place: [1, 1, 0] }).min;
    let at = |x: f64, y: f64, z: f64| low + DVec3::new(x, y, z);
    let both = |corners| Triangle { corners, two_sided: true, tint: [[200, 100, 50]; 3], ..Triangle::default() };
    vec![
        both([at(0.0, 0.0, 1.0), at(8.0, 0.0, 3.0), at(8.0, 8.0, 5.0)]),
        both([at(0.0, 0.0, 1.0), at(8.0, 8.0, 5.0), at(0.0, 8.0, 3.0)]),
        both([at(4.0, 1.0, 3.0), at(4.0, 7.0, 3.0), at(4.5, 4.0, 7.5)]),
    ]
}

#[test]
fn splats_stand_where_the_image_was_taken_from_all_sides() {
    let cell = Cell { level: 0, place: [1, 1, 0] };
    let materials = Materials::default();
    for direction in Direction::all() {
        let lattice = Lattice { direction, origin: octree().origin(), pitch: PITCH };
        let mut drawn = Drawn::default();
        let triangles = content();
        let surface: &dyn raster::Surface = &materials;
        let view = raster::leaf(&octree(), cell, &lattice, [(triangles.as_slice(), surface)], &mut drawn);
        let view = view.expect("something is seen from everywhere");
        let links = links(&view, &lattice, &Thresholds::default());
        let file = encode(&view, &links, direction, Encoding::default()).expect("small").expect("shows something");
        let (world, source) = stored_world(Some(direction), ("orthoviews/0/1_1_0/", "x.fsov"), file.len() as u64);
        let decoded = decode(&world, &source, RepId(0), &file).expect("just written");
        let Content::Splats(image) = decoded.content else { panic!("splats") };
        let mut seen = 0;
        for (index, shape) in image.shapes.iter().enumerate() {
            let (column, row) = (index as u32 % image.size[0], index as u32 / image.size[0]);
            let depth = f64::from(shape & 1023) / 1023.0 * image.range;
            let at = image.origin + image.pixel * (f64::from(column) * image.right + f64::from(row) * image.up)
                - depth * image.towards_eye;
            if shape >> 10 & 0b10_0000 == 0 {
                continue;
            }
            seen += 1;
            let pixel = (lattice.project(at).truncate() - 0.5).round();
            let index = view.rect.index(glam::I64Vec2::new(pixel.x as i64, pixel.y as i64)).expect("in the image");
            let expected = view.position(&lattice, index).expect("shown there");
            assert!((at - expected).length() <= depth_error(view.range) + 1e-6, "{direction:?}: {at} {expected}");
        }
        assert_eq!(seen, view.pixels.iter().filter(|p| p.is_some()).count());
        assert_eq!(image.bounds, octree().bounds(cell));
        assert_eq!(cell_bounds(&world, &source, RepId(0)), Some(image.bounds));
        assert_eq!(image.normals.len(), 2 * image.shapes.len());
        assert_eq!(image.colours.len(), 4 * image.shapes.len());
        assert!(image.colours.as_chunks::<4>().0.iter().all(|pixel| pixel[3] == 255));
    }
}

#[test]
fn a_file_cut_at_any_length_or_put_elsewhere_is_refused() {
    let cell = Cell { level: 0, place: [1, 1, 0] };
    let direction = Direction::from_signs([0, 0, 1]).expect("canonical");
    let lattice = Lattice { direction, origin: octree().origin(), pitch: PITCH };
    let (triangles, materials) = (content(), Materials::default());
    let surface: &dyn raster::Surface = &materials;
    let view = raster::leaf(&octree(), cell, &lattice, [(triangles.as_slice(), surface)], &mut Drawn::default());
    let view = view.expect("seen");
    let links = links(&view, &lattice, &Thresholds::default());
    let file = encode(&view, &links, direction, Encoding::default()).expect("small").expect("shown");
    let (world, source) = stored_world(Some(direction), ("orthoviews/0/1_1_0/", "x.fsov"), file.len() as u64);
    for length in 0..file.len() {
        let error = decode(&world, &source, RepId(0), &file[..length]).expect_err("cut");
        assert!(error.to_string().contains("representation 0 (orthoviews/0/1_1_0/x.fsov): "), "{error}");
        assert!(error.fault.contains("expected") || error.fault.contains("plane"), "{error}");
    }
    let refused = |uri: (&str, &str), direction: Option<Direction>, part: &str| {
        let (world, source) = stored_world(direction, uri, 1);
        let error = decode(&world, &source, RepId(0), &file).expect_err("elsewhere").to_string();
        assert!(error.contains(part), "{error}");
    };
    refused(("orthoviews/0/2_1_0/", "x.fsov"), Some(direction), "where the cell is");
    refused(("orthoviews/1/0_0_0/", "x.fsov"), Some(direction), "an image of level 0; expected 1");
    refused(("orthoviews/", "x.fsov"), Some(direction), "an address without a cell");
    refused(("geometry/1_1_0/", "0.glb"), None, "expected \"glTF\"");
    let other = Direction::from_signs([1, 0, 0]);
    refused(("orthoviews/0/1_1_0/", "x.fsov"), other, "an image along oop; expected one along poo");
    // Depths that reach out of the cell.
    let mut far = file.clone();
    far[44..52].copy_from_slice(&1e9f64.to_le_bytes());
    let error = decode(&world, &source, RepId(0), &far).expect_err("too deep");
    assert!(error.fault.contains("byte 36: depths from"), "{error}");
}

#[test]
fn geometry_stands_where_it_is_and_a_cut_one_is_refused() {
    let low = DVec3::new(6.4e6, 10.0, 100.0);
    let positions = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 1.0], [2.0, 2.0, 0.5]];
    let triangles = [[0, 1, 2], [1, 3, 2]];
    let normals = [[0.0, 0.0, 1.0]; 4];
    let file =
        glb::encode(&glb::Mesh { origin: Some(low), positions: &positions, normals: &normals, triangles: &triangles });
    let (world, source) = stored_world(None, ("geometry/1_1_0/", "0.glb"), file.len() as u64);
    let decoded = decode(&world, &source, RepId(0), &file).expect("just written");
    let Content::Mesh(mesh) = decoded.content else { panic!("a mesh") };
    assert_eq!((mesh.vertices.len(), mesh.indices.len(), mesh.parts.len()), (4, 6, 1), "corners are shared");
    let at = |vertex: usize| mesh.origin + DVec3::from_array(mesh.vertices[vertex].position.map(f64::from));
    for (corner, &index) in mesh.indices.iter().enumerate() {
        let expected = positions[triangles.as_flattened()[corner] as usize];
        assert!((at(index as usize) - low - DVec3::from_array(expected.map(f64::from))).length() < 1e-6);
    }
    assert_eq!(mesh.vertices[0].normal, [0.0, 0.0, 1.0]);
    assert_eq!(mesh.bounds, Aabb { min: low, max: low + DVec3::new(2.0, 2.0, 1.0) });
    for length in 0..file.len() {
        assert!(decode(&world, &source, RepId(0), &file[..length]).is_err(), "cut to {length} bytes");
    }
}

#[test]
fn far_texture_coordinates_stay_fine_and_sides_are_kept_apart() {
    let mut triangles = content();
    triangles[0].uv = [glam::DVec2::new(1e9 + 0.25, 3.0), glam::DVec2::new(1e9 + 1.5, 3.0), glam::DVec2::new(1e9, 4.0)];
    triangles[1].two_sided = false;
    triangles[2].corners[1] = DVec3::NAN;
    let (content, left_out) = meshed(Piece { triangles, ..Piece::default() });
    let Content::Mesh(mesh) = content else { panic!("a mesh") };
    assert_eq!(left_out, ["1 triangles that are not finite"]);
    assert_eq!(mesh.parts.iter().map(|part| part.two_sided).collect::<Vec<_>>(), [false, true]);
    let uv = mesh.vertices[mesh.indices[3] as usize].uv;
    assert_eq!(uv, [0.25, 0.0]);
    let (empty, _) = meshed(Piece::default());
    assert!(matches!(empty, Content::Empty));
}

#[test]
fn every_content_of_recorded_tilesets_is_drawn_within_its_bounds() {
    for (name, expected) in [
        ("mars_dingo_gap_3dtiles", 298_357),
        ("cesium_metadata_granularities", 10_868),
        ("cesium_sparse_implicit_quadtree", 64),
    ] {
        let Some(path) = data(&format!("scenes/{name}")) else { continue };
        let (world, source) = Source::open(&path.to_string_lossy()).expect("a tileset");
        assert_eq!(source.refusal(), None);
        let mut triangles = 0;
        for rep in (0..world.tree.representations() as u32).map(RepId) {
            let bytes = source.bytes(&world, rep).expect("a file");
            let decoded = decode(&world, &source, rep, &bytes).unwrap_or_else(|error| panic!("{error}"));
            let Content::Mesh(mesh) = decoded.content else { panic!("{name} {}: no mesh", world.uri(rep)) };
            let node = world.tree.bounds(world.tree.node_of(rep));
            let slack = 1e-3 * (node.max - node.min).length() + 1e-6 * mesh.origin.length();
            assert!(
                (mesh.bounds.min + slack).cmpge(node.min).all() && (mesh.bounds.max - slack).cmple(node.max).all(),
                "{name} {}: {:?} in {node:?}",
                world.uri(rep),
                mesh.bounds
            );
            assert!(mesh.vertices.iter().flat_map(|v| v.position.iter().chain(&v.normal)).all(|v| v.is_finite()));
            triangles += mesh.indices.len() / 3;
        }
        assert_eq!(triangles, expected, "{name}");
    }
}

#[test]
fn a_truncated_content_of_a_recorded_tileset_is_refused() {
    let Some(path) = data("scenes/mars_dingo_gap_3dtiles") else { return };
    let (world, source) = Source::open(&path.to_string_lossy()).expect("a tileset");
    let rep = (0..world.tree.representations() as u32).map(RepId).find(|&rep| world.uri(rep) == "333.b3dm");
    let rep = rep.expect("the smallest file");
    let bytes = source.bytes(&world, rep).expect("a file");
    for length in (0..bytes.len()).step_by(7).chain(bytes.len() - 8..bytes.len()) {
        let error = decode(&world, &source, rep, &bytes[..length]).expect_err("cut");
        assert!(error.to_string().contains("(333.b3dm)"), "{error}");
    }
}

#[test]
fn a_generated_city_is_made_and_one_of_sizes_only_says_so() {
    let (world, source) = Source::open("city:blocks=1,seed=3").expect("a city");
    for rep in (0..world.tree.representations() as u32).map(RepId) {
        let bytes = source.bytes(&world, rep).expect("made");
        let decoded = decode(&world, &source, rep, &bytes).expect("its own GLB");
        assert!(decoded.left_out.is_empty(), "{:?}", decoded.left_out);
        let Content::Mesh(mesh) = decoded.content else { panic!("a mesh") };
        assert!(mesh.parts.iter().all(|part| part.texture.is_none_or(|texture| texture < mesh.textures.len())));
    }
    let (world, source) = Source::open("city:blocks=1,orthoviews=64").expect("a city");
    assert!(source.refusal().expect("sizes only").contains("sizes only"));
    let error = source.bytes(&world, RepId(0)).expect_err("no bytes").to_string();
    assert!(error.contains("expected one with contents"), "{error}");
    assert!(decode(&world, &source, RepId(0), b"glTF").is_err());
    assert!(source.bytes(&world, RepId(u32::MAX)).expect_err("no such one").fault.contains("expected one of"));
}

#[test]
fn worlds_that_are_made_or_imported_whole_are_drawn_within_their_bounds() {
    let recorded = [
        "scenes/delft_lod1.city.json",
        "scenes/zurich_subset_lod2.city.json",
        "scenes/3dbag_tile5870.city.jsonl",
        "scenes/jacksboro_fault_dem.npz",
    ];
    let made = ["terrain:size=3km,resolution=20m", "asteroids:count=12,triangles=300"].map(str::to_owned);
    let recorded = recorded.into_iter().filter_map(data).map(|path| path.to_string_lossy().into_owned());
    for name in made.into_iter().chain(recorded) {
        let (world, source) = Source::open(&name).expect("a world");
        assert_eq!(source.refusal(), None, "{name}");
        let mut triangles = 0;
        for rep in (0..world.tree.representations() as u32).map(RepId) {
            // What a server sends in place of files means nothing.
            let decoded = decode(&world, &source, rep, b"filler").unwrap_or_else(|error| panic!("{error}"));
            let Content::Mesh(mesh) = decoded.content else { panic!("{name}: no mesh") };
            let node = world.tree.bounds(world.tree.node_of(rep));
            // Coarse levels may reach out by their error, and skirts by that of the tile above.
            let slack =
                2.0 * world.tree.error(RepId(0)).max(world.tree.error(rep)) + 1e-3 * (node.max - node.min).length();
            assert!(
                (mesh.bounds.min + slack).cmpge(node.min).all() && (mesh.bounds.max - slack).cmple(node.max).all(),
                "{name} {}: {:?} in {node:?}",
                world.uri(rep),
                mesh.bounds
            );
            triangles += mesh.indices.len() / 3;
        }
        assert!(triangles > 1000, "{name}: {triangles}");
    }
}

#[test]
fn files_outside_of_the_folder_are_not_read() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("secret"), "12345678").expect("a file");
    let inside = folder.path().join("world");
    std::fs::create_dir_all(inside.join("geometry/1_1_0")).expect("folders");
    let source = Source::in_folder(&inside, Placing::Stored { octree: octree(), pixel: PITCH });
    for (folder, name) in [("../", "secret"), ("", "../secret"), ("geometry/1_1_0/", "../../../secret")] {
        let (world, _) = stored_world(None, (folder, name), 8);
        let error = source.bytes(&world, RepId(0)).expect_err("outside");
        assert!(error.fault.contains("outside of the world's folder"), "{error}");
    }
    std::fs::write(inside.join("geometry/1_1_0/0.glb"), "1234").expect("a file");
    let (world, _) = stored_world(None, ("geometry/1_1_0/", "0.glb"), 8);
    assert_eq!(source.bytes(&world, RepId(0)).expect_err("too short").fault, "4 bytes; expected 8");
    let (world, _) = stored_world(None, ("geometry/1_1_0/", "0.glb"), 4);
    assert_eq!(source.bytes(&world, RepId(0)).expect("a file"), b"1234");
}
