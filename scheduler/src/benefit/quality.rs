//! B_R(v) and Q_R(v) over a cut: what a resident set makes of a view.

use super::accuracy::{RIVALS_TARGET_PX, accuracy, is_within};
use super::coverage::{Coverage, Elements, Shown as _};
use super::cut::{Cut, Patch, projected_area};
use super::element::{self, ELEMENTS};
use crate::lod_tree::{LodTree, NodeId, RepId};

/// What a resident set makes of one view. Sums are in sr before the cut's scaling, which cancels in every ratio.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Quality {
    /// Σ w q.
    pub benefit: f64,
    /// Σ w.
    pub weight: f64,
    /// Σ w over what is shown at an error of at most 16 px.
    pub within_target: f64,
}

impl Quality {
    /// Q = Σ w q / Σ w; `None` when nothing is in view.
    pub fn mean(&self) -> Option<f64> {
        (self.weight > 0.0).then(|| (self.benefit / self.weight).clamp(0.0, 1.0))
    }
}

/// A part of a patch that is shown with one error throughout.
#[derive(Clone, Copy, Debug)]
pub struct Shown {
    /// The node that owns what is shown, or `None` where nothing is.
    pub owner: Option<NodeId>,
    /// What of it shows this, in a world with directions; otherwise `None`, and whatever of its own has the error.
    pub rep: Option<RepId>,
    /// Its error, metres; ∞ where nothing is shown.
    pub error: f32,
    /// Weight of the part, sr.
    pub weight: f64,
    /// (pixels per metre / e₀)².
    pub sharpness: f64,
}

impl Shown {
    /// Whether `rep`, owned by `owner` and resident, is what is shown.
    pub fn is_by(&self, tree: &LodTree, rep: RepId) -> bool {
        self.rep.map_or_else(|| tree.error(rep) as f32 == self.error, |by| by == rep)
    }
}

impl Quality {
    fn count(&mut self, part: &Shown) {
        if part.owner.is_some() {
            self.benefit += part.weight * accuracy(f64::from(part.error), part.sharpness);
            if is_within(f64::from(part.error), part.sharpness, RIVALS_TARGET_PX) {
                self.within_target += part.weight;
            }
        }
    }
}

/// Evaluates a resident set over a cut; `shown` is told every part that is shown with one error.
pub fn evaluate(tree: &LodTree, cut: &Cut, coverage: &Coverage, mut shown: impl FnMut(Shown)) -> Quality {
    if tree.has_directions() {
        return evaluate_elements(tree, cut, coverage, shown);
    }
    let mut quality = Quality::default();
    let mut stack = Vec::new();
    let mut sweep = coverage.sweep(tree, tree.root());
    for patch in &cut.patches {
        let (owner, error, any_beneath) = sweep.shown_at(patch.node);
        quality.weight += patch.weight;
        let mut count = |part: Shown| {
            quality.count(&part);
            shown(part);
        };
        if any_beneath {
            divide(tree, cut, coverage, patch, (owner, error), &mut stack, &mut count);
        } else {
            count(Shown { owner, rep: None, error, weight: patch.weight, sharpness: patch.sharpness });
        }
    }
    quality
}

/// Splits a group's weight by projected area down to what is shown with one error. `stack` is scratch.
fn divide(
    tree: &LodTree,
    cut: &Cut,
    coverage: &Coverage,
    patch: &Patch,
    above: (Option<NodeId>, f32),
    stack: &mut Vec<(NodeId, Option<NodeId>, f32)>,
    count: &mut impl FnMut(Shown),
) {
    let direction = (tree.centre(patch.node) - cut.eye).normalize_or_zero();
    let whole = projected_area(tree, patch.node, direction);
    let density = if whole > 0.0 { patch.weight / whole } else { 0.0 };
    stack.clear();
    stack.push((patch.node, above.0, above.1));
    while let Some((node, owner, error)) = stack.pop() {
        for child in tree.children(node) {
            let (own, any_beneath) = coverage.at(child);
            let (owner, error) = if own < error { (Some(child), own) } else { (owner, error) };
            if any_beneath {
                stack.push((child, owner, error));
            } else {
                let weight = density * projected_area(tree, child, direction);
                count(Shown { owner, rep: None, error, weight, sharpness: patch.sharpness });
            }
        }
    }
}

/// As [`evaluate`], by element: where residents differ beneath a group, each element of it is divided by surface, so that
/// the parts add up to the whole.
fn evaluate_elements(tree: &LodTree, cut: &Cut, coverage: &Coverage, mut shown: impl FnMut(Shown)) -> Quality {
    let mut quality = Quality::default();
    let mut stack: Vec<(NodeId, Elements)> = Vec::new();
    let mut sweep = coverage.sweep_elements(tree, tree.root());
    for patch in &cut.patches {
        let (elements, any_beneath) = sweep.at(patch.node);
        let surface = tree.surface(patch.node);
        let facing = element::facing(tree.centre(patch.node) - cut.eye, tree.half(patch.node), cut.reach);
        let whole = element::projected(&surface, &facing);
        if whole <= 0.0 {
            continue;
        }
        quality.weight += patch.weight;
        let density = facing.map(|m| patch.weight * m / whole);
        let mut count = |surface: &[f64; ELEMENTS], elements: &Elements| {
            for s in (0..ELEMENTS).filter(|&s| surface[s] * density[s] > 0.0) {
                let rep = elements.rep(s);
                let (owner, error) = (rep.map(|rep| tree.node_of(rep)), elements.errors[s]);
                let part = Shown { owner, rep, error, weight: surface[s] * density[s], sharpness: patch.sharpness };
                quality.count(&part);
                shown(part);
            }
        };
        if !any_beneath {
            count(&surface, &elements);
            continue;
        }
        stack.clear();
        stack.push((patch.node, elements));
        while let Some((node, elements)) = stack.pop() {
            for child in tree.children(node) {
                let (own, any_beneath) = coverage.at(child);
                let elements = elements.at(coverage, child, own);
                if any_beneath {
                    stack.push((child, elements));
                } else {
                    count(&tree.surface(child), &elements);
                }
            }
        }
    }
    quality
}
