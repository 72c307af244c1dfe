//! Better prices, step by step.
//!
//! The dual is convex and piecewise linear in the prices. Each round moves every price against its slope, in its own
//! units (accuracy for targets, relative use for link and memory, so that large and small targets move alike), smoothed
//! over the rounds; the length of the moves falls geometrically. The best bound met is kept, and that of the mean of the
//! later prices is tried as well. Nothing here needs to be exact: any prices prove a bound.

use super::over_time::{Dual, OverTime, Supply};
use super::prices::{Prices, decrease};

/// Rounds that a level takes at most, and at least.
const ROUNDS: [usize; 2] = [40, 300];
/// Choices looked at in all rounds of a level together.
const WORK: usize = 250_000_000;
/// Share of the last slope that stays in the next.
const SMOOTHING: f64 = 0.8;
/// First and last length of a move: of an accuracy, and of a price relative to its scale; of the first level, and of those
/// that begin with the prices of another.
const SHOWN_MOVES: [[f64; 2]; 2] = [[0.1, 0.005], [0.03, 0.002]];
const PRICE_MOVES: [[f64; 2]; 2] = [[0.1, 0.005], [0.05, 0.003]];
/// Worth of all that the link brings, to begin with.
const WORTH: f64 = 0.3;
/// Early rounds whose prices do not count for the mean.
const WARMING: f64 = 0.5;

/// A bound with the prices that prove it.
#[derive(Clone, Debug)]
pub struct Proof {
    /// Upper bound of the mean quality.
    pub value: f64,
    /// That prove it.
    pub prices: Prices,
    /// Place of the level that they are for.
    pub level: usize,
}

/// The best bound found within the work limit, level by level; `supply` has the limits of each.
pub fn prove(levels: &[OverTime], supply: &[Supply]) -> Option<Proof> {
    let mut best: Option<Proof> = None;
    let mut last: Option<Prices> = None;
    for (level, (problem, supply)) in levels.iter().zip(supply).enumerate() {
        let rounds = (WORK / problem.size()[2].max(1)).clamp(ROUNDS[0], ROUNDS[1]);
        let begin = last.as_ref().map(|coarse| problem.refined(&levels[level - 1], coarse));
        let (value, prices) = prove_in(problem, supply, begin, rounds);
        last = Some(prices.clone());
        if best.as_ref().is_none_or(|best| value < best.value) {
            best = Some(Proof { value, prices, level });
        }
    }
    best
}

/// The best bound found in so many rounds, from these prices or from the beginning.
pub fn prove_in(problem: &OverTime, supply: &Supply, begin: Option<Prices>, rounds: usize) -> (f64, Prices) {
    let is_refined = usize::from(begin.is_some());
    let mut ascent = Ascent::new(problem, supply, begin);
    let from = (rounds as f64 * WARMING) as usize;
    let (mut mean, mut counted) = (ascent.prices.clone(), 0.0);
    for round in 0..rounds {
        let progress = round as f64 / rounds as f64;
        let length = |moves: [[f64; 2]; 2]| {
            let [first, last] = moves[is_refined];
            first * libm::pow(last / first, progress)
        };
        ascent.look();
        ascent.step(length(SHOWN_MOVES), length(PRICE_MOVES));
        if round >= from {
            counted += 1.0;
            approach(&mut mean, &ascent.prices, 1.0 / counted);
        }
    }
    ascent.look();
    ascent.prices = mean;
    ascent.look();
    ascent.best
}

struct Ascent<'a> {
    problem: &'a OverTime,
    supply: &'a Supply,
    prices: Prices,
    best: (f64, Prices),
    dual: Dual,
    /// Smoothed slopes: of targets, link, memory and frames.
    shown: Vec<f32>,
    capacity: Vec<f64>,
    memory: Vec<f64>,
    frame: Vec<f64>,
    /// Bytes that the link brings in each step, and a little more so that none is 0.
    delivered: Vec<f64>,
    ceiling: Vec<f32>,
}

