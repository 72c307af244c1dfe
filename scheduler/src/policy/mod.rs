//! Policies: what to fetch next, each in a file under its published name.

pub mod added_benefit;
pub mod foresight;
pub mod lookahead;
pub mod tiles_renderer;

use crate::lod_tree::RepId;
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
