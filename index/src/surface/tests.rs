//! Whole sources through the spool: generated worlds, real data, and what a world far larger than memory takes.

use std::path::PathBuf;
use std::sync::Arc;

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;

use super::spool::{Spool, SpoolError, SpoolSettings};
use super::{SurfaceSource, open};
use crate::specification::Progress;
use crate::world::Georeference;

fn opened(input: &str) -> Box<dyn SurfaceSource> {
    let progress: Progress = Arc::new(|_, _| {});
    open(input, &progress).unwrap_or_else(|error| panic!("{input}: {error}"))
}

fn refused(input: &str) -> String {
    let progress: Progress = Arc::new(|_, _| {});
    open(input, &progress).err().map(|error| error.to_string()).unwrap_or_default()
}

fn spooled(source: &dyn SurfaceSource, leaf_side: f64) -> (tempfile::TempDir, Spool) {
    let folder = tempfile::tempdir().expect("a folder");
    let settings = SpoolSettings { leaf_side, ..SpoolSettings::default() };
    let spool = Spool::fill(source, folder.path(), &settings, &|_, _| {}).expect("surfaces");
    (folder, spool)
}

/// The area of a source by its statistics, and the number of its triangles in the leaves.
fn area_above(spool: &Spool, least: f64) -> f64 {
    spool.statistics().orientations.iter().filter(|(normal, _)| normal.z > least).map(|(_, area)| area).sum()
}

#[cfg(all(feature = "textures", feature = "terrain", feature = "asteroids"))]
#[test]
fn generated_worlds_have_surfaces() {
    let city = opened("city:blocks=3");
    assert_eq!(city.pieces(), 9);
    let (_folder, spool) = spooled(&*city, 64.0);
    let statistics = spool.statistics();
    let declared = (0..9).filter_map(|piece| city.declared(piece)).fold(Aabb::EMPTY, Aabb::union);
    // The ground's skirt of 0.2 m is not made.
    assert!((statistics.bounds.max - declared.max).abs().max_element() < 1e-6, "{statistics:?}");
    // Grounds, and roofs above them.
    let side = declared.max.x - declared.min.x;
    assert!(area_above(&spool, 0.999) > side * side && statistics.image_bytes > 100_000, "{statistics:?}");
    let textured: usize = spool
        .leaves()
        .map(|place| spool.leaf(place).expect("readable").materials.textures.iter().filter(|t| t.is_some()).count())
        .sum();
    assert!(textured > 9, "{textured}");
    assert_ne!(city.identity().expect("parameters"), opened("city:blocks=3,seed=2").identity().expect("parameters"));

    let terrain = opened("terrain:size=10km,resolution=20m,relief=900");
    let (_folder, spool) = spooled(&*terrain, 640.0);
    let side = 20.0 * 64.0 * 8.0;
    assert_eq!(spool.statistics().triangles, 2 * (8 * 64 * 8 * 64));
    let flat: f64 = spool.statistics().orientations.iter().map(|(normal, area)| normal.z * area).sum();
    assert!((flat / (side * side) - 1.0).abs() < 0.05, "{flat}");

    let asteroids = opened("asteroids:count=60,triangles=300");
    let (_folder, spool) = spooled(&*asteroids, 64.0);
    assert!(spool.statistics().triangles >= 60 * 250 && spool.statistics().repairs == Default::default());
    // Closed surfaces face everywhere alike.
    let sum: DVec3 = spool.statistics().orientations.iter().map(|(normal, area)| *normal * *area).sum();
    assert!(sum.length() < 1e-3 * spool.statistics().area, "{sum}");
}

#[cfg(feature = "textures")]
#[test]
fn documents_of_generated_worlds_name_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("city");
    let params = crate::generate::city::CityParams { blocks_x: 2, blocks_y: 2, ..Default::default() };
    crate::generate::document::write(&params, &out).expect("written");
    let source = opened(out.to_str().expect("UTF-8"));
    assert_eq!(source.identity().expect("parameters"), opened("city:blocks=2").identity().expect("parameters"));
}

#[cfg(all(feature = "textures", feature = "city"))]
#[test]
fn a_written_city_is_read_as_it_was_made() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("city");
    let params = crate::generate::city::CityParams { blocks_x: 2, blocks_y: 2, ..Default::default() };
    crate::generate::city::geometry::write(&params, &out, &mut |_, _| {}).expect("written");
    let [tileset, made] = [opened(out.to_str().expect("UTF-8")), opened("city:blocks=2")];
    let [(_a, tileset), (_b, made)] = [spooled(&*tileset, 64.0), spooled(&*made, 64.0)];
    let [a, b] = [tileset.statistics(), made.statistics()];
    assert_eq!((a.triangles, a.repairs), (b.triangles, b.repairs));
    assert!((a.area / b.area - 1.0).abs() < 1e-5, "{} {}", a.area, b.area);
    assert!((a.bounds.min - b.bounds.min).abs().max_element() < 1e-3, "{:?} {:?}", a.bounds, b.bounds);
}

