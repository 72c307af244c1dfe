//! A path in figures, and what to mind about it.

use foresight_index::geodesy::{Geodetic, utm_zone_epsg};
use glam::DVec3;

use super::{CameraPath, Frame, Heights};

/// Longest step over the median one from which sampling is called irregular.
const IRREGULAR: f64 = 4.0;

/// A path that stays within this is the motion of a head or a hand, metres.
const ROOM: f64 = 6.0;

/// Coordinates farther out than this, and farther than several times the path's extent, are a map's, metres.
const MAP: f64 = 1e5;

/// Where a path on the Earth is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Least and greatest latitude, degrees.
    pub latitude: [f64; 2],
    /// Westernmost and easternmost longitude, degrees.
    pub longitude: [f64; 2],
    /// What heights are above.
    pub heights: Heights,
    /// EPSG code of the UTM zone of its first pose.
    pub utm: u32,
}

/// A path in figures.
#[derive(Clone, Debug, PartialEq)]
pub struct PathFacts {
    /// Number of poses.
    pub poses: usize,
    /// Seconds.
    pub duration: f64,
    /// Sum of the chords between poses, metres.
    pub length: f64,
    /// Shortest, median and longest step between poses, seconds.
    pub steps: [f64; 3],
    /// Number of gaps.
    pub gaps: usize,
    /// Median, 95th percentile and greatest of the steps' speeds, m/s.
    pub speeds: [f64; 3],
    /// Extent along the frame's axes; on the Earth east, north and in height; metres.
    pub extent: DVec3,
    /// Least and greatest height; for a path off the Earth along its up; metres.
    pub height: [f64; 2],
    /// Where on the Earth.
    pub place: Option<Place>,
    /// What to mind.
    pub traps: Vec<String>,
}

impl PathFacts {
    /// The figures of a path, in O(n log n).
    pub fn new(path: &CameraPath) -> PathFacts {
        let poses = path.poses();
        let (mut steps, mut speeds, mut length) = (Vec::new(), Vec::new(), 0.0);
        for pair in poses.windows(2) {
            let (step, moved) = (pair[1].time - pair[0].time, pair[0].position.distance(pair[1].position));
            length += moved;
            speeds.push(moved / step);
            steps.push(step);
        }
        let gaps = steps.iter().filter(|&&step| step > path.gap()).count();
        steps.sort_by(f64::total_cmp);
        speeds.sort_by(f64::total_cmp);
        let of = |sorted: &[f64], share: f64| {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of the length")]
            let index = (share * sorted.len() as f64) as usize;
            sorted.get(index.min(sorted.len().saturating_sub(1))).copied().unwrap_or(0.0)
        };
        let (extent, height, place) = extent(path);
        let mut facts = PathFacts {
            poses: poses.len(),
            duration: path.duration(),
            length,
            steps: [of(&steps, 0.0), path.median_step(), of(&steps, 1.0)],
            gaps,
            speeds: [of(&speeds, 0.5), of(&speeds, 0.95), of(&speeds, 1.0)],
            extent,
            height,
            place,
            traps: Vec::new(),
        };
        facts.traps = facts.find_traps(path);
        facts
    }

    fn find_traps(&self, path: &CameraPath) -> Vec<String> {
        let mut traps = Vec::new();
        let [shortest, median, longest] = self.steps;
        if longest > IRREGULAR * median {
            traps
                .push(format!("irregular: from {shortest:.3} s to {longest:.3} s between poses, {median:.3} s mostly"));
        }
        let largest = self.extent.max_element();
        if largest <= ROOM && self.place.is_none() {
            traps.push(format!(
                "moves within {largest:.1} m: the motion of a head or a hand, rather to ride on another path than one \
                 through a world"
            ));
        }
        let first = path.poses()[0].position;
        let away = first.abs().max_element();
        if self.place.is_none() && away > MAP.max(4.0 * largest) {
            traps.push(format!(
                "begins at {first:.0}: coordinates of a projected system, such as UTM? --path-crs EPSG:CODE puts it on \
                 the Earth"
            ));
        }
        match self.place.map(|place| place.heights) {
            Some(Heights::Pressure) => traps.push(
                "heights by air pressure differ from those above sea level with the weather, and these from those above \
                 the ellipsoid by up to 107 m (50 m in Europe)"
                    .to_owned(),
            ),
            Some(Heights::SeaLevel) => traps.push(
                "heights above sea level differ from those above the ellipsoid by up to 107 m (50 m in Europe)".to_owned(),
            ),
            Some(Heights::Ellipsoid) => traps.push(
                "heights above the ellipsoid differ from those above sea level by up to 107 m (50 m in Europe)".to_owned(),
            ),
            Some(Heights::Ground) | None => {}
        }
        traps
    }

