//! A flight as pictures, on a virtual clock: what is resident at a frame is what the simulation says.

use crate::draw::choose::ChooseSettings;
use crate::draw::environment::EnvironmentSettings;
use crate::gpu::{EnvironmentCounts, FrameCounts, GpuError, Picture, Share};
use crate::measure::{self, Likeness};
use crate::offscreen::Offscreen;
use foresight_index::world::World;
use foresight_replay::future;
use foresight_replay::replay::Announcer;
use foresight_replay::simulation::{Conditions, ReplayError, Simulation};
use foresight_scheduler::benefit::accuracy::HALF_ACCURACY_PX;
use foresight_scheduler::benefit::coverage::Refinement;
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::benefit::quality::evaluate;
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::policy::specification::PolicySpec;
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_scheduler::state::smallest_closure;
use foresight_scheduler::units::Time;
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{Flight, tick_time};
use foresight_traces::link::LinkTrace;
use image::ImageEncoder;
use serde::Serialize;
use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Version of the documents that `--json` prints.
pub const SCHEMA_VERSION: u32 = 1;

/// The table of the frames, one JSON object a line.
pub const TABLE: &str = "frames.jsonl";

/// What pictures are compared with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Against {
    /// The same view with everything resident, drawn by the same settings: what remains is what has not come.
    #[default]
    Everything,
    /// The finest triangles of everything: what remains is that, and what orthoviews cannot show.
    Geometry,
}

/// A flight to be drawn.
#[derive(Clone, Copy)]
pub struct Headless<'a> {
    /// The world.
    pub world: &'a World,
    /// The camera; pictures are as large as its viewport.
    pub flight: &'a Flight,
    /// The link.
    pub link: &'a LinkTrace,
    /// Who decides what is fetched.
    pub policy: &'a PolicySpec,
    /// Memory and refinement.
    pub scheduler: SchedulerSettings,
    /// What the client can do.
    pub client: ClientSettings,
    /// Everything is resident from the start on, whatever the memory.
    pub everything: bool,
    /// What pictures are compared with.
    pub against: Against,
    /// What is drawn of what is resident.
    pub choose: ChooseSettings,
    /// What is far comes from environment maps, in the pictures and not in their references. They take what is left of so
    /// many bytes beside the scheduler's.
    pub environment: Option<(EnvironmentSettings, u64)>,
    /// From one picture to the next, at least 1.
    pub ticks_per_picture: u64,
}

/// One picture in figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// From 0.
    pub frame: usize,
    /// Seconds from the start.
    pub t_s: f64,
    /// The scheduler's measured quality Q of the view; `None` where nothing is in view.
    pub quality: Option<f64>,
    /// Share of the view's weight that is shown at an error of at most 1, 2, 4, …, 512 pixels; empty where nothing is in
    /// view.
    pub within_px: Vec<f64>,
    /// Structural similarity with the reference, sky left out; `None` where the reference shows nothing.
    pub ssim: Option<f64>,
    /// dB; `None` where the reference shows nothing, and where there is no difference.
    pub psnr_db: Option<f64>,
    /// Share of what the reference shows at which the picture shows nothing.
    pub holes: Option<f64>,
    /// Share of the picture that is compared: the rest is sky.
    pub compared: f64,
    /// Memory in use by the scheduler's account, bytes.
    pub memory_bytes: u64,
    /// Bytes that have crossed the link.
    pub received_bytes: u64,
    /// Representations that are resident.
    pub resident: usize,
    /// Samples of orthoviews that were drawn.
    pub points: u64,
    /// Triangles that were drawn.
    pub triangles: u64,
    /// Draw calls.
    pub draws: u64,
    /// What became of environment maps; `None` without.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub environment: Option<EnvironmentRow>,
}

/// Environment maps at a picture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EnvironmentRow {
    /// Samples of maps that were drawn; they are among [`Row::points`].
    pub points: u64,
    /// Contents that maps showed in their place.
    pub left_out: usize,
    /// Maps that were drawn.
    pub maps_drawn: usize,
    /// Faces that were made for this picture, and the points and triangles drawn into them.
    pub faces_made: u64,
    /// See there.
    pub points_in: u64,
    /// Maps made so far.
    pub maps_made: u64,
    /// Bytes of maps, and of what they are made with.
    pub bytes: u64,
}

impl EnvironmentRow {
    fn new(points: u64, counts: &EnvironmentCounts) -> EnvironmentRow {
        let &EnvironmentCounts { left_out, maps_drawn, faces_made, points_in, maps_made, bytes, .. } = counts;
        EnvironmentRow { points, left_out, maps_drawn, faces_made, points_in, maps_made, bytes }
    }
}

