//! Proven bounds alone: the enclosure of every candidate, leg by leg, against the reference, on all processors.
//!
//! The reference goes on until it lies, give or take its own error, within the bounds; then they hold. Where it never
//! does it is taken as well as it can be: if the two intervals meet, nothing is decided, and otherwise the bounds are
//! violated.

use super::outcome::{ErrorRow, Kind, ProofCounts};
use super::record::Record;
use super::reference::reference_within;
use super::scene::Scene;
use super::statistics::share;
use crate::stopwatch::Stopwatch;
use foresight_scheduler::estimate::Outcome;
use foresight_scheduler::integral::{AddedBenefit, IntegralError, Method, integrate};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Gap asked for, relative.
const TOLERANCE: f64 = 1e-3;
/// Gains below this, sr·s, are enclosed as if they were this.
const FLOOR: f64 = 1e-6;
/// Most evaluations of a leg.
const EVALUATIONS_MAX: u32 = 400;
/// Candidates between two reports of progress.
const CHUNK: usize = 2048;
/// The row over all scenes of a kind.
const ALL: &str = "all";

/// What is known of a candidate.
#[derive(Clone, Copy, Debug, Default)]
struct Checked {
    value: f64,
    lower: f64,
    upper: f64,
    evaluations: u64,
    nanos: u64,
    counts: ProofCounts,
}

impl Checked {
    fn of(legs: &[AddedBenefit]) -> Result<Checked, IntegralError> {
        let mut sum = Checked { counts: ProofCounts { candidates: 1, ..ProofCounts::default() }, ..Checked::default() };
        let mut is_violated = false;
        for benefit in legs {
            let method = Method::Enclosure { tolerance: TOLERANCE, floor: FLOOR, evaluations_max: EVALUATIONS_MAX };
            let watch = Stopwatch::start();
            // An enclosure is certified.
            let Outcome::Certified(found) = integrate(benefit, &method)? else { continue };
            sum.nanos += watch.nanos();
            let truth = reference_within(benefit, [found.lower, found.upper])?;
            let (low, high) = (truth.value - truth.error, truth.value + truth.error);
            sum.counts.legs += 1;
            let is_sound = found.lower <= found.value && found.value <= found.upper;
            // Nothing is nothing exactly.
            let is_nothing = truth.value == 0.0 && truth.error <= 1e-300 && found.lower <= 0.0 && 0.0 <= found.upper;
            if is_nothing || found.lower <= low && high <= found.upper {
                sum.counts.legs_within += 1;
            }
            is_violated |= !is_sound || found.lower > high || low > found.upper;
            sum.value += found.value;
            sum.lower = (sum.lower + found.lower).next_down();
            sum.upper = (sum.upper + found.upper).next_up();
            sum.evaluations += u64::from(found.evaluations);
        }
        sum.counts.violated = u64::from(is_violated);
        Ok(sum)
    }
}

/// What was checked, scene by scene.
#[derive(Debug, Default)]
pub struct Proofs {
    records: BTreeMap<(Kind, String), Record>,
    /// Over all scenes.
    pub counts: ProofCounts,
}

impl Proofs {
    /// Checks every candidate of `scene`; `progress` is told how many are done.
    ///
    /// # Errors
    /// A candidate is not legal.
    pub fn measure(&mut self, scene: &Scene, progress: &dyn Fn(usize)) -> Result<(), IntegralError> {
        let mut all = Vec::with_capacity(scene.candidates.len());
        for chunk in scene.candidates.chunks(CHUNK) {
            all.extend(chunk.par_iter().map(|legs| Checked::of(legs)).collect::<Result<Vec<_>, _>>()?);
            progress(all.len());
        }
        let best = all.iter().map(|c| c.value.abs()).fold(0.0, f64::max);
        let record = self.records.entry((scene.kind, scene.case.clone())).or_default();
        for checked in all {
            let off = (checked.upper - checked.value).max(checked.value - checked.lower);
            record.errors.push(share(off, checked.value, best));
            record.gaps.push(share(checked.upper - checked.lower, checked.value, best));
            record.evaluations += checked.evaluations;
            record.nanos += checked.nanos;
            record.violations += checked.counts.violated;
            self.counts.add(&checked.counts);
        }
        Ok(())
    }

    /// A row a scene, and one a kind over all its scenes. Errors are those that the bounds leave possible.
    pub fn rows(&self) -> Vec<ErrorRow> {
        let mut whole: BTreeMap<Kind, Record> = BTreeMap::new();
        for ((kind, _), record) in &self.records {
            whole.entry(*kind).or_default().merge(record);
        }
        let row = |case: &str, kind: Kind, record: &Record| {
            Some(ErrorRow {
                method: "enclosure".to_owned(),
                setting: format!("tolerance={TOLERANCE:e}"),
                certified: true,
                ..record.row(case, kind)?
            })
        };
        let single = self.records.iter().map(|((kind, case), record)| row(case, *kind, record));
        let all = whole.iter().map(|(kind, record)| row(ALL, *kind, record));
        single.chain(all).flatten().collect()
    }
}
