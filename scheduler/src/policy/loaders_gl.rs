//! `loaders-gl`: the loading of loaders.gl 5.0.0-alpha.2 (commit 34122eba), which deck.gl's `Tile3DLayer` drives, with
//! its shipped settings, read from `tileset-3d.ts`, `tile-3d.ts`, `tileset-traverser.ts`, `tileset-3d-traverser.ts`,
//! `tileset-cache.ts`, `tiles-3d-lod.ts`, `tiles-3d-request-priority.ts`, `frame-state.ts` and `request-scheduler.ts`.
//!
//! Once per frame:
//! 1. *Traverse* from the root, in view or not. Error on screen = geometricError · H / (distance · 1.15), less the relief
//!    of `tileset::fog`, 0 for a geometric error of 0; distance to the bounding box, at least 10⁻⁷ m. 1.15 stands for
//!    2 tan(fovy/2) whatever the field of view is. A tile whose error is above the target is refined: its children are
//!    taken farthest first, and those in the frustum are visited, nearest first. If the tile has content, those that are
//!    not are loaded too, and beneath an empty child the nearest tiles with content; and as shipped *the first child that
//!    is not loaded yet ends this*: the children nearer than it are neither visited nor loaded before it is there, so
//!    that beneath each tile the children are loaded one after the other, the farthest first.
//! 2. *Request* what of this is missing. Lower first:
//!
//!    P = 10⁸·\[not progressive\] + 10⁴·⌊9999·fov⌋ + ⌊9999·(error(root) − error(parent))/error(root)⌋
//!
//!    the last term within 0 and 9999, a root being its own parent. Progressive: the tile's error at 0.3·H is above the
//!    target, or its parent's is. fov = 0 if the view's ray meets the sphere round the box, else 1 − forward · ĉ within 0
//!    and 1, ĉ towards the sphere's point nearest the ray. At most 64 at once, decoding included. Downloads are not
//!    aborted.
//! 3. *Unload*, while more than the cache's size is loaded, what the traversal has not touched: least recently touched
//!    first; of one frame, last touched first.
//! 4. *Adjust* the target, here and whenever a tile has been loaded: while less than the cache's size is loaded, ÷ 1.02
//!    down to 8 px; else, while memory is short, × 1.02.
//!
//! A tile that failed is not asked for again, and so ends its parent's children as in 1 for ever.
//!
//! Settled here, beside what `tileset` says:
//! - Deferral (`foveatedTimeDelay`) has no effect: replacement without skipped levels is never deferred.
//! - The traversal runs in every frame (shipped: when the view has changed or a tile was loaded).
//! - Cache : overflow = 512 MiB : 512 MiB; together they are the budget. Memory is short where the next request would
//!   not fit even decoded, with all that was not touched unloaded (shipped: when more than both is loaded).
//! - In P, an empty tile's error is the greatest of those of the contents beneath it.
//! - Among equals in P, and among children at equal distances, the tile first in preorder goes first.

use crate::benefit::frustum::{Frustum, Side};
use crate::lod_tree::{LodTree, RepId};
use crate::policy::tileset::fog::Fog;
use crate::policy::tileset::{Queued, Sight, Tileset};
use crate::policy::{Policy, Rival};
use crate::scheduler::Action;
use crate::state::ClientState;
use crate::units::Time;
use crate::view::View;

/// `sseDenominator`.
const ERROR_DENOMINATOR: f64 = 1.15;
/// Least distance that an error is divided by, metres.
const DISTANCE_MIN: f64 = 1e-7;
/// `progressiveResolutionHeightFraction`.
const PROGRESSIVE_HEIGHT: f64 = 0.3;
/// Factor by which the target changes.
const TARGET_STEP: f64 = 1.02;
/// The target is not raised above this, pixels: then nothing but the root is left long since.
const TARGET_MAX_PX: f64 = 1e9;

/// How a comparison offers it.
pub const RIVAL: Rival = Rival {
    name: "loaders-gl",
    about: "loaders.gl as deck.gl drives it: 8 px, centre first, 64 requests, a tile's children one after the other",
    error_target_px: Some(8.0),
    parallel: 64,
    tells_directions: false,
    build: |tree, settings| {
        let (error_target_px, max_requests) = (settings.error_target_px, settings.parallel);
        Box::new(LoadersGl::new(tree, LoadersGlSettings { error_target_px, max_requests, ..Default::default() }))
    },
};

