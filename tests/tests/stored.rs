//! What a stored world has to show, small: `stored` prints the figures at size.

use foresight_index::orthoview::direction::nine;
use foresight_tests::stored::headline::{self, required::required};
use foresight_tests::stored::linear::slope;
use foresight_tests::stored::scene::Scene;
use foresight_tests::stored::sizes::{Sizes, With};
use foresight_tests::stored::{codec, connectivity, correct, linear, storage};
use glam::DVec3;

fn city(blocks: u32, leaf: f64, pixels: f64) -> Scene {
    Scene::open(&format!("city:blocks={blocks}"), leaf, pixels).expect("a city")
}

#[test]
fn leaves_agree_with_rays_and_parents_with_their_cells() {
    let mut scenes = vec![city(2, 100.0, 48.0)];
    if let Some(data) = foresight_tests::data() {
        let mars = data.join("scenes/mars_dingo_gap_3dtiles/tileset.json");
        scenes.push(Scene::open(&mars.to_string_lossy(), 32.0, 48.0).expect("the recorded tileset"));
    }
    for scene in &scenes {
        let mut total = correct::Truth::default();
        for cell in scene.leaves().into_iter().take(3) {
            let truth = correct::leaf(scene, cell, &scene.directions).expect("readable");
            total.pixels += truth.pixels;
            total.within += truth.within;
        }
        assert!(total.pixels > 5000, "{}: {total:?}", scene.name);
        assert!(total.share() >= 0.999, "{}: {total:?}", scene.name);
    }
    let plan = correct::Plan { leaves: 1, parents: 1, level_max: 1, directions: nine()[..3].to_vec(), seed: 1 };
    let findings = correct::findings(&scenes[0], &plan).expect("readable");
    let parents = &findings.tables[1];
    assert!(parents.numbers("composited : direct, dB").iter().all(|db| *db > 20.0), "{}", parents.text());
    assert!(parents.numbers("shown by both, %").iter().all(|share| *share > 95.0), "{}", parents.text());
    // Averages up the tree are no worse than a fixed number of samples, against many.
    assert_eq!(findings.pictures.len(), 3);
}

#[test]
fn walls_and_spheres_are_connected_foliage_and_steps_are_not() {
    for case in connectivity::cases() {
        let (view, links) = connectivity::drawn(&case).expect("something to see");
        let share = connectivity::share(&view, &links);
        let [least, most] = case.expected;
        assert!((least..=most).contains(&share), "{}: {share}", case.name);
        assert_eq!(connectivity::bridges(&view, &links, 2.0), 0, "{}", case.name);
    }
}

#[test]
fn the_default_codecs_are_smaller_than_the_papers() {
    let scene = city(1, 100.0, 96.0);
    let samples = codec::samples(&scene, 4).expect("readable");
    let findings = codec::findings(&scene.name, &samples).expect("something to code");
    assert_eq!(findings.tables.len(), 3);
    assert!(findings.tables.iter().all(|table| !table.is_empty()));
    let plot = findings.plots[0].svg().expect("drawable");
    assert!(plot.starts_with("<svg") && plot.contains("polyline"), "{}", &plot[..200.min(plot.len())]);
    let stored = storage::stored(&scene).expect("codable");
    assert!(stored.without_normals < stored.bytes && stored.bytes > 1000, "{stored:?}");
}

#[test]
fn building_grows_with_the_leaves() {
    let rows: Vec<linear::Built> =
        [2, 4].map(|blocks| linear::built(&city(blocks, 100.0, 24.0)).expect("codable")).into();
    assert!(rows[1].leaves >= 4 * rows[0].leaves && rows[1].levels == rows[0].levels + 1, "{rows:?}");
    let bytes: Vec<(f64, f64)> = rows.iter().map(|row| (row.leaves as f64, row.bytes as f64)).collect();
    assert!((0.85..1.2).contains(&slope(&bytes)), "{bytes:?}");
    assert!(rows[1].image_peak < 3 * rows[0].image_peak, "{rows:?}");
    // The slope of a power is its exponent.
    let cubes: Vec<(f64, f64)> = (1..9).map(|k| (f64::from(k), 7.0 * f64::from(k * k * k))).collect();
    assert!((slope(&cubes) - 3.0).abs() < 1e-12);
}

#[test]
fn cells_grow_by_a_constant_per_doubling_and_bandwidth_does_not_grow() {
    let sizes = Sizes::measured(&city(4, 200.0, 32.0)).expect("one layer");
    let allowed = 200.0 / 32.0 / 200.0;
    let cells = |side: f64| {
        let tree = sizes.catalogue(side, 1, With::Orthoviews).expect("small");
        // Nothing that is required overlaps, and all of the world is shown.
        let shown = required(&tree, DVec3::new(3.0, 7.0, 2.0), allowed);
        let area: f64 = shown.iter().map(|s| 4.0 * tree.half(s.node).x * tree.half(s.node).y).sum();
        let whole = 4.0 * tree.half(tree.root()).x * tree.half(tree.root()).y;
        assert!((area / whole - 1.0).abs() < 1e-6, "{area} of {whole}");
        shown.len() as f64
    };
    let counts = [3200.0, 6400.0, 12_800.0, 25_600.0].map(cells);
    let steps = [counts[1] - counts[0], counts[2] - counts[1], counts[3] - counts[2]];
    assert!(steps.iter().all(|step| *step <= 40.0), "{counts:?}");
    let plan =
        headline::Plan { areas: vec![1.0, 16.0], trips: 4, seconds: 12.0, table: (12.0, 1), broadband: 50.0, seed: 1 };
    let findings = headline::findings(&sizes, &plan).expect("replayable");
    let growth = &findings.tables[1];
    let rates = growth.numbers("orthoviews, Mbit/s");
    assert!(rates.iter().all(|rate| rate.is_finite()) && rates[1] < 20.0 * rates[0].max(1e-3), "{}", growth.text());
    assert_eq!(findings.plots.len(), 4);
    for plot in &findings.plots {
        plot.svg().expect("drawable");
    }
}
