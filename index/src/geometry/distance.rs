//! The error of a level S that stands for originals O: how far a point of either is from the other at most (the two-sided
//! Hausdorff distance), but what S leaves out altogether counts for no more than the diameter ∅ of the connected part
//! that it belongs to,
//!
//! ```text
//! max( max_{o∈O} min(∅(o), min_{s∈S} |o − s|), max_{s∈S} min_{o∈O} |o − s| )
//! ```
//!
//! The upper bound is rigorous up to the rounding of 64-bit arithmetic, whatever the search leaves undone: a piece of a
//! triangle is nowhere farther from the other surface than its farthest corner is from any one triangle of it, because the
//! distance to a convex set is convex; nor than its centroid's distance and its radius together. Pieces are cut, the one with
//! the largest bound first, until no bound exceeds the largest distance found by more than the tolerance (Guthe, Borodin &
//! Klein 2005; Tang, Lee & Kim 2009): across the sides of the triangle that they are nearest to, so that two triangulations of one
//! plane are settled by as many pieces as they overlap in, else in halves. Most triangles are settled by the triangle that
//! settled the one before.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::nearest::Nearest;
use crate::mesh::Triangle;
use crate::mesh::triangle::closest;

/// Relative tolerance of the bracket.
const RELATIVE: f64 = 0.05;
/// Pieces that are looked at beyond one for each triangle, at most: so many, and so many for each triangle of either
/// surface; then the bracket stays as wide as it is.
const EXTRA_PIECES: usize = 20_000;
const EXTRA_PIECES_EACH: usize = 4;
/// Triangles that are looked at first, for a distance that settles others.
const FIRST: usize = 512;
/// Nodes that a search visits at most, and all together for each triangle of either surface.
const VISITS: u64 = 1024;
const VISITS_EACH: u64 = 128;

/// A distance that is known to lie in an interval, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bracket {
    /// It is no less.
    pub lower: f64,
    /// It is no more.
    pub upper: f64,
}

/// A surface with what leaving out each of its triangles costs at most, by the triangles' numbers, metres.
pub(super) struct Surface<'a> {
    pub(super) tree: &'a Nearest,
    pub(super) wholes: Option<&'a [f64]>,
}

/// The error of `level` for `originals`, to within 5 % or `absolute` metres where the work allows it. `None` if either is empty.
pub(super) fn error(level: &Surface<'_>, originals: &Surface<'_>, absolute: f64) -> Option<Bracket> {
    if level.tree.len() == 0 || originals.tree.len() == 0 {
        return None;
    }
    let there = Way::new(level.tree, 0.0, absolute, originals.tree.len()).farthest(originals);
    // What is found the other way counts only if it is farther.
    let back = Way::new(originals.tree, there.lower, absolute, level.tree.len()).farthest(level);
    Some(Bracket { lower: there.lower.max(back.lower), upper: there.upper.max(back.upper) })
}

/// A piece of a triangle, ordered by how far it may be from the other surface, then by age.
struct Piece {
    upper: f64,
    age: usize,
    corners: Triangle,
    whole: f64,
    /// Place of the triangle that is nearest to its centroid, as far as is known.
    near: u32,
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

/// From one surface to another.
struct Way<'a> {
    other: &'a Nearest,
    absolute: f64,
    /// Largest distance found.
    lower: f64,
    /// Largest bound among pieces that need no cutting.
    settled: f64,
    /// Place of the triangle that was the last to be nearest.
    hint: u32,
    /// Pieces that may be made.
    extra: usize,
    /// Nodes that may yet be visited.
    visits: u64,
}