/// What a user of the library can set; the default is what it ships with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadersGlSettings {
    /// `maximumScreenSpaceError`: error on screen at which refinement stops, pixels.
    pub error_target_px: f64,
    /// `maxRequests`.
    pub max_requests: usize,
    /// `cacheBytes / (cacheBytes + maximumCacheOverflowBytes)`: share of the budget down to which untouched tiles are
    /// unloaded.
    pub cache_share: f64,
}

impl Default for LoadersGlSettings {
    fn default() -> LoadersGlSettings {
        LoadersGlSettings { error_target_px: 8.0, max_requests: 64, cache_share: 0.5 }
    }
}

/// What is known of a tile. Frame numbers instead of flags: nothing has to be reset.
#[derive(Clone, Copy, Debug, Default)]
struct Visit {
    /// Frame in which what the view makes of it was last computed.
    seen: u32,
    touched: u32,
    requested: u32,
    visible: bool,
    /// The whole box lies in the frustum.
    all_inside: bool,
    /// The error at the reduced height is above the target.
    coarse: bool,
    /// So is it, or the parent's.
    progressive: bool,
    /// Pixels; ∞ without content.
    error: f64,
    /// Pixels, as the priority takes it.
    stated_error: f64,
    /// Metres.
    distance: f64,
    /// Metres along the view to the middle.
    depth_in_view: f64,
    foveated: f64,
    /// Frame, and place within it, of the last use: the order of the cache.
    last_use: (u32, i64),
}

/// What one frame's traversal goes by.
struct Traversal<'t> {
    tree: &'t LodTree,
    frustum: Frustum,
    fog: Fog,
    /// Viewport height over the denominator, pixels.
    scale: f64,
}

/// The policy.
#[derive(Debug)]
pub struct LoadersGl {
    settings: LoadersGlSettings,
    tileset: Tileset,
    visits: Vec<Visit>,
    /// Per tile its error, or the greatest beneath it if it is empty; metres.
    stated: Vec<f32>,
    /// `memoryAdjustedScreenSpaceError`, pixels.
    target: f64,
    /// In the last frame, something that was wanted did not fit.
    memory_short: bool,
    /// Tiles touched or loaded so far in this frame: their order in the cache.
    touches: i64,
    requested: Vec<u32>,
    queue: Vec<Queued>,
    stack: Vec<u32>,
    empty_stack: Vec<u32>,
    children: Vec<u32>,
}

/// Angular distance of a sphere from the view's ray: 1 − cos of the angle to its nearest point, within 0 and 1.
fn foveated_factor(frustum: &Frustum, sight: &Sight) -> f64 {
    let radius = sight.half.length();
    let ahead = frustum.forward.dot(sight.to_centre).max(0.0);
    let to_ray = frustum.forward * ahead - sight.to_centre;
    let away = to_ray.length();
    if away <= radius {
        return 0.0;
    }
    let nearest = sight.to_centre + to_ray * (radius / away);
    (1.0 - frustum.forward.dot(nearest.normalize_or(frustum.forward))).clamp(0.0, 1.0)
}

impl LoadersGl {
    /// A viewer of `tree`.
    pub fn new(tree: &LodTree, settings: LoadersGlSettings) -> LoadersGl {
        let tileset = Tileset::new(tree);
        let mut stated: Vec<f32> = Vec::with_capacity(tileset.tiles().len());
        stated.extend(tileset.tiles().iter().map(|t| if t.is_empty() { 0.0 } else { t.error as f32 }));
        for (id, tile) in tileset.tiles().iter().enumerate().rev() {
            // Children come after their parent: this one is final.
            let beneath = stated[id];
            if let Some(parent) = tileset.tiles().get(tile.parent as usize).filter(|p| p.is_empty()) {
                debug_assert!(parent.subtree_end as usize > id);
                let above = &mut stated[tile.parent as usize];
                *above = above.max(beneath);
            }
        }
        LoadersGl {
            settings,
            visits: vec![Visit::default(); tileset.tiles().len()],
            stated,
            tileset,
            target: settings.error_target_px,
            memory_short: false,
            touches: 0,
            requested: Vec::new(),
            queue: Vec::new(),
            stack: Vec::new(),
            empty_stack: Vec::new(),
            children: Vec::new(),
        }
    }

