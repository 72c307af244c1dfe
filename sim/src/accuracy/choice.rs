//! Choosing the best candidate: by evaluating all, by one pass over sampled patches, by branch and bound; and what each
//! choice is worth leaf by leaf under a fine quadrature.

use super::gains;
use super::outcome::ChoiceRow;
use super::situation::Situation;
use crate::stopwatch::Stopwatch;
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::policy::foresight::{ChoiceMethod, ForesightSettings};
use foresight_scheduler::predict::PredictedPath;
use foresight_scheduler::select::certified::{
    Ask, Instance, Link, Objective, ObjectiveSettings, Ranked, Search, Standing, certified_winner, closure,
    exhaustive_winner,
};
use foresight_scheduler::select::horizon::{Horizon, HorizonSettings};

/// Regrets tolerated by branch and bound; 0 asks for the exhaustive winner.
const CERTIFIED: [f64; 5] = [0.0, 1e-4, 1e-3, 1e-2, 1e-1];
/// Finer estimators than decisions use, at the tolerance that they use: whether with eight times as many intervals of time,
/// the opening angle, and the name.
const FINER: [(bool, f64, &str); 4] = [
    (false, 0.1, "certified, θ = 0.1"),
    (false, 0.0, "certified, leaf by leaf"),
    (true, 0.3, "certified, 8× the intervals"),
    (true, 0.1, "certified, 8× the intervals, θ = 0.1"),
];
/// Shares of the winner's gain below which sampled groups are not opened.
const SAMPLED: [f64; 3] = [1.0, 0.1, 0.01];
/// Bounds of that gain, sr, as the policy has them.
const GROUPING: (f64, f64) = (1e-7, 2e-3);
/// Regret at which the finest choice is found.
const FINEST: f64 = 1e-4;
/// Candidates evaluated in one situation, at most: fewer decisions in a larger world.
const EVALUATED_MOST: usize = 400_000;
/// Ratios closer than this, relative, are equal: sums in another order.
const ROUNDING: f64 = 1e-9;

const ALL: &str = "all";

#[derive(Clone, Copy, Debug, PartialEq)]
enum Method {
    Exhaustive,
    Certified(f64),
    Sampled(f64),
    /// A place in [`FINER`], and the tolerance.
    Finer(usize, f64),
}

/// What a method chose over the decisions of a case.
#[derive(Clone, Debug, Default)]
struct Record {
    wrong: u64,
    decisions: u64,
    max_regret: f64,
    /// Largest and sum under the finest reference.
    max_fine: f64,
    sum_fine: f64,
    nanos: u64,
    evaluated: u64,
}

/// Choices by every method, case by case.
#[derive(Debug)]
pub struct Choices {
    methods: Vec<(Method, bool)>,
    cases: Vec<(String, Vec<Record>)>,
}

impl Choices {
    /// The methods, of which `settings` names the one that decisions use.
    pub fn new(settings: &ForesightSettings) -> Choices {
        let by = settings.choice;
        let certified =
            CERTIFIED.map(|t| (Method::Certified(t), by == ChoiceMethod::Certified && t == settings.tolerance));
        let sampled = SAMPLED.map(|t| (Method::Sampled(t), by == ChoiceMethod::Sampled && t == settings.grouping));
        let finer = (0..FINER.len()).map(|which| (Method::Finer(which, settings.tolerance), false));
        let methods =
            std::iter::once((Method::Exhaustive, false)).chain(sampled).chain(certified).chain(finer).collect();
        Choices { methods, cases: Vec::new() }
    }

