use std::collections::BTreeMap;
use std::sync::Arc;

use foresight_scheduler::lod_tree::Aabb;
use glam::{DVec2, DVec3};
use proptest::prelude::*;

use super::*;
use crate::orthoview::raster::Triangle;
use crate::surface::Piece;
use crate::surface::overlap::meets;
use crate::world::Georeference;

/// Pieces that are there.
#[derive(Debug)]
struct Given(Vec<Piece>);

impl SurfaceSource for Given {
    fn pieces(&self) -> usize {
        self.0.len()
    }

    fn declared(&self, _: usize) -> Option<Aabb> {
        None
    }

    fn name(&self, _: usize) -> &str {
        "given"
    }

    fn read(&self, piece: usize) -> Result<Piece, ContentError> {
        Ok(self.0[piece].clone())
    }

    fn up(&self) -> DVec3 {
        DVec3::Z
    }

    fn georeference(&self) -> Option<Georeference> {
        None
    }

    fn identity(&self) -> Result<[u8; 32], ContentError> {
        Ok([7; 32])
    }
}

fn triangle(corners: [[f64; 3]; 3]) -> Triangle {
    Triangle { corners: corners.map(DVec3::from_array), ..Triangle::default() }
}

fn png(colour: [u8; 3]) -> Arc<[u8]> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let pixels = image::RgbImage::from_pixel(2, 2, image::Rgb(colour));
    pixels.write_to(&mut bytes, image::ImageFormat::Png).expect("into memory");
    bytes.into_inner().into()
}

fn settings(leaf_side: f64) -> SpoolSettings {
    SpoolSettings { leaf_side, memory: 1, keep_strays: false }
}

fn filled(source: &Given, settings: &SpoolSettings) -> (tempfile::TempDir, Result<Spool, SpoolError>) {
    let folder = tempfile::tempdir().expect("a folder");
    let spool = Spool::fill(source, folder.path(), settings, &|_, _| {});
    (folder, spool)
}

/// A floor of n × n cells of a metre, two triangles each, at a height.
fn floor(n: usize, height: f64) -> Vec<Triangle> {
    let cell = |x: f64, y: f64| {
        let at = |i: f64, j: f64| [x + i, y + j, height];
        [triangle([at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0)]), triangle([at(0.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)])]
    };
    (0..n * n).flat_map(|at| cell((at % n) as f64, (at / n) as f64)).collect()
}

fn piece(triangles: Vec<Triangle>) -> Piece {
    Piece { triangles, ..Piece::default() }
}

fn arbitrary() -> impl Strategy<Value = Given> {
    let number = || (0..400i32).prop_map(|v| f64::from(v) * 0.37);
    let corner = move || prop::array::uniform3(number());
    let one =
        (prop::array::uniform3(corner()), prop::array::uniform3(prop::array::uniform3(0..3u8)), 0..3u32, any::<bool>());
    let triangles = prop::collection::vec(one, 0..20);
    prop::collection::vec(triangles, 1..5).prop_map(|pieces| {
        let image = |at: usize| Some(png([at as u8 * 20, 9, 9]));
        Given(
            pieces
                .into_iter()
                .enumerate()
                .map(|(at, given)| {
                    let triangles = given.into_iter().map(|(corners, tint, material, two_sided)| Triangle {
                        tint: tint.map(|corner| corner.map(|v| if v == 0 { 255 } else { v * 100 })),
                        uv: [DVec2::new(f64::from(tint[0][0]), 0.5), DVec2::ZERO, DVec2::ONE],
                        material,
                        two_sided,
                        ..triangle(corners)
                    });
                    let textured = Material { texture: Some(0), cutoff: 0.25, ..Material::default() };
                    let other = Material { base: [0.5, 0.25, 1.0], texture: Some(1), cutoff: 0.0 };
                    // The first image is the same for all.
                    let images = vec![image(9), image(at)];
                    Piece {
                        triangles: triangles.collect(),
                        materials: vec![textured, other],
                        images,
                        ..Piece::default()
                    }
                })
                .collect(),
        )
    })
}

