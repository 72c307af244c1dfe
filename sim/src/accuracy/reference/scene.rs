//! The integrand in double-double arithmetic, written apart from the scheduler's: everything is turned into the camera's
//! frame, and solid angles are summed over the faces of the box that the eye sees.

use super::double::{Vector, atan2, cross, difference, dot, double, exp, minus, plus, ratio, sin_cos, times};
use foresight_scheduler::benefit::accuracy::HALF_ACCURACY_PX;
use foresight_scheduler::benefit::element::normals;
use foresight_scheduler::integral::{AddedBenefit, Form};
use glam::DVec3;
use twofloat::TwoFloat;

/// Smallest cosine to the view's centre that κ knows.
const COSINE_MIN: f64 = 0.05;

/// An added benefit in double-double.
pub(super) struct Scene<'a> {
    benefit: &'a AddedBenefit,
    centre: Vector,
    velocity: Vector,
    axis: Vector,
    /// Right, up and forward of the camera at the leg's begin.
    camera: [Vector; 3],
    /// tan of half the horizontal and the vertical field of view.
    tan: [TwoFloat; 2],
    /// (pixels per radian ÷ e₀)².
    pub(super) sharpness: TwoFloat,
    near: TwoFloat,
}

fn vector(v: DVec3) -> Vector {
    v.to_array().map(double)
}

