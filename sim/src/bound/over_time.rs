//! The replay as one facility-location problem over time, relaxed upwards, and its Lagrangian dual.
//!
//! Time is cut into steps t. x_rt says whether r is resident at some moment of step t, z_rt whether it comes in it, c_rt
//! whether it is carried into it from the step before. Every policy keeps
//!
//! ```text
//! x_rt ≤ c_rt + z_rt,   c_rt ≤ x_r(t−1),   c_r0 = 0          what was there at the start counts as come, and as delivered
//! Σ_r M_r Σ_{s≤t} z_rs ≤ W_t                                  deliverable by the end of step t
//! Σ_r m_r c_rt ≤ B                                            memory at the step's beginning
//! Q_t ≤ Σ_ℓ w_ℓt Σ_r a_rℓt y_rℓt,   y_rℓt ≤ x_rt,   Σ_r y_rℓt ≤ 1     mean quality in the step
//! Q_t ≤ A_t                                                   the mean of the step's own frame bounds
//! ```
//!
//! because a frame shows no more than all that is resident at some moment of its step, and what is resident then was
//! resident at the step's beginning or came in it. For any prices λ_t, μ_t, v_ℓt ≥ 0 and θ_t in [0, 1], with
//! Λ_t = Σ_{s≥t} λ_s, the mean quality is therefore at most
//!
//! ```text
//! Σ λ_t W_t + Σ μ_t B + Σ θ_t A_t + Σ (1−θ_t) w_ℓt v_ℓt
//!   + Σ_r max over patterns of Σ_t [ (1−θ_t) Σ_ℓ w_ℓt (a_rℓt − v_ℓt)⁺ x_rt − μ_t m_r c_rt − Λ_t M_r z_rt ],
//! ```
//!
//! each maximum by dynamic programming along time (in or out). A pattern never lets r come before W_t holds what r needs
//! first and r itself. What lies beneath a closed group is one more facility without error, of which any part can be had:
//! by linearity its best pattern is a whole one. Accuracies of a step's frames are bounded by the chord of
//! 1/(1 + g²s) over the sharpness s that occur, which is convex in s. In a world with directions ℓ stands for an element
//! of a leaf's surface.

use super::frame::{CheapestBeneath, ROUNDING};
use super::prices::Prices;
use super::seen::{Items, Patched, Sight, patches, steps};
use super::targets::{Seen, choices, free, seen};
use foresight_scheduler::benefit::cut::Cut;
use foresight_scheduler::benefit::element::{ELEMENTS, errors};
use foresight_scheduler::lod_tree::{LodTree, RepId};
use rayon::prelude::*;
use std::ops::Range;

/// Steps, more or less; the early ones are shorter.
const STEPS: usize = 120;
/// Steps of one level that are one step of the level before.
pub const COARSER: usize = 5;
/// Choices of an accuracy of less than this share of a target's best are left out; its price is at least theirs.
const FAINT: f64 = 0.05;
/// As many choices are gathered before the smallest targets are taken out.
const GATHERED_MAX: usize = 12_000_000;
/// Groups with more than this share of the replay's weight are opened, if the choices allow.
const OPEN_SHARE: f64 = 1e-6;
/// Relative error of a sum of a few million terms of one sign, rounded up.
const SUMMATION: f64 = 1e-8;

/// What can be resident.
#[derive(Clone, Copy, Debug)]
struct Facility {
    wire: f64,
    decoded: f64,
    /// Wire bytes that must have come, and decoded bytes that must fit, before it can be there; 0 where any part can.
    least: [f64; 2],
    first_slot: u32,
    end_slot: u32,
}

/// A target in a step.
#[derive(Clone, Copy, Debug)]
struct Target {
    step: u32,
    /// Place of its item; in a world with directions times [`ELEMENTS`], plus the element.
    item: u64,
    /// Least price: accuracy of what is left out of its choices.
    floor: f32,
    weight: f64,
    first_choice: u32,
    end_choice: u32,
}

/// A facility that shows a target.
#[derive(Clone, Copy, Debug)]
struct Choice {
    /// Rounded up.
    accuracy: f32,
    slot: u32,
}

/// What one start of a replay sets the limits to.
#[derive(Clone, Debug)]
pub struct Supply {
    /// W_t: bytes deliverable by the last frame of each step, and what was there at the start.
    pub wire: Vec<f64>,
    /// B, decoded bytes.
    pub memory: f64,
    /// A_t: Σ of the frames' own bounds over the step, divided by the number of frames with something in view.
    pub frames: Vec<f64>,
}

