//! What the views of a neighbourhood could see: leaves and far groups, chosen once for all of them, and bounds on the
//! deficit over a set of views.
//!
//! A leaf has its exact solid angle in the frustum and the accuracy at its nearest point, a far group the projected
//! areas of its leaves and the accuracy at its middle (a far leaf at its nearest point), as in [`crate::benefit::cut`]. A group is kept as one if it is far,
//! by the opening angle, from every reachable eye: so the deficit is one continuous function over the neighbourhood, at
//! each view at least as fine as the view's own cut. Opening 0 is the sum over leaves.

use super::bounds::{Interval, Item, Lens, scale, scaled_sum, solid_angle};
use super::faceted::{self, Faceted};
use super::neighbourhood::Neighbourhood;
use super::slope::{Extent, Slope, slope};
use super::view_box::Views;
use super::{WorstCaseError, check_cut, turned};
use crate::benefit::accuracy::{accuracy, sharpness};
use crate::benefit::coverage::Coverage;
use crate::benefit::cut::CutSettings;
use crate::benefit::frustum::Frustum;
use crate::benefit::solid_angle::of_box_in_frustum;
use crate::lod_tree::{LodTree, NodeId};
use crate::view::View;
use core::ops::Range;
use glam::DVec3;

/// A leaf or a far group with the errors that the resident set shows it with.
#[derive(Clone, Debug)]
struct Target {
    node: NodeId,
    centre: DVec3,
    half: DVec3,
    /// Σ ι·A by axis, m².
    areas: DVec3,
    /// ι; of a far group it is in the areas.
    importance: f64,
    is_far: bool,
    is_leaf: bool,
    /// Into [`Targets::parts`], or [`Targets::faceted`] where the world has directions; a leaf has one.
    parts: Range<u32>,
}

/// Projected areas that are shown with one error.
#[derive(Clone, Copy, Debug)]
struct Part {
    areas: DVec3,
    error: f32,
}

/// Everything that some view of a neighbourhood could see, with a resident set folded in.
#[derive(Clone, Debug)]
pub struct Targets {
    targets: Vec<Target>,
    parts: Vec<Part>,
    /// Instead of `parts` in a world with directions.
    faceted: Vec<Faceted>,
    has_directions: bool,
    view: View,
    near: f64,
    pixels_per_radian: f64,
    solid_angle: f64,
}

/// A view's scaled sums, sr.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Deficit {
    /// min(1, Ω/Σw)·Σ w·(1 − q).
    pub deficit: f64,
    /// min(Σw, Ω).
    pub weight: f64,
}

/// Half angles of frusta beyond which polygons are no longer clipped exactly, radians: their solid angles are then
/// bounded by those of the whole box.
const CLIP_CORNER_MAX: f64 = 1.45;

/// Eyes spread by at most this share of a leaf's radius see of it about what the middle sees of the grown box.
const SMALL: f64 = 0.25;
/// Views that turn by less than this, radians, are turned as one.
const TURN_MIN: f64 = 1e-9;
/// Width of a leaf's interval from which on its slope is looked for, as a share of the frustum's solid angle.
const SLOPED_MIN: f64 = 1e-3;
/// What is uncertain about a slope's remainder is at most this share of the interval's width, or the interval serves.
const SLOPED_MAX: f64 = 0.7;
/// A remainder of at most this share of what the slope amounts to leaves nothing to clipped polygons.
const SMOOTH: f64 = 0.3;

