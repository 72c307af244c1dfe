//! `cesium-native`: the loading of cesium-native 0.62 (commit 004a56ac) with its shipped settings, read from
//! `TilesetSelection.cpp`, `Tileset.cpp`, `TilesetContentManager.cpp`, `TilesetViewGroup.cpp`, `TileLoadTask.h`,
//! `TilesetOptions.h`, `Tile.cpp` and `ViewState.cpp`.
//!
//! Once per frame:
//! 1. *Select* from the root, depth first. Error on screen = geometricError · H / (max(distance, 10⁻⁷ m) · 2 tan(fovy/2));
//!    distance to the bounding box; a tile *meets* the target if its error is below 16 px.
//!    - A tile with children is culled if none of their boxes is in the frustum (its own box decides if it has none, or
//!      one of them is empty). A culled tile is queued as `Preload` and not visited.
//!    - A leaf, and a tile that meets the target, is *rendered* and queued as `Normal`. But a tile that meets it, is not
//!      loaded, and was refined in the last frame is refined still, so that the finer tiles stay drawn, and is queued as
//!      `Urgent`; what is beneath such a tile is not queued for its own sake.
//!    - Any other tile is *refined*: its children are visited. If one of the tiles rendered beneath is not loaded, and
//!      none of them was rendered in the last frame, the tile itself is rendered and those beneath are kicked: where the
//!      tile is loaded, or where more than 20 beneath are not. If it is more than 20 and the tile was not itself drawn in
//!      the last frame, what is beneath leaves the queue and the tile is queued as `Normal`.
//!    - A refined tile that has not been queued is queued as `Preload`.
//! 2. *Unload*, while memory is short, what neither this frame nor the last has visited: least recently visited first,
//!    of one frame, ancestors first.
//! 3. *Load* what is queued and missing: `Urgent` before `Normal` before `Preload`, then lower first
//!
//!    (1 − forward · ĉ) · distance, ĉ towards the middle of the box; last where the eye is within 10⁻⁵ m of it.
//!
//!    At most 20 at once, decoding included. Loads are not aborted.
//!
//! A tile that failed counts as loaded and is not asked for again.
//!
//! Settled here, beside what `tileset` says:
//! - Empty tiles are refined unconditionally (shipped: those whose error is not below their parent's, and external
//!   tilesets). One without children counts as loaded.
//! - 512 MiB bound what is cached unused, and nothing bounds what is used. Here the budget bounds both. What is used only
//!   as a `Preload` (culled or refined, not rendered) goes too, after all that is unused, where an `Urgent` or a `Normal`
//!   load would not fit otherwise: as shipped, a preload never stands in their way.
//! - No occlusion results, as without a renderer that gives them. No fog: at its densest, 2·10⁻⁴/m, it hides what is
//!   more than 136 km away. `renderTilesUnderCamera` is for bounding regions only. One view.

mod selection;

use crate::lod_tree::{LodTree, RepId};
use crate::policy::tileset::{Queued, Tileset};
use crate::policy::{Policy, Rival};
use crate::scheduler::Action;
use crate::state::ClientState;
use crate::units::Time;
use crate::view::View;
use selection::{Branch, Load, Selected, Selection};

/// How a comparison offers it.
pub const RIVAL: Rival = Rival {
    name: "cesium-native",
    about: "cesium-native as shipped: urgent, normal and preloaded tiles by angle times distance, 20 loads, 16 px",
    error_target_px: Some(16.0),
    parallel: 20,
    tells_directions: false,
    build: |tree, settings| {
        let (error_target_px, max_loads) = (settings.error_target_px, settings.parallel);
        let settings = CesiumNativeSettings { error_target_px, max_loads, ..CesiumNativeSettings::default() };
        Box::new(CesiumNative::new(tree, settings))
    },
};

/// What a user of the library can set; the default is what it ships with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CesiumNativeSettings {
    /// `maximumScreenSpaceError`: error on screen below which refinement stops, pixels.
    pub error_target_px: f64,
    /// `maximumSimultaneousTileLoads`.
    pub max_loads: usize,
    /// `loadingDescendantLimit`: when more tiles than this are missing beneath one, it is loaded first.
    pub descendant_limit: usize,
    /// `preloadAncestors`.
    pub preload_ancestors: bool,
    /// `preloadSiblings`.
    pub preload_siblings: bool,
}

impl Default for CesiumNativeSettings {
    fn default() -> CesiumNativeSettings {
        CesiumNativeSettings {
            error_target_px: 16.0,
            max_loads: 20,
            descendant_limit: 20,
            preload_ancestors: true,
            preload_siblings: true,
        }
    }
}

/// The policy.
#[derive(Debug)]
pub struct CesiumNative {
    settings: CesiumNativeSettings,
    tileset: Tileset,
    selected: Vec<Selected>,
    /// Tiles visited in this frame and in the last, in preorder.
    visited: Vec<u32>,
    visited_before: Vec<u32>,
    loads: Vec<Load>,
    branches: Vec<Branch>,
    queue: Vec<Queued>,
}

impl CesiumNative {
    /// A viewer of `tree`.
    pub fn new(tree: &LodTree, settings: CesiumNativeSettings) -> CesiumNative {
        let tileset = Tileset::new(tree);
        CesiumNative {
            settings,
            selected: vec![Selected::default(); tileset.tiles().len()],
            tileset,
            visited: Vec::new(),
            visited_before: Vec::new(),
            loads: Vec::new(),
            branches: Vec::new(),
            queue: Vec::new(),
        }
    }

    fn plan(&mut self, state: &ClientState, view: &View) {
        self.select(state, &Selection::new(state.tree, view));
        for at in 0..self.visited.len() {
            self.tileset.keep_prerequisites(state.tree, self.visited[at]);
        }
        let frame = self.tileset.frame();
        let CesiumNative { selected, tileset, settings, loads, queue, .. } = self;
        let unused = |id: u32| {
            let last = selected[id as usize].last_visited();
            (last + 1 < frame).then_some((last, i64::from(id)))
        };
        let only_preloaded =
            |id: u32| selected[id as usize].is_only_preloaded(frame).then_some((u32::MAX, i64::from(id)));
        let mut slots = settings.max_loads.saturating_sub(tileset.pending().len());
        let mut blocked = None;
        for preloads in [false, true] {
            queue.clear();
            for load in loads.iter().filter(|l| l.is_preload() == preloads) {
                tileset.enqueue(state, load.tile, load.priority, queue);
            }
            if blocked.is_none() || tileset.pending().is_empty() {
                blocked = if preloads {
                    tileset.request(state, queue, &mut slots, unused)
                } else {
                    tileset.request(state, queue, &mut slots, |id| unused(id).or_else(|| only_preloaded(id)))
                };
            }
        }
    }
}

impl Policy for CesiumNative {
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

    fn failed(&mut self, _state: &ClientState, rep: RepId, _now: Time) {
        self.tileset.fail(rep);
    }
}
