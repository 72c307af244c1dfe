//! A view's cut: the leaves near the eye one by one, what is far away in groups.
//!
//! A view over 10⁷ leaves cannot be summed leaf by leaf many times a second. Where a group subtends a small angle, its
//! leaves are seen from almost the same direction and distance, so its weight is that of their projected areas,
//! Σ ι·A_ℓ(u) / d², which is additive. This *defines* the weights that scheduling, measurement and the upper bound all
//! share; the opening angle θ bounds the relative error of a group's weight by O(θ²), and θ → 0 is the sum over leaves.
//! The cut depends on the view only, never on what is resident: so values of two resident sets compare exactly.

use super::accuracy::sharpness;
use super::frustum::{Frustum, Side};
use super::{element, solid_angle, weight};
use crate::lod_tree::{LodTree, NodeId};
use crate::setting::{SettingError, within};
use crate::view::View;
use glam::DVec3;

/// How a cut is made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutSettings {
    /// θ: a node is opened while its radius exceeds θ × its distance. Smaller is more accurate and slower.
    pub opening: f64,
    /// Distances are at least this, metres.
    pub near: f64,
    /// Centre weighting κ = 1 / (1 + falloff·tan²θ) with θ the angle from the view's centre; 0 weighs all alike.
    pub centre_falloff: f64,
}

impl Default for CutSettings {
    fn default() -> CutSettings {
        CutSettings { opening: 0.15, near: 0.1, centre_falloff: 0.0 }
    }
}

impl CutSettings {
    /// Refuses what no weight could be computed with, naming the field.
    pub fn check(&self) -> Result<(), SettingError> {
        within("opening", self.opening, (0.0, 1e12), "radians from 0 to 1e12")?;
        within("near", self.near, (1e-30, 1e30), "metres from 1e-30 to 1e30")?;
        within("centre_falloff", self.centre_falloff, (0.0, 1e12), "a number from 0 to 1e12")
    }
}

/// A node of the cut with what the view makes of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// The node: a leaf, or a group far enough away.
    pub node: NodeId,
    /// w, sr: of the leaf, or summed over the leaves of the group.
    pub weight: f64,
    /// (pixels per metre / e₀)² at its distance, m⁻².
    pub sharpness: f64,
}

/// The patches of one view, in preorder.
#[derive(Clone, Debug, Default)]
pub struct Cut {
    /// In the order of their nodes, so that what lies beneath a node is one range.
    pub patches: Vec<Patch>,
    /// Σ w before scaling, sr.
    pub total_weight: f64,
    /// min(1, Ω/Σw): every weight counts times this, so that a view never weighs more than its frustum. It cancels in
    /// the quality.
    pub scale: f64,
    /// The eye, from which groups are opened further.
    pub eye: DVec3,
    /// By how much it may move, metres; 0 for a view's own frustum.
    pub reach: f64,
}

/// Which directions count, and how far they may be off.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Region {
    /// The view's frustum; weights are clipped to it.
    Frustum,
    /// The union of everything reachable by turning `angle` radians and moving `reach` metres: a leaf that meets it
    /// weighs its whole solid angle, and its distance is `reach` less, but at least `stand_off` (\[ZK\] §5, `union`).
    Reachable {
        /// ωε, radians.
        angle: f64,
        /// ϑε, metres.
        reach: f64,
        /// Distances that no client takes up, metres.
        stand_off: f64,
    },
}

impl Cut {
    /// Makes the cut of `view` into `self`, reusing its memory.
    pub fn make(&mut self, tree: &LodTree, view: &View, region: Region, settings: &CutSettings) {
        self.make_from(tree, &Eye::new(view, region, settings));
    }

    /// The same from an eye.
    pub fn make_from(&mut self, tree: &LodTree, eye: &Eye) {
        self.patches.clear();
        self.total_weight = 0.0;
        self.eye = eye.frustum.eye;
        self.reach = eye.reach();
        let end = tree.nodes() as u32;
        let mut next = 0u32;
        // Beneath a node that lies inside as a whole no plane needs to be looked at.
        let mut inside_until = 0u32;
        while next < end {
            let node = NodeId(next);
            let centre = tree.centre(node) - self.eye;
            let half = tree.half(node);
            let subtree_end = tree.subtree_end(node).0;
            let side = if next < inside_until { Side::Inside } else { eye.side(centre, half) };
            if side == Side::Outside {
                next = subtree_end;
                continue;
            }
            if side == Side::Inside && next >= inside_until {
                inside_until = subtree_end;
            }
            let is_leaf = subtree_end == next + 1;
            let is_far = eye.is_far(centre, half, side);
            if !is_leaf && !is_far {
                next += 1;
                continue;
            }
            if let Some((weight, sharpness)) = eye.weigh(tree, node, centre, half, is_far, side) {
                self.total_weight += weight;
                self.patches.push(Patch { node, weight, sharpness });
            }
            next = subtree_end;
        }
        self.scale = eye.scale(self.total_weight);
    }

