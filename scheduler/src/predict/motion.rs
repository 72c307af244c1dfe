//! The recent motion: velocities by finite differences, teleports, and how fast the client tends to move and turn.

use crate::units::Time;
use crate::view::View;
use glam::{DQuat, DVec3};
use std::collections::VecDeque;

/// Span over which velocities are taken, seconds: long enough to even out tracking noise.
const BASELINE_S: f64 = 0.2;
/// Two views nearer in time than this say nothing about a velocity, seconds.
const LEAST_SPAN_S: f64 = 1e-3;
/// Radians up to which a rotation is known from its ends alone.
const HALF_TURN: f64 = core::f64::consts::PI;
/// Span of motion that the percentiles look back on, seconds.
const MEMORY_S: f64 = 10.0;
/// Spacing of the speeds kept for the percentiles, seconds.
const SPACING_S: f64 = 0.1;
/// A jump by more than this many times the recent 95th percentile of the speed (and 10 m) is a teleport.
const TELEPORT_FACTOR: f64 = 20.0;

/// Speeds, m/s and rad/s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Speeds {
    /// Of translation, m/s.
    pub linear: f64,
    /// Of rotation, rad/s.
    pub angular: f64,
}

/// The views of the last moments.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    recent: VecDeque<(Time, View)>,
    speeds: VecDeque<(Time, Speeds)>,
    percentile: Speeds,
}

impl Motion {
    /// Takes a view in; true if the camera has teleported, and everything before is forgotten.
    pub fn observe(&mut self, view: &View, now: Time) -> bool {
        let mut teleported = false;
        if let Some((before, last)) = self.recent.back() {
            let passed = now.since(*before).secs();
            if passed <= 0.0 {
                if let Some(newest) = self.recent.back_mut() {
                    newest.1 = *view;
                }
                return false;
            }
            let jump = view.position.distance(last.position);
            teleported = jump > 10.0 && jump > TELEPORT_FACTOR * self.percentile.linear.max(1.0) * passed;
            if teleported {
                self.recent.clear();
            }
        }
        self.recent.push_back((now, *view));
        while self.recent.len() > 2 && now.since(self.recent[1].0).secs() >= BASELINE_S {
            self.recent.pop_front();
        }
        let due = self.speeds.back().is_none_or(|(t, _)| now.since(*t).secs() >= SPACING_S);
        if due && self.recent.len() > 1 {
            let speeds = Speeds { linear: self.velocity().length(), angular: self.rotation_rate().length() };
            self.speeds.push_back((now, speeds));
            while self.speeds.front().is_some_and(|(t, _)| now.since(*t).secs() > MEMORY_S) {
                self.speeds.pop_front();
            }
            self.percentile = Speeds {
                linear: percentile(self.speeds.iter().map(|(_, s)| s.linear)),
                angular: percentile(self.speeds.iter().map(|(_, s)| s.angular)),
            };
        }
        teleported
    }

    /// The newest view.
    pub fn latest(&self) -> Option<&(Time, View)> {
        self.recent.back()
    }

    /// The oldest and the newest view of the baseline and the seconds between them, if that is long enough.
    fn baseline(&self) -> Option<(&View, &View, f64)> {
        let ((from, a), (to, b)) = (self.recent.front()?, self.recent.back()?);
        let span = to.since(*from).secs();
        (span >= LEAST_SPAN_S).then_some((a, b, span))
    }

    /// Velocity, m/s, world space.
    pub fn velocity(&self) -> DVec3 {
        self.baseline().map_or(DVec3::ZERO, |(a, b, span)| (b.position - a.position) / span)
    }

    /// Rotation rate as an axis times rad/s, world space.
    pub fn rotation_rate(&self) -> DVec3 {
        let Some((a, b, span)) = self.baseline() else { return DVec3::ZERO };
        let turn = rotation_vector(b.orientation * a.orientation.conjugate());
        // From one view to the next: over the whole baseline, more than half a turn would look like less.
        let steps = self.recent.iter().zip(self.recent.iter().skip(1));
        let (mut sum, mut length) = (DVec3::ZERO, 0.0);
        for ((_, from), (_, to)) in steps {
            let step = rotation_vector(to.orientation * from.orientation.conjugate());
            sum += step;
            length += step.length();
        }
        (if length < HALF_TURN { turn } else { sum }) / span
    }

    /// 95th percentile of the speeds over the last ten seconds.
    pub fn percentile(&self) -> Speeds {
        self.percentile
    }
}

/// 95th percentile by nearest rank; 0 of nothing.
fn percentile(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    let rank = (sorted.len() * 95).div_ceil(100);
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}

/// The shortest rotation as an axis times radians.
pub fn rotation_vector(q: DQuat) -> DVec3 {
    let q = if q.w < 0.0 { -q } else { q };
    let v = DVec3::new(q.x, q.y, q.z);
    let sin = v.length();
    if sin < 1e-12 { v * 2.0 } else { v * (2.0 * libm::atan2(sin, q.w) / sin) }
}

/// `view` moved to `position` and turned by the world-space rotation vector `turn`; the orientation stays a unit.
pub fn moved(view: &View, position: DVec3, turn: DVec3) -> View {
    View { position, orientation: (DQuat::from_scaled_axis(turn) * view.orientation).normalize(), ..*view }
}