/// The problem of a replay; the same for every start of its link.
#[derive(Debug)]
pub struct OverTime {
    steps: Vec<Range<usize>>,
    facilities: Vec<Facility>,
    /// Step of each slot; a slot is a facility in a step.
    slot_step: Vec<u32>,
    targets: Vec<Target>,
    choices: Vec<Choice>,
    /// Weight of all that is seen, by step.
    weight: Vec<f64>,
    /// Weight of what is taken to be shown without error for nothing, by step.
    free: Vec<f64>,
}

/// Value of the dual and its slopes: of a bound, what is left of each limit at these prices.
#[derive(Clone, Debug, Default)]
pub struct Dual {
    /// Upper bound of the mean quality.
    pub value: f64,
    /// Bytes fetched in each step.
    pub fetched: Vec<f64>,
    /// Bytes carried into each step.
    pub carried: Vec<f64>,
    /// How often each target is shown.
    pub shown: Vec<f32>,
    /// Quality of each step in the relaxed optimum, prices of the targets included.
    pub quality: Vec<f64>,
    /// Σ (w (a − v)⁺) of each slot.
    profit: Vec<f64>,
    /// What led to each slot: [`CARRIED`] and [`WAS_IN`]; then whether it is [`IN`].
    flags: Vec<u8>,
}

/// The slot's facility was carried in rather than fetched.
const CARRIED: u8 = 1;
/// Before the slot it was in rather than out.
const WAS_IN: u8 = 2;
/// It is in.
const IN: u8 = 4;

impl OverTime {
    /// The problem of the cuts of a replay, in [`COARSER`] × as many steps from one to the next, beginning with one step;
    /// the last is the tightest. None where nothing is ever in view, or where even the coarsest grouping has too many
    /// choices.
    pub fn levels(tree: &LodTree, cheapest: &CheapestBeneath, cuts: &[Cut]) -> Vec<OverTime> {
        if cuts.iter().all(|cut| cut.total_weight <= 0.0) {
            return Vec::new();
        }
        let mut count = STEPS;
        while count > 0 {
            let mut steps = steps(cuts.len(), count);
            let mut patches = patches(tree, cuts, &steps);
            let sight = Sight::new(tree, &patches);
            let mut share = OPEN_SHARE;
            while share < 1e-3 {
                let items = Items::new(tree, cheapest, &sight, share);
                if choices(tree, &items, &patches) <= GATHERED_MAX {
                    let mut levels = Vec::new();
                    loop {
                        levels.push(OverTime::build(tree, &steps, &patches, &items));
                        if steps.len() == 1 {
                            levels.reverse();
                            return levels;
                        }
                        steps = steps.chunks(COARSER).map(|s| s[0].start..s[s.len() - 1].end).collect();
                        patches = patches.chunks(COARSER).map(Patched::merged).collect();
                    }
                }
                share *= 4.0;
            }
            count /= 4;
        }
        Vec::new()
    }

