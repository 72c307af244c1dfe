//! Replays whose decisions are timed.

use crate::stopwatch::Stopwatch;
pub use foresight_replay::replay::{Completion, ReplayError, Request, Run, Stage};
use foresight_scheduler::policy::Policy;

/// Replays `policy` over the stage; the times of its decisions are real.
///
/// # Errors
/// As [`foresight_replay::replay::replay`]'s.
pub fn replay<'a>(stage: Stage<'a>, policy: Box<dyn Policy + 'a>) -> Result<Run, ReplayError> {
    let watch = Stopwatch::start();
    foresight_replay::replay::replay(stage, policy, &|| watch.nanos())
}
