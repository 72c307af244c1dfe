//! Several policies over the same world, path and link, and what came of it.

use crate::bound::whole::{self, Bound, Terms};
use crate::future;
use crate::outcome::{
    AlphaOutcome, Arrival, Comparison, Inputs, Interval, Intervals, Limits, PolicyOutcome, PolicySeries, Pressure,
    RegretOutcome, SCHEMA_VERSION, Series, ShadowPrices, UpperBound,
};
use crate::pressure::Needs;
use crate::replay::{ReplayError, Run, Stage, replay};
use crate::stopwatch::percentiles;
use foresight_scheduler::benefit::coverage::Refinement;
use foresight_scheduler::benefit::cut::{Cut, CutSettings};
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::policy::foresight::{AlphaReport, Constraint};
use foresight_scheduler::policy::specification::PolicySpec;
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_scheduler::state::smallest_closure;
use foresight_scheduler::units::Time;
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{Flight, TICKS_PER_FRAME, tick_time};
use foresight_traces::link::LinkTrace;
use foresight_traces::random::SplitMix64;
use glam::DVec3;
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::collections::BTreeSet;

/// Below this ρ policies cannot differ.
const RHO_WARNED: f64 = 0.1;

/// Memory as asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Memory {
    /// Bytes.
    Bytes(u64),
    /// μ: a multiple of the largest need.
    OfLargestNeed(f64),
}

/// A comparison to be made.
pub struct Plan<'a> {
    /// The world.
    pub tree: &'a LodTree,
    /// Its up, for the map.
    pub up: DVec3,
    /// The camera.
    pub flight: &'a Flight,
    /// The link.
    pub link: &'a LinkTrace,
    /// Offsets into the link, one a replay.
    pub starts: Vec<Time>,
    /// What to compare.
    pub policies: Vec<PolicySpec>,
    /// Replace each policy with an error target by itself as shipped and by the best of these in hindsight.
    pub hindsight_targets: Vec<f64>,
    /// Memory budget.
    pub memory: Memory,
    /// Refinement and first guesses; the budget is set from `memory`.
    pub scheduler: SchedulerSettings,
    /// What the client can do.
    pub client: ClientSettings,
    /// How frames are judged.
    pub judging: CutSettings,
    /// Start with the first need resident.
    pub warm: bool,
    /// Leave the bound out.
    pub without_bound: bool,
    /// Replay what knows path and link once more with what the bound lets cost nothing, to tell what limits `foresight`.
    pub limits: bool,
}

/// Why there is no comparison.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CompareError {
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
    /// A rival in a world of orthoviews.
    #[error(
        "the world has representations that show one direction only, which policy {0} does not tell apart; expected foresight and what follows its objective, or lookahead"
    )]
    Directions(String),
    /// A replay failed.
    #[error("policy {policy}, start at {start_s} s: {source}")]
    Replay {
        /// Its label.
        policy: String,
        /// Into the link.
        start_s: f64,
        /// Why.
        #[source]
        source: ReplayError,
    },
}

/// Seeded offsets into a link: none for a single replay, otherwise one in each of `count` equal parts of its period.
pub fn starts(link: &LinkTrace, count: usize, seed: u64) -> Vec<Time> {
    if count <= 1 {
        return vec![Time::ZERO];
    }
    let mut random = SplitMix64::new(seed);
    let period = link.period().secs();
    (0..count).map(|i| Time::from_secs(period * (i as f64 + random.uniform()) / count as f64)).collect()
}