    /// The figures and traps for the reader, a line each.
    pub fn lines(&self) -> Vec<String> {
        let (duration, length) = (self.duration, self.length);
        let rate = (self.poses - 1) as f64 / duration;
        let prec = if rate < 1.0 { 3 } else { 1 };
        let mut lines = vec![format!(
            "{} poses over {duration:.2} s ({:.prec$} Hz); {length:.1} m long, {:.2} m/s on average",
            self.poses,
            rate,
            length / duration
        )];
        let [shortest, step, longest] = self.steps;
        lines.push(format!("steps of {shortest:.3} s to {longest:.3} s, median {step:.3} s; {} gaps", self.gaps));
        let [median, p95, fastest] = self.speeds;
        lines.push(format!("speeds: median {median:.2} m/s, 95th percentile {p95:.2} m/s, at most {fastest:.2} m/s"));
        // No −0.0.
        let [low, high] = self.height.map(|height| if height.abs() < 5e-3 { 0.0 } else { height });
        if let Some(place) = self.place {
            let ([south, north], [west, east]) = (place.latitude, place.longitude);
            lines.push(format!(
                "frame: Earth (WGS 84), latitude {south:.5}° to {north:.5}°, longitude {west:.5}° to {east:.5}°, in UTM \
                 zone EPSG:{}",
                place.utm
            ));
            lines.push(format!("heights {low:.1} m to {high:.1} m, {}", place.heights));
        } else {
            lines.push(format!("frame: local metres; heights {low:.2} m to {high:.2} m along its up"));
        }
        lines.extend(self.traps.iter().map(|trap| format!("mind: {trap}")));
        lines
    }
}

/// Extent, heights, and the place on the Earth.
fn extent(path: &CameraPath) -> (DVec3, [f64; 2], Option<Place>) {
    let poses = path.poses();
    let first = poses[0].position;
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let mut height = [f64::INFINITY, f64::NEG_INFINITY];
    let mut widen = |value: f64| height = [height[0].min(value), height[1].max(value)];
    let Frame::Earth(heights) = path.frame() else {
        for pose in poses {
            (low, high) = (low.min(pose.position), high.max(pose.position));
            widen(pose.position.dot(path.up()));
        }
        return (high - low, height, None);
    };
    let origin = Geodetic::from_ecef(first).unwrap_or(Geodetic { latitude: 0.0, longitude: 0.0, height: 0.0 });
    let level_from_earth = origin.east_north_up().transpose();
    let (mut latitude, mut longitude) = ([f64::INFINITY, f64::NEG_INFINITY], [0.0_f64; 2]);
    for pose in poses {
        let p = level_from_earth * (pose.position - first);
        (low, high) = (low.min(p), high.max(p));
        let Some(here) = Geodetic::from_ecef(pose.position) else { continue };
        widen(here.height);
        latitude = [latitude[0].min(here.latitude), latitude[1].max(here.latitude)];
        // The shorter way around from the first pose.
        let turn = 2.0 * std::f64::consts::PI;
        let around = here.longitude - origin.longitude;
        let around = around - turn * (around / turn).round();
        longitude = [longitude[0].min(around), longitude[1].max(around)];
    }
    let place = Place {
        latitude: latitude.map(f64::to_degrees),
        longitude: longitude.map(|around| (origin.longitude + around).to_degrees()),
        heights,
        utm: utm_zone_epsg(&origin),
    };
    (DVec3::new(high.x - low.x, high.y - low.y, height[1] - height[0]), height, Some(place))
}
