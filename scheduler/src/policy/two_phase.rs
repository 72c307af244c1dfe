//! `two-phase`: the caching and prefetching of \[RAIL\] §6, for a viewer on a track.
//!
//! Reference views V₁, V₂, … stand along the track; the viewer is between V₁ and V₂ (fig. 4). Of these two the whole
//! panorama is loaded. Of V₃, V₄ and V₅ less and less is: that part of the panorama that surrounds the view's
//! direction. One phase of prefetching goes along the direction of view, the other along the track. When the viewer
//! passes V₂, the rest of V₃ is fetched, and a part of V₆. A cache keeps what was used last.
//!
//! Settled here:
//! - A panorama ↔ the set that its position requires, whatever the direction: the coarsest cut with g · pixels per
//!   radian / d ≤ target, d (m) from the position to the node's box; the finest there is where nothing meets the target.
//!   There is no visibility polyhedron: everything at a distance counts as visible.
//! - Contents of one node and error, the directions of an orthoview, are loaded together.
//! - The track: the announced path, if there is one; else straight on in the direction in which the viewer has moved
//!   since V₁, at the start and after standing still in that of the view. V₁ is where the viewer was when the segment
//!   began, the others follow at the distance L, along the path. The next segment begins L from V₁, whichever way.
//! - The paper samples 20 to 23 views a path, without a rule. L is the longest side of the smallest box, not of size 0,
//!   that the viewer's own position requires: closer, neighbouring sets hardly differ.
//! - "Less and less": V₃ within 90° of the view's direction, V₄ within 45°, V₅ within 22.5°; a node belongs to it if the
//!   sphere about its box does in part. V₆ gets nothing before it is V₅.
//! - The order has no rule either: what of V₁ and V₂ is in view, nearest first; the rest of them, by the angle to the
//!   view's direction (the phase along the direction of view); V₃, V₄ and V₅, each nearest first (along the track). Of
//!   equals the coarser comes first. The queue is made anew in every segment, and when the camera has turned by a
//!   quarter of its field of view, or field of view or viewport change.
//! - A disc answers at once, and two threads read it; over a link they would wait for it to answer. Requests in flight: 4.
//! - The paper has no first picture other than the panoramas. At the start, where nothing is shown, the coarsest
//!   representation of everything in view comes first, nearest first; without it the screen would stay empty until the
//!   finest has come.
//! - "Maximum number of views allowed in cache is determined by memory size": the queue ends where its decoded bytes
//!   would exceed the memory budget. What is not in it goes when room is needed, least recently in it first. When that
//!   is not enough, the queue waits for what is on its way, and when nothing is, passes over what does not fit.
//! - A failed request is made again when the queue is made anew. Nothing on its way is aborted.

use super::downloads::{Asked, Downloads};
use super::tileset::tile::{Tile, shown_beneath, tiles_of};
use super::{Policy, Rival};
use crate::benefit::frustum::{Frustum, Side};
use crate::lod_tree::{LodTree, RepId};
use crate::scheduler::Action;
use crate::state::ClientState;
use crate::units::Time;
use crate::view::View;
use glam::DVec3;

/// How a comparison offers it.
pub const RIVAL: Rival = Rival {
    name: "two-phase",
    about: "all around the nearest two views of the track, ever less of the next three, least recently used go",
    error_target_px: Some(16.0),
    parallel: 4,
    tells_directions: false,
    build: |tree, settings| {
        let (error_target_px, max_requests) = (settings.error_target_px, settings.parallel);
        Box::new(TwoPhase::new(tree, TwoPhaseSettings { error_target_px, max_requests }))
    },
};

/// What can be set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwoPhaseSettings {
    /// Error on screen that the required sets meet, pixels.
    pub error_target_px: f64,
    /// Requests in flight at once.
    pub max_requests: usize,
}

impl Default for TwoPhaseSettings {
    fn default() -> TwoPhaseSettings {
        TwoPhaseSettings { error_target_px: 16.0, max_requests: 4 }
    }
}

/// Reference views looked at.
const VIEWS: usize = 5;

/// A content to load.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Entry {
    /// 0: at the start; 1: in view; 2: the rest of V₁ and V₂; 3 to 5: V₃ to V₅.
    phase: u8,
    /// Metres, or radians in phase 2.
    key: f64,
    depth: u32,
    rep: RepId,
}

/// What the queue was made for.
#[derive(Clone, Copy, Debug)]
struct Made {
    views: [DVec3; VIEWS],
    /// L, metres.
    length: f64,
    forward: DVec3,
    fov_y: f64,
    viewport: [u32; 2],
    /// Frame.
    frame: u32,
}

impl Made {
    fn is_segment_of(&self, position: DVec3) -> bool {
        // A world of points has no length: there a segment is a point.
        position == self.views[0] || position.distance(self.views[0]) < self.length
    }
}

