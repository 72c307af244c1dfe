//! Fixes by latitude, longitude and height over time, made into a path on the Earth.

use foresight_index::geodesy::Geodetic;
use glam::DQuat;

use crate::path::built_in::look as turned;
use crate::path::frame::earth_axes;
use crate::path::{CameraPath, Heights, POSES_MAX, PathError, Pose, look};

use super::instant;

/// Farthest height accepted, metres.
const HEIGHT_MAX: f64 = 1e7;

/// Latest time accepted, seconds after 1970 or before it.
const TIME_MAX: f64 = 1e12;

/// How the camera is turned: clockwise from north, upwards, right side down; radians.
#[derive(Clone, Copy, Debug)]
pub(super) struct Attitude {
    pub(super) heading: f64,
    pub(super) pitch: f64,
    pub(super) roll: f64,
}

/// A position at a time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fix {
    /// Seconds since 1970, or since another moment of the file's.
    pub(super) time: f64,
    /// Degrees.
    pub(super) latitude: f64,
    /// Degrees.
    pub(super) longitude: f64,
    /// Metres.
    pub(super) height: Option<f64>,
    pub(super) attitude: Option<Attitude>,
}

/// Fixes as they are read.
pub(super) struct Track<'a> {
    name: &'a str,
    fixes: Vec<Fix>,
    notes: Vec<String>,
    /// Whether the times are dates.
    is_dated: bool,
}

impl<'a> Track<'a> {
    pub(super) fn new(name: &'a str, is_dated: bool) -> Track<'a> {
        Track { name, fixes: Vec::new(), notes: Vec::new(), is_dated }
    }

    pub(super) fn fixes(&self) -> &[Fix] {
        &self.fixes
    }

    pub(super) fn add_note(&mut self, note: impl Into<String>) {
        self.notes.push(note.into());
    }

    /// Takes a fix.
    ///
    /// # Errors
    /// What is wrong with it: the caller knows where it stands.
    pub(super) fn push(&mut self, fix: Fix) -> Result<(), String> {
        if !(-90.0..=90.0).contains(&fix.latitude) {
            return Err(format!("a latitude of {}; expected degrees from −90 to 90", fix.latitude));
        }
        if !(-180.0..=360.0).contains(&fix.longitude) {
            return Err(format!("a longitude of {}; expected degrees from −180 to 360", fix.longitude));
        }
        if let Some(height) = fix.height.filter(|height| !(-HEIGHT_MAX..=HEIGHT_MAX).contains(height)) {
            return Err(format!("a height of {height}; expected metres, at most {HEIGHT_MAX}"));
        }
        if !(-TIME_MAX..=TIME_MAX).contains(&fix.time) {
            return Err(format!("a time of {} s; expected at most {TIME_MAX}", fix.time));
        }
        if let Some(a) = fix.attitude.filter(|a| ![a.heading, a.pitch, a.roll].iter().all(|v| v.abs() <= 1e6)) {
            return Err(format!("angles {}, {}, {} radians; expected finite ones", a.heading, a.pitch, a.roll));
        }
        if self.fixes.len() == POSES_MAX {
            return Err(format!("one position more than the {POSES_MAX} expected at most"));
        }
        self.fixes.push(fix);
        Ok(())
    }

    /// The path: fixes in order of time, the first of those at the same time, missing heights interpolated, and where
    /// there is no attitude a camera along the motion.
    pub(super) fn finish(mut self, heights: Heights) -> Result<CameraPath, PathError> {
        let total = self.fixes.len();
        if self.fixes.windows(2).any(|pair| pair[1].time < pair[0].time) {
            self.fixes.sort_by(|a, b| a.time.total_cmp(&b.time));
            self.notes.push("positions put in order of time".to_owned());
        }
        self.fixes.dedup_by(|later, kept| later.time <= kept.time);
        let duplicates = total - self.fixes.len();
        if duplicates > 0 {
            self.notes
                .push(format!("mind: {duplicates} of {total} positions have the time of the one before them: dropped"));
        }
        let start = self.fixes.first().map_or(0.0, |fix| fix.time);
        if self.is_dated && !self.fixes.is_empty() {
            self.notes.insert(0, format!("begins {}", instant::to_text(start)));
        }
        let heights = self.fill_heights(heights);
        let mut has_attitude = Vec::with_capacity(self.fixes.len());
        let poses = self.fixes.iter().map(|fix| {
            let position = Geodetic::from_degrees(fix.latitude, fix.longitude, fix.height.unwrap_or(0.0)).to_ecef();
            has_attitude.push(fix.attitude.is_some());
            let orientation = fix.attitude.map_or(DQuat::IDENTITY, |a| {
                let level = DQuat::from_mat3(&earth_axes(position));
                (level * turned(0.5 * std::f64::consts::PI - a.heading, a.pitch, a.roll)).normalize()
            });
            Pose { time: fix.time - start, position, orientation }
        });
        let poses = poses.collect();
        let mut path = CameraPath::on_earth(self.name, poses, heights)?;
        for note in self.notes {
            path.add_note(note);
        }
        let without = has_attitude.iter().filter(|has| !**has).count();
        if without > 0 {
            look::complete(&mut path, &has_attitude);
            path.add_note(match without == has_attitude.len() {
                true => look::ALONG_THE_MOTION.to_owned(),
                false => format!("{without} of {} poses without orientation look along the motion", has_attitude.len()),
            });
        }
        Ok(path)
    }

    /// Interpolates missing heights in time, those before the first and after the last as these; without any they
    /// are 0 above the ground.
    fn fill_heights(&mut self, heights: Heights) -> Heights {
        let known: Vec<(f64, f64)> =
            self.fixes.iter().filter_map(|fix| fix.height.map(|height| (fix.time, height))).collect();
        let missing = self.fixes.len() - known.len();
        let (Some(first), Some(last)) = (known.first(), known.last()) else {
            if !self.fixes.is_empty() {
                self.notes.push("mind: no heights: taken as 0 above the ground".to_owned());
            }
            return Heights::Ground;
        };
        if missing == 0 {
            return heights;
        }
        for fix in self.fixes.iter_mut().filter(|fix| fix.height.is_none()) {
            let next = known.partition_point(|(time, _)| *time <= fix.time);
            let (before, after) = (known.get(next.wrapping_sub(1)).unwrap_or(first), known.get(next).unwrap_or(last));
            let step = after.0 - before.0;
            let share = if step > 0.0 { (fix.time - before.0) / step } else { 0.0 };
            fix.height = Some(before.1 + (after.1 - before.1) * share);
        }
        self.notes.push(format!("{missing} of {} heights are missing: interpolated", self.fixes.len()));
        heights
    }
}
