//! Solid angles of clipped boxes as Taylor models.

use super::model::{Model, ULP, Vector, cross, dot, minus, plus, times};
use crate::benefit::solid_angle::outline_corners;
use glam::DVec3;

/// A corner of an outline, from the eye; only its direction matters.
#[derive(Clone, Copy)]
pub(super) struct Corner {
    at: Vector,
}

/// The outline of a box from outside, corner by corner; `beyond` names the axes along which the eye lies beyond it.
pub(super) fn outline(centre: &Vector, half: DVec3, beyond: u8) -> Vec<Corner> {
    outline_corners(u32::from(beyond))
        .iter()
        .map(|bits| Corner {
            at: [0, 1, 2].map(|k| {
                let towards = if centre[k].middle() > 0.0 { -half[k] } else { half[k] };
                centre[k] + Model::exact(if bits & (1 << k) != 0 { -towards } else { towards })
            }),
        })
        .collect()
}

/// Twice the signed tangent's parts of the triangle (a, b, c): (x, y) with tan(Ω/2) = y/x (Van Oosterom and Strackee
/// 1983). y by differences, so that small triangles keep their digits.
fn triangle(a: &Lit, b: &Lit, c: &Lit) -> (Model, Model) {
    let y = dot(&a.at, &cross(&minus(&b.at, &a.at), &minus(&c.at, &a.at)));
    let x = a.length * b.length * c.length
        + dot(&a.at, &b.at) * c.length
        + dot(&b.at, &c.at) * a.length
        + dot(&c.at, &a.at) * b.length;
    (x, y)
}

struct Lit {
    at: Vector,
    length: Model,
}

fn lit(corner: &Corner) -> Lit {
    // Scaled to a length near 1, so that near and far corners do not overflow together.
    let longest = corner.at.iter().map(|x| x.middle().abs()).fold(0.0, f64::max);
    let unit = if longest > 0.0 { 1.0 / longest } else { 1.0 };
    let at = corner.at.map(|x| x.scaled(unit));
    Lit { at, length: dot(&at, &at).sqrt() }
}

/// In which sense the outline runs, ±1. Seen edge-on it has none, and no solid angle to speak of either.
pub(super) fn orientation(polygon: &[Corner]) -> f64 {
    let Some(first) = polygon.first() else { return 1.0 };
    let mut sum = Model::ZERO;
    for pair in polygon[1..].windows(2) {
        let normal = cross(&minus(&pair[0].at, &first.at), &minus(&pair[1].at, &first.at));
        sum = sum + dot(&first.at, &normal);
    }
    if sum.middle() < 0.0 { -1.0 } else { 1.0 }
}

/// The polygon inside one half-space through the eye, and the angle (radians, summed over corners) by which corners were
/// moved onto the plane because their side is not clear. `None` where a direction cannot be told.
pub(super) fn clipped(polygon: &[Corner], plane: &Vector) -> Option<(Vec<Corner>, f64)> {
    let mut moved = 0.0;
    let mut heights = Vec::with_capacity(polygon.len());
    for corner in polygon {
        let height = dot(&corner.at, plane);
        let side = if height.low() >= 0.0 {
            1
        } else if height.high() < 0.0 {
            -1
        } else {
            let shortest = dot(&corner.at, &corner.at).low().max(0.0).sqrt() * (1.0 - 8.0 * ULP);
            if shortest <= 0.0 {
                return None;
            }
            // asin(x) ≤ (π/2)·x.
            moved += 1.571 * (height.magnitude() / shortest).min(2.0);
            0
        };
        heights.push((height, side));
    }
    let mut out = Vec::with_capacity(polygon.len() + 1);
    let Some(mut previous) = polygon.len().checked_sub(1) else { return Some((out, moved)) };
    for next in 0..polygon.len() {
        let ((da, sa), (db, sb)) = (heights[previous], heights[next]);
        if sa * sb < 0 {
            // The point of the chord on the plane, times a positive number.
            let (a, b) = (&polygon[previous].at, &polygon[next].at);
            let at = if sa > 0 { plus(&times(a, -db), &times(b, da)) } else { plus(&times(a, db), &times(b, -da)) };
            out.push(Corner { at });
        }
        if sb >= 0 {
            out.push(polygon[next]);
        }
        previous = next;
    }
    Some((out, moved))
}

/// The solid angle enclosed, sr, of a polygon that runs in the given sense.
pub(super) fn solid_angle(polygon: &[Corner], sense: f64) -> Option<Model> {
    if polygon.len() < 3 {
        return Some(Model::ZERO);
    }
    let corners: Vec<Lit> = polygon.iter().map(lit).collect();
    let (mut re, mut im) = (Model::exact(1.0), Model::ZERO);
    for pair in corners[1..].windows(2) {
        let (x, y) = triangle(&corners[0], &pair[0], &pair[1]);
        let y = y.scaled(sense);
        (re, im) = (re * x - im * y, re * y + im * x);
    }
    let angle = Model::argument(re, im)?;
    // The half angles sum to 0 to π, and the model turns by less than a quarter from its middle.
    let angle = if angle.middle() < -core::f64::consts::FRAC_PI_2 {
        angle + Model::constant(core::f64::consts::TAU, 1e-15)
    } else {
        angle
    };
    Some(angle.scaled(2.0))
}
