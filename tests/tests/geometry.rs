//! Geometry of leaves before stock readers: what three.js's GLTFLoader makes of it, and what Khronos' validator says.

use std::sync::Arc;

use foresight_index::format::glb_compressed::Packing;
use foresight_index::geometry::{GeometryLevel, GeometrySettings, levels};
use foresight_index::octree::{Cell, Octree};
use foresight_index::orthoview::raster::Triangle;
use foresight_index::orthoview::texture::{Material, Materials, Texture};
use foresight_scheduler::lod_tree::Aabb;
use foresight_tests::fidelity::{Browser, packages_folder};
use glam::{DVec2, DVec3};
use serde_json::Value;

/// A leaf's least corner, far from the origin: 32 bits tell metres apart no better than by a quarter there.
const CORNER: DVec3 = DVec3::new(2_684_123.456_789, 1_246_000.123_4, 412.789);
const SIDE: f64 = 48.0;

fn octree() -> Octree {
    Octree::over(Aabb { min: CORNER, max: CORNER + SIDE }, SIDE).expect("a box")
}

/// Hills with a photograph, a fence with holes, a wall with repeated bricks, and a pole in two colours.
fn content() -> (Vec<Triangle>, Materials) {
    let mut triangles = Vec::new();
    let mut square = |corners: [DVec3; 4], uv: [DVec2; 4], material: u32, tint: [[u8; 3]; 4], two_sided: bool| {
        for [a, b, c] in [[0, 1, 2], [0, 2, 3]] {
            let (at, shown, tint) =
                ([corners[a], corners[b], corners[c]], [uv[a], uv[b], uv[c]], [tint[a], tint[b], tint[c]]);
            triangles.push(Triangle { corners: at, uv: shown, material, tint, two_sided });
        }
    };
    let height = |x: f64, y: f64| 4.0 + 2.0 * libm::sin(x * 0.21) * libm::cos(y * 0.33);
    let ground = |i: u32, j: u32| {
        let (x, y) = (f64::from(i) * 0.5, f64::from(j) * 0.5);
        CORNER + DVec3::new(x, y, height(x, y))
    };
    let white = [[255; 3]; 4];
    for j in 0..96 {
        for i in 0..96 {
            let around = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)];
            let uv = around.map(|(i, j)| DVec2::new(f64::from(i), f64::from(j)) / 96.0);
            square(around.map(|(i, j)| ground(i, j)), uv, 0, white, false);
        }
    }
    let upright = |x: f64, y: f64, width: f64| {
        let foot = CORNER + DVec3::new(x, y, 8.0);
        [foot, foot + DVec3::X * width, foot + DVec3::new(width, 0.0, 5.0), foot + DVec3::Z * 5.0]
    };
    let over = |times: f64| [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)].map(|(u, v)| DVec2::new(u, v) * times);
    square(upright(4.0, 10.0, 20.0), over(1.0), 1, white, true);
    square(upright(4.0, 30.0, 20.0), over(5.0), 2, white, false);
    let two = [[200, 30, 30], [200, 30, 30], [255; 3], [255; 3]];
    square(upright(40.0, 40.0, 1.0), over(1.0), 3, two, true);

    let photograph = (0..512 * 512_u32).map(|i| [(i % 256) as u8, (i / 1024) as u8, 90, 255]).collect();
    let fence = (0..64 * 64_u32).map(|i| [120, 80, 40, if i / 8 % 2 == 0 { 255 } else { 0 }]).collect();
    let bricks = (0..32 * 32_u32).map(|i| [160, 60, (i * 7 % 90) as u8, 255]).collect();
    let texture = |side: usize, texels: Vec<[u8; 4]>| Some(Arc::new(Texture::new(side, side, texels)));
    let shown = |texture| Material { texture, ..Material::default() };
    let materials = Materials {
        materials: vec![shown(Some(0)), Material { cutoff: 0.5, ..shown(Some(1)) }, shown(Some(2)), shown(None)],
        textures: vec![texture(512, photograph), texture(64, fence), texture(32, bricks)],
    };
    (triangles, materials)
}