    /// Bytes that the patches occupy.
    pub fn heap_bytes(&self) -> usize {
        self.patches.capacity() * size_of::<Patch>()
    }

    /// Share of each element in what `node`, in view, weighs here.
    pub fn shares(&self, tree: &LodTree, node: NodeId) -> [f64; element::ELEMENTS] {
        element::shares(tree, node, tree.centre(node) - self.eye, tree.half(node), self.reach)
    }
}

/// One view with the directions that count for it: what a box weighs there.
#[derive(Clone, Debug)]
pub struct Eye {
    /// The view's frustum.
    pub frustum: Frustum,
    region: Region,
    widened: Widened,
    settings: CutSettings,
}

impl Eye {
    /// The eye of a view that has passed [`View::check`].
    pub fn new(view: &View, region: Region, settings: &CutSettings) -> Eye {
        let frustum = Frustum::new(view);
        let widened = match region {
            Region::Frustum => Widened::new(&frustum, 0.0, 0.0),
            Region::Reachable { angle, reach, .. } => Widened::new(&frustum, angle, reach),
        };
        Eye { frustum, region, widened, settings: *settings }
    }

    /// The same with another opening angle.
    pub fn with_opening(&self, opening: f64) -> Eye {
        Eye { settings: CutSettings { opening, ..self.settings }, ..self.clone() }
    }

    /// Where a box lies, by its centre relative to the eye and its half sides, metres.
    pub fn side(&self, centre: DVec3, half: DVec3) -> Side {
        match self.region {
            Region::Frustum => self.frustum.side(centre, half),
            Region::Reachable { .. } => self.widened.side(&self.frustum, centre, half),
        }
    }

    /// Whether a box is small enough from here to count as a group. Across the border of the view it has to be 0.35 times as
    /// large: its share inside is a ramp.
    pub fn is_far(&self, centre: DVec3, half: DVec3, side: Side) -> bool {
        let opening = if side == Side::Inside { self.settings.opening } else { 0.35 * self.settings.opening };
        half.length_squared() < opening * opening * centre.length_squared()
    }

    /// min(1, Ω/Σw) for the weights `total` of everything seen.
    pub fn scale(&self, total: f64) -> f64 {
        if total > self.frustum.solid_angle { self.frustum.solid_angle / total } else { 1.0 }
    }

    /// Weight (sr) and sharpness (m⁻²) of a leaf, or of a group that is far; `None` if it weighs nothing.
    pub fn weigh(
        &self,
        tree: &LodTree,
        node: NodeId,
        centre: DVec3,
        half: DVec3,
        is_far: bool,
        side: Side,
    ) -> Option<(f64, f64)> {
        let frustum = &self.frustum;
        let centre_distance = centre.length();
        let mut weight = if is_far {
            weight::of_group(tree.face_areas(node), centre, centre_distance)
        } else {
            let exact = match (self.region, side) {
                (Region::Frustum, Side::Straddles(planes)) => {
                    solid_angle::of_box_in_frustum(centre, half, frustum, planes)
                }
                (Region::Frustum, _) => solid_angle::of_box_in_frustum(centre, half, frustum, 0),
                (Region::Reachable { .. }, _) => solid_angle::of_box(centre, half),
            };
            tree.importance(node) * exact
        };
        if let (true, Region::Frustum, Side::Straddles(planes)) = (is_far, self.region, side) {
            weight *= weight::share_inside(&frustum.planes, centre, half, planes);
        }
        if self.settings.centre_falloff > 0.0 && matches!(self.region, Region::Frustum) {
            weight /= weight::off_centre(self.settings.centre_falloff, frustum.forward, centre, centre_distance);
        }
        if weight.is_nan() || weight <= 0.0 {
            return None;
        }
        if tree.has_directions() && !element::faces(tree, node, centre, half, self.reach()) {
            return None;
        }
        let distance = if tree.is_leaf(node) { weight::nearest_distance(centre, half) } else { centre_distance };
        Some((weight, sharpness(frustum.pixels_per_radian, self.shown_distance(distance))))
    }

