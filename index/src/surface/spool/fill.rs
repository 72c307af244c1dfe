//! Filling a spool: the source is read once to measure it, and once to sort its triangles into leaves. Triangles wait in
//! memory up to a budget, then go to the end of a file as one block a leaf.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use foresight_scheduler::lod_tree::Aabb;
use rayon::prelude::*;

use super::block::{flags, put, stride};
use super::looks::Looks;
use super::measure::{Body, Measure, Soundness, middle, non_manifold_edges, soundness};
use super::{Block, IMAGES, Index, LEAVES_MAX, Spool, SpoolError, SpoolSettings, Statistics, TRIANGLES, order};
use crate::import::tiles3d::ContentError;
use crate::octree::Octree;
use crate::orthoview::raster::Triangle;
use crate::surface::overlap::{TooManyLeaves, leaves};
use crate::surface::{PIECE_TRIANGLES, Piece, SurfaceSource};

/// A leaf is taken this share of its side larger: no rounding loses a triangle on its border.
const SLACK: f64 = 1e-6;
/// Most different things that are said to be left out.
const MAX_LEFT_OUT: usize = 256;

/// Told how many pieces have been read, and of how many; each is read twice, three times if something lies far away.
pub type Progress<'p> = &'p (dyn Fn(u64, u64) + Sync);

/// Sorts the triangles of `source` into the folder `folder`, which is made if need be; what is in it of an older spool is
/// replaced.
///
/// # Errors
/// A source that cannot be read or has no triangles; leaves far too small; a folder that cannot be written.
pub(super) fn fill(
    source: &dyn SurfaceSource,
    folder: &Path,
    settings: &SpoolSettings,
    progress: Progress<'_>,
) -> Result<Spool, SpoolError> {
    let identity = source.identity()?;
    let pieces = source.pieces();
    let ticks = Ticks { done: AtomicU64::new(0), total: AtomicU64::new(2 * pieces as u64), progress };
    let Survey { measure, counts, strays } = survey(source, settings.keep_strays, &ticks)?;
    let octree = Octree::over(measure.bounds, settings.leaf_side)?;

    fs::create_dir_all(folder).map_err(|source| SpoolError::io(folder, source))?;
    super::Index::remove(folder)?;
    let mut sorter = Sorter::begin(folder, octree, settings.memory)?;
    let room = PIECE_TRIANGLES * rayon::current_num_threads();
    let mut first = 0;
    while first < pieces {
        let (mut end, mut sum) = (first, 0);
        while end < pieces && (end == first || sum + counts[end] as usize <= room) {
            sum += counts[end] as usize;
            end += 1;
        }
        let batch: Vec<Result<Sorted, SpoolError>> = (first..end)
            .into_par_iter()
            .map(|piece| {
                let sorted = sort(source, piece, &octree, strays);
                ticks.tick();
                sorted
            })
            .collect();
        for sorted in batch {
            sorter.add(sorted?)?;
        }
        first = end;
    }
    let left_out = said(&sorter.left_out, &measure, strays);
    let placed = sorter.placed;
    let image_bytes = sorter.looks.images.iter().map(|image| image.length).sum();
    let statistics = Statistics { placed, image_bytes, left_out, ..figures(&measure) };
    sorter.finish(folder, identity, settings, statistics)
}

/// How far the reading is.
struct Ticks<'p> {
    done: AtomicU64,
    total: AtomicU64,
    progress: Progress<'p>,
}

impl Ticks<'_> {
    fn tick(&self) {
        (self.progress)(self.done.fetch_add(1, Ordering::Relaxed) + 1, self.total.load(Ordering::Relaxed));
    }
}

/// What is known before anything is sorted.
struct Survey {
    measure: Measure,
    /// Triangles of each piece.
    counts: Vec<u32>,
    strays: Option<Body>,
}

/// Reads the source once, and once more if something lies far away.
fn survey(source: &dyn SurfaceSource, keep_strays: bool, ticks: &Ticks<'_>) -> Result<Survey, SpoolError> {
    let pieces = source.pieces();
    let (mut measure, counts) = measured(source, None, ticks)?;
    let mut strays = None;
    if let Some(body) = measure.body().filter(|_| !keep_strays) {
        ticks.total.fetch_add(pieces as u64, Ordering::Relaxed);
        let (without, _) = measured(source, Some(body), ticks)?;
        if without.repairs.strays <= measure.few() {
            let non_manifold_edges = measure.repairs.non_manifold_edges;
            measure = without;
            measure.repairs.non_manifold_edges = non_manifold_edges;
            strays = Some(body);
        }
    }
    if measure.triangles == 0 {
        let name = if pieces == 0 { String::new() } else { source.name(0).to_owned() };
        return Err(SpoolError::Empty { name, repairs: measure.repairs });
    }
    Ok(Survey { measure, counts, strays })
}

