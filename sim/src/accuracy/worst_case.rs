//! The worst case, both readings: every method and setting against the sum over leaves, or the largest deficit known.

use super::gains;
use super::outcome::{ErrorRow, Kind};
use super::record::{Answer, Record};
use super::situation::Situation;
use super::statistics::{relative_error, share};
use crate::stopwatch::Stopwatch;
use foresight_scheduler::benefit::coverage::Coverage;
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::benefit::quality::evaluate;
use foresight_scheduler::estimate::Certified;
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::policy::foresight::ForesightSettings;
use foresight_scheduler::select::horizon::{Horizon, HorizonSettings};
use foresight_scheduler::worst_case::minimum::{self, MinimumSettings};
use foresight_scheduler::worst_case::neighbourhood::Neighbourhood;
use foresight_scheduler::worst_case::target::Targets;
use foresight_scheduler::worst_case::union::{self, UnionSettings};
use foresight_scheduler::worst_case::{WorstCaseError, WorstCaseKind, union_cut};
use foresight_traces::random::SplitMix64;
use std::collections::BTreeMap;

/// Opening angles of the cut that decisions use.
const ANGLES: [f64; 3] = [0.6, 0.3, 0.15];
/// Gaps asked of the proven union.
const TOLERANCES: [f64; 4] = [1e-1, 1e-2, 1e-3, 1e-5];
/// Sizes of the covering set.
const SAMPLES: [usize; 4] = [4, 16, 64, 256];
/// Samples among which a deficit is sought that a proof has missed.
const CHECKED: usize = 400;
/// Representations of a situation whose gains are measured.
const GAINS: usize = 8;
/// Evaluations that the offline search may take where not every candidate is asked for.
const OFFLINE_SHORT: u32 = 5_000_000;
/// Candidates from which on the full offline search runs.
const FULL_FROM: u64 = 100_000;
/// Rounding of the references, share of Σw.
const ROUNDING: f64 = 1e-12;

const ALL: &str = "all";

/// A method at a setting, by which rows are told apart; ordered as they are printed.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Tried {
    reading: &'static str,
    method: &'static str,
    order: usize,
    setting: String,
    certified: bool,
    is_default: bool,
}

/// Errors of every method and setting, case by case.
#[derive(Debug, Default)]
pub struct WorstCases {
    records: BTreeMap<(String, Tried), Record>,
}

impl WorstCases {
    /// Measures both readings in a situation. `candidates` says how long the offline search may take.
    ///
    /// # Errors
    /// The situation is not legal.
    pub fn measure(
        &mut self,
        case: &str,
        tree: &LodTree,
        situation: &Situation,
        settings: &ForesightSettings,
        candidates: u64,
        random: &mut SplitMix64,
    ) -> Result<(), WorstCaseError> {
        let neighbourhood = neighbourhood(situation)?;
        self.worth(case, tree, situation, settings, &neighbourhood)?;
        self.gains(case, tree, situation, settings, &neighbourhood, random)?;
        self.minimum(case, tree, situation, settings, &neighbourhood, candidates)
    }

    fn add(&mut self, case: &str, tried: Tried, nanos: u64, answers: impl Iterator<Item = Judged>) {
        let record = self.records.entry((case.to_owned(), tried)).or_default();
        record.nanos += nanos;
        for judged in answers {
            record.errors.push(judged.error);
            record.evaluations += judged.evaluations;
            record.gaps.extend(judged.gap.filter(|gap| gap.is_finite()));
            record.violations += u64::from(judged.is_violated);
        }
    }

