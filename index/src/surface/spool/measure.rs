//! What a source holds in figures: bounds, areas by orientation, and what has to be repaired. Sums are of whole numbers, so
//! that they do not depend on the order in which pieces are read.

use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;

use crate::orthoview::raster::Triangle;

/// Bins of normals along each axis of a face of the cube around the sphere.
const BINS: usize = 8;
/// Fixed point of areas: parts of a square metre.
const FIXED: f64 = (1u64 << 40) as f64;
/// Areas beyond this are taken as this, m².
const LARGEST: f64 = 1e24;
/// Middles of triangles that are kept to find the main body.
const SAMPLE: usize = 1 << 16;
/// Lines: a triangle's height is less than this share of its longest edge.
const FLAT: f64 = 1e-12;

/// What was put right.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Repairs {
    /// Triangles with a corner that is no number or names no vertex: left out.
    pub not_finite: u64,
    /// Triangles without area: left out.
    pub degenerate: u64,
    /// Triangles far away from everything else: left out.
    pub strays: u64,
    /// Edges of more than two triangles within a piece; kept.
    pub non_manifold_edges: u64,
}

/// What a triangle is good for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Soundness {
    Sound,
    NotFinite,
    Degenerate,
}

pub(super) fn soundness(triangle: &Triangle) -> Soundness {
    let [a, b, c] = triangle.corners;
    if !(a.is_finite() && b.is_finite() && c.is_finite()) {
        return Soundness::NotFinite;
    }
    let longest = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
    let area = (b - a).cross(c - a).length();
    // NaN where it overflows.
    if area > FLAT * longest { Soundness::Sound } else { Soundness::Degenerate }
}

pub(super) fn middle(triangle: &Triangle) -> DVec3 {
    let [a, b, c] = triangle.corners;
    a / 3.0 + b / 3.0 + c / 3.0
}

/// The triangles of a source, added up.
#[derive(Clone, Debug)]
pub(super) struct Measure {
    /// Sound ones.
    pub(super) triangles: u64,
    pub(super) repairs: Repairs,
    pub(super) bounds: Aabb,
    /// Box around the middles.
    middles: Aabb,
    area: u128,
    /// By bin: area, and vector area.
    bins: Vec<(u128, [i128; 3])>,
    /// Middles whose numbers have the least hashes, with these.
    sample: Vec<(u64, DVec3)>,
    /// Hashes from here on are not kept.
    below: u64,
}

impl Default for Measure {
    fn default() -> Measure {
        Measure {
            triangles: 0,
            repairs: Repairs::default(),
            bounds: Aabb::EMPTY,
            middles: Aabb::EMPTY,
            area: 0,
            bins: vec![(0, [0; 3]); 6 * BINS * BINS],
            sample: Vec::new(),
            below: u64::MAX,
        }
    }
}

