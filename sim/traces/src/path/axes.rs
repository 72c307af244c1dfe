//! Which way a recording's camera looks, and in which order it writes its quaternions: given, or read off its motion.

use std::fmt;
use std::str::FromStr;

use glam::{DMat3, DQuat, DVec3};

use super::PathError;

/// A signed axis of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Axis {
    /// 0 for x, 1 for y, 2 for z.
    index: u8,
    negative: bool,
}

impl Axis {
    pub(super) const Z: Axis = Axis { index: 2, negative: false };
    pub(super) const Y: Axis = Axis { index: 1, negative: false };
    pub(super) const MINUS_Y: Axis = Axis { index: 1, negative: true };
    pub(super) const MINUS_Z: Axis = Axis { index: 2, negative: true };

    const ALL: [Axis; 6] = [
        Axis { index: 0, negative: false },
        Axis { index: 0, negative: true },
        Axis::Y,
        Axis::MINUS_Y,
        Axis::Z,
        Axis::MINUS_Z,
    ];

    /// The unit vector.
    pub fn vector(self) -> DVec3 {
        DVec3::AXES[usize::from(self.index)] * self.sign()
    }

    fn sign(self) -> f64 {
        if self.negative { -1.0 } else { 1.0 }
    }

    /// The component along this axis.
    fn of(self, components: [f64; 3]) -> f64 {
        components[usize::from(self.index)] * self.sign()
    }
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.negative { '-' } else { '+' };
        write!(f, "{sign}{}", ["x", "y", "z"][usize::from(self.index)])
    }
}

impl FromStr for Axis {
    type Err = PathError;

    fn from_str(text: &str) -> Result<Axis, PathError> {
        let fail = || PathError::Option { given: text.to_owned(), message: "expected an axis such as -z".to_owned() };
        let (negative, name) = match text.strip_prefix(['-', '−']) {
            Some(name) => (true, name),
            None => (false, text.strip_prefix('+').unwrap_or(text)),
        };
        let index = match name {
            "x" => 0,
            "y" => 1,
            "z" => 2,
            _ => return Err(fail()),
        };
        Ok(Axis { index, negative })
    }
}

/// Axes of a recording's camera: which one it looks along and which one is up in its picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CameraAxes {
    /// Viewing direction.
    pub forward: Axis,
    /// Up in the picture.
    pub up: Axis,
}

impl CameraAxes {
    pub(super) const PLUS_X_MINUS_Z: CameraAxes =
        CameraAxes { forward: Axis { index: 0, negative: false }, up: Axis::MINUS_Z };

    /// Turns a camera that looks along −z with +y up into one with these axes.
    pub fn from_canonical(self) -> DQuat {
        let (forward, up) = (self.forward.vector(), self.up.vector());
        DQuat::from_mat3(&DMat3::from_cols(forward.cross(up), up, -forward)).normalize()
    }

    fn all() -> impl Iterator<Item = CameraAxes> {
        Axis::ALL.into_iter().flat_map(|forward| {
            let ups = Axis::ALL.into_iter().filter(move |up| up.index != forward.index);
            ups.map(move |up| CameraAxes { forward, up })
        })
    }
}

impl fmt::Display for CameraAxes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.forward, self.up)
    }
}

impl FromStr for CameraAxes {
    type Err = PathError;

    /// Forward and up, such as `-y/+z`.
    fn from_str(text: &str) -> Result<CameraAxes, PathError> {
        let fail = || PathError::Option {
            given: text.to_owned(),
            message: "expected forward and up along two different axes, such as -y/+z".to_owned(),
        };
        let (forward, up) = text.split_once('/').ok_or_else(fail)?;
        let (forward, up): (Axis, Axis) = (forward.trim().parse()?, up.trim().parse()?);
        if forward.index == up.index {
            return Err(fail());
        }
        Ok(CameraAxes { forward, up })
    }
}

/// Order in which a recording writes the components of a quaternion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QuatOrder {
    /// Real part last.
    Xyzw,
    /// Real part first.
    Wxyz,
}

impl QuatOrder {
    /// The quaternion of four numbers in this order, not normalised.
    pub fn quaternion(self, [a, b, c, d]: [f64; 4]) -> DQuat {
        match self {
            QuatOrder::Xyzw => DQuat::from_xyzw(a, b, c, d),
            QuatOrder::Wxyz => DQuat::from_xyzw(b, c, d, a),
        }
    }
}