/// Makes the comparison. `inputs` names what is compared; its figures are filled in here. `progress` is told how many
/// replays of how many are done, from several threads.
pub fn compare(
    plan: &Plan,
    inputs: Inputs,
    progress: impl Fn(usize, usize) + Sync,
) -> Result<Comparison, CompareError> {
    if let Some(blind) = plan.policies.iter().find(|p| plan.tree.has_directions() && !p.tells_directions()) {
        return Err(CompareError::Directions(blind.label.clone()));
    }
    let cuts = plan.flight.cuts(plan.tree, &plan.judging);
    let needs = Needs::new(plan.tree, &cuts);
    let budget = match plan.memory {
        Memory::Bytes(bytes) => bytes,
        Memory::OfLargestNeed(mu) => libm::ceil(mu * needs.largest_bytes as f64) as u64,
    };
    // Members of a sibling group come one after the other: below this not even one of them fits.
    let smallest = smallest_closure(plan.tree, Refinement::Partial).unwrap_or(0);
    if budget < smallest {
        return Err(CompareError::Memory { budget, smallest });
    }
    let preloaded = if plan.warm { first_need(plan.tree, &needs, budget) } else { Vec::new() };
    let mut policies = plan.policies.clone();
    for spec in &plan.policies {
        if spec.has_target() {
            policies.extend(plan.hindsight_targets.iter().map(|&px| spec.with_target(px)));
        }
    }
    // What knows path and link on a link and a client as the bound relaxes them, after the others.
    let relaxed_link = if plan.limits { relaxed(plan.link) } else { None };
    let compared = policies.len();
    let clairvoyant = policies.iter().find(|p| p.label == "clairvoyant").cloned();
    policies.extend(clairvoyant.filter(|_| relaxed_link.is_some()));
    let jobs: Vec<(usize, usize)> =
        (0..policies.len()).flat_map(|p| (0..plan.starts.len()).map(move |s| (p, s))).collect();
    let done = std::sync::atomic::AtomicUsize::new(0);
    let runs: Vec<Run> = jobs
        .par_iter()
        .map(|&(p, s)| {
            let start = plan.starts[s];
            let relaxed = relaxed_link.as_ref().filter(|_| p >= compared);
            let link = relaxed.unwrap_or(plan.link);
            let refinement = if relaxed.is_some() { Refinement::Partial } else { plan.scheduler.refinement };
            let stage = Stage {
                tree: plan.tree,
                flight: plan.flight,
                cuts: &cuts,
                link,
                link_start: start,
                client: if relaxed.is_some() { ClientSettings::unlimited() } else { plan.client },
                scheduler: SchedulerSettings { budget, refinement, ..plan.scheduler },
                preloaded: &preloaded,
            };
            let policy = future::build(&policies[p], plan.tree, plan.flight, link, start);
            let run = replay(stage, policy).map_err(|source| CompareError::Replay {
                policy: policies[p].label.clone(),
                start_s: start.secs(),
                source,
            })?;
            progress(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1, jobs.len());
            Ok(run)
        })
        .collect::<Result<_, CompareError>>()?;
    let by_policy: Vec<&[Run]> = runs.chunks(plan.starts.len()).collect();
    let mut outcomes: Vec<(PolicyOutcome, usize)> =
        by_policy.iter().enumerate().map(|(p, runs)| (outcome(&policies[p], runs), p)).collect();
    let relaxed_quality = outcomes.split_off(compared).pop().and_then(|(outcome, _)| outcome.mean_quality);
    keep_best_targets(&mut outcomes, &policies, plan.policies.len());

    let bounds = if plan.without_bound { Vec::new() } else { bounds(plan, &cuts, budget, &preloaded) };
    let nonempty = cuts.iter().filter(|c| c.total_weight > 0.0).count();
    let delivered: Vec<f64> =
        plan.starts.iter().map(|&s| plan.link.bytes_deliverable(s, s + plan.flight.duration()) as f64).collect();
    let duration_s = plan.flight.duration().secs();
    let pressure = Pressure {
        lambda: needs.newly_needed_bytes(plan.tree, budget) as f64 / (duration_s * plan.link.mean_rate()),
        rho: needs.union_bytes as f64 / mean(&delivered).unwrap_or(0.0).max(1.0),
        mu: budget as f64 / needs.largest_bytes.max(1) as f64,
        largest_need_bytes: needs.largest_bytes,
    };
    let mut warnings = Vec::new();
    if nonempty == 0 {
        warnings.push("nothing is ever in view: quality is undefined; place the path elsewhere".to_owned());
    } else if pressure.rho < RHO_WARNED {
        let times = 1.0 / RHO_WARNED;
        warnings.push(if pressure.mu < 1.0 {
            format!(
                "ρ = {:.3}: the link delivers more than {times:.0} times what the path needs, so policies differ after start-up \
                 only by what they keep in a memory of μ = {:.2}",
                pressure.rho, pressure.mu
            )
        } else {
            format!(
                "ρ = {:.3}: the link delivers more than {times:.0} times what the path needs, so policies cannot differ after \
                 start-up",
                pressure.rho
            )
        });
    }
    let shown: Vec<(&str, &Run)> =
        outcomes.iter().map(|(outcome, p)| (outcome.name.as_str(), &by_policy[*p][0])).collect();
    let series = series(plan, &bounds, &shown);
    let upper_bound = UpperBound::new(&bounds);
    let policies: Vec<PolicyOutcome> = outcomes.into_iter().map(|(outcome, _)| outcome).collect();
    let brought: Vec<Vec<f64>> = plan.starts.iter().map(|&start| brought(plan, start)).collect();
    Ok(Comparison {
        schema_version: SCHEMA_VERSION,
        inputs: Inputs {
            representations: plan.tree.representations() as u64,
            path_hash: path_hash(plan.flight),
            link_hash: plan.link.hash().to_hex().to_string(),
            duration_s,
            memory_bytes: budget,
            warm: plan.warm,
            starts_s: plan.starts.iter().map(|s| s.secs()).collect(),
            ..inputs
        },
        pressure,
        nonempty_share: nonempty as f64 / cuts.len() as f64,
        shadow_prices: ShadowPrices::new(&bounds, &brought, budget),
        limits: Limits::of(&policies, relaxed_quality, &upper_bound),
        upper_bound,
        policies,
        warnings,
        series,
    })
}

