//! `cesium`: the loading of CesiumJS 1.145 (`@cesium/engine` 24.0.0) with its shipped settings, read from
//! `Cesium3DTileset.js`, `Cesium3DTile.js`, `Cesium3DTilesetTraversal.js`, `Cesium3DTilesetBaseTraversal.js`,
//! `Cesium3DTilesetCache.js`, `Cesium3DTileOptimizations.js`, `RequestScheduler.js` and `Camera.js`.
//!
//! Once per frame:
//! 1. *Adjust* the target: while less than the cache's size is loaded, ÷ 1.02 down to 16 px; else, while memory is short,
//!    × 1.02.
//! 2. *Traverse* from the root what is visible. Error on screen = geometricError · H / (distance · 2 tan(fovy/2)), less
//!    the relief of `tileset::fog`, 0 for a geometric error of 0; distance to the bounding box, at least
//!    10⁻⁷ m. A tile whose error is above the target is refined: its visible children are visited, nearest first, and if
//!    it has content the others are loaded too, because it is not replaced before all are there; beneath an empty child,
//!    the nearest tiles with content. A tile is visible if its box is in the frustum and, where the children's boxes lie
//!    strictly within its own, one of theirs is. All of these are *touched*.
//! 3. *Request* what was touched and is missing, unless the camera moves: 60 · |Δeye| / max(2r, 1) < 1, r the radius of
//!    the sphere round the box and Δeye the movement since the last frame, or if that is 0 the one before. Lower first:
//!
//!    P = 10⁸·\[not progressive\] + 10⁴·⌊10⁴·n(fov)⌋ + ⌊10⁴·n(distance)⌋ + n(level)
//!
//!    n = normalised by the least and greatest of the tiles updated this frame, less 10⁻⁷, at least 0. Progressive: the
//!    tile's error at 0.3·H is above the target, or its parent's is. fov = 0 if the view's line meets the sphere, else
//!    1 − |forward · ĉ|, ĉ towards the sphere's point nearest the line: as shipped, what lies straight behind is
//!    central. fov and distance are those of the *holder*: where a tile's most central child c (the farthest of equals)
//!    is more central, the tile takes its fov and the lesser of the distances and lends both to all its children; it is
//!    itself lent those of the tile that holds them for it if it was such a child and that tile is no less central.
//!    At most 20 are started per frame (the heap), 18 at once; none in a frame that finds 18 in flight.
//! 4. *Abort* requests of tiles that were not touched, in the same frame.
//! 5. *Unload*, while more than the cache's size is loaded, what was not touched: least recently touched first; of one
//!    frame, last touched first.
//!
//! A tile that failed is not asked for again.
//!
//! Settled here, beside what `tileset` says:
//! - P has two more terms: 10⁹ for deferred tiles, which replacement without skipped levels never has
//!   (`foveatedTimeDelay` has no effect), and 10¹⁰ for all but a flight's destination: no flight is announced.
//! - A tileset comes from one server, so that of its limits of 50 in all and 18 per server the lower one binds.
//!   `parallel` sets both.
//! - Cache : overflow = 512 MiB : 512 MiB; together they are the budget. Memory is short where the next request would
//!   not fit even decoded, with all that was not touched unloaded (shipped: when a tile is processed above the limit).
//! - The tileset's own error, which can stop at the root, and viewer request volumes are not in the tree.
//! - Children at equal distances are visited in the order of the tree (shipped: that of the frame before).

mod traversal;

use crate::lod_tree::{LodTree, RepId};
use crate::policy::tileset::tile::Tile;
use crate::policy::tileset::{Queued, Tileset};
use crate::policy::{Policy, Rival};
use crate::scheduler::Action;
use crate::state::ClientState;
use crate::units::Time;
use crate::view::View;
use glam::DVec3;
use traversal::{Ranges, View3d, Visit};

/// Requests that the scheduler's heap holds: at most as many are started in a frame.
const HEAP: usize = 20;
/// Factor by which the target changes per frame.
const TARGET_STEP: f64 = 1.02;
/// The target is not raised above this, pixels: then nothing but the root is left long since.
const TARGET_MAX_PX: f64 = 1e9;

/// How a comparison offers it.
pub const RIVAL: Rival = Rival {
    name: "cesium",
    about: "CesiumJS as shipped: base traversal at 16 px, foveated priority, 18 requests to a server, aborts, LRU cache",
    error_target_px: Some(16.0),
    parallel: 18,
    tells_directions: false,
    build: |tree, settings| {
        let (error_target_px, max_requests) = (settings.error_target_px, settings.parallel);
        Box::new(Cesium::new(tree, CesiumSettings { error_target_px, max_requests, ..CesiumSettings::default() }))
    },
};

/// What a user of the viewer can set; the default is what it ships with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CesiumSettings {
    /// `maximumScreenSpaceError`: error on screen at which refinement stops, pixels.
    pub error_target_px: f64,
    /// `RequestScheduler.maximumRequestsPerServer`.
    pub max_requests: usize,
    /// `cacheBytes / (cacheBytes + maximumCacheOverflowBytes)`: share of the budget down to which untouched tiles are
    /// unloaded.
    pub cache_share: f64,
    /// `cullRequestsWhileMovingMultiplier`: frames of the camera's movement that a tile's diameter must exceed.
    pub moving_multiplier: f64,
    /// `progressiveResolutionHeightFraction`.
    pub progressive_height: f64,
}