/// A hash of 64 bits (Steele, Lea and Flood, the finaliser of SplitMix).
fn mixed(value: u64) -> u64 {
    let value = value.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let value = (value ^ (value >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    value ^ (value >> 31)
}

fn bin(normal: DVec3) -> usize {
    let size = normal.abs();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let step = |v: f64| (((v / size[axis] + 1.0) * 0.5 * BINS as f64) as usize).min(BINS - 1);
    let face = 2 * axis + usize::from(normal[axis] < 0.0);
    (face * BINS + step(normal[(axis + 1) % 3])) * BINS + step(normal[(axis + 2) % 3])
}

#[expect(clippy::cast_possible_truncation, reason = "clamped far below the largest")]
fn fixed(area: f64) -> i128 {
    (area.clamp(-LARGEST, LARGEST) * FIXED) as i128
}

impl Measure {
    /// Adds the triangles of a piece. Those that `is_stray` are counted as that alone.
    pub(super) fn add(&mut self, piece: usize, triangles: &[Triangle], is_stray: &dyn Fn(DVec3) -> bool) {
        for (at, triangle) in triangles.iter().enumerate() {
            match soundness(triangle) {
                Soundness::NotFinite => self.repairs.not_finite += 1,
                Soundness::Degenerate => self.repairs.degenerate += 1,
                Soundness::Sound => {
                    let middle = middle(triangle);
                    if is_stray(middle) {
                        self.repairs.strays += 1;
                    } else {
                        self.sound(mixed(mixed(piece as u64) ^ at as u64), middle, triangle);
                    }
                }
            }
        }
        self.thin();
    }

    fn sound(&mut self, hash: u64, middle: DVec3, triangle: &Triangle) {
        self.triangles += 1;
        let [a, b, c] = triangle.corners;
        self.bounds = self.bounds.union(Aabb { min: a.min(b).min(c), max: a.max(b).max(c) });
        self.middles = self.middles.union(Aabb { min: middle, max: middle });
        let vector = 0.5 * (b - a).cross(c - a);
        let area = vector.length();
        self.area = self.area.saturating_add(fixed(area).unsigned_abs());
        // A surface that is seen from both sides faces both ways.
        let sides: &[f64] = if triangle.two_sided { &[0.5, -0.5] } else { &[1.0] };
        for side in sides {
            let own = *side * vector;
            let slot = &mut self.bins[bin(own)];
            slot.0 = slot.0.saturating_add(fixed(side.abs() * area).unsigned_abs());
            for (sum, value) in slot.1.iter_mut().zip(own.to_array()) {
                *sum = sum.saturating_add(fixed(value));
            }
        }
        if hash < self.below {
            self.sample.push((hash, middle));
            if self.sample.len() >= 4 * SAMPLE {
                self.thin();
            }
        }
    }

    /// Keeps the least hashes, whatever the order they came in.
    fn thin(&mut self) {
        if self.sample.len() > SAMPLE {
            self.sample.sort_unstable_by_key(|kept| kept.0);
            self.sample.truncate(SAMPLE);
            self.below = self.sample.last().map_or(u64::MAX, |kept| kept.0);
        }
    }

    pub(super) fn join(mut self, other: Measure) -> Measure {
        self.triangles += other.triangles;
        let (own, theirs) = (&mut self.repairs, other.repairs);
        own.not_finite += theirs.not_finite;
        own.degenerate += theirs.degenerate;
        own.strays += theirs.strays;
        own.non_manifold_edges += theirs.non_manifold_edges;
        self.bounds = self.bounds.union(other.bounds);
        self.middles = self.middles.union(other.middles);
        self.area = self.area.saturating_add(other.area);
        for (slot, other) in self.bins.iter_mut().zip(other.bins) {
            slot.0 = slot.0.saturating_add(other.0);
            for (sum, value) in slot.1.iter_mut().zip(other.1) {
                *sum = sum.saturating_add(value);
            }
        }
        self.sample.extend(other.sample);
        self.thin();
        self
    }

    /// Square metres.
    pub(super) fn area(&self) -> f64 {
        self.area as f64 / FIXED
    }

    /// Area by unit normal: the mean of each bin that has any.
    pub(super) fn orientations(&self) -> Vec<(DVec3, f64)> {
        let bins = self.bins.iter().filter(|bin| bin.0 > 0);
        bins.filter_map(|(area, vector)| {
            let normal = DVec3::from_array(vector.map(|v| v as f64)).try_normalize()?;
            Some((normal, *area as f64 / FIXED))
        })
        .collect()
    }

    /// The main body, where something lies far outside it.
    pub(super) fn body(&self) -> Option<Body> {
        let few = self.few();
        let mut axes = [const { Vec::new() }; 3];
        for (axis, values) in axes.iter_mut().enumerate() {
            values.extend(self.sample.iter().map(|kept| kept.1[axis]));
            values.sort_unstable_by(f64::total_cmp);
        }
        let middle = |values: &Vec<f64>| values.get(values.len() / 2).copied();
        let centre = DVec3::new(middle(&axes[0])?, middle(&axes[1])?, middle(&axes[2])?);
        let mut distances: Vec<f64> = self.sample.iter().map(|kept| (kept.1 - centre).abs().max_element()).collect();
        distances.sort_unstable_by(f64::total_cmp);
        // As many of the sample as there are few of all.
        let share = few as f64 / self.triangles as f64 * distances.len() as f64;
        let within = distances.len().checked_sub(1 + share.ceil() as usize)?;
        let reach = BODY_RADII * distances.get(within)?;
        let far = (self.middles.max - centre).max(centre - self.middles.min).max_element();
        (few > 0 && reach > 0.0 && far > reach).then_some(Body { centre, reach })
    }

    /// How many triangles are few: 1 in 10,000, but 8 if there are 32 or more; at most a quarter.
    pub(super) fn few(&self) -> u64 {
        (self.triangles / 10_000).max(8).min(self.triangles / 4)
    }
}

/// A triangle is stray if its middle is further from the body's than this many times the distance within which all but a
/// few lie.
pub(super) const BODY_RADII: f64 = 100.0;

/// Where almost everything is: within `reach` of `centre` along each axis, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Body {
    pub(super) centre: DVec3,
    pub(super) reach: f64,
}

impl Body {
    pub(super) fn is_outside(&self, middle: DVec3) -> bool {
        (middle - self.centre).abs().max_element() > self.reach
    }
}

/// Edges that more than two sound triangles share, told by the bits of their ends.
pub(super) fn non_manifold_edges(triangles: &[Triangle]) -> u64 {
    let end = |corner: DVec3| {
        corner
            .to_array()
            .into_iter()
            .fold(0, |hash, value| mixed(hash ^ if value == 0.0 { 0 } else { value.to_bits() }))
    };
    let mut edges = Vec::with_capacity(3 * triangles.len());
    for triangle in triangles.iter().filter(|triangle| soundness(triangle) == Soundness::Sound) {
        let [a, b, c] = triangle.corners.map(end);
        edges.extend([(a, b), (b, c), (c, a)].map(|(from, to)| mixed(from.min(to)) ^ from.max(to)));
    }
    edges.sort_unstable();
    edges.chunk_by(|a, b| a == b).filter(|same| same.len() > 2).count() as u64
}
