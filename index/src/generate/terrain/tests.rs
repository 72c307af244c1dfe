use foresight_scheduler::lod_tree::{NodeId, RepId};

use super::*;
use crate::terrain::encode_heights;
use crate::world::open;

fn small() -> TerrainParams {
    TerrainParams { size: 10_000.0, resolution: 10.0, ..TerrainParams::default() }
}

#[test]
fn the_quadtree_covers_the_square() {
    let world = terrain(&small()).unwrap();
    // 10 km over tiles of 640 m: 16 × 16 of them.
    assert_eq!(world.tree.representations(), 256 + 64 + 16 + 4 + 1);
    let bounds = world.summary().bounds;
    assert_eq!((bounds.min.truncate(), bounds.max.truncate()), (DVec2::splat(-5120.0), DVec2::splat(5120.0)));
    assert!(bounds.min.z >= 0.0 && bounds.max.z <= 2000.0 && bounds.max.z - bounds.min.z > 300.0, "{bounds:?}");
    // Of more than one subtree that is modelled by itself, a tile is what it is by itself.
    let params = TerrainParams { size: 70.0 * 640.0, ..small() };
    let (world, shape) = (terrain(&params).unwrap(), params.shape().unwrap());
    let mut tiles = Vec::new();
    shape.preorder([0, shape.levels - 1], 0, 0, &mut tiles);
    assert_eq!((tiles.len(), shape.levels), (world.tree.representations(), 8));
    let fractal = params.fractal(&shape);
    for (rep, &(level, x, y)) in tiles.iter().enumerate().step_by(97) {
        let model = model::tile(&params, &shape, &fractal, shape.tiles(level), x, y);
        assert_eq!(world.tree.wire_bytes(RepId(rep as u32)), u64::from(model.wire_bytes), "{level} {x} {y}");
        assert_eq!(world.uri(RepId(rep as u32)), format!("{level}/{x}/{y}.glb"));
    }
    let odd = TerrainParams { size: 5.0 * 640.0, ..small() };
    assert_eq!(terrain(&odd).unwrap().tree.representations(), 25 + 9 + 4 + 1);
}

#[test]
fn sizes_and_errors_are_plausible() {
    let world = terrain(&small()).unwrap();
    let tree = &world.tree;
    for rep in (0..tree.representations() as u32).map(RepId) {
        assert!((20_000..100_000).contains(&tree.wire_bytes(rep)), "{}", tree.wire_bytes(rep));
        if let Some(parent) = tree.parent(tree.node_of(rep)) {
            assert!(tree.error(rep) <= tree.error(tree.own(parent).next().unwrap()));
        }
    }
    let bare = terrain(&TerrainParams { texels: 0, ..small() }).unwrap();
    let leaf = (0..bare.tree.nodes() as u32).map(NodeId).find(|&node| bare.tree.is_leaf(node)).unwrap();
    assert_eq!(bare.tree.error(bare.tree.own(leaf).next().unwrap()), 0.0);
}

#[test]
fn the_same_parameters_make_the_same_world() {
    let world = terrain(&small()).unwrap();
    assert_eq!(world.hash(), terrain(&small()).unwrap().hash());
    assert_ne!(world.hash(), terrain(&TerrainParams { seed: 2, ..small() }).unwrap().hash());
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("t");
    super::super::document::write(&small(), &out).unwrap();
    assert_eq!(open(&out).unwrap().hash(), world.hash());
}

#[test]
fn refuses_what_is_too_large() {
    let error = terrain(&TerrainParams { size: 4_000_000.0, resolution: 1.0, ..small() }).unwrap_err();
    assert!(matches!(error, GenerateError::TooMany { .. }), "{error}");
    assert!(
        terrain(&TerrainParams { resolution: 0.0, ..small() }).unwrap_err().to_string().starts_with("resolution is 0")
    );
    assert!(terrain(&TerrainParams { size: f64::NAN, ..small() }).is_err());
}

