//! Which neighbouring pixels show one surface (\[HIBR\] §4.2): the depth, the normal and the sphericality test, closed in
//! blocks of 2 × 2; a pixel with more than four such neighbours is connected, and is drawn as a disc.
//!
//! With p̂ the unit vector between two pixels' points, two are of one surface if |d₁ − d₂| < τ₁, |n̂₁·p̂| < τ₂ and
//! |n̂₂·p̂| < τ₂, and n̂₁′·n̂₂ > τ₃, n̂₁′ being n̂₁ mirrored in the plane halfway between them. The paper prints < τ₃; on a
//! sphere that product is 1, so that > is meant.

use super::image::{Lattice, Orthoview};
use glam::{DVec2, DVec3, I64Vec2};

/// The tests' thresholds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thresholds {
    /// τ₁ in sides of a pixel: depths grow with the pixels from level to level.
    pub depth: f64,
    /// τ₂: sine of the largest angle between a surface and the line to the neighbour.
    pub normal: f64,
    /// τ₃.
    pub sphericality: f64,
}

impl Default for Thresholds {
    /// Four sides: a surface at 76° from its normal still holds together. 0.7: 44°. 0.7: mirrored normals within 46°.
    fn default() -> Thresholds {
        Thresholds { depth: 4.0, normal: 0.7, sphericality: 0.7 }
    }
}

/// To the eight neighbours, in this order, as bits: right, up, up-left, up-right, and the four opposite ones.
const NEIGHBOURS: [(i64, i64); 8] = [(1, 0), (0, 1), (-1, 1), (1, 1), (-1, 0), (0, -1), (1, -1), (-1, -1)];

/// What six bits beside a depth say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Links(u8);

impl Links {
    const PRESENT: u8 = 0b10_0000;
    const CONNECTED: u8 = 0b01_0000;

    /// Something is shown.
    pub fn is_present(self) -> bool {
        self.0 & Self::PRESENT != 0
    }

    /// More than four neighbours are of the same surface.
    pub fn is_connected(self) -> bool {
        self.0 & Self::CONNECTED != 0
    }

    /// Of one surface with the neighbour to the right, above, above left, above right; the others have it on their side.
    pub fn forward(self) -> [bool; 4] {
        std::array::from_fn(|i| self.0 >> i & 1 == 1)
    }

    /// The six bits: from the lowest four links, connected, present.
    pub fn bits(self) -> u8 {
        self.0
    }

    /// From six bits; the upper two are not looked at.
    pub fn from_bits(bits: u8) -> Links {
        Links(bits & 0b11_1111)
    }
}

/// The links of every pixel, row by row.
pub fn links(view: &Orthoview, lattice: &Lattice, thresholds: &Thresholds) -> Vec<Links> {
    let rect = view.rect;
    let side = lattice.pitch * (1u64 << view.level) as f64;
    // Relative to the image's own corner: differences of positions far from the origin would lose their digits.
    let local = Lattice { origin: DVec3::ZERO, ..*lattice };
    let frame = local.frame();
    let width = rect.width();
    let points: Vec<DVec3> = view
        .pixels
        .iter()
        .enumerate()
        .map(|(index, pixel)| {
            let at = DVec2::new((index % width) as f64, (index / width) as f64) * (side / lattice.pitch);
            frame.unproject(at.extend(f64::from(pixel.depth)))
        })
        .collect();
    let related = |here: usize, there: usize| {
        let (a, b) = (&view.pixels[here], &view.pixels[there]);
        if !(a.is_some() && b.is_some()) {
            return false;
        }
        // The cheapest of the tests first: it parts most of what is parted.
        if f64::from((a.depth - b.depth).abs()) >= thresholds.depth * side {
            return false;
        }
        let between = (points[there] - points[here]).normalize_or_zero();
        let normal = |n: [f32; 3]| DVec3::from_array(n.map(f64::from));
        let (n1, n2) = (normal(a.normal), normal(b.normal));
        let mirrored = n1 - 2.0 * n1.dot(between) * between;
        n1.dot(between).abs() < thresholds.normal
            && n2.dot(between).abs() < thresholds.normal
            && mirrored.dot(n2) > thresholds.sphericality
    };
    let mut mask = vec![0u8; view.pixels.len()];
    let neighbour = |index: usize, (x, y): (i64, i64)| rect.index(rect.at(index) + I64Vec2::new(x, y));
    let mut join = |here: usize, there: usize, towards: usize| {
        mask[here] |= 1 << towards;
        mask[there] |= 1 << ((towards + 4) % 8);
    };
    for here in 0..view.pixels.len() {
        for (towards, &step) in NEIGHBOURS.iter().enumerate().take(4) {
            if let Some(there) = neighbour(here, step)
                && related(here, there)
            {
                join(here, there, towards);
            }
        }
    }
    close_blocks(&rect, &mut mask);
    mask.iter()
        .zip(&view.pixels)
        .map(|(bits, pixel)| {
            let connected = if bits.count_ones() > 4 { Links::CONNECTED } else { 0 };
            let present = if pixel.is_some() { Links::PRESENT } else { 0 };
            Links(bits & 0b1111 | connected | present)
        })
        .collect()
}

