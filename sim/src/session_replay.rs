//! A session that was recorded live: whether its decisions are made again, what was seen, and what the simulator says of
//! the same views over a link.
//!
//! What was seen is judged as the simulator judges: at 30 Hz from the first view on, by what could be shown at that time,
//! the view being the last that is not later. What could be shown follows from what was reported and said: a completion
//! shows, a discard or a drop hides, and an arrival hides what its request was to free. Of several cameras the one of the
//! largest weight counts.

mod again;
mod differences;
mod seen;

pub use again::{Agreement, Difference, Recorded, replay_recording};
pub use differences::{Differences, Shift};

use crate::compare::outcome;
use crate::future;
use crate::outcome::{DEFICIT_FLOOR, PolicyOutcome};
use crate::replay::{ReplayError, Run, Stage, replay};
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::lod_tree::{LodTree, RepId};
use foresight_scheduler::policy::specification::PolicySpec;
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_scheduler::units::Time;
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{Flight, TICKS_PER_SECOND};
use foresight_traces::link::LinkTrace;
use foresight_wire::message::Error;
use foresight_wire::recording::RecordingError;
use serde::Serialize;

/// Version of the JSON document. Raised when a field changes its meaning or goes away.
pub const SCHEMA_VERSION: u32 = 1;

/// Longest recording that is judged, ticks: twelve hours.
pub const TICKS_MAX: u64 = 12 * 3600 * TICKS_PER_SECOND;

/// Why a recorded session cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum SessionReplayError {
    /// It is no recording.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Its `hello` is refused.
    #[error("{name}: the session cannot be opened: {}", error.message)]
    Open {
        /// Of the recording.
        name: String,
        /// What the session says.
        error: Error,
    },
    /// It is of another world.
    #[error("{name}: the recorded world has {recorded} representations; the one given has {given}")]
    World {
        /// Of the recording.
        name: String,
        /// As its welcome says.
        recorded: u64,
        /// Of the world given.
        given: u64,
    },
    /// It is too long.
    #[error("{name}: its views span {seconds:.0} s; expected at most {}", TICKS_MAX / TICKS_PER_SECOND)]
    Length {
        /// Of the recording.
        name: String,
        /// From the first view to the last.
        seconds: f64,
    },
    /// Its policy cannot be made.
    #[error("{name}: {message}")]
    Policy {
        /// Of the recording.
        name: String,
        /// Why.
        message: String,
    },
    /// The simulation failed.
    #[error("simulating {name}: {source}")]
    Replay {
        /// Of the recording.
        name: String,
        /// Why.
        source: ReplayError,
    },
}

/// What came of a recorded session.
#[derive(Clone, Debug, Serialize)]
pub struct SessionOutcome {
    /// As named.
    pub recording: String,
    /// Its id.
    pub session: String,
    /// The world's name.
    pub world: String,
    /// Hash of the world as recorded.
    pub identity: String,
    /// The policy at the start.
    pub policy: String,
    /// Memory at the start, bytes.
    pub memory_bytes: u64,
    /// Views recorded.
    pub views: u64,
    /// From the first to the last view, seconds.
    pub duration_s: f64,
    /// Whether the answers are made again.
    pub agreement: Agreement,
    /// What was seen; `None` without a view.
    pub live: Option<PolicyOutcome>,
    /// Over a link, where one is given.
    pub simulated: Option<Simulated>,
    /// What the reader of the figures must know.
    pub warnings: Vec<String>,
}

/// The simulator on the same views, and how far the live session was from it.
#[derive(Clone, Debug, Serialize)]
pub struct Simulated {
    /// The link as named.
    pub link: String,
    /// The path as named; the recorded views if there is none.
    pub path: Option<String>,
    /// What it reached.
    pub outcome: PolicyOutcome,
    /// |d_live − d_simulated| ÷ max(d_simulated, 10⁻³), d the mean deficit; `None` where nothing is in view.
    pub relative_difference: Option<f64>,
    /// In what they differ.
    pub differences: Differences,
}

