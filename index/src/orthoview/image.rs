//! Where an orthoview's pixels are in the world, and what they hold.

use super::Direction;
use foresight_scheduler::lod_tree::Aabb;
use glam::{DVec3, I64Vec2};

/// The lattice of a direction: image coordinates are pixels of the leaves' level, from the octree's origin on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// From the content to the eye.
    pub direction: Direction,
    /// Image coordinate 0, metres.
    pub origin: DVec3,
    /// Side of a pixel of the leaves' level, metres.
    pub pitch: f64,
}

/// Pixels of a lattice at some level: from `min` to before `max`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rect {
    /// First column and row.
    pub min: I64Vec2,
    /// After the last.
    pub max: I64Vec2,
}

impl Rect {
    /// Columns.
    pub fn width(&self) -> usize {
        usize::try_from(self.max.x - self.min.x).unwrap_or_default()
    }

    /// Rows.
    pub fn height(&self) -> usize {
        usize::try_from(self.max.y - self.min.y).unwrap_or_default()
    }

    /// Pixels.
    pub fn area(&self) -> usize {
        self.width() * self.height()
    }

    /// The pixels one level up that cover this.
    pub fn above(&self) -> Rect {
        Rect { min: self.min.map(|v| v.div_euclid(2)), max: self.max.map(|v| (v + 1).div_euclid(2)) }
    }

    /// The pixels one level down that this covers.
    pub fn beneath(&self) -> Rect {
        Rect { min: self.min * 2, max: self.max * 2 }
    }

    /// Place of a pixel in row-major order; `None` outside.
    pub fn index(&self, at: I64Vec2) -> Option<usize> {
        let inside = at.cmpge(self.min).all() && at.cmplt(self.max).all();
        let from = at - self.min;
        inside.then(|| from.y as usize * self.width() + from.x as usize)
    }

    /// The pixel at a place in row-major order.
    pub fn at(&self, index: usize) -> I64Vec2 {
        let width = self.width().max(1);
        self.min + I64Vec2::new((index % width) as i64, (index / width) as i64)
    }
}

/// A lattice with its axes worked out, for many points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    right: DVec3,
    up: DVec3,
    towards_eye: DVec3,
    origin: DVec3,
    pitch: f64,
}

impl Frame {
    /// As [`Lattice::project`].
    pub fn project(&self, point: DVec3) -> DVec3 {
        let from = point - self.origin;
        DVec3::new(from.dot(self.right) / self.pitch, from.dot(self.up) / self.pitch, -from.dot(self.towards_eye))
    }

    /// As [`Lattice::unproject`].
    pub fn unproject(&self, at: DVec3) -> DVec3 {
        let (x, y) = (at.x * self.pitch, at.y * self.pitch);
        self.origin + self.right * x + self.up * y - self.towards_eye * at.z
    }
}

impl Lattice {
    /// Its axes, worked out once.
    pub fn frame(&self) -> Frame {
        let [right, up] = self.direction.image_axes();
        Frame { right, up, towards_eye: self.direction.towards_eye(), origin: self.origin, pitch: self.pitch }
    }

    /// Image coordinates in pixels of `pitch`, and the depth: metres along the view from the plane through the origin,
    /// growing away from the eye.
    pub fn project(&self, point: DVec3) -> DVec3 {
        self.frame().project(point)
    }

    /// The point at image coordinates and a depth, as [`Lattice::project`] gives them.
    pub fn unproject(&self, at: DVec3) -> DVec3 {
        self.frame().unproject(at)
    }

    /// The pixels of a level that a box can touch, and the range of its depths, metres. Rows grow upwards.
    #[expect(clippy::cast_possible_truncation, reason = "a box within the octree: some 2⁴⁰ pixels at most")]
    pub fn footprint(&self, bounds: &Aabb, level: u32) -> (Rect, [f64; 2]) {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for corner in 0..8 {
            let pick = |axis: usize| if corner >> axis & 1 == 1 { bounds.max[axis] } else { bounds.min[axis] };
            let at = self.project(DVec3::new(pick(0), pick(1), pick(2)));
            low = low.min(at);
            high = high.max(at);
        }
        let scale = 1.0 / (1u64 << level) as f64;
        // A corner on a pixel's edge, off by rounding, adds no column.
        let first = |v: f64| (v * scale + 1e-6).floor() as i64;
        let last = |v: f64| (v * scale - 1e-6).ceil() as i64;
        let min = I64Vec2::new(first(low.x), first(low.y));
        let max = I64Vec2::new(last(high.x), last(high.y)).max(min + 1);
        (Rect { min, max }, [low.z, high.z])
    }
}