    fn build(tree: &LodTree, steps: &[Range<usize>], patches: &[Vec<Patched>], items: &Items) -> OverTime {
        // Facilities by item: its own representations, then what lies beneath it.
        let mut facilities = Vec::new();
        let mut chains: Vec<Vec<(u32, Option<RepId>)>> = Vec::with_capacity(items.all.len());
        for (place, item) in items.all.iter().enumerate() {
            let mut chain = if item.parent == place { Vec::new() } else { chains[item.parent].clone() };
            for rep in tree.own(item.node) {
                let needs = std::iter::successors(Some(rep), |&r| tree.prerequisite(r));
                chain.push((facilities.len() as u32, Some(rep)));
                facilities.push(Facility {
                    wire: tree.wire_bytes(rep) as f64,
                    decoded: tree.decoded_bytes(rep) as f64,
                    least: [needs.map(|r| tree.wire_bytes(r) as f64).sum(), tree.decoded_bytes(rep) as f64],
                    first_slot: 0,
                    end_slot: 0,
                });
            }
            if item.beneath[0].is_finite() {
                chain.push((facilities.len() as u32, None));
                let [wire, decoded] = item.beneath;
                facilities.push(Facility { wire, decoded, least: [0.0; 2], first_slot: 0, end_slot: 0 });
            }
            chains.push(chain);
        }
        let mut seen: Vec<Vec<Seen>> = patches.par_iter().map(|of_step| seen(tree, items, of_step)).collect();
        let lengths: Vec<usize> = chains.iter().map(Vec::len).collect();
        let free = free(&mut seen, &lengths);

        // What can show a target, with its error; what lies beneath shows it without.
        let has_directions = tree.has_directions();
        let shows = |target: &Seen| {
            let element = usize::from(target.element);
            chains[target.item].iter().filter_map(move |&(facility, rep)| {
                let error = match rep {
                    None => 0.0,
                    Some(rep) if has_directions => f64::from(errors(tree, rep)[element]),
                    Some(rep) => tree.error(rep),
                };
                (error < f64::INFINITY).then_some((facility, error))
            })
        };
        let mut last = vec![u32::MAX; facilities.len()];
        for (step, seen) in seen.iter().enumerate() {
            for target in seen {
                let best = shows(target).map(|(_, error)| target.accuracy(error)).fold(0.0, f32::max);
                let bright = |error: f64| f64::from(target.accuracy(error)) >= FAINT * f64::from(best);
                for (facility, _) in shows(target).filter(|c| bright(c.1)) {
                    if std::mem::replace(&mut last[facility as usize], step as u32) != step as u32 {
                        facilities[facility as usize].end_slot += 1;
                    }
                }
            }
        }
        let mut slots = 0;
        for facility in &mut facilities {
            let count = facility.end_slot;
            (facility.first_slot, facility.end_slot) = (slots, slots);
            slots += count;
        }
        last.fill(u32::MAX);
        let mut problem = OverTime {
            weight: free.clone(),
            free,
            steps: steps.to_vec(),
            facilities,
            slot_step: vec![0; slots as usize],
            targets: Vec::new(),
            choices: Vec::new(),
        };
        for (step, seen) in seen.iter().enumerate() {
            for target in seen {
                let first_choice = problem.choices.len() as u32;
                let best = shows(target).map(|(_, error)| target.accuracy(error)).fold(0.0, f32::max);
                let mut floor = 0.0f32;
                for (facility, error) in shows(target) {
                    let accuracy = target.accuracy(error);
                    if f64::from(accuracy) < FAINT * f64::from(best) {
                        floor = floor.max(accuracy);
                        continue;
                    }
                    let of = &mut problem.facilities[facility as usize];
                    if std::mem::replace(&mut last[facility as usize], step as u32) != step as u32 {
                        problem.slot_step[of.end_slot as usize] = step as u32;
                        of.end_slot += 1;
                    }
                    problem.choices.push(Choice { accuracy, slot: of.end_slot - 1 });
                }
                let end_choice = problem.choices.len() as u32;
                problem.weight[step] += target.weight[0];
                if end_choice > first_choice {
                    let lanes = if has_directions { ELEMENTS as u64 } else { 1 };
                    let (step, item) = (step as u32, target.item as u64 * lanes + u64::from(target.element));
                    problem.targets.push(Target {
                        step,
                        item,
                        floor,
                        weight: target.weight[0],
                        first_choice,
                        end_choice,
                    });
                }
            }
        }
        problem
    }

    /// Frames of each step.
    pub fn steps(&self) -> &[Range<usize>] {
        &self.steps
    }

    /// Number of targets, of slots and of choices.
    pub fn size(&self) -> [usize; 3] {
        [self.targets.len(), self.slot_step.len(), self.choices.len()]
    }

    /// Share of the replay's weight in each step.
    pub(super) fn weight(&self) -> &[f64] {
        &self.weight
    }

    /// Prices for this level from those of the one before.
    pub(super) fn refined(&self, coarse: &OverTime, prices: &Prices) -> Prices {
        let step = |t: usize| t / COARSER;
        let steps = 0..self.steps.len();
        // Within a step all are sorted by item.
        let mut place = 0;
        let mut shown = Vec::with_capacity(self.targets.len());
        let mut best = self.best();
        let first = |step: usize| coarse.targets.partition_point(|t| (t.step as usize) < step);
        let starts: Vec<usize> = (0..=coarse.steps.len()).map(first).collect();
        let mut of_step = u32::MAX;
        for target in &self.targets {
            let range = starts[step(target.step as usize)]..starts[step(target.step as usize) + 1];
            if target.step != of_step {
                (of_step, place) = (target.step, range.start);
            }
            while place < range.end && coarse.targets[place].item < target.item {
                place += 1;
            }
            let ceiling = best.next().unwrap_or(1.0);
            let known = (place < range.end && coarse.targets[place].item == target.item).then(|| prices.shown[place]);
            shown.push(known.unwrap_or(ceiling).min(ceiling));
        }
        Prices {
            capacity: steps.clone().map(|t| prices.capacity[step(t)]).collect(),
            memory: steps.clone().map(|t| prices.memory[step(t)] / COARSER as f64).collect(),
            frame: steps.map(|t| prices.frame[step(t)]).collect(),
            shown,
        }
    }