/// The model against tiles that are made: 4096 × 4096 cells of 10 m, their errors measured sample by sample.
#[test]
fn the_model_fits_tiles_that_are_made() {
    let params = TerrainParams { size: 16.0 * 640.0, texels: 0, ..small() };
    let shape = params.shape().unwrap();
    let fractal = params.fractal(&shape);
    let side = 16 * u64::from(TILE_CELLS) + 1;
    let heights: Vec<f64> =
        (0..side).flat_map(|y| (0..side).map(move |x| (x, y))).map(|(x, y)| fractal.sample(x, y)).collect();
    let at = |x: u64, y: u64| heights[(y * side + x) as usize];
    let cells = u64::from(TILE_CELLS);
    let (mut errors, mut sizes, mut outside) = (Vec::new(), Vec::new(), 0);
    for level in 0..4 {
        let stride = 1 << level;
        for (x, y) in (0..16 / stride).flat_map(|y| (0..16 / stride).map(move |x| (x, y))) {
            let modelled = model::tile(&params, &shape, &fractal, stride, x, y);
            let (x0, y0) = (x * cells * stride, y * cells * stride);
            let samples: Vec<f32> = (0..=cells)
                .flat_map(|j| (0..=cells).map(move |i| (i, j)))
                .map(|(i, j)| at(x0 + i * stride, y0 + j * stride) as f32)
                .collect();
            sizes.push(encode_heights(&samples, 65).len() as f64 / f64::from(modelled.wire_bytes));
            let mut error = 0.0_f64;
            for (i, j) in (0..cells * stride).flat_map(|j| (0..cells * stride).map(move |i| (i, j))) {
                let (cx, cy) = (i / stride * stride, j / stride * stride);
                let corner = |dx: u64, dy: u64| at(x0 + cx + dx * stride, y0 + cy + dy * stride);
                let part = DVec2::new((i - cx) as f64, (j - cy) as f64) / stride as f64;
                let coarse = crate::terrain::on_cell([corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)], part);
                let fine = at(x0 + i, y0 + j);
                error = error.max((coarse - fine).abs());
                outside += u64::from(fine < modelled.low - 1e-9 || fine > modelled.high + 1e-9);
            }
            if level > 0 {
                errors.push(error / modelled.error);
            }
        }
    }
    let spread = |ratios: &mut Vec<f64>| {
        ratios.sort_by(f64::total_cmp);
        let at = |part: f64| ratios[(part * (ratios.len() - 1) as f64) as usize];
        (at(0.05), at(0.5), at(0.95))
    };
    let (low, middle, high) = spread(&mut errors);
    let sizes = spread(&mut sizes);
    assert!(low > 0.7 && (0.9..1.1).contains(&middle) && high < 1.6, "errors {low} {middle} {high}");
    assert!(sizes.0 > 0.85 && (0.95..1.05).contains(&sizes.1) && sizes.2 < 1.1, "sizes {sizes:?}");
    assert!(outside * 10_000 < side * side, "{outside} samples outside the bounds");
}

#[test]
fn a_written_terrain_is_opened_as_what_was_measured() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("t");
    let params = TerrainParams { size: 3.0 * 640.0, ..small() };
    let mut told = Vec::new();
    let written = write(&params, &out, &mut |done, all| told.push((done, all))).unwrap();
    assert_eq!((written.tiles, written.files, told.last()), (14, 14, Some(&(14, 14))));
    let world = open(&out).unwrap();
    assert!(world.notes.is_empty(), "{:?}", world.notes);
    assert_eq!((world.up, world.tree.representations()), (DVec3::Z, 14));
    let sizes: u64 = (0..14).map(|rep| world.tree.wire_bytes(RepId(rep))).sum();
    assert_eq!(sizes, written.bytes);
    // The same surface as the catalogue's, and the same errors as an elevation grid would have.
    let catalogue = terrain(&params).unwrap();
    let (bounds, model) = (world.summary().bounds, catalogue.summary().bounds);
    assert_eq!((bounds.min.truncate(), bounds.max.truncate()), (model.min.truncate(), model.max.truncate()));
    let root = world.tree.error(RepId(0));
    assert!(root > 0.0 && (0.4..2.5).contains(&(root / catalogue.tree.error(RepId(0)))), "{root}");
    let leaf = (0..world.tree.nodes() as u32).map(NodeId).find(|&node| world.tree.is_leaf(node)).unwrap();
    assert_eq!(world.tree.error(world.tree.own(leaf).next().unwrap()), 0.0);
    let refused =
        write(&TerrainParams { size: 200_000.0, ..small() }, &folder.path().join("u"), &mut |_, _| {}).unwrap_err();
    assert!(refused.to_string().contains("--catalogue-only"), "{refused}");
}
