//! The objective over the time ahead, sampled: J(R) as a sum over patches.
//!
//! The integral of ARCHITECTURE.md is a midpoint rule over intervals of [t, t+δ], one cut per interval and predicted path; the
//! worst case is one more cut. Every patch then adds w·a(least error at or above it), with α, the path's belief, the
//! attenuation and the cut's scale folded into w. Groups are opened until what could still be gained beneath them is
//! below a tolerance, so that every choice that matters has its own patches.

use crate::benefit::accuracy::accuracy;
use crate::benefit::coverage::{Coverage, Elements, Refinement};
use crate::benefit::cut::{Cut, CutSettings, Patch, Region, projected_area};
use crate::benefit::element::{self, ELEMENTS};
use crate::lod_tree::{LodTree, NodeId, RepId};
use crate::predict::PredictedPath;
use crate::view::View;
use crate::worst_case::union_cut;

/// When a term of the objective counts, seconds from the horizon's start; the worst case counts always.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Span {
    Interval { from: f64, to: f64 },
    Always,
}

impl Span {
    /// Share of the term that lies after `offset`.
    fn after(self, offset: f64) -> f64 {
        match self {
            Span::Always => 1.0,
            Span::Interval { from, to } => ((to - offset) / (to - from)).clamp(0.0, 1.0),
        }
    }
}

#[derive(Clone, Debug)]
struct Term {
    span: Span,
    cut: Cut,
    /// The nodes of the cut's patches once more: searches touch nothing else.
    nodes: Vec<NodeId>,
    /// Whether it stands for a present view.
    is_present: bool,
}

impl Term {
    /// The patches at or beneath a node.
    fn beneath(&self, tree: &LodTree, node: NodeId) -> impl Iterator<Item = &Patch> {
        let end = tree.subtree_end(node);
        let first = self.nodes.partition_point(|&n| n < node);
        self.cut.patches[first..].iter().take_while(move |p| p.node < end)
    }
}

/// What the horizon is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HorizonSettings {
    /// α: share of the predicted paths in the objective; the rest is the worst case.
    pub alpha: f64,
    /// Attenuation rate per second: att(u) = exp(−rate·u). 0 is att ≡ 1.
    pub attenuation: f64,
    /// Groups are opened while more than this could be gained beneath them: sr of the objective, in which α, belief and
    /// attenuation are included.
    pub tolerance: f64,
    /// How the cuts are made.
    pub cut: CutSettings,
}