impl Default for CesiumSettings {
    fn default() -> CesiumSettings {
        CesiumSettings {
            error_target_px: 16.0,
            max_requests: 18,
            cache_share: 0.5,
            moving_multiplier: 60.0,
            progressive_height: 0.3,
        }
    }
}

/// The policy.
#[derive(Debug)]
pub struct Cesium {
    settings: CesiumSettings,
    tileset: Tileset,
    visits: Vec<Visit>,
    /// Whether a tile's children lie strictly within it (`checkChildrenWithinParent`).
    children_within: Vec<bool>,
    /// `memoryAdjustedScreenSpaceError`, pixels.
    target: f64,
    /// In the last frame, something that was wanted did not fit.
    memory_short: bool,
    eye: Option<DVec3>,
    /// Metres between the last two frames.
    moved: f64,
    ranges: Ranges,
    /// Tiles touched or loaded so far in this frame: their order in the cache.
    touches: i64,
    requested: Vec<u32>,
    queue: Vec<Queued>,
    stack: Vec<u32>,
    empty_stack: Vec<u32>,
    children: Vec<u32>,
}

impl Cesium {
    /// A viewer of `tree`.
    pub fn new(tree: &LodTree, settings: CesiumSettings) -> Cesium {
        let tileset = Tileset::new(tree);
        let tiles = 0..tileset.tiles().len() as u32;
        Cesium {
            settings,
            visits: vec![Visit::default(); tileset.tiles().len()],
            children_within: tiles.map(|id| children_within(tree, &tileset, id)).collect(),
            tileset,
            target: settings.error_target_px,
            memory_short: false,
            eye: None,
            moved: 0.0,
            ranges: Ranges::default(),
            touches: 0,
            requested: Vec::new(),
            queue: Vec::new(),
            stack: Vec::new(),
            empty_stack: Vec::new(),
            children: Vec::new(),
        }
    }

    fn plan(&mut self, state: &ClientState, view: &View) {
        let cache = (self.settings.cache_share * state.budget as f64) as u64;
        if self.tileset.loaded_bytes() < cache {
            self.target = (self.target / TARGET_STEP).max(self.settings.error_target_px);
        } else if self.memory_short {
            self.target = (self.target * TARGET_STEP).min(TARGET_MAX_PX);
        }
        let moved = self.eye.map_or(0.0, |eye| view.position.distance(eye));
        let movement = if moved != 0.0 { moved } else { self.moved };
        (self.eye, self.moved) = (Some(view.position), moved);
        self.traverse(state, &View3d::new(state.tree, view, movement));

        let mut queue = core::mem::take(&mut self.queue);
        queue.clear();
        for (order, &id) in self.requested.iter().enumerate() {
            let priority = self.priority(id);
            self.tileset.enqueue(state, id, (0, priority.to_bits(), order as u32), &mut queue);
        }
        let frame = self.tileset.frame();
        let Cesium { visits, tileset, settings, .. } = self;
        let touched = |id: u32| visits[id as usize].touched == frame;
        let unused = |id: u32| (!touched(id)).then(|| visits[id as usize].last_use);
        let active = state.requests().len();
        let cancelled = tileset.cancel_unused(state, touched);
        tileset.unload_down_to(state, cache, unused);
        let free = if active < settings.max_requests { settings.max_requests - (active - cancelled) } else { 0 };
        let blocked = tileset.request(state, &mut queue, &mut free.min(HEAP), unused);
        self.memory_short = blocked.is_some_and(|rep| tileset.bytes_with(state, rep, unused) > state.budget);
        self.queue = queue;
    }

    /// P of a tile that was updated in this frame.
    fn priority(&self, id: u32) -> f64 {
        let visit = &self.visits[id as usize];
        let holder = &self.visits[visit.holder as usize];
        let digits = |share: f64| libm::floor(share * 1e4);
        let penalty = if visit.progressive { 0.0 } else { 1e8 };
        penalty
            + 1e4 * digits(self.ranges.foveated.share(holder.foveated))
            + digits(self.ranges.distance.share(holder.distance))
            + self.ranges.level.share(f64::from(self.tileset.tile(id).level))
    }
}

/// Whether the boxes of the tile's children lie within its own when both are projected on the line through their
/// middles, strictly and for each child; true without children.
fn children_within(tree: &LodTree, tileset: &Tileset, id: u32) -> bool {
    let bounds = |tile: &Tile| (tree.centre(tile.node), tree.half(tile.node));
    let (centre, half) = bounds(tileset.tile(id));
    tileset.children(id).all(|child| {
        let (child_centre, child_half) = bounds(tileset.tile(child));
        let axis = child_centre - centre;
        let length = axis.length();
        // As shipped, a child in the very middle passes.
        length == 0.0 || (axis / length).abs().dot(half - child_half) > length
    })
}

impl Policy for Cesium {
    fn name(&self) -> &str {
        RIVAL.name
    }

    fn observe(&mut self, _state: &ClientState, _view: &View, now: Time) {
        self.tileset.observe(now);
    }

    fn decide(&mut self, state: &ClientState, now: Time) -> Action {
        if let Some(view) = self.tileset.begin_frame(state) {
            self.plan(state, &view);
        }
        self.tileset.next_action(state, now)
    }

    fn completed(&mut self, _state: &ClientState, rep: RepId, _now: Time) {
        // Behind everything that the last frame touched.
        self.touches += 1;
        let tile = self.tileset.tile_of(rep) as usize;
        self.visits[tile].last_use = (self.tileset.frame(), self.touches);
    }

    fn failed(&mut self, _state: &ClientState, rep: RepId, _now: Time) {
        self.tileset.fail(rep);
    }
}