/// A triangle with what it looks like at its first corner.
fn shown(triangle: &Triangle, surfaces: &Surfaces) -> String {
    use crate::orthoview::raster::Surface;
    let colour = surfaces.materials.colour(triangle.material, triangle.uv[0], 0.0);
    format!("{:?} {:?} {:?} {} {colour:?}", triangle.corners, triangle.uv, triangle.tint, triangle.two_sided)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn a_leaf_has_the_triangles_that_meet_it_in_their_order(source in arbitrary(), side in 20.0..90.0f64, memory in 1..9000usize) {
        let settings = SpoolSettings { leaf_side: side, memory, keep_strays: false };
        let (folder, spool) = filled(&source, &settings);
        let all: Vec<Surfaces> = source.0.iter().map(|piece| piece.clone().decoded()).collect();
        let sound = |t: &&Triangle| {
            let [a, b, c] = t.corners;
            (b - a).cross(c - a).length() > 1e-9
        };
        let count = all.iter().flat_map(|s| s.triangles.iter().filter(sound)).count() as u64;
        if count == 0 {
            let is_empty = matches!(spool, Err(SpoolError::Empty { .. }));
            prop_assert!(is_empty);
            return Ok(());
        }
        let spool = spool.expect("something is there");
        prop_assert_eq!(spool.statistics().triangles, count);
        let octree = *spool.octree();
        let [nx, ny, nz] = octree.cells_at(0);
        let mut placed = 0;
        let mut occupied = Vec::new();
        for place in (0..nx).flat_map(|x| (0..ny).flat_map(move |y| (0..nz).map(move |z| [x, y, z]))) {
            let cell = Cell { level: 0, place };
            let bounds = octree.bounds(cell);
            let slack = 1e-6 * side;
            let bounds = Aabb { min: bounds.min - slack, max: bounds.max + slack };
            let expected: Vec<String> = all.iter()
                .flat_map(|s| s.triangles.iter().filter(sound).filter(|t| meets(&t.corners, &bounds)).map(|t| shown(t, s)))
                .collect();
            let leaf = spool.leaf(place).expect("readable");
            let found: Vec<String> = leaf.triangles.iter().map(|t| shown(t, &leaf)).collect();
            prop_assert_eq!(&found, &expected);
            prop_assert_eq!(spool.is_occupied(cell), !expected.is_empty());
            prop_assert_eq!(spool.triangles(cell), expected.len() as u64);
            placed += expected.len() as u64;
            if !expected.is_empty() {
                occupied.push(place);
            }
        }
        let mut leaves: Vec<_> = spool.leaves().collect();
        leaves.sort_unstable();
        prop_assert_eq!(leaves, occupied);
        prop_assert_eq!((spool.statistics().placed, spool.triangles(octree.root())), (placed, placed));
        let area: f64 = spool.statistics().orientations.iter().map(|(_, area)| area).sum();
        prop_assert!((area / spool.statistics().area - 1.0).abs() < 1e-9);
        // What was written is opened.
        let again = Spool::open(folder.path(), [7; 32], &settings).expect("readable").expect("finished");
        prop_assert_eq!(&again.index, &spool.index);
    }
}

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    let pieces = (0..40).map(|at| piece(floor(20, f64::from(at)))).collect();
    let source = Given(pieces);
    let bytes = |threads: usize, memory: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let settings = SpoolSettings { leaf_side: 3.0, memory, keep_strays: false };
        let (folder, spool) = pool.install(|| filled(&source, &settings));
        spool.expect("a floor");
        ["triangles", "images", "index"]
            .map(|name| blake3::hash(&std::fs::read(folder.path().join(name)).expect("there")))
    };
    assert_eq!(bytes(1, 1 << 20), bytes(3, 1 << 20));
    assert_ne!(bytes(1, 1 << 20)[0], bytes(1, 1 << 28)[0], "less memory makes more blocks");
}