impl fmt::Display for QuatOrder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            QuatOrder::Xyzw => "xyzw",
            QuatOrder::Wxyz => "wxyz",
        })
    }
}

impl FromStr for QuatOrder {
    type Err = PathError;

    fn from_str(text: &str) -> Result<QuatOrder, PathError> {
        match text {
            "xyzw" => Ok(QuatOrder::Xyzw),
            "wxyz" => Ok(QuatOrder::Wxyz),
            _ => Err(PathError::Option { given: text.to_owned(), message: "expected xyzw or wxyz".to_owned() }),
        }
    }
}

/// How a recording is to be read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Convention {
    pub(super) order: QuatOrder,
    pub(super) axes: CameraAxes,
    /// Up of the frame that the positions are in.
    pub(super) up: Axis,
}

/// What is given rather than chosen.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Given {
    pub(super) order: Option<QuatOrder>,
    pub(super) axes: Option<CameraAxes>,
    pub(super) up: Option<Axis>,
}

/// A pose as it stands in the file: the quaternion's four numbers in the file's order.
#[derive(Clone, Copy, Debug)]
pub(super) struct RawPose {
    pub(super) time: f64,
    pub(super) position: DVec3,
    pub(super) numbers: [f64; 4],
}

/// Motion is measured over at least this long …
const WINDOW_SECONDS: f64 = 0.5;
/// … and not over more than this, where a recording pauses.
const WINDOW_SECONDS_MAX: f64 = 3.0;
/// At most about this many windows are measured.
const WINDOWS_MAX: usize = 20_000;
/// A camera that follows its motion at least so well (mean cosine, weighted by distance) is believed.
const FOLLOWS: f64 = 0.75;
/// One that follows it less than this says nothing about its forward axis.
const FOLLOWS_A_LITTLE: f64 = 0.25;
/// An up axis whose mean cosine with the vertical is above this is believed, below `UP_DENIED` it is denied.
const UP_BELIEVED: f64 = 0.8;
const UP_DENIED: f64 = 0.5;
/// Motion along another up must be less than this share of that along the format's.
const LEVEL: f64 = 0.5;
/// A candidate must score this much more than the format's default.
const MARGIN: f64 = 0.15;

/// How well each body axis follows the motion, and how it stands to the axes of the frame, in one quaternion order.
struct Evidence {
    order: QuatOrder,
    /// Σ axis·Δp / Σ|Δp| for each body axis; 0 without motion.
    follow: [f64; 3],
    /// `mean[k]`: mean direction of body axis k in the frame.
    mean: [DVec3; 3],
}

impl Evidence {
    fn gather(poses: &[RawPose], order: QuatOrder) -> Evidence {
        let stride = poses.len().div_ceil(WINDOWS_MAX).max(1);
        let (mut follow, mut mean) = ([0.0; 3], [DVec3::ZERO; 3]);
        let (mut distance, mut count) = (0.0, 0.0);
        let mut end = 0;
        for i in (0..poses.len()).step_by(stride) {
            while end < poses.len() && poses[end].time < poses[i].time + WINDOW_SECONDS {
                end += 1;
            }
            let middle = i + (end.min(poses.len() - 1) - i) / 2;
            let body = DMat3::from_quat(order.quaternion(poses[middle].numbers).normalize());
            count += 1.0;
            for (sum, axis) in mean.iter_mut().zip([body.x_axis, body.y_axis, body.z_axis]) {
                *sum += axis;
            }
            if end < poses.len() && poses[end].time - poses[i].time <= WINDOW_SECONDS_MAX {
                let moved = poses[end].position - poses[i].position;
                distance += moved.length();
                for (sum, axis) in follow.iter_mut().zip([body.x_axis, body.y_axis, body.z_axis]) {
                    *sum += axis.dot(moved);
                }
            }
        }
        if distance > 0.0 {
            follow = follow.map(|sum| sum / distance);
        }
        Evidence { order, follow, mean: mean.map(|sum| sum / count) }
    }

    fn score(&self, axes: CameraAxes, up: Axis) -> Score {
        let along_up = self.mean.map(|axis| axis.dot(up.vector()));
        Score { follow: axes.forward.of(self.follow), up: axes.up.of(along_up) }
    }
}