impl<'a> Ascent<'a> {
    fn new(problem: &'a OverTime, supply: &'a Supply, begin: Option<Prices>) -> Ascent<'a> {
        let ceiling: Vec<f32> = problem.best().collect();
        let steps = problem.steps().len();
        let all = supply.wire.last().copied().unwrap_or(0.0).max(1.0);
        let prices = begin.unwrap_or_else(|| Prices {
            capacity: vec![WORTH / all; steps],
            memory: vec![0.0; steps],
            shown: ceiling.clone(),
            frame: vec![0.0; steps],
        });
        let floor = 0.05 * all / steps as f64;
        let mut before = 0.0;
        let delivered = supply.wire.iter().map(|&until| until - std::mem::replace(&mut before, until) + floor);
        Ascent {
            problem,
            supply,
            best: (f64::INFINITY, prices.clone()),
            prices,
            dual: Dual::default(),
            shown: vec![0.0; ceiling.len()],
            capacity: vec![0.0; steps],
            memory: vec![0.0; steps],
            frame: vec![0.0; steps],
            delivered: delivered.collect(),
            ceiling,
        }
    }

    /// The bound at the present prices.
    fn look(&mut self) {
        self.problem.dual(self.supply, &self.prices, &mut self.dual);
        if self.dual.value < self.best.0 {
            self.best = (self.dual.value, self.prices.clone());
        }
    }

    fn step(&mut self, shown_move: f64, price_move: f64) {
        let keep = SMOOTHING;
        let smooth = |of: &mut f64, slope: f64| *of = keep * *of + (1.0 - keep) * slope;
        let dual = &self.dual;
        for (place, price) in self.prices.shown.iter_mut().enumerate() {
            let slope = (1.0 - dual.shown[place]).max(-1.0);
            let smoothed = &mut self.shown[place];
            *smoothed = keep as f32 * *smoothed + (1.0 - keep) as f32 * slope;
            *price = (*price - shown_move as f32 * *smoothed).clamp(0.0, self.ceiling[place]);
        }
        let steps = self.capacity.len();
        let all: f64 = self.supply.wire.last().copied().unwrap_or(0.0).max(1.0);
        // Worth of all bytes that come, and of all memory kept, when they are what quality hangs on: of the order of 1.
        let scale = price_move / all;
        // What exceeds the link many times over says no more than twice.
        let fetched: f64 = dual.fetched.iter().sum();
        let tamed = (2.0 * all / fetched.max(1.0)).min(1.0);
        for t in 0..steps {
            let slope = (self.brought(t) - tamed * dual.fetched[t]) / self.delivered[t];
            smooth(&mut self.capacity[t], slope);
            self.prices.capacity[t] -= scale * self.capacity[t];
        }
        decrease(&mut self.prices.capacity, &self.delivered);
        let budget = self.supply.memory.max(1.0);
        let scale = price_move / (budget * steps as f64);
        for t in 1..steps {
            smooth(&mut self.memory[t], (1.0 - dual.carried[t] / budget).max(-1.0));
            self.prices.memory[t] = (self.prices.memory[t] - scale * self.memory[t]).max(0.0);
        }
        for t in 0..steps {
            let weight = self.problem.weight()[t];
            if weight > 0.0 {
                let slope = (self.supply.frames[t] - dual.quality[t]) / weight;
                smooth(&mut self.frame[t], slope.clamp(-1.0, 1.0));
                self.prices.frame[t] = (self.prices.frame[t] - 4.0 * price_move * self.frame[t]).clamp(0.0, 1.0);
            }
        }
    }

    /// Bytes that the link brings in step t.
    fn brought(&self, t: usize) -> f64 {
        self.supply.wire[t] - if t == 0 { 0.0 } else { self.supply.wire[t - 1] }
    }
}

/// Moves `mean` towards `to` by a share.
fn approach(mean: &mut Prices, to: &Prices, share: f64) {
    let blend = |mean: &mut [f64], to: &[f64]| mean.iter_mut().zip(to).for_each(|(m, t)| *m += (t - *m) * share);
    blend(&mut mean.capacity, &to.capacity);
    blend(&mut mean.memory, &to.memory);
    blend(&mut mean.frame, &to.frame);
    for (mean, to) in mean.shown.iter_mut().zip(&to.shown) {
        *mean += (to - *mean) * share as f32;
    }
    // Rounding must not make what falls rise.
    let mut least = f64::INFINITY;
    for price in &mut mean.capacity {
        least = least.min(price.max(0.0));
        *price = least;
    }
}