impl Scene<'_> {
    pub(super) fn new(benefit: &AddedBenefit) -> Scene<'_> {
        let view = benefit.leg.start();
        let q = view.orientation;
        let norm = [q.x, q.y, q.z, q.w].map(|x| double(x) * x).into_iter().fold(double(0.0), |a, b| a + b);
        // The rotation matrix of q/|q|, by columns.
        let product = |a: f64, b: f64| ratio(TwoFloat::new_mul(a, b) * 2.0, norm);
        let one = double(1.0);
        let right = [
            one - product(q.y, q.y) - product(q.z, q.z),
            product(q.x, q.y) + product(q.z, q.w),
            product(q.x, q.z) - product(q.y, q.w),
        ];
        let up = [
            product(q.x, q.y) - product(q.z, q.w),
            one - product(q.x, q.x) - product(q.z, q.z),
            product(q.y, q.z) + product(q.x, q.w),
        ];
        let forward = times(&cross(&right, &up), double(-1.0));
        let (sin, cos) = sin_cos(double(0.5 * view.fov_y));
        let [width, height] = view.viewport.map(f64::from);
        let up_tan = ratio(sin, cos);
        let centre = benefit.target.centre();
        let eye = view.position;
        let axis = vector(benefit.leg.axis());
        let length = dot(&axis, &axis).sqrt();
        let pixels = ratio(double(height), up_tan * 2.0 * HALF_ACCURACY_PX);
        Scene {
            benefit,
            centre: [difference(centre.x, eye.x), difference(centre.y, eye.y), difference(centre.z, eye.z)],
            velocity: vector(benefit.leg.velocity()),
            axis: axis.map(|x| ratio(x, length)),
            camera: [right, up, forward],
            tan: [up_tan * width / height, up_tan],
            sharpness: pixels * pixels,
            near: double(benefit.cut.near),
        }
    }

    /// The centre from the eye, world axes, `seconds` after the leg's begin.
    pub(super) fn relative(&self, seconds: TwoFloat) -> Vector {
        minus(&self.centre, &times(&self.velocity, seconds))
    }

    pub(super) fn velocity(&self) -> &Vector {
        &self.velocity
    }

    /// The integrand, sr, `seconds` after the leg's begin.
    pub(super) fn value(&self, seconds: TwoFloat) -> TwoFloat {
        let AddedBenefit { leg, target, cut, attenuation, .. } = self.benefit;
        let centre = self.relative(seconds);
        let [right, up, forward] = self.turned(seconds);
        let half = target.half().to_array();
        // Inward normals of the planes, not of length 1: neither sides nor ramps need that.
        let planes = [
            plus(&times(&forward, self.tan[0]), &right),
            minus(&times(&forward, self.tan[0]), &right),
            plus(&times(&forward, self.tan[1]), &up),
            minus(&times(&forward, self.tan[1]), &up),
        ];
        let squared = dot(&centre, &centre);
        let floored = larger(squared.sqrt(), self.near);
        let mut weight = match target.form() {
            Form::Leaf => self.solid_angle(&centre, half, &planes) * target.importance(),
            Form::FarLeaf | Form::Group => {
                let areas = target.face_areas().to_array();
                let mut weight = double(0.0);
                for k in 0..3 {
                    weight += centre[k].abs() * areas[k];
                }
                weight = ratio(weight, floored * floored * floored);
                for plane in &planes {
                    let height = dot(plane, &centre);
                    let extent = plane[0].abs() * half[0] + plane[1].abs() * half[1] + plane[2].abs() * half[2];
                    weight *= share(height, extent);
                }
                weight
            }
        };
        if target.facet().is_some() {
            weight *= self.share_of_element(&centre, half);
        }
        if weight.hi() <= 0.0 {
            return double(0.0);
        }
        if cut.centre_falloff > 0.0 {
            let along = dot(&forward, &centre);
            let across = larger(floored * floored - along * along, double(0.0));
            let along = larger(along, floored * COSINE_MIN);
            weight = ratio(weight, ratio(across * cut.centre_falloff, along * along) + 1.0);
        }
        if *attenuation > 0.0 {
            weight *= exp((seconds + leg.from_s()) * -attenuation);
        }
        let distance = match target.form() {
            Form::Group => floored,
            Form::Leaf | Form::FarLeaf => {
                let mut sum = double(0.0);
                for k in 0..3 {
                    let gap = larger(centre[k].abs() - half[k], double(0.0));
                    sum += gap * gap;
                }
                larger(sum.sqrt(), self.near)
            }
        };
        weight * self.gain(distance)
    }

    /// The share of an element in what faces the eye: areas times the eye's height over their planes.
    fn share_of_element(&self, centre: &Vector, half: [f64; 3]) -> TwoFloat {
        let Some(facet) = self.benefit.target.facet() else { return double(1.0) };
        let (mut own, mut whole) = (double(0.0), double(0.0));
        for (s, (normal, area)) in normals().into_iter().zip(facet.surface).enumerate() {
            let mut height = double(0.0);
            for (k, along) in normal.to_array().into_iter().enumerate() {
                height += TwoFloat::new_mul(along.abs(), half[k]) - centre[k] * along;
            }
            let seen = larger(height, double(0.0)) * f64::from(area);
            whole += seen;
            if s == usize::from(facet.element) {
                own = seen;
            }
        }
        if whole.hi() > 0.0 { ratio(own, whole) } else { double(0.0) }
    }

    /// a(g₁) − a(g₀) at a distance.
    fn gain(&self, distance: TwoFloat) -> TwoFloat {
        let sharpness = ratio(self.sharpness, distance * distance);
        let [x, y] = [self.benefit.after, self.benefit.before]
            .map(|g| (g != f64::INFINITY).then(|| TwoFloat::new_mul(g, g) * sharpness));
        match (x, y) {
            (Some(x), Some(_)) => {
                let (after, before) = (self.benefit.after, self.benefit.before);
                let spread = difference(before, after) * TwoFloat::new_add(before, after) * sharpness;
                let y = x + spread;
                ratio(ratio(spread, x + 1.0), y + 1.0)
            }
            (Some(x), None) => ratio(double(1.0), x + 1.0),
            (None, Some(y)) => ratio(double(-1.0), y + 1.0),
            (None, None) => double(0.0),
        }
    }

    /// Right, up and forward, `seconds` after the leg's begin.
    fn turned(&self, seconds: TwoFloat) -> [Vector; 3] {
        let rate = self.benefit.leg.rate();
        if rate == 0.0 {
            return self.camera;
        }
        let (sin, cos) = sin_cos(seconds * rate);
        self.camera.map(|v| {
            let still = times(&self.axis, dot(&self.axis, &v));
            let across = minus(&v, &still);
            plus(&still, &plus(&times(&across, cos), &times(&cross(&self.axis, &v), sin)))
        })
    }

    /// Solid angle, sr, of a box inside the planes.
    fn solid_angle(&self, centre: &Vector, half: [f64; 3], planes: &[Vector; 4]) -> TwoFloat {
        let mut sum = double(0.0);
        let mut is_outside = false;
        for k in 0..3 {
            let (i, j) = ((k + 1) % 3, (k + 2) % 3);
            for side in [-1.0, 1.0] {
                // A face is seen where the eye lies beyond it.
                let height = centre[k] + side * half[k];
                let outward = height * side;
                if outward.hi() >= 0.0 {
                    continue;
                }
                is_outside = true;
                let corner = |a: f64, b: f64| {
                    let mut at = [double(0.0); 3];
                    at[k] = height;
                    at[i] = centre[i] + a * half[i];
                    at[j] = centre[j] + b * half[j];
                    at
                };
                let mut face = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
                for plane in planes {
                    face = inside(&face, plane);
                }
                sum += polygon(&face);
            }
        }
        if is_outside {
            return sum;
        }
        let [a, b] = self.tan;
        atan2(a * b, (a * a + b * b + 1.0).sqrt()) * 4.0
    }
}

