//! The objective as a set of views, each with its share: J(R) is their weighted sum.
//!
//! The integral of ARCHITECTURE.md is a midpoint rule: one view an interval of \[t, t+δ\] and predicted path, and the worst
//! case is one more. Nothing is summed here: a candidate's gain is summed over its own subtree when it is asked for.

use super::rough::Place;
use crate::benefit::cut::{Cut, CutSettings, Eye, Region};
use crate::lod_tree::LodTree;
use crate::predict::PredictedPath;
use crate::select::horizon::Worst;
use crate::view::View;

/// θ of the cuts that only scale the weights of a view to its frustum.
const SCALE_OPENING: f64 = 0.8;

/// What the objective is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectiveSettings {
    /// α: share of the predicted paths; the rest is the worst case.
    pub alpha: f64,
    /// Attenuation rate per second: att(u) = exp(−rate·u).
    pub attenuation: f64,
    /// Opening angle, near plane and centre weighting.
    pub cut: CutSettings,
}

/// One view of the objective.
#[derive(Clone, Debug)]
pub(super) struct Term {
    pub(super) eye: Eye,
    /// Half-spaces of the frustum, each with its absolute values; a box outside one of them weighs nothing.
    pub(super) planes: [(glam::DVec3, glam::DVec3); 4],
    /// (pixels per radian / e₀)²: the sharpness is this over the squared distance.
    pub(super) sharpness: f64,
    /// Interval of time, as a place in `spans`; the last one is always.
    pub(super) span: usize,
    /// Share of the objective, with the view's scale.
    factor: f64,
    /// Whether this is the first view of the first path, or of another camera's first.
    pub(super) is_nearest: bool,
}

/// The views and their shares.
#[derive(Clone, Debug, Default)]
pub struct Objective {
    pub(super) terms: Vec<Term>,
    /// Ends of the intervals, seconds from now.
    spans: Vec<(f64, f64)>,
    pub(super) places: Vec<Place>,
    /// By term.
    pub(super) place_of: Vec<usize>,
    scratch: Cut,
    /// Terms whose share knows their view's scale, from the first on; the rest weigh as if nothing overlapped.
    scaled: usize,
    /// θ of the cuts by which they are scaled.
    scale_opening: f64,
    /// As many paths, from the first on, are each camera's first; at least one is.
    pub(crate) cameras: usize,
}

impl Objective {
    /// Looks ahead anew. `bounds` are the ends of the intervals in seconds, ascending from 0; each of `paths` has a view
    /// per interval, at its middle. `worst` is the view with the region reachable from it, or the worst reachable views.
    pub fn make<'a>(
        &mut self,
        tree: &LodTree,
        paths: &[PredictedPath],
        bounds: &[f64],
        worst: impl Into<Worst<'a>>,
        settings: &ObjectiveSettings,
    ) {
        self.begin(paths, bounds, worst, settings);
        self.scale(tree, usize::MAX);
    }

    /// As [`Objective::make`], but for the scales of the views.
    pub(crate) fn begin<'a>(
        &mut self,
        paths: &[PredictedPath],
        bounds: &[f64],
        worst: impl Into<Worst<'a>>,
        settings: &ObjectiveSettings,
    ) {
        (self.scaled, self.scale_opening) = (0, settings.cut.opening.max(SCALE_OPENING));
        self.terms.clear();
        self.spans.clear();
        self.spans.extend(bounds.windows(2).map(|w| (w[0], w[1])));
        let att: Vec<f64> = self
            .spans
            .iter()
            .map(|(from, to)| (to - from) * libm::exp(-settings.attenuation * 0.5 * (from + to)))
            .collect();
        let whole: f64 = att.iter().sum();
        if settings.alpha > 0.0 && whole > 0.0 {
            for (which, path) in paths.iter().enumerate() {
                for (span, view) in path.views.iter().enumerate().take(att.len()) {
                    let factor = settings.alpha * path.weight * att[span] / whole;
                    let is_nearest = span == 0 && which < self.cameras;
                    self.add(view, Region::Frustum, span, factor, &settings.cut, is_nearest);
                }
            }
        }
        if settings.alpha < 1.0 {
            let cut = CutSettings { centre_falloff: 0.0, ..settings.cut };
            let (always, share) = (self.spans.len(), 1.0 - settings.alpha);
            match worst.into() {
                Worst::Union(view, region) => self.add(view, region, always, share, &cut, false),
                Worst::Several(views) => {
                    for (weight, view, region) in views {
                        self.add(view, *region, always, share * weight, &cut, false);
                    }
                }
            }
        }
        // Views from one place follow each other: their distances are taken once.
        self.terms.sort_by(|a, b| {
            let [[ax, ay, az], [bx, by, bz]] = [a, b].map(|t| t.eye.frustum.eye.to_array());
            (a.span.cmp(&b.span)).then(ax.total_cmp(&bx)).then(ay.total_cmp(&by)).then(az.total_cmp(&bz))
        });
        self.find_places();
    }

    /// Scales at most `most` more views to their frusta; true once all are.
    pub(crate) fn scale(&mut self, tree: &LodTree, most: usize) -> bool {
        for term in self.terms.iter_mut().skip(self.scaled).take(most) {
            self.scratch.make_from(tree, &term.eye.with_opening(self.scale_opening));
            term.factor *= self.scratch.scale;
            self.scaled += 1;
        }
        self.scaled == self.terms.len()
    }

    fn add(&mut self, view: &View, region: Region, span: usize, factor: f64, settings: &CutSettings, is_nearest: bool) {
        if factor.is_nan() || factor <= 0.0 {
            return;
        }
        let eye = Eye::new(view, region, settings);
        let half_accuracy = crate::benefit::accuracy::HALF_ACCURACY_PX;
        let ratio = eye.frustum.pixels_per_radian / half_accuracy;
        self.terms.push(Term {
            is_nearest: is_nearest || self.terms.is_empty(),
            planes: eye.frustum.planes.map(|p| (p, p.abs())),
            eye,
            sharpness: ratio * ratio,
            span,
            factor,
        });
    }

    /// Bytes that it occupies.
    pub fn heap_bytes(&self) -> usize {
        self.terms.capacity() * size_of::<Term>() + self.scratch.heap_bytes()
    }

    /// Writes the share of each term that lies after `offset` seconds.
    pub(super) fn weights(&self, offset: f64, weights: &mut Vec<f64>) {
        weights.clear();
        // The terms are in the order of their spans.
        let share_of =
            |span: usize| self.spans.get(span).map_or(1.0, |(from, to)| ((to - offset) / (to - from)).clamp(0.0, 1.0));
        let (mut span, mut share) = (0, share_of(0));
        weights.extend(self.terms.iter().map(|term| {
            if term.span != span {
                (span, share) = (term.span, share_of(term.span));
            }
            term.factor * share
        }));
    }
}
