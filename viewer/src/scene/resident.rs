//! What is uploaded, what waits for it, and what memory all of that takes.
//!
//! One budget holds over the bytes as they came (the wire cache), what is decoded and waits for its upload, and what the GPU has. What
//! is dropped from the GPU is told from outside: [`Resident::discard`]. Where the budget is short otherwise, bytes that came go first,
//! the least wanted before others, then decoded contents that wait; a content that does not fit even then is refused with a word.

use super::compress::Compression;
use super::content::Content;
use super::decode::Decoded;
use super::loader::{Input, Loaded, Loader};
use bytes::Bytes;
use foresight_scheduler::lod_tree::RepId;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// What takes contents: the renderer.
pub trait Uploads {
    /// Takes a content; returns the bytes that it occupies.
    ///
    /// # Errors
    /// Why not, in words.
    fn upload(&mut self, rep: RepId, content: &Content) -> Result<u64, String>;

    /// Lets a content go.
    fn remove(&mut self, rep: RepId);
}

/// How much memory and time there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ResidentSettings {
    /// Bytes of everything.
    pub budget: u64,
    /// Of these, what the wire cache may take at most.
    pub wire_max: u64,
    /// Bytes uploaded in a frame; one content is uploaded however large it is.
    pub upload_bytes: u64,
}

impl ResidentSettings {
    /// A budget, a quarter of it at most for the wire cache, and 8 MiB a frame.
    pub fn with_budget(budget: u64) -> ResidentSettings {
        ResidentSettings { budget, wire_max: budget / 4, upload_bytes: 8 << 20 }
    }
}

/// Memory by what it is for, bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Used {
    /// Bytes as they came.
    pub wire: u64,
    /// Decoded, waiting.
    pub decoded: u64,
    /// On the GPU.
    pub gpu: u64,
}

impl Used {
    /// All of it.
    pub fn total(&self) -> u64 {
        self.wire.saturating_add(self.decoded).saturating_add(self.gpu)
    }
}

/// What a frame brought.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Frame {
    /// Uploaded: drawable from now on.
    pub shown: Vec<RepId>,
    /// Their bytes on the GPU.
    pub uploaded_bytes: u64,
    /// What there will be nothing of, and why, in words that name it.
    pub failed: Vec<(RepId, String)>,
}

/// A content that waits for its upload.
#[derive(Debug)]
struct Waiting {
    decoded: Decoded,
    bytes: u64,
}

/// What is on the GPU.
#[derive(Clone, Debug, Default)]
struct Shown {
    bytes: u64,
    credit: Option<Arc<str>>,
}

/// The contents of a world that are there.
#[derive(Debug)]
pub struct Resident {
    settings: ResidentSettings,
    loader: Loader,
    /// By representation: bytes, and when they were last of use.
    wire: BTreeMap<RepId, (Bytes, u64)>,
    waiting: BTreeMap<RepId, Waiting>,
    shown: BTreeMap<RepId, Shown>,
    /// How much each that is not shown yet is wanted.
    ranks: BTreeMap<RepId, f64>,
    used: Used,
    used_max: u64,
    turn: u64,
    /// Waiting ones that went for lack of room, until that is told.
    dropped: Vec<RepId>,
    left_out: BTreeSet<String>,
}

/// Most notes about what is left out that are kept.
const NOTES_MAX: usize = 64;

impl Resident {
    /// Nothing yet.
    pub fn new(loader: Loader, settings: ResidentSettings) -> Resident {
        Resident {
            settings,
            loader,
            wire: BTreeMap::new(),
            waiting: BTreeMap::new(),
            shown: BTreeMap::new(),
            ranks: BTreeMap::new(),
            used: Used::default(),
            used_max: 0,
            turn: 0,
            dropped: Vec::new(),
            left_out: BTreeSet::new(),
        }
    }

    /// Changes the budget. What is beyond a smaller one goes, but for what is on the GPU: that is told from outside.
    pub fn set_settings(&mut self, settings: ResidentSettings) {
        self.settings = settings;
        self.make_room(0, None);
    }

    /// Contents that are decoded from now on are compressed so.
    pub fn set_compression(&mut self, compression: Compression) {
        self.loader.set_compression(compression);
    }

    /// Bytes of a representation that came over the network; decoded and uploaded as `rank` says, larger first.
    pub fn received(&mut self, rep: RepId, bytes: Bytes, rank: f64) -> Option<(RepId, String)> {
        self.keep_wire(rep, &bytes);
        self.want(rep, rank, Input::Bytes(bytes))
    }

    /// Asks for a representation whose bytes are kept, or which the loader's own source has.
    pub fn ask(&mut self, rep: RepId, rank: f64) -> Option<(RepId, String)> {
        let kept = self.cached(rep);
        self.want(rep, rank, kept.map_or(Input::Source, Input::Bytes))
    }