/// In every block of 2 × 2, what is joined by a path of the block's own links becomes joined. All blocks look at the links
/// as the tests left them: the order of blocks does not matter.
fn close_blocks(rect: &super::Rect, mask: &mut [u8]) {
    let tested = mask.to_vec();
    for corner in 0..mask.len() {
        let at = rect.at(corner);
        // 0 1
        // 2 3, upwards; towards: right 0, up 1, up-left 2, up-right 3.
        let places = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| rect.index(at + I64Vec2::new(x, y)));
        let [Some(a), Some(b), Some(c), Some(d)] = places else { continue };
        let pairs =
            [(0, 1, a, b, 0usize), (0, 2, a, c, 1), (0, 3, a, d, 3), (1, 2, b, c, 2), (1, 3, b, d, 1), (2, 3, c, d, 0)];
        let mut group = [0, 1, 2, 3];
        for (i, j, from, _, towards) in pairs {
            if tested[from] >> towards & 1 == 1 {
                let (low, high) = (group[i].min(group[j]), group[i].max(group[j]));
                group.iter_mut().filter(|g| **g == high).for_each(|g| *g = low);
            }
        }
        for (i, j, from, to, towards) in pairs {
            if group[i] == group[j] {
                mask[from] |= 1 << towards;
                mask[to] |= 1 << ((towards + 4) % 8);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::image::{Pixel, Rect};
    use super::*;

    /// A view of 16 × 16 pixels of 1 m from above; `shape` gives height and normal at a pixel's middle.
    fn view(shape: impl Fn(f64, f64) -> Option<(f64, DVec3)>) -> (Orthoview, Lattice) {
        let rect = Rect { min: I64Vec2::splat(-8), max: I64Vec2::splat(8) };
        let lattice = Lattice { direction: super::super::direction::nine()[0], origin: DVec3::ZERO, pitch: 1.0 };
        let [right, up] = lattice.direction.image_axes();
        let pixels = (0..256)
            .map(|index| {
                let at = rect.at(index).as_dvec2() + 0.5;
                let world = right * at.x + up * at.y;
                shape(world.x, world.y).map_or(Pixel::EMPTY, |(height, normal)| {
                    let normal = normal.normalize().to_array().map(|v| v as f32);
                    Pixel { depth: (20.0 - height) as f32, colour: [1.0; 3], normal }
                })
            })
            .collect();
        (Orthoview { level: 0, rect, near: 0.0, range: 20.0, pixels }, lattice)
    }

    fn connected(shape: impl Fn(f64, f64) -> Option<(f64, DVec3)>) -> (usize, usize) {
        let (view, lattice) = view(shape);
        let links = links(&view, &lattice, &Thresholds::default());
        (links.iter().filter(|l| l.is_connected()).count(), links.iter().filter(|l| l.is_present()).count())
    }

    #[test]
    fn a_wall_is_connected_but_for_its_border() {
        // Level, and steep: 14 × 14 pixels have all eight neighbours, those on the border five, the corners three.
        for slope in [0.0, 0.5] {
            let (joined, present) = connected(|x, _| Some((slope * x, DVec3::new(-slope, 0.0, 1.0))));
            assert_eq!((joined, present), (252, 256), "slope {slope}");
        }
    }

    #[test]
    fn a_sphere_is_connected_where_it_faces_the_view() {
        let radius: f64 = 7.0;
        let (joined, present) = connected(|x, y| {
            let z = radius * radius - x * x - y * y;
            (z > 0.0).then(|| (z.sqrt(), DVec3::new(x, y, z.sqrt())))
        });
        assert!(joined * 10 > present * 6 && joined < present, "{joined} of {present}");
    }

    #[test]
    fn foliage_is_not() {
        // Leaves at hashed heights, turned anyhow.
        let hash = |x: f64, y: f64, k: f64| libm::modf(libm::sin(x * 12.9 + y * 78.2 + k) * 43_758.5).0.abs();
        let (joined, present) = connected(|x, y| {
            let turned = DVec3::new(hash(x, y, 1.0) - 0.5, hash(x, y, 2.0) - 0.5, 0.2 + hash(x, y, 3.0));
            Some((12.0 * hash(x, y, 0.0), turned))
        });
        assert!(joined * 20 < present, "{joined} of {present}");
    }

    #[test]
    fn a_step_parts_what_lies_above_from_what_lies_below() {
        let (view, lattice) = view(|x, _| Some((if x > 0.0 { 10.0 } else { 0.0 }, DVec3::Z)));
        let links = links(&view, &lattice, &Thresholds::default());
        for (index, link) in links.iter().enumerate() {
            let depth = |there: Option<usize>| there.map(|i| view.pixels[i].depth);
            for (towards, &(x, y)) in NEIGHBOURS.iter().enumerate().take(4) {
                let there = depth(view.rect.index(view.rect.at(index) + I64Vec2::new(x, y)));
                let same = there == Some(view.pixels[index].depth);
                assert_eq!(link.forward()[towards], same, "{index} {towards}");
            }
            assert_eq!(Links::from_bits(link.bits()), *link);
        }
    }

    #[test]
    fn closing_a_block_joins_what_a_path_joins() {
        let rect = Rect { min: I64Vec2::ZERO, max: I64Vec2::splat(2) };
        // a–b and b–d: then all three are joined to each other, and c to none.
        let mut mask = vec![0b0000_0001, 0b0001_0010, 0, 0b0010_0000];
        close_blocks(&rect, &mut mask);
        assert_eq!(mask, [0b0000_1001, 0b0001_0010, 0, 0b1010_0000]);
    }
}