/// A picture as it is made.
pub struct Shown<'a, 'w> {
    /// In figures.
    pub row: &'a Row,
    /// What is seen.
    pub picture: &'a Picture,
    /// What could be seen.
    pub reference: &'a Picture,
    /// The cut by which the quality was judged.
    pub cut: &'a Cut,
    /// The client at that time.
    pub simulation: &'a Simulation<'w>,
}

/// A flight in figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// What drew.
    pub adapter: String,
    /// Name of the world.
    pub world: String,
    /// Hash of its content.
    pub world_hash: String,
    /// The policy with its options; `None` where everything is resident.
    pub policy: Option<String>,
    /// Name of the link; `None` where everything is resident.
    pub link: Option<String>,
    /// Columns and rows of the pictures.
    pub size: [u32; 2],
    /// Pictures.
    pub frames: usize,
    /// Seconds of the flight.
    pub duration_s: f64,
    /// Mean of the qualities that are defined.
    pub mean_quality: Option<f64>,
    /// Mean of the similarities that are defined.
    pub mean_ssim: Option<f64>,
    /// The picture with the least similarity.
    pub worst_frame: Option<usize>,
    /// Its similarity.
    pub worst_ssim: Option<f64>,
    /// Memory budget, bytes; `None` where everything is resident.
    pub memory_budget: Option<u64>,
    /// The most that was in use at a picture, bytes; with everything resident, maps aside, what the contents' sizes say.
    pub memory_max: u64,
    /// Of that the most that environment maps took.
    pub maps_max: u64,
    /// Why there were no environment maps, if they were asked for and at some picture there were none to be had.
    pub maps_refused: Option<String>,
    /// Bytes that have crossed the link.
    pub bytes_received: u64,
    /// What could not be shown, and why; others were drawn in its place. The first few.
    pub broken: Vec<String>,
    /// How many there are of these.
    pub broken_count: usize,
}

/// Of [`Row::within_px`].
const OCTAVES: usize = 10;

/// Most faults that a summary names.
const BROKEN_MAX: usize = 10;

/// Why there are no pictures.
#[derive(Debug, thiserror::Error)]
pub enum HeadlessError {
    /// Nothing can be drawn.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The simulation stopped.
    #[error(transparent)]
    Replay(#[from] ReplayError),
    /// Pictures of different sizes.
    #[error(transparent)]
    Sizes(#[from] measure::SizesDiffer),
    /// A rival in a world of orthoviews.
    #[error(
        "the world has representations that show one direction only, which policy {0} does not tell apart; expected foresight and what follows its objective, or lookahead"
    )]
    Directions(String),
    /// Nothing fits into memory.
    #[error(
        "the memory budget is {budget} bytes, but the smallest request of this world takes {smallest}; expected at least that"
    )]
    Memory {
        /// As set.
        budget: u64,
        /// Wire and decoded bytes of the smallest closure.
        smallest: u64,
    },
    /// A file could not be written.
    #[error("{}: {source}", file.display())]
    Write {
        /// Which.
        file: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
}

