//! The bound of a whole replay: the smaller of the mean of the frames' own bounds and the bound over time.

use super::ascent::{self, Proof};
use super::frame::{self, CheapestBeneath, FrameBound, FrameDual, Limits};
use super::over_time::{OverTime, Supply};
use foresight_scheduler::benefit::cut::Cut;
use foresight_scheduler::lod_tree::LodTree;
use foresight_scheduler::units::Time;
use foresight_traces::flight::{TICKS_PER_FRAME, TICKS_PER_SECOND, tick_time};
use foresight_traces::link::LinkTrace;
use rayon::prelude::*;

/// Says how a bound over time was proven, in every report.
pub const METHOD_OVER_TIME: &str = "over time, with what is fetched again: Lagrangian dual of residence, link and memory in \
                                    steps of up to a few seconds, each step also within its frames' own bounds";

/// What a replay is bounded under.
#[derive(Clone, Copy, Debug)]
pub struct Terms<'a> {
    /// The world.
    pub tree: &'a LodTree,
    /// One a sampled frame, as [`foresight_traces::flight::Flight::cuts`] makes them.
    pub cuts: &'a [Cut],
    /// The link.
    pub link: &'a LinkTrace,
    /// Wire bytes of what is resident at the start.
    pub at_start: u64,
    /// Memory budget, bytes.
    pub budget: u64,
}

/// The bound of one start, and what more link or memory would have added to it.
#[derive(Clone, Debug, Default)]
pub struct Bound {
    /// Upper bound of Q per frame, each by itself; `None` where nothing is in view.
    pub frames: Vec<Option<f64>>,
    /// Mean of those.
    pub by_frame: Option<f64>,
    /// The bound over time; `None` where there is none.
    pub over_time: Option<f64>,
    /// Mean quality per byte that the link brings in addition just before each frame.
    pub per_link_byte: Vec<f64>,
    /// Mean quality per byte of memory in addition at each frame.
    pub per_memory_byte: Vec<f64>,
}

impl Bound {
    /// The smaller of the two.
    pub fn mean_quality(&self) -> Option<f64> {
        let by_frame = self.by_frame?;
        Some(self.over_time.map_or(by_frame, |over_time| over_time.min(by_frame)))
    }

    /// How the smaller was proven.
    pub fn method(&self) -> &'static str {
        if self.is_over_time() { METHOD_OVER_TIME } else { frame::METHOD }
    }

    /// Whether the bound over time is the smaller one.
    pub fn is_over_time(&self) -> bool {
        matches!((self.over_time, self.by_frame), (Some(over_time), Some(by_frame)) if over_time < by_frame)
    }
}

/// The bounds of a replay for several starts in the link; on any number of threads the same.
pub fn bounds(terms: &Terms, starts: &[Time]) -> Vec<Bound> {
    let cheapest = CheapestBeneath::new(terms.tree);
    let wire: Vec<Vec<f64>> = starts.iter().map(|&start| deliverable(terms, start)).collect();
    let by_frame: Vec<Vec<Option<FrameDual>>> = terms
        .cuts
        .par_iter()
        .enumerate()
        .map(|(frame, cut)| {
            let problem = FrameBound::new(terms.tree, &cheapest, cut);
            let Some(mut problem) = problem else { return vec![None; starts.len()] };
            let limits = wire.iter().map(|wire| Limits { wire: wire[frame], memory: terms.budget as f64 });
            limits.map(|limits| Some(problem.prove(limits))).collect()
        })
        .collect();
    let levels = OverTime::levels(terms.tree, &cheapest, terms.cuts);
    let of_start = |s: usize| {
        let frames: Vec<Option<FrameDual>> = by_frame.iter().map(|frame| frame[s]).collect();
        one(terms, &levels, &frames, &wire[s])
    };
    (0..starts.len()).into_par_iter().map(of_start).collect()
}

/// Wire bytes that can have come by each frame, those at the start included.
fn deliverable(terms: &Terms, start: Time) -> Vec<f64> {
    let at = |frame: usize| start + tick_time(frame as u64 * TICKS_PER_FRAME);
    (0..terms.cuts.len())
        .map(|frame| terms.link.bytes_deliverable(start, at(frame)).saturating_add(terms.at_start) as f64)
        .collect()
}

fn one(terms: &Terms, levels: &[OverTime], frames: &[Option<FrameDual>], wire: &[f64]) -> Bound {
    let seen = frames.iter().flatten().count();
    let mut bound = Bound {
        frames: frames.iter().map(|f| f.map(|f| f.value)).collect(),
        by_frame: (seen > 0).then(|| frames.iter().flatten().map(|f| f.value).sum::<f64>() / seen as f64),
        ..Bound::default()
    };
    let share = 1.0 / seen.max(1) as f64;
    let supply: Vec<Supply> = levels.iter().map(|p| supply(p, frames, wire, terms.budget, share)).collect();
    let found = ascent::prove(levels, &supply);
    bound.over_time = found.as_ref().map(|found| found.value.clamp(0.0, 1.0));
    let proof = found.filter(|_| bound.is_over_time()).map(|found| (&levels[found.level], found));
    (bound.per_link_byte, bound.per_memory_byte) = per_byte(frames, proof.as_ref(), share);
    bound
}

/// The limits of a start, by step.
pub(super) fn supply(
    problem: &OverTime,
    frames: &[Option<FrameDual>],
    wire: &[f64],
    budget: u64,
    share: f64,
) -> Supply {
    let steps = problem.steps().iter();
    let own =
        |step: &std::ops::Range<usize>| frames[step.clone()].iter().flatten().map(|f| f.value).sum::<f64>() * share;
    Supply {
        wire: steps.clone().map(|step| wire[step.end - 1]).collect(),
        memory: budget as f64,
        frames: steps.map(own).collect(),
    }
}

/// What a byte of link just before each frame, and a byte of memory at it, adds to the mean quality.
fn per_byte(frames: &[Option<FrameDual>], proof: Option<&(&OverTime, Proof)>, share: f64) -> (Vec<f64>, Vec<f64>) {
    // To what part each frame counts by itself.
    let mut own = vec![1.0; frames.len()];
    let (mut link, mut memory) = (vec![0.0; frames.len()], vec![0.0; frames.len()]);
    if let Some((problem, proof)) = proof {
        for (step, range) in problem.steps().iter().enumerate() {
            own[range.clone()].fill(proof.prices.frame[step]);
            link[range.clone()].fill(proof.prices.capacity[step]);
            memory[range.start] = proof.prices.memory[step];
        }
        memory[0] = 0.0;
    }
    let mut later = 0.0;
    for (frame, dual) in frames.iter().enumerate().rev() {
        if let Some(dual) = dual {
            later += own[frame] * dual.wire * share;
            memory[frame] += own[frame] * dual.memory * share;
        }
        link[frame] += later;
    }
    (link, memory)
}

/// Sampled frames in a second.
pub const FRAMES_PER_SECOND: usize = (TICKS_PER_SECOND / TICKS_PER_FRAME) as usize;