#[test]
fn an_unfinished_or_foreign_spool_is_recognised() {
    let source = Given(vec![piece(floor(8, 0.0))]);
    let settings = settings(4.0);
    let (folder, spool) = filled(&source, &settings);
    drop(spool);
    let open = |identity: [u8; 32], settings: &SpoolSettings| {
        Spool::open(folder.path(), identity, settings).expect("readable")
    };
    assert!(open([7; 32], &settings).is_some());
    assert!(open([8; 32], &settings).is_none(), "another source");
    assert!(open([7; 32], &SpoolSettings { leaf_side: 5.0, ..settings }).is_none(), "other leaves");
    let (index, triangles) = (folder.path().join("index"), folder.path().join("triangles"));
    let whole = std::fs::read(&index).expect("there");
    for at in [0, 9, 60, whole.len() / 2, whole.len() - 1] {
        let mut changed = whole.clone();
        changed[at] ^= 1;
        std::fs::write(&index, &changed).expect("written");
        assert!(open([7; 32], &settings).is_none(), "byte {at} changed");
        std::fs::write(&index, &whole[..at]).expect("written");
        assert!(open([7; 32], &settings).is_none(), "cut off at {at}");
    }
    std::fs::write(&index, &whole).expect("written");
    let rest = std::fs::read(&triangles).expect("there");
    std::fs::write(&triangles, &rest[..rest.len() - 1]).expect("written");
    assert!(open([7; 32], &settings).is_none(), "triangles cut off");
    std::fs::write(&triangles, &rest).expect("written");
    assert!(open([7; 32], &settings).is_some());
    // Filling begins by taking the index away: a fill that is cut off leaves nothing that looks whole.
    super::Index::remove(folder.path()).expect("removed");
    assert!(open([7; 32], &settings).is_none());
    assert!(Spool::open(&folder.path().join("absent"), [7; 32], &settings).expect("absent").is_none());
}