/// Draws the flight. `each` is given every picture with its reference. `references`, empty at first, keeps the references
/// from one flight to the next over the same path with the same [`Headless::against`] and [`Headless::choose`].
///
/// # Errors
/// As [`HeadlessError`] has them, and those of `each`.
pub fn fly(
    headless: &Headless,
    offscreen: &mut Offscreen,
    mut references: Option<&mut Vec<Picture>>,
    each: &mut dyn FnMut(&Shown) -> Result<(), HeadlessError>,
) -> Result<Summary, HeadlessError> {
    let Headless { world, flight, link, policy, .. } = *headless;
    let tree = &world.tree;
    if tree.has_directions() && !policy.tells_directions() {
        return Err(HeadlessError::Directions(policy.label.clone()));
    }
    let every: BTreeSet<RepId> = (0..tree.representations() as u32).map(RepId).collect();
    let preloaded: Vec<RepId> = if headless.everything { every.iter().copied().collect() } else { Vec::new() };
    let mut scheduler = headless.scheduler;
    let smallest = smallest_closure(tree, Refinement::Partial).unwrap_or(0);
    if headless.everything {
        scheduler.budget = u64::MAX / 4;
    } else if scheduler.budget < smallest {
        return Err(HeadlessError::Memory { budget: scheduler.budget, smallest });
    }
    let conditions =
        Conditions { tree, link, link_start: Time::ZERO, client: headless.client, scheduler, preloaded: &preloaded };
    let mut simulation = Simulation::new(conditions, future::build(policy, tree, flight, link, Time::ZERO))?;
    let mut announcer = Announcer::new(&flight.views, headless.client.announce_s);
    let mut resident: BTreeSet<RepId> = preloaded.iter().copied().collect();
    offscreen.set_environment(headless.environment.map(|(settings, _)| settings));
    let mut cut = Cut::default();
    let mut totals = Totals::default();
    for (tick, view) in flight.views.iter().enumerate() {
        let now = tick_time(tick as u64);
        simulation.advance(now)?;
        if let Some(path) = announcer.at(tick) {
            simulation.announce(&path, now)?;
        }
        let done = simulation.decide(view, now)?;
        resident.extend(done.completed.iter().copied());
        for gone in &done.discarded {
            resident.remove(gone);
        }
        if !(tick as u64).is_multiple_of(headless.ticks_per_picture.max(1)) {
            continue;
        }
        cut.make(tree, view, Region::Frustum, &CutSettings { centre_falloff: 0.0, ..CutSettings::default() });
        let quality = simulation.judge(&cut).mean();
        let within_px = within_px(tree, &cut, &simulation);
        let (picture, counts, maps) = match headless.environment {
            Some((_, bytes)) => {
                let bytes = bytes.saturating_sub(if headless.everything { 0 } else { simulation.used_bytes() });
                let share = Share { bytes, frames: headless.ticks_per_picture, waits: true };
                let drawn = offscreen.picture_with_maps(view, &resident, &headless.choose, share)?;
                (drawn.0, drawn.1, Some(drawn.2))
            }
            None => {
                let (picture, counts) = offscreen.picture(view, &resident, &headless.choose)?;
                (picture, counts, None)
            }
        };
        let frame = totals.rows;
        let made = match references.as_deref().and_then(|kept| kept.get(frame)) {
            Some(_) => None,
            None => Some(match headless.against {
                Against::Everything if headless.everything && maps.is_none() => picture.clone(),
                Against::Everything => offscreen.picture(view, &every, &headless.choose)?.0,
                Against::Geometry => offscreen.picture(view, &every, &ChooseSettings::reference())?.0,
            }),
        };
        let kept = references.as_deref().and_then(|kept| kept.get(frame));
        let reference = made.as_ref().or(kept).unwrap_or(&picture);
        let likeness = measure::compare(&picture, reference)?;
        totals.maps(maps.as_ref());
        let environment = maps.map(|maps| EnvironmentRow::new(counts.map_points, &maps));
        let row =
            Row { quality, within_px, environment, ..row(frame, now, likeness, counts, &simulation, resident.len()) };
        totals.add(&row);
        each(&Shown { row: &row, picture: &picture, reference, cut: &cut, simulation: &simulation })?;
        if let (Some(made), Some(kept)) = (made, references.as_deref_mut()) {
            kept.push(made);
        }
    }
    let streamed = |text: &str| (!headless.everything).then(|| text.to_owned());
    let uri = |(&rep, reason): (&RepId, &String)| match world.uri(rep) {
        uri if uri.is_empty() || reason.contains(&*uri) => reason.clone(),
        uri => format!("{uri}: {reason}"),
    };
    let mean = |(sum, count): (f64, usize)| (count > 0).then(|| sum / count as f64);
    Ok(Summary {
        schema_version: SCHEMA_VERSION,
        adapter: offscreen.adapter().to_owned(),
        world: world.name.clone(),
        world_hash: world.hash().to_hex().to_string(),
        policy: streamed(&policy.label),
        link: streamed(link.name()),
        size: flight.views.first().map_or([0, 0], |view| view.viewport),
        frames: totals.rows,
        duration_s: flight.duration().secs(),
        mean_quality: mean(totals.quality),
        mean_ssim: mean(totals.ssim),
        worst_frame: totals.worst.map(|(frame, _)| frame),
        worst_ssim: totals.worst.map(|(_, ssim)| ssim),
        memory_budget: (!headless.everything)
            .then(|| headless.environment.map_or(scheduler.budget, |(_, bytes)| bytes.max(scheduler.budget))),
        memory_max: totals.memory_max,
        maps_max: totals.maps_max,
        maps_refused: totals.refused,
        bytes_received: simulation.delivered_bytes(),
        broken: offscreen.broken().iter().take(BROKEN_MAX).map(uri).collect(),
        broken_count: offscreen.broken().len(),
    })
}

/// [`Row::within_px`].
fn within_px(tree: &LodTree, cut: &Cut, simulation: &Simulation) -> Vec<f64> {
    let mut within = [0.0; OCTAVES];
    let total = evaluate(tree, cut, simulation.resident(), |part| {
        let pixels = f64::from(part.error) * part.sharpness.sqrt() * HALF_ACCURACY_PX;
        if part.owner.is_some() {
            let limits = (0..OCTAVES).map(|octave| (1u32 << octave) as f64);
            within.iter_mut().zip(limits).filter(|(_, most)| pixels <= *most).for_each(|(sum, _)| *sum += part.weight);
        }
    })
    .weight;
    if total > 0.0 { within.map(|sum| sum / total).to_vec() } else { Vec::new() }
}