    /// W under `union`.
    fn worth(
        &mut self,
        case: &str,
        tree: &LodTree,
        situation: &Situation,
        settings: &ForesightSettings,
        neighbourhood: &Neighbourhood,
    ) -> Result<(), WorstCaseError> {
        let (truth, weight) = union_by_cut(tree, situation, settings, 0.0, &mut Cut::default());
        let judge = |answer: Answer| Judged::of(&answer, truth, truth, weight, ROUNDING * weight);
        let mut cut = Cut::default();
        for (order, &angle) in ANGLES.iter().enumerate() {
            let tried = Tried::cut("union", order, angle, settings);
            let watch = Stopwatch::start();
            let (value, _) = union_by_cut(tree, situation, settings, angle, &mut cut);
            let nanos = watch.nanos();
            let answer = Answer::bare(value, cut.patches.len() as u64);
            self.add(case, tried, nanos, std::iter::once(judge(answer)));
        }
        for (order, &tolerance) in TOLERANCES.iter().enumerate() {
            let asked = UnionSettings { tolerance, ..UnionSettings::default() };
            let watch = Stopwatch::start();
            let found = union::worth(tree, neighbourhood, &situation.planned, &asked)?;
            let tried = Tried::bounds("union", order, tolerance);
            self.add(case, tried, watch.nanos(), std::iter::once(judge(proven(&found))));
        }
        Ok(())
    }

    /// What single representations add to W under `union`.
    fn gains(
        &mut self,
        case: &str,
        tree: &LodTree,
        situation: &Situation,
        settings: &ForesightSettings,
        neighbourhood: &Neighbourhood,
        random: &mut SplitMix64,
    ) -> Result<(), WorstCaseError> {
        const READING: &str = "union gain";
        let leaf_by_leaf = horizon(tree, situation, settings, 0.0);
        let mut planned = situation.planned.clone();
        let reps = draw(tree, situation, random);
        let mut gains_by = |horizon: &Horizon| -> Vec<f64> {
            reps.iter().map(|&rep| horizon.marginal(tree, &mut planned, rep, 0.0)).collect()
        };
        let truths = gains_by(&leaf_by_leaf);
        let all = gains::of_each(tree, &leaf_by_leaf, &situation.planned, 0.0);
        let best = all.into_iter().fold(0.0, f64::max);
        let (_, weight) = union_by_cut(tree, situation, settings, 0.0, &mut Cut::default());
        let judge = |(answer, &truth): (Answer, &f64)| Judged::of(&answer, truth, truth, best, ROUNDING * weight);
        for (order, &angle) in ANGLES.iter().enumerate() {
            let watch = Stopwatch::start();
            let made = horizon(tree, situation, settings, angle);
            let values = gains_by(&made);
            let nanos = watch.nanos();
            let patches = made.patches() as u64;
            let answers = values.into_iter().map(|value| Answer::bare(value, patches));
            self.add(case, Tried::cut(READING, order, angle, settings), nanos, answers.zip(&truths).map(judge));
        }
        for (order, &tolerance) in TOLERANCES.iter().enumerate() {
            let asked = UnionSettings { tolerance, ..UnionSettings::default() };
            let watch = Stopwatch::start();
            let found = reps
                .iter()
                .map(|&rep| union::gain(tree, neighbourhood, &situation.planned, rep, &asked))
                .collect::<Result<Vec<_>, _>>()?;
            let tried = Tried::bounds(READING, order, tolerance);
            self.add(case, tried, watch.nanos(), found.iter().map(proven).zip(&truths).map(judge));
        }
        Ok(())
    }