    /// Best accuracy that each target can be shown at.
    pub(super) fn best(&self) -> impl Iterator<Item = f32> + '_ {
        let choices = |t: &Target| &self.choices[t.first_choice as usize..t.end_choice as usize];
        self.targets.iter().map(move |t| choices(t).iter().map(|c| c.accuracy).fold(0.0, f32::max))
    }

    /// The bound that `prices` prove, with its slopes. Prices must be as [`Prices`] says; any such prices are valid.
    pub fn dual(&self, supply: &Supply, prices: &Prices, dual: &mut Dual) {
        let count = self.steps.len();
        for (values, length) in [(&mut dual.fetched, count), (&mut dual.carried, count + 1), (&mut dual.quality, count)]
        {
            values.clear();
            values.resize(length, 0.0);
        }
        dual.profit.clear();
        dual.profit.resize(self.slot_step.len(), 0.0);
        dual.flags.clear();
        dual.flags.resize(self.slot_step.len(), 0);
        dual.shown.clear();

        let mut assigned = 0.0;
        for (step, &free) in self.free.iter().enumerate() {
            assigned += free * (1.0 - prices.frame[step]);
            dual.quality[step] += free;
        }
        for (target, &price) in self.targets.iter().zip(&prices.shown) {
            let price = price.max(target.floor);
            for choice in &self.choices[target.first_choice as usize..target.end_choice as usize] {
                if choice.accuracy > price {
                    dual.profit[choice.slot as usize] +=
                        target.weight * (f64::from(choice.accuracy) - f64::from(price));
                }
            }
            let worth = target.weight * f64::from(price);
            assigned += worth * (1.0 - prices.frame[target.step as usize]);
            dual.quality[target.step as usize] += worth;
        }
        // Memory prices summed up to each step: those between two steps are a difference.
        let mut until = 0.0;
        let memory: Vec<f64> = prices
            .memory
            .iter()
            .map(|price| {
                until += price;
                until
            })
            .collect();
        let mut patterns = 0.0;
        for facility in &self.facilities {
            patterns += self.best_pattern(facility, supply, prices, &memory, dual);
        }
        for step in 1..=count {
            dual.carried[step] += dual.carried[step - 1];
        }
        dual.carried.truncate(count);
        for (target, &price) in self.targets.iter().zip(&prices.shown) {
            let price = price.max(target.floor);
            let choices = &self.choices[target.first_choice as usize..target.end_choice as usize];
            let is_in = |c: &&Choice| c.accuracy > price && dual.flags[c.slot as usize] & IN != 0;
            dual.shown.push(choices.iter().filter(is_in).count() as f32);
        }
        let mut limits = supply.memory * until;
        let mut later = 0.0;
        for step in (0..count).rev() {
            limits += (prices.capacity[step] - later).max(0.0) * supply.wire[step];
            later = prices.capacity[step];
            limits += prices.frame[step] * supply.frames[step];
        }
        dual.value = (limits + assigned + patterns) * (1.0 + SUMMATION) + ROUNDING;
    }

    /// The worth of a facility's best pattern; marks its slots and adds up what it takes.
    fn best_pattern(
        &self,
        facility: &Facility,
        supply: &Supply,
        prices: &Prices,
        memory: &[f64],
        dual: &mut Dual,
    ) -> f64 {
        let slots = facility.first_slot as usize..facility.end_slot as usize;
        let (mut is_in, mut best) = (f64::NEG_INFINITY, 0.0);
        let mut memory_before = 0.0;
        let fits = facility.least[1] <= supply.memory;
        for slot in slots.clone() {
            let step = self.slot_step[slot] as usize;
            let carried = is_in - facility.decoded * (memory[step] - memory_before);
            memory_before = memory[step];
            let mut flags = if is_in > best { WAS_IN } else { 0 };
            best = f64::max(best, is_in);
            let fetched = if fits && facility.least[0] <= supply.wire[step] {
                best - facility.wire * prices.capacity[step]
            } else {
                f64::NEG_INFINITY
            };
            if carried >= fetched {
                flags |= CARRIED;
            }
            dual.flags[slot] = flags;
            is_in = carried.max(fetched) + dual.profit[slot] * (1.0 - prices.frame[step]);
        }
        let worth = f64::max(best, is_in);
        // Back along the best pattern.
        let mut inside = is_in > best;
        for slot in slots.clone().rev() {
            let step = self.slot_step[slot] as usize;
            let flags = dual.flags[slot];
            if !inside {
                dual.flags[slot] = 0;
                inside = flags & WAS_IN != 0;
                continue;
            }
            dual.flags[slot] = IN;
            dual.quality[step] += dual.profit[slot];
            if flags & CARRIED != 0 && slot > slots.start {
                let before = self.slot_step[slot - 1] as usize;
                dual.carried[before + 1] += facility.decoded;
                dual.carried[step + 1] -= facility.decoded;
            } else {
                dual.fetched[step] += facility.wire;
                inside = flags & WAS_IN != 0;
            }
        }
        worth
    }
}