/// The worst case, as a horizon samples it.
#[derive(Clone, Copy, Debug)]
pub enum Worst<'a> {
    /// Everything in the region reachable from the view, as one cut.
    Union(&'a View, Region),
    /// Several regions, each from its view, with weights that sum to 1: those of several cameras, or single reachable
    /// views, the worst ones.
    Several(&'a [(f64, View, Region)]),
}

impl<'a> From<(&'a View, Region)> for Worst<'a> {
    fn from((view, region): (&'a View, Region)) -> Worst<'a> {
        Worst::Union(view, region)
    }
}

/// The sampled objective from one moment on.
#[derive(Clone, Debug, Default)]
pub struct Horizon {
    terms: Vec<Term>,
    /// Cuts of earlier horizons, kept for their memory.
    spare: Vec<Cut>,
    /// Scratch of the opening.
    opened: Vec<Patch>,
    /// Number of patches over all terms.
    patches: usize,
    /// As many paths, from the first on, stand for present views; at least one does.
    pub(crate) cameras: usize,
}

/// Where a representation stands at a patch in a world with directions.
#[derive(Clone, Copy, Debug)]
pub struct ElementChain {
    /// What shows each element.
    pub shown: Elements,
    /// Their shares in the patch's weight.
    pub shares: [f64; ELEMENTS],
}

/// Where a rep stands at a patch: the least errors of what is planned.
#[derive(Clone, Copy, Debug)]
pub struct Chain {
    /// The node that owns the best, if anything is shown.
    pub owner: Option<NodeId>,
    /// Its error.
    pub best: f32,
}

impl Horizon {
    /// Samples the objective. `bounds` are the ends of the intervals in seconds, ascending from 0; each of `paths` has a
    /// view per interval, at its middle. `worst` is the view with the region reachable from it, or the worst reachable
    /// views with their weights.
    pub fn make<'a>(
        &mut self,
        tree: &LodTree,
        planned: &Coverage,
        paths: &[PredictedPath],
        bounds: &[f64],
        worst: impl Into<Worst<'a>>,
        settings: &HorizonSettings,
    ) {
        self.spare.extend(self.terms.drain(..).map(|t| t.cut));
        let att: Vec<f64> =
            bounds.windows(2).map(|w| (w[1] - w[0]) * libm::exp(-settings.attenuation * 0.5 * (w[0] + w[1]))).collect();
        let whole: f64 = att.iter().sum();
        if settings.alpha > 0.0 && whole > 0.0 {
            for (which, path) in paths.iter().enumerate() {
                for (i, view) in path.views.iter().enumerate().take(att.len()) {
                    let mut cut = self.spare.pop().unwrap_or_default();
                    cut.make(tree, view, Region::Frustum, &settings.cut);
                    let span = Span::Interval { from: bounds[i], to: bounds[i + 1] };
                    let factor = settings.alpha * path.weight * att[i] / whole;
                    let is_present = i == 0 && which < self.cameras;
                    self.add(tree, planned, cut, span, factor, settings, is_present);
                }
            }
        }
        if settings.alpha < 1.0 {
            let worst = worst.into();
            let views = match worst {
                Worst::Union(view, region) => &[(1.0, *view, region)][..],
                Worst::Several(views) => views,
            };
            for (weight, view, region) in views {
                let mut cut = self.spare.pop().unwrap_or_default();
                union_cut(&mut cut, tree, view, *region, &settings.cut);
                self.add(tree, planned, cut, Span::Always, (1.0 - settings.alpha) * weight, settings, false);
            }
        }
        self.patches = self.terms.iter().map(|t| t.cut.patches.len()).sum();
    }

    #[expect(clippy::too_many_arguments, reason = "one term; grouping the inputs would only rename them")]
    fn add(
        &mut self,
        tree: &LodTree,
        planned: &Coverage,
        mut cut: Cut,
        span: Span,
        factor: f64,
        settings: &HorizonSettings,
        is_present: bool,
    ) {
        let scale = factor * cut.scale;
        // The tolerance is on the objective: a term of little weight need not be opened far.
        let tolerance = settings.tolerance;
        self.opened.clear();
        let patches = cut.patches.iter().map(|patch| Patch { weight: patch.weight * scale, ..*patch });
        if tree.has_directions() {
            let mut sweep = planned.sweep_elements(tree, tree.root());
            let mut deficit = |node: NodeId, sharpness: f64| {
                element::mean_deficit(&cut.shares(tree, node), &sweep.at(node).0.errors, sharpness)
            };
            patches.for_each(|patch| open(tree, &mut deficit, cut.eye, patch, tolerance, &mut self.opened));
        } else {
            let mut sweep = planned.sweep(tree, tree.root());
            let mut deficit =
                |node: NodeId, sharpness: f64| 1.0 - accuracy(f64::from(sweep.shown_at(node).1), sharpness);
            patches.for_each(|patch| open(tree, &mut deficit, cut.eye, patch, tolerance, &mut self.opened));
        }
        core::mem::swap(&mut cut.patches, &mut self.opened);
        let nodes = cut.patches.iter().map(|p| p.node).collect();
        let is_present = is_present || self.terms.is_empty();
        self.terms.push(Term { span, cut, nodes, is_present });
    }

    /// Patches over all terms: what an evaluation costs.
    pub fn patches(&self) -> usize {
        self.patches
    }

    /// ΔJ of having `rep` beside everything else in `planned`, counted from `offset` seconds on: a gain if it is not
    /// planned, the loss of discarding it if it is. `planned` is altered and restored on the way.
    pub fn marginal(&self, tree: &LodTree, planned: &mut Coverage, rep: RepId, offset: f64) -> f64 {
        if planned.refinement() == Refinement::Atomic {
            return self.marginal_of_group(tree, planned, rep, offset);
        }
        if tree.has_directions() {
            return self.marginal_by_element(tree, planned, rep, offset);
        }
        let node = tree.node_of(rep);
        let error = tree.error(rep) as f32;
        let mut above = f32::INFINITY;
        if planned.counts(tree, node) {
            for other in tree.own(node) {
                if other != rep && planned.contains(other) {
                    above = above.min(tree.error(other) as f32);
                }
            }
        }
        if let Some(parent) = tree.parent(node) {
            above = above.min(planned.best_above(tree, parent));
        }
        if error >= above {
            return 0.0;
        }
        let mut sweep = planned.sweep_beneath(tree, node, (None, above));
        let mut sum = 0.0;
        for term in &self.terms {
            let share = term.span.after(offset);
            if share <= 0.0 {
                continue;
            }
            sweep.restart();
            let mut part = 0.0;
            for patch in term.beneath(tree, node) {
                let (_, others, _) = sweep.shown_at(patch.node);
                if error < others {
                    part += patch.weight
                        * (accuracy(f64::from(error), patch.sharpness) - accuracy(f64::from(others), patch.sharpness));
                }
            }
            sum += share * part;
        }
        sum
    }

    fn marginal_by_element(&self, tree: &LodTree, planned: &Coverage, rep: RepId, offset: f64) -> f64 {
        let (node, errors) = (tree.node_of(rep), element::errors(tree, rep));
        let others = planned.elements_without(tree, rep);
        if !element::improves(&errors, &others.errors) {
            return 0.0;
        }
        let mut sweep = planned.sweep_from(tree, node, others);
        let mut sum = 0.0;
        for term in &self.terms {
            let share = term.span.after(offset);
            if share <= 0.0 {
                continue;
            }
            sweep.restart();
            let mut part = 0.0;
            for patch in term.beneath(tree, node) {
                let others = sweep.at(patch.node).0.errors;
                if element::improves(&errors, &others) {
                    let shares = term.cut.shares(tree, patch.node);
                    part += patch.weight * element::mean_gain(&shares, &errors, &others, patch.sharpness);
                }
            }
            sum += share * part;
        }
        sum
    }

    /// As [`Horizon::marginal`] where a sibling group counts together: the difference over all that the group shows.
    fn marginal_of_group(&self, tree: &LodTree, planned: &mut Coverage, rep: RepId, offset: f64) -> f64 {
        let top = tree.content_parent(tree.node_of(rep)).unwrap_or(tree.root());
        let before = self.benefit_beneath(tree, planned, top, offset);
        if planned.remove(tree, rep) {
            let after = self.benefit_beneath(tree, planned, top, offset);
            planned.insert(tree, rep);
            return (before - after).max(0.0);
        }
        planned.insert(tree, rep);
        let after = self.benefit_beneath(tree, planned, top, offset);
        planned.remove(tree, rep);
        (after - before).max(0.0)
    }

    /// Σ w·a over what lies beneath `node`, counted from `offset` on.
    pub fn benefit_beneath(&self, tree: &LodTree, planned: &Coverage, node: NodeId, offset: f64) -> f64 {
        if tree.has_directions() {
            return self.benefit_by_element(tree, planned, node, offset);
        }
        let mut sweep = planned.sweep(tree, node);
        let mut sum = 0.0;
        for term in &self.terms {
            let share = term.span.after(offset);
            sweep.restart();
            let mut part = 0.0;
            for patch in term.beneath(tree, node) {
                let (_, best, _) = sweep.shown_at(patch.node);
                part += patch.weight * accuracy(f64::from(best), patch.sharpness);
            }
            sum += share * part;
        }
        sum
    }

    fn benefit_by_element(&self, tree: &LodTree, planned: &Coverage, node: NodeId, offset: f64) -> f64 {
        let mut sweep = planned.sweep_elements(tree, node);
        let mut sum = 0.0;
        for term in &self.terms {
            sweep.restart();
            let mut part = 0.0;
            for patch in term.beneath(tree, node) {
                let errors = sweep.at(patch.node).0.errors;
                let shares = term.cut.shares(tree, patch.node);
                part += patch.weight * element::mean_accuracy(&shares, &errors, patch.sharpness);
            }
            sum += term.span.after(offset) * part;
        }
        sum
    }

    /// J(R), sampled.
    pub fn objective(&self, tree: &LodTree, planned: &Coverage) -> f64 {
        self.benefit_beneath(tree, planned, tree.root(), 0.0)
    }

    /// Visits every patch with the chain above it: `visit(patch, share after offset, chain, is of a present view)`; the
    /// nearest sampled view of the first path, or of each camera's first, stands for the present one.
    pub fn for_each(
        &self,
        tree: &LodTree,
        planned: &Coverage,
        offset: f64,
        mut visit: impl FnMut(&Patch, f64, Chain, bool),
    ) {
        let mut sweep = planned.sweep(tree, tree.root());
        for term in &self.terms {
            let share = term.span.after(offset);
            sweep.restart();
            for patch in &term.cut.patches {
                let (owner, best, _) = sweep.shown_at(patch.node);
                let chain = Chain { owner, best };
                visit(patch, share, chain, term.is_present);
            }
        }
    }

    /// As [`Horizon::for_each`] in a world with directions.
    pub fn for_each_by_element(
        &self,
        tree: &LodTree,
        planned: &Coverage,
        offset: f64,
        mut visit: impl FnMut(&Patch, f64, &ElementChain, bool),
    ) {
        let mut sweep = planned.sweep_elements(tree, tree.root());
        for term in &self.terms {
            let share = term.span.after(offset);
            sweep.restart();
            for patch in &term.cut.patches {
                let shown = sweep.at(patch.node).0;
                let chain = ElementChain { shown, shares: term.cut.shares(tree, patch.node) };
                visit(patch, share, &chain, term.is_present);
            }
        }
    }
}