/// The recorded session over a link.
pub struct Simulation<'a> {
    /// The link.
    pub link: &'a LinkTrace,
    /// As named.
    pub link_name: &'a str,
    /// A path with its name, instead of the recorded views.
    pub flight: Option<(&'a Flight, &'a str)>,
    /// What the client can do.
    pub client: ClientSettings,
}

/// Judges the recorded session, and simulates it where a link is given.
///
/// # Errors
/// Views that span too long, a policy that cannot be made, a simulation that fails.
pub fn judge(
    name: &str,
    tree: &LodTree,
    recorded: &Recorded,
    judging: &CutSettings,
    simulation: Option<&Simulation>,
) -> Result<SessionOutcome, SessionReplayError> {
    let header = &recorded.header;
    let policy = header.hello.policy.clone().unwrap_or_else(|| header.limits.policy.clone());
    let mut spec = header
        .limits
        .policy(&policy)
        .map_err(|message| SessionReplayError::Policy { name: name.to_owned(), message })?;
    spec.settings.reach.up = recorded.up;
    let mut outcome_of = SessionOutcome {
        recording: name.to_owned(),
        session: header.session.clone(),
        world: header.world.clone(),
        identity: header.identity.clone(),
        policy,
        memory_bytes: header.hello.memory_bytes,
        views: recorded.views.len() as u64,
        duration_s: recorded.duration().secs(),
        agreement: recorded.agreement.clone(),
        live: None,
        simulated: None,
        warnings: recorded.warnings.clone(),
    };
    let Some(flight) = recorded.flight(name)? else {
        outcome_of.warnings.push("the recording has no view: there is nothing to judge".to_owned());
        return Ok(outcome_of);
    };
    let run = seen::run(tree, recorded, &flight, judging);
    let outcome = outcome(&spec, std::slice::from_ref(&run));
    let live = Live { flight, run, outcome };
    if let Some(simulation) = simulation {
        outcome_of.simulated = Some(simulate(name, tree, recorded, &spec, &live, judging, simulation)?);
    }
    outcome_of.live = Some(live.outcome);
    Ok(outcome_of)
}

/// The recorded session as it was seen.
struct Live {
    flight: Flight,
    run: Run,
    outcome: PolicyOutcome,
}

fn simulate(
    name: &str,
    tree: &LodTree,
    recorded: &Recorded,
    spec: &PolicySpec,
    live: &Live,
    judging: &CutSettings,
    simulation: &Simulation,
) -> Result<Simulated, SessionReplayError> {
    let flight = simulation.flight.map_or(&live.flight, |(flight, _)| flight);
    let hello = &recorded.header.hello;
    let guess = hello.link.unwrap_or(recorded.header.limits.link);
    let cuts = flight.cuts(tree, judging);
    let preloaded: Vec<RepId> = recorded.held_at_start.clone();
    let stage = Stage {
        tree,
        flight,
        cuts: &cuts,
        link: simulation.link,
        link_start: Time::ZERO,
        client: simulation.client,
        scheduler: SchedulerSettings {
            refinement: hello.refinement.into(),
            rate_guess: guess.rate,
            latency_guess_s: guess.latency_s,
            ..SchedulerSettings::with_budget(hello.memory_bytes)
        },
        preloaded: &preloaded,
    };
    let policy = future::build(spec, tree, flight, simulation.link, Time::ZERO);
    let run = replay(stage, policy).map_err(|source| SessionReplayError::Replay { name: name.to_owned(), source })?;
    let simulated = outcome(spec, std::slice::from_ref(&run));
    let relative_difference = live
        .outcome
        .mean_deficit
        .zip(simulated.mean_deficit)
        .map(|(live, simulated)| (live - simulated).abs() / simulated.max(DEFICIT_FLOOR));
    Ok(Simulated {
        link: simulation.link_name.to_owned(),
        path: simulation.flight.map(|(_, name)| name.to_owned()),
        outcome: simulated,
        relative_difference,
        differences: Differences::between(&live.run, &run),
    })
}
