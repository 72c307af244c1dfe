//! The error of a surface S that stands for originals O: how far a point of either is from the other at most (the
//! two-sided Hausdorff distance), but what S leaves out altogether counts for no more than its own diameter ∅,
//!
//! ```text
//! max( max_{o∈O} min(∅(o), min_{s∈S} |o − s|), max_{s∈S} min_{o∈O} |o − s| )
//! ```
//!
//! A viewer misses a house by the size of the house, however far the next surface is. Bracketed by branch and bound:
//! A piece of a triangle with corners v is nowhere farther from the other surface than max |v − T| for any one of its
//! triangles T, because the distance to a convex set is convex; and nowhere farther than the distance of its centroid plus
//! its radius. The piece with the largest bound is halved until no bound exceeds the largest distance found by
//! more than the tolerance (Guthe, Borodin & Klein 2005; Tang, Lee & Kim 2009).

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::DVec3;
use rstar::{AABB, PointDistance, RTree, RTreeObject};

use super::triangle::closest;
use super::{Original, Triangle};

/// Relative tolerance of the bracket.
const RELATIVE: f64 = 0.05;
/// Absolute tolerance as a share of the originals' extent: about a pixel where they fill a screen.
const PIXEL: f64 = 1e-3;
/// Pieces that are looked at beyond one for each triangle, at most; then the bracket stays as wide as it is.
const EXTRA_PIECES: usize = 10_000;

/// A distance that is known to lie in an interval, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bracket {
    pub(crate) lower: f64,
    pub(crate) upper: f64,
    /// True if it is no wider than the tolerance.
    pub(crate) is_tight: bool,
}

/// The largest upper bound that is near enough to a lower one, given the absolute tolerance.
fn allowed(lower: f64, absolute: f64) -> f64 {
    (lower * (1.0 + RELATIVE)).max(lower + absolute)
}

/// The error of a surface that stands for the originals. `None` if either has no triangle.
pub(crate) fn error(surface: &[Triangle], originals: &[Original]) -> Option<Bracket> {
    if surface.is_empty() || originals.is_empty() {
        return None;
    }
    let corners = || originals.iter().flat_map(|original| original.corners);
    let (min, max) = (corners().reduce(DVec3::min)?, corners().reduce(DVec3::max)?);
    let absolute = PIXEL * (max - min).length();
    let there = RTree::bulk_load(surface.iter().copied().map(Indexed).collect());
    let there = farthest(originals.iter().copied(), &there, 0.0, absolute);
    let back = RTree::bulk_load(originals.iter().map(|original| Indexed(original.corners)).collect());
    let surface = surface.iter().map(|&corners| Original { corners, whole: f64::INFINITY });
    // What is found the other way counts only if it is farther.
    let back = farthest(surface, &back, there.0, absolute);
    let (lower, upper) = (there.0.max(back.0), there.1.max(back.1));
    Some(Bracket { lower, upper, is_tight: upper <= allowed(lower, absolute) })
}

/// A triangle in the index.
struct Indexed(Triangle);

impl RTreeObject for Indexed {
    type Envelope = AABB<[f64; 3]>;

    fn envelope(&self) -> AABB<[f64; 3]> {
        let [a, b, c] = self.0;
        AABB::from_corners(a.min(b).min(c).to_array(), a.max(b).max(c).to_array())
    }
}

impl PointDistance for Indexed {
    fn distance_2(&self, point: &[f64; 3]) -> f64 {
        let point = DVec3::from_array(*point);
        (closest(&self.0, point) - point).length_squared()
    }
}

/// A piece of a triangle, ordered by how far it may be from the other surface, then by age.
struct Piece {
    upper: f64,
    age: usize,
    part: Original,
}