/// Opens `patch` until nothing beneath it could gain more than `tolerance`, in preorder. `deficit` answers how much of a
/// node's weight is missing at a sharpness; it is asked for ascending nodes.
fn open(
    tree: &LodTree,
    deficit: &mut impl FnMut(NodeId, f64) -> f64,
    eye: glam::DVec3,
    patch: Patch,
    tolerance: f64,
    out: &mut Vec<Patch>,
) {
    let mut worth_opening = |node: NodeId, weight: f64| weight * deficit(node, patch.sharpness) > tolerance;
    if tree.is_leaf(patch.node) || !worth_opening(patch.node, patch.weight) {
        out.push(patch);
        return;
    }
    let direction = (tree.centre(patch.node) - eye).normalize_or_zero();
    let whole = projected_area(tree, patch.node, direction);
    if whole <= 0.0 {
        out.push(patch);
        return;
    }
    let density = patch.weight / whole;
    let end = tree.subtree_end(patch.node);
    let mut next = NodeId(patch.node.0 + 1);
    while next < end {
        let weight = density * projected_area(tree, next, direction);
        if tree.is_leaf(next) || !worth_opening(next, weight) {
            out.push(Patch { node: next, weight, sharpness: patch.sharpness });
            next = tree.subtree_end(next);
        } else {
            next = NodeId(next.0 + 1);
        }
    }
}