#[test]
fn inputs_are_recognised_by_their_content() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = |name: &str, text: &str| {
        let file = folder.path().join(name);
        std::fs::write(&file, text).expect("written");
        file.to_str().expect("UTF-8").to_owned()
    };
    let obj = file("mesh.txt", "# a triangle\n\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    assert_eq!(opened(&obj).pieces(), 1);
    let turned = opened(&format!("{obj},up=y"));
    assert_eq!(turned.load(0).expect("readable").triangles[0].corners[2], DVec3::Z);
    assert_ne!(turned.identity().expect("readable"), opened(&obj).identity().expect("readable"));
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
        element face 1\nproperty list uchar int vertex_index\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    assert_eq!(opened(&file("mesh.obj", ply)).load(0).expect("readable").triangles.len(), 1);
    for (text, part) in [
        ("", "nothing in it; expected GLB, glTF, OBJ, PLY"),
        ("hello", "it begins with \"hello\""),
        ("{\"asset\": {\"version\": \"2.0\"}, \"scenes\": []}", "no triangles"),
        ("{\"asset\": {\"version\": \"1.0\"}, \"meshes\": []}", "$.asset.version"),
    ] {
        let message = refused(&file("some", text));
        assert!(message.contains(part), "{text:?}: {message}");
    }
    assert!(refused(folder.path().to_str().expect("UTF-8")).contains("a folder with none of tileset.json"));
    assert!(refused("absent.glb").contains("absent.glb"));
    assert!(refused("city:blocks=0").contains("blocks_x is 0"));
}

/// A part of the shared data, or `None` (said, and a failure under CI) where it is absent.
fn data(part: &str) -> Option<String> {
    let beside = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data"));
    let path = std::env::var_os("FORESIGHT_DATA").map_or(beside, PathBuf::from).join(part);
    if path.exists() {
        return path.to_str().map(str::to_owned);
    }
    assert!(std::env::var_os("CI").is_none(), "{} is absent", path.display());
    println!("skipped: {} is absent", path.display());
    None
}

#[test]
fn dingo_gap() {
    let Some(path) = data("scenes/mars_dingo_gap_3dtiles") else { return };
    let source = opened(&path);
    assert_eq!((source.pieces(), source.up(), source.georeference()), (220, DVec3::Y, None));
    let (_folder, spool) = spooled(&*source, 16.0);
    let statistics = spool.statistics();
    println!("{} triangles, {:.0} m², {:?}", statistics.triangles, statistics.area, statistics.repairs);
    let up: f64 = statistics.orientations.iter().filter(|(normal, _)| normal.y > 0.5).map(|(_, area)| area).sum();
    assert!(up > 0.8 * statistics.area, "{up} of {}", statistics.area);
    // About 10 m in a content, whatever the declared boxes say.
    let height = |piece: usize| {
        let bounds = source.load(piece).expect("readable").bounds();
        (bounds.max - bounds.min).y
    };
    let mean = (0..220).map(height).sum::<f64>() / 220.0;
    assert!((5.0..15.0).contains(&mean), "{mean}");
}

#[cfg(feature = "cityjson")]
#[test]
fn zurich() {
    let Some(path) = data("scenes/zurich_subset_lod2.city.json") else { return };
    let source = opened(&path);
    assert_eq!(source.georeference(), Some(Georeference::Epsg(2056)));
    let (_folder, spool) = spooled(&*source, 64.0);
    let statistics = spool.statistics();
    println!(
        "{} triangles, {:.0} m², {:?}, {:?}",
        statistics.triangles, statistics.area, statistics.repairs, statistics.bounds
    );
    let colours: std::collections::BTreeSet<String> = spool
        .leaves()
        .flat_map(|place| spool.leaf(place).expect("readable").materials.materials)
        .map(|material| format!("{:?}", material.base))
        .collect();
    assert!(colours.len() >= 3, "roofs, walls and what is beneath: {colours:?}");
}

/// Largest resident set of this process so far, bytes.
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    Some(line.split_ascii_whitespace().nth(1)?.parse::<u64>().ok()? * 1024)
}

/// Prints the time on cores and the peak of memory for a generated world of 50 million triangles. Alone in its process: the
/// figures are the process's.
#[cfg(feature = "terrain")]
#[test]
fn a_world_far_larger_than_memory() {
    if std::env::var_os("FORESIGHT_FULL").is_none_or(|value| value != "1") {
        println!("skipped: needs tests/run --full");
        return;
    }
    let source = opened("terrain:size=50km,resolution=10m");
    let folder = tempfile::tempdir().expect("a folder");
    let settings = SpoolSettings { leaf_side: 250.0, memory: 64 << 20, ..SpoolSettings::default() };
    let start = processor_seconds("self");
    let spool = Spool::fill(&*source, folder.path(), &settings, &|_, _| {}).expect("surfaces");
    let seconds = processor_seconds("self") - start;
    let statistics = spool.statistics();
    let peak = peak_memory().unwrap_or(0);
    println!(
        "{} triangles, {} in {} leaves, {:.2} GB on disk, {seconds:.0} s on cores: {:.2} million triangles a second and core, peak memory {:.0} MB",
        statistics.triangles,
        statistics.placed,
        spool.leaves().count(),
        statistics.triangle_bytes as f64 / 1e9,
        statistics.triangles as f64 / seconds / 1e6,
        peak as f64 / 1e6
    );
    assert!(statistics.triangles >= 50_000_000, "{}", statistics.triangles);
    // A seventh of what the triangles are on disk, on two cores.
    assert!(peak < 1 << 30, "{peak} bytes");
    drop(spool);
}