impl Way<'_> {
    fn new(other: &Nearest, known: f64, absolute: f64, parts: usize) -> Way<'_> {
        let extra = EXTRA_PIECES + EXTRA_PIECES_EACH * (parts + other.len());
        Way {
            other,
            absolute,
            lower: known,
            settled: 0.0,
            hint: 0,
            extra,
            visits: VISITS_EACH * (parts + other.len()) as u64 + VISITS * FIRST as u64,
        }
    }

    /// The largest upper bound that is near enough to the largest distance found.
    fn allowed(&self) -> f64 {
        (self.lower * (1.0 + RELATIVE)).max(self.lower + self.absolute)
    }

    /// How far any point of a triangle is from one of the other surface's at most.
    fn reach(&self, corners: &Triangle, place: u32) -> f64 {
        let (other, _) = self.other.at(place);
        corners.iter().map(|&c| (closest(other, c) - c).length_squared()).fold(0.0, f64::max).sqrt()
    }

    /// An upper bound for a piece; the lower bound rises with what is found.
    fn look(&mut self, corners: &Triangle, whole: f64) -> f64 {
        let upper = self.reach(corners, self.hint).min(whole);
        let allowed = self.allowed();
        if upper <= allowed {
            return upper;
        }
        let [a, b, c] = *corners;
        let centroid = (a + b + c) / 3.0;
        let mut visits = VISITS.min(self.visits);
        let before = visits;
        let found = self.other.search(centroid, self.hint, &mut visits, |place| self.reach(corners, place) <= allowed);
        self.visits -= before - visits;
        self.hint = found.place;
        let here = found.square.sqrt();
        if found.is_nearest {
            self.lower = self.lower.max(here.min(whole));
        }
        let radius = corners.iter().map(|&corner| (corner - centroid).length()).fold(0.0, f64::max);
        let upper = self.reach(corners, found.place).min(here + radius).min(upper).min(whole);
        if upper > self.allowed() {
            // Extremes are often corners.
            let distance = |&at: &glam::DVec3| (closest(self.other.at(found.place).0, at) - at).length_squared();
            let far = corners.iter().copied().max_by(|one, two| distance(one).total_cmp(&distance(two)));
            let mut visits = VISITS.min(self.visits);
            let before = visits;
            let corner = self.other.search(far.unwrap_or(centroid), found.place, &mut visits, |_| false);
            self.visits -= before - visits;
            if corner.is_nearest {
                self.lower = self.lower.max(corner.square.sqrt().min(whole));
            }
        }
        upper
    }

    fn farthest(mut self, surface: &Surface<'_>) -> Bracket {
        let whole = |number: u32| surface.wholes.map_or(f64::INFINITY, |wholes| wholes[number as usize]);
        let count = surface.tree.len();
        let stride = count.div_ceil(FIRST).max(1);
        for place in (0..count).step_by(stride).skip(1) {
            let (corners, number) = surface.tree.at(place as u32);
            self.look(corners, whole(number));
        }
        let mut pieces = BinaryHeap::new();
        let mut made = 0;
        for place in 0..count {
            let (corners, number) = surface.tree.at(place as u32);
            let whole = whole(number);
            let upper = self.look(corners, whole);
            self.sort(Piece { upper, age: made, corners: *corners, whole, near: self.hint }, &mut pieces);
            made += 1;
        }
        let end = made + self.extra;
        while made < end {
            if pieces.peek().is_none_or(|piece: &Piece| piece.upper <= self.allowed()) {
                break;
            }
            let Some(Piece { upper: bound, corners, whole, near, .. }) = pieces.pop() else { break };
            let (parts, count) = across(&corners, self.other.at(near).0).unwrap_or_else(|| halves(corners));
            for corners in &parts[..count] {
                let upper = self.look(corners, whole).min(bound);
                self.sort(Piece { upper, age: made, corners: *corners, whole, near: self.hint }, &mut pieces);
                made += 1;
            }
        }
        let left = pieces.peek().map_or(0.0, |piece| piece.upper);
        Bracket { lower: self.lower, upper: self.lower.max(self.settled).max(left) }
    }

    fn sort(&mut self, piece: Piece, pieces: &mut BinaryHeap<Piece>) {
        if piece.upper > self.allowed() {
            pieces.push(piece);
        } else {
            self.settled = self.settled.max(piece.upper);
        }
    }
}

/// Parts of a triangle, and how many there are.
type Parts = ([Triangle; 3], usize);

/// A triangle cut by the plane that stands on a side of another, of those that part it the one beyond which it reaches farthest.
/// `None` if none parts it.
fn across(corners: &Triangle, other: &Triangle) -> Option<Parts> {
    let normal = (other[1] - other[0]).cross(other[2] - other[0]);
    let mut best: Option<(f64, [f64; 3])> = None;
    for i in 0..3 {
        let along = other[(i + 1) % 3] - other[i];
        let outwards = along.cross(normal).normalize_or_zero();
        let heights = corners.map(|corner| outwards.dot(corner - other[i]));
        let (low, high) = heights.iter().fold((0.0_f64, 0.0_f64), |(low, high), &h| (low.min(h), high.max(h)));
        // Neither part a sliver.
        let parts = low < -1e-3 * high && high > -1e-3 * low && high.is_finite() && low.is_finite();
        if parts && best.is_none_or(|(most, _)| high > most) {
            best = Some((high, heights));
        }
    }
    let (_, heights) = best?;
    // The corner that lies on a side of its own.
    let alone = (0..3).find(|&i| {
        let beyond = |h: f64| h > 0.0;
        beyond(heights[i]) != beyond(heights[(i + 1) % 3]) && beyond(heights[i]) != beyond(heights[(i + 2) % 3])
    })?;
    let (next, last) = ((alone + 1) % 3, (alone + 2) % 3);
    let cut =
        |to: usize| corners[alone].lerp(corners[to], (heights[alone] / (heights[alone] - heights[to])).clamp(0.0, 1.0));
    let (one, two) = (cut(next), cut(last));
    let parts = [[corners[alone], one, two], [one, corners[next], corners[last]], [one, corners[last], two]];
    parts.as_flattened().iter().all(|corner| corner.is_finite()).then_some((parts, 3))
}

/// A triangle halved at its longest side.
fn halves([a, b, c]: Triangle) -> Parts {
    let (ab, bc, ca) = ((b - a).length_squared(), (c - b).length_squared(), (a - c).length_squared());
    let [a, b, c] = if ab >= bc && ab >= ca {
        [a, b, c]
    } else if bc >= ca {
        [b, c, a]
    } else {
        [c, a, b]
    };
    let middle = 0.5 * (a + b);
    ([[a, middle, c], [middle, b, c], [b; 3]], 2)
}