    fn cache_bytes(&self, state: &ClientState) -> u64 {
        (self.settings.cache_share * state.budget as f64) as u64
    }

    fn plan(&mut self, state: &ClientState, view: &View) {
        let traversal = Traversal {
            tree: state.tree,
            frustum: Frustum::new(view),
            fog: Fog::new(state.tree, view),
            scale: f64::from(view.viewport[1]) / ERROR_DENOMINATOR,
        };
        self.traverse(state, &traversal);

        let mut queue = core::mem::take(&mut self.queue);
        queue.clear();
        for &id in &self.requested {
            self.tileset.enqueue(state, id, (0, self.priority(id), id), &mut queue);
        }
        let (frame, cache) = (self.tileset.frame(), self.cache_bytes(state));
        let LoadersGl { visits, tileset, settings, .. } = self;
        let unused = |id: u32| {
            let visit = &visits[id as usize];
            (visit.touched != frame).then_some(visit.last_use)
        };
        tileset.unload_down_to(state, cache, unused);
        let mut slots = settings.max_requests.saturating_sub(tileset.pending().len());
        let blocked = tileset.request(state, &mut queue, &mut slots, unused);
        self.memory_short = blocked.is_some_and(|rep| tileset.bytes_with(state, rep, unused) > state.budget);
        self.queue = queue;
        self.adjust_target(cache, self.tileset.loaded_bytes());
    }

    /// `adjustScreenSpaceError`.
    fn adjust_target(&mut self, cache: u64, loaded: u64) {
        if loaded < cache {
            self.target = (self.target / TARGET_STEP).max(self.settings.error_target_px);
        } else if self.memory_short {
            self.target = (self.target * TARGET_STEP).min(TARGET_MAX_PX);
        }
    }

    /// P of a tile that was seen in this frame, as its parent was.
    fn priority(&self, id: u32) -> u64 {
        let visit = &self.visits[id as usize];
        let above = self.visits.get(self.tileset.tile(id).parent as usize).unwrap_or(visit);
        let root = self.visits[0].stated_error;
        let reversed = if root > 0.0 { ((root - above.stated_error) / root).clamp(0.0, 1.0) } else { 0.0 };
        let digits = |share: f64| libm::floor(9999.0 * share) as u64;
        let penalty = if visit.progressive { 0 } else { 100_000_000 };
        penalty + 10_000 * digits(visit.foveated) + digits(reversed)
    }

    fn traverse(&mut self, state: &ClientState, traversal: &Traversal) {
        self.requested.clear();
        self.touches = 0;
        self.see(traversal, 0);
        self.stack.clear();
        self.stack.push(0);
        while let Some(id) = self.stack.pop() {
            if self.tileset.has_children(id) && self.visits[id as usize].error > self.target {
                self.expand(state, traversal, id);
            }
            self.load(state, id);
            self.touch(traversal, id);
        }
    }

    /// `updateVisibility`: what the view makes of the tile, once per frame.
    fn see(&mut self, traversal: &Traversal, id: u32) {
        let frame = self.tileset.frame();
        if self.visits[id as usize].seen == frame {
            return;
        }
        let tile = *self.tileset.tile(id);
        let parent = self.visits.get(tile.parent as usize).filter(|v| v.seen == frame);
        let (inside, parent_coarse) = parent.map_or((false, false), |v| (v.all_inside, v.coarse));
        let sight = Sight::of(traversal.tree, &traversal.frustum, tile.node, inside);
        let distance = sight.distance.max(DISTANCE_MIN);
        let relief = traversal.fog.relief_px(distance);
        let on_screen = |error: f64, share: f64| {
            if error == 0.0 { 0.0 } else { share * error * traversal.scale / distance - relief }
        };
        let visit = &mut self.visits[id as usize];
        visit.seen = frame;
        visit.all_inside = sight.side == Side::Inside;
        visit.visible = sight.side != Side::Outside;
        visit.error = on_screen(tile.error, 1.0);
        visit.stated_error = on_screen(f64::from(self.stated[id as usize]), 1.0);
        visit.coarse = on_screen(tile.error, PROGRESSIVE_HEIGHT) > self.target;
        visit.progressive = visit.coarse || parent_coarse;
        visit.distance = sight.distance;
        visit.depth_in_view = traversal.frustum.forward.dot(sight.to_centre);
        visit.foveated = foveated_factor(&traversal.frustum, &sight);
    }

