//! Upper bounds for what lies in a box: nearest distance, frustum, area per byte and least error.

use super::lanes::{Lanes, Looked};
use super::objective::Objective;
use crate::benefit::element::{self, ELEMENTS, Errors};
use crate::benefit::frustum::Side;
use crate::lod_tree::{Beneath, LodTree, NodeId};
use glam::DVec3;

/// The terms among which a box may be seen: a bit each, the last bit for all from the 64th on.
pub(super) type Mask = u64;

/// Every term.
pub(super) const ALL: Mask = Mask::MAX;

/// The bit of a term.
pub(super) fn bit(term: usize) -> Mask {
    1 << term.min(63)
}

/// Covers the rounding of areas to f32 and of the sums in f64, which is below 10⁻⁶ and 10⁻¹².
pub(super) const SLACK: f64 = 1.0 + 1e-6;

/// A bound that is wanted: for candidates with at most this area per byte and at least this error, where at most `shown`
/// is shown.
#[derive(Clone, Copy, Debug)]
pub(super) struct Target {
    density: DVec3,
    least_squared: f64,
    shown: f64,
    /// Elements that it can show better, a bit each; all of them where the world has no directions.
    shows: u16,
}

/// What is shown of a box in a world with directions.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShownElements {
    /// At least the errors of everything in the box, by element; 0 where it has no such surface.
    pub(super) errors: Errors,
}

impl ShownElements {
    /// Of a node where at least `errors` are shown.
    pub(super) fn new(tree: &LodTree, node: NodeId, errors: &Errors) -> ShownElements {
        let surface = tree.surface(node);
        ShownElements { errors: core::array::from_fn(|s| if surface[s] > 0.0 { errors[s] } else { 0.0 }) }
    }

    /// The largest error of what any part of a box can turn to the eye, among the elements of `shows`: what faces it from
    /// no point of the box faces it from none of a part.
    fn worst(&self, facing: &[f64; ELEMENTS], shows: u16) -> f64 {
        let seen = (0..ELEMENTS).filter(|&s| facing[s] > 0.0 && shows >> s & 1 != 0);
        seen.map(|s| f64::from(self.errors[s])).fold(0.0, f64::max)
    }
}

impl Target {
    /// For a representation that shows some elements only: those with less than the error of `others` in `errors`.
    pub(super) fn of_elements(self, errors: &Errors, others: &Errors) -> Target {
        let better = (0..ELEMENTS).filter(|&s| errors[s] < others[s]);
        Target { shows: better.fold(0, |mask, s| mask | 1 << s), ..self }
    }

    /// With `shown` instead of what it was made with; of no worth where that is shown as well already.
    fn shown_as(self, shown: f64) -> Target {
        let density = if shown * shown <= self.least_squared { DVec3::ZERO } else { self.density };
        Target { shown, density, ..self }
    }

    /// For candidates within `bounds` where everything is shown with an error of at most `shown` metres (∞: nothing).
    pub(super) fn new(bounds: &Beneath, shown: f32) -> Target {
        let [x, y, z] = bounds.density.map(f64::from);
        let least = f64::from(bounds.least_error);
        Target { density: DVec3::new(x, y, z), least_squared: least * least, shown: f64::from(shown), shows: u16::MAX }
    }

    /// For everything that has these face areas, m², instead of an area per byte.
    pub(super) fn of_area(areas: DVec3, least_error: f32, shown: f32) -> Target {
        let least = f64::from(least_error);
        Target { density: areas, least_squared: least * least, shown: f64::from(shown), shows: u16::MAX }
    }

    /// Area per byte by axis, or area, m².
    pub(super) fn density(&self) -> DVec3 {
        self.density
    }

    /// Largest accuracy that can be added at a sharpness of exactly `s`.
    pub(super) fn added_at(&self, s: f64) -> f64 {
        let with = 1.0 + self.least_squared * s;
        if self.shown == f64::INFINITY {
            return 1.0 / with;
        }
        let shown_squared = self.shown * self.shown;
        s * (shown_squared - self.least_squared) / (with * (1.0 + shown_squared * s))
    }

    /// At any sharpness up to `s`: the accuracy added rises up to s = 1/(e·e_shown) and falls from there on.
    pub(super) fn added_up_to(&self, s: f64) -> f64 {
        let best = 1.0 / (self.least_squared.sqrt() * self.shown);
        if self.shown == f64::INFINITY {
            // Nearest 1 from far away.
            return 1.0;
        }
        self.added_at(s.min(best))
    }
}