/// Radians; 0 where one of the two has no length.
fn angle_between(a: DVec3, b: DVec3) -> f64 {
    let lengths = a.length() * b.length();
    if lengths > 0.0 { libm::acos((a.dot(b) / lengths).clamp(-1.0, 1.0)) } else { 0.0 }
}

/// The policy.
#[derive(Debug)]
pub struct TwoPhase {
    settings: TwoPhaseSettings,
    tiles: Vec<Tile>,
    contents: Vec<RepId>,
    /// Per tile, whether contents beneath it show all of it.
    shown_beneath: Vec<bool>,
    path: Vec<(Time, DVec3)>,
    made: Option<Made>,
    /// Number of times that the queue has been made.
    update: u32,
    /// Per representation, the queue that it was last in.
    queued_in: Vec<u32>,
    /// In order.
    queue: Vec<Entry>,
    /// All before it has been requested.
    next: usize,
    downloads: Downloads,
}

impl TwoPhase {
    /// A client of `tree`.
    pub fn new(tree: &LodTree, settings: TwoPhaseSettings) -> TwoPhase {
        let (tiles, contents, _) = tiles_of(tree);
        TwoPhase {
            settings,
            shown_beneath: shown_beneath(&tiles, |tile| !tile.is_empty()),
            tiles,
            contents,
            path: Vec::new(),
            made: None,
            update: 0,
            queued_in: vec![0; tree.representations()],
            queue: Vec::new(),
            next: 0,
            downloads: Downloads::new(tree),
        }
    }

    /// Calls `required` with each tile that a position requires. `allowed`: error that meets the target at one metre.
    fn panorama(&self, tree: &LodTree, eye: DVec3, allowed: f64, cone: Option<Cone>, mut required: impl FnMut(u32)) {
        let mut next = 0u32;
        while next < self.tiles.len() as u32 {
            let id = next;
            let tile = &self.tiles[id as usize];
            let to_centre = tree.centre(tile.node) - eye;
            let half = tree.half(tile.node);
            if cone.is_some_and(|c| !c.meets(to_centre, half.length())) {
                next = tile.subtree_end;
                continue;
            }
            let distance = (to_centre.abs() - half).max(DVec3::ZERO).length();
            let meets = !tile.is_empty() && tile.error <= allowed * distance;
            if !tile.is_empty() && (meets || !self.shown_beneath[id as usize]) {
                required(id);
            }
            next = if meets { tile.subtree_end } else { id + 1 };
        }
    }

    /// Positions of V₁ to V₅, V₁ being `first`, `length` apart.
    fn stand(&self, first: DVec3, direction: DVec3, length: f64, now: Time) -> [DVec3; VIEWS] {
        let mut views = [first; VIEWS];
        if length == 0.0 {
            return views;
        }
        let ahead = self.path.partition_point(|&(time, _)| time <= now);
        let mut remaining = length;
        let (mut at, mut placed) = (first, 1);
        for &(_, to) in &self.path[ahead..] {
            let mut step = at.distance(to);
            while placed < VIEWS && step >= remaining {
                at += (to - at) * (remaining / step);
                step -= remaining;
                views[placed] = at;
                (placed, remaining) = (placed + 1, length);
            }
            remaining -= step;
            at = to;
        }
        if self.path.len() > ahead {
            // The track ends here.
            views[placed..].fill(at);
        } else {
            for (k, view) in views.iter_mut().enumerate() {
                *view = first + direction * (k as f64 * length);
            }
        }
        views
    }