#[derive(Clone, Copy, Debug)]
struct Score {
    follow: f64,
    up: f64,
}

impl Score {
    fn sum(self) -> f64 {
        self.follow + self.up
    }

    fn is_strong(self) -> bool {
        self.follow >= FOLLOWS && self.up >= UP_BELIEVED
    }
}

/// Extent of the positions along an axis.
fn spread(poses: &[RawPose], axis: Axis) -> f64 {
    let along = poses.iter().map(|pose| pose.position.dot(axis.vector()));
    let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
    high - low
}

/// Chooses what is not given, and says why.
///
/// Every order and pair of axes is scored by how well forward follows the motion plus how close up stays to the
/// vertical, both mean cosines. The best replaces the format's default if it is clearly better, and either follows the
/// motion well, or follows it a little while the default's up is not up at all: a camera that strafes or orbits does
/// not follow its motion, and says nothing about its forward axis. The frame's up is the default's too, unless no
/// candidate is convincing there while the default camera stands upright along x or y and moves much less along that.
pub(super) fn choose(poses: &[RawPose], default: Convention, given: Given) -> (Convention, String) {
    let fixed = Convention {
        order: given.order.unwrap_or(default.order),
        axes: given.axes.unwrap_or(default.axes),
        up: given.up.unwrap_or(default.up),
    };
    if given.order.is_some() && given.axes.is_some() && given.up.is_some() || poses.is_empty() {
        return (fixed, format!("camera axes {}, quaternions {}, up {}: as given", fixed.axes, fixed.order, fixed.up));
    }
    let orders = [QuatOrder::Xyzw, QuatOrder::Wxyz];
    let evidence: Vec<Evidence> = orders
        .into_iter()
        .filter(|order| given.order.is_none_or(|given| given == *order))
        .map(|order| Evidence::gather(poses, order))
        .collect();
    let score_of = |convention: Convention| {
        let found = evidence.iter().find(|e| e.order == convention.order);
        found.map_or(Score { follow: 0.0, up: 0.0 }, |e| e.score(convention.axes, convention.up))
    };
    let best_with = |up: Axis| {
        let mut best = (Convention { up, ..fixed }, score_of(Convention { up, ..fixed }));
        for e in &evidence {
            for axes in CameraAxes::all().filter(|axes| given.axes.is_none_or(|given| given == *axes)) {
                let score = e.score(axes, up);
                if score.sum() > best.1.sum() {
                    best = (Convention { order: e.order, axes, up }, score);
                }
            }
        }
        best
    };

    let mut fixed = fixed;
    let mut best = best_with(fixed.up);
    if given.up.is_none() && default.up == Axis::Z && !best.1.is_strong() {
        let upright = Axis::ALL
            .into_iter()
            .filter(|up| up.index != default.up.index)
            .filter(|&up| spread(poses, up) < LEVEL * spread(poses, default.up))
            .find(|&up| score_of(Convention { up, ..fixed }).up >= UP_BELIEVED);
        if let Some(up) = upright {
            fixed.up = up;
            best = best_with(up);
        }
    }
    let (best, best_score) = best;
    let fixed_score = score_of(fixed);
    let convincing = best_score.follow >= FOLLOWS && best_score.up >= UP_DENIED
        || fixed_score.up < UP_DENIED && best_score.up >= UP_BELIEVED && best_score.follow >= FOLLOWS_A_LITTLE;
    let differs = best != fixed;
    let taken = if differs && convincing && best_score.sum() >= fixed_score.sum() + MARGIN { best } else { fixed };
    let score = score_of(taken);
    let weak = score.follow < FOLLOWS || score.up < UP_DENIED;
    let mut note = format!(
        "camera axes {}, quaternions {}, up {}: forward follows the motion by {:.2}, up the vertical by {:.2}",
        taken.axes, taken.order, taken.up, score.follow, score.up
    );
    if taken.up != default.up && given.up.is_none() {
        note.push_str(&format!("; the frame's up is {}, not the format's {}", taken.up, default.up));
    }
    if taken == fixed && weak {
        note.push_str("; weak evidence, so the format's default stands");
    } else if taken != fixed {
        note.push_str(&format!(
            "; the format's default, {} {}, by {:.2} and {:.2}",
            fixed.axes, fixed.order, fixed_score.follow, fixed_score.up
        ));
    }
    (taken, note)
}
