//! How building grows with the world: bytes, instructions, time and memory against leaf cells.

use std::path::Path;
use std::process::Command;

use foresight_index::format::orthoview::{Encoding, encode};
use foresight_index::orthoview::connectivity::{Thresholds, links};
use foresight_index::orthoview::{Direction, Orthoview};
use foresight_sim::stopwatch::Stopwatch;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::plot::{Curve, Plot, Scale};
use super::scene::Scene;
use super::table::Table;
use super::{Fault, Findings};

/// What building one world took.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Built {
    /// Occupied leaves.
    pub leaves: u64,
    /// Levels above them.
    pub levels: u32,
    /// Images.
    pub images: u64,
    /// Bytes of all files.
    pub bytes: u64,
    /// Triangles of the world.
    pub triangles: u64,
    /// Triangles drawn, a direction at a time.
    pub drawn: u64,
    /// Instructions, of all threads; 0 where they were not counted.
    pub instructions: u64,
    /// Wall time of building, seconds.
    pub seconds: f64,
    /// Of this, processor time, seconds.
    pub processor: f64,
    /// Most bytes of images at a time.
    pub image_peak: u64,
    /// Most resident memory while building beyond what was resident before, bytes.
    pub resident_peak: u64,
}

/// Builds all orthoviews of `scene` and encodes them; nothing is written.
///
/// # Errors
/// A content that cannot be read, an image that cannot be encoded.
pub fn built(scene: &Scene) -> Result<Built, Fault> {
    let mut built = Built { levels: scene.octree.root().level, triangles: scene.triangles, ..Built::default() };
    forget_peak();
    let (before, busy) = (status("VmRSS:"), processor());
    let watch = Stopwatch::start();
    let mut bytes = 0;
    let made = scene.orthoviews(&scene.directions, |_, images: &[(Direction, &Orthoview)]| {
        let sizes: Vec<u64> = images
            .par_iter()
            .map(|(direction, view)| {
                let links = links(view, &scene.lattice(*direction), &Thresholds::default());
                let file = encode(view, &links, *direction, Encoding::default());
                Ok(file.map_err(|e| Fault::new(&scene.name, e))?.map_or(0, |f| f.len() as u64))
            })
            .collect::<Result<_, Fault>>()?;
        bytes += sizes.iter().sum::<u64>();
        Ok(())
    })?;
    built.seconds = watch.nanos() as f64 / 1e9;
    built.processor = processor() - busy;
    built.leaves = made.leaves;
    built.images = made.images;
    built.drawn = made.drawn.triangles;
    built.image_peak = made.peak_bytes as u64;
    built.bytes = bytes;
    built.resident_peak = status("VmHWM:").saturating_sub(before);
    Ok(built)
}

/// Starts the peak of resident memory anew (Linux).
fn forget_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// A size in bytes from `/proc/self/status`; 0 where there is none.
fn status(key: &str) -> u64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find(|line| line.starts_with(key)).unwrap_or_default();
    line.split_whitespace().nth(1).and_then(|kb| kb.parse::<u64>().ok()).unwrap_or_default() * 1024
}

/// Processor time of this process, seconds, to 10 ms; 0 where it is not known.
fn processor() -> f64 {
    let text = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after = text.rsplit_once(')').map_or("", |(_, rest)| rest);
    let ticks = |at: usize| after.split_whitespace().nth(at).and_then(|t| t.parse::<f64>().ok()).unwrap_or_default();
    (ticks(11) + ticks(12)) / 100.0
}

/// What to measure.
pub struct Plan<'a> {
    /// Blocks along a side, growing.
    pub blocks: Vec<u32>,
    /// Further parameters of the city, as `key=value,…`.
    pub city: &'a str,
    /// Side of a leaf, metres, and its pixels.
    pub leaf: (f64, f64),
    /// This program, which is started anew for each world, as `program linear --one WORLD`.
    pub program: &'a Path,
    /// Count instructions too: under valgrind, which takes about 30 times as long.
    pub count: bool,
}

/// Measures each size in a process of its own.
///
/// # Errors
/// A process that does not start, or says no figures.
pub fn findings(plan: &Plan<'_>) -> Result<Findings, Fault> {
    let mut rows: Vec<Built> = Vec::new();
    for &blocks in &plan.blocks {
        let world = format!("city:blocks={blocks},{}", plan.city);
        let (side, pixels) = plan.leaf;
        let arguments =
            ["linear".into(), "--one".into(), world, format!("--leaf={side}"), format!("--pixels={pixels}")];
        let mut built: Built = run(Command::new(plan.program).args(&arguments))?.0;
        if plan.count {
            // What is left when the same is done without building: opening the world and starting.
            let mut bare = arguments.to_vec();
            bare.push("--unbuilt".to_owned());
            built.instructions = counted(plan.program, &arguments)?.saturating_sub(counted(plan.program, &bare)?);
        }
        rows.push(built);
    }
    Ok(report(&rows, plan.count))
}

