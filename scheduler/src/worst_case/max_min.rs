//! What to fetch under `minimum`: the choice that lowers the largest deficit over the sampled views.
//!
//! The largest deficit is not supermodular, so greedy has no guarantee. SATURATE (Krause, McMahan, Guestrin and Gupta
//! 2008) has: for a level t it covers Σ_i min(F_i, W_i − t) greedily, F_i the benefit and W_i the weight of view i, which is
//! monotone submodular, and bisects for the least t that it covers within γ times the budget, γ = 1 + ln(Σ_i W_i / τ). Wolsey's
//! bound for greedy submodular cover makes every t that some choice reaches within the budget one of those: so the
//! largest deficit is at most τ above the least possible within the budget, at γ times its cost. No polynomial
//! algorithm does better than a factor on the budget unless P = NP.

use super::{WorstCaseError, check_cut, within};
use crate::benefit::accuracy::accuracy;
use crate::benefit::coverage::Coverage;
use crate::benefit::cut::{Cut, CutSettings, Patch, Region};
use crate::benefit::element;
use crate::lod_tree::{LodTree, NodeId, RepId};
use crate::view::View;

/// Monotone submodular functions of one choice, F_i(A) − F_i(∅) each.
pub trait Family {
    /// How many functions.
    fn functions(&self) -> usize;
    /// How many elements.
    fn elements(&self) -> usize;
    /// Cost of an element, finite and more than 0.
    fn cost(&self, element: usize) -> f64;
    /// By how much each function grows if `element` is added to what is chosen; `gains` has one place a function.
    fn gains(&mut self, element: usize, gains: &mut [f64]);
    /// Adds `element`.
    fn choose(&mut self, element: usize);
    /// Back to nothing chosen.
    fn clear(&mut self);
}

/// A choice.
#[derive(Clone, Debug, PartialEq)]
pub struct Saturated {
    /// Elements in the order in which they were chosen.
    pub chosen: Vec<usize>,
    /// Their cost together.
    pub cost: f64,
    /// Largest deficit left.
    pub deficit: f64,
    /// No choice within the budget leaves less than this.
    pub least_deficit: f64,
}

/// Lowers the largest of the deficits `missing[i] − F_i(A)` within `gamma` × `budget`, where `gamma` = 1 + ln(Σ missing / `tolerance`).
/// With `gamma` 1 in `stretch` the budget is kept, and the guarantee holds against the best choice at budget/γ.
pub fn saturate(
    family: &mut impl Family,
    missing: &[f64],
    budget: f64,
    tolerance: f64,
    stretch: Stretch,
) -> Result<Saturated, WorstCaseError> {
    within("budget", budget, 0.0, f64::MAX, "a cost, not negative")?;
    within("tolerance", tolerance, f64::MIN_POSITIVE, f64::MAX, "more than 0")?;
    within(
        "missing deficits",
        missing.len() as f64,
        family.functions() as f64,
        family.functions() as f64,
        "one a function",
    )?;
    for &one in missing {
        within("deficit", one, 0.0, f64::MAX, "a number, not negative")?;
    }
    for element in 0..family.elements() {
        within("cost", family.cost(element), f64::MIN_POSITIVE, f64::MAX, "more than 0")?;
    }
    let total: f64 = missing.iter().sum();
    let gamma = 1.0 + libm::log(total / tolerance).max(0.0);
    let (allowed, compared) = match stretch {
        Stretch::Guaranteed => (budget * gamma, budget),
        Stretch::Kept => (budget, budget / gamma),
    };
    // No element that alone exceeds what the best may spend is in the best choice.
    let usable: Vec<usize> = (0..family.elements()).filter(|&e| family.cost(e) <= compared.max(0.0)).collect();
    let most = missing.iter().copied().fold(0.0, f64::max);
    let mut best = Saturated { chosen: Vec::new(), cost: 0.0, deficit: most, least_deficit: 0.0 };
    let (mut low, mut high) = (0.0, most);
    // Halvings of [0, W] to the tolerance, at most those of a double.
    for step in 0..64 {
        // The least deficit of all first: it may be reached.
        let level = if step == 0 { 0.0 } else { 0.5 * (low + high) };
        let (chosen, cost, deficit) = cover(family, missing, level, &usable, allowed, tolerance);
        let covered = deficit <= level + tolerance;
        if deficit < best.deficit {
            best = Saturated { chosen, cost, deficit, least_deficit: 0.0 };
        }
        if covered {
            high = level;
        } else {
            low = level;
        }
        if high - low <= tolerance {
            break;
        }
    }
    best.least_deficit = low;
    Ok(best)
}

/// What SATURATE may spend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stretch {
    /// γ times the budget: then no choice within the budget is better by more than the tolerance.
    Guaranteed,
    /// The budget: then no choice within budget/γ is.
    Kept,
}

