//! `3d-tiles-renderer`: the loading of NASA-AMMOS 3DTilesRendererJS 0.5.3 with its shipped settings, read from
//! `TilesRendererBase.js`, `traverseFunctions.js`, `PriorityQueue.js`, `LRUCache.js` and `three/…/TilesRenderer.js`.
//!
//! Once per frame:
//! 1. *Traverse* from the root. Error on screen = geometricError · H / (distance · 2 tan(fov/2)), infinite at distance 0;
//!    distance to the bounding volume. Stop outside the frustum and where the error is ≤ the target. Every tile reached
//!    is *used*, and so are the siblings of a used tile (`loadAncestors` and `loadSiblings` are on). A tile none of whose
//!    children is in the frustum counts as outside; it and they are kept if cached, but not loaded. A tile whose error
//!    is not below that of its nearest ancestor which can be stopped at is refined whatever its error. Beneath a tile
//!    that would be drawn and is not loaded, the tiles used in the last frame stay used, down to those that were drawn.
//! 2. *Queue* every used tile that is not loaded, none while the cache is full; forget what is queued and no longer
//!    used. A download that has begun is not aborted by this, only by 3.
//! 3. *Unload* if the cache is above its lower cap (5 % of it at a time): only unused tiles, unfinished before loaded,
//!    then oldest last-visited frame, deeper, earlier in loading, lower error.
//! 4. *Request*: higher error, nearer, shallower; at most 25 that have had no response. `PriorityQueue` waits for what
//!    `fetch` promises, which is the response's header: bodies still coming hold no slot. How much is under way at once
//!    is up to the connection, `parallel`: 100 is what HTTP/2 recommends that a server allows at least (RFC 9113, 6.5.2),
//!    6 what browsers open over HTTP/1.1. What is asked for beyond that waits in the browser, first come first served.
//!
//! A failed tile is not asked for again until the cache has dropped it.
//!
//! Settled here:
//! - Bounding volumes are the nodes' content boxes. The frustum has no near or far plane.
//! - Every tile refines by `REPLACE`. A node's representations are a chain of tiles with decreasing error; those of
//!   equal error (the directions of an orthoview) are the contents of one tile.
//! - A tileset states the error of an empty tile, the tree does not. An empty tile never meets the target: stopping at
//!   it shows nothing. Where children replace their parent together (`Atomic`), an empty sibling hands the marking on to
//!   its children, as an external tileset does; else it is marked itself, and nothing outside the frustum is loaded for it.
//!   As shipped, it counts as drawn while what is beneath it comes.
//! - The tree is known from the start: no `tileset.json` is waited for, and the 250 tiles prepared per frame do not bind.
//! - Upper cap = the budget, which cannot be overdrawn; lower cap = ¾ of it (0.3 of 0.4 GiB); 8000 and 6000 items. As
//!   shipped, bytes count once a tile is loaded. "Full" is: the next request does not fit. Unused tiles then go at once,
//!   if that makes room (shipped: when the download has overdrawn the cap). If not, the queue waits for what is on its
//!   way, and when nothing is, later requests that fit go ahead.
//! - Contents have their prerequisites requested first and kept as long as they are used or cached.
//! - Queue and downloads run within the frame that finds a tile used; shipped, up to one frame later. The queue is made
//!   anew each frame: only its order of insertion among equals is lost; here the tile first in preorder goes first.
//! - Of what is drawn, only that is followed which decides on loading; "kicked" tiles are not.
//! - 5 parses at a time are the decoder's limit, not the policy's.

mod traversal;
mod unload;

use crate::benefit::coverage::Refinement;
use crate::benefit::frustum::Frustum;
use crate::lod_tree::{LodTree, RepId};
use crate::policy::tileset::FRAME;
use crate::policy::tileset::tile::{Tile, tiles_of};
use crate::policy::{Policy, Rival};
use crate::scheduler::Action;
use crate::state::{ClientState, Status};
use crate::units::Time;
use crate::view::View;
use core::cmp::Ordering;
use std::collections::VecDeque;
use traversal::{Descent, Traversal};

