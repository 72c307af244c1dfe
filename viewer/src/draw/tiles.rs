//! Which of an orthoview's 4 × 4 tiles the view can show at all (\[HIBR\] §6.1).

use super::list::DrawList;
use foresight_scheduler::benefit::frustum::{Frustum, Side};
use foresight_scheduler::lod_tree::{Aabb, RepId};
use foresight_scheduler::view::View;

/// Tiles of an orthoview: 4 × 4, by the bit of [`super::list::Item::tiles`].
pub const TILES: usize = 16;

/// How many tiles there were, and are left.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileCounts {
    /// Of all items, without those in which nothing is.
    pub all: u32,
    /// In the view, and not all in a box that is left out.
    pub kept: u32,
}

/// Takes tiles away that are empty, out of view, or inside a box that their item leaves out; and items without any tile
/// left. `boxes` bounds each tile's splats, [`Aabb::EMPTY`] where it has none; what has no tiles is kept whole.
pub fn cull_tiles(list: &mut DrawList, view: &View, boxes: impl Fn(RepId) -> Option<[Aabb; TILES]>) -> TileCounts {
    let mut counts = TileCounts::default();
    if view.check().is_err() {
        return counts;
    }
    let frustum = Frustum::new(view);
    list.items.retain_mut(|item| {
        let Some(boxes) = boxes(item.rep) else {
            return true;
        };
        let tiles = item.tiles;
        for (tile, bounds) in boxes.iter().enumerate().filter(|(tile, _)| tiles >> tile & 1 == 1) {
            let empty = bounds.is_empty();
            counts.all += u32::from(!empty);
            let (centre, half) = (bounds.centre() - frustum.eye, 0.5 * (bounds.max - bounds.min));
            let inside = |hidden: &Aabb| bounds.min.cmpgt(hidden.min).all() && bounds.max.cmplt(hidden.max).all();
            if empty || frustum.side(centre, half) == Side::Outside || item.hidden.iter().any(inside) {
                item.tiles &= !(1 << tile);
            } else {
                counts.kept += 1;
            }
        }
        item.tiles != 0
    });
    counts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::list::{ALL_TILES, Item};
    use glam::{DQuat, DVec3};

    #[test]
    fn tiles_out_of_view_empty_or_left_out_go() {
        let view = View {
            position: DVec3::ZERO,
            orientation: DQuat::IDENTITY,
            fov_y: core::f64::consts::FRAC_PI_2,
            viewport: [100, 100],
        };
        // Tiles of 10 m in a wall 20 m ahead, from −20 to 20 m; the pyramid is 20 m wide there, so all are seen.
        let boxes = |behind: f64| {
            let corner =
                |tile: usize| DVec3::new((tile % 4) as f64, (tile / 4) as f64, 0.0) * 10.0 - DVec3::splat(20.0);
            let mut boxes: [Aabb; TILES] = core::array::from_fn(|tile| {
                let min = corner(tile) + DVec3::Z * behind;
                Aabb { min, max: min + DVec3::new(10.0, 10.0, 1.0) }
            });
            boxes[5] = Aabb::EMPTY;
            boxes
        };
        let item = |hidden: Vec<Aabb>| Item { rep: RepId(0), hidden, tiles: ALL_TILES, false_colour: None };
        let culled = |behind: f64, hidden: Vec<Aabb>| {
            let mut list = DrawList { items: vec![item(hidden)] };
            let counts = cull_tiles(&mut list, &view, |_| Some(boxes(behind)));
            (list.items.first().map_or(0, |item| item.tiles), counts)
        };
        assert_eq!(culled(0.0, Vec::new()), (ALL_TILES & !(1 << 5), TileCounts { all: 15, kept: 15 }));
        assert_eq!(culled(100.0, Vec::new()), (0, TileCounts { all: 15, kept: 0 }));
        // At 10 m the pyramid shows the four in the middle only, one of which is empty.
        assert_eq!(culled(10.0, Vec::new()).0, 1 << 6 | 1 << 9 | 1 << 10);
        let left_out = Aabb { min: DVec3::new(-21.0, -21.0, -30.0), max: DVec3::new(-9.0, -9.0, 0.0) };
        assert_eq!(culled(0.0, vec![left_out]).0, ALL_TILES & !(1 << 5 | 1));
        let mut whole = DrawList { items: vec![item(Vec::new())] };
        assert_eq!(cull_tiles(&mut whole, &view, |_| None), TileCounts::default());
        assert_eq!(whole.items.len(), 1);
    }
}
