//! Policies: what to fetch next, each in a file under its published name.
//!
//! # Adding a policy
//!
//! A new file here, and its module's name in the list of `rivals!` below: the command line, the comparison, its report
//! and the properties that hold in every replay then include it. This is a whole such file (inside the crate,
//! `crate::` stands for `foresight_scheduler::`). Its head states the rule, where it comes from, every constant, and
//! what was settled where the source leaves a choice.
//!
//! ```
//! //! `nearest-first`: whatever is nearest, one after the other, until memory is full. Drops nothing.
//!
//! use foresight_scheduler::lod_tree::RepId;
//! use foresight_scheduler::policy::{Policy, Rival, RivalSettings};
//! use foresight_scheduler::scheduler::Action;
//! use foresight_scheduler::state::{ClientState, Status};
//! use foresight_scheduler::units::Time;
//! use foresight_scheduler::view::View;
//! use glam::DVec3;
//!
//! /// How a comparison offers it.
//! pub const RIVAL: Rival = Rival {
//!     name: "nearest-first",
//!     about: "the nearest first, nothing dropped",
//!     error_target_px: None,
//!     parallel: 4,
//!     tells_directions: false,
//!     build: |_tree, settings| Box::new(NearestFirst { parallel: settings.parallel, queue: Vec::new() }),
//! };
//!
//! struct NearestFirst {
//!     parallel: usize,
//!     /// Metres and what is there, nearest last.
//!     queue: Vec<(f64, RepId)>,
//! }
//!
//! impl Policy for NearestFirst {
//!     fn name(&self) -> &str {
//!         RIVAL.name
//!     }
//!
//!     fn observe(&mut self, state: &ClientState, view: &View, _now: Time) {
//!         let tree = state.tree;
//!         let distance = |rep| {
//!             let node = tree.node_of(rep);
//!             ((tree.centre(node) - view.position).abs() - tree.half(node)).max(DVec3::ZERO).length()
//!         };
//!         self.queue = (0..tree.representations() as u32).map(|id| (distance(RepId(id)), RepId(id))).collect();
//!         // A total order, so that every machine decides alike.
//!         self.queue.sort_by(|a, b| b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)));
//!     }
//!
//!     fn decide(&mut self, state: &ClientState, now: Time) -> Action {
//!         while state.requests().len() < self.parallel {
//!             let Some((_, rep)) = self.queue.pop() else { break };
//!             let fits = state.request_bytes(rep) <= state.free_bytes();
//!             if state.status(rep) == Status::Absent && state.has_prerequisite(rep) && fits {
//!                 return Action::Fetch { rep, discard_on_arrival: Vec::new() };
//!             }
//!         }
//!         Action::WaitUntil(now + Time::from_secs(1.0 / 60.0))
//!     }
//! }
//! # use foresight_scheduler::lod_tree::{Aabb, LodTreeBuilder, Representation};
//! # use foresight_scheduler::scheduler::{Scheduler, SchedulerSettings};
//! # let mut builder = LodTreeBuilder::default();
//! # builder.open()?;
//! # for x in [30.0, 10.0] {
//! #     builder.open()?;
//! #     let (wire_bytes, decoded_bytes) = (1000, 4000);
//! #     builder.add(Representation { wire_bytes, decoded_bytes, error: 0.0, prerequisite: None, direction: None })?;
//! #     builder.close(Some(Aabb { min: DVec3::new(x, 0.0, 0.0), max: DVec3::new(x + 1.0, 1.0, 1.0) }), 1.0)?;
//! # }
//! # builder.close(None, 1.0)?;
//! # let tree = builder.finish()?;
//! # let policy = (RIVAL.build)(&tree, &RivalSettings { error_target_px: 16.0, parallel: RIVAL.parallel });
//! # let mut scheduler = Scheduler::new(&tree, SchedulerSettings::with_budget(1 << 20), policy);
//! # let (position, orientation) = (DVec3::ZERO, glam::DQuat::IDENTITY);
//! # scheduler.observe(&View { position, orientation, fov_y: 1.0, viewport: [800, 600] }, Time::ZERO)?;
//! # for rep in [RepId(1), RepId(0)] {
//! #     assert_eq!(scheduler.next(Time::ZERO)?, Action::Fetch { rep, discard_on_arrival: Vec::new() });
//! # }
//! # assert!(matches!(scheduler.next(Time::ZERO)?, Action::WaitUntil(_)));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A policy that is wrong about what is possible is refused by the scheduler, and no client is harmed. One that decides
//! once per frame, keeps what it uses and drops the least recently used finds that in `downloads.rs`. Tests with
//! trees made by hand, where the order of requests follows from the rule, go to `scheduler/tests/rivals/`.

