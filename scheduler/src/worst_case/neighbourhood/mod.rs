//! N(v, ε): the views that a client could have in ε, by the way it moves.
//!
//! | kind | eye | orientation q′ |
//! |---|---|---|
//! | free | ball of ϑε | q·exp(a·X + b·Y), ‖(a, b)‖ ≤ ωε: forward anywhere in a cone of ωε, roll kept |
//! | walking | horizontal disc of ϑε, height within a step | U(a)·q·exp(b·X), \|a\| ≤ ωε, \|b\| ≤ ωε, pitch limited |
//! | orbiting | t + s·Q·(p − t): on the shell around t, s within ϑε of the distance | Q·q: t stays where it is on the screen |
//! | path-bound | along a polyline, ϑε of its length either way (\[RAIL\] §3) | as free |
//!
//! X, Y, Z are the camera's axes, U(a) turns by a about the world's up. Q = U(a)·R(side, b) with the horizontal axis `side`
//! across the line of sight to t, |a| and |b| at most min(ϑε/distance, ωε). Two rotations exp(a), exp(b) differ by at most ‖a − b‖ (Hartley
//! and Kahl 2009, lemma 4), and products of rotations about two axes by an
//! angle known in closed form: so boxes of coordinates become cones.

mod distances;

use super::view_box::{DIMENSIONS, ViewBox, Views};
use super::{COORDINATE_MAX, WorstCaseError, within};
use crate::benefit::cut::Region;
use crate::lod_tree::Aabb;
use crate::view::View;
use core::f64::consts::{FRAC_PI_2, PI};
use glam::{DQuat, DVec3};

/// How a client moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum NeighbourhoodKind {
    /// In every direction.
    #[default]
    Free,
    /// On the ground.
    Walk {
        /// The height changes by at most this within ε, metres.
        step: f64,
        /// Greatest angle of the view's centre above and below the horizon, radians.
        pitch_max: f64,
    },
    /// Around the middle of the world.
    Orbit,
    /// Along the path that it has announced.
    Path,
}