impl Targets {
    /// Of a neighbourhood: everything that is not outside for all its views. Distances are at least the near plane and
    /// the stand-off.
    pub fn new(
        tree: &LodTree,
        neighbourhood: &Neighbourhood,
        coverage: &Coverage,
        settings: &CutSettings,
    ) -> Result<Targets, WorstCaseError> {
        check_cut(settings)?;
        let view = *neighbourhood.view();
        let whole = neighbourhood.views(&neighbourhood.whole());
        let lens = Lens::new(&View { position: whole.eye, orientation: whole.orientation, ..view });
        let frustum = &lens.frustum;
        let mut made = Targets {
            targets: Vec::new(),
            parts: Vec::new(),
            faceted: Vec::new(),
            has_directions: tree.has_directions(),
            view,
            near: settings.near.max(neighbourhood.stand_off()),
            pixels_per_radian: view.pixels_per_radian(),
            solid_angle: frustum.solid_angle,
        };
        let mut next = NodeId(0);
        let mut stack = Vec::new();
        while next.index() < tree.nodes() {
            let node = next;
            let (centre, half) = (tree.centre(node) - whole.eye, tree.half(node));
            let side = side_of(frustum, centre, half, &whole);
            if side == Seen::Never {
                next = tree.subtree_end(node);
                continue;
            }
            let opening = if side == Seen::Always { settings.opening } else { 0.5 * settings.opening };
            let is_far = half.length() < opening * (centre.length() - whole.radius);
            if !tree.is_leaf(node) && !is_far {
                next = NodeId(node.0 + 1);
                continue;
            }
            next = tree.subtree_end(node);
            let first = made.parts_len();
            let above = coverage.best_above(tree, node);
            if tree.has_directions() {
                faceted::add(&mut made.faceted, tree, coverage, node);
            } else if coverage.any_beneath(node) {
                stack.clear();
                stack.push((node, above));
                while let Some((inner, error)) = stack.pop() {
                    for child in tree.children(inner) {
                        let error = error.min(coverage.best_at(child));
                        if coverage.any_beneath(child) {
                            stack.push((child, error));
                        } else {
                            made.parts.push(Part { areas: tree.face_areas(child), error });
                        }
                    }
                }
            } else {
                made.parts.push(Part { areas: tree.face_areas(node), error: above });
            }
            let (areas, importance) = (tree.face_areas(node), tree.importance(node));
            // What weighs nothing from anywhere is left out.
            if importance <= 0.0 && tree.is_leaf(node) || is_far && areas == DVec3::ZERO {
                made.parts.truncate(first as usize);
                made.faceted.truncate(first as usize);
                continue;
            }
            let (centre, parts) = (tree.centre(node), first..made.parts_len());
            let is_leaf = tree.is_leaf(node);
            made.targets.push(Target { node, centre, half, areas, importance, is_far, is_leaf, parts });
        }
        Ok(made)
    }

    fn parts_len(&self) -> u32 {
        self.parts.len().max(self.faceted.len()) as u32
    }

    /// The parts of a target by element.
    fn facets(&self, target: &Target) -> &[Faceted] {
        &self.faceted[target.parts.start as usize..target.parts.end as usize]
    }

    /// How many there are: what evaluating a view costs.
    pub fn len(&self) -> usize {
        self.targets.len()
    }

    /// Whether nothing can be seen.
    pub fn is_empty(&self) -> bool {
        self.targets.is_empty()
    }

    /// Solid angle of the frustum, sr.
    pub fn solid_angle(&self) -> f64 {
        self.solid_angle
    }