impl PartialEq for Piece {
    fn eq(&self, other: &Piece) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Piece {}

impl PartialOrd for Piece {
    fn partial_cmp(&self, other: &Piece) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Piece {
    fn cmp(&self, other: &Piece) -> Ordering {
        self.upper.total_cmp(&other.upper).then(other.age.cmp(&self.age))
    }
}

/// A lower and an upper bound of the largest distance of a point of `parts` from the other surface, or of its diameter if
/// that is less; no less than `known`.
fn farthest(parts: impl Iterator<Item = Original>, other: &RTree<Indexed>, known: f64, absolute: f64) -> (f64, f64) {
    let allowed = |lower: f64| allowed(lower, absolute);
    let mut lower = known;
    let look = |&Original { corners, whole }: &Original, lower: &mut f64| -> f64 {
        let [a, b, c] = corners;
        let centroid = (a + b + c) / 3.0;
        let Some((nearest, square)) = other.nearest_neighbor_with_distance_2(centroid.to_array()) else {
            return *lower;
        };
        let here = square.sqrt();
        *lower = lower.max(here.min(whole));
        let radius = corners.iter().map(|&corner| (corner - centroid).length()).fold(0.0, f64::max);
        let reach = |corner: DVec3| (closest(&nearest.0, corner) - corner).length();
        let far = corners.iter().copied().max_by(|&one, &two| reach(one).total_cmp(&reach(two))).unwrap_or(centroid);
        let upper = reach(far).min(here + radius).max(here).min(whole);
        if upper > allowed(*lower) {
            // Extremes are often corners.
            if let Some((_, square)) = other.nearest_neighbor_with_distance_2(far.to_array()) {
                *lower = lower.max(square.sqrt().min(whole));
            }
        }
        upper
    };
    // The largest bound among pieces that need no halving.
    let mut settled = 0.0_f64;
    let mut pieces = BinaryHeap::new();
    let mut made = 0;
    for part in parts {
        let upper = look(&part, &mut lower);
        if upper > allowed(lower) {
            pieces.push(Piece { upper, age: made, part });
            made += 1;
        } else {
            settled = settled.max(upper);
        }
    }
    for _ in 0..EXTRA_PIECES / 2 {
        if pieces.peek().is_none_or(|piece| piece.upper <= allowed(lower)) {
            break;
        }
        let Some(Piece { upper: bound, part: Original { corners: [a, b, c], whole }, .. }) = pieces.pop() else {
            break;
        };
        let (ab, bc, ca) = ((b - a).length_squared(), (c - b).length_squared(), (a - c).length_squared());
        let [a, b, c] = if ab >= bc && ab >= ca {
            [a, b, c]
        } else if bc >= ca {
            [b, c, a]
        } else {
            [c, a, b]
        };
        let middle = 0.5 * (a + b);
        for corners in [[a, middle, c], [middle, b, c]] {
            let part = Original { corners, whole };
            let upper = look(&part, &mut lower).min(bound);
            if upper > allowed(lower) {
                pieces.push(Piece { upper, age: made, part });
                made += 1;
            } else {
                settled = settled.max(upper);
            }
        }
    }
    let left = pieces.peek().map_or(0.0, |piece| piece.upper);
    (lower, lower.max(settled).max(left))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn square(z: f64, side: f64, cells: u32) -> Vec<Triangle> {
        let step = side / f64::from(cells);
        let at = |x: u32, y: u32| DVec3::new(f64::from(x) * step, f64::from(y) * step, z);
        let cell = |x: u32, y: u32| {
            let corners = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            [[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]]
        };
        (0..cells).flat_map(|y| (0..cells).flat_map(move |x| cell(x, y))).collect()
    }

    fn between(surface: &[Triangle], originals: &[Triangle]) -> Option<Bracket> {
        let whole = f64::INFINITY;
        error(surface, &originals.iter().map(|&corners| Original { corners, whole }).collect::<Vec<_>>())
    }

    fn assert_holds(bracket: Bracket, distance: f64) {
        assert!(bracket.lower <= distance + 1e-9 && distance <= bracket.upper + 1e-9, "{bracket:?} {distance}");
        assert!(bracket.is_tight, "{bracket:?}");
    }

    #[test]
    fn known_distances() {
        // Parallel planes, differently triangulated.
        assert_holds(between(&square(0.0, 10.0, 1), &square(3.0, 10.0, 7)).unwrap(), 3.0);
        // A smaller square within a larger one: the larger one's far corner is 5·√2 away, only that way.
        assert_holds(between(&square(0.0, 5.0, 3), &square(0.0, 10.0, 2)).unwrap(), 5.0 * 2.0_f64.sqrt());
        // The same surface cut otherwise.
        assert_holds(between(&square(0.0, 10.0, 1), &square(0.0, 10.0, 2)).unwrap(), 0.0);
        // A spike of 4 m over the middle of a flat square.
        let apex = DVec3::new(5.0, 5.0, 4.0);
        let corners = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]].map(|[x, y]| DVec3::new(x, y, 0.0));
        let spike: Vec<Triangle> = (0..4).map(|at| [corners[at], corners[(at + 1) % 4], apex]).collect();
        assert_holds(between(&spike, &square(0.0, 10.0, 1)).unwrap(), 4.0);
        assert_eq!(between(&[], &spike), None);
        // A house 500 m away that is left out: its diameter.
        let mut town: Vec<Original> =
            square(0.0, 10.0, 2).into_iter().map(|corners| Original { corners, whole: 15.0 }).collect();
        let away = DVec3::new(500.0, 0.0, 0.0);
        town.extend(spike.iter().map(|corners| Original { corners: corners.map(|c| c + away), whole: 11.0 }));
        assert_holds(error(&square(0.0, 10.0, 1), &town).unwrap(), 11.0);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn brackets_hold_for_random_surfaces(points in prop::collection::vec(prop::array::uniform3(-10.0..10.0f64), 6..30)) {
            let points: Vec<DVec3> = points.into_iter().map(DVec3::from_array).collect();
            let triangles: Vec<Triangle> = points.chunks_exact(3).map(|corners| [corners[0], corners[1], corners[2]]).collect();
            let (a, b) = triangles.split_at(1);
            let bracket = between(a, b).unwrap();
            prop_assert!(bracket.is_tight);
            // No sampled point is farther than the upper bound, none that the lower bound stands for is missing.
            let mut sampled = 0.0_f64;
            for (from, to) in [(a, b), (b, a)] {
                for &[p, q, r] in from {
                    for step in 0..=20_u32 {
                        for other in 0..=20 - step {
                            let (s, t) = (f64::from(step) / 20.0, f64::from(other) / 20.0);
                            let point = p + (q - p) * s + (r - p) * t;
                            let near = to.iter().map(|triangle| (closest(triangle, point) - point).length());
                            sampled = sampled.max(near.fold(f64::INFINITY, f64::min));
                        }
                    }
                }
            }
            prop_assert!(sampled <= bracket.upper + 1e-9, "{} {:?}", sampled, bracket);
            // Samples lie at most 1/20 of the longest edge, 35 m, apart.
            prop_assert!(bracket.lower <= sampled + 1.8, "{} {:?}", sampled, bracket);
        }
    }
}
