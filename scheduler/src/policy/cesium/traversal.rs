//! Which tiles a frame touches and requests: the base traversal, over flat arrays and without recursion.

use super::Cesium;
use crate::benefit::frustum::{Frustum, Side};
use crate::lod_tree::LodTree;
use crate::policy::tileset::Sight;
use crate::policy::tileset::fog::Fog;
use crate::state::ClientState;
use crate::view::View;

/// Least distance that an error is divided by, metres.
const DISTANCE_MIN: f64 = 1e-7;

/// What is known of a tile. Frame numbers instead of flags: nothing has to be reset.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Visit {
    /// Frame in which what the view makes of it was last computed.
    seen: u32,
    pub(super) touched: u32,
    requested: u32,
    visible: bool,
    /// The whole box lies in the frustum.
    all_inside: bool,
    /// The error at the reduced height is above the target.
    coarse: bool,
    /// So is it, or the parent's.
    pub(super) progressive: bool,
    /// It was the most central among its siblings.
    most_central: bool,
    /// The tile whose `foveated` and `distance` stand for its own.
    pub(super) holder: u32,
    /// Pixels.
    error: f64,
    /// Metres; lessened by what it holds for its children.
    pub(super) distance: f64,
    /// Metres along the view to the middle.
    depth_in_view: f64,
    /// As `distance`.
    pub(super) foveated: f64,
    /// Frame, and place within it, of the last use: the order of the cache.
    pub(super) last_use: (u32, i64),
}

/// The least and the greatest of something.
#[derive(Clone, Copy, Debug)]
pub(super) struct Range {
    low: f64,
    high: f64,
}

impl Range {
    const EMPTY: Range = Range { low: f64::INFINITY, high: f64::NEG_INFINITY };

    fn add(&mut self, value: f64) {
        self.low = self.low.min(value);
        self.high = self.high.max(value);
    }

    /// Where `value` lies between them, from 0 to less than 1.
    pub(super) fn share(&self, value: f64) -> f64 {
        let width = self.high - self.low;
        if width > 0.0 { (((value - self.low) / width).clamp(0.0, 1.0) - 1e-7).max(0.0) } else { 0.0 }
    }
}

/// Of the tiles updated in a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ranges {
    pub(super) level: Range,
    pub(super) distance: Range,
    pub(super) foveated: Range,
}

impl Default for Ranges {
    fn default() -> Ranges {
        Ranges { level: Range::EMPTY, distance: Range::EMPTY, foveated: Range::EMPTY }
    }
}

/// What one frame's traversal goes by.
pub(super) struct View3d<'t> {
    tree: &'t LodTree,
    frustum: Frustum,
    fog: Fog,
    /// Metres that the eye moves per frame.
    movement: f64,
}

impl<'t> View3d<'t> {
    pub(super) fn new(tree: &'t LodTree, view: &View, movement: f64) -> View3d<'t> {
        View3d { tree, frustum: Frustum::new(view), fog: Fog::new(tree, view), movement }
    }
}

/// Angular distance of a sphere from the view's line, both ways: 1 − |cos| of the angle to its nearest point.
fn foveated_factor(frustum: &Frustum, sight: &Sight) -> f64 {
    let radius = sight.half.length();
    let to_line = frustum.forward * frustum.forward.dot(sight.to_centre) - sight.to_centre;
    let away = to_line.length();
    if away <= radius {
        return 0.0;
    }
    let nearest = sight.to_centre + to_line * (radius / away);
    1.0 - frustum.forward.dot(nearest.normalize_or(frustum.forward)).abs().min(1.0)
}

impl Cesium {
    /// `selectTiles`: lists what is requested, and touches what is used.
    pub(super) fn traverse(&mut self, state: &ClientState, view: &View3d) {
        self.requested.clear();
        self.ranges = Ranges::default();
        self.touches = 0;
        self.update(view, 0);
        if !self.visits[0].visible {
            return;
        }
        self.stack.clear();
        self.stack.push(0);
        while let Some(id) = self.stack.pop() {
            if self.tileset.has_children(id) && self.visits[id as usize].error > self.target {
                self.expand(state, view, id);
            }
            self.load(state, view, id);
            self.touch(view, id);
        }
    }

