//! Policies: what to fetch next, each in a file under its published name.

pub mod added_benefit;
mod downloads;
pub mod foresight;
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
use crate::scheduler::Action;
use crate::state::ClientState;
use crate::units::Time;
use crate::view::View;

/// Decides what a client fetches, cancels and discards. All a policy knows is what it is told here.
pub trait Policy: Send {
    /// The name under which it is asked for.
    fn name(&self) -> &str;

    /// The camera moved. Called at every tick, before [`Policy::decide`].
    fn observe(&mut self, state: &ClientState, view: &View, now: Time);

    /// One thing to do. Asked again at once until it answers [`Action::WaitUntil`].
    fn decide(&mut self, state: &ClientState, now: Time) -> Action;

    /// A representation became visible.
    fn completed(&mut self, _state: &ClientState, _rep: RepId, _now: Time) {}

    /// A request or its decoding failed.
    fn failed(&mut self, _state: &ClientState, _rep: RepId, _now: Time) {}

    /// The client has said where it will go.
    fn announce_path(&mut self, _path: &[(Time, View)]) {}
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