/// What was left out, with how often.
fn said(texts: &BTreeMap<String, u64>, measure: &Measure, strays: Option<Body>) -> Vec<String> {
    let times = |(text, count): (&String, &u64)| {
        if *count > 1 { format!("{text} ({count} times)") } else { text.clone() }
    };
    let mut said: Vec<String> = texts.iter().map(times).collect();
    if let Some(Body { centre, reach }) = strays {
        let (strays, few) = (measure.repairs.strays, measure.few());
        said.push(format!(
            "{strays} triangles further than {reach:.0} m from {centre:.0}, 100 times as far as all but {few} lie"
        ));
    }
    said
}

fn figures(measure: &Measure) -> Statistics {
    Statistics {
        triangles: measure.triangles,
        placed: 0,
        area: measure.area(),
        orientations: measure.orientations(),
        bounds: measure.bounds,
        repairs: measure.repairs,
        left_out: Vec::new(),
        image_bytes: 0,
        triangle_bytes: 0,
    }
}

/// What a source holds, found by reading it; nothing is sorted or written.
pub(super) fn inspect(source: &dyn SurfaceSource, progress: Progress<'_>) -> Result<Statistics, SpoolError> {
    let total = AtomicU64::new(2 * source.pieces() as u64);
    let ticks = Ticks { done: AtomicU64::new(0), total, progress };
    let Survey { measure, strays, .. } = survey(source, false, &ticks)?;
    let mut looks = Looks::default();
    let mut texts = BTreeMap::new();
    let mut nowhere = std::io::sink();
    for piece in 0..source.pieces() {
        let mut piece = source.read(piece)?;
        let mut left_out = std::mem::take(&mut piece.left_out);
        let taken = looks.take(&mut piece, &mut |text| left_out.push(text), &mut nowhere);
        taken.map_err(|source| SpoolError::io(Path::new("images"), source))?;
        left_out.into_iter().for_each(|text| count(&mut texts, text));
        ticks.tick();
    }
    let image_bytes = looks.images.iter().map(|image| image.length).sum();
    Ok(Statistics { image_bytes, left_out: said(&texts, &measure, strays), ..figures(&measure) })
}

/// Counts what is left out; of too many different things the rest is not said.
fn count(texts: &mut BTreeMap<String, u64>, text: String) {
    if texts.len() < MAX_LEFT_OUT || texts.contains_key(&text) {
        *texts.entry(text).or_default() += 1;
    }
}

/// Reads all pieces, and adds them up. Gives the number of triangles in each, too.
fn measured(
    source: &dyn SurfaceSource,
    body: Option<Body>,
    ticks: &Ticks<'_>,
) -> Result<(Measure, Vec<u32>), ContentError> {
    let is_stray = |middle| body.is_some_and(|body| body.is_outside(middle));
    let whole = Mutex::new(Measure::default());
    // A measure is large: one for a run of pieces, not for each.
    let run = (source.pieces() / (8 * rayon::current_num_threads())).clamp(1, 64);
    let counts: Result<Vec<Vec<u32>>, ContentError> = (0..source.pieces())
        .into_par_iter()
        .fold_chunks(
            run,
            || Ok((Measure::default(), Vec::new())),
            |state: Result<(Measure, Vec<u32>), ContentError>, piece| {
                let (mut measure, mut counts) = state?;
                let triangles = source.triangles(piece)?;
                measure.add(piece, &triangles, &is_stray);
                if body.is_none() {
                    measure.repairs.non_manifold_edges += non_manifold_edges(&triangles);
                }
                counts.push(triangles.len().min(u32::MAX as usize) as u32);
                ticks.tick();
                Ok((measure, counts))
            },
        )
        .map(|state| {
            let (measure, counts) = state?;
            let mut whole = whole.lock().unwrap_or_else(PoisonError::into_inner);
            let joined = std::mem::take(&mut *whole).join(measure);
            *whole = joined;
            Ok(counts)
        })
        .collect();
    let counts = counts?.into_iter().flatten().collect();
    Ok((whole.into_inner().unwrap_or_else(PoisonError::into_inner), counts))
}

/// A piece with the leaves of each triangle.
struct Sorted {
    piece: Piece,
    /// Leaf and triangle, the leaves in the octree's order.
    places: Vec<(u128, u32)>,
}

fn sort(source: &dyn SurfaceSource, piece: usize, octree: &Octree, strays: Option<Body>) -> Result<Sorted, SpoolError> {
    let mut read = source.read(piece)?;
    read.triangles.retain(|triangle| {
        soundness(triangle) == Soundness::Sound && !strays.is_some_and(|body| body.is_outside(middle(triangle)))
    });
    let mut places = Vec::with_capacity(read.triangles.len());
    let mut found = Vec::new();
    let mut last = ([0; 3], 0);
    for (at, triangle) in read.triangles.iter().enumerate() {
        found.clear();
        let slack = SLACK * octree.leaf_side();
        leaves(octree, &triangle.corners, slack, LEAVES_MAX, &mut found).map_err(|TooManyLeaves| {
            let [a, b, c] = triangle.corners;
            let bounds = Aabb { min: a.min(b).min(c), max: a.max(b).max(c) };
            SpoolError::SmallLeaves { name: source.name(piece).to_owned(), side: octree.leaf_side(), bounds }
        })?;
        for &place in &found {
            // Triangles that follow each other are mostly in one leaf.
            if last.0 != place {
                last = (place, order::key(octree, place));
            }
            places.push((last.1, at as u32));
        }
    }
    places.sort_unstable();
    Ok(Sorted { piece: read, places })
}