    fn make_queue(&mut self, state: &ClientState, view: &View, now: Time) {
        let tree = state.tree;
        let eye = view.position;
        let forward = view.forward();
        let allowed = self.settings.error_target_px / view.pixels_per_radian();
        let within_segment = self.made.filter(|m| m.is_segment_of(eye));
        let (views, length) = match within_segment {
            Some(made) => (made.views, made.length),
            None => {
                let moved = self.made.map(|m| eye - m.views[0]).unwrap_or_default();
                let direction = moved.try_normalize().unwrap_or(forward);
                let mut length = f64::INFINITY;
                self.panorama(tree, eye, allowed, None, |id| {
                    let side = 2.0 * tree.half(self.tiles[id as usize].node).max_element();
                    if side > 0.0 {
                        length = length.min(side);
                    }
                });
                let length = if length.is_finite() { length } else { 0.0 };
                (self.stand(eye, direction, length, now), length)
            }
        };
        let frame = self.downloads.frame();
        let (fov_y, viewport) = (view.fov_y, view.viewport);
        let at_start = self.made.is_none() && self.downloads.held().is_empty();
        self.made = Some(Made { views, length, forward, fov_y, viewport, frame });
        self.update += 1;
        self.next = 0;
        let mut queue = core::mem::take(&mut self.queue);
        let mut queued_in = core::mem::take(&mut self.queued_in);
        queue.clear();
        let frustum = Frustum::new(view);
        let mut add = |id: u32, phase: u8, key: f64| {
            let tile = &self.tiles[id as usize];
            for &rep in &self.contents[tile.first_content as usize..tile.end_content as usize] {
                if queued_in[rep.index()] != self.update {
                    queued_in[rep.index()] = self.update;
                    queue.push(Entry { phase, key, depth: tile.depth, rep });
                }
            }
        };
        let to = |id: u32, eye: DVec3| {
            let node = self.tiles[id as usize].node;
            (tree.centre(node) - eye, tree.half(node))
        };
        let distance = |id: u32, eye: DVec3| {
            let (to_centre, half) = to(id, eye);
            (to_centre.abs() - half).max(DVec3::ZERO).length()
        };
        if at_start {
            self.coarsest_in(tree, &frustum, |id| add(id, 0, distance(id, eye)));
        }
        for reference in &views[..2] {
            self.panorama(tree, *reference, allowed, None, |id| {
                let (to_centre, half) = to(id, eye);
                if frustum.side(to_centre, half) == Side::Outside {
                    add(id, 2, angle_between(to_centre, forward));
                } else {
                    add(id, 1, distance(id, eye));
                }
            });
        }
        let mut angle = core::f64::consts::FRAC_PI_2;
        for (phase, reference) in (3u8..).zip(&views[2..]) {
            let cone = Cone { axis: forward, angle };
            self.panorama(tree, *reference, allowed, Some(cone), |id| add(id, phase, distance(id, *reference)));
            angle *= 0.5;
        }
        queue.sort_unstable_by(|a, b| {
            let by_key = a.key.total_cmp(&b.key);
            a.phase.cmp(&b.phase).then(by_key).then(a.depth.cmp(&b.depth)).then(a.rep.cmp(&b.rep))
        });
        // As many as memory holds.
        let mut bytes = 0;
        let fitting = queue.iter().take_while(|entry| {
            bytes += tree.decoded_bytes(entry.rep);
            bytes <= state.budget
        });
        let fitting = fitting.count().max(1);
        queue.truncate(fitting);
        for entry in queue.iter().rev() {
            self.downloads.touch(state, entry.rep);
        }
        (self.queue, self.queued_in) = (queue, queued_in);
    }

    /// The first content on each way down, as far as it is in view.
    fn coarsest_in(&self, tree: &LodTree, frustum: &Frustum, mut found: impl FnMut(u32)) {
        let mut next = 0u32;
        while next < self.tiles.len() as u32 {
            let id = next;
            let tile = &self.tiles[id as usize];
            let outside = frustum.side(tree.centre(tile.node) - frustum.eye, tree.half(tile.node)) == Side::Outside;
            if !outside && !tile.is_empty() {
                found(id);
            }
            next = if outside || !tile.is_empty() { tile.subtree_end } else { id + 1 };
        }
    }

    fn plan(&mut self, state: &ClientState, view: &View, now: Time) {
        let valid = self.made.is_some_and(|made| {
            made.is_segment_of(view.position)
                && angle_between(view.forward(), made.forward) < 0.25 * view.fov_y
                && (view.fov_y, view.viewport) == (made.fov_y, made.viewport)
        });
        if !valid {
            self.make_queue(state, view, now);
        }
        if let Some(made) = self.made {
            self.downloads.keep_since(made.frame);
        }
        let mut passed = true;
        for at in self.next..self.queue.len() {
            if self.downloads.slots() == 0 {
                break;
            }
            match self.downloads.request(state, self.queue[at].rep) {
                Asked::Yes if passed => self.next = at + 1,
                Asked::Yes => {}
                Asked::TooLarge => passed = false,
                Asked::NoSlot | Asked::Waits => break,
            }
        }
    }
}

/// Directions within an angle of an axis.
#[derive(Clone, Copy, Debug)]
struct Cone {
    /// Unit vector.
    axis: DVec3,
    /// Radians, at most π/2.
    angle: f64,
}

impl Cone {
    /// Whether a sphere about `centre`, seen from the apex, reaches into it.
    fn meets(&self, centre: DVec3, radius: f64) -> bool {
        let distance = centre.length();
        if distance <= radius {
            return true;
        }
        angle_between(self.axis, centre) <= self.angle + libm::asin(radius / distance)
    }
}

impl Policy for TwoPhase {
    fn name(&self) -> &str {
        RIVAL.name
    }

    fn observe(&mut self, _state: &ClientState, _view: &View, now: Time) {
        self.downloads.frame_seen(now);
    }

    fn decide(&mut self, state: &ClientState, now: Time) -> Action {
        if self.downloads.begin(state, self.settings.max_requests)
            && let Some(view) = &state.view
        {
            self.plan(state, view, now);
        }
        self.downloads.next(state, now)
    }

    fn announce_path(&mut self, path: &[(Time, View)]) {
        self.path = path.iter().map(|(time, view)| (*time, view.position)).collect();
    }
}