fn row(
    frame: usize,
    now: Time,
    likeness: Option<Likeness>,
    counts: FrameCounts,
    simulation: &Simulation,
    resident: usize,
) -> Row {
    Row {
        frame,
        t_s: now.secs(),
        quality: None,
        within_px: Vec::new(),
        ssim: likeness.map(|l| l.ssim),
        psnr_db: likeness.map(|l| l.psnr_db).filter(|db| db.is_finite()),
        holes: likeness.map(|l| l.holes),
        compared: likeness.map_or(0.0, |l| l.compared),
        memory_bytes: simulation.used_bytes(),
        received_bytes: simulation.received_bytes(),
        resident,
        points: counts.points,
        triangles: counts.triangles,
        draws: counts.draws,
        environment: None,
    }
}

#[derive(Default)]
struct Totals {
    rows: usize,
    /// Sum and count.
    quality: (f64, usize),
    ssim: (f64, usize),
    worst: Option<(usize, f64)>,
    memory_max: u64,
    /// Most bytes of maps, and why there were none.
    maps_max: u64,
    refused: Option<String>,
}

impl Totals {
    fn maps(&mut self, counts: Option<&EnvironmentCounts>) {
        if let Some(counts) = counts {
            self.maps_max = self.maps_max.max(counts.bytes);
            self.refused = self.refused.take().or_else(|| counts.refused.clone());
        }
    }

    fn add(&mut self, row: &Row) {
        self.rows += 1;
        if let Some(quality) = row.quality {
            self.quality = (self.quality.0 + quality, self.quality.1 + 1);
        }
        if let Some(ssim) = row.ssim {
            self.ssim = (self.ssim.0 + ssim, self.ssim.1 + 1);
            if self.worst.is_none_or(|(_, worst)| ssim < worst) {
                self.worst = Some((row.frame, ssim));
            }
        }
        let maps = row.environment.as_ref().map_or(0, |environment| environment.bytes);
        self.memory_max = self.memory_max.max(row.memory_bytes + maps);
    }
}

/// Draws the flight into the folder `frames`, which is made: `frame_00000.png` and so on, and [`TABLE`] at the end.
/// `progress` is told after each picture how many of how many there are.
///
/// # Errors
/// As [`fly`]'s, and files that cannot be written.
pub fn run(
    headless: &Headless,
    offscreen: &mut Offscreen,
    frames: &Path,
    progress: &mut dyn FnMut(usize, usize, &Row),
) -> Result<Summary, HeadlessError> {
    std::fs::create_dir_all(frames).map_err(|source| HeadlessError::Write { file: frames.to_owned(), source })?;
    let all = headless.flight.views.len().div_ceil(headless.ticks_per_picture.max(1) as usize);
    let mut table = Vec::new();
    let summary = fly(headless, offscreen, None, &mut |shown| {
        let Shown { row, picture, .. } = *shown;
        let file = frames.join(format!("frame_{:05}.png", row.frame));
        let bytes = png(picture).map_err(|source| HeadlessError::Write { file: file.clone(), source })?;
        write_beside(&file, &bytes)?;
        let wrong = |error: serde_json::Error| HeadlessError::Write { file: frames.join(TABLE), source: error.into() };
        serde_json::to_writer(&mut table, row).map_err(wrong)?;
        table.push(b'\n');
        progress(row.frame + 1, all, row);
        Ok(())
    })?;
    write_beside(&frames.join(TABLE), &table)?;
    Ok(summary)
}

/// A picture as a PNG.
///
/// # Errors
/// What the encoder refuses.
pub fn png(picture: &Picture) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    image::codecs::png::PngEncoder::new(&mut bytes)
        .write_image(&picture.rgba, picture.size[0], picture.size[1], image::ExtendedColorType::Rgba8)
        .map_err(std::io::Error::other)?;
    Ok(bytes)
}

/// Writes beside and then renames, so that no file is ever there in part.
fn write_beside(file: &Path, bytes: &[u8]) -> Result<(), HeadlessError> {
    let wrong = |source| HeadlessError::Write { file: file.to_owned(), source };
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(".part");
    let beside = file.with_file_name(name);
    let mut out = std::fs::File::create(&beside).map_err(wrong)?;
    out.write_all(bytes).map_err(wrong)?;
    drop(out);
    std::fs::rename(&beside, file).map_err(wrong)
}