pub mod added_benefit;
mod downloads;
pub mod foresight;
pub mod specification;
mod tileset;

/// Declares the module of each rival and lists its [`Rival`].
macro_rules! rivals {
    ($($module:ident)*) => {
        $(pub mod $module;)*
        /// Every rival, in the order of the comparison.
        pub const RIVALS: &[Rival] = &[$($module::RIVAL),*];
    };
}

rivals! {
    lookahead
    tiles_renderer
    cesium
    cesium_native
    loaders_gl
    potree
    playcanvas
    two_phase
    weighted_proxy
}

use crate::lod_tree::{LodTree, RepId};
use crate::scheduler::{Action, Reason};
use crate::select::certified::Certificate;
use crate::setting::{SettingError, within};
use crate::state::ClientState;
use crate::units::Time;
use crate::view::View;

/// Decides what a client fetches, cancels and discards. All a policy knows is what it is told here.
pub trait Policy: Send {
    /// The name under which it is asked for.
    fn name(&self) -> &str;

    /// The camera moved. Called at every tick, before [`Policy::decide`].
    fn observe(&mut self, state: &ClientState, view: &View, now: Time);

    /// Several cameras share link and memory: their shares, which sum to 1, and their views, two or more. A policy that
    /// does not know how to weigh them follows the camera of the largest share, the first of equals.
    fn observe_cameras(&mut self, state: &ClientState, _cameras: &[(f64, View)], now: Time) {
        if let Some(view) = &state.view {
            self.observe(state, view, now);
        }
    }

    /// One thing to do. Asked again at once until it answers [`Action::WaitUntil`].
    fn decide(&mut self, state: &ClientState, now: Time) -> Action;

    /// A representation became visible.
    fn completed(&mut self, _state: &ClientState, _rep: RepId, _now: Time) {}

    /// A request or its decoding failed.
    fn failed(&mut self, _state: &ClientState, _rep: RepId, _now: Time) {}

    /// The client has let go of `rep` by itself: it was resident, or its request or arrival is over. What it was to hand
    /// its memory to, and what its own request had doomed, is corrected in `state`. Nothing failed.
    fn dropped(&mut self, _state: &ClientState, _rep: RepId, _now: Time) {}

    /// The client has changed otherwise: its memory budget is another, or it holds what nobody has told it to fetch.
    fn changed(&mut self, _state: &ClientState) {}

    /// More memory is in use than the budget allows: what to cancel or discard next. Asked instead of
    /// [`Policy::decide`] until it fits. With `None` the scheduler chooses, and tells the policy by [`Policy::dropped`].
    fn make_room(&mut self, _state: &ClientState, _now: Time) -> Option<Action> {
        None
    }

    /// Why the last fetch was chosen, by a policy that can say.
    fn reason(&self) -> Option<Reason> {
        None
    }

    /// What became of α, for a policy that has one.
    fn alpha(&self) -> Option<foresight::AlphaReport> {
        None
    }

    /// The client has said where it will go.
    fn announce_path(&mut self, _path: &[(Time, View)]) {}

    /// Bytes of the tables that grow with what is resident, planned or searched; 0 for a policy that does not count them.
    fn heap_bytes(&self) -> usize {
        0
    }

    /// What is proven about the last choice, by a policy that proves something.
    fn certificate(&self) -> Option<Certificate> {
        None
    }
}

/// A policy of another viewer or paper, as a comparison offers it.
#[derive(Clone, Copy, Debug)]
pub struct Rival {
    /// Its published name.
    pub name: &'static str,
    /// Its rule, in one line.
    pub about: &'static str,
    /// Error on the screen that it ships with as its aim, pixels; `None` if it aims at something else.
    pub error_target_px: Option<f64>,
    /// Requests in flight at once that it ships with.
    pub parallel: usize,
    /// Whether it knows that an orthoview shows one side only. Others would take the first for the whole, and a world
    /// with directions is not replayed with them.
    pub tells_directions: bool,
    /// Makes it for one client.
    pub build: for<'a> fn(&'a LodTree, &RivalSettings) -> Box<dyn Policy + 'a>,
}

/// What can be set of every rival.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RivalSettings {
    /// Error on the screen aimed at, pixels, where the rival has such an aim.
    pub error_target_px: f64,
    /// Requests in flight at once.
    pub parallel: usize,
}

impl RivalSettings {
    /// Refuses an aim or a number of requests that has no meaning, naming the field.
    pub fn check(&self) -> Result<(), SettingError> {
        within("error_target_px", self.error_target_px, (1e-6, 1e12), "pixels from 1e-6 to 1e12")?;
        within("parallel", self.parallel as f64, (1.0, 1e6), "a count from 1 to 1e6")
    }
}