    fn want(&mut self, rep: RepId, rank: f64, input: Input) -> Option<(RepId, String)> {
        if self.shown.contains_key(&rep) {
            return None;
        }
        self.ranks.insert(rep, rank);
        self.dropped.retain(|&dropped| dropped != rep);
        if self.waiting.contains_key(&rep) {
            return None;
        }
        let refused = self.loader.ask(rep, rank, input)?;
        self.ranks.remove(&refused);
        Some((
            refused,
            format!("representation {}: too many contents wait to be decoded; it is the least wanted", refused.0),
        ))
    }

    /// Bytes that came, if they are still there: they need not be fetched again.
    pub fn cached(&mut self, rep: RepId) -> Option<Bytes> {
        self.turn += 1;
        let (bytes, last) = self.wire.get_mut(&rep)?;
        *last = self.turn;
        Some(bytes.clone())
    }

    /// How much a representation that is not shown yet is wanted now.
    pub fn rank(&mut self, rep: RepId, rank: f64) {
        if let Some(own) = self.ranks.get_mut(&rep) {
            *own = rank;
            self.loader.rank(rep, rank);
        }
    }

    /// Lets a representation go, wherever it is; bytes that came are kept as long as there is room.
    pub fn discard(&mut self, rep: RepId, uploads: &mut dyn Uploads) {
        self.forget(rep);
        if let Some(shown) = self.shown.remove(&rep) {
            self.used.gpu = self.used.gpu.saturating_sub(shown.bytes);
            uploads.remove(rep);
        }
    }

    /// Takes back what was asked for and is not shown.
    fn forget(&mut self, rep: RepId) {
        if self.ranks.remove(&rep).is_none() {
            return;
        }
        self.loader.cancel(rep);
        if let Some(waiting) = self.waiting.remove(&rep) {
            self.used.decoded = self.used.decoded.saturating_sub(waiting.bytes);
        }
    }

    /// What a frame does: takes what is decoded, and uploads the most wanted within the frame's bytes.
    pub fn frame(&mut self, uploads: &mut dyn Uploads) -> Frame {
        let loaded = self.loader.poll();
        let mut frame = Frame::default();
        self.take(loaded, &mut frame);
        self.upload(self.settings.upload_bytes, uploads, &mut frame);
        frame
    }

    /// Makes every representation of `reps` resident, however long that takes: for references. What does not fit the budget or cannot be
    /// decoded is told.
    pub fn everything(&mut self, reps: impl IntoIterator<Item = RepId>, uploads: &mut dyn Uploads) -> Frame {
        let mut all = Frame::default();
        let mut reps = reps.into_iter().fuse();
        loop {
            // As many at a time as keep the threads busy.
            while self.loader.outstanding() < 16 {
                let Some(rep) = reps.next() else { break };
                all.failed.extend(self.ask(rep, 0.0));
            }
            let loaded = self.loader.wait();
            if loaded.is_empty() {
                return all;
            }
            self.take(loaded, &mut all);
            self.upload(u64::MAX, uploads, &mut all);
        }
    }

    fn take(&mut self, loaded: Vec<Loaded>, frame: &mut Frame) {
        for Loaded { rep, bytes, result } in loaded {
            if let Some(bytes) = bytes {
                self.keep_wire(rep, &bytes);
            }
            match result {
                // Taken back while it was decoded.
                Ok(_) if !self.ranks.contains_key(&rep) => {}
                Ok(decoded) => {
                    for text in &decoded.left_out {
                        if self.left_out.len() < NOTES_MAX && !self.left_out.contains(text) {
                            self.left_out.insert(text.clone());
                        }
                    }
                    let bytes = decoded.content.bytes();
                    self.used.decoded += bytes;
                    self.waiting.insert(rep, Waiting { decoded, bytes });
                    self.dropped.retain(|&dropped| dropped != rep);
                    self.make_room(0, None);
                }
                Err(error) => {
                    self.ranks.remove(&rep);
                    frame.failed.push((rep, error));
                }
            }
        }
        self.note();
    }