    /// The nodes: leaves, and groups that are far from every reachable eye.
    pub fn nodes(&self) -> impl Iterator<Item = NodeId> + '_ {
        self.targets.iter().map(|t| t.node)
    }

    /// The point of a target's box that is nearest to `eye`.
    pub(super) fn nearest_point(&self, index: u32, eye: DVec3) -> DVec3 {
        let target = &self.targets[index as usize];
        eye.clamp(target.centre - target.half, target.centre + target.half)
    }

    fn deficit_of(&self, error: f32, distance: f64) -> f64 {
        1.0 - accuracy(f64::from(error), sharpness(self.pixels_per_radian, distance.max(self.near)))
    }

    fn deficit_bounds_of(&self, error: f32, nearest: f64, farthest: f64) -> Interval {
        Interval { lo: self.deficit_of(error, farthest), hi: self.deficit_of(error, nearest) }
    }

    /// The deficit of one view; exact up to rounding.
    pub fn at(&self, view: &View) -> Deficit {
        self.sum(view, self.targets.iter())
    }

    /// As [`Targets::at`] where only `among` can be seen.
    pub fn at_among(&self, view: &View, among: &[(u32, Item)]) -> Deficit {
        self.sum(view, among.iter().map(|&(index, _)| &self.targets[index as usize]))
    }

    fn sum<'a>(&self, view: &View, targets: impl Iterator<Item = &'a Target>) -> Deficit {
        let frustum = Frustum::new(view);
        let (mut deficit, mut weight) = (0.0, 0.0);
        for target in targets {
            let (w, wd) = self.value(target, &frustum);
            weight += w;
            deficit += wd;
        }
        let scale = scale(weight, self.solid_angle);
        Deficit { deficit: deficit * scale, weight: weight * scale }
    }

    /// Mean of 1/distance over what the present view sees, by weight: how many radians a metre of motion is worth. Where
    /// it sees nothing, that of the nearest target.
    pub fn radians_per_metre(&self) -> f64 {
        let frustum = Frustum::new(&self.view);
        let (mut sum, mut weight, mut nearest) = (0.0, 0.0, f64::INFINITY);
        for target in &self.targets {
            let centre = target.centre - frustum.eye;
            let distance = (centre.abs() - target.half).max(DVec3::ZERO).length().max(self.near);
            let (w, _) = self.value(target, &frustum);
            weight += w;
            sum += w / distance;
            nearest = nearest.min(distance);
        }
        let mean = if weight > 0.0 { sum / weight } else { 1.0 / nearest };
        if mean.is_finite() { mean } else { 0.0 }
    }

    /// Weight, and weight × deficit.
    fn value(&self, target: &Target, frustum: &Frustum) -> (f64, f64) {
        let centre = target.centre - frustum.eye;
        if target.is_far {
            let distance = centre.length();
            let share = share_inside(frustum, centre, target.half, DVec3::ZERO, 0.0, 0.0).hi;
            if self.has_directions {
                let looked_at = if target.is_leaf { nearest(centre, target.half) } else { distance };
                let weight = share * target.areas.dot(centre.abs() / distance) / (distance * distance);
                let deficit = |error: f32| self.deficit_of(error, looked_at);
                let mean = faceted::mean(self.facets(target), centre, target.half, deficit);
                return mean.map_or((0.0, 0.0), |mean| (weight, weight * mean));
            }
            let projected = |areas: DVec3| areas.dot(centre.abs() / distance) / (distance * distance);
            let parts = &self.parts[target.parts.start as usize..target.parts.end as usize];
            let looked_at = if target.is_leaf { nearest(centre, target.half) } else { distance };
            let wd: f64 = parts.iter().map(|p| projected(p.areas) * self.deficit_of(p.error, looked_at)).sum();
            return (share * projected(target.areas), share * wd);
        }
        let omega = of_box_in_frustum(centre, target.half, frustum, 0b1111);
        let weight = target.importance * omega;
        if self.has_directions {
            let looked_at = nearest(centre, target.half);
            let deficit = |error: f32| self.deficit_of(error, looked_at);
            let mean = faceted::mean(self.facets(target), centre, target.half, deficit);
            return mean.map_or((0.0, 0.0), |mean| (weight, weight * mean));
        }
        let error = self.parts[target.parts.start as usize].error;
        (weight, weight * self.deficit_of(error, nearest(centre, target.half)))
    }

    /// Weight and deficit of every target that some of the views may see, into `found`. Only the targets named by `among`
    /// are looked at, or all.
    pub fn enclose(&self, views: &Views, among: Option<&[u32]>, found: &mut Vec<(u32, Item)>) {
        self.enclose_with_slopes(views, among, found, &mut Vec::new());
    }

    /// As [`Targets::enclose`], and into `slopes` the weights of those that are known to first order.
    pub(super) fn enclose_with_slopes(
        &self,
        views: &Views,
        among: Option<&[u32]>,
        found: &mut Vec<(u32, Item)>,
        slopes: &mut Vec<(u32, Slope)>,
    ) {
        let lens = Lens::new(&View { position: views.eye, orientation: views.orientation, ..self.view });
        let wide = lens.widened(views.turn, views.turns);
        let narrow = lens.narrowed(views.turn, views.turns);
        found.clear();
        slopes.clear();
        let set = SetOfViews { views, extent: Extent::of(views), lens: &lens, wide: &wide, narrow: narrow.as_ref() };
        let all = 0..self.targets.len() as u32;
        let mut look = |index: u32| {
            let (item, slope) = self.bounds(&self.targets[index as usize], &set);
            if item.weight.hi > 0.0 {
                found.push((index, item));
                slopes.extend(slope.map(|slope| (index, slope)));
            }
        };
        match among {
            Some(some) => some.iter().for_each(|&index| look(index)),
            None => all.for_each(&mut look),
        }
    }

    /// Bounds on the deficit over items of [`Targets::enclose`].
    pub fn deficit_bounds(&self, items: &[(u32, Item)]) -> Interval {
        let found = scaled_sum(items.iter().map(|(_, item)| *item), self.solid_angle);
        Interval { lo: found.lo, hi: found.hi.min(self.solid_angle * (1.0 + 1e-12)) }
    }

    fn bounds(&self, target: &Target, set: &SetOfViews) -> (Item, Option<Slope>) {
        let centre = target.centre - set.views.eye;
        let side = side_of(&set.lens.frustum, centre, target.half, set.views);
        if side == Seen::Never {
            return (Item::default(), None);
        }
        if target.is_far {
            (self.far_bounds(target, centre, side, set.views, set.lens), None)
        } else {
            self.leaf_bounds(target, centre, side, set)
        }
    }

    fn far_bounds(&self, target: &Target, centre: DVec3, side: Seen, views: &Views, lens: &Lens) -> Item {
        let off = centre.abs();
        let boxed = (off - views.half).max(DVec3::ZERO);
        let nearest = boxed.length().max(centre.length() - views.radius);
        let farthest = (off + views.half).length().min(centre.length() + views.radius);
        let round = 16.0 * f64::EPSILON;
        let hi = target.areas.dot(off + views.half) / (nearest * nearest * nearest) * (1.0 + round);
        let lo = target.areas.dot(boxed) / (farthest * farthest * farthest) * (1.0 - round);
        let share = match side {
            Seen::Always => Interval { lo: 1.0, hi: 1.0 },
            _ => share_inside(&lens.frustum, centre, target.half, views.half, views.radius, views.turn),
        };
        let (mut looked_at, mut looked_from) = (nearest, farthest);
        if target.is_leaf {
            let outside = off - target.half;
            let here = outside.max(DVec3::ZERO).length();
            looked_at = (outside - views.half).max(DVec3::ZERO).length().max(here - views.radius);
            looked_from = (outside + views.half).max(DVec3::ZERO).length().min(here + views.radius);
        }
        if self.has_directions {
            let bounds = |error: f32| self.deficit_bounds_of(error, looked_at, looked_from);
            let Some((mean, always)) = faceted::bounds(self.facets(target), centre, target.half, views, bounds) else {
                return Item::default();
            };
            return Item {
                weight: sane(if always { share.lo * lo } else { 0.0 }, share.hi * hi, f64::INFINITY),
                share: sane(mean.lo * (1.0 - 1e-9), mean.hi * (1.0 + 1e-9), 1.0),
            };
        }
        let (mut most, mut least) = (0.0f64, 1.0f64);
        let (mut above, mut below) = (DVec3::ZERO, DVec3::ZERO);
        for part in &self.parts[target.parts.start as usize..target.parts.end as usize] {
            let (d_hi, d_lo) = (self.deficit_of(part.error, looked_at), self.deficit_of(part.error, looked_from));
            most = most.max(d_hi);
            least = least.min(d_lo);
            above += part.areas * d_hi;
            below += part.areas * d_lo;
        }
        // The share is a quotient of sums that are linear in the directions' components: extreme where each of these is
        // least or greatest. Where areas are sums in single precision, the parts may sum to a little more or less than
        // the whole.
        let (mut hi_share, mut lo_share) = (0.0f64, 1.0f64);
        for corner in 0..8u32 {
            let pick = |axis: usize| if corner & 1 << axis != 0 { off[axis] + views.half[axis] } else { boxed[axis] };
            let along = DVec3::new(pick(0), pick(1), pick(2));
            let whole = target.areas.dot(along);
            if whole > 0.0 {
                hi_share = hi_share.max(above.dot(along) / whole);
                lo_share = lo_share.min(below.dot(along) / whole);
            }
        }
        let (hi_share, lo_share) = (hi_share.min(most * (1.0 + 1e-5)), lo_share.max(least * (1.0 - 1e-5)));
        Item {
            weight: sane(share.lo * lo, share.hi * hi, f64::INFINITY),
            share: sane(lo_share * (1.0 - 1e-9), hi_share * (1.0 + 1e-9), 1.0 + 1e-4),
        }
    }

    fn leaf_bounds(&self, target: &Target, centre: DVec3, side: Seen, set: &SetOfViews) -> (Item, Option<Slope>) {
        let SetOfViews { views, lens, wide, narrow, .. } = *set;
        let (half, frustum) = (target.half, &lens.frustum);
        let outside = centre.abs() - half;
        let here = outside.max(DVec3::ZERO).length();
        let nearest = (outside - views.half).max(DVec3::ZERO).length().max(here - views.radius);
        let farthest = (outside + views.half).max(DVec3::ZERO).length().min(here + views.radius);
        let mut omega = solid_angle(centre, half, views.half, views.radius);
        omega.hi = omega.hi.min(frustum.solid_angle);
        omega.lo = omega.lo.min(frustum.solid_angle);
        // Clipped polygons are good to this, the modulus of their triangles being at least 4cos³ of the corner's angle.
        let clips = wide.corner_angle < CLIP_CORNER_MAX;
        let cos = libm::cos(wide.corner_angle);
        let slack = 1e-14 / (cos * cos * cos);
        let mut sloped = None;
        if (centre.abs() + views.half).cmple(half).all() {
            // From within, a leaf fills every view.
            omega = Interval { lo: frustum.solid_angle, hi: frustum.solid_angle };
        } else {
            let whole = omega;
            if side != Seen::Always {
                omega.lo = 0.0;
            }
            if omega.width() > SLOPED_MIN * frustum.solid_angle {
                sloped = slope(lens, centre, half, views);
            }
            let mut is_smooth = false;
            if let Some(slope) = &sloped {
                let by = set.extent.most(slope.moved, slope.turned);
                is_smooth = slope.rest <= SMOOTH * by;
                omega.hi = omega.hi.min(slope.middle + by + slope.rest);
                omega.lo = omega.lo.max(slope.middle - by - slope.rest).min(omega.hi);
            }
            if clips && !is_smooth && side != Seen::Always {
                // What some eye sees of the box, the middle sees of the box grown by the eyes' spread.
                let grown = of_box_in_frustum(centre, half + views.half, wide, 0b1111) + slack;
                omega.hi = omega.hi.min(grown);
                if views.radius < 0.5 * here && views.radius > SMALL * half.length() {
                    // Or: it sees it turned by at most asin(r/d), and larger by at most the factor of the faces.
                    let unclipped = solid_angle(centre, half, DVec3::ZERO, 0.0);
                    if unclipped.lo > 0.0 && views.radius > 0.0 {
                        let factor = front_factor(centre, half, views);
                        let off = libm::asin((views.radius / here).min(1.0));
                        let turned = lens.widened(views.turn + off, views.turns + off);
                        if turned.corner_angle < CLIP_CORNER_MAX && factor.is_finite() {
                            let cos = libm::cos(turned.corner_angle);
                            let part = of_box_in_frustum(centre, half, &turned, 0b1111) + 1e-14 / (cos * cos * cos);
                            omega.hi = omega.hi.min(part * factor);
                        }
                    }
                }
                // What is wider than the views turn is better turned against the views than the views against it.
                let is_wide = views.turn > TURN_MIN && half.length() > views.turn * here;
                if is_wide && let Some(most) = turned::solid_angle(lens, centre, half + views.half, views, 1.0) {
                    omega.hi = omega.hi.min(most + slack);
                }
                let seen_least = |centre: DVec3, half: DVec3| {
                    let within = narrow.map_or(0.0, |narrow| of_box_in_frustum(centre, half, narrow, 0b1111));
                    let turned = if is_wide { turned::solid_angle(lens, centre, half, views, -1.0) } else { None };
                    (within.max(turned.unwrap_or(0.0)) - slack).max(0.0)
                };
                // What every eye sees of the box, as the middle sees it: the box less the eyes' spread, or, of what is
                // thin, so much of its faces.
                let shrunk = half - views.half;
                let least = if shrunk.min_element() >= 0.0 {
                    seen_least(centre, shrunk)
                } else {
                    (0..3)
                        .filter_map(|axis| turned::core_of_face(centre, half, views.half, axis))
                        .map(|(centre, half)| seen_least(centre, half))
                        .sum()
                };
                omega.lo = omega.lo.max(least.min(whole.hi)).min(omega.hi);
            }
        }
        if self.has_directions {
            let bounds = |error: f32| self.deficit_bounds_of(error, nearest, farthest);
            let Some((mean, always)) = faceted::bounds(self.facets(target), centre, target.half, views, bounds) else {
                return (Item::default(), None);
            };
            let least = if always { target.importance * omega.lo } else { 0.0 };
            let item = Item {
                weight: sane(least, target.importance * omega.hi, f64::INFINITY),
                share: sane(mean.lo * (1.0 - 1e-9), mean.hi * (1.0 + 1e-9), 1.0),
            };
            return (item, None);
        }
        let error = self.parts[target.parts.start as usize].error;
        let item = Item {
            weight: sane(target.importance * omega.lo, target.importance * omega.hi, f64::INFINITY),
            share: sane(self.deficit_of(error, farthest) - 1e-15, self.deficit_of(error, nearest) + 1e-15, 1.0),
        };
        // Else the interval says as much.
        let sloped = sloped.filter(|slope| 2.0 * slope.rest <= SLOPED_MAX * omega.width());
        (item, sloped.map(|slope| slope.times(target.importance)))
    }
}

