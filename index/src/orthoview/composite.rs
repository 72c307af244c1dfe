//! From four pixels one, up the tree (\[HIBR\] §4.1, Figure 4): nearest depth; colour and normal averaged over what lies
//! within Δz of it. The same rule brings the leaves' doubled resolution down.

use super::image::{Orthoview, Pixel};
use glam::I64Vec2;

/// Δz in sides of the pixel that is made. A surface seen at 60° from its normal falls by √3 sides over one pixel, so its
/// four quarters still count as one surface.
pub const DELTA_Z: f64 = 2.0;

/// One pixel from up to four. `delta_z` in metres.
pub fn merge(candidates: [Pixel; 4], delta_z: f32) -> Pixel {
    let depth = candidates.iter().map(|p| p.depth).fold(f32::INFINITY, f32::min);
    if depth == f32::INFINITY {
        return Pixel::EMPTY;
    }
    let (mut colour, mut normal, mut count) = ([0.0f32; 3], [0.0f32; 3], 0.0f32);
    let mut nearest = Pixel::EMPTY;
    for pixel in candidates.iter().filter(|p| p.is_some() && p.depth - depth <= delta_z) {
        count += 1.0;
        for axis in 0..3 {
            colour[axis] += pixel.colour[axis];
            normal[axis] += pixel.normal[axis];
        }
        if pixel.depth < nearest.depth {
            nearest = *pixel;
        }
    }
    let length = normal.iter().map(|v| v * v).sum::<f32>().sqrt();
    // Opposite normals cancel: then the nearest one's.
    let normal = if length > 1e-3 * count { normal.map(|v| v / length) } else { nearest.normal };
    Pixel { depth, colour: colour.map(|v| v / count), normal }
}

/// Draws a child over a parent's image of twice the resolution: whatever is nearer stays. `target` has the parent's depths
/// and the child's level; what lies outside of it is left out. Both belong to one lattice.
pub fn overlay(target: &mut Orthoview, child: &Orthoview) {
    let shift = child.near - target.near;
    let (min, max) = (child.rect.min.max(target.rect.min), child.rect.max.min(target.rect.max));
    for y in min.y..max.y {
        let row = |view: &Orthoview| view.rect.index(I64Vec2::new(min.x, y));
        let (Some(from), Some(to)) = (row(child), row(target)) else { continue };
        let width = (max.x - min.x) as usize;
        for (pixel, place) in child.pixels[from..from + width].iter().zip(&mut target.pixels[to..to + width]) {
            if !pixel.is_some() {
                continue;
            }
            let depth = (f64::from(pixel.depth) + shift).max(0.0);
            #[expect(clippy::cast_possible_truncation, reason = "relative to the cell's near end")]
            let moved = Pixel { depth: depth as f32, ..*pixel };
            if moved.depth < place.depth {
                *place = moved;
            }
        }
    }
}

/// An image of the parent's depths at its children's level, to be overlaid and then [`halved`].
pub fn doubled(parent: &Orthoview) -> Orthoview {
    let rect = parent.rect.beneath();
    let level = parent.level.saturating_sub(1);
    Orthoview { level, rect, near: parent.near, range: parent.range, pixels: vec![Pixel::EMPTY; rect.area()] }
}

/// Half the resolution: fills `parent`, whose pixels are `side` metres wide, from an image of twice its resolution.
#[expect(clippy::cast_possible_truncation, reason = "a length in metres, and only a threshold")]
pub fn halved(double: &Orthoview, parent: &mut Orthoview, side: f64) {
    let delta_z = (DELTA_Z * side) as f32;
    let width = parent.rect.width();
    if double.rect == parent.rect.beneath() {
        for (y, row) in parent.pixels.chunks_exact_mut(width).enumerate() {
            let (lower, upper) = double.pixels[4 * width * y..][..4 * width].split_at(2 * width);
            for ((pixel, below), above) in row.iter_mut().zip(lower.chunks_exact(2)).zip(upper.chunks_exact(2)) {
                *pixel = merge([below[0], below[1], above[0], above[1]], delta_z);
            }
        }
        return;
    }
    for index in 0..parent.pixels.len() {
        let corner = parent.rect.at(index) * 2;
        let candidates = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| double.get(corner + I64Vec2::new(x, y)));
        parent.pixels[index] = merge(candidates, delta_z);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixel(depth: f32, grey: f32) -> Pixel {
        Pixel { depth, colour: [grey; 3], normal: [0.0, 0.0, 1.0] }
    }

    #[test]
    fn the_nearest_wins_and_what_is_within_delta_z_is_averaged() {
        let merged = merge([pixel(5.0, 1.0), pixel(5.5, 0.0), pixel(9.0, 0.3), Pixel::EMPTY], 1.0);
        assert_eq!((merged.depth, merged.colour), (5.0, [0.5; 3]));
        assert_eq!(merge([Pixel::EMPTY; 4], 1.0), Pixel::EMPTY);
        let turned = Pixel { normal: [0.0, 0.0, -1.0], ..pixel(1.0, 1.0) };
        let merged = merge([pixel(2.0, 0.0), turned, Pixel::EMPTY, Pixel::EMPTY], 10.0);
        assert_eq!(merged.normal, [0.0, 0.0, -1.0], "opposite normals leave the nearest one's");
    }

    #[test]
    fn averages_over_a_flat_surface_are_exact_up_the_tree() {
        // A chequerboard of 0 and 1 becomes an even ½ after one step, and stays that.
        let double: Vec<Pixel> = (0..64).map(|i| pixel(3.0, ((i % 8 + i / 8) % 2) as f32)).collect();
        for quad in 0..16 {
            let (x, y) = (quad % 4 * 2, quad / 4 * 2);
            let merged = merge([(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| double[(y + j) * 8 + x + i]), 0.1);
            assert_eq!((merged.depth, merged.colour), (3.0, [0.5; 3]));
        }
    }
}