/// Greedy submodular cover of Σ min(F_i, (missing_i − level)₊) by gain per cost, until what is uncovered sums to at most
/// `tolerance` or nothing fits.
fn cover(
    family: &mut impl Family,
    missing: &[f64],
    level: f64,
    usable: &[usize],
    allowed: f64,
    tolerance: f64,
) -> (Vec<usize>, f64, f64) {
    family.clear();
    let goal: Vec<f64> = missing.iter().map(|m| (m - level).max(0.0)).collect();
    let mut have = vec![0.0; missing.len()];
    let mut gains = vec![0.0; missing.len()];
    let (mut chosen, mut cost) = (Vec::new(), 0.0);
    let mut left = usable.to_vec();
    loop {
        let uncovered: f64 = goal.iter().zip(&have).map(|(g, h): (&f64, &f64)| (g - h).max(0.0)).sum();
        if uncovered <= tolerance {
            break;
        }
        let mut best: Option<(f64, usize)> = None;
        for (place, &element) in left.iter().enumerate() {
            family.gains(element, &mut gains);
            let gain: f64 = (0..goal.len()).map(|i| (have[i] + gains[i]).min(goal[i]) - have[i].min(goal[i])).sum();
            let ratio = gain / family.cost(element);
            if ratio > 0.0 && best.is_none_or(|(most, _)| ratio > most) {
                best = Some((ratio, place));
            }
        }
        let Some((_, place)) = best else { break };
        let element = left.remove(place);
        if cost + family.cost(element) > allowed * (1.0 + 1e-12) {
            continue;
        }
        family.gains(element, &mut gains);
        have.iter_mut().zip(&gains).for_each(|(h, g)| *h += g);
        cost += family.cost(element);
        family.choose(element);
        chosen.push(element);
    }
    let deficit = missing.iter().zip(&have).map(|(m, h)| (m - h).max(0.0)).fold(0.0, f64::max);
    (chosen, cost, deficit)
}

/// Benefits of sampled views beside a resident set; an element is a closure.
pub struct SampledViews<'a> {
    tree: &'a LodTree,
    /// Cuts with their scale folded in.
    cuts: Vec<Cut>,
    resident: Coverage,
    planned: Coverage,
    elements: Vec<(f64, Vec<RepId>)>,
}

impl<'a> SampledViews<'a> {
    /// Of `views`, with `elements` to choose from: each costs so much, and brings so many representations. `coverage`
    /// counts partially refined; groups of the cuts are opened wherever an element lies beneath them.
    pub fn new(
        tree: &'a LodTree,
        views: &[View],
        coverage: Coverage,
        elements: Vec<(f64, Vec<RepId>)>,
        settings: &CutSettings,
    ) -> Result<SampledViews<'a>, WorstCaseError> {
        check_cut(settings)?;
        for &rep in elements.iter().flat_map(|(_, reps)| reps) {
            within("representation", f64::from(rep.0), 0.0, tree.representations() as f64 - 1.0, "one of the tree's")?;
        }
        let settings = CutSettings { centre_falloff: 0.0, opening: 0.0, ..*settings };
        let mut cuts = Vec::new();
        for view in views {
            view.check()?;
            let mut cut = Cut::default();
            cut.make(tree, view, Region::Frustum, &settings);
            cut.patches.iter_mut().for_each(|p| p.weight *= cut.scale);
            cuts.push(cut);
        }
        Ok(SampledViews { tree, cuts, planned: coverage.clone(), resident: coverage, elements })
    }

    /// Deficit of every view with what is chosen, sr.
    pub fn deficits(&self) -> Vec<f64> {
        let miss = |cut: &Cut| {
            let missed = cut.patches.iter().map(|p| p.weight * (1.0 - self.shown(cut, p)));
            missed.sum()
        };
        self.cuts.iter().map(miss).collect()
    }

    /// Benefit of one view beneath a node.
    fn beneath(&self, cut: &Cut, node: NodeId) -> f64 {
        let end = self.tree.subtree_end(node);
        let first = cut.patches.partition_point(|p| p.node < node);
        cut.patches[first..].iter().take_while(|p| p.node < end).map(|p| p.weight * self.shown(cut, p)).sum()
    }

    /// q of a patch.
    fn shown(&self, cut: &Cut, patch: &Patch) -> f64 {
        let (tree, node) = (self.tree, patch.node);
        if tree.has_directions() {
            let errors = self.planned.elements_above(tree, node).errors;
            return element::mean_accuracy(&cut.shares(tree, node), &errors, patch.sharpness);
        }
        accuracy(f64::from(self.planned.best_above(tree, node)), patch.sharpness)
    }
}

impl Family for SampledViews<'_> {
    fn functions(&self) -> usize {
        self.cuts.len()
    }

    fn elements(&self) -> usize {
        self.elements.len()
    }

    fn cost(&self, element: usize) -> f64 {
        self.elements[element].0
    }

    fn gains(&mut self, element: usize, gains: &mut [f64]) {
        gains.fill(0.0);
        let reps = self.elements[element].1.clone();
        let mut added = Vec::new();
        for rep in reps {
            let node = self.tree.node_of(rep);
            for (gain, cut) in gains.iter_mut().zip(&self.cuts) {
                *gain -= self.beneath(cut, node);
            }
            if self.planned.insert(self.tree, rep) {
                added.push(rep);
            }
            for (gain, cut) in gains.iter_mut().zip(&self.cuts) {
                *gain += self.beneath(cut, node);
            }
        }
        for rep in added {
            self.planned.remove(self.tree, rep);
        }
        gains.iter_mut().for_each(|g| *g = g.max(0.0));
    }

    fn choose(&mut self, element: usize) {
        for &rep in &self.elements[element].1 {
            self.planned.insert(self.tree, rep);
        }
    }

    fn clear(&mut self) {
        self.planned = self.resident.clone();
    }
}
