//! A part of a path between two predicted views.

use super::{IntegralError, within};
use crate::benefit::frustum::Frustum;
use crate::predict::motion::rotation_vector;
use crate::view::View;
use glam::{DQuat, DVec3};

/// Positions, sizes and the way covered on a leg, metres, are at most this.
pub(super) const METRES_MAX: f64 = 1e30;
/// Legs end at most this late, seconds.
pub(super) const SECONDS_MAX: f64 = 1e6;
const PIXELS_PER_RADIAN_MAX: f64 = 1e30;

/// Motion from `from_s` to `to_s` seconds (from now): position linear in time, orientation turning at constant rate
/// about one axis; field of view and viewport stay.
#[derive(Clone, Copy, Debug)]
pub struct Leg {
    start: View,
    velocity: DVec3,
    axis: DVec3,
    rate: f64,
    from_s: f64,
    to_s: f64,
    base: Frustum,
}

impl Leg {
    /// From `start` at `from_s` on, with `velocity` (m/s) and the rotation vector `rotation` (rad/s, world space, any
    /// length: several turns are legal).
    ///
    /// # Errors
    /// What [`View::check`] refuses, NaN, infinities, times that do not ascend from 0, and sizes beyond 10³⁰ m, 10⁶ s
    /// and 10⁶ rad/s.
    pub fn new(start: &View, velocity: DVec3, rotation: DVec3, from_s: f64, to_s: f64) -> Result<Leg, IntegralError> {
        start.check()?;
        within("from_s", from_s, 0.0, SECONDS_MAX, "0 to 1e6 s")?;
        within("to_s", to_s, from_s, SECONDS_MAX, "from_s to 1e6 s")?;
        for value in start.position.to_array() {
            within("position", value.abs(), 0.0, METRES_MAX, "coordinates up to 1e30 m")?;
        }
        let way = velocity * (to_s - from_s);
        for (speed, metres) in velocity.to_array().into_iter().zip(way.to_array()) {
            within("velocity", speed.abs(), 0.0, METRES_MAX, "up to 1e30 m/s")?;
            within("velocity times duration", metres.abs(), 0.0, METRES_MAX, "up to 1e30 m")?;
        }
        for value in rotation.to_array() {
            within("rotation", value.abs(), 0.0, 1e6, "up to 1e6 rad/s")?;
        }
        within("pixels per radian", start.pixels_per_radian(), 1e-30, PIXELS_PER_RADIAN_MAX, "1e-30 to 1e30")?;
        let start = View { orientation: start.orientation.normalize(), ..*start };
        let rate = rotation.length();
        let axis = if rate > 0.0 { (rotation / rate).normalize_or(DVec3::X) } else { DVec3::X };
        Ok(Leg { start, velocity, axis, rate, from_s, to_s, base: Frustum::new(&start) })
    }

    /// From `a` at `from_s` to `b` at `to_s` by the shorter rotation. The field of view and the viewport are those of
    /// `a`. A leg of no length stays at `a`.
    ///
    /// # Errors
    /// As [`Leg::new`].
    pub fn between(a: &View, b: &View, from_s: f64, to_s: f64) -> Result<Leg, IntegralError> {
        b.check()?;
        let seconds = to_s - from_s;
        if seconds == 0.0 {
            return Leg::new(a, DVec3::ZERO, DVec3::ZERO, from_s, to_s);
        }
        let turn = rotation_vector(b.orientation.normalize() * a.orientation.normalize().conjugate());
        Leg::new(a, (b.position - a.position) / seconds, turn / seconds, from_s, to_s)
    }

    /// What is left of it after `arrival_s`; the end alone if that lies beyond.
    #[must_use]
    pub fn after(&self, arrival_s: f64) -> Leg {
        if arrival_s.is_nan() || arrival_s <= self.from_s {
            return *self;
        }
        let from_s = arrival_s.min(self.to_s);
        let start = self.view(from_s);
        Leg { start, from_s, base: self.frustum(from_s), ..*self }
    }

    /// The view at `from_s`, its orientation a unit.
    pub fn start(&self) -> &View {
        &self.start
    }

    /// m/s.
    pub fn velocity(&self) -> DVec3 {
        self.velocity
    }

    /// Unit axis of the rotation, world space; any if it does not turn.
    pub fn axis(&self) -> DVec3 {
        self.axis
    }

    /// rad/s about the axis, ≥ 0.
    pub fn rate(&self) -> f64 {
        self.rate
    }

    /// When it begins, seconds.
    pub fn from_s(&self) -> f64 {
        self.from_s
    }

    /// When it ends, seconds.
    pub fn to_s(&self) -> f64 {
        self.to_s
    }

    /// The frustum at `from_s`.
    pub fn base(&self) -> &Frustum {
        &self.base
    }

    /// The view at `u` seconds.
    pub fn view(&self, u: f64) -> View {
        let t = u - self.from_s;
        let orientation = if self.rate > 0.0 {
            (DQuat::from_axis_angle(self.axis, self.rate * t) * self.start.orientation).normalize()
        } else {
            self.start.orientation
        };
        View { position: self.start.position + self.velocity * t, orientation, ..self.start }
    }

    /// The frustum at `u` seconds.
    pub fn frustum(&self, u: f64) -> Frustum {
        let t = u - self.from_s;
        let mut frustum = self.base;
        frustum.eye = self.start.position + self.velocity * t;
        if self.rate > 0.0 {
            let (sin, cos) = libm::sincos(self.rate * t);
            frustum.forward = self.turned(frustum.forward, sin, cos);
            for plane in &mut frustum.planes {
                *plane = self.turned(*plane, sin, cos);
            }
        }
        frustum
    }

    /// Where `point` lies relative to the eye at `u` seconds, metres. Not through the eye's world position: that would
    /// round to the world's distance from the origin.
    pub fn relative(&self, point: DVec3, u: f64) -> DVec3 {
        (point - self.start.position) - self.velocity * (u - self.from_s)
    }

    /// `v` turned about the axis, after Rodrigues.
    pub(super) fn turned(&self, v: DVec3, sin: f64, cos: f64) -> DVec3 {
        v * cos + self.axis.cross(v) * sin + self.axis * (self.axis.dot(v) * (1.0 - cos))
    }
}