impl NeighbourhoodKind {
    /// Every kind with its name, and the defaults of walking: half a metre, 60°.
    pub const ALL: [(&'static str, NeighbourhoodKind); 4] = [
        ("free", NeighbourhoodKind::Free),
        ("walk", NeighbourhoodKind::Walk { step: 0.5, pitch_max: PI / 3.0 }),
        ("orbit", NeighbourhoodKind::Orbit),
        ("path", NeighbourhoodKind::Path),
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            NeighbourhoodKind::Free => "free",
            NeighbourhoodKind::Walk { .. } => "walk",
            NeighbourhoodKind::Orbit => "orbit",
            NeighbourhoodKind::Path => "path",
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
enum Shape {
    Free,
    Walking {
        up: DVec3,
        east: DVec3,
        step: f64,
        pitch: (f64, f64),
    },
    Orbiting {
        target: DVec3,
        up: DVec3,
        side: DVec3,
        distance: f64,
        arc: (f64, f64),
        tilt: (f64, f64),
        nearer: f64,
    },
    /// Corners of the reachable part of the path, each with its length from where the client is.
    PathBound {
        corners: Vec<(f64, DVec3)>,
    },
}

/// The views reachable from one view.
#[derive(Clone, Debug, PartialEq)]
pub struct Neighbourhood {
    view: View,
    reach: f64,
    angle: f64,
    stand_off: f64,
    shape: Shape,
}

/// A set of views such that every reachable one is near one of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Covering {
    /// The samples; the present view is the first.
    pub views: Vec<View>,
    /// Some sample has its eye within this, metres,
    pub radius_m: f64,
    /// and is turned by at most this, radians.
    pub radius_rad: f64,
}

/// A vector across `up`: of the coordinate axes that which is farthest from it, made perpendicular.
fn east_of(up: DVec3) -> DVec3 {
    let axes = [DVec3::X, DVec3::Y, DVec3::Z];
    let axis = axes.into_iter().min_by(|a, b| a.dot(up).abs().total_cmp(&b.dot(up).abs())).unwrap_or(DVec3::X);
    (axis - up * axis.dot(up)).normalize()
}

fn check_up(up: DVec3) -> Result<DVec3, WorstCaseError> {
    check_point("up", up)?;
    within("length of up", up.length(), 1.0 - 1e-6, 1.0 + 1e-6, "1 within 1e-6")?;
    Ok(up.normalize())
}

fn check_view(view: &View) -> Result<(), WorstCaseError> {
    view.check()?;
    check_point("position", view.position)
}

fn check_point(field: &'static str, value: DVec3) -> Result<(), WorstCaseError> {
    // Not finite fails the comparison too.
    if value.abs().max_element() <= COORDINATE_MAX && value.is_finite() {
        Ok(())
    } else {
        Err(WorstCaseError::Point { field, value })
    }
}

impl Neighbourhood {
    fn new(view: View, reach: f64, angle: f64, shape: Shape) -> Result<Neighbourhood, WorstCaseError> {
        check_view(&view)?;
        within("reach", reach, 0.0, COORDINATE_MAX, "metres from 0 to 1e15")?;
        within("angle", angle, 0.0, f64::MAX, "radians, not negative")?;
        Ok(Neighbourhood { view, reach, angle: angle.min(PI), stand_off: 0.0, shape })
    }

    /// Of a client that flies: `reach` is ϑε in metres, `angle` ωε in radians; π and more is every direction.
    pub fn free(view: View, reach: f64, angle: f64) -> Result<Neighbourhood, WorstCaseError> {
        Neighbourhood::new(view, reach, angle, Shape::Free)
    }

    /// Of a client on the ground, `up` a unit vector, whose height changes by at most `step` metres and whose view's centre stays within
    /// `pitch_max` of the horizon; a pitch already beyond may stay what it is.
    pub fn walking(
        view: View,
        reach: f64,
        angle: f64,
        up: DVec3,
        step: f64,
        pitch_max: f64,
    ) -> Result<Neighbourhood, WorstCaseError> {
        let up = check_up(up)?;
        within("step", step, 0.0, COORDINATE_MAX, "metres, not negative")?;
        within("pitch_max", pitch_max, 0.0, FRAC_PI_2, "radians from 0 to π/2")?;
        let mut made = Neighbourhood::new(view, reach, angle, Shape::Free)?;
        let elevation = libm::asin(view.forward().dot(up).clamp(-1.0, 1.0));
        let low = (-pitch_max - elevation).min(0.0).max(-made.angle);
        let high = (pitch_max - elevation).max(0.0).min(made.angle);
        made.shape = Shape::Walking { up, east: east_of(up), step, pitch: (low, high) };
        Ok(made)
    }

    /// Of a client that orbits about `target`, whatever of it it looks at; it comes no closer than a hundredth of its
    /// distance, and the line of sight stays a degree off the vertical unless it is there already.
    pub fn orbiting(
        view: View,
        target: DVec3,
        up: DVec3,
        reach: f64,
        angle: f64,
    ) -> Result<Neighbourhood, WorstCaseError> {
        let up = check_up(up)?;
        check_point("target", target)?;
        let mut made = Neighbourhood::new(view, reach, angle, Shape::Free)?;
        let arm = view.position - target;
        let distance = arm.length();
        if distance <= 0.0 {
            return Err(WorstCaseError::Contradiction {
                field: "distance from the target",
                value: distance,
                contradiction: "a client cannot orbit about where it is",
            });
        }
        let along = arm / distance;
        let side = up.cross(along).try_normalize().unwrap_or_else(|| east_of(up));
        let most = (reach / distance).min(made.angle);
        // Turning by b about `side` lowers the eye by b.
        let elevation = libm::asin(along.dot(up).clamp(-1.0, 1.0));
        let pole = FRAC_PI_2 - PI / 180.0;
        let tilt = ((elevation - pole).min(0.0).max(-most), (elevation + pole).max(0.0).min(most));
        let nearer = reach.min(0.99 * distance);
        made.shape = Shape::Orbiting { target, up, side, distance, arc: (-most, most), tilt, nearer };
        Ok(made)
    }

    /// Of a client that moves forth and back along `track`, from the point of it that is nearest; the client must be on
    /// it, within `reach` or a tenth of a metre.
    pub fn path_bound(view: View, track: &[DVec3], reach: f64, angle: f64) -> Result<Neighbourhood, WorstCaseError> {
        for &corner in track {
            check_point("corner of the path", corner)?;
        }
        let mut made = Neighbourhood::new(view, reach, angle, Shape::Free)?;
        let mut best: Option<(f64, usize, DVec3)> = None;
        for (i, leg) in track.windows(2).enumerate() {
            let along = leg[1] - leg[0];
            let share = ((view.position - leg[0]).dot(along) / along.length_squared()).clamp(0.0, 1.0);
            let point = leg[0] + along * if share.is_nan() { 0.0 } else { share };
            let off = point.distance(view.position);
            if best.is_none_or(|(least, _, _)| off < least) {
                best = Some((off, i, point));
            }
        }
        let Some((off, leg, point)) = best else {
            return Err(WorstCaseError::Contradiction {
                field: "corners of the path",
                value: track.len() as f64,
                contradiction: "a path has at least two",
            });
        };
        if off > reach.max(0.1) {
            return Err(WorstCaseError::Contradiction {
                field: "distance from the path",
                value: off,
                contradiction: "a path-bound client is on its path",
            });
        }
        let walk = |ahead: &mut dyn Iterator<Item = DVec3>| {
            let (mut at, mut from, mut out) = (0.0, point, Vec::new());
            for to in ahead {
                let length = from.distance(to);
                if length <= 0.0 {
                    continue;
                }
                if at + length >= reach {
                    out.push((reach, from + (to - from) * ((reach - at) / length)));
                    break;
                }
                at += length;
                out.push((at, to));
                from = to;
            }
            out
        };
        let forth = walk(&mut track[leg + 1..].iter().copied());
        let back = walk(&mut track[..=leg].iter().rev().copied());
        let mut corners: Vec<_> = back.into_iter().rev().map(|(at, corner)| (-at, corner)).collect();
        corners.push((0.0, point));
        corners.extend(forth);
        made.shape = Shape::PathBound { corners };
        Ok(made)
    }

    /// The same with a distance (m) that no client falls below, whatever it could reach.
    pub fn with_stand_off(mut self, stand_off: f64) -> Neighbourhood {
        self.stand_off = if stand_off > 0.0 { stand_off.min(COORDINATE_MAX) } else { 0.0 };
        self
    }

    /// The present view.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// Distance that no client falls below, metres.
    pub fn stand_off(&self) -> f64 {
        self.stand_off
    }

    /// Farthest that an eye gets from the present one, metres.
    pub fn farthest(&self) -> f64 {
        self.views(&self.whole()).radius
    }

    /// The region that holds everything that some reachable view could see: as one cut takes it.
    pub fn region(&self) -> Region {
        let whole = self.views(&self.whole());
        let off = whole.eye.distance(self.view.position);
        Region::Reachable { angle: whole.turn, reach: whole.radius + off, stand_off: self.stand_off }
    }

    /// All coordinates; parts of the box may lie outside ([`Neighbourhood::is_outside`]).
    pub fn whole(&self) -> ViewBox {
        let span = |low: f64, high: f64| (0.5 * (low + high), 0.5 * (high - low));
        let (reach, angle) = (self.reach, self.angle);
        let sides = match &self.shape {
            Shape::Free => [span(-reach, reach); 3].into_iter().chain([span(-angle, angle); 2]).collect::<Vec<_>>(),
            Shape::Walking { step, pitch, .. } => vec![
                span(-reach, reach),
                span(-step, *step),
                span(-reach, reach),
                span(-angle, angle),
                span(pitch.0, pitch.1),
            ],
            Shape::Orbiting { arc, tilt, nearer, .. } => {
                vec![span(arc.0, arc.1), span(tilt.0, tilt.1), span(-nearer, reach)]
            }
            Shape::PathBound { corners } => {
                let ends = (corners.first().map_or(0.0, |c| c.0), corners.last().map_or(0.0, |c| c.0));
                vec![span(ends.0, ends.1), (0.0, 0.0), (0.0, 0.0), span(-angle, angle), span(-angle, angle)]
            }
        };
        let mut whole = ViewBox { mid: [0.0; DIMENSIONS], half: [0.0; DIMENSIONS] };
        for (i, (mid, half)) in sides.into_iter().enumerate() {
            (whole.mid[i], whole.half[i]) = (mid, half);
        }
        whole
    }

    /// Whether no view of the box is reachable: the corners of a box around a ball or a disc.
    pub fn is_outside(&self, part: &ViewBox) -> bool {
        let least = |i: usize| (part.mid[i].abs() - part.half[i]).max(0.0);
        let norm = |axes: &[usize]| axes.iter().map(|&i| least(i) * least(i)).sum::<f64>().sqrt();
        let beyond = |axes: &[usize], limit: f64| norm(axes) > limit * (1.0 + 1e-12);
        match self.shape {
            Shape::Free => beyond(&[0, 1, 2], self.reach) || beyond(&[3, 4], self.angle),
            Shape::Walking { .. } => beyond(&[0, 2], self.reach),
            Shape::Orbiting { .. } => false,
            Shape::PathBound { .. } => beyond(&[3, 4], self.angle),
        }
    }

    /// A reachable view near the middle of the box: the middle itself, or the nearest within a ball or a disc.
    pub fn sample(&self, part: &ViewBox) -> View {
        self.reachable(part.mid)
    }

    /// Coordinates of a view of the box that is near `point` and turned towards it: of each the end or the middle that serves
    /// best, one after the other.
    pub(super) fn towards(&self, part: &ViewBox, point: DVec3) -> [f64; DIMENSIONS] {
        let mut at = part.mid;
        // Less is better: the distance of an eye, minus the cosine of a turn.
        let rate = |at: &[f64; DIMENSIONS], axis: usize| {
            let (eye, orientation) = self.at(at);
            let off = point - eye;
            if axis < 3 { off.length() } else { -(orientation * DVec3::NEG_Z).dot(off.normalize_or_zero()) }
        };
        for axis in (0..DIMENSIONS).filter(|&axis| part.half[axis] > 0.0) {
            let mut best = rate(&at, axis);
            for end in [part.mid[axis] - part.half[axis], part.mid[axis] + part.half[axis]] {
                let mut tried = at;
                tried[axis] = end;
                let rated = rate(&tried, axis);
                if rated < best {
                    (at, best) = (tried, rated);
                }
            }
        }
        at
    }

    /// The view at coordinates, moved into the ball or the disc that holds what is reachable.
    pub(super) fn reachable(&self, mut at: [f64; DIMENSIONS]) -> View {
        let mut shrink = |axes: &[usize], limit: f64| {
            let norm = axes.iter().map(|&i| at[i] * at[i]).sum::<f64>().sqrt();
            if norm > limit {
                axes.iter().for_each(|&i| at[i] *= limit / norm);
            }
        };
        match self.shape {
            Shape::Free => {
                shrink(&[0, 1, 2], self.reach);
                shrink(&[3, 4], self.angle);
            }
            Shape::Walking { .. } => shrink(&[0, 2], self.reach),
            Shape::Orbiting { .. } => {}
            Shape::PathBound { .. } => shrink(&[3, 4], self.angle),
        }
        let (position, orientation) = self.at(&at);
        View { position, orientation, ..self.view }
    }

    /// Eye and orientation at coordinates.
    fn at(&self, at: &[f64; DIMENSIONS]) -> (DVec3, DQuat) {
        let q = self.view.orientation;
        let turned = || (q * DQuat::from_scaled_axis(DVec3::new(at[3], at[4], 0.0))).normalize();
        match &self.shape {
            Shape::Free => (self.view.position + DVec3::new(at[0], at[1], at[2]), turned()),
            Shape::Walking { up, east, .. } => {
                let turned = DQuat::from_axis_angle(*up, at[3]) * q * DQuat::from_rotation_x(at[4]);
                let moved = *east * at[0] + *up * at[1] + up.cross(*east) * at[2];
                (self.view.position + moved, turned.normalize())
            }
            Shape::Orbiting { target, up, side, distance, .. } => {
                let turn = DQuat::from_axis_angle(*up, at[0]) * DQuat::from_axis_angle(*side, at[1]);
                let arm = (self.view.position - target) * ((distance + at[2]) / distance);
                (target + turn * arm, (turn * q).normalize())
            }
            Shape::PathBound { corners } => (along(corners, at[0]), turned()),
        }
    }

    /// What the views of a box have in common.
    pub fn views(&self, part: &ViewBox) -> Views {
        let (eye, orientation) = self.at(&part.mid);
        let h = &part.half;
        let mut views =
            Views { eye, half: DVec3::new(h[0], h[1], h[2]), radius: 0.0, orientation, turn: 0.0, turns: DVec3::ZERO };
        views.radius = views.half.length();
        views.turn = libm::hypot(h[3], h[4]);
        match &self.shape {
            Shape::Free => {
                views.radius =
                    views.radius.min(self.reach + DVec3::new(part.mid[0], part.mid[1], part.mid[2]).length());
                views.turn = views.turn.min(self.angle + libm::hypot(part.mid[3], part.mid[4]));
            }
            Shape::Walking { up, east, step, .. } => {
                views.half = east.abs() * h[0] + up.abs() * h[1] + up.cross(*east).abs() * h[2];
                let flat = libm::hypot(h[0], h[2]).min(self.reach + libm::hypot(part.mid[0], part.mid[2]));
                views.radius = libm::hypot(flat, h[1].min(*step));
                views.turn = turn_of((*up, h[3]), (self.view.orientation * DVec3::X, h[4]));
            }
            Shape::Orbiting { up, side, distance, .. } => {
                // A chord of angle x is at most x long on the unit sphere, and at most 2.
                let turn = turn_of((*up, h[0]), (*side, h[1]));
                views.radius = h[2] + (distance + part.mid[2]) * turn.min(2.0);
                views.half = DVec3::splat(views.radius);
                views.turn = turn;
            }
            Shape::PathBound { corners } => {
                let (low, high) = (part.mid[0] - h[0], part.mid[0] + h[0]);
                let ends = [along(corners, low), along(corners, high)];
                let between = corners.iter().filter(|c| c.0 > low && c.0 < high).map(|c| c.1);
                let mut bounds = Aabb::EMPTY;
                for point in ends.into_iter().chain(between) {
                    bounds = bounds.union(Aabb { min: point, max: point });
                }
                views.eye = bounds.centre();
                views.half = 0.5 * (bounds.max - bounds.min);
                views.radius = views.half.length();
                views.turn = views.turn.min(self.angle + libm::hypot(part.mid[3], part.mid[4]));
            }
        }
        views.turn = (views.turn + 1e-14).min(PI);
        views.turns = self.turns_of(part, &views) + 1e-14;
        // Eyes are rounded to doubles.
        let blur = 4.0 * f64::EPSILON * (views.eye.abs() + views.half);
        views.half += blur;
        views.radius += 2.0 * blur.max_element();
        views
    }

    /// [`Views::turns`]. The angular velocity of exp(m + s·d) about the camera's axes is d, less up to θ²/6 of |d| across m,
    /// and up to θ/2 of |d| about the line of sight, θ = |m + s·d| (Rodrigues); of U(a)·q·exp(b·X) it is ȧ about `up`, as
    /// the camera has it, and ḃ about X.
    fn turns_of(&self, part: &ViewBox, views: &Views) -> DVec3 {
        let (first, second) = (part.half[3], part.half[4]);
        match &self.shape {
            Shape::Free | Shape::PathBound { .. } => {
                let turn = libm::hypot(first, second);
                let theta = libm::hypot(part.mid[3].abs() + first, part.mid[4].abs() + second);
                let across = theta * theta / 6.0 * turn;
                DVec3::new(first + across, second + across, 0.5 * theta * turn).min(DVec3::splat(PI))
            }
            Shape::Walking { up, .. } => {
                let up = views.orientation.conjugate() * *up;
                first * (up.abs() + views.turn).min(DVec3::ONE) + DVec3::X * second
            }
            Shape::Orbiting { .. } => DVec3::splat(views.turn),
        }
    }

    /// Whether `view` is reachable, to 10⁻⁶ of a radian and of the distances involved.
    pub fn contains(&self, view: &View) -> bool {
        if view.check().is_err() || view.fov_y != self.view.fov_y || view.viewport != self.view.viewport {
            return false;
        }
        let slack = 1e-6 * (1.0 + self.reach) + 1e-9 * self.view.position.length();
        let moved = view.position - self.view.position;
        let turned = crate::predict::motion::rotation_vector(self.view.orientation.conjugate() * view.orientation);
        let looks = |turned: DVec3| turned.z.abs() <= 1e-6 && turned.length() <= self.angle + 1e-6;
        match &self.shape {
            Shape::Free => moved.length() <= self.reach + slack && looks(turned),
            Shape::Walking { up, east, step, pitch } => {
                let height = moved.dot(*up);
                let flat = (moved - *up * height).length();
                let (before, after) = (self.view.orientation * DVec3::X, view.orientation * DVec3::X);
                let azimuth = |v: DVec3| libm::atan2(v.dot(up.cross(*east)), v.dot(*east));
                let yaw = libm::remainder(azimuth(after) - azimuth(before), 2.0 * PI);
                let rest = (DQuat::from_axis_angle(*up, yaw) * self.view.orientation).conjugate() * view.orientation;
                let rest = crate::predict::motion::rotation_vector(rest);
                let pitched =
                    libm::hypot(rest.y, rest.z) <= 1e-6 && rest.x >= pitch.0 - 1e-6 && rest.x <= pitch.1 + 1e-6;
                flat <= self.reach + slack && height.abs() <= step + slack && yaw.abs() <= self.angle + 1e-6 && pitched
            }
            Shape::Orbiting { target, up, side, distance, arc, tilt, nearer } => {
                let arm = view.position - target;
                let length = arm.length();
                if length < distance - nearer - slack || length > distance + self.reach + slack {
                    return false;
                }
                let before = (self.view.position - target) / distance;
                let east = east_of(*up);
                let elevation = |v: DVec3| libm::asin(v.dot(*up).clamp(-1.0, 1.0));
                let azimuth = |v: DVec3| libm::atan2(v.dot(up.cross(east)), v.dot(east));
                let b = elevation(before) - elevation(arm / length);
                let a = libm::remainder(azimuth(arm) - azimuth(before), 2.0 * PI);
                let turn = DQuat::from_axis_angle(*up, a) * DQuat::from_axis_angle(*side, b);
                let off = crate::predict::motion::rotation_vector(
                    (turn * self.view.orientation).conjugate() * view.orientation,
                );
                off.length() <= 1e-6
                    && (arc.0 - 1e-6..=arc.1 + 1e-6).contains(&a)
                    && (tilt.0 - 1e-6..=tilt.1 + 1e-6).contains(&b)
            }
            Shape::PathBound { corners } => {
                let off = corners.windows(2).map(|leg| {
                    let along = leg[1].1 - leg[0].1;
                    let share = ((view.position - leg[0].1).dot(along) / along.length_squared()).clamp(0.0, 1.0);
                    (leg[0].1 + along * share).distance(view.position)
                });
                let off = off.fold(corners[0].1.distance(view.position), f64::min);
                off <= slack && looks(turned)
            }
        }
    }

    /// At most `count` boxes that hold every reachable view, halved along their longest side; a metre counts as
    /// `radians_per_metre`.
    pub fn boxes(&self, count: usize, radians_per_metre: f64) -> Vec<ViewBox> {
        let mut boxes = vec![self.whole()];
        let mut halved = Vec::new();
        while 2 * boxes.len() <= count {
            let Some(axis) = self.longest(&boxes[0], radians_per_metre) else { break };
            halved.clear();
            halved.extend(boxes.iter().flat_map(|part| part.split(axis)).filter(|part| !self.is_outside(part)));
            core::mem::swap(&mut boxes, &mut halved);
        }
        boxes
    }

    /// The dimension along which a box is longest, if it can still be halved there.
    pub fn longest(&self, part: &ViewBox, radians_per_metre: f64) -> Option<usize> {
        let length = |axis: usize| {
            let scale = match (&self.shape, axis) {
                // A radian of an orbit moves and turns.
                (Shape::Orbiting { distance, .. }, 0 | 1) => 1.0 + distance * radians_per_metre,
                (_, 0..=2) => radians_per_metre,
                _ => 1.0,
            };
            scale * part.half[axis]
        };
        (0..DIMENSIONS).filter(|&axis| part.is_divisible(axis)).max_by(|&a, &b| length(a).total_cmp(&length(b)))
    }

    /// At most `count` + 1 samples such that every reachable view is near one.
    pub fn covering(&self, count: usize, radians_per_metre: f64) -> Covering {
        let boxes = self.boxes(count.clamp(1, 1 << 20), radians_per_metre);
        let mut covering = Covering { views: vec![self.view], radius_m: 0.0, radius_rad: 0.0 };
        for part in &boxes {
            let views = self.views(part);
            let sample = self.sample(part);
            // Projecting the middle onto the convex ball or disc brings it no farther from what lies within; along a path
            // the middle of the box need not be on it.
            covering.radius_m = covering.radius_m.max(
                views.radius
                    + match self.shape {
                        Shape::PathBound { .. } => sample.position.distance(views.eye),
                        _ => 0.0,
                    },
            );
            covering.radius_rad = covering.radius_rad.max(views.turn);
            covering.views.push(sample);
        }
        covering
    }
}

/// Greatest angle of a rotation by at most so much about one axis, then by at most so much about another: half of it has the
/// cosine cos(a/2)·cos(b/2) − |cos| of the axes' angle × sin(a/2)·sin(b/2).
fn turn_of(first: (DVec3, f64), second: (DVec3, f64)) -> f64 {
    let (a, b) = (0.5 * first.1, 0.5 * second.1);
    let across = first.0.dot(second.0).abs().min(1.0);
    let cos = libm::cos(a) * libm::cos(b) - across * libm::sin(a) * libm::sin(b);
    // Where the sum is small the cosine has lost its digits; the sum of the angles is a bound too.
    if a + b < 1e-4 || a + b >= FRAC_PI_2 { 2.0 * (a + b) } else { 2.0 * libm::acos(cos.clamp(-1.0, 1.0)) + 1e-11 }
}

/// The point of a polyline at length `at`.
fn along(corners: &[(f64, DVec3)], at: f64) -> DVec3 {
    let next = corners.partition_point(|c| c.0 < at).clamp(1, corners.len().max(2) - 1);
    match (corners.get(next - 1), corners.get(next)) {
        (Some(a), Some(b)) if b.0 > a.0 => a.1.lerp(b.1, ((at - a.0) / (b.0 - a.0)).clamp(0.0, 1.0)),
        (Some(a), _) => a.1,
        _ => DVec3::ZERO,
    }
}