/// How a comparison offers it.
pub const RIVAL: Rival = Rival {
    name: "3d-tiles-renderer",
    about: "the viewer of that name as shipped: 16 px, 25 unanswered requests, its queue's order and its cache",
    error_target_px: Some(16.0),
    parallel: 100,
    tells_directions: false,
    build: |tree, settings| {
        let (error_target_px, max_streams) = (settings.error_target_px, settings.parallel);
        let settings = TilesRendererSettings { error_target_px, max_streams, ..TilesRendererSettings::default() };
        Box::new(TilesRenderer::new(tree, settings))
    },
};

/// What a user of the viewer can set; the default is what it ships with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TilesRendererSettings {
    /// `errorTarget`: error on screen at which refinement stops, pixels.
    pub error_target_px: f64,
    /// `downloadQueue.maxJobsPerOrigin`: requests without a response.
    pub max_downloads: usize,
    /// Requests and responses that the connection carries at once; not the viewer's to set.
    pub max_streams: usize,
    /// `lruCache.maxSize`: no tile is admitted at this many.
    pub max_items: usize,
    /// `lruCache.minSize`: unused tiles are unloaded above this many.
    pub min_items: usize,
    /// `lruCache.minBytesSize / maxBytesSize`: unused tiles are unloaded above this share of the budget.
    pub min_bytes_share: f64,
    /// `lruCache.unloadPercent`: share of the lower cap that is unloaded in one frame.
    pub unload_share: f64,
}

impl Default for TilesRendererSettings {
    fn default() -> TilesRendererSettings {
        TilesRendererSettings {
            error_target_px: 16.0,
            max_downloads: 25,
            max_streams: 100,
            max_items: 8000,
            min_items: 6000,
            min_bytes_share: 0.75,
            unload_share: 0.05,
        }
    }
}

/// What the traversals know of a tile. Frame numbers instead of flags: nothing has to be reset.
#[derive(Clone, Copy, Debug, Default)]
struct Visit {
    visited: u32,
    used: u32,
    /// Frame in which the cache was last told to keep it.
    kept: u32,
    active: u32,
    in_frustum: bool,
    /// The whole box lies in the frustum.
    all_inside: bool,
    cached: bool,
    failed: bool,
    finished: bool,
    any_child_used: bool,
    children_loaded: bool,
    /// Pixels.
    error: f64,
    /// Metres.
    distance: f64,
}

/// A content in the queue.
#[derive(Clone, Copy, Debug)]
struct Queued {
    error: f64,
    distance: f64,
    depth: u32,
    tile: u32,
    rep: RepId,
}

/// `errorPriorityCallback`: what is requested first comes first.
fn by_priority(a: &Queued, b: &Queued) -> Ordering {
    b.error
        .total_cmp(&a.error)
        .then(a.distance.total_cmp(&b.distance))
        .then(a.depth.cmp(&b.depth))
        .then(a.tile.cmp(&b.tile))
        .then(a.rep.cmp(&b.rep))
}

/// The policy.
#[derive(Debug)]
pub struct TilesRenderer {
    settings: TilesRendererSettings,
    tiles: Vec<Tile>,
    contents: Vec<RepId>,
    tile_of: Vec<u32>,
    visits: Vec<Visit>,
    frame: u32,
    /// A discard, a cancellation or a failure may have left a cached tile without content.
    may_have_gone: bool,
    /// The frame observed last has not been planned yet.
    due: bool,
    next_frame: Time,
    /// Tiles with a content requested, loaded or failed.
    cached: Vec<u32>,
    /// Contents asked for that the connection does not carry yet, in order.
    waiting: VecDeque<RepId>,
    /// Contents asked for and not loaded yet, waiting ones included.
    pending: Vec<RepId>,
    used: Vec<u32>,
    used_last_frame: Vec<u32>,
    queue: Vec<Queued>,
    unused: Vec<u32>,
    descents: Vec<Descent>,
    /// Per representation, how many cached ones of other tiles need it; zero between uses. Empty if none needs another.
    dependants: Vec<u32>,
    actions: VecDeque<Action>,
}