    /// `updateAndPushChildren`.
    fn expand(&mut self, state: &ClientState, traversal: &Traversal, id: u32) {
        let mut children = core::mem::take(&mut self.children);
        children.clear();
        children.extend(self.tileset.children(id));
        for &child in &children {
            self.see(traversal, child);
        }
        children.sort_by(|&a, &b| {
            let (a, b) = (&self.visits[a as usize], &self.visits[b as usize]);
            let by_distance = b.distance.total_cmp(&a.distance);
            if a.distance == 0.0 { by_distance.then(b.depth_in_view.total_cmp(&a.depth_in_view)) } else { by_distance }
        });
        let has_content = !self.tileset.tile(id).is_empty();
        for &child in &children {
            if self.visits[child as usize].visible {
                self.stack.push(child);
            } else if has_content {
                self.load(state, child);
                self.touch(traversal, child);
            }
            if !has_content {
                continue;
            }
            if self.tileset.tile(child).is_empty() {
                self.load_beneath_empty(state, traversal, child);
            } else if self.tileset.has_failed(child) || !self.tileset.is_loaded(state, child) {
                break;
            }
        }
        self.children = children;
    }

    /// `executeEmptyTraversal`: down to the nearest tiles with content, what is out of view is loaded too. As shipped, an
    /// empty child does not hold up its siblings, whatever is missing beneath it.
    fn load_beneath_empty(&mut self, state: &ClientState, traversal: &Traversal, top: u32) {
        self.empty_stack.clear();
        self.empty_stack.push(top);
        while let Some(id) = self.empty_stack.pop() {
            self.see(traversal, id);
            if !self.visits[id as usize].visible {
                self.load(state, id);
                self.touch(traversal, id);
            }
            if self.tileset.tile(id).is_empty() {
                self.empty_stack.extend(self.tileset.children(id));
            }
        }
    }

    fn load(&mut self, state: &ClientState, id: u32) {
        let frame = self.tileset.frame();
        if self.visits[id as usize].requested != frame && self.tileset.is_missing(state, id) {
            self.visits[id as usize].requested = frame;
            self.requested.push(id);
        }
    }

    /// `touchTile`: the last of several in a frame counts.
    fn touch(&mut self, traversal: &Traversal, id: u32) {
        let frame = self.tileset.frame();
        // Each goes before what this frame has touched already.
        self.touches += 1;
        let visit = &mut self.visits[id as usize];
        visit.last_use = (frame, -self.touches);
        if core::mem::replace(&mut visit.touched, frame) != frame {
            self.tileset.keep_prerequisites(traversal.tree, id);
        }
    }
}

impl Policy for LoadersGl {
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

    fn completed(&mut self, state: &ClientState, rep: RepId, _now: Time) {
        // Behind everything that the last frame touched.
        self.touches += 1;
        let tile = self.tileset.tile_of(rep) as usize;
        self.visits[tile].last_use = (self.tileset.frame(), self.touches);
        self.adjust_target(self.cache_bytes(state), self.tileset.loaded_now(state));
    }

    fn failed(&mut self, _state: &ClientState, rep: RepId, _now: Time) {
        self.tileset.fail(rep);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn what_lies_behind_is_not_central() {
        let view = View { position: DVec3::ZERO, orientation: glam::DQuat::IDENTITY, fov_y: 1.0, viewport: [100, 100] };
        let frustum = Frustum::new(&view);
        let factor = |to_centre: DVec3| {
            let sight = Sight { to_centre, half: DVec3::splat(1.0), distance: 1.0, side: Side::Outside };
            foveated_factor(&frustum, &sight)
        };
        assert_eq!(factor(DVec3::new(0.0, 1.0, -9.0)), 0.0);
        assert_eq!(factor(DVec3::new(0.0, 0.0, 9.0)), 1.0);
        // The sphere of radius √3 comes within 10 − √3 of the ray at 20 m: 1 − 20/√(20² + (10 − √3)²).
        let beside = 10.0 - 3f64.sqrt();
        let expected = 1.0 - 20.0 / (400.0 + beside * beside).sqrt();
        assert!((factor(DVec3::new(10.0, 0.0, -20.0)) - expected).abs() < 1e-12);
    }
}
