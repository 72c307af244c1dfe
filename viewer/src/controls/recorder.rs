//! Recording where the camera goes, as the project's own recordings, in the world's own coordinates.

use super::capture::{Beside, CaptureError};
use foresight_scheduler::view::View;
use foresight_traces::path::Frame;
use foresight_traces::path::recording::{Sample, Writer};
use glam::DVec3;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Poses of a recording: 18 hours at 60 a second. It ends there.
const POSES_MAX: u64 = 4_000_000;

/// A recording that is being made, `path-NNNN.jsonl`. It is replayed with `--path FILE --place world`.
#[derive(Debug)]
pub struct Recorder {
    beside: Beside,
    writer: Writer<File>,
    began_ns: u64,
    last: Option<(u64, View)>,
    poses: u64,
}

impl Recorder {
    /// Begins one at `now_ns` in a world with this up.
    ///
    /// # Errors
    /// What the file system says.
    pub fn begin(folder: &Path, up: DVec3, now_ns: u64) -> Result<Recorder, CaptureError> {
        let (beside, file) = Beside::create(folder, "path", "jsonl")?;
        let name = beside.file().display().to_string();
        match Writer::new(&name, file, Frame::Local, up) {
            Ok(writer) => Ok(Recorder { beside, writer, began_ns: now_ns, last: None, poses: 0 }),
            Err(error) => {
                beside.discard();
                Err(error.into())
            }
        }
    }

    /// Seconds recorded.
    pub fn seconds(&self) -> f64 {
        self.last.map_or(0.0, |(at, _)| at.saturating_sub(self.began_ns) as f64 * 1e-9)
    }

    /// Adds where the camera is; a time that is not later than the one before is left out. False when the recording is full.
    ///
    /// # Errors
    /// What the file system says.
    pub fn push(&mut self, view: &View, now_ns: u64) -> Result<bool, CaptureError> {
        if self.poses >= POSES_MAX {
            return Ok(false);
        }
        if self.last.is_some_and(|(at, _)| now_ns <= at) || now_ns < self.began_ns {
            return Ok(true);
        }
        let before = self.last.map(|(_, view)| view);
        self.writer.push(&Sample {
            t: (now_ns - self.began_ns) as f64 * 1e-9,
            position: view.position.to_array(),
            orientation: view.orientation.to_array(),
            fov_y: (before.is_none_or(|before| before.fov_y != view.fov_y)).then_some(view.fov_y),
            viewport: (before.is_none_or(|before| before.viewport != view.viewport)).then_some(view.viewport),
        })?;
        self.last = Some((now_ns, *view));
        self.poses += 1;
        Ok(true)
    }

    /// Ends it; `None` if it has fewer than two poses, which no path can be made of.
    ///
    /// # Errors
    /// What the file system says.
    pub fn finish(self) -> Result<Option<PathBuf>, CaptureError> {
        self.writer.finish()?;
        if self.poses < 2 {
            self.beside.discard();
            return Ok(None);
        }
        self.beside.keep().map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use foresight_index::world::World;
    use foresight_traces::arguments::{PathArgs, open_path};
    use foresight_traces::path::place::{Placement, into_world};
    use glam::DQuat;
    use std::sync::Arc;

    fn world() -> World {
        foresight_index::specification::open("city:blocks=2", &(Arc::new(|_, _| {}) as _)).unwrap()
    }

    fn view(i: u64) -> View {
        let turn = i as f64 * 0.02;
        View {
            position: DVec3::new(100.0 * libm::cos(turn), 1e6 + turn, 30.0 + 0.1 * turn),
            orientation: DQuat::from_rotation_z(turn) * DQuat::from_rotation_x(1.4),
            fov_y: 1.0,
            viewport: [640, 480],
        }
    }

    #[test]
    fn what_is_recorded_is_replayed_where_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::begin(folder.path(), DVec3::Z, 5_000_000_000).unwrap();
        for i in 0..100 {
            assert!(recorder.push(&view(i), 5_000_000_000 + i * 16_000_000).unwrap());
        }
        // Not later: left out.
        assert!(recorder.push(&view(200), 5_000_000_000 + 99 * 16_000_000).unwrap());
        assert!((recorder.seconds() - 1.584).abs() < 1e-9);
        let file = recorder.finish().unwrap().unwrap();
        assert!(file.ends_with("path-0001.jsonl"));
        let path = open_path(file.to_str(), &PathArgs::default()).unwrap();
        let (placed, _) = into_world(&path, Some(Placement::World), &world()).unwrap();
        for i in 0..100 {
            let (position, orientation) = placed.at(i as f64 * 0.016);
            assert!(position.distance(view(i).position) < 1e-6, "{i}: {position}");
            assert!(orientation.dot(view(i).orientation).abs() > 1.0 - 1e-12);
        }
    }

    #[test]
    fn a_recording_of_one_pose_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = Recorder::begin(folder.path(), DVec3::Z, 0).unwrap();
        recorder.push(&view(0), 0).unwrap();
        assert_eq!(recorder.finish().unwrap(), None);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