impl TilesRenderer {
    /// A viewer of `tree`.
    pub fn new(tree: &LodTree, settings: TilesRendererSettings) -> TilesRenderer {
        let (tiles, contents, tile_of) = tiles_of(tree);
        TilesRenderer {
            settings,
            visits: vec![Visit::default(); tiles.len()],
            tiles,
            contents,
            tile_of,
            frame: 1,
            may_have_gone: false,
            due: false,
            next_frame: Time::ZERO,
            cached: Vec::new(),
            waiting: VecDeque::new(),
            pending: Vec::new(),
            used: Vec::new(),
            used_last_frame: Vec::new(),
            queue: Vec::new(),
            unused: Vec::new(),
            descents: Vec::new(),
            dependants: vec![0; if tree.has_prerequisites() { tree.representations() } else { 0 }],
            actions: VecDeque::new(),
        }
    }

    fn contents(&self, tile: u32) -> &[RepId] {
        let tile = &self.tiles[tile as usize];
        &self.contents[tile.first_content as usize..tile.end_content as usize]
    }

    fn is_finished(&self, state: &ClientState, tile: u32) -> bool {
        self.visits[tile as usize].failed
            || self.contents(tile).iter().all(|&r| matches!(state.status(r), Status::Resident | Status::Doomed))
    }

    fn add_to_cache(&mut self, tile: u32) {
        if !core::mem::replace(&mut self.visits[tile as usize].cached, true) {
            self.cached.push(tile);
        }
    }

    fn plan(&mut self, state: &ClientState, view: &View) {
        if self.frame == 2 {
            // What was there before the first frame.
            for rep in (0..state.tree.representations() as u32).map(RepId) {
                if state.status(rep) != Status::Absent {
                    self.add_to_cache(self.tile_of[rep.index()]);
                }
            }
        }
        let waiting = &self.waiting;
        self.pending.retain(|&r| matches!(state.status(r), Status::InFlight | Status::Arrived) || waiting.contains(&r));
        let traversal = Traversal {
            tree: state.tree,
            frustum: Frustum::new(view),
            target: self.settings.error_target_px,
            atomic: state.resident().refinement() == Refinement::Atomic,
        };
        self.mark_used(&traversal);
        self.list_used(state, &traversal);
        self.keep_previously_used(&traversal);
        self.fill_queue(state);
        let freed = self.unload(state);
        self.request(state, freed);
        core::mem::swap(&mut self.used, &mut self.used_last_frame);
    }

    /// `toggleTiles`: keeps what is used, and queues what of it is missing.
    fn fill_queue(&mut self, state: &ClientState) {
        self.queue.clear();
        for &id in &self.used {
            let tile = &self.tiles[id as usize];
            let visit = &mut self.visits[id as usize];
            visit.kept = self.frame;
            if visit.failed {
                continue;
            }
            let (error, distance) = (visit.error, visit.distance);
            for &rep in &self.contents[tile.first_content as usize..tile.end_content as usize] {
                if state.status(rep) == Status::Absent && !self.waiting.contains(&rep) {
                    self.queue.push(Queued { error, distance, depth: tile.depth, tile: id, rep });
                }
                let mut needed = state.tree.prerequisite(rep);
                while let Some(prerequisite) = needed {
                    self.visits[self.tile_of[prerequisite.index()] as usize].kept = self.frame;
                    needed = state.tree.prerequisite(prerequisite);
                }
            }
        }
        let room = self.settings.max_items.saturating_sub(self.cached.len());
        if self.queue.len() > room {
            // The queue is admitted in the order in which it would be unloaded last.
            self.queue.select_nth_unstable_by(room, |a, b| a.depth.cmp(&b.depth).then(by_priority(a, b)));
            self.queue.truncate(room);
        }
    }

    /// Requests on their way that are not about to be cancelled, and how many of them have had no response.
    fn under_way(&self, state: &ClientState) -> (usize, usize) {
        let is_cancelled = |rep| self.actions.iter().any(|a| matches!(a, Action::Cancel(c) if *c == rep));
        let requests = state.requests().iter().filter(|r| !is_cancelled(r.rep));
        requests.fold((0, 0), |(all, unanswered), r| (all + 1, unanswered + usize::from(r.responded.is_none())))
    }

