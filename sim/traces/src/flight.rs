//! A path as it is replayed: a view at every tick, and the cuts by which the frames are judged.

use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::lod_tree::LodTree;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use rayon::prelude::*;

/// Policies are asked this often, per second.
pub const TICKS_PER_SECOND: u64 = 60;
/// Quality is sampled at every second tick.
pub const TICKS_PER_FRAME: u64 = 2;

/// Time of a tick: exact multiples of 1/60 s, rounded down to the nanosecond.
pub fn tick_time(tick: u64) -> Time {
    Time(tick * 1_000_000_000 / TICKS_PER_SECOND)
}

/// The views of a replay, one a tick.
#[derive(Clone, Debug)]
pub struct Flight {
    /// At [`tick_time`] of their index.
    pub views: Vec<View>,
}

impl Flight {
    /// Samples a path of `duration_s` seconds; at least one tick.
    pub fn sample(duration_s: f64, mut at: impl FnMut(f64) -> View) -> Flight {
        let ticks = (libm::floor(duration_s * TICKS_PER_SECOND as f64) as u64).max(1);
        Flight { views: (0..ticks).map(|tick| at(tick_time(tick).secs())).collect() }
    }

    /// Length of the replay.
    pub fn duration(&self) -> Time {
        tick_time(self.views.len() as u64)
    }

    /// Number of sampled frames.
    pub fn frames(&self) -> usize {
        self.views.len().div_ceil(TICKS_PER_FRAME as usize)
    }

    /// The cut of every sampled frame, κ = 1, in order; in parallel, and the same on any number of threads.
    pub fn cuts(&self, tree: &LodTree, settings: &CutSettings) -> Vec<Cut> {
        let settings = CutSettings { centre_falloff: 0.0, ..*settings };
        self.views
            .par_iter()
            .step_by(TICKS_PER_FRAME as usize)
            .map(|view| {
                let mut cut = Cut::default();
                cut.make(tree, view, Region::Frustum, &settings);
                cut
            })
            .collect()
    }
}
