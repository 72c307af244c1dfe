//! The integrand over a part of a leg, as a Taylor model.

use super::model::{LIBM, Model, ULP, Vector, dot, minus, plus, times};
use super::solid_angle::{Corner, clipped, orientation, outline, solid_angle};
use crate::benefit::accuracy::HALF_ACCURACY_PX;
use crate::benefit::element::normals;
use crate::benefit::weight::COSINE_MIN;
use crate::integral::{AddedBenefit, Form};
use core::f64::consts::PI;
use glam::{DQuat, DVec3};

/// A vector that is constant up to rounding.
fn exact(v: DVec3) -> Vector {
    v.to_array().map(Model::exact)
}

fn normalised(v: &Vector) -> Option<Vector> {
    Some(times(v, dot(v, v).rsqrt()?))
}

/// n(u) = A + cos θ·B + sin θ·C.
struct Turning {
    still: Vector,
    cos: Vector,
    sin: Vector,
}

impl Turning {
    fn new(v: &Vector, axis: &Vector) -> Turning {
        let still = times(axis, dot(axis, v));
        Turning { still, cos: minus(v, &still), sin: super::model::cross(axis, v) }
    }

    fn at(&self, sin: Model, cos: Model) -> Vector {
        plus(&self.still, &plus(&times(&self.cos, cos), &times(&self.sin, sin)))
    }
}

/// An added benefit, prepared: its frustum's parts with the rounding that they carry.
pub(super) struct Scene<'a> {
    benefit: &'a AddedBenefit,
    forward: Turning,
    planes: Option<[Turning; 4]>,
    /// Solid angle of the frustum, sr.
    frustum: Model,
    /// (pixels per radian / e₀)².
    sharpness: Model,
    /// The centre of the target from the eye at the leg's begin, and by how much that is rounded.
    centre: DVec3,
    /// Begin and end of the integral after the leg's begin, seconds.
    pub(super) span: (f64, f64),
}

