//! What grouping costs: gains by patches of an opening angle θ against gains leaf by leaf, under the same samples in time.

use super::gains;
use super::outcome::{ErrorRow, Kind};
use super::record::Record;
use super::situation::Situation;
use super::statistics::relative_error;
use crate::stopwatch::Stopwatch;
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::lod_tree::{LodTree, NodeId, RepId};
use foresight_scheduler::policy::foresight::ForesightSettings;
use foresight_scheduler::select::horizon::{Horizon, HorizonSettings};
use foresight_traces::random::SplitMix64;

/// Opening angles measured, beside the default.
const ANGLES: [f64; 5] = [0.6, 0.3, 0.15, 0.075, 0.0375];

/// Share of a steradian beneath which a group is not opened further: the finest that decisions use.
const TOLERANCE: f64 = 1e-7;

/// Errors of one opening angle over the candidates of one case.
pub struct Grouped {
    setting: String,
    is_default: bool,
    record: Record,
}

/// Sets each opening angle against leaf by leaf on `count` representations drawn by `seed` in each situation.
pub fn measure(
    tree: &LodTree,
    situations: &[Situation],
    settings: &ForesightSettings,
    count: usize,
    seed: u64,
) -> Vec<Grouped> {
    let mut angles = ANGLES.to_vec();
    if !angles.contains(&settings.cut.opening) {
        angles.push(settings.cut.opening);
    }
    angles.sort_by(|a, b| b.total_cmp(a));
    let mut rows: Vec<Grouped> = angles
        .iter()
        .map(|&angle| Grouped {
            setting: format!("θ={angle}"),
            is_default: angle == settings.cut.opening,
            record: Record::default(),
        })
        .collect();
    for (i, situation) in situations.iter().enumerate() {
        let mut random = SplitMix64::new(seed ^ (i as u64) << 32);
        let exact = Sampled::new(tree, situation, settings, 0.0);
        let all = gains::of_each(tree, &exact.horizon, &situation.planned, exact.arrival_s);
        let best = all.iter().copied().fold(0.0, f64::max);
        let reps = draw(tree, situation, &all, count, &mut random);
        let truth: Vec<f64> = exact.gains(tree, situation, &reps);
        for (row, &angle) in rows.iter_mut().zip(&angles) {
            let watch = Stopwatch::start();
            let sampled = Sampled::new(tree, situation, settings, angle);
            let values = sampled.gains(tree, situation, &reps);
            row.record.nanos += watch.nanos();
            row.record.evaluations += sampled.horizon.patches() as u64 * reps.len() as u64;
            row.record.errors.extend(values.iter().zip(&truth).map(|(v, t)| relative_error(*v, *t, best)));
        }
    }
    rows
}

/// A row for `case`.
pub fn row(case: &str, grouped: &Grouped) -> Option<ErrorRow> {
    rows_of(case, &[grouped])
}

/// A row an opening angle over all cases.
pub fn over_all(cases: &[Vec<Grouped>]) -> Vec<ErrorRow> {
    let angles = cases.first().map_or(0, Vec::len);
    (0..angles)
        .filter_map(|i| rows_of("all", &cases.iter().filter_map(|case| case.get(i)).collect::<Vec<_>>()))
        .collect()
}

/// A row over several cases; all are of one setting.
fn rows_of(case: &str, grouped: &[&Grouped]) -> Option<ErrorRow> {
    let first = grouped.first()?;
    let mut record = Record::default();
    grouped.iter().for_each(|g| record.merge(&g.record));
    Some(ErrorRow {
        method: "grouping".to_owned(),
        setting: first.setting.clone(),
        default: first.is_default,
        ..record.row(case, Kind::Real)?
    })
}

/// The objective sampled for a situation, the predicted paths alone.
struct Sampled {
    horizon: Horizon,
    arrival_s: f64,
}

impl Sampled {
    fn new(tree: &LodTree, situation: &Situation, settings: &ForesightSettings, opening: f64) -> Sampled {
        let horizon = HorizonSettings {
            alpha: 1.0,
            attenuation: settings.attenuation,
            tolerance: TOLERANCE,
            cut: CutSettings { opening, ..settings.cut },
        };
        let mut sampled = Sampled { horizon: Horizon::default(), arrival_s: situation.arrival_s };
        let worst = (&situation.view, situation.region);
        sampled.horizon.make(tree, &situation.planned, &situation.middles, &situation.bounds, worst, &horizon);
        sampled
    }

    fn gains(&self, tree: &LodTree, situation: &Situation, reps: &[RepId]) -> Vec<f64> {
        let mut planned = situation.planned.clone();
        reps.iter().map(|&rep| self.horizon.marginal(tree, &mut planned, rep, self.arrival_s)).collect()
    }
}

/// Representations that are not planned: a third of any, a third coarse ones, a third of those that gain.
fn draw(tree: &LodTree, situation: &Situation, gains: &[f64], count: usize, random: &mut SplitMix64) -> Vec<RepId> {
    let gaining: Vec<RepId> = (0..gains.len() as u32).map(RepId).filter(|rep| gains[rep.index()] > 0.0).collect();
    let total = tree.representations();
    let mut reps = Vec::with_capacity(count);
    // What is planned is drawn again, a bounded number of times: all of a small world may be planned.
    for draw in 0..4 * count {
        if reps.len() == count || total == 0 {
            break;
        }
        let any = RepId((random.uniform() * total as f64) as u32);
        let rep = match draw % 3 {
            0 => any,
            1 => coarser(tree, tree.node_of(any), random).unwrap_or(any),
            _ => gaining.get((random.uniform() * gaining.len() as f64) as usize).copied().unwrap_or(any),
        };
        if !situation.planned.contains(rep) {
            reps.push(rep);
        }
    }
    reps
}

/// The coarsest representation of some node above.
fn coarser(tree: &LodTree, node: NodeId, random: &mut SplitMix64) -> Option<RepId> {
    let above: Vec<NodeId> = tree.ancestors(node).collect();
    let chosen = above.get((random.uniform() * above.len() as f64) as usize)?;
    tree.own(*chosen).next()
}
