//! `weighted-proxy`: the proxy transmission of \[NVE\] §4.8.2.
//!
//! Every request is a stream, a leaf of a distribution tree with two branches (fig. 4.18). Under *high priority* are
//! the lowest levels of what is in view and has not come yet. Everything else is under *normal priority*, which gets
//! bandwidth only when the other branch has none left to send. Within a branch bandwidth is shared by weight; nearer
//! objects weigh more. Normal priority holds the finer levels of what is in view, each after the one before it, and, at
//! very low priority, the lowest levels of what is out of view within the area of interest, a circle about the viewer.
//!
//! Settled here:
//! - An object ↔ a branch of the tree that ends in one representation; its lowest level ↔ the first representation from
//!   the root down, shared by all objects beneath it; the next levels ↔ what follows beneath. A level may be asked for
//!   when the one above it is there or on its way. Directions of an orthoview are one level.
//! - The thesis chooses levels by Pareto fronts and image metrics measured beforehand (§4.5, §5.1). Here an object is
//!   refined until geometric error · pixels per radian / distance ≤ target.
//! - "Higher priority to objects nearby" has no formula: weight = 1 / d, d the distance to the node's box, not less than
//!   the radius of the smallest box in the world, rounded to powers of two. So a level shared by many objects weighs
//!   as the nearest of them does.
//! - A proxy can split the link at will, a client can only choose what to request. Shares are approximated in whole
//!   requests by deficit round robin over the powers of two of the distance: each ring of distance is credited bytes in
//!   proportion to its weight times the number of its streams, and the one whose next request is paid for first gets
//!   the slot; then the nearest stream in it goes. What is in flight shares the link equally.
//! - "Only start after": nothing of normal priority is requested while a high-priority request is in flight. What
//!   is in flight when one turns up is not paused.
//! - "Very low priority" is strict: preloading waits until no stream in view does.
//! - The area of interest has no radius in the thesis: it ends for each object where its box's radius falls below the
//!   target, in pixels.
//! - The number of streams at a time has no limit; requests in flight: 4.
//! - The safe margin of 10 % of the bandwidth is the proxy's, not the client's: it is not held back.
//! - The thesis drops nothing. Here the least recently used goes when room is needed; what is in view, and the lowest
//!   levels within the area of interest, are used. When that is not enough, requests wait for what is on its way, and
//!   when nothing is, what does not fit is passed over. Keeping only as much of what is in view as memory holds,
//!   level after level, was tried: it fetches the same again and again, and is worse.
//! - Where children replace their parent together, siblings out of view are streams like those in view.
//! - A failed request is made again.

use super::downloads::{Asked, Downloads};
use super::tileset::tile::{Tile, tiles_of};
use super::{Policy, Rival};
use crate::benefit::coverage::Refinement;
use crate::benefit::frustum::{Frustum, Side};
use crate::lod_tree::{LodTree, RepId};
use crate::scheduler::Action;
use crate::state::{ClientState, Status};
use crate::units::Time;
use crate::view::View;
use glam::DVec3;

/// How a comparison offers it.
pub const RIVAL: Rival = Rival {
    name: "weighted-proxy",
    about: "lowest levels of what is in view first, then shares of the bandwidth by nearness",
    error_target_px: Some(16.0),
    parallel: 4,
    tells_directions: false,
    build: |tree, settings| {
        let (error_target_px, max_requests) = (settings.error_target_px, settings.parallel);
        Box::new(WeightedProxy::new(tree, WeightedProxySettings { error_target_px, max_requests }))
    },
};

/// What can be set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightedProxySettings {
    /// Error on screen at which refinement stops, pixels.
    pub error_target_px: f64,
    /// Requests in flight at once.
    pub max_requests: usize,
}

impl Default for WeightedProxySettings {
    fn default() -> WeightedProxySettings {
        WeightedProxySettings { error_target_px: 16.0, max_requests: 4 }
    }
}

/// Distances are told apart from 2⁻¹⁰ m to 2³⁰ m.
const NEAREST: i32 = -10;
const RINGS: usize = 41;