    /// `updateVisibility`: what the view makes of the tile, once per frame.
    fn see(&mut self, view: &View3d, id: u32) {
        let frame = self.tileset.frame();
        if self.visits[id as usize].seen == frame {
            return;
        }
        let tile = *self.tileset.tile(id);
        let parent = self.visits.get(tile.parent as usize).filter(|v| v.seen == frame);
        let (inside, parent_coarse) = parent.map_or((false, false), |v| (v.all_inside, v.coarse));
        let sight = Sight::of(view.tree, &view.frustum, tile.node, inside);
        let distance = sight.distance.max(DISTANCE_MIN);
        let (error, reduced) = if tile.error == 0.0 {
            (0.0, 0.0)
        } else {
            let full = tile.error * view.frustum.pixels_per_radian / distance;
            let relief = view.fog.relief_px(distance);
            (full - relief, full * self.settings.progressive_height - relief)
        };
        let visit = &mut self.visits[id as usize];
        visit.seen = frame;
        visit.all_inside = sight.side == Side::Inside;
        visit.visible = sight.side != Side::Outside;
        visit.error = error;
        visit.coarse = reduced > self.target;
        visit.progressive = visit.coarse || parent_coarse;
        visit.distance = sight.distance;
        visit.depth_in_view = view.frustum.forward.dot(sight.to_centre);
        visit.foveated = foveated_factor(&view.frustum, &sight);
    }

    /// `updateTile`.
    fn update(&mut self, view: &View3d, id: u32) {
        self.see(view, id);
        let within = self.visits[id as usize].visible && self.children_within[id as usize];
        if within && self.tileset.has_children(id) {
            let end = self.tileset.tile(id).subtree_end;
            let (mut child, mut any) = (id + 1, false);
            while child < end {
                self.see(view, child);
                any |= self.visits[child as usize].visible;
                child = self.tileset.tile(child).subtree_end;
            }
            self.visits[id as usize].visible = any;
        }
        let visit = &mut self.visits[id as usize];
        (visit.most_central, visit.holder) = (false, id);
        self.ranges.level.add(f64::from(self.tileset.tile(id).level));
        self.ranges.distance.add(visit.distance);
        self.ranges.foveated.add(visit.foveated);
    }

    /// `updateAndPushChildren`.
    fn expand(&mut self, state: &ClientState, view: &View3d, id: u32) {
        let mut children = core::mem::take(&mut self.children);
        children.clear();
        children.extend(self.tileset.children(id));
        for &child in &children {
            self.update(view, child);
        }
        // The nearest is visited first: it is pushed last.
        children.sort_by(|&a, &b| {
            let (a, b) = (&self.visits[a as usize], &self.visits[b as usize]);
            let depth = if a.distance == 0.0 {
                b.depth_in_view.total_cmp(&a.depth_in_view)
            } else {
                core::cmp::Ordering::Equal
            };
            b.distance.total_cmp(&a.distance).then(depth)
        });
        let has_content = !self.tileset.tile(id).is_empty();
        let mut most_central: Option<u32> = None;
        for &child in &children {
            let visit = &self.visits[child as usize];
            let (visible, foveated) = (visit.visible, visit.foveated);
            if (visible || has_content) && most_central.is_none_or(|c| foveated < self.visits[c as usize].foveated) {
                most_central = Some(child);
            }
            if visible {
                self.stack.push(child);
            } else if has_content {
                self.load(state, view, child);
                self.touch(view, child);
            }
            if has_content && self.tileset.tile(child).is_empty() {
                self.load_beneath_empty(state, view, child);
            }
        }
        if let Some(most_central) = most_central {
            self.lend(id, most_central, &children);
        }
        self.children = children;
    }