impl Scene<'_> {
    pub(super) fn new(benefit: &AddedBenefit) -> Scene<'_> {
        let leg = &benefit.leg;
        let view = leg.start();
        let q = view.orientation;
        // The rotation by a quaternion of any length, as the exact one of its direction.
        let axis_of = |x: DVec3| -> Vector {
            let DQuat { x: a, y: b, z: c, w } = q;
            let [a, b, c, w] = [a, b, c, w].map(Model::exact);
            let r = [a, b, c];
            let v = exact(x);
            let (rr, rv) = (dot(&r, &r), dot(&r, &v));
            let turned = plus(&times(&v, w * w - rr), &times(&r, rv.scaled(2.0)));
            plus(&turned, &times(&super::model::cross(&r, &v), w.scaled(2.0)))
        };
        // Lengths are |q|², 1 to within rounding; directions are all that planes need, and normalising removes them.
        let unit = |x: DVec3| normalised(&axis_of(x)).unwrap_or([Model::constant(0.0, 2.0); 3]);
        let (right, up, forward) = (unit(DVec3::X), unit(DVec3::Y), unit(DVec3::NEG_Z));
        let tan = libm::tan(0.5 * view.fov_y);
        let up_tan = Model::constant(tan, LIBM * tan);
        let aspect = Model::exact(f64::from(view.viewport[0])) * reciprocal(Model::exact(f64::from(view.viewport[1])));
        let right_tan = up_tan * aspect;
        let axis = normalised(&exact(leg.axis())).unwrap_or([Model::constant(0.0, 2.0); 3]);
        let plane = |side: &Vector, tan: Model| -> Option<Turning> {
            Some(Turning::new(&normalised(&plus(&times(&forward, tan), side))?, &axis))
        };
        let negative = |v: &Vector| v.map(|x| -x);
        let planes = (|| {
            Some([
                plane(&right, right_tan)?,
                plane(&negative(&right), right_tan)?,
                plane(&up, up_tan)?,
                plane(&negative(&up), up_tan)?,
            ])
        })();
        let squares = Model::exact(1.0) + up_tan.squared() + right_tan.squared();
        let frustum = Model::argument(squares.sqrt(), up_tan * right_tan).unwrap_or(Model::between(0.0, 0.5 * PI));
        let pixels = Model::exact(f64::from(view.viewport[1])) * reciprocal(up_tan.scaled(2.0 * HALF_ACCURACY_PX));
        Scene {
            benefit,
            forward: Turning::new(&forward, &axis),
            planes,
            frustum: frustum.scaled(4.0),
            sharpness: pixels.squared(),
            centre: benefit.target.centre() - view.position,
            span: (benefit.from_s() - leg.from_s(), benefit.to_s() - leg.from_s()),
        }
    }

    /// The integrand from `from` to `to` seconds after the leg's begin, without the sign of the gain and without the
    /// importance of a leaf; s = ±1 at the ends.
    pub(super) fn over(&self, from: f64, to: f64) -> Model {
        let ceiling = self.ceiling();
        match self.integrand(from, to) {
            Some(model) if model.is_finite() && model.high() - model.low() <= ceiling => model,
            _ => Model::between(0.0, ceiling),
        }
    }

    /// No weight × gain is larger, sr.
    fn ceiling(&self) -> f64 {
        let target = &self.benefit.target;
        let near = self.benefit.cut.near;
        match target.form() {
            Form::Leaf => self.frustum.high().min(4.0 * PI * (1.0 + LIBM)),
            Form::FarLeaf | Form::Group => target.face_areas().length() / (near * near) * (1.0 + LIBM),
        }
    }

    fn integrand(&self, from: f64, to: f64) -> Option<Model> {
        let AddedBenefit { leg, target, cut, .. } = self.benefit;
        let middle = 0.5 * (from + to);
        let reach = (to - middle).max(middle - from);
        let (c, v) = (self.centre, leg.velocity());
        // start − v·t, with every rounding: of the difference, of the products, of the sum.
        let centre: Vector = [0, 1, 2].map(|k| {
            let way = v[k] * middle;
            let at = c[k] - way;
            let rounded = 2.0 * ULP * (c[k].abs() + 2.0 * way.abs() + at.abs());
            Model::linear(at, -v[k] * reach, (rounded + 2.0 * ULP * (v[k] * reach).abs()) * (1.0 + LIBM))
        });
        let angle = leg.rate() * middle;
        let swing = leg.rate() * reach;
        let (sin, cos) = if leg.rate() > 0.0 {
            // The rate is the length of a vector that was rounded; it is given as a double.
            Model::sincos(angle, swing, 4.0 * ULP * (angle.abs() + swing))
        } else {
            (Model::ZERO, Model::exact(1.0))
        };
        let half = target.half();
        let planes = self.planes.as_ref()?;
        let mut straddled: Vec<Vector> = Vec::with_capacity(4);
        let mut share = Model::exact(1.0);
        for plane in planes {
            let normal = plane.at(sin, cos);
            let height = dot(&normal, &centre);
            let extent =
                normal[0].abs().scaled(half.x) + normal[1].abs().scaled(half.y) + normal[2].abs().scaled(half.z);
            if (height + extent).high() < 0.0 {
                return Some(Model::ZERO);
            }
            if (height - extent).low() >= 0.0 {
                continue;
            }
            if target.form() != Form::Leaf {
                let ramp = match extent.recip() {
                    Some(inverse) => (Model::exact(0.5) + (height * inverse).scaled(0.5)).clamped(),
                    None => Model::between(0.0, 1.0),
                };
                share = share * ramp;
            }
            straddled.push(normal);
        }
        let distance_squared = dot(&centre, &centre);
        let floor = cut.near * cut.near * (1.0 - LIBM);
        let floored = |squared: Model| {
            // The floor itself is rounded; below it by that much is below it.
            squared.at_least(floor).widened(4.0 * LIBM * cut.near * cut.near)
        };
        let centre_squared = floored(distance_squared);
        let mut weight = match target.form() {
            Form::Leaf => self.clipped_solid_angle(&centre, half, &straddled)?,
            Form::FarLeaf | Form::Group => {
                let inverse = positive(centre_squared, floor).rsqrt()?;
                let areas = target.face_areas();
                let projected =
                    centre[0].abs().scaled(areas.x) + centre[1].abs().scaled(areas.y) + centre[2].abs().scaled(areas.z);
                projected * (inverse.squared() * inverse) * share
            }
        };
        if target.facet().is_some() {
            weight = weight * self.share_of_element(&centre, half);
        }
        if cut.centre_falloff > 0.0 {
            weight = weight * self.centre_weight(&centre, sin, cos, centre_squared)?;
        }
        if self.benefit.attenuation > 0.0 {
            weight = weight * self.attenuation(middle, reach);
        }
        let squared = match target.form() {
            Form::Group => centre_squared,
            Form::Leaf | Form::FarLeaf => {
                let gap = |k: usize| (centre[k].abs() - Model::exact(half[k])).at_least(0.0).squared();
                floored(gap(0) + gap(1) + gap(2))
            }
        };
        Some(weight * self.gain(positive(squared, floor))?)
    }

    /// |a(g₁) − a(g₀)| for the distance², by a = d²/(d² + E), E = g²·(px/rad ÷ e₀)².
    fn gain(&self, squared: Model) -> Option<Model> {
        let (low, high) = if self.benefit.after <= self.benefit.before {
            (self.benefit.after, self.benefit.before)
        } else {
            (self.benefit.before, self.benefit.after)
        };
        if low == high {
            return Some(Model::ZERO);
        }
        let scaled = |g: f64| self.sharpness * Model::exact(g).squared();
        let better = squared * (squared + scaled(low)).recip()?;
        let better = if low == 0.0 { Model::exact(1.0) } else { better.clamped() };
        if high == f64::INFINITY {
            return Some(better);
        }
        // (g₀² − g₁²) = (g₀ − g₁)(g₀ + g₁): no cancellation.
        let spread = (Model::exact(high) - Model::exact(low)) * (Model::exact(high) + Model::exact(low));
        let worse = (self.sharpness * spread) * (squared + scaled(high)).recip()?;
        Some(better * worse.clamped())
    }

    fn centre_weight(&self, centre: &Vector, sin: Model, cos: Model, squared: Model) -> Option<Model> {
        let along = dot(&self.forward.at(sin, cos), centre);
        let across = (squared - along.squared()).at_least(0.0);
        let least = squared.sqrt().scaled(COSINE_MIN);
        let along = along.max(least).squared();
        let tangent = across * along.recip()?;
        let off = Model::exact(1.0) + tangent.scaled(self.benefit.cut.centre_falloff);
        Some(off.at_least(1.0).recip()?.clamped())
    }

    /// S_s·m_s / Σ S·m; all that a share can be where nothing may face the eye.
    fn share_of_element(&self, centre: &Vector, half: DVec3) -> Model {
        let Some(facet) = self.benefit.target.facet() else { return Model::exact(1.0) };
        let (mut own, mut whole) = (Model::ZERO, Model::ZERO);
        for (s, (normal, area)) in normals().into_iter().zip(facet.surface).enumerate() {
            if area <= 0.0 {
                continue;
            }
            let mut height = Model::ZERO;
            for k in 0..3 {
                height = height + Model::exact(half[k]).scaled(normal[k].abs()) - centre[k].scaled(normal[k]);
            }
            let seen = height.at_least(0.0).scaled(f64::from(area));
            whole = whole + seen;
            if s == usize::from(facet.element) {
                own = seen;
            }
        }
        if own.high() <= 0.0 {
            return Model::ZERO;
        }
        match whole.recip() {
            Some(inverse) if whole.low() > 0.0 => (own * inverse).clamped(),
            _ => Model::between(0.0, 1.0),
        }
    }

    fn attenuation(&self, middle: f64, reach: f64) -> Model {
        let rate = self.benefit.attenuation;
        let leg = self.benefit.leg.from_s();
        let (from, to) = (leg + (middle - reach), leg + (middle + reach));
        let exp = |u: f64| libm::exp(-rate * u.max(0.0));
        let rounded = (8.0 * ULP * rate * to + LIBM).min(1.0);
        let at = libm::exp(-rate * (leg + middle));
        let swing = rate * reach;
        let plain = Model::between(exp(to) * (1.0 - rounded), (exp(from) * (1.0 + rounded)).min(1.0));
        if swing > 0.5 {
            return plain;
        }
        // exp(−x) by its series; the term left out is below x⁵/120·e^½.
        let x = Model::linear(0.0, -swing, 4.0 * ULP * swing);
        let mut sum = Model::exact(1.0);
        for k in (1..5).rev() {
            sum = Model::exact(1.0) + (x * sum).scaled(1.0 / f64::from(k));
        }
        let fifth = swing * swing * swing * swing * swing;
        sum.widened(fifth / 60.0) * Model::constant(at, at * rounded)
    }

    fn clipped_solid_angle(&self, centre: &Vector, half: DVec3, planes: &[Vector]) -> Option<Model> {
        let most = self.frustum.high();
        let mut beyond = 0u8;
        // Distance to the box along the axes that are clear, and how far the eye may lie beyond the others.
        let (mut gap, mut unclear) = (0.0f64, 0.0f64);
        for k in 0..3 {
            let reach = centre[k].abs();
            if reach.low() > half[k] {
                beyond |= 1 << k;
                gap = gap.max((reach.low() - half[k]) * (1.0 - LIBM));
            } else if reach.high() > half[k] {
                unclear = unclear.max((reach.high() - half[k]) * (1.0 + LIBM));
            }
        }
        if beyond == 0 {
            return Some(if unclear > 0.0 { self.around(centre, half) } else { self.frustum });
        }
        let mut polygon: Vec<Corner> = outline(centre, half, beyond);
        let sense = orientation(&polygon);
        // A box grown by as much as is unclear has this outline, with corners moved by that; asin(x) ≤ (π/2)·x.
        let mut moved = if unclear > 0.0 { 2.0 * 1.571 * (unclear / gap) * (1.0 + LIBM) } else { 0.0 };
        if moved > 1.0 {
            return Some(self.around(centre, half));
        }
        let sine = cap_sine(centre, half);
        for plane in planes {
            let (kept, by) = clipped(&polygon, plane)?;
            polygon = kept;
            moved += by;
        }
        // A corner moved by an angle changes the solid angle by at most that times the perimeter, which is at most that
        // of the cap around the box; twice, because the clipped corner is moved back.
        let slack = 2.0 * moved * 2.0 * PI * sine * (1.0 + LIBM) + 2.0 * PI * moved * moved;
        let omega = solid_angle(&polygon, sense)?.widened(slack);
        if omega.low() >= 0.0 && omega.high() <= most {
            return Some(omega);
        }
        let capped = Model::between(omega.low().max(0.0).min(most), omega.high().min(most).max(0.0));
        Some(if capped.magnitude() < omega.magnitude() || omega.high() > most { capped } else { omega })
    }

    /// All that is known where the eye crosses a face plane of the box.
    fn around(&self, centre: &Vector, half: DVec3) -> Model {
        // From outside by a distance d, the box fills at most the cap of its bounding sphere and, beyond a face plane,
        // half the sphere.
        let sine = cap_sine(centre, half);
        let cap = if sine < 1.0 {
            2.0 * PI * (1.0 - ((1.0 - sine) * (1.0 + sine)).sqrt()) * (1.0 + LIBM) + 1e-15
        } else {
            4.0 * PI * (1.0 + LIBM)
        };
        Model::between(0.0, cap.min(self.frustum.high()))
    }
}

/// Sine of the half angle of the cone around a box, at most; 1 where the cone may be as wide as a half-space.
fn cap_sine(centre: &Vector, half: DVec3) -> f64 {
    let radius = half.length() * (1.0 + LIBM);
    let distance = dot(centre, centre).low().max(0.0).sqrt() * (1.0 - LIBM);
    if radius < distance { (radius / distance * (1.0 + LIBM)).min(1.0) } else { 1.0 }
}

/// 1/x of what is known to be positive.
fn reciprocal(x: Model) -> Model {
    x.recip().unwrap_or(Model::between(0.0, f64::MAX))
}

/// What is known to be at least about `floor`, made so.
fn positive(x: Model, floor: f64) -> Model {
    if x.low() > 0.5 * floor { x } else { Model::between(floor * (1.0 - 8.0 * LIBM), x.high().max(floor)) }
}