/// A box of views in its several forms.
struct SetOfViews<'a> {
    views: &'a Views,
    extent: Extent,
    lens: &'a Lens,
    wide: &'a Frustum,
    narrow: Option<&'a Frustum>,
}

/// Distance to the nearest point of a box.
fn nearest(centre: DVec3, half: DVec3) -> f64 {
    (centre.abs() - half).max(DVec3::ZERO).length()
}

/// Greatest factor by which the integrand z/r³ of any front face grows between the middle and another eye; ∞ where a
/// face may turn to the front.
fn front_factor(centre: DVec3, half: DVec3, views: &Views) -> f64 {
    let outside = centre.abs() - half;
    let mut factor = 0.0f64;
    for axis in 0..3 {
        let z = outside[axis];
        if z + views.half[axis] <= 0.0 {
            continue;
        }
        if z <= views.half[axis] {
            return f64::INFINITY;
        }
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        let distance = DVec3::new(z, outside[i].max(0.0), outside[j].max(0.0)).length();
        let towards = 1.0 - views.radius / distance;
        if towards <= 0.0 {
            return f64::INFINITY;
        }
        factor = factor.max((1.0 + views.half[axis] / z) / (towards * towards * towards));
    }
    factor * (1.0 + 1e-12)
}

/// An interval within [0, most]; everything possible where rounding or overflow has left none.
fn sane(lo: f64, hi: f64, most: f64) -> Interval {
    let lo = if lo > 0.0 { lo.min(most) } else { 0.0 };
    let hi = if hi.is_nan() { most } else { hi.clamp(0.0, most) };
    Interval { lo: lo.min(hi), hi }
}