#[test]
fn what_cannot_be_drawn_is_dropped_and_counted() {
    let mut triangles = floor(10, 1.0);
    let nan = triangle([[f64::NAN, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    let infinite = triangle([[f64::INFINITY, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    let line = triangle([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]]);
    let point = triangle([[3.0; 3]; 3]);
    // A third triangle on an edge of the floor.
    let fin = triangle([[0.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.5, 0.5, 2.0]]);
    triangles.extend([nan, infinite, line, point, fin]);
    let (_folder, spool) = filled(&Given(vec![piece(triangles)]), &settings(4.0));
    let statistics = spool.expect("a floor").statistics().clone();
    let expected = Repairs { not_finite: 2, degenerate: 2, strays: 0, non_manifold_edges: 1 };
    assert_eq!((statistics.triangles, statistics.repairs), (201, expected));
    assert_eq!(statistics.bounds, Aabb { min: DVec3::new(0.0, 0.0, 1.0), max: DVec3::new(10.0, 10.0, 2.0) });
}

#[test]
fn a_handful_of_triangles_far_away_does_not_blow_up_the_bounds() {
    let mut triangles = floor(30, 0.0);
    for (at, far) in [1e6, -1e6, 3e8, 1e100].into_iter().enumerate() {
        let size = 0.001 * far;
        triangles.push(triangle([[far, at as f64, 0.0], [far, size, 0.0], [far + size, 0.0, 1.0]]));
    }
    // A spike: one corner astray.
    triangles.push(triangle([[1.0, 1.0, 0.0], [2.0, 1.0, 0.0], [1.5, 1.0, 1e6]]));
    let source = Given(vec![piece(triangles.clone()), piece(floor(30, 5.0))]);
    let (_folder, spool) = filled(&source, &settings(8.0));
    let spool = spool.expect("floors");
    let statistics = spool.statistics();
    assert_eq!((statistics.repairs.strays, statistics.triangles), (5, 3600));
    assert_eq!(statistics.bounds, Aabb { min: DVec3::ZERO, max: DVec3::new(30.0, 30.0, 5.0) });
    assert!(statistics.left_out.iter().any(|text| text.contains("5 triangles further than")), "{statistics:?}");
    let leaf = spool.leaf([0, 0, 0]).expect("readable");
    assert!(leaf.triangles.iter().flat_map(|t| t.corners).all(|c| c.abs().max_element() <= 30.0));
    let (_folder, spool) = filled(&source, &SpoolSettings { keep_strays: true, ..settings(1e95) });
    assert_eq!(spool.expect("kept").statistics().triangles, 3605);
}

#[test]
fn what_is_large_or_sparse_is_no_stray() {
    // A statue of 2 m on a ground of 400 m, and two villages with nothing between.
    let scaled = |n: usize, scale: f64, at: DVec3| {
        let mut triangles = floor(n, 0.0);
        triangles.iter_mut().for_each(|t| t.corners = t.corners.map(|c| c * scale + at));
        triangles
    };
    let statue = scaled(200, 0.01, DVec3::new(-1.0, -1.0, 0.0));
    let ground = scaled(1, 400.0, DVec3::new(-200.0, -200.0, -1.0));
    let villages = [scaled(10, 1.0, DVec3::ZERO), scaled(10, 1.0, DVec3::new(1e5, 0.0, 0.0))].concat();
    for (triangles, side) in [([statue, ground].concat(), 10.0), (villages, 100.0)] {
        let count = triangles.len() as u64;
        let (_folder, spool) = filled(&Given(vec![piece(triangles)]), &settings(side));
        let statistics = spool.expect("a scene").statistics().clone();
        assert_eq!((statistics.triangles, statistics.repairs.strays), (count, 0), "{statistics:?}");
    }
}

#[test]
fn nothing_to_draw_is_an_error_that_says_so() {
    let nan = triangle([[f64::NAN; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    for pieces in [vec![], vec![piece(vec![])], vec![piece(vec![nan])]] {
        let (folder, spool) = filled(&Given(pieces), &settings(1.0));
        let message = spool.err().expect("nothing").to_string();
        assert!(message.contains("no triangle that can be drawn"), "{message}");
        assert!(!folder.path().join("index").exists());
    }
}

#[test]
fn leaves_far_too_small_are_refused_by_name() {
    let ground = triangle([[0.0; 3], [1e5, 0.0, 0.0], [0.0, 1e5, 0.0]]);
    let (_folder, spool) = filled(&Given(vec![piece(vec![ground])]), &settings(1.0));
    let message = spool.err().expect("too many leaves").to_string();
    assert!(message.contains("given: a triangle from") && message.contains("expected larger leaves"), "{message}");
}

#[test]
fn images_are_kept_once_and_what_is_none_is_said() {
    let with = |images: Vec<Option<Arc<[u8]>>>| {
        let textured = Material { texture: Some(0), base: [0.25, 0.5, 0.75], ..Material::default() };
        Piece {
            triangles: floor(3, 0.0),
            materials: vec![textured],
            images,
            left_out: vec!["said".to_owned()],
            ..Piece::default()
        }
    };
    let broken: Arc<[u8]> = png([1, 2, 3])[..40].into();
    let source = Given(vec![
        with(vec![Some(png([9, 9, 9]))]),
        with(vec![Some(png([9, 9, 9]))]),
        with(vec![Some(b"\xABKTX 20\xBB"[..].into())]),
        with(vec![None]),
        with(vec![Some(broken)]),
    ]);
    let (folder, spool) = filled(&source, &settings(10.0));
    let spool = spool.expect("floors");
    let stored = (png([9, 9, 9]).len() + 40) as u64;
    assert_eq!(std::fs::metadata(folder.path().join("images")).expect("there").len(), stored);
    let mut said: BTreeMap<bool, Vec<&String>> = BTreeMap::new();
    spool.statistics().left_out.iter().for_each(|text| said.entry(text.starts_with("said")).or_default().push(text));
    assert_eq!(said[&true], ["said (5 times)"]);
    assert!(said[&false][0].contains("no PNG, JPEG or WebP"), "{said:?}");
    let leaf = spool.leaf([0, 0, 0]).expect("readable");
    // The image that is there, the broken one, and the base colour of the others.
    assert_eq!((leaf.materials.materials.len(), leaf.left_out.len()), (3, 1));
    assert_eq!(leaf.triangles.len(), 5 * 18);
}