fn made(settings: GeometrySettings) -> Vec<GeometryLevel> {
    let (triangles, materials) = content();
    levels(&[(&triangles, &materials)], &octree(), Cell { level: 0, place: [0; 3] }, &settings).expect("geometry")
}

fn browser() -> Option<Browser> {
    if let Err(skipped) = foresight_tests::full() {
        println!("{skipped}");
        return None;
    }
    match Browser::install(&packages_folder().expect("a folder for packages")) {
        Ok(browser) => Some(browser),
        Err(error) => {
            assert!(std::env::var_os("CI").is_none_or(|value| value != "true"), "{error}");
            println!("skipped: {error}");
            None
        }
    }
}

/// Every packing, unlit and lit.
fn all() -> Vec<(GeometrySettings, GeometryLevel)> {
    let packings = [Packing::Floats, Packing::Quantised, Packing::Compressed];
    let settings = packings
        .into_iter()
        .flat_map(|packing| [false, true].map(|lit| GeometrySettings { packing, lit, ..GeometrySettings::default() }));
    settings.flat_map(|settings| made(settings).into_iter().map(move |level| (settings, level))).collect()
}

#[test]
fn gltf_loader_shows_what_was_built() {
    let Some(browser) = browser() else { return };
    let all = all();
    let files: Vec<Vec<u8>> = all.iter().map(|(_, level)| level.glb.clone()).collect();
    let loaded = browser.load_models(&files).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(loaded.len(), all.len());
    for ((settings, level), loaded) in all.iter().zip(&loaded) {
        let of = format!("{settings:?}: {loaded:?}");
        assert_eq!((loaded.vertices, loaded.triangles), (level.vertices, level.triangles), "{of}");
        let meshes = loaded.lit + loaded.unlit;
        assert!(meshes >= 3 && (if settings.lit { loaded.unlit } else { loaded.lit }) == 0, "{of}");
        assert!(loaded.textures.len() >= 2 && loaded.repeated == 1, "{of}");
        // The hills reach from face to face. y up: (x, z, −y).
        let (min, max) = (DVec3::from_array(loaded.min), DVec3::from_array(loaded.max));
        let expected = (DVec3::new(CORNER.x, min.y, -CORNER.y - SIDE), DVec3::new(CORNER.x + SIDE, max.y, -CORNER.y));
        // 32-bit positions reach the loader's box in 64 bits.
        assert!((min - expected.0).abs().max_element() < 1e-4, "{of}");
        assert!((max - expected.1).abs().max_element() < 1e-4, "{of}");
        let top = CORNER.z + 13.0;
        assert!((max.y - top).abs() <= f64::from(level.error) + 1e-4, "{of}");
    }
}

#[test]
fn the_validator_finds_nothing_wrong() {
    let Some(browser) = browser() else { return };
    let all = all();
    let files: Vec<Vec<u8>> = all.iter().map(|(_, level)| level.glb.clone()).collect();
    let reports = browser.validate_models(&files).unwrap_or_else(|error| panic!("{error}"));
    for ((settings, level), report) in all.iter().zip(&reports) {
        // It does not know the compression, and takes the second buffer, which is for others, for a lack of data.
        let unknown = |message: &&Value| {
            settings.packing == Packing::Compressed
                && message["pointer"].as_str().is_some_and(|p| p.starts_with("/buffers/1"))
        };
        let messages = report["issues"]["messages"].as_array().expect("messages");
        let bad: Vec<&Value> =
            messages.iter().filter(|m| m["severity"].as_u64() < Some(2)).filter(|m| !unknown(m)).collect();
        assert!(bad.is_empty(), "{settings:?}: {bad:#?}");
        assert_eq!(report["info"]["totalTriangleCount"], level.triangles, "{settings:?}");
    }
}
