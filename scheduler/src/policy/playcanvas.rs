//! `playcanvas`: streamed splats of the PlayCanvas engine, 2.22 (`lodMode = error`), read from `gsplat-unified/`
//! `gsplat-lod-table.js`, `gsplat-budget-balancer.js`, `gsplat-octree-instance.js`, `gsplat-world.js`, `gsplat-octree.js`
//! and from `gsplat-asset-loader.js`.
//!
//! Every tenth frame, if the camera has moved more than 1 m or turned more than 90°, the field of view has changed by
//! more than 2 %, or something has been loaded:
//! 1. *Balance* a budget of splats. Every node starts at its coarsest level. A step to the next finer one is worth
//!    coverage · (error removed / splats added); coverage = (r / (r + d'))², r the radius of the sphere about the
//!    node's box, d' = d · f · min(tan(fov_x/2), tan(fov_y/2)) / tan 22.5°, d the distance to the box, and f = 1 + 2t for
//!    a nearest point behind the camera, −t being the cosine of its direction against the view's (`lodBehindPenalty` = 3).
//!    Levels that are not better than a cheaper one are left out. Error per splat is that of the best run which the
//!    step opens: max over all levels still to come. Steps are taken in the order of 512 buckets, spaced
//!    logarithmically over 10⁻²⁴ to 10³, first come first in each, until one does not fit. A node's next step is in no
//!    better bucket than the one before it.
//! 2. *Show* of each node the finest level loaded that is not finer than chosen, else the coarsest
//!    (`lodUnderfillLimit` = 10); what was shown before stays until that is loaded.
//! 3. *Queue* for each node, in the order of the tree, the level one step finer than the one shown, behind what is
//!    queued already: all nodes go up together.
//!
//! In every frame: 2 downloads at once; what no node shows or awaits is unloaded 100 frames later (`cooldownTicks`).
//! After a failure a file is asked for twice more, then no more. Nothing on its way is aborted. View direction counts by f alone.
//!
//! Settled here:
//! - Splats ↔ decoded bytes. The engine budgets what is drawn and has no limit for what is loaded. Half of the memory
//!   is the budget of splats; the rest is for what is loaded and not drawn: parts of files that other nodes show finer,
//!   levels cooling down, and what is on its way.
//! - A node ↔ a tile, its coarser level ↔ its part of the nearest tile above, a file shared with its siblings: part by
//!   surface. So a step adds decoded bytes minus that part, and every leaf has the levels above it as its own.
//! - Error ↔ geometric error ÷ r: the tool that writes streamed splats measures them relative to the node.
//! - The best run is looked for 16 levels down; the error of several tiles is their mean by surface.
//! - `lodBehindPenalty`, `lodUpdateAngle` and `lodUnderfillLimit` are those of the engine's streaming examples. Its
//!   defaults, 1, 0 and 0, show nothing of a node until its chosen level has come. `lodUnderfillLimit` does not bind
//!   here, however deep the tree.
//! - What is no longer wanted leaves the queue at the next balance; as shipped, a level queued as the next step stays
//!   there, and delays the others.
//! - Memory cannot be overdrawn: what cools down goes before the request, if that makes room. If not, the queue waits
//!   for what is on its way, and when nothing is, passes over what does not fit, and what is finer than chosen is no
//!   longer kept until its replacement comes.
//! - Where children replace their parent together, nothing differs: the engine draws node by node.
//! - `lodFalloff` is not followed. From 2.23 on the default is another mode, `distance`, which ignores the errors.

use super::downloads::{Asked, Downloads};
use super::tileset::tile::{Tile, shown_beneath, tiles_of};
use super::{Policy, Rival};
use crate::lod_tree::{LodTree, RepId};
use crate::scheduler::Action;
use crate::state::{ClientState, Status};
use crate::units::Time;
use crate::view::View;
use core::cmp::Reverse;
use glam::DVec3;
use std::collections::BinaryHeap;

/// How a comparison offers it.
pub const RIVAL: Rival = Rival {
    name: "playcanvas",
    about: "streamed splats: coverage · error removed / splats added, greedily to a budget",
    error_target_px: None,
    parallel: 2,
    tells_directions: false,
    build: |tree, settings| {
        Box::new(PlayCanvas::new(tree, PlayCanvasSettings { max_loads: settings.parallel, ..Default::default() }))
    },
};

/// What can be set; the default is what the engine's streaming examples set, and its own defaults else.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlayCanvasSettings {
    /// `maxConcurrentLoads`.
    pub max_loads: usize,
    /// Share of the memory budget that may be drawn.
    pub splat_share: f64,
    /// Frames between balances.
    pub frames: u32,
    /// `lodUpdateDistance`, metres.
    pub update_distance_m: f64,
    /// `lodUpdateAngle`, radians.
    pub update_angle: f64,
    /// `lodBehindPenalty`.
    pub behind_penalty: f64,
    /// `cooldownTicks`.
    pub cooldown_frames: u32,
    /// Failures after which a file is not asked for again: one more than `maxRetries`.
    pub failures_max: u8,
}

