//! What a client's log of events says: what could be shown when, and how good that was.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use foresight_scheduler::benefit::coverage::{Coverage, Refinement};
use foresight_scheduler::benefit::cut::Cut;
use foresight_scheduler::benefit::quality::evaluate;
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_traces::flight::{TICKS_PER_FRAME, tick_time};
use serde::Deserialize;

/// A line of the log.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Line {
    /// When, ns since the first tick.
    pub t_ns: u64,
    /// To what.
    pub rep: u32,
    /// What happened.
    pub event: String,
}

/// A flight as its client recorded it.
#[derive(Clone, Debug, Default)]
pub struct Flown {
    /// In order.
    pub lines: Vec<Line>,
}

impl Flown {
    /// Reads a log.
    ///
    /// # Panics
    /// If it is none.
    pub fn read(file: &Path) -> Flown {
        let text = std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        let mut lines: Vec<Line> =
            text.lines().skip(1).map(|line| serde_json::from_str(line).expect("a line of the log")).collect();
        // Sorting is stable: what happened at one time stays in order.
        lines.sort_by_key(|line| line.t_ns);
        Flown { lines }
    }

    /// Events of a kind.
    pub fn count(&self, event: &str) -> usize {
        self.lines.iter().filter(|line| line.event == event).count()
    }

    /// Requests, in order: time and representation.
    pub fn requests(&self) -> Vec<(u64, u32)> {
        self.lines.iter().filter(|line| line.event == "requested").map(|line| (line.t_ns, line.rep)).collect()
    }

    /// Representations that were requested while they could be shown.
    pub fn requested_while_resident(&self) -> Vec<u32> {
        let mut resident = BTreeSet::new();
        let mut again = Vec::new();
        for line in &self.lines {
            match line.event.as_str() {
                "completed" => {
                    resident.insert(line.rep);
                }
                "discarded" | "dropped" | "cancelled" | "failed" => {
                    resident.remove(&line.rep);
                }
                "requested" if resident.contains(&line.rep) => again.push(line.rep),
                _ => {}
            }
        }
        again
    }

    /// Seconds from request to first byte, in order of the request.
    pub fn latencies_s(&self) -> Vec<f64> {
        let mut requested = BTreeMap::new();
        let mut latencies = Vec::new();
        for line in &self.lines {
            match line.event.as_str() {
                "requested" => {
                    requested.insert(line.rep, line.t_ns);
                }
                "responded" => {
                    if let Some(at) = requested.remove(&line.rep) {
                        latencies.push(line.t_ns.saturating_sub(at) as f64 * 1e-9);
                    }
                }
                _ => {}
            }
        }
        latencies
    }

    /// 1 − Q at every sampled frame, by what could be shown then; `None` where nothing is in view. The same cuts and the
    /// same evaluation as the simulator's.
    pub fn deficits(&self, tree: &LodTree, cuts: &[Cut], refinement: Refinement) -> Vec<Option<f64>> {
        let mut resident = Coverage::new(tree, refinement);
        let mut lines = self.lines.iter().peekable();
        let frames = cuts.iter().enumerate().map(|(frame, cut)| {
            let now = tick_time(frame as u64 * TICKS_PER_FRAME).0;
            while let Some(line) = lines.next_if(|line| line.t_ns <= now) {
                let rep = RepId(line.rep);
                match line.event.as_str() {
                    "completed" if !resident.contains(rep) => {
                        resident.insert(tree, rep);
                    }
                    "discarded" | "dropped" | "cancelled" | "failed" if resident.contains(rep) => {
                        resident.remove(tree, rep);
                    }
                    _ => {}
                }
            }
            evaluate(tree, cut, &resident, |_| {}).mean().map(|quality| 1.0 - quality)
        });
        frames.collect()
    }
}

/// Mean over the frames with something in view.
pub fn mean(deficits: &[Option<f64>]) -> f64 {
    let known: Vec<f64> = deficits.iter().copied().flatten().collect();
    known.iter().sum::<f64>() / known.len().max(1) as f64
}

/// Seconds after `from_s` from which on the deficit, as a mean over one second, stays within `tolerance` of the undisturbed
/// one's for a second. `None` if that does not happen before the end.
pub fn returned_after_s(
    disturbed: &[Option<f64>],
    undisturbed: &[Option<f64>],
    from_s: f64,
    tolerance: f64,
) -> Option<f64> {
    let frame_s = tick_time(TICKS_PER_FRAME).secs();
    let second = (1.0 / frame_s).round() as usize;
    let over = |deficits: &[Option<f64>], frame: usize| mean(&deficits[frame..frame + second]);
    let first = (from_s / frame_s) as usize;
    let last = disturbed.len().min(undisturbed.len()).saturating_sub(2 * second);
    let close = |frame: usize| over(disturbed, frame) <= over(undisturbed, frame) + tolerance;
    (first..last).find(|&frame| (frame..frame + second).all(close)).map(|frame| (frame - first) as f64 * frame_s)
}
