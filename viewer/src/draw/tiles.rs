//! Which of an orthoview's 4 × 4 tiles the view can show at all (\[HIBR\] §6.1).

use super::list::Item;
use foresight_scheduler::benefit::frustum::{Frustum, Side};
use foresight_scheduler::lod_tree::Aabb;

/// Tiles of an orthoview: 4 × 4, by the bit of [`Item::tiles`].
pub const TILES: usize = 16;

/// An item's tiles without those that are empty, out of view, or all inside a box that it leaves out. `boxes` bounds each
/// tile's splats, [`Aabb::EMPTY`] where it has none.
pub fn tiles_in_view(frustum: &Frustum, item: &Item, boxes: &[Aabb; TILES]) -> u16 {
    let mut tiles = item.tiles;
    for (tile, bounds) in boxes.iter().enumerate() {
        let (centre, half) = (bounds.centre() - frustum.eye, 0.5 * (bounds.max - bounds.min));
        let inside = |hidden: &Aabb| bounds.min.cmpgt(hidden.min).all() && bounds.max.cmplt(hidden.max).all();
        let is_out = bounds.is_empty() || frustum.side(centre, half) == Side::Outside;
        if is_out || item.hidden.iter().any(inside) {
            tiles &= !(1 << tile);
        }
    }
    tiles
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::list::ALL_TILES;
    use foresight_scheduler::lod_tree::RepId;
    use foresight_scheduler::view::View;
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
        let frustum = Frustum::new(&view);
        let seen = |behind: f64, hidden: Vec<Aabb>| {
            let item = Item { rep: RepId(0), hidden, behind: 0.0, tiles: ALL_TILES, false_colour: None };
            tiles_in_view(&frustum, &item, &boxes(behind))
        };
        assert_eq!(seen(0.0, Vec::new()), ALL_TILES & !(1 << 5));
        assert_eq!(seen(100.0, Vec::new()), 0);
        // At 10 m the pyramid shows the four in the middle only, one of which is empty.
        assert_eq!(seen(10.0, Vec::new()), 1 << 6 | 1 << 9 | 1 << 10);
        let left_out = Aabb { min: DVec3::new(-21.0, -21.0, -30.0), max: DVec3::new(-9.0, -9.0, 0.0) };
        assert_eq!(seen(0.0, vec![left_out]), ALL_TILES & !(1 << 5 | 1));
    }
}