    fn free_slots(&self, state: &ClientState) -> usize {
        self.settings.max_downloads.saturating_sub(self.under_way(state).1 + self.waiting.len())
    }

    /// What waiting requests will take.
    fn waiting_bytes(&self, state: &ClientState) -> u64 {
        self.waiting.iter().map(|&r| state.request_bytes(r)).sum()
    }

    fn free_bytes(&self, state: &ClientState) -> u64 {
        state.free_bytes().saturating_sub(self.waiting_bytes(state))
    }

    /// `tryRunJobs` of the download queue.
    fn request(&mut self, state: &ClientState, freed: u64) {
        let mut slots = self.free_slots(state);
        let mut free = self.free_bytes(state) + freed;
        let mut queue = core::mem::take(&mut self.queue);
        let mut sorted = 0;
        let mut next = 0;
        while slots > 0 && next < queue.len() {
            if next == sorted {
                // Only as much is put in order as can be requested.
                let rest = &mut queue[sorted..];
                let chunk = slots.min(rest.len());
                if chunk < rest.len() {
                    rest.select_nth_unstable_by(chunk, by_priority);
                }
                rest[..chunk].sort_unstable_by(by_priority);
                sorted += chunk;
            }
            let wanted = queue[next].rep;
            let asked = |rep| state.status(rep) != Status::Absent || self.pending.contains(&rep);
            let mut rep = wanted;
            while let Some(missing) = state.tree.prerequisite(rep).filter(|&p| !asked(p)) {
                rep = missing;
            }
            if asked(rep) {
                next += 1;
                continue;
            }
            let bytes = state.request_bytes(rep);
            if bytes <= free {
                (free, slots) = (free - bytes, slots - 1);
                self.waiting.push_back(rep);
                self.pending.push(rep);
                self.add_to_cache(self.tile_of[rep.index()]);
            } else if self.pending.is_empty() {
                // Nothing will change by waiting: let those go ahead that fit.
                queue.drain(..=next);
                queue.retain(|q| state.request_bytes(q.rep) <= free);
                (next, sorted) = (0, 0);
            } else {
                break;
            }
        }
        self.queue = queue;
        let streams = self.settings.max_streams.saturating_sub(self.under_way(state).0);
        for rep in self.waiting.drain(..streams.min(self.waiting.len())) {
            self.actions.push_back(Action::Fetch { rep, discard_on_arrival: Vec::new() });
        }
    }
}

impl Policy for TilesRenderer {
    fn name(&self) -> &str {
        "3d-tiles-renderer"
    }

    fn observe(&mut self, _state: &ClientState, _view: &View, now: Time) {
        self.frame += 1;
        self.due = true;
        self.next_frame = now + FRAME;
    }

    fn decide(&mut self, state: &ClientState, now: Time) -> Action {
        if core::mem::take(&mut self.due) {
            self.actions.clear();
            if let Some(view) = &state.view {
                self.plan(state, view);
            }
        }
        while let Some(action) = self.actions.pop_front() {
            let possible = match &action {
                Action::Fetch { rep, .. } => {
                    state.status(*rep) == Status::Absent
                        && state.has_prerequisite(*rep)
                        && state.request_bytes(*rep) <= state.free_bytes()
                }
                Action::Cancel(rep) => state.status(*rep) == Status::InFlight && !state.is_needed(*rep),
                Action::Discard(rep) => state.status(*rep) == Status::Resident && !state.is_needed(*rep),
                Action::WaitUntil(_) => false,
            };
            self.may_have_gone |= !possible || !matches!(action, Action::Fetch { .. });
            if possible {
                return action;
            }
        }
        Action::WaitUntil(if self.next_frame > now { self.next_frame } else { now + FRAME })
    }

    fn failed(&mut self, _state: &ClientState, rep: RepId, _now: Time) {
        let tile = self.tile_of[rep.index()];
        self.visits[tile as usize].failed = true;
        self.add_to_cache(tile);
    }
}
