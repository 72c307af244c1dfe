//! What is written is read again, by this crate's own reader.

use super::*;
use crate::surface;
use std::sync::Arc;

fn read(glb: &[u8]) -> surface::Surfaces {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("level.glb");
    std::fs::write(&file, glb).expect("a file");
    let progress: crate::specification::Progress = Arc::new(|_, _| {});
    let source = surface::open(&file.to_string_lossy(), &progress).expect("a GLB");
    // A piece for each primitive, with materials of its own.
    let mut all = surface::Surfaces::default();
    for piece in 0..source.pieces() {
        let mut one = source.load(piece).expect("surfaces");
        let (materials, textures) = (all.materials.materials.len(), all.materials.textures.len());
        one.triangles.iter_mut().for_each(|t| t.material += materials as u32);
        one.materials.materials.iter_mut().for_each(|m| m.texture = m.texture.map(|t| t + textures));
        all.triangles.append(&mut one.triangles);
        all.materials.materials.append(&mut one.materials.materials);
        all.materials.textures.append(&mut one.materials.textures);
        all.left_out.append(&mut one.left_out);
    }
    all
}

fn sorted(mut corners: Vec<[DVec3; 3]>) -> Vec<[[i64; 3]; 3]> {
    // In steps of the lattice, which are 2⁻¹² m.
    let rounded = |at: DVec3| (at * 4096.0).round().to_array().map(|v| v as i64);
    let mut out: Vec<_> = corners
        .drain(..)
        .map(|triangle| {
            let mut at = triangle.map(rounded);
            let least = (0..3).min_by_key(|&i| at[i]).unwrap_or(0);
            at.rotate_left(least);
            at
        })
        .collect();
    out.sort_unstable();
    out
}

#[test]
fn every_packing_is_read_with_its_looks() {
    let mut content = hills(24, 1.0);
    let tint = [[255, 0, 0], [0, 255, 0], [10, 20, 30]];
    content.iter_mut().skip(40).step_by(3).for_each(|t| (t.material, t.tint) = (1, tint));
    let mut materials = painted();
    materials.materials.push(Material { base: [0.25, 0.5, 1.0], ..Material::default() });
    let mut all = Vec::new();
    for packing in [Packing::Floats, Packing::Quantised, Packing::Compressed] {
        for lit in [false, true] {
            let settings = GeometrySettings { packing, lit, coarsest: 0.0, ..GeometrySettings::default() };
            let levels = levels(&[(&content, &materials)], &octree(), cell(0), &settings).expect("geometry");
            let shown = read(&levels[0].glb);
            assert!(shown.left_out.is_empty(), "{:?}", shown.left_out);
            assert_eq!(shown.triangles.len() as u64, levels[0].triangles);
            if packing == Packing::Compressed {
                let corners = shown.triangles.iter().map(|t| t.corners).collect();
                assert_eq!(sorted(corners), sorted(triangles(&levels[0].glb)));
            }
            let is_tinted = |t: &&Triangle| t.tint != Triangle::WHITE;
            let tinted = shown.triangles.iter().find(is_tinted).expect("tints");
            assert_eq!(shown.materials.materials[tinted.material as usize].base, [0.25, 0.5, 1.0]);
            let mut colours = tinted.tint;
            colours.sort_unstable();
            // Colours of cut triangles are between those of their corners.
            assert!(shown.triangles.iter().any(|t| {
                let mut c = t.tint;
                c.sort_unstable();
                c == [[0, 255, 0], [10, 20, 30], [255, 0, 0]]
            }));
            // Texture coordinates are shares of the crop: the same place of the leaf shows the same colour.
            let painted = shown.triangles.iter().find(|t| !is_tinted(t)).expect("painted");
            let texture = shown.materials.materials[painted.material as usize].texture.expect("a texture");
            let cropped = shown.materials.textures[texture].as_deref().expect("an image").size();
            assert!(cropped.0 < 250 && cropped.1 < 250, "{cropped:?}");
            let here = (painted.corners[0] - DVec3::new(99.5, 49.5, 0.0)).truncate() / 17.0 * 500.0;
            let first = (0.5 / 17.0 * 500.0_f64 - 2.0).floor();
            let expected = (here - first) / DVec2::new(cropped.0 as f64, cropped.1 as f64);
            assert!((painted.uv[0] - expected).abs().max_element() < 1e-3, "{:?} for {expected:?}", painted.uv[0]);
            all.push(sorted(shown.triangles.iter().map(|t| t.corners).collect()));
        }
    }
    // Floats are the lattice's points too, to within 32 bits.
    assert!(all.iter().all(|triangles| triangles.len() == all[0].len()));
}
