//! What the client of a recorded session could see, frame by frame.

use super::Recorded;
use super::again::Change;
use crate::replay::{Completion, Request, Run};
use foresight_scheduler::benefit::coverage::Coverage;
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::benefit::quality::evaluate;
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::units::Time;
use foresight_traces::flight::{Flight, TICKS_PER_FRAME, tick_time};
use std::collections::BTreeSet;

/// The session as the simulator would have recorded a replay of it: frames, requests, completions, bytes. Times count from
/// the first view.
pub(super) fn run(tree: &LodTree, recorded: &Recorded, flight: &Flight, judging: &CutSettings) -> Run {
    let start = recorded.views.first().map_or(Time::ZERO, |(start, _)| *start);
    let mut changes: Vec<(Time, Change)> =
        recorded.changes.iter().map(|&(at, change)| (at.since(start), change)).collect();
    // Events bear their own times, and come after answers to what was said before.
    changes.sort_by_key(|(at, _)| *at);
    let mut seen = Seen {
        tree,
        resident: Coverage::new(tree, recorded.header.hello.refinement.into()),
        was_best: BTreeSet::new(),
        run: Run { bytes_fetched: recorded.received, ..Run::default() },
    };
    for &rep in &recorded.held_at_start {
        seen.resident.insert(tree, rep);
        seen.was_best.insert(rep);
    }
    let judging = CutSettings { centre_falloff: 0.0, ..*judging };
    let mut cut = Cut::default();
    let mut next = 0;
    for (tick, view) in flight.views.iter().enumerate() {
        let now = tick_time(tick as u64);
        while let Some(&(at, change)) = changes.get(next).filter(|(at, _)| *at <= now) {
            seen.change(at, change);
            next += 1;
        }
        if (tick as u64).is_multiple_of(TICKS_PER_FRAME) {
            cut.make(tree, view, Region::Frustum, &judging);
            seen.judge(&cut);
        }
    }
    for &(at, change) in &changes[next..] {
        seen.change(at, change);
    }
    let left: Vec<RepId> = seen.resident.iter().collect();
    left.into_iter().for_each(|rep| seen.charge_if_wasted(rep));
    seen.run.decisions = seen.run.requests.len() as u64;
    seen.run
}

struct Seen<'a> {
    tree: &'a LodTree,
    resident: Coverage,
    /// Residents that were the best of something in view since they came, or were there from the start.
    was_best: BTreeSet<RepId>,
    run: Run,
}

impl Seen<'_> {
    fn change(&mut self, at: Time, change: Change) {
        match change {
            Change::Requested(rep) => self.run.requests.push(Request { at, rep }),
            Change::Shown(rep) => {
                if self.resident.insert(self.tree, rep) {
                    self.was_best.remove(&rep);
                    self.run.completions.push(Completion { at, rep });
                }
            }
            Change::Hidden(rep) | Change::LetGo(rep) => {
                if rep.index() < self.tree.representations() && self.resident.remove(self.tree, rep) {
                    self.run.evictions += 1;
                    self.charge_if_wasted(rep);
                } else if matches!(change, Change::LetGo(_)) {
                    self.run.cancellations += 1;
                }
            }
        }
    }

    fn charge_if_wasted(&mut self, rep: RepId) {
        if !self.was_best.contains(&rep) {
            self.run.bytes_wasted += self.tree.wire_bytes(rep);
        }
    }

    fn judge(&mut self, cut: &Cut) {
        let (tree, resident, was_best) = (self.tree, &self.resident, &mut self.was_best);
        let quality = evaluate(tree, cut, resident, |part| {
            let Some(owner) = part.owner else { return };
            let shown = tree.own(owner).filter(|&rep| resident.contains(rep) && part.is_by(tree, rep));
            was_best.extend(shown);
        });
        self.run.frames.push(quality);
    }
}
