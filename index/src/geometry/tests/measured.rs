//! Levels and their errors against brute force.

use super::*;
use crate::mesh::triangle::closest;
use proptest::prelude::*;

/// Largest distance of points sampled on `from` from `to`.
fn sampled(from: &[[DVec3; 3]], to: &[[DVec3; 3]], steps: u32) -> f64 {
    let mut farthest = 0.0_f64;
    for [p, q, r] in from {
        for i in 0..=steps {
            for j in 0..=steps - i {
                let (s, t) = (f64::from(i) / f64::from(steps), f64::from(j) / f64::from(steps));
                let at = *p + (*q - *p) * s + (*r - *p) * t;
                let near = to.iter().map(|t| (closest(t, at) - at).length_squared()).fold(f64::INFINITY, f64::min);
                farthest = farthest.max(near);
            }
        }
    }
    farthest.sqrt()
}

fn clipped(content: &[Triangle], place: u64) -> Vec<[DVec3; 3]> {
    let materials = Materials::default();
    let octree = octree();
    let soup = soup::gathered(&[(content, &materials)], &octree, cell(place)).expect("few triangles");
    let origin = octree.bounds(cell(place)).min;
    soup.pieces.iter().map(|p| p.corners.map(|at| at + origin)).collect()
}

#[test]
fn errors_are_above_what_sampling_finds_and_near_it() {
    let content = hills(64, 1.0);
    let originals = clipped(&content, 0);
    let levels = made(&content, &Materials::default(), 0);
    assert!(levels.len() >= 3, "{}", levels.len());
    for (finer, level) in levels.iter().zip(&levels[1..]) {
        assert!(level.error > finer.error && level.glb.len() < finer.glb.len() && level.triangles < finer.triangles);
    }
    for level in &levels {
        let shown = triangles(&level.glb);
        assert_eq!(shown.len() as u64, level.triangles);
        let found = sampled(&originals, &shown, 4).max(sampled(&shown, &originals, 4));
        let error = f64::from(level.error);
        assert!(found <= error + 1e-9, "{found} above {error}");
        assert!(level.measured.upper <= error && level.measured.lower <= level.measured.upper);
        // The bracket's tolerance, and what samples miss.
        assert!(found >= 0.8 * level.measured.lower - 1e-3, "{found} for {level:?}", level = level.measured);
        let step = 8.0 / f64::from(STEPS);
        assert!(level.measured.upper <= 1.06 * level.measured.lower + step, "{:?}", level.measured);
    }
    // Rounding to the lattice alone.
    assert!(f64::from(levels[0].error) < 8.0 / f64::from(STEPS), "{}", levels[0].error);
}

#[test]
fn what_is_left_out_counts_with_its_diameter() {
    // A chimney of 20 cm, 4 m above a floor.
    let floor = [
        triangle([DVec3::new(101.0, 51.0, -3.0), DVec3::new(107.0, 51.0, -3.0), DVec3::new(107.0, 57.0, -3.0)]),
        triangle([DVec3::new(101.0, 51.0, -3.0), DVec3::new(107.0, 57.0, -3.0), DVec3::new(101.0, 57.0, -3.0)]),
    ];
    let at = |x: f64, y: f64, z: f64| DVec3::new(104.0 + x, 54.0 + y, 1.0 + z);
    let chimney = triangle([at(0.0, 0.0, 0.0), at(0.2, 0.0, 0.0), at(0.0, 0.0, 0.15)]);
    let content = [floor[0], floor[1], chimney];
    let settings = GeometrySettings { gain: 1.0, least_bytes: 0, ..GeometrySettings::default() };
    let plain = Materials::default();
    let levels = levels(&[(&content, &plain)], &octree(), cell(0), &settings).expect("geometry");
    let (first, last) = (&levels[0], &levels[levels.len() - 1]);
    assert_eq!((first.triangles, last.triangles), (3, 2));
    assert!((0.25..0.2505).contains(&last.error), "{}", last.error);
}

#[test]
fn textures_are_reduced_to_the_error_and_cropped_to_what_is_shown() {
    let content = hills(64, 0.5);
    let materials = painted();
    let settings = GeometrySettings { packing: Packing::Floats, ..GeometrySettings::default() };
    let levels = levels(&[(&content, &materials)], &octree(), cell(1), &settings).expect("geometry");
    for level in &levels {
        let (json, binary) = chunks(&level.glb);
        let view = &json["bufferViews"][json["images"][0]["bufferView"].as_u64().expect("a view") as usize];
        let start = view["byteOffset"].as_u64().expect("an offset") as usize;
        let bytes = &binary[start..start + view["byteLength"].as_u64().expect("a length") as usize];
        let image = image::load_from_memory(bytes).expect("a JPEG");
        // 8 m of 17 at 500 texels and a margin: 3.4 cm a texel along the ground, a little more on slopes.
        let finest = 8.0 / 17.0 * 500.0;
        let texel = 8.0 / f64::from(image.width()) * finest / (finest + 4.0);
        assert!(image.width() <= 241 && image.height() <= 241, "{} × {}", image.width(), image.height());
        assert!(texel <= f64::from(level.error).max(0.035), "{texel} for an error of {}", level.error);
    }
    let first = levels.first().expect("levels");
    let last = levels.last().expect("levels");
    assert!(last.glb.len() * 8 < first.glb.len(), "{} and {}", first.glb.len(), last.glb.len());
}

#[test]
fn repeated_textures_stay_whole_and_are_transformed() {
    let mut content = hills(16, 0.0);
    content.iter_mut().for_each(|t| t.uv = t.uv.map(|uv| uv * 10.0 - 3.0));
    let levels = made(&content, &painted(), 0);
    let (json, _) = chunks(&levels[0].glb);
    let transform =
        &json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"]["KHR_texture_transform"];
    let scale = transform["scale"][0].as_f64().expect("a scale");
    assert!((scale - 80.0 / 17.0).abs() < 1e-3, "{transform}");
    assert_eq!(
        json["samplers"][json["textures"][0]["sampler"].as_u64().expect("a sampler") as usize],
        serde_json::json!({})
    );
}

#[test]
fn bytes_are_the_same_each_time() {
    let (content, materials) = (hills(64, 1.0), painted());
    assert_eq!(made(&content, &materials, 0), made(&content, &materials, 0));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn brackets_hold_for_random_triangles(
        points in prop::collection::vec(prop::array::uniform3(0.0..8.0f64), 9..40), split in 1..3usize,
    ) {
        let points: Vec<DVec3> = points.into_iter().map(DVec3::from_array).collect();
        let all: Vec<[DVec3; 3]> = points.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        let (a, b) = all.split_at(split);
        let (one, other) = (Nearest::over(a.to_vec()), Nearest::over(b.to_vec()));
        let bracket = distance::error(
            &Surface { tree: &one, wholes: None }, &Surface { tree: &other, wholes: None }, 1e-3,
        ).expect("triangles");
        let found = sampled(a, b, 20).max(sampled(b, a, 20));
        prop_assert!(found <= bracket.upper + 1e-9 && bracket.upper <= bracket.lower * 1.05 + 2e-3);
        // Samples lie at most 1/20 of the longest edge, 14 m, apart.
        prop_assert!(bracket.lower <= found + 0.7);
        // The tree finds what looking at each finds.
        for point in points {
            let found = one.search(point, 0, &mut u64::MAX.clone(), |_| false);
            let least = a.iter().map(|t| (closest(t, point) - point).length_squared()).fold(f64::INFINITY, f64::min);
            prop_assert!(found.is_nearest && found.square == least);
        }
    }
}
