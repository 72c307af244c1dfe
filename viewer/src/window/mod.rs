//! A window on a world while it streams: input, camera, scheduler, contents, picture, overlay.
//!
//! One thread draws (`app`). Another decides and fetches: the scheduler in this program (`local`), or a session of a server
//! ([`fly_drawn`]). They meet in an [`Exchange`]. Contents are read and decoded on threads of their own
//! ([`crate::scene::loader`]).

mod app;
mod frame;
mod judge;
mod local;
mod player;
mod screen;
mod stage;

use crate::clock::Clock;
use crate::controls::rig::Mode;
use crate::draw::environment::EnvironmentSettings;
use crate::exchange::{Exchange, Link, Status};
use crate::fetch::Http;
use crate::gpu::{GpuError, Sky};
use crate::scene::compress::Compression;
use crate::scene::source::Source;
use crate::session::{Drawn, Plan, fly_drawn};
use foresight_index::world::World;
use foresight_replay::simulation::ReplayError;
use foresight_scheduler::policy::specification::PolicySpec;
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_scheduler::view::View;
use foresight_traces::link::LinkTrace;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::Arc;

/// Who decides what is fetched.
pub enum Decider {
    /// The scheduler in this program.
    Local {
        /// The policy.
        policy: Box<PolicySpec>,
        /// What carries contents.
        link: LinkTrace,
        /// Memory and refinement.
        scheduler: SchedulerSettings,
    },
    /// A session of a server.
    Remote {
        /// With whom.
        plan: Box<Plan>,
        /// How many its world must have, to be this one.
        representations: usize,
        /// HTTP.
        http: Http,
        /// What waits for sockets.
        runtime: tokio::runtime::Runtime,
    },
}

/// What a window is opened with.
pub struct WindowSettings {
    /// The world.
    pub world: Arc<World>,
    /// Its contents.
    pub source: Arc<Source>,
    /// Who decides.
    pub decider: Decider,
    /// Memory for everything, bytes.
    pub memory: u64,
    /// Of that, what contents may take; environment maps take what is left.
    pub contents_memory: u64,
    /// What is far comes from environment maps from the beginning on; `None`: only once they are switched on.
    pub environment: Option<EnvironmentSettings>,
    /// A path to be played, 60 views a second; its first view is where the camera begins.
    pub path: Option<Vec<View>>,
    /// Close the window at the path's end.
    pub closes: bool,
    /// How the camera moves in the beginning.
    pub mode: Mode,
    /// Vertical field of view, radians.
    pub fov_y: f64,
    /// Pixels of the window, if the monitor has room.
    pub size: [u32; 2],
    /// Where screenshots and recordings are written.
    pub captures: PathBuf,
    /// Seconds a frame may take before less is drawn; `None` for as long as it takes.
    pub frame_s: Option<f64>,
    /// How colours, normals and textures are kept.
    pub compression: Compression,
    /// What is behind everything.
    pub sky: Sky,
    /// The program's clock.
    pub clock: Clock,
}

/// Why there is no window, or none any more.
#[derive(Debug, thiserror::Error)]
pub enum WindowError {
    /// No window system.
    #[error(
        "no window can be opened: {0}. Expected a desktop: DISPLAY or WAYLAND_DISPLAY names it (Debian: libxkbcommon-x11-0 \
         libx11-xcb1 libxcursor1 libxi6 libxrandr2; without a monitor, xvfb-run). --headless draws into files"
    )]
    System(String),
    /// Nothing can be drawn.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The world has no contents.
    #[error("the world cannot be drawn: {0}")]
    Contents(&'static str),
    /// The scheduler stopped.
    #[error(transparent)]
    Replay(#[from] ReplayError),
    /// The session stopped.
    #[error("{0}")]
    Session(String),
    /// A rival in a world of orthoviews.
    #[error(
        "the world has representations that show one direction only, which policy {0} does not tell apart; expected foresight and \
         what follows its objective, or lookahead"
    )]
    Directions(String),
    /// No threads.
    #[error("starting threads: {0}")]
    Threads(#[from] std::io::Error),
}

/// What came of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Outcome {
    /// Version of this document.
    pub schema_version: u32,
    /// What drew.
    pub adapter: String,
    /// Name of the world.
    pub world: String,
    /// Policy with its options.
    pub policy: String,
    /// Seconds that the window was open.
    pub seconds: f64,
    /// Frames drawn.
    pub frames: u64,
    /// Median time from one frame to the next, milliseconds.
    pub frame_ms: f64,
    /// Representations that were shown.
    pub shown: u64,
    /// Those that could not be.
    pub broken: u64,
    /// Bytes received.
    pub bytes_received: u64,
    /// Memory budget, bytes.
    pub memory_budget: u64,
    /// Most memory used: as it came, decoded, on the GPU, environment maps.
    pub memory_max: u64,
    /// Environment maps made.
    pub maps_made: u64,
    /// How often the graphics device was opened anew.
    pub devices_lost: u64,
    /// How often the server was away.
    pub server_away: u64,
    /// Files written.
    pub files: Vec<PathBuf>,
}

/// Opens a window and returns when it is closed.
///
/// # Errors
/// As [`WindowError`] has them.
pub fn run(settings: WindowSettings) -> Result<Outcome, WindowError> {
    if let Some(why) = settings.source.refusal() {
        return Err(WindowError::Contents(why));
    }
    if let Decider::Local { policy, .. } = &settings.decider
        && settings.world.tree.has_directions()
        && !policy.tells_directions()
    {
        return Err(WindowError::Directions(policy.label.clone()));
    }
    let exchange = Exchange::new();
    std::thread::scope(|scope| {
        let decided = scope.spawn(|| {
            let result = match &settings.decider {
                Decider::Local { policy, link, scheduler } => {
                    let local = local::Local { world: &settings.world, policy, link, scheduler: *scheduler };
                    local::drive(&local, &exchange, settings.clock).map_err(WindowError::from)
                }
                Decider::Remote { plan, representations, http, runtime } => {
                    let drawn = Drawn {
                        plan,
                        representations: *representations,
                        exchange: &exchange,
                        clock: settings.clock,
                        http: http.clone(),
                    };
                    let flown = runtime.block_on(fly_drawn(drawn));
                    flown.map(|_| ()).map_err(|error| WindowError::Session(error.to_string()))
                }
            };
            // The world stays on screen, and the overlay says why no more of it comes.
            if let Err(error) = &result {
                let status = Status { link: Link::Over(error.to_string()), ..exchange.status() };
                exchange.set_status(status);
            }
            result
        });
        let drawn = app::run(&settings, &exchange);
        exchange.leave();
        let decided = decided.join().unwrap_or_else(|_| Err(WindowError::Session("the scheduler failed".to_owned())));
        let outcome = drawn?;
        decided.map(|()| outcome)
    })
}