    /// `decisions` choices in a row in a situation, each after the exhaustive winner of the one before is planned; fewer
    /// in a large world, or if nothing gains any more.
    pub fn measure(
        &mut self,
        case: &str,
        tree: &LodTree,
        situation: &Situation,
        settings: &ForesightSettings,
        decisions: usize,
    ) {
        if self.cases.last().is_none_or(|(name, _)| name != case) {
            self.cases.push((case.to_owned(), vec![Record::default(); self.methods.len()]));
        }
        let Some((_, records)) = self.cases.last_mut() else { return };
        let mut coarse = instance(tree, situation, settings, false, settings.cut.opening);
        let mut fine = instance(tree, situation, settings, true, 0.0);
        let mut finer = FINER.map(|(fine, opening, _)| instance(tree, situation, settings, fine, opening));
        for _ in 0..decisions.min(EVALUATED_MOST.div_ceil(tree.representations().max(1))) {
            let watch = Stopwatch::start();
            let best = exhaustive_winner(&mut coarse);
            let nanos = watch.nanos();
            let Some(winner) = best.rep else { return };
            let gain = ranked(&mut coarse, winner).map_or(0.0, |r| r.gain);
            let finest = certified_winner(&mut fine, FINEST);
            for ((method, _), record) in self.methods.iter().zip(records.iter_mut()) {
                // What is proven of a choice by another estimator.
                let mut proven = None;
                let (chosen, evaluated, nanos) = match *method {
                    Method::Exhaustive => (Some(winner), tree.representations() as u64, nanos),
                    Method::Certified(tolerance) => {
                        let watch = Stopwatch::start();
                        let found = certified_winner(&mut coarse, tolerance);
                        (found.rep, found.certificate.evaluations, watch.nanos())
                    }
                    Method::Finer(which, tolerance) => {
                        let watch = Stopwatch::start();
                        let found = certified_winner(&mut finer[which], tolerance);
                        let nanos = watch.nanos();
                        let missed = found.certificate.regret;
                        proven = Some(if missed > tolerance { missed } else { 0.0 });
                        (found.rep, found.certificate.evaluations, nanos)
                    }
                    Method::Sampled(share) => {
                        let tolerance = (share * gain).clamp(GROUPING.0, GROUPING.1);
                        let watch = Stopwatch::start();
                        let (rep, patches) = sampled_winner(&coarse, situation, settings, tolerance);
                        (rep, patches as u64, watch.nanos())
                    }
                };
                let worth =
                    |instance: &mut Instance| chosen.and_then(|rep| ranked(instance, rep)).map_or(0.0, |r| r.ratio);
                let regret = proven.unwrap_or_else(|| regret(worth(&mut coarse), best.ratio));
                // The finest choice is known to a tolerance: what is better than it has no regret.
                let of_fine = self::regret(worth(&mut fine), finest.ratio);
                record.decisions += 1;
                record.wrong += u64::from(regret > 0.0);
                record.max_regret = record.max_regret.max(regret);
                record.max_fine = record.max_fine.max(of_fine);
                record.sum_fine += of_fine;
                record.nanos += nanos;
                record.evaluated += evaluated;
            }
            for instance in [&mut coarse, &mut fine].into_iter().chain(&mut finer) {
                let members = ranked(instance, winner).map_or_else(Vec::new, |r| r.members);
                for member in members {
                    instance.standing.insert(tree, member);
                }
            }
        }
    }

    /// A row a case and method, and over all cases a row a method, in that order.
    pub fn rows(&self) -> Vec<ChoiceRow> {
        let mut whole = vec![Record::default(); self.methods.len()];
        for (method, record) in self.cases.iter().flat_map(|(_, records)| records.iter().enumerate()) {
            whole[method].merge(record);
        }
        let single = self.cases.iter().flat_map(|(case, records)| self.of_case(case, records));
        single.chain(self.of_case(ALL, &whole)).collect()
    }

    fn of_case(&self, case: &str, records: &[Record]) -> Vec<ChoiceRow> {
        let row = |((method, is_default), record): (&(Method, bool), &Record)| {
            let (name, tolerance, certified) = match *method {
                Method::Exhaustive => ("exhaustive", 0.0, true),
                Method::Certified(tolerance) => ("certified", tolerance, true),
                Method::Sampled(share) => ("sampled", share, false),
                Method::Finer(which, tolerance) => (FINER[which].2, tolerance, true),
            };
            let count = record.decisions.max(1) as f64;
            ChoiceRow {
                case: case.to_owned(),
                method: name.to_owned(),
                tolerance,
                certified,
                default: *is_default,
                wrong_choices: record.wrong,
                decisions: record.decisions,
                max_regret: record.max_regret,
                max_regret_reference: (record.decisions > 0).then_some(record.max_fine),
                mean_regret_reference: (record.decisions > 0).then_some(record.sum_fine / count),
                ns_per_decision: record.nanos as f64 / count,
                candidates_evaluated: record.evaluated as f64 / count,
            }
        };
        self.methods.iter().zip(records).filter(|(_, record)| record.decisions > 0).map(row).collect()
    }
}