    fn upload(&mut self, most: u64, uploads: &mut dyn Uploads, frame: &mut Frame) {
        let mut order: Vec<(f64, RepId)> = self.waiting.keys().map(|&rep| (self.rank_of(rep), rep)).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut left = most;
        for (_, rep) in order {
            let Some(waiting) = self.waiting.get(&rep) else { continue };
            if waiting.bytes > left && left < most {
                break;
            }
            let bytes = waiting.bytes;
            // It leaves the memory of what waits as it comes to that of the GPU; a driver's own copy in between is not counted.
            left = left.saturating_sub(bytes);
            let Some(Waiting { decoded, .. }) = self.waiting.remove(&rep) else { continue };
            self.used.decoded = self.used.decoded.saturating_sub(bytes);
            self.ranks.remove(&rep);
            match uploads.upload(rep, &decoded.content) {
                Ok(gpu) => {
                    self.used.gpu += gpu;
                    if !self.make_room(0, None) {
                        self.used.gpu -= gpu;
                        uploads.remove(rep);
                        frame.failed.push((rep, self.no_room(rep)));
                        continue;
                    }
                    self.shown.insert(rep, Shown { bytes: gpu, credit: decoded.credit });
                    frame.shown.push(rep);
                    frame.uploaded_bytes += gpu;
                }
                Err(error) => frame.failed.push((rep, format!("representation {}: {error}", rep.0))),
            }
        }
        let dropped = std::mem::take(&mut self.dropped);
        frame.failed.extend(dropped.into_iter().map(|rep| (rep, self.no_room(rep))));
        self.note();
    }

    fn no_room(&self, rep: RepId) -> String {
        let (budget, gpu) = (self.settings.budget, self.used.gpu);
        format!("representation {}: no room beside {gpu} bytes on the GPU; the memory budget is {budget} bytes", rep.0)
    }

    fn rank_of(&self, rep: RepId) -> f64 {
        self.ranks.get(&rep).copied().filter(|rank| !rank.is_nan()).unwrap_or(f64::NEG_INFINITY)
    }

    /// Keeps bytes as long as there is room.
    fn keep_wire(&mut self, rep: RepId, bytes: &Bytes) {
        let length = bytes.len() as u64;
        if length > self.settings.wire_max {
            return;
        }
        self.turn += 1;
        if let Some((old, _)) = self.wire.insert(rep, (bytes.clone(), self.turn)) {
            self.used.wire = self.used.wire.saturating_sub(old.len() as u64);
        }
        self.used.wire += length;
        while self.used.wire > self.settings.wire_max && self.drop_wire() {}
        self.make_room(0, None);
        self.note();
    }

    /// Drops the bytes that were of no use for longest.
    fn drop_wire(&mut self) -> bool {
        let Some((&rep, _)) = self.wire.iter().min_by_key(|(_, (_, last))| *last) else { return false };
        let Some((bytes, _)) = self.wire.remove(&rep) else { return false };
        self.used.wire = self.used.wire.saturating_sub(bytes.len() as u64);
        true
    }

    /// Makes room for so many more bytes: of the wire cache first, then of contents that wait, less wanted ones first and `keep` never.
    /// False if there is not enough.
    fn make_room(&mut self, more: u64, keep: Option<RepId>) -> bool {
        while self.used.total().saturating_add(more) > self.settings.budget {
            if self.drop_wire() {
                continue;
            }
            let least = self.waiting.keys().copied().filter(|rep| Some(*rep) != keep);
            let Some(rep) = least.min_by(|a, b| self.rank_of(*a).total_cmp(&self.rank_of(*b)).then(b.cmp(a))) else {
                return false;
            };
            self.forget(rep);
            self.dropped.push(rep);
        }
        true
    }

    fn note(&mut self) {
        self.used_max = self.used_max.max(self.used.total());
    }

    /// Whether it can be drawn.
    pub fn is_shown(&self, rep: RepId) -> bool {
        self.shown.contains_key(&rep)
    }

    /// Whether it was asked for and is neither shown nor failed.
    pub fn is_pending(&self, rep: RepId) -> bool {
        self.ranks.contains_key(&rep)
    }

    /// What can be drawn, in order.
    pub fn shown(&self) -> impl Iterator<Item = RepId> + '_ {
        self.shown.keys().copied()
    }

    /// Contents that wait to be decoded or uploaded.
    pub fn pending(&self) -> usize {
        self.ranks.len()
    }

    /// Memory now.
    pub fn used(&self) -> Used {
        self.used
    }

    /// Most memory there ever was, bytes.
    pub fn used_max(&self) -> u64 {
        self.used_max
    }

    /// Whose a representation on the GPU is, as it says itself.
    pub fn credit(&self, rep: RepId) -> Option<&Arc<str>> {
        self.shown.get(&rep)?.credit.as_ref()
    }

    /// Whose all of `reps` are, each said once.
    pub fn credits(&self, reps: impl IntoIterator<Item = RepId>) -> BTreeSet<Arc<str>> {
        reps.into_iter().filter_map(|rep| self.credit(rep).cloned()).collect()
    }

    /// What of the contents is not drawn, each said once; the first few.
    pub fn left_out(&self) -> &BTreeSet<String> {
        &self.left_out
    }
}

#[cfg(test)]
#[path = "resident_tests.rs"]
mod tests;