impl Default for PlayCanvasSettings {
    fn default() -> PlayCanvasSettings {
        PlayCanvasSettings {
            max_loads: 2,
            splat_share: 0.5,
            frames: 10,
            update_distance_m: 1.0,
            update_angle: core::f64::consts::FRAC_PI_2,
            behind_penalty: 3.0,
            cooldown_frames: 100,
            failures_max: 3,
        }
    }
}

/// tan 22.5°, half of the field of view at which distances are not scaled.
const REFERENCE_TAN: f64 = core::f64::consts::SQRT_2 - 1.0;
const BUCKETS: u32 = 512;
/// Levels below a tile among which the best run is looked for.
const REACH: usize = 16;
const NONE: u32 = u32::MAX;

/// A step from a tile's part of the tile above to the tile itself.
#[derive(Clone, Copy, Debug)]
struct Step {
    /// Nearest tile above that is a level; [`NONE`] at a coarsest level.
    above: u32,
    /// Not worse than what is above, and not empty.
    level: bool,
    /// Bytes drawn more.
    cost: f64,
    /// Error removed per byte, of the best run.
    ratio: f64,
    /// Number of levels with this one as `above`.
    below: u32,
}

/// What is beneath a tile at one depth.
#[derive(Clone, Copy, Debug, Default)]
struct Cut {
    bytes: f64,
    surface: f64,
    /// Σ surface · error.
    error: f64,
}

fn bytes_of(tree: &LodTree, tile: &Tile, contents: &[RepId]) -> f64 {
    let own = &contents[tile.first_content as usize..tile.end_content as usize];
    own.iter().map(|&r| tree.decoded_bytes(r)).sum::<u64>() as f64
}

/// The steps of all tiles, from what does not depend on the view.
fn steps(tree: &LodTree, tiles: &[Tile], contents: &[RepId]) -> Vec<Step> {
    let mut steps: Vec<Step> = Vec::with_capacity(tiles.len());
    for tile in tiles {
        let above = match steps.get(tile.parent as usize) {
            Some(parent) if parent.level => tile.parent,
            Some(parent) => parent.above,
            None => NONE,
        };
        let level = !tile.is_empty() && !tile.unconditional;
        steps.push(Step { above, level, cost: bytes_of(tree, tile, contents), ratio: 0.0, below: 0 });
    }
    let surface = |tile: &Tile| tree.face_areas(tile.node).element_sum();
    let mut cuts: Vec<Vec<Cut>> = vec![Vec::new(); tiles.len()];
    for id in (0..tiles.len()).rev().filter(|&id| tiles[id].parent < id as u32) {
        let Step { above, level, cost: bytes, .. } = steps[id];
        if !level {
            continue;
        }
        let tile = &tiles[id];
        let own_surface = surface(tile).max(f64::MIN_POSITIVE);
        let mut cut = core::mem::take(&mut cuts[id]);
        cut.insert(0, Cut { bytes, surface: own_surface, error: own_surface * tile.error });
        cut.truncate(REACH);
        let Some(parent) = tiles.get(above as usize) else { continue };
        let part = (own_surface / surface(parent).max(own_surface)) * bytes_of(tree, parent, contents);
        let radius = tree.half(tile.node).length().max(f64::MIN_POSITIVE);
        let ratio = |c: &Cut| (parent.error - c.error / c.surface) / radius / (c.bytes - part).max(1.0);
        steps[id].ratio = cut.iter().map(ratio).fold(0.0, f64::max);
        steps[id].cost = bytes - part;
        steps[above as usize].below += 1;
        let sums = &mut cuts[above as usize];
        // A branch that ends stays as it is further down.
        while sums.len() < cut.len() {
            sums.push(sums.last().copied().unwrap_or_default());
        }
        for (depth, sum) in sums.iter_mut().enumerate() {
            let c = cut[depth.min(cut.len() - 1)];
            sum.bytes += c.bytes;
            sum.surface += c.surface;
            sum.error += c.error;
        }
    }
    steps
}

/// Rises with the value: the bit pattern of a positive single-precision number, scaled to 10⁻²⁴ … 10³.
fn bucket(value: f64) -> u32 {
    let (low, high) = (1e-24f32.to_bits(), 1e3f32.to_bits());
    let key = (value as f32).max(0.0).to_bits().clamp(low, high);
    (u64::from(key - low) * u64::from(BUCKETS - 1) / u64::from(high - low)) as u32
}

/// Camera at the latest balance.
#[derive(Clone, Copy, Debug)]
struct Balanced {
    position: DVec3,
    forward: DVec3,
    fov_y: f64,
}