/// The ramp of a small box across a plane.
fn share(height: TwoFloat, extent: TwoFloat) -> TwoFloat {
    if extent.hi() == 0.0 {
        return double(if height.hi() >= 0.0 { 1.0 } else { 0.0 });
    }
    let ramp = ratio(height, extent) * 0.5 + 0.5;
    if ramp.hi() <= 0.0 {
        double(0.0)
    } else if ramp.hi() >= 1.0 {
        double(1.0)
    } else {
        ramp
    }
}

fn larger(a: TwoFloat, b: TwoFloat) -> TwoFloat {
    if a >= b { a } else { b }
}

/// The part of a polygon on the inner side of a plane through the eye (Sutherland–Hodgman).
fn inside(corners: &[Vector], plane: &Vector) -> Vec<Vector> {
    let mut out = Vec::with_capacity(corners.len() + 1);
    let Some(mut a) = corners.last() else { return out };
    let mut height_a = dot(a, plane);
    for b in corners {
        let height_b = dot(b, plane);
        if (height_a.hi() >= 0.0) != (height_b.hi() >= 0.0) {
            out.push(plus(a, &times(&minus(b, a), ratio(height_a, height_a - height_b))));
        }
        if height_b.hi() >= 0.0 {
            out.push(*b);
        }
        (a, height_a) = (b, height_b);
    }
    out
}

/// Solid angle, sr, of a flat convex polygon that does not contain the eye: Van Oosterom and Strackee's triangles.
fn polygon(corners: &[Vector]) -> TwoFloat {
    let Some((a, rest)) = corners.split_first() else { return double(0.0) };
    // Relative to the farthest, so that products of lengths stay in range.
    let longest = corners.iter().map(|c| dot(c, c).hi()).fold(0.0, f64::max);
    if longest == 0.0 {
        return double(0.0);
    }
    let unit = 1.0 / longest.sqrt();
    let scaled = |v: &Vector| v.map(|x| x * unit);
    let a = scaled(a);
    let rest: Vec<(Vector, TwoFloat)> = rest.iter().map(scaled).map(|c| (c, dot(&c, &c).sqrt())).collect();
    let length = dot(&a, &a).sqrt();
    let (mut re, mut im) = (double(1.0), double(0.0));
    for pair in rest.windows(2) {
        let ((b, lb), (c, lc)) = (&pair[0], &pair[1]);
        let y = dot(&a, &cross(&minus(b, &a), &minus(c, &a))).abs();
        let x = length * *lb * *lc + dot(&a, b) * *lc + dot(b, c) * length + dot(c, &a) * *lb;
        (re, im) = (re * x - im * y, re * y + im * x);
        let size = re.hi().abs().max(im.hi().abs());
        if size > 0.0 {
            (re, im) = (re / size, im / size);
        }
    }
    let angle = atan2(im, re);
    // Half angles sum to 0 to π.
    let angle = if angle.hi() < -1.0 { angle + twofloat::consts::PI * 2.0 } else { angle };
    if angle.hi() < 0.0 { double(0.0) } else { angle * 2.0 }
}