    /// W under `minimum`.
    fn minimum(
        &mut self,
        case: &str,
        tree: &LodTree,
        situation: &Situation,
        settings: &ForesightSettings,
        neighbourhood: &Neighbourhood,
        candidates: u64,
    ) -> Result<(), WorstCaseError> {
        const READING: &str = "minimum";
        let targets = Targets::new(tree, neighbourhood, &situation.planned, &settings.cut)?;
        let evaluations_max =
            if candidates < FULL_FROM { OFFLINE_SHORT } else { MinimumSettings::OFFLINE.evaluations_max };
        let searches = [
            ("decision", MinimumSettings::default()),
            ("offline", MinimumSettings { evaluations_max, ..MinimumSettings::OFFLINE }),
        ];
        let mut proofs = Vec::new();
        for (order, (setting, asked)) in searches.into_iter().enumerate() {
            let watch = Stopwatch::start();
            let found = minimum::certified(&targets, neighbourhood, &asked)?;
            let nanos = watch.nanos();
            let is_default = setting == "decision" && settings.worst_case == WorstCaseKind::Minimum;
            let tried = Tried {
                reading: READING,
                method: "branch-and-bound",
                order,
                setting: setting.to_owned(),
                certified: true,
                is_default,
            };
            proofs.push((tried, found, nanos));
        }
        let mut sampled = Vec::new();
        for (order, &samples) in SAMPLES.iter().enumerate() {
            let watch = Stopwatch::start();
            let e = minimum::sampled(&targets, neighbourhood, samples)?;
            let nanos = watch.nanos();
            let (lower, upper) = (e.value - e.error_estimate, e.value + e.error_estimate);
            let answer = Answer { value: e.value, lower, upper, evaluations: u64::from(e.evaluations) };
            let is_default = samples == settings.worst_samples && settings.worst_case == WorstCaseKind::Minimum;
            let setting = format!("samples={samples}");
            let tried = Tried { reading: READING, method: "covering", order, setting, certified: false, is_default };
            sampled.push((tried, answer, nanos));
        }
        // W lies between what is proven and the largest deficit that anybody has met.
        let dense = minimum::sampled(&targets, neighbourhood, CHECKED)?.value;
        let met = sampled.iter().map(|(_, answer, _)| answer.value).fold(dense, f64::min);
        let met = proofs.iter().map(|(_, found, _)| found.worth.value).fold(met, f64::min);
        let least = proofs.iter().map(|(_, found, _)| found.worth.lower).fold(f64::NEG_INFINITY, f64::max).min(met);
        let weight = proofs.iter().map(|(_, found, _)| found.weight).fold(0.0, f64::max);
        // Deficits of single views are good to 10⁻⁹.
        let slack = 1e-9 * (weight + met.abs());
        for (tried, found, nanos) in proofs {
            let judged = Judged::of_weight(&proven(&found.worth), least, met, weight, slack);
            self.add(case, tried, nanos, std::iter::once(judged));
        }
        for (tried, answer, nanos) in sampled {
            // What it says is a lie only if even the mildest truth contradicts it.
            let judged = Judged::of_weight(&answer, least, met, weight, slack);
            self.add(case, tried, nanos, std::iter::once(judged));
        }
        Ok(())
    }

    /// A row a case, method and setting, and over all cases a row a method and setting, in that order.
    pub fn rows(&self) -> Vec<ErrorRow> {
        let mut whole: BTreeMap<&Tried, Record> = BTreeMap::new();
        for ((_, tried), record) in &self.records {
            whole.entry(tried).or_default().merge(record);
        }
        let row = |case: &str, tried: &Tried, record: &Record| {
            Some(ErrorRow {
                reading: Some(tried.reading.to_owned()),
                method: tried.method.to_owned(),
                setting: tried.setting.clone(),
                certified: tried.certified,
                default: tried.is_default,
                ..record.row(case, Kind::Real)?
            })
        };
        let single = self.records.iter().map(|((case, tried), record)| row(case, tried, record));
        let all = whole.iter().map(|(tried, record)| row(ALL, tried, record));
        single.chain(all).flatten().collect()
    }
}

impl Tried {
    fn cut(reading: &'static str, order: usize, angle: f64, settings: &ForesightSettings) -> Tried {
        let is_default = angle == settings.cut.opening && settings.worst_case == WorstCaseKind::Union;
        Tried { reading, method: "cut", order, setting: format!("θ={angle}"), certified: false, is_default }
    }

    fn bounds(reading: &'static str, order: usize, tolerance: f64) -> Tried {
        let setting = format!("tolerance={tolerance:e}");
        Tried { reading, method: "bounds", order, setting, certified: true, is_default: false }
    }
}

