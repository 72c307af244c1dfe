//! What no mesh should be, and is.

use super::*;

fn sound(levels: &[GeometryLevel]) {
    for level in levels {
        assert!(level.error.is_finite() && level.error >= 0.0);
        for corner in triangles(&level.glb).into_iter().flatten() {
            assert!(corner.is_finite(), "{corner}");
        }
        let (json, _) = chunks(&level.glb);
        assert!(!json.to_string().contains("null"), "a number that is none: {json}");
    }
}

fn of(corners: &[[[f64; 3]; 3]]) -> Vec<GeometryLevel> {
    let content: Vec<Triangle> = corners.iter().map(|c| triangle(c.map(DVec3::from_array))).collect();
    let levels = made(&content, &Materials::default(), 0);
    sound(&levels);
    levels
}

const A: [f64; 3] = [101.0, 51.0, 0.0];
const B: [f64; 3] = [107.0, 51.0, 1.0];
const C: [f64; 3] = [104.0, 57.0, 2.0];

#[test]
fn nothing_and_what_is_elsewhere_make_no_level() {
    assert!(of(&[]).is_empty());
    assert!(of(&[[[110.0, 51.0, 0.0], [115.0, 51.0, 0.0], [112.0, 55.0, 0.0]]]).is_empty());
}

#[test]
fn a_single_triangle_is_one_level() {
    let levels = of(&[[A, B, C]]);
    assert_eq!((levels.len(), levels[0].triangles, levels[0].vertices), (1, 1, 3));
}

#[test]
fn numbers_that_are_none_and_outliers_are_left_out() {
    let nan = f64::NAN;
    let bad = [[[nan, 51.0, 0.0], B, C], [A, [f64::INFINITY, 0.0, 0.0], C], [A, B, [0.0, f64::NEG_INFINITY, nan]]];
    assert!(of(&bad).is_empty());
    let levels = of(&[bad[0], bad[1], [A, B, C], bad[2]]);
    assert_eq!(levels[0].triangles, 1);
    // Corners far out: the leaf has its share.
    for far in [1e6, 1e12, 1e150, 1e300] {
        let levels = of(&[[[-far, -far, 0.5], [far, -far, 0.5], [0.0, far, 0.5]], [A, B, C]]);
        assert!(!levels.is_empty());
    }
}

#[test]
fn points_lines_and_slivers_are_no_surface() {
    assert!(of(&[[A, A, A], [A, B, A], [A, B, B]]).is_empty());
    let middle: [f64; 3] = std::array::from_fn(|i| 0.5 * (A[i] + B[i]));
    assert!(of(&[[A, B, middle]]).is_empty());
    // Narrower than the lattice.
    let beside = [middle[0], middle[1] + 1e-7, middle[2]];
    assert!(of(&[[A, B, beside]]).is_empty());
    let levels = of(&[[A, B, beside], [A, B, C]]);
    assert_eq!(levels[0].triangles, 1);
    assert!(levels[0].error < 1e-3, "{}", levels[0].error);
}

#[test]
fn a_mesh_smaller_than_a_step_shows_nothing() {
    let tiny = |d: f64| [A, [A[0] + d, A[1], A[2]], [A[0], A[1] + d, A[2]]];
    assert!(of(&[tiny(1e-6), tiny(1e-5)]).is_empty());
}

#[test]
fn repeated_and_turned_triangles_are_shown_once() {
    let levels = of(&[[A, B, C], [B, C, A], [C, A, B], [A, B, C]]);
    assert_eq!(levels[0].triangles, 1);
    assert_eq!(of(&[[A, B, C], [A, C, B]])[0].triangles, 2, "a back is another surface");
}

#[test]
fn edges_of_many_triangles_are_kept_and_simplified() {
    // Twelve pages on one spine, each bent in 20 places.
    let mut pages = Vec::new();
    for page in 0..12 {
        let turn = f64::from(page) * 0.5;
        let at = |i: u32, z: f64| {
            let r = f64::from(i) * 0.15;
            [104.0 + r * libm::cos(turn), 54.0 + r * libm::sin(turn), z + 0.01 * f64::from(i % 3)]
        };
        for i in 0..20 {
            pages.push([at(i, -2.0), at(i + 1, -2.0), at(i + 1, 2.0)]);
            pages.push([at(i, -2.0), at(i + 1, 2.0), at(i, 2.0)]);
        }
    }
    let levels = of(&pages);
    assert!(levels.len() >= 2 && levels[0].triangles == 480, "{}", levels.len());
}

#[test]
fn a_million_coincident_triangles_are_one() {
    let content = vec![triangle([A, B, C].map(DVec3::from_array)); 1_000_000];
    let levels = made(&content, &Materials::default(), 0);
    sound(&levels);
    assert_eq!(levels[0].triangles, 1);
}

#[test]
fn a_fan_of_many_triangles_about_one_vertex_takes_bounded_time() {
    let rim = |i: u32| {
        let turn = f64::from(i) * 3e-4;
        DVec3::new(104.0 + 3.0 * libm::cos(turn), 54.0 + 3.0 * libm::sin(turn), 0.0)
    };
    let content: Vec<Triangle> =
        (0..20_000).map(|i| triangle([DVec3::new(104.0, 54.0, 1.0), rim(i), rim(i + 1)])).collect();
    let levels = made(&content, &Materials::default(), 0);
    sound(&levels);
    assert!(!levels.is_empty());
}

#[test]
fn overlapping_sheets_take_bounded_time() {
    // 20,000 large triangles through each other: no tree of boxes parts them.
    let mut state = 1_u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f64 / (1_u64 << 24) as f64
    };
    let mut corner = || DVec3::new(100.5 + 7.0 * next(), 50.5 + 7.0 * next(), -3.5 + 7.0 * next());
    let content: Vec<Triangle> = (0..20_000).map(|_| triangle([corner(), corner(), corner()])).collect();
    sound(&made(&content, &Materials::default(), 0));
}

#[test]
fn texture_coordinates_that_are_none_and_missing_textures_are_harmless() {
    let mut content = hills(8, 0.1);
    content[0].uv[1] = DVec2::NAN;
    content[1].uv[2] = DVec2::new(f64::INFINITY, 0.5);
    content[2].uv[0] = DVec2::new(1e300, -1e300);
    content[3].material = 77;
    let levels = made(&content, &painted(), 0);
    sound(&levels);
    let mut missing = painted();
    missing.textures[0] = None;
    missing.materials.push(Material { texture: Some(9), base: [f32::NAN, 2.0, -1.0], cutoff: f32::NAN });
    content[4].material = 1;
    let levels = made(&content, &missing, 0);
    sound(&levels);
    let (json, _) = chunks(&levels[0].glb);
    assert!(json.get("images").is_none());
}

#[test]
fn settings_out_of_range_are_refused() {
    let bad = |change: fn(&mut GeometrySettings)| {
        let mut settings = GeometrySettings::default();
        change(&mut settings);
        assert!(settings.check().is_err(), "{settings:?}");
    };
    bad(|s| s.finest = -1.0);
    bad(|s| s.finest = f64::NAN);
    bad(|s| s.coarsest = 2.0);
    bad(|s| s.gain = 0.0);
    bad(|s| s.texels = f64::INFINITY);
    bad(|s| s.jpeg_quality = 0);
}