/// The first frame's needs as far as they fit.
fn first_need(tree: &LodTree, needs: &Needs, budget: u64) -> Vec<RepId> {
    let mut used = 0;
    let mut first = needs.frames.iter().find(|f| !f.is_empty()).cloned().unwrap_or_default();
    // A prerequisite has the lower id: it is there, or left out, before what needs it.
    first.sort_unstable();
    let mut kept = BTreeSet::new();
    for rep in first {
        let usable = tree.prerequisite(rep).is_none_or(|p| kept.contains(&p));
        if usable && used + tree.decoded_bytes(rep) <= budget {
            used += tree.decoded_bytes(rep);
            kept.insert(rep);
        }
    }
    kept.into_iter().collect()
}

/// Of each policy's variants in hindsight, keeps the one with the least deficit, under a name that says so.
fn keep_best_targets(outcomes: &mut Vec<(PolicyOutcome, usize)>, policies: &[PolicySpec], shipped: usize) {
    if outcomes.len() == shipped {
        return;
    }
    let deficit = |o: &PolicyOutcome| o.mean_deficit.unwrap_or(1.0);
    let variants = outcomes.split_off(shipped);
    for (place, spec) in policies[..shipped].iter().enumerate().rev() {
        if !spec.has_target() {
            continue;
        }
        let is_variant = |p: usize| policies[p].label.rsplit_once(":target=").is_some_and(|(of, _)| of == spec.label);
        let best =
            variants.iter().filter(|(_, p)| is_variant(*p)).min_by(|a, b| deficit(&a.0).total_cmp(&deficit(&b.0)));
        if let Some((best, p)) = best {
            let mut best = best.clone();
            best.name = format!("{} (best)", best.name);
            outcomes.insert(place + 1, (best, *p));
        }
    }
}

/// The link without latency and failures.
fn relaxed(link: &LinkTrace) -> Option<LinkTrace> {
    link.with_rtt(Time::ZERO).and_then(|link| link.with_loss(0.0, 0)).ok()
}

/// Bytes that the link can bring between each frame and the one before.
fn brought(plan: &Plan, start: Time) -> Vec<f64> {
    let at = |frame: u64| start + tick_time(frame * TICKS_PER_FRAME);
    let frames = 0..plan.flight.frames() as u64;
    frames.map(|f| plan.link.bytes_deliverable(at(f.saturating_sub(1)), at(f)) as f64).collect()
}

/// The upper bounds, one a start.
fn bounds(plan: &Plan, cuts: &[Cut], budget: u64, preloaded: &[RepId]) -> Vec<Bound> {
    let at_start = preloaded.iter().map(|&r| plan.tree.wire_bytes(r)).sum();
    whole::bounds(&Terms { tree: plan.tree, cuts, link: plan.link, at_start, budget }, &plan.starts)
}