/// The policy.
#[derive(Debug)]
pub struct PlayCanvas {
    settings: PlayCanvasSettings,
    tiles: Vec<Tile>,
    contents: Vec<RepId>,
    tile_of: Vec<u32>,
    steps: Vec<Step>,
    /// Per tile, whether levels beneath it show all of it.
    shown_beneath: Vec<bool>,
    /// Coarsest levels, in preorder.
    starts: Vec<u32>,
    /// Bytes of those.
    start_bytes: f64,
    balanced: Option<Balanced>,
    balances: u32,
    /// Per tile, the balance in which it was last chosen.
    chosen_in: Vec<u32>,
    /// Per chosen tile, how many of its steps are shown by what is loaded.
    covered: Vec<u32>,
    /// Chosen tiles in preorder.
    chosen: Vec<u32>,
    /// What is shown or awaited.
    in_use: Vec<RepId>,
    /// First come, first served.
    queue: Vec<RepId>,
    /// Per representation, the balance which wants it and has not found it in the queue.
    wanted_in: Vec<u32>,
    heap: BinaryHeap<(u32, Reverse<u32>, u32)>,
    failures: Vec<u8>,
    something_loaded: bool,
    /// Nothing could be requested although nothing was on its way.
    stuck: bool,
    downloads: Downloads,
}

impl PlayCanvas {
    /// A client of `tree`.
    pub fn new(tree: &LodTree, settings: PlayCanvasSettings) -> PlayCanvas {
        let (tiles, contents, tile_of) = tiles_of(tree);
        let steps = steps(tree, &tiles, &contents);
        let starts: Vec<u32> = (0..tiles.len() as u32)
            .filter(|&id| steps[id as usize].level && steps[id as usize].above == NONE)
            .collect();
        PlayCanvas {
            settings,
            shown_beneath: shown_beneath(&tiles, |t| !t.is_empty() && !t.unconditional),
            start_bytes: starts.iter().map(|&id| bytes_of(tree, &tiles[id as usize], &contents)).sum(),
            starts,
            balanced: None,
            balances: 0,
            chosen_in: vec![0; tiles.len()],
            covered: vec![0; tiles.len()],
            chosen: Vec::new(),
            in_use: Vec::new(),
            queue: Vec::new(),
            wanted_in: vec![0; tree.representations()],
            heap: BinaryHeap::new(),
            failures: vec![0; tree.representations()],
            something_loaded: false,
            stuck: false,
            downloads: Downloads::new(tree),
            tiles,
            contents,
            tile_of,
            steps,
        }
    }

    /// Puts the steps that begin at tile `id` into the heap, in no better bucket than `limit`.
    fn offer_steps(&mut self, tree: &LodTree, view: &View, id: u32, limit: u32, order: &mut u32) {
        let tan_y = libm::tan(0.5 * view.fov_y);
        let tan_x = tan_y * f64::from(view.viewport[0]) / f64::from(view.viewport[1]);
        let scale = tan_x.min(tan_y) / REFERENCE_TAN;
        let forward = view.forward();
        let mut next = id + 1;
        let end = self.tiles[id as usize].subtree_end;
        while next < end {
            let tile = &self.tiles[next as usize];
            let step = self.steps[next as usize];
            if !step.level {
                next += 1;
                continue;
            }
            let half = tree.half(tile.node);
            let to_centre = tree.centre(tile.node) - view.position;
            let nearest = to_centre - to_centre.clamp(-half, half);
            let distance = nearest.length();
            let mut penalty = 1.0;
            if distance > 0.01 {
                let behind = (-forward.dot(nearest) / distance).max(0.0);
                penalty += behind * (self.settings.behind_penalty - 1.0);
            }
            let radius = half.length();
            let projected = radius / (radius + distance * penalty * scale).max(1e-12);
            let coverage = (projected * projected).max(1e-12);
            let place = bucket(coverage * step.ratio).min(limit);
            self.heap.push((place, Reverse(*order), next));
            *order += 1;
            next = tile.subtree_end;
        }
    }

    /// Chooses a level for every node.
    fn balance(&mut self, state: &ClientState, view: &View) {
        self.balances += 1;
        self.heap.clear();
        self.chosen.clear();
        let budget = self.settings.splat_share * state.budget as f64;
        let mut spent = self.start_bytes;
        let mut order = 0;
        for place in 0..self.starts.len() {
            let id = self.starts[place];
            self.choose(id);
            if spent < budget {
                self.offer_steps(state.tree, view, id, BUCKETS, &mut order);
            }
        }
        while let Some((place, _, id)) = self.heap.pop() {
            spent += self.steps[id as usize].cost;
            if spent > budget {
                break;
            }
            self.choose(id);
            self.offer_steps(state.tree, view, id, place, &mut order);
        }
        self.chosen.sort_unstable();
    }