/// ⌊log₂ distance⌋, counted from [`NEAREST`].
fn ring(distance: f64) -> u8 {
    // The exponent of a number that is not negative; below the normal numbers it is less than −1022.
    let exponent = (distance.to_bits() >> 52) as i32 - 1023;
    (exponent - NEAREST).clamp(0, RINGS as i32 - 1) as u8
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Branch {
    High,
    Normal,
    Preload,
}

/// A level in view or of interest.
#[derive(Clone, Copy, Debug)]
struct Looked {
    branch: Branch,
    missing: bool,
    /// Metres.
    distance: f64,
    tile: u32,
}

/// A level that is neither there nor on its way.
#[derive(Clone, Copy, Debug)]
struct Stream {
    branch: Branch,
    ring: u8,
    /// Metres.
    distance: f64,
    tile: u32,
}

/// Deficit round robin: bytes credited to each ring and not spent.
#[derive(Clone, Debug)]
struct Shares {
    credit: [f64; RINGS],
}

impl Shares {
    /// The ring that can pay first for its next request, after `(ring, streams, bytes)` of each that has one; credits
    /// all of them until it can. The nearest of those that can at once.
    fn next(&mut self, waiting: &[(u8, usize, u64)]) -> Option<u8> {
        let mut idle = [true; RINGS];
        let weight = |ring: u8, streams: usize| libm::ldexp(streams as f64, -i32::from(ring));
        let mut first: Option<(f64, u8)> = None;
        for &(ring, streams, bytes) in waiting {
            idle[usize::from(ring)] = false;
            let rounds = (bytes as f64 - self.credit[usize::from(ring)]).max(0.0) / weight(ring, streams);
            if first.is_none_or(|(least, _)| rounds < least) {
                first = Some((rounds, ring));
            }
        }
        for (credit, idle) in self.credit.iter_mut().zip(idle) {
            // Who has nothing to send saves nothing up.
            *credit = if idle { 0.0 } else { *credit };
        }
        let (rounds, chosen) = first?;
        for &(ring, streams, _) in waiting {
            self.credit[usize::from(ring)] += rounds * weight(ring, streams);
        }
        Some(chosen)
    }

    fn spend(&mut self, ring: u8, bytes: u64) {
        self.credit[usize::from(ring)] -= bytes as f64;
    }
}

/// The policy.
#[derive(Debug)]
pub struct WeightedProxy {
    settings: WeightedProxySettings,
    tiles: Vec<Tile>,
    contents: Vec<RepId>,
    /// Radius of the smallest box that is not a point, metres.
    smallest: f64,
    looked_at: Vec<Looked>,
    streams: Vec<Stream>,
    /// Shares of the high and of the normal branch.
    shares: [Shares; 2],
    /// High-priority requests that were in flight when last looked at.
    high_in_flight: Vec<RepId>,
    downloads: Downloads,
}

impl WeightedProxy {
    /// A client of `tree`.
    pub fn new(tree: &LodTree, settings: WeightedProxySettings) -> WeightedProxy {
        let (tiles, contents, _) = tiles_of(tree);
        let radii = tiles.iter().map(|tile| tree.half(tile.node).length()).filter(|&r| r > 0.0);
        let smallest = radii.fold(f64::INFINITY, f64::min);
        let shares = Shares { credit: [0.0; RINGS] };
        WeightedProxy {
            settings,
            contents,
            smallest: if smallest.is_finite() { smallest } else { 0.0 },
            looked_at: Vec::new(),
            streams: Vec::new(),
            shares: [shares.clone(), shares],
            high_in_flight: Vec::new(),
            downloads: Downloads::new(tree),
            tiles,
        }
    }

    fn own(&self, tile: &Tile) -> &[RepId] {
        &self.contents[tile.first_content as usize..tile.end_content as usize]
    }

    /// Lists what is in view or of interest, in preorder, and whether it is missing.
    fn look(&mut self, state: &ClientState, view: &View) {
        let (tree, frustum) = (state.tree, Frustum::new(view));
        let target = self.settings.error_target_px;
        let atomic = state.resident().refinement() == Refinement::Atomic;
        self.looked_at.clear();
        let mut next = 0u32;
        while next < self.tiles.len() as u32 {
            let id = next;
            let tile = self.tiles[id as usize];
            let to_centre = tree.centre(tile.node) - frustum.eye;
            let half = tree.half(tile.node);
            let distance = (to_centre.abs() - half).max(DVec3::ZERO).length();
            let in_view = frustum.side(to_centre, half) != Side::Outside;
            let of_interest = in_view
                || (tile.depth <= 1 && half.length() * frustum.pixels_per_radian >= target * distance)
                || (tile.depth > 1 && atomic);
            if !of_interest {
                next = tile.subtree_end;
                continue;
            }
            if tile.is_empty() {
                next = id + 1;
                continue;
            }
            let branch = match (tile.depth == 1, in_view) {
                (true, true) => Branch::High,
                (true, false) => Branch::Preload,
                (false, _) => Branch::Normal,
            };
            let own = self.own(&tile);
            let missing = own.iter().any(|&r| state.status(r) == Status::Absent);
            self.looked_at.push(Looked { branch, missing, distance: distance.max(self.smallest), tile: id });
            let refine = !missing && in_view && tile.error * frustum.pixels_per_radian > target * distance;
            next = if refine { id + 1 } else { tile.subtree_end };
        }
    }

    /// Requests streams of one branch; false if nothing more can be requested in this frame.
    fn serve(&mut self, state: &ClientState, range: core::ops::Range<usize>, branch: Branch) -> bool {
        let mut waiting: Vec<(u8, usize, u64)> = Vec::new();
        // Sorted by ring, then by distance.
        let mut place = [0; RINGS];
        for at in range.clone() {
            let ring = self.streams[at].ring;
            match waiting.last_mut() {
                Some((last, streams, _)) if *last == ring => *streams += 1,
                _ => {
                    place[usize::from(ring)] = at;
                    waiting.push((ring, 1, self.missing_bytes(state, at)));
                }
            }
        }
        while let Some(ring) = self.shares[usize::from(branch != Branch::High)].next(&waiting) {
            let at = place[usize::from(ring)];
            let tile = self.tiles[self.streams[at].tile as usize];
            let bytes = self.missing_bytes(state, at);
            let mut fits = true;
            for content in tile.first_content..tile.end_content {
                let rep = self.contents[content as usize];
                let before = self.downloads.slots();
                match self.downloads.request(state, rep) {
                    Asked::Yes => {}
                    Asked::TooLarge => fits = false,
                    Asked::NoSlot | Asked::Waits => return false,
                }
                if branch == Branch::High && self.downloads.slots() < before {
                    self.high_in_flight.push(rep);
                }
            }
            let shares = &mut self.shares[usize::from(branch != Branch::High)];
            if fits {
                shares.spend(ring, bytes);
            }
            let Some(entry) = waiting.iter().position(|w| w.0 == ring) else { return false };
            place[usize::from(ring)] += 1;
            waiting[entry].1 -= 1;
            if waiting[entry].1 == 0 {
                waiting.remove(entry);
            } else {
                waiting[entry].2 = self.missing_bytes(state, at + 1);
            }
        }
        true
    }

    fn missing_bytes(&self, state: &ClientState, at: usize) -> u64 {
        let tile = &self.tiles[self.streams[at].tile as usize];
        let missing = self.own(tile).iter().filter(|&&r| state.status(r) == Status::Absent);
        missing.map(|&r| state.tree.wire_bytes(r)).sum()
    }

    fn plan(&mut self, state: &ClientState, view: &View) {
        self.look(state, view);
        // Coarse levels last, so that they go last.
        for looked in self.looked_at.iter().rev() {
            let tile = &self.tiles[looked.tile as usize];
            for &rep in &self.contents[tile.first_content as usize..tile.end_content as usize] {
                self.downloads.touch(state, rep);
            }
        }
        self.high_in_flight.retain(|&r| state.status(r) == Status::InFlight);
        if self.downloads.slots() == 0 {
            return;
        }
        self.streams.clear();
        self.streams.extend(self.looked_at.iter().filter(|looked| looked.missing).map(|looked| {
            let Looked { branch, distance, tile, .. } = *looked;
            Stream { branch, ring: ring(distance), distance, tile }
        }));
        self.streams.sort_unstable_by(|a, b| {
            let by_distance = a.distance.total_cmp(&b.distance);
            a.branch.cmp(&b.branch).then(a.ring.cmp(&b.ring)).then(by_distance).then(a.tile.cmp(&b.tile))
        });
        let normal = self.streams.partition_point(|s| s.branch == Branch::High);
        let preload = self.streams.partition_point(|s| s.branch != Branch::Preload);
        if self.serve(state, 0..normal, Branch::High)
            && self.high_in_flight.is_empty()
            && self.serve(state, normal..preload, Branch::Normal)
        {
            self.serve(state, preload..self.streams.len(), Branch::Preload);
        }
    }
}

impl Policy for WeightedProxy {
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
            self.plan(state, view);
        }
        self.downloads.next(state, now)
    }
}