/// Whether the frusta of a set of views hold a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Seen {
    /// Some plane of every view has it outside, the same for all.
    Never,
    Sometimes,
    /// Every view has it inside.
    Always,
}

/// A plane's distance to the box's middle changes by at most |middle|·2sin(turn/2) + radius between views.
fn side_of(frustum: &Frustum, centre: DVec3, half: DVec3, views: &Views) -> Seen {
    let chord = 2.0 * libm::sin(0.5 * views.turn);
    let slack = chord * centre.length() + views.radius + 1e-12 * (centre.length() + views.radius);
    let turned = chord * half.length();
    let mut seen = Seen::Always;
    for plane in &frustum.planes {
        let distance = plane.dot(centre);
        let extent = plane.abs().dot(half) + turned;
        if distance + slack < -extent {
            return Seen::Never;
        }
        if distance - slack < extent {
            seen = Seen::Sometimes;
        }
    }
    seen
}

/// Interval of the share of a far group inside the frustum, as the cut has it: a ramp over its extent across each plane.
fn share_inside(frustum: &Frustum, centre: DVec3, half: DVec3, spread: DVec3, radius: f64, turn: f64) -> Interval {
    let chord = 2.0 * libm::sin(0.5 * turn);
    let turned = chord * half.length();
    let round = if radius > 0.0 || turn > 0.0 { 1e-12 * (centre.length() + radius) } else { 0.0 };
    let mut share = Interval { lo: 1.0, hi: 1.0 };
    for plane in &frustum.planes {
        let moved = plane.abs().dot(spread).min(radius);
        let slack = chord * (centre.length() + radius) + moved + round;
        let (distance, extent) = (plane.dot(centre), plane.abs().dot(half));
        let (wide, thin) = (extent + turned, (extent - turned).max(0.0));
        let ramp = |distance: f64, extent: f64| {
            let share = (0.5 + 0.5 * distance / extent).clamp(0.0, 1.0);
            // A group without extent is inside or not.
            if extent > 0.0 { share } else { f64::from(u8::from(distance >= 0.0)) }
        };
        let (low, high) = (distance - slack, distance + slack);
        share.hi *= ramp(high, if high > 0.0 { thin } else { wide });
        share.lo *= ramp(low, if low >= 0.0 { wide } else { thin });
    }
    share
}