impl Objective {
    /// For each target, at least the gain (per byte, or whole) of every candidate in the box; ∞ where an eye may be inside.
    /// Looks only at the terms of `mask` and returns those that may see the box. `weights` are the terms' shares.
    #[expect(clippy::too_many_arguments, reason = "inputs of one sum; grouping them would only rename them")]
    pub(super) fn bound(
        &self,
        weights: &[f64],
        centre: DVec3,
        half: DVec3,
        mask: Mask,
        targets: &[Target],
        elements: Option<&ShownElements>,
        out: &mut Vec<f64>,
    ) -> Mask {
        out.clear();
        out.resize(targets.len(), 0.0);
        let mut seen = 0;
        // Summed shares of the frusta that see the box from one place.
        let mut place: Option<(usize, f64)> = None;
        for (i, term) in self.terms.iter().enumerate() {
            if mask & bit(i) == 0 {
                continue;
            }
            let relative = centre - term.eye.frustum.eye;
            let reachable = term.eye.is_reachable();
            if reachable {
                // The test is of the sphere around the box, and those around its parts reach out of it: none farther than √2
                // times its radius. A hair more, so that rounding cannot tell a box from its parts.
                let wide = half * (core::f64::consts::SQRT_2 * (1.0 + 1e-9)) + relative.abs() * 1e-12;
                if term.eye.side(relative, wide) == Side::Outside {
                    continue;
                }
            } else if term.planes.iter().any(|(plane, abs)| {
                let extent = abs.dot(half);
                plane.dot(relative) < -extent - 1e-12 * (abs.dot(relative.abs()) + extent)
            }) {
                continue;
            }
            seen |= bit(i);
            if weights[i] <= 0.0 {
                continue;
            }
            if reachable {
                self.bound_from(i, weights[i], relative, half, targets, elements, out);
                continue;
            }
            place = match place {
                Some((first, sum)) if self.is_same_place(first, i) => Some((first, sum + weights[i])),
                before => {
                    if let Some((first, sum)) = before {
                        let centre = centre - self.terms[first].eye.frustum.eye;
                        self.bound_from(first, sum, centre, half, targets, elements, out);
                    }
                    Some((i, weights[i]))
                }
            };
        }
        if let Some((first, sum)) = place {
            self.bound_from(first, sum, centre - self.terms[first].eye.frustum.eye, half, targets, elements, out);
        }
        for bound in out.iter_mut() {
            *bound = if bound.is_nan() { f64::INFINITY } else { *bound * SLACK };
        }
        seen
    }

    fn is_same_place(&self, a: usize, b: usize) -> bool {
        let (a, b) = (&self.terms[a], &self.terms[b]);
        a.eye.frustum.eye == b.eye.frustum.eye && a.sharpness == b.sharpness
    }

    /// Adds what one place with `weight` makes of the box, whose middle is at `centre` from there.
    #[expect(clippy::too_many_arguments, reason = "inputs of one sum; grouping them would only rename them")]
    fn bound_from(
        &self,
        term: usize,
        weight: f64,
        centre: DVec3,
        half: DVec3,
        targets: &[Target],
        elements: Option<&ShownElements>,
        out: &mut [f64],
    ) {
        let (index, term) = (term, &self.terms[term]);
        let reachable = term.eye.is_reachable();
        let delta = (centre.abs() - half).max(DVec3::ZERO);
        let squared = delta.length_squared();
        let distance = squared.sqrt();
        let shown_from = term.eye.shown_distance(distance);
        if let Some(elements) = elements {
            // A hair more, for rounding.
            let slack = 1e-12 * (centre.length() + half.length());
            let facing = element::facing(centre, half, term.eye.reach() + slack);
            let shown = |target: &Target| target.shown_as(elements.worst(&facing, target.shows));
            let targets: Vec<Target> = targets.iter().map(shown).collect();
            return self.bound_from(index, weight, centre, half, &targets, None, out);
        }
        if distance <= 0.0 || (!reachable && shown_from > distance) {
            out.fill(f64::INFINITY);
            return;
        }
        let by_squared = 1.0 / squared;
        // Largest cosine between the directions into the box and each axis.
        let cosines = ((centre.abs() + half) * (distance * by_squared)).min(DVec3::ONE);
        let share = weight * by_squared;
        if reachable {
            let s = term.sharpness / (shown_from * shown_from);
            for (bound, target) in out.iter_mut().zip(targets) {
                *bound += share * target.density.dot(cosines) * target.added_up_to(s);
            }
        } else {
            // Weight × accuracy added is s·Δa(s) up to constants, which rises with s: nearest counts most.
            let s = term.sharpness * by_squared;
            for (bound, target) in out.iter_mut().zip(targets) {
                *bound += share * target.density.dot(cosines) * target.added_at(s);
            }
        }
    }
}

impl Objective {
    /// About what showing a node with `errors` instead of `others` adds, and whether the first term sees it: not a bound.
    pub(super) fn guess<L: Lanes>(
        &self,
        tree: &LodTree,
        weights: &[f64],
        node: NodeId,
        errors: &L,
        others: &L,
    ) -> (f64, bool) {
        let (middle, half, areas) = (tree.centre(node), tree.half(node), tree.face_areas(node));
        let (mut sum, mut in_first) = (0.0, false);
        for (i, term) in self.terms.iter().enumerate() {
            let centre = middle - term.eye.frustum.eye;
            let outside = if term.eye.is_reachable() {
                term.eye.side(centre, half) == Side::Outside
            } else {
                term.planes.iter().any(|(plane, abs)| plane.dot(centre) < -abs.dot(half))
            };
            if outside {
                continue;
            }
            in_first |= term.is_nearest;
            let squared = (centre.length_squared() + 0.25 * half.length_squared()).max(f64::MIN_POSITIVE);
            let distance = squared.sqrt();
            let shown_from = term.eye.shown_distance(distance);
            let area = areas.dot((centre / distance).abs());
            let solid_angle = (area / squared).min(term.eye.frustum.solid_angle);
            let sharpness = term.sharpness / (shown_from * shown_from);
            let at = Looked { node, centre, half, reach: term.eye.reach(), sharpness };
            sum += weights[i] * solid_angle * errors.guessed(others, tree, &at);
        }
        (sum, in_first)
    }
}