fn run(command: &mut Command) -> Result<(Built, String), Fault> {
    let fault = |why: String| Fault::new("a build", why);
    let output = command.output().map_err(|e| fault(e.to_string()))?;
    let log = String::from_utf8_lossy(&output.stderr).into_owned();
    if !output.status.success() {
        return Err(fault(log));
    }
    Ok((serde_json::from_slice(&output.stdout).map_err(|e| fault(format!("{e}\n{log}")))?, log))
}

/// Instructions of all threads, by valgrind's `exp-bbv`, which counts blocks of straight code as they are executed.
fn counted(program: &Path, arguments: &[String]) -> Result<u64, Fault> {
    let mut command = Command::new("valgrind");
    command.args(["--tool=exp-bbv", "--instr-count-only=yes", "--bb-out-file=/dev/null", "--pc-out-file=/dev/null"]);
    let (_, log) = run(command.arg(program).args(arguments).env("RAYON_NUM_THREADS", "1"))?;
    let count = |line: &str| line.rsplit_once("Total instructions:")?.1.trim().parse::<u64>().ok();
    let total = log.lines().filter_map(count).sum();
    if total == 0 { Err(Fault::new("valgrind", format!("no instructions counted: {log}"))) } else { Ok(total) }
}

/// Least-squares slope of log y over log x; NaN of fewer than two points.
pub fn slope(points: &[(f64, f64)]) -> f64 {
    let logs: Vec<(f64, f64)> =
        points.iter().filter(|p| p.0 > 0.0 && p.1 > 0.0).map(|p| (libm::log(p.0), libm::log(p.1))).collect();
    let n = logs.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| logs.iter().map(of).sum::<f64>() / n;
    let (mx, my) = (mean(|p| p.0), mean(|p| p.1));
    let (mut xy, mut xx) = (0.0, 0.0);
    for (x, y) in &logs {
        xy += (x - mx) * (y - my);
        xx += (x - mx) * (x - mx);
    }
    xy / xx
}

fn report(rows: &[Built], counted: bool) -> Findings {
    let mut table = Table::new(
        "Building all orthoviews of a generated city, nine directions",
        &[
            "leaves",
            "levels above",
            "images",
            "MB",
            "instructions, G",
            "wall, s",
            "processor, s",
            "M triangles/s and core",
            "images held at most, MB",
            "memory beyond the index, MB",
        ],
    );
    for built in rows {
        table.row([
            json!(built.leaves),
            json!(built.levels),
            json!(built.images),
            json!(built.bytes as f64 / 1e6),
            json!(counted.then_some(built.instructions as f64 / 1e9)),
            json!(built.seconds),
            json!(built.processor),
            json!(built.drawn as f64 / 1e6 / built.processor.max(1e-2)),
            json!(built.image_peak as f64 / 1e6),
            json!(built.resident_peak as f64 / 1e6),
        ]);
    }
    let of =
        |value: fn(&Built) -> f64| -> Vec<(f64, f64)> { rows.iter().map(|b| (b.leaves as f64, value(b))).collect() };
    let mut slopes = Table::new(
        "Slopes of log y over log leaves (1 is linear; memory ought to grow with the depth)",
        &["of", "all sizes", "without the smallest", "the two largest"],
    );
    let figures: [(&str, Vec<(f64, f64)>); 4] = [
        ("bytes", of(|b| b.bytes as f64)),
        ("instructions", of(|b| b.instructions as f64)),
        ("wall time", of(|b| b.seconds)),
        ("images held at most", of(|b| b.image_peak as f64)),
    ];
    for (name, points) in &figures {
        let from = |first: usize| {
            let slope = slope(&points[first.min(points.len())..]);
            json!(slope.is_finite().then_some(slope))
        };
        slopes.row([json!(name), from(0), from(1), from(points.len().saturating_sub(2))]);
    }
    let curve = |name: &str, points: Vec<(f64, f64)>| Curve { name: name.to_owned(), points, dotted: true };
    let plot = Plot {
        name: "linear".to_owned(),
        title: "Building against the size of the world ([HIBR] Figure 9: slopes ≈ 1)".to_owned(),
        x: ("leaf cells".to_owned(), Scale::Logarithmic),
        y: ("bytes; M instructions; ms; bytes of memory".to_owned(), Scale::Logarithmic),
        curves: vec![
            curve("bytes stored", of(|b| b.bytes as f64)),
            curve("M instructions", of(|b| b.instructions as f64 / 1e6)),
            curve("wall, ms", of(|b| 1e3 * b.seconds)),
            curve("images held at most, bytes", of(|b| b.image_peak as f64)),
        ],
    };
    Findings { tables: vec![table, slopes], plots: vec![plot], ..Findings::default() }
}