/// What a pixel shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pixel {
    /// Metres along the view, as [`Lattice::project`] has it; infinite where there is nothing.
    pub depth: f32,
    /// Linear light, 0 to 1 (IEC 61966-2-1 primaries), unlit.
    pub colour: [f32; 3],
    /// Unit normal in the world, turned towards the eye.
    pub normal: [f32; 3],
}

impl Pixel {
    /// Nothing.
    pub const EMPTY: Pixel = Pixel { depth: f32::INFINITY, colour: [0.0; 3], normal: [0.0; 3] };

    /// Whether there is something.
    pub fn is_some(&self) -> bool {
        self.depth < f32::INFINITY
    }
}

/// A cell's image. Depths are relative to `near`, so that they keep their precision far from the origin.
#[derive(Clone, Debug, PartialEq)]
pub struct Orthoview {
    /// Level of the pixels, and of the cell.
    pub level: u32,
    /// Where it lies.
    pub rect: Rect,
    /// Least depth of the cell, metres; the pixels' depths begin there.
    pub near: f64,
    /// Depth of the cell from `near` to its far end, metres.
    pub range: f64,
    /// Row by row, upwards.
    pub pixels: Vec<Pixel>,
}

impl Orthoview {
    /// An empty image of a cell.
    pub fn empty(lattice: &Lattice, bounds: &Aabb, level: u32) -> Orthoview {
        let (rect, [near, far]) = lattice.footprint(bounds, level);
        Orthoview { level, rect, near, range: far - near, pixels: vec![Pixel::EMPTY; rect.area()] }
    }

    /// Whether nothing is in it.
    pub fn is_empty(&self) -> bool {
        !self.pixels.iter().any(Pixel::is_some)
    }

    /// The pixel there; empty outside.
    pub fn get(&self, at: I64Vec2) -> Pixel {
        self.rect.index(at).map_or(Pixel::EMPTY, |index| self.pixels[index])
    }

    /// Bytes of the pixels.
    pub fn heap_bytes(&self) -> usize {
        self.pixels.capacity() * size_of::<Pixel>()
    }

    /// Where the middle of a pixel lies in the world; `None` if it is empty.
    pub fn position(&self, lattice: &Lattice, index: usize) -> Option<DVec3> {
        let pixel = self.pixels.get(index).filter(|p| p.is_some())?;
        let at = (self.rect.at(index).as_dvec2() + 0.5) * (1u64 << self.level) as f64;
        Some(lattice.unproject(at.extend(self.near + f64::from(pixel.depth))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_return_from_the_image_and_footprints_hold_their_boxes() {
        for direction in Direction::all() {
            let lattice = Lattice { direction, origin: DVec3::new(6.4e6, -3.0, 100.0), pitch: 0.25 };
            let bounds = Aabb { min: lattice.origin + 8.0, max: lattice.origin + DVec3::new(16.0, 16.0, 12.0) };
            let point = lattice.origin + DVec3::new(9.0, 15.5, 10.0);
            let at = lattice.project(point);
            assert!((lattice.unproject(at) - point).length() < 1e-8);
            for level in 0..4 {
                let (rect, [near, far]) = lattice.footprint(&bounds, level);
                let pixel = I64Vec2::new(
                    (at.x / f64::from(1 << level)).floor() as i64,
                    (at.y / f64::from(1 << level)).floor() as i64,
                );
                assert!(rect.index(pixel).is_some(), "{direction:?} {level}");
                assert!(near <= at.z && at.z <= far);
                let index = rect.index(pixel).expect("inside");
                assert_eq!(rect.at(index), pixel);
            }
        }
    }

    #[test]
    fn leaves_of_a_power_of_two_meet_on_whole_pixels() {
        // Seen from above, a leaf of 8 m at 0.25 m is 32 by 32 pixels, and no row is shared with its neighbour.
        let lattice = Lattice { direction: super::super::direction::nine()[0], origin: DVec3::ZERO, pitch: 0.25 };
        let leaf = |x: f64| Aabb { min: DVec3::new(x, 0.0, 0.0), max: DVec3::new(x + 8.0, 8.0, 8.0) };
        let (first, _) = lattice.footprint(&leaf(0.0), 0);
        let (second, _) = lattice.footprint(&leaf(8.0), 0);
        assert_eq!((first.width(), first.height(), first.area()), (32, 32, 1024));
        assert!(
            first.max.x == second.min.x
                || first.min.x == second.max.x
                || first.max.y == second.min.y
                || first.min.y == second.max.y
        );
        let odd = Rect { min: I64Vec2::new(-3, 1), max: I64Vec2::new(2, 4) };
        assert_eq!(odd.above(), Rect { min: I64Vec2::new(-2, 0), max: I64Vec2::new(1, 2) });
        assert_eq!(odd.index(I64Vec2::new(2, 1)), None);
    }
}