    /// The distance at which what is `distance` away is shown, metres: less by what can be moved, and floored.
    pub fn shown_distance(&self, distance: f64) -> f64 {
        let distance = match self.region {
            Region::Reachable { reach, stand_off, .. } => (distance - reach).max(stand_off),
            Region::Frustum => distance,
        };
        distance.max(self.settings.near)
    }

    /// By how much the eye may move, metres.
    pub fn reach(&self) -> f64 {
        match self.region {
            Region::Reachable { reach, .. } => reach,
            Region::Frustum => 0.0,
        }
    }

    /// Whether this is the worst case's region instead of a view's frustum.
    pub fn is_reachable(&self) -> bool {
        matches!(self.region, Region::Reachable { .. })
    }
}

/// Σ ι·A_ℓ(u) over the leaves beneath `node`, m², along the unit vector `direction`.
pub fn projected_area(tree: &LodTree, node: NodeId, direction: DVec3) -> f64 {
    weight::projected_area(tree.face_areas(node), direction)
}

/// A frustum turned by up to `angle` and moved by up to `reach`: the sines and cosines that its test needs.
#[derive(Clone, Copy, Debug)]
struct Widened {
    reach: f64,
    /// Planes are passed by directions at most this far behind them.
    plane: Angle,
    /// The corner cone.
    corner: Angle,
}

/// An angle in [0, π] with its sine and cosine.
#[derive(Clone, Copy, Debug)]
struct Angle {
    radians: f64,
    sin: f64,
    cos: f64,
}

impl Angle {
    fn new(radians: f64) -> Angle {
        let radians = radians.clamp(0.0, core::f64::consts::PI);
        Angle { radians, sin: libm::sin(radians), cos: libm::cos(radians) }
    }
}

impl Widened {
    fn new(frustum: &Frustum, angle: f64, reach: f64) -> Widened {
        Widened { reach, plane: Angle::new(angle), corner: Angle::new(frustum.corner_angle + angle) }
    }

    /// As [`Frustum::side`]; never misses a box.
    fn side(&self, frustum: &Frustum, centre: DVec3, half: DVec3) -> Side {
        const EVERY_PLANE: u8 = 0b1111;
        const HALF_PI: f64 = core::f64::consts::FRAC_PI_2;
        let distance = centre.length();
        let radius = half.length() + self.reach;
        if distance <= radius {
            return Side::Straddles(EVERY_PLANE);
        }
        // Half the cone of directions in which the moved box can be seen, κ < π/2.
        let cone_sin = radius / distance;
        let cone_cos = (1.0 - cone_sin * cone_sin).max(0.0).sqrt();
        let along = frustum.forward.dot(centre) / distance;
        // Off the centre by more than corner + κ? Cosines fall on [0, π]; beyond π nothing is off.
        let corner_is_wide = self.corner.radians >= HALF_PI
            && self.corner.cos * cone_cos - self.corner.sin * cone_sin > self.corner.cos
            || self.corner.radians + libm::asin(cone_sin.min(1.0)) >= core::f64::consts::PI;
        if !corner_is_wide && along < self.corner.cos * cone_cos - self.corner.sin * cone_sin {
            return Side::Outside;
        }
        let mut side = if along > self.corner.cos * cone_cos + self.corner.sin * cone_sin
            && libm::asin(cone_sin.min(1.0)) < self.corner.radians
        {
            Side::Inside
        } else {
            Side::Straddles(EVERY_PLANE)
        };
        if self.plane.radians >= HALF_PI {
            return side;
        }
        for plane in &frustum.planes {
            let height = plane.dot(centre) / distance;
            let reaches_pole = self.plane.cos * cone_cos - self.plane.sin * cone_sin <= 0.0;
            if !reaches_pole && height < -(self.plane.sin * cone_cos + self.plane.cos * cone_sin) {
                return Side::Outside;
            }
            if height < cone_sin * self.plane.cos - cone_cos * self.plane.sin {
                side = Side::Straddles(EVERY_PLANE);
            }
        }
        side
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lod_tree::{Aabb, LodTreeBuilder, Representation};
    use glam::DQuat;
    use proptest::prelude::*;

    /// 4^levels leaves on a square, in a quadtree.
    fn quadtree(levels: u32, side: f64) -> LodTree {
        fn node(b: &mut LodTreeBuilder, level: u32, x: f64, z: f64, side: f64) {
            b.open().unwrap();
            b.add(Representation {
                wire_bytes: 10,
                decoded_bytes: 10,
                error: side as f32,
                prerequisite: None,
                direction: None,
            })
            .unwrap();
            let mut content = None;
            if level == 0 {
                let height = 1.0 + (x * 7.0 + z * 3.0).abs() % 2.0;
                content = Some(Aabb { min: DVec3::new(x, 0.0, z), max: DVec3::new(x + side, height, z + side) });
            } else {
                let h = side / 2.0;
                for (dx, dz) in [(0.0, 0.0), (h, 0.0), (0.0, h), (h, h)] {
                    node(b, level - 1, x + dx, z + dz, h);
                }
            }
            b.close(content, 1.0).unwrap();
        }
        let mut b = LodTreeBuilder::default();
        node(&mut b, levels, -side / 2.0, -side / 2.0, side);
        b.finish().unwrap()
    }

    fn view(position: DVec3, yaw: f64, pitch: f64) -> View {
        View {
            position,
            orientation: DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch),
            fov_y: 1.0,
            viewport: [1920, 1080],
        }
    }