/// A landscape of 2 n² triangles in each format: name of the file, and its bytes.
fn landscapes(n: u32) -> Vec<(&'static str, Vec<u8>)> {
    use std::io::Write;
    let side = n + 1;
    let place = |at: u32| {
        let (x, y) = (f64::from(at % side), f64::from(at / side));
        DVec3::new(x, y, 20.0 * libm::sin(x / 50.0) * libm::cos(y / 70.0))
    };
    let places: Vec<DVec3> = (0..side * side).map(place).collect();
    let cell = |at: u32| {
        let first = at / n * side + at % n;
        [[first, first + 1, first + side + 1], [first, first + side + 1, first + side]]
    };
    let triangles: Vec<[u32; 3]> = (0..n * n).flat_map(cell).collect();
    let positions = crate::format::glb::narrowed(&places);
    let (mut obj, mut text) = (Vec::new(), Vec::new());
    let header = |format: &str| {
        let (v, f) = (places.len(), triangles.len());
        format!(
            "ply\nformat {format} 1.0\nelement vertex {v}\nproperty float x\nproperty float y\nproperty float z\n\
             element face {f}\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    write!(text, "{}", header("ascii")).expect("into memory");
    let mut binary = header("binary_little_endian").into_bytes();
    for [x, y, z] in &positions {
        writeln!(obj, "v {x} {y} {z}").expect("into memory");
        writeln!(text, "{x} {y} {z}").expect("into memory");
        binary.extend([x, y, z].into_iter().flat_map(|value| value.to_le_bytes()));
    }
    for [a, b, c] in &triangles {
        writeln!(obj, "f {} {} {}", a + 1, b + 1, c + 1).expect("into memory");
        writeln!(text, "3 {a} {b} {c}").expect("into memory");
        binary.push(3);
        binary.extend([a, b, c].into_iter().flat_map(|index| index.to_le_bytes()));
    }
    let mesh = crate::format::glb::Mesh { origin: None, positions: &positions, normals: &[], triangles: &triangles };
    vec![
        ("landscape.glb", crate::format::glb::encode(&mesh)),
        ("landscape.obj", obj),
        ("text.ply", text),
        ("binary.ply", binary),
    ]
}

/// Seconds that a process or thread has had a core, to 10 ms; 0 where the system does not tell.
fn processor_seconds(of: &str) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{of}/stat")).unwrap_or_default();
    let fields = stat.rsplit_once(')').map_or("", |(_, rest)| rest).split_ascii_whitespace();
    fields.skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// Prints how fast each format is read, by one thread, of the seconds that it has a core.
#[test]
fn every_format_holds_the_same_landscape() {
    let full = std::env::var_os("FORESIGHT_FULL").is_some_and(|value| value == "1");
    let n = if full { 2000 } else { 300 };
    let folder = tempfile::tempdir().expect("a folder");
    let mut areas = Vec::new();
    for (name, bytes) in landscapes(n) {
        let file = folder.path().join(name);
        std::fs::write(&file, &bytes).expect("written");
        let start = processor_seconds("thread-self");
        let source = opened(file.to_str().expect("UTF-8"));
        let count: usize = (0..source.pieces()).map(|at| source.triangles(at).expect("readable").len()).sum();
        let seconds = processor_seconds("thread-self") - start;
        assert_eq!(count, 2 * (n * n) as usize, "{name}");
        let (rate, mega) = (count as f64 / seconds / 1e6, bytes.len() as f64 / 1e6);
        println!("{name}: {mega:.0} MB, {rate:.2} million triangles a second");
        let (_folder, spool) = spooled(&*source, 100.0);
        areas.push(spool.statistics().area);
        assert_eq!(spool.statistics().repairs, Default::default(), "{name}");
    }
    assert!(areas.iter().all(|area| (area / areas[0] - 1.0).abs() < 1e-6), "{areas:?}");
}

#[test]
fn a_folder_that_cannot_be_written_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("file");
    std::fs::write(&file, "in the way").expect("written");
    let mesh = folder.path().join("a.obj");
    std::fs::write(&mesh, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").expect("written");
    let source = opened(mesh.to_str().expect("UTF-8"));
    let made = Spool::fill(&*source, &file, &SpoolSettings::default(), &|_, _| {});
    match made {
        Err(SpoolError::Io { file: named, .. }) => assert_eq!(named, file),
        other => panic!("{:?}", other.err()),
    }
}