    /// The most central child's place goes to the tile that holds it for all the children.
    fn lend(&mut self, id: u32, most_central: u32, children: &[u32]) {
        let child = &mut self.visits[most_central as usize];
        child.most_central = true;
        let (foveated, distance) = (child.foveated, child.distance);
        let visit = &self.visits[id as usize];
        let passes_on = (visit.most_central || id == 0) && foveated <= self.visits[visit.holder as usize].foveated;
        let holder = if passes_on { visit.holder } else { id };
        let held = &mut self.visits[holder as usize];
        held.foveated = held.foveated.min(foveated);
        held.distance = held.distance.min(distance);
        for &child in children {
            self.visits[child as usize].holder = holder;
        }
    }

    /// `executeEmptyTraversal`: down to the nearest tiles with content, what is out of view is loaded too.
    fn load_beneath_empty(&mut self, state: &ClientState, view: &View3d, top: u32) {
        self.empty_stack.clear();
        self.empty_stack.push(top);
        while let Some(id) = self.empty_stack.pop() {
            self.update(view, id);
            if !self.visits[id as usize].visible {
                self.load(state, view, id);
                self.touch(view, id);
            }
            if self.tileset.tile(id).is_empty() {
                self.empty_stack.extend(self.tileset.children(id));
            }
        }
    }

    /// `loadTile`: requests the tile if it is missing and stays in view long enough.
    fn load(&mut self, state: &ClientState, view: &View3d, id: u32) {
        let frame = self.tileset.frame();
        if self.visits[id as usize].requested == frame || !self.tileset.is_missing(state, id) {
            return;
        }
        let diameter = (2.0 * view.tree.half(self.tileset.tile(id).node).length()).max(1.0);
        if self.settings.moving_multiplier * view.movement / diameter < 1.0 {
            self.visits[id as usize].requested = frame;
            self.requested.push(id);
        }
    }

    /// `touchTile`.
    fn touch(&mut self, view: &View3d, id: u32) {
        let frame = self.tileset.frame();
        let visit = &mut self.visits[id as usize];
        if visit.touched != frame {
            visit.touched = frame;
            // Each goes before what this frame has touched already.
            self.touches += 1;
            visit.last_use = (frame, -self.touches);
            self.tileset.keep_prerequisites(view.tree, id);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn what_lies_straight_behind_is_central() {
        let view = View { position: DVec3::ZERO, orientation: glam::DQuat::IDENTITY, fov_y: 1.0, viewport: [100, 100] };
        let frustum = Frustum::new(&view);
        let factor = |to_centre: DVec3| {
            let sight = Sight { to_centre, half: DVec3::splat(1.0), distance: 1.0, side: Side::Outside };
            foveated_factor(&frustum, &sight)
        };
        assert_eq!(factor(DVec3::new(0.0, 1.0, -9.0)), 0.0);
        assert_eq!(factor(DVec3::new(0.0, 0.0, 9.0)), 0.0);
        // The sphere of radius √3 comes within 10 − √3 of the line at 20 m: 1 − 20/√(20² + (10 − √3)²).
        let beside = 10.0 - 3f64.sqrt();
        let expected = 1.0 - 20.0 / (400.0 + beside * beside).sqrt();
        assert!((factor(DVec3::new(10.0, 0.0, -20.0)) - expected).abs() < 1e-12);
        assert!((factor(DVec3::new(10.0, 0.0, 20.0)) - expected).abs() < 1e-12);
    }

    #[test]
    fn shares_stay_below_one_and_a_single_value_has_none() {
        let mut range = Range::EMPTY;
        range.add(3.0);
        assert_eq!(range.share(3.0), 0.0);
        range.add(7.0);
        assert_eq!((range.share(3.0), range.share(5.0), range.share(7.0)), (0.0, 0.5 - 1e-7, 1.0 - 1e-7));
    }
}