    fn by_leaf(tree: &LodTree, view: &View) -> f64 {
        let frustum = Frustum::new(view);
        (0..tree.nodes() as u32)
            .map(NodeId)
            .filter(|&n| tree.is_leaf(n))
            .map(|n| solid_angle::of_box_in_frustum(tree.centre(n) - frustum.eye, tree.half(n), &frustum, 0b1111))
            .sum()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        /// The cut's weight is that of the leaves one by one, within the opening angle's error; smaller is better.
        #[test]
        fn weights_converge_to_the_sum_over_leaves(x in -40.0..40.0f64, y in 2.5..30.0f64, yaw in -3.0..3.0f64, pitch in -0.6..0.2f64) {
            let tree = quadtree(5, 320.0);
            let view = view(DVec3::new(x, y, 0.3 * x), yaw, pitch);
            let exact = by_leaf(&tree, &view);
            for (opening, tolerance) in [(0.3, 0.03), (0.15, 0.015), (0.0, 1e-9)] {
                let mut cut = Cut::default();
                cut.make(&tree, &view, Region::Frustum, &CutSettings { opening, ..CutSettings::default() });
                prop_assert!((cut.total_weight - exact).abs() <= tolerance * exact.max(0.05), "θ = {opening}: {} {exact}", cut.total_weight);
            }
        }

        /// Whatever some turned and moved view sees is in the widened cut.
        #[test]
        fn the_reachable_region_misses_nothing(yaw in -3.0..3.0f64, turn in -1.5..1.5f64, pitch in -0.5..0.5f64, dx in -3.0..3.0f64, dz in -3.0..3.0f64) {
            let tree = quadtree(4, 200.0);
            let here = view(DVec3::new(3.0, 5.0, -2.0), yaw, -0.1);
            let there = view(DVec3::new(3.0 + dx, 5.0, -2.0 + dz), yaw + turn, -0.1 + pitch);
            let angle = libm::acos(here.forward().dot(there.forward()).clamp(-1.0, 1.0)) ;
            let settings = CutSettings { opening: 0.0, ..CutSettings::default() };
            let (mut wide, mut seen) = (Cut::default(), Cut::default());
            // The roll that a pitched turn brings along is not part of N(v, ε): allow for it.
            wide.make(&tree, &here, Region::Reachable { angle: angle + 0.35, reach: dx.hypot(dz), stand_off: 0.5 }, &settings);
            seen.make(&tree, &there, Region::Frustum, &settings);
            for patch in &seen.patches {
                prop_assert!(wide.patches.iter().any(|p| p.node == patch.node), "{:?}", patch.node);
            }
        }
    }

    #[test]
    fn inside_a_box_it_fills_the_view_and_outside_nothing_weighs() {
        let tree = quadtree(0, 10.0);
        let mut cut = Cut::default();
        cut.make(&tree, &view(DVec3::new(0.0, 0.5, 0.0), 0.3, 0.1), Region::Frustum, &CutSettings::default());
        assert_eq!(cut.patches.len(), 1);
        assert_eq!(cut.scale, 1.0);
        cut.make(&tree, &view(DVec3::new(0.0, 0.5, -100.0), 0.0, 0.0), Region::Frustum, &CutSettings::default());
        assert!(cut.patches.is_empty());
        assert_eq!(cut.scale, 1.0);
    }
}