/// What a policy reached, averaged over the starts.
pub(crate) fn outcome(spec: &PolicySpec, runs: &[Run]) -> PolicyOutcome {
    let figures: Vec<Figures> = runs.iter().map(Figures::new).collect();
    let all = |figure: fn(&Figures) -> Option<f64>| -> Vec<Option<f64>> { figures.iter().map(figure).collect() };
    let average = |figure| {
        let values = all(figure);
        // A mean over those that reached it would flatter the others.
        values.iter().copied().collect::<Option<Vec<f64>>>().and_then(|v| mean(&v))
    };
    let spread = |figure| interval(&all(figure));
    let mut nanos: Vec<u64> = runs.iter().flat_map(|r| r.decision_nanos.iter().copied()).collect();
    PolicyOutcome {
        name: spec.label.clone(),
        mean_quality: average(|f| f.mean_quality),
        mean_deficit: average(|f| f.mean_deficit),
        mean_deficit_by_start: all(|f| f.mean_deficit),
        p05_quality: average(|f| f.p05_quality),
        seconds_below_0_9: average(|f| f.seconds_below_0_9).unwrap_or(0.0),
        seconds_to_0_9: average(|f| f.seconds_to_0_9),
        share_within_16px: average(|f| f.share_within_16px),
        bytes_fetched: average(|f| f.bytes_fetched).unwrap_or(0.0),
        bytes_wasted: average(|f| f.bytes_wasted).unwrap_or(0.0),
        bytes_cancelled: average(|f| f.bytes_cancelled).unwrap_or(0.0),
        failures: average(|f| f.failures).unwrap_or(0.0),
        evictions: average(|f| f.evictions).unwrap_or(0.0),
        decisions: average(|f| f.decisions).unwrap_or(0.0),
        decision_ns: percentiles(&mut nanos),
        regret: RegretOutcome::of(runs.iter().flat_map(|r| r.regrets.iter().copied()).collect()),
        alpha: spec.alpha_rule().and_then(|rule| AlphaOutcome::of(rule, runs)),
        interval: (runs.len() > 1).then(|| Intervals {
            mean_quality: spread(|f| f.mean_quality),
            mean_deficit: spread(|f| f.mean_deficit),
            p05_quality: spread(|f| f.p05_quality),
            seconds_below_0_9: spread(|f| f.seconds_below_0_9),
            seconds_to_0_9: spread(|f| f.seconds_to_0_9),
            share_within_16px: spread(|f| f.share_within_16px),
            bytes_fetched: spread(|f| f.bytes_fetched),
            bytes_wasted: spread(|f| f.bytes_wasted),
            bytes_cancelled: spread(|f| f.bytes_cancelled),
            evictions: spread(|f| f.evictions),
        }),
    }
}

impl AlphaOutcome {
    /// Over the starts; `None` if a policy says nothing of its α.
    fn of(rule: &'static str, runs: &[Run]) -> Option<AlphaOutcome> {
        let reports: Vec<AlphaReport> = runs.iter().map(|run| run.alpha).collect::<Option<_>>()?;
        let over = |figure: fn(&AlphaReport) -> Option<f64>| -> Option<f64> {
            mean(&reports.iter().map(figure).collect::<Option<Vec<_>>>()?)
        };
        let constraints: Vec<Constraint> = reports.iter().filter_map(|r| r.constraint).collect();
        let stands = |good: &[Constraint]| constraints.iter().filter(|c| good.contains(c)).count();
        let has_target = !constraints.is_empty();
        Some(AlphaOutcome {
            rule,
            mean: over(|r| Some(r.mean_alpha))?,
            settled: over(|r| Some(r.settled_alpha))?,
            oscillation: over(|r| Some(r.oscillation))?,
            mean_worst_quality: over(|r| r.mean_worst_quality),
            settled_worst_quality: over(|r| r.settled_worst_quality),
            at_least: over(|r| r.target),
            constraint: constraints.iter().map(|c| c.name()).collect(),
            converged: has_target.then(|| stands(&[Constraint::Met, Constraint::Slack]) == constraints.len()),
            infeasible: has_target.then(|| stands(&[Constraint::Infeasible]) > 0),
        })
    }
}

/// One replay's figures. Frames are evenly spaced, so a mean over frames is a mean over time.
struct Figures {
    mean_quality: Option<f64>,
    mean_deficit: Option<f64>,
    p05_quality: Option<f64>,
    seconds_below_0_9: Option<f64>,
    seconds_to_0_9: Option<f64>,
    share_within_16px: Option<f64>,
    bytes_fetched: Option<f64>,
    bytes_wasted: Option<f64>,
    bytes_cancelled: Option<f64>,
    failures: Option<f64>,
    evictions: Option<f64>,
    decisions: Option<f64>,
}