/// An answer set against the truth.
struct Judged {
    error: f64,
    gap: Option<f64>,
    evaluations: u64,
    is_violated: bool,
}

impl Judged {
    /// Relative to max(|`high`|, 10⁻⁴ × `best`). The truth lies in [`low`, `high`], give or take `slack`.
    fn of(answer: &Answer, low: f64, high: f64, best: f64, slack: f64) -> Judged {
        Judged {
            error: relative_error(answer.value, high, best),
            gap: Some(share(answer.upper - answer.lower, high, best)),
            evaluations: answer.evaluations,
            is_violated: !answer.meets(low - slack, high + slack),
        }
    }

    /// Relative to Σw.
    fn of_weight(answer: &Answer, low: f64, high: f64, weight: f64, slack: f64) -> Judged {
        let relative = |width: f64| if width == 0.0 { 0.0 } else { width / weight.max(f64::MIN_POSITIVE) };
        Judged {
            error: relative((answer.value - high).abs()),
            gap: Some(relative(answer.upper - answer.lower)),
            evaluations: answer.evaluations,
            is_violated: !answer.meets(low - slack, high + slack),
        }
    }
}

fn proven(found: &Certified) -> Answer {
    let Certified { value, lower, upper, evaluations } = *found;
    Answer { value, lower, upper, evaluations: u64::from(evaluations) }
}

/// N(v, ε) of the situation: everything within the region's reach and angle.
fn neighbourhood(situation: &Situation) -> Result<Neighbourhood, WorstCaseError> {
    match situation.region {
        Region::Reachable { angle, reach, stand_off } => {
            Ok(Neighbourhood::free(situation.view, reach, angle)?.with_stand_off(stand_off))
        }
        Region::Frustum => Neighbourhood::free(situation.view, 0.0, 0.0),
    }
}

/// W and the scaled Σw under `union`, sr, by a cut of opening angle θ; θ = 0 is leaf by leaf.
fn union_by_cut(
    tree: &LodTree,
    situation: &Situation,
    settings: &ForesightSettings,
    opening: f64,
    cut: &mut Cut,
) -> (f64, f64) {
    let made = CutSettings { opening, ..settings.cut };
    union_cut(cut, tree, &situation.view, situation.region, &made);
    let quality = evaluate(tree, cut, &situation.planned, |_| {});
    (cut.scale * quality.benefit, cut.scale * quality.weight)
}

/// The worst case alone as decisions sample it.
fn horizon(tree: &LodTree, situation: &Situation, settings: &ForesightSettings, opening: f64) -> Horizon {
    let made = HorizonSettings {
        alpha: 0.0,
        attenuation: settings.attenuation,
        tolerance: 1e-7,
        cut: CutSettings { opening, ..settings.cut },
    };
    let mut horizon = Horizon::default();
    let worst = (&situation.view, situation.region);
    horizon.make(tree, &situation.planned, &[], &situation.bounds, worst, &made);
    horizon
}

/// Representations that are not planned, in or around the view: those of the leaves of a cut and of what lies above them.
fn draw(tree: &LodTree, situation: &Situation, random: &mut SplitMix64) -> Vec<RepId> {
    let mut cut = Cut::default();
    union_cut(&mut cut, tree, &situation.view, situation.region, &CutSettings::default());
    let mut reps = Vec::new();
    for _ in 0..4 * GAINS {
        if reps.len() == GAINS || cut.patches.is_empty() {
            break;
        }
        let patch = &cut.patches[(random.uniform() * cut.patches.len() as f64) as usize];
        let above: Vec<RepId> = tree.ancestors(patch.node).flat_map(|node| tree.own(node)).collect();
        let chosen = above.get((random.uniform() * above.len() as f64) as usize).copied();
        reps.extend(chosen.filter(|rep| !is_known(&situation.planned, &reps, *rep)));
    }
    reps
}

fn is_known(planned: &Coverage, reps: &[RepId], rep: RepId) -> bool {
    planned.contains(rep) || reps.contains(&rep)
}