impl Record {
    fn merge(&mut self, other: &Record) {
        self.wrong += other.wrong;
        self.decisions += other.decisions;
        self.max_regret = self.max_regret.max(other.max_regret);
        self.max_fine = self.max_fine.max(other.max_fine);
        self.sum_fine += other.sum_fine;
        self.nanos += other.nanos;
        self.evaluated += other.evaluated;
    }
}

/// (best − chosen) ÷ best; 0 within rounding.
fn regret(chosen: f64, best: f64) -> f64 {
    let missed = best - chosen;
    if best > 0.0 && missed > ROUNDING * best { missed / best } else { 0.0 }
}

/// The choice of a situation, by as many intervals as decisions use or by many, with groups opened to `opening`.
fn instance<'a>(
    tree: &'a LodTree,
    situation: &Situation,
    settings: &ForesightSettings,
    fine: bool,
    opening: f64,
) -> Instance<'a> {
    let (bounds, paths): (&[f64], &[PredictedPath]) =
        if fine { (&situation.fine.0, &situation.fine.1) } else { (&situation.bounds, &situation.middles) };
    let made = ObjectiveSettings {
        alpha: settings.alpha,
        attenuation: settings.attenuation,
        cut: CutSettings { opening, ..settings.cut },
    };
    let mut objective = Objective::default();
    let worst = (&situation.view, situation.region);
    objective.make(tree, paths, bounds, worst, &made);
    let link = Link {
        seconds_per_byte: 1.0 / situation.rate,
        request_cost_s: settings.request_cost_s,
        first_byte_s: situation.first_byte_s,
        arrival_per_byte_s: 1.0 / situation.rate,
        arrival: None,
    };
    Instance { tree, standing: Standing::new(tree, situation.planned.clone()), objective, link }
}

/// A candidate's exact gain and ratio.
fn ranked(instance: &mut Instance, rep: RepId) -> Option<Ranked> {
    let Instance { tree, standing, objective, link } = instance;
    Search::default().exact(&Ask { tree, objective, link: *link, allowed: &|_| true }, standing, rep)
}

/// The candidate with the largest gain per second of link by one pass over the patches of every predicted view, groups
/// opened down to `tolerance`; and the number of patches.
fn sampled_winner(
    instance: &Instance,
    situation: &Situation,
    settings: &ForesightSettings,
    tolerance: f64,
) -> (Option<RepId>, usize) {
    let tree = instance.tree;
    let plan = instance.standing.plan();
    let made =
        HorizonSettings { alpha: settings.alpha, attenuation: settings.attenuation, tolerance, cut: settings.cut };
    let mut horizon = Horizon::default();
    let worst = (&situation.view, situation.region);
    horizon.make(tree, plan, &situation.middles, &situation.bounds, worst, &made);
    let gains = gains::of_each(tree, &horizon, plan, instance.link.arrival_of(0));
    // Ranked by these bounds, evaluated with their own arrival until none can be better.
    let ratio_of = |members: &[RepId], gain: f64| gain / instance.link.cost(tree, members).max(f64::MIN_POSITIVE);
    let mut order: Vec<(f64, RepId)> = (0..gains.len() as u32)
        .map(RepId)
        .filter(|rep| gains[rep.index()] > 0.0)
        .map(|rep| {
            let members = closure(tree, &instance.standing, rep);
            (ratio_of(&members, members.iter().map(|m| gains[m.index()]).sum()), rep)
        })
        .collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut hypothetical = plan.clone();
    let mut best: Option<(f64, RepId)> = None;
    for (bound, rep) in order {
        if best.is_some_and(|(ratio, _)| ratio >= bound) {
            break;
        }
        let members = closure(tree, &instance.standing, rep);
        let bytes: u64 = members.iter().map(|&m| tree.wire_bytes(m)).sum();
        let offset = instance.link.arrival_of(bytes);
        let mut gain = 0.0;
        for &member in &members {
            gain += horizon.marginal(tree, &mut hypothetical, member, offset);
            hypothetical.insert(tree, member);
        }
        for &member in &members {
            hypothetical.remove(tree, member);
        }
        let ratio = ratio_of(&members, gain);
        if ratio > 0.0 && best.is_none_or(|(r, _)| ratio > r) {
            best = Some((ratio, rep));
        }
    }
    (best.map(|(_, rep)| rep), horizon.patches())
}