impl Figures {
    fn new(run: &Run) -> Figures {
        let frame_s = tick_time(TICKS_PER_FRAME).secs();
        let mut qualities: Vec<f64> = run.frames.iter().filter_map(|f| f.mean()).collect();
        let within: Vec<f64> =
            run.frames.iter().filter(|f| f.weight > 0.0).map(|f| (f.within_target / f.weight).min(1.0)).collect();
        let reached = run.frames.iter().position(|f| f.mean().is_some_and(|q| q >= 0.9));
        let below = qualities.iter().filter(|q| **q < 0.9).count();
        let mean_quality = mean(&qualities);
        qualities.sort_by(f64::total_cmp);
        let p05 = qualities.get((qualities.len() * 5).div_ceil(100).saturating_sub(1)).copied();
        Figures {
            mean_quality,
            mean_deficit: mean_quality.map(|q| 1.0 - q),
            p05_quality: p05,
            seconds_below_0_9: Some(below as f64 * frame_s),
            seconds_to_0_9: reached.map(|frame| frame as f64 * frame_s),
            share_within_16px: mean(&within),
            bytes_fetched: Some(run.bytes_fetched as f64),
            bytes_wasted: Some(run.bytes_wasted as f64),
            bytes_cancelled: Some(run.bytes_cancelled as f64),
            failures: Some(run.failures as f64),
            evictions: Some(run.evictions as f64),
            decisions: Some(run.decisions as f64),
        }
    }
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// 95 % interval of the mean by Student's t; `None` if a value is missing or there is only one.
pub(crate) fn interval(values: &[Option<f64>]) -> Option<Interval> {
    let values: Vec<f64> = values.iter().copied().collect::<Option<_>>()?;
    let n = values.len() as f64;
    let centre = mean(&values).filter(|_| values.len() > 1)?;
    let variance = values.iter().map(|v| (v - centre) * (v - centre)).sum::<f64>() / (n - 1.0);
    let t = StudentsT::new(0.0, 1.0, n - 1.0).ok()?.inverse_cdf(0.975);
    let half = t * (variance / n).sqrt();
    Some(Interval { lower: centre - half, upper: centre + half })
}

fn path_hash(flight: &Flight) -> String {
    let mut hasher = blake3::Hasher::new();
    for view in &flight.views {
        let (p, q) = (view.position, view.orientation);
        for value in [p.x, p.y, p.z, q.x, q.y, q.z, q.w, view.fov_y] {
            hasher.update(&value.to_le_bytes());
        }
        for side in view.viewport {
            hasher.update(&side.to_le_bytes());
        }
    }
    hasher.finalize().to_hex().to_string()
}

/// Series of the first start, for the report.
fn series(plan: &Plan, bounds: &[Bound], runs: &[(&str, &Run)]) -> Series {
    let start = plan.starts[0];
    let seconds = libm::ceil(plan.flight.duration().secs()) as u64;
    let second = |s: u64| Time(s * 1_000_000_000);
    let east = plan.up.any_orthonormal_vector();
    // Towards +x where the world's up allows, so that maps of z-up worlds have their usual axes.
    let east = (DVec3::X - plan.up * plan.up.x).try_normalize().unwrap_or(east);
    let north = plan.up.cross(east);
    let flat = |p: DVec3| [east.dot(p), north.dot(p)];
    let frames: Vec<u64> = (0..plan.flight.frames() as u64).map(|f| f * TICKS_PER_FRAME).collect();
    let frames_per_second = (foresight_traces::flight::TICKS_PER_SECOND / TICKS_PER_FRAME) as usize;
    Series {
        frame_s: frames.iter().map(|&t| tick_time(t).secs()).collect(),
        bound: bounds.first().map(|b| b.frames.clone()).unwrap_or_default(),
        path_xy: frames.iter().map(|&t| flat(plan.flight.views[t as usize].position)).collect(),
        second_s: (0..seconds).map(|s| s as f64).collect(),
        capacity_bytes: (0..seconds)
            .map(|s| plan.link.bytes_deliverable(start + second(s), start + second(s + 1)) as f64)
            .collect(),
        policies: runs
            .iter()
            .map(|&(name, run)| PolicySeries {
                name: name.to_owned(),
                quality: run.frames.iter().map(|f| f.mean()).collect(),
                memory_bytes: run.memory.clone(),
                used_bytes: (0..seconds as usize)
                    .map(|s| {
                        let at = |second: usize| {
                            run.received.get(second * frames_per_second).or(run.received.last()).copied().unwrap_or(0)
                        };
                        (at(s + 1) - at(s)) as f64
                    })
                    .collect(),
                arrivals: run
                    .completions
                    .iter()
                    .map(|c| {
                        let node = plan.tree.node_of(c.rep);
                        let half = plan.tree.half(node);
                        let extent = |axis: DVec3| axis.abs().dot(half);
                        Arrival {
                            at_s: c.at.secs(),
                            centre: flat(plan.tree.centre(node)),
                            half: [extent(east), extent(north)],
                            depth: plan.tree.ancestors(node).count() as u32 - 1,
                        }
                    })
                    .collect(),
            })
            .collect(),
    }
}