/// What waits in memory, and the files that it goes to.
struct Sorter {
    octree: Octree,
    memory: usize,
    triangles: Vec<Triangle>,
    waiting: BTreeMap<u128, Vec<u32>>,
    references: usize,
    file: Output,
    images: Output,
    looks: Looks,
    blocks: Vec<Block>,
    placed: u64,
    left_out: BTreeMap<String, u64>,
}

/// A file being written.
struct Output {
    path: PathBuf,
    writer: BufWriter<File>,
    length: u64,
}

impl Output {
    fn create(path: PathBuf) -> Result<Output, SpoolError> {
        let file = File::create(&path).map_err(|source| SpoolError::io(&path, source))?;
        Ok(Output { path, writer: BufWriter::with_capacity(1 << 20, file), length: 0 })
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), SpoolError> {
        self.length += bytes.len() as u64;
        self.writer.write_all(bytes).map_err(|source| SpoolError::io(&self.path, source))
    }

    fn finish(mut self) -> Result<u64, SpoolError> {
        let fault = |source| SpoolError::io(&self.path, source);
        self.writer.flush().map_err(fault)?;
        self.writer.get_ref().sync_all().map_err(fault)?;
        Ok(self.length)
    }
}

impl Sorter {
    fn begin(folder: &Path, octree: Octree, memory: usize) -> Result<Sorter, SpoolError> {
        Ok(Sorter {
            octree,
            memory,
            triangles: Vec::new(),
            waiting: BTreeMap::new(),
            references: 0,
            file: Output::create(folder.join(TRIANGLES))?,
            images: Output::create(folder.join(IMAGES))?,
            looks: Looks::default(),
            blocks: Vec::new(),
            placed: 0,
            left_out: BTreeMap::new(),
        })
    }

    fn add(&mut self, sorted: Sorted) -> Result<(), SpoolError> {
        let Sorted { mut piece, places } = sorted;
        let mut said = std::mem::take(&mut piece.left_out);
        let images = &mut self.images;
        let taken = self.looks.take(&mut piece, &mut |text| said.push(text), &mut images.writer);
        taken.map_err(|source| SpoolError::io(&images.path, source))?;
        said.into_iter().for_each(|text| count(&mut self.left_out, text));
        let first = self.triangles.len() as u32;
        self.triangles.extend_from_slice(&piece.triangles);
        self.references += places.len();
        self.placed += places.len() as u64;
        for run in places.chunk_by(|a, b| a.0 == b.0) {
            let waiting = self.waiting.entry(run[0].0).or_default();
            waiting.extend(run.iter().map(|&(_, at)| first + at));
        }
        let triangle = size_of::<Triangle>();
        if self.triangles.len() * triangle + self.references * 4 >= self.memory {
            self.flush()?;
        }
        Ok(())
    }

    /// Writes what waits, leaf by leaf.
    fn flush(&mut self) -> Result<(), SpoolError> {
        let waiting = std::mem::take(&mut self.waiting);
        let triangles = &self.triangles;
        let leaves: Vec<(u128, Vec<u32>)> = waiting.into_iter().collect();
        for leaves in leaves.chunks(1024) {
            let encoded: Vec<(u8, Vec<u8>)> = leaves
                .par_iter()
                .map(|(_, members)| {
                    let flags = flags(members.iter().map(|&at| &triangles[at as usize]));
                    let mut bytes = Vec::with_capacity(members.len() * stride(flags));
                    members.iter().for_each(|&at| put(&triangles[at as usize], flags, &mut bytes));
                    (flags, bytes)
                })
                .collect();
            for ((leaf, members), (flags, bytes)) in leaves.iter().zip(encoded) {
                let (offset, count) = (self.file.length, members.len() as u32);
                self.blocks.push(Block { leaf: *leaf, offset, count, flags });
                self.file.write(&bytes)?;
            }
        }
        self.triangles.clear();
        self.references = 0;
        Ok(())
    }

    fn finish(
        mut self,
        folder: &Path,
        identity: [u8; 32],
        settings: &SpoolSettings,
        mut statistics: Statistics,
    ) -> Result<Spool, SpoolError> {
        self.flush()?;
        self.blocks.sort_unstable_by_key(|block| (block.leaf, block.offset));
        statistics.triangle_bytes = self.file.finish()?;
        self.images.finish()?;
        let index = Index {
            identity,
            leaf_side: settings.leaf_side,
            keep_strays: settings.keep_strays,
            statistics,
            materials: self.looks.materials,
            images: self.looks.images,
            blocks: self.blocks,
        };
        index.write(folder)?;
        Ok(Spool::over(folder, self.octree, index))
    }
}