    fn choose(&mut self, id: u32) {
        self.chosen_in[id as usize] = self.balances;
        self.covered[id as usize] = 0;
        self.chosen.push(id);
    }

    fn own(&self, id: u32) -> &[RepId] {
        let tile = &self.tiles[id as usize];
        &self.contents[tile.first_content as usize..tile.end_content as usize]
    }

    fn is_loaded(&self, state: &ClientState, id: u32) -> bool {
        self.own(id).iter().all(|&r| state.status(r) == Status::Resident)
    }

    /// What of the chosen is shown and what is to be loaded next.
    fn apply(&mut self, state: &ClientState) {
        self.in_use.clear();
        let mut wanted: Vec<RepId> = Vec::new();
        // Children come after their parents: from the end, a tile's steps are counted before it is looked at.
        for place in (0..self.chosen.len()).rev() {
            let id = self.chosen[place];
            let step = self.steps[id as usize];
            let finer = self.shown_beneath[id as usize] && self.covered[id as usize] == step.below;
            let loaded = self.is_loaded(state, id);
            if let (true, Some(covered)) = (loaded || finer, self.covered.get_mut(step.above as usize)) {
                *covered += 1;
            }
            if finer {
                continue;
            }
            let begins = step.above == NONE || self.is_loaded(state, step.above);
            if !loaded && !begins {
                continue;
            }
            let tile = self.tiles[id as usize];
            for at in tile.first_content..tile.end_content {
                let rep = self.contents[at as usize];
                self.in_use.push(rep);
                if state.status(rep) == Status::Absent {
                    wanted.push(rep);
                    self.wanted_in[rep.index()] = self.balances;
                }
            }
        }
        // First come, first served: what was queued before keeps its place.
        self.queue.retain(|r| self.wanted_in[r.index()] == self.balances);
        for &rep in &self.queue {
            self.wanted_in[rep.index()] = 0;
        }
        let new = wanted.iter().rev().filter(|r| self.wanted_in[r.index()] != 0);
        self.queue.extend(new);
        if self.stuck {
            return;
        }
        for &rep in self.downloads.held() {
            let mut id = self.tile_of[rep.index()];
            if self.chosen_in[id as usize] == self.balances {
                continue;
            }
            while id != NONE && self.chosen_in[id as usize] != self.balances {
                id = self.steps[id as usize].above;
            }
            if id != NONE && !self.is_loaded(state, id) {
                self.in_use.push(rep);
            }
        }
    }

    fn is_due(&mut self, view: &View) -> bool {
        if !(self.downloads.frame() - 1).is_multiple_of(self.settings.frames.max(1)) {
            return false;
        }
        let loaded = core::mem::take(&mut self.something_loaded);
        let Some(last) = self.balanced else { return true };
        let angle = libm::acos(last.forward.dot(view.forward()).clamp(-1.0, 1.0));
        loaded
            || self.stuck
            || last.position.distance(view.position) > self.settings.update_distance_m
            || angle > self.settings.update_angle
            || (view.fov_y - last.fov_y).abs() > 0.02 * last.fov_y
    }

    fn plan(&mut self, state: &ClientState, view: &View) {
        if self.is_due(view) {
            self.balance(state, view);
            self.apply(state);
            self.balanced = Some(Balanced { position: view.position, forward: view.forward(), fov_y: view.fov_y });
        }
        for &rep in &self.in_use {
            self.downloads.touch(state, rep);
        }
        self.downloads.discard_unused(state, self.settings.cooldown_frames);
        let mut too_large = false;
        for &rep in self.queue.iter().filter(|r| self.failures[r.index()] < self.settings.failures_max) {
            match self.downloads.request(state, rep) {
                Asked::Yes => {}
                Asked::TooLarge => too_large = true,
                Asked::NoSlot | Asked::Waits => break,
            }
        }
        self.stuck = too_large && self.downloads.is_idle();
    }
}

impl Policy for PlayCanvas {
    fn name(&self) -> &str {
        RIVAL.name
    }

    fn observe(&mut self, _state: &ClientState, _view: &View, now: Time) {
        self.downloads.frame_seen(now);
    }

    fn decide(&mut self, state: &ClientState, now: Time) -> Action {
        if self.downloads.begin(state, self.settings.max_loads)
            && let Some(view) = &state.view
        {
            self.plan(state, view);
        }
        self.downloads.next(state, now)
    }

    fn completed(&mut self, _state: &ClientState, _rep: RepId, _now: Time) {
        self.something_loaded = true;
    }

    fn failed(&mut self, _state: &ClientState, rep: RepId, _now: Time) {
        let failures = &mut self.failures[rep.index()];
        *failures = failures.saturating_add(1);
    }
}
