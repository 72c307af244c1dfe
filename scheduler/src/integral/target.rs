//! What is seen along a leg: a leaf, or a group far away.

use super::leg::METRES_MAX;
use super::{IntegralError, Leg, within};
use crate::benefit::accuracy::sharpness;
use crate::benefit::cut::CutSettings;
use crate::benefit::element::{self, ELEMENTS};
use crate::benefit::frustum::{Frustum, Side};
use crate::benefit::{solid_angle, weight};
use crate::lod_tree::{LodTree, NodeId};
use glam::DVec3;

/// By which of the cut's formulas a target weighs, and where its distance is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// A leaf: importance × the exact solid angle inside the frustum; accuracy at its nearest point.
    Leaf,
    /// A leaf far away: as a group, but accuracy at its nearest point.
    FarLeaf,
    /// A group far away: projected area / d² × the share inside; d and accuracy at its centre.
    Group,
}

/// A node as it is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    centre: DVec3,
    half: DVec3,
    /// Of a far leaf or a group: Σ ι × face area by axis, m². Of a leaf: ι thrice.
    size: DVec3,
    form: Form,
    facet: Option<Facet>,
}

/// One element of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facet {
    /// m² by element; not negative.
    pub surface: [f32; ELEMENTS],
    /// Which of them is meant.
    pub element: u8,
}

/// What a view makes of a target.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sight {
    /// w, sr (not scaled to the frustum).
    pub weight: f64,
    /// (pixels per metre / e₀)² at its distance, m⁻².
    pub sharpness: f64,
}

impl Target {
    /// A node of a tree. A node with children is a group whatever `far` says.
    pub fn of(tree: &LodTree, node: NodeId, far: bool) -> Target {
        let form = match (tree.is_leaf(node), far) {
            (false, _) => Form::Group,
            (true, true) => Form::FarLeaf,
            (true, false) => Form::Leaf,
        };
        let size = if form == Form::Leaf { DVec3::splat(tree.importance(node)) } else { tree.face_areas(node) };
        Target { centre: tree.centre(node), half: tree.half(node), size, form, facet: None }
    }

    /// One element of its surface: its weight is the element's share of the whole. A representation adds the sum over the
    /// elements, each with the errors that it has there.
    #[must_use]
    pub fn element(mut self, tree: &LodTree, node: NodeId, element: usize) -> Target {
        let surface = tree.surface(node).map(|area| area as f32);
        self.facet = Some(Facet { surface, element: element.min(ELEMENTS - 1) as u8 });
        self
    }

    /// One element of a surface that is given.
    ///
    /// # Errors
    /// Areas that are NaN, negative or beyond 10³⁰ m², and an element that does not exist.
    pub fn with_facet(mut self, facet: Facet) -> Result<Target, IntegralError> {
        for area in facet.surface {
            within("surface", f64::from(area), 0.0, 1e30, "0 to 1e30 m²")?;
        }
        within("element", f64::from(facet.element), 0.0, (ELEMENTS - 1) as f64, "0 to 13")?;
        self.facet = Some(facet);
        Ok(self)
    }

    /// The element that is meant, if not all of the surface.
    pub fn facet(&self) -> Option<&Facet> {
        self.facet.as_ref()
    }

    /// A leaf by its box, metres, and importance.
    ///
    /// # Errors
    /// What is NaN, negative, or beyond 10³⁰ m or an importance of 10³⁰⁰.
    pub fn leaf(centre: DVec3, half: DVec3, importance: f64) -> Result<Target, IntegralError> {
        check_box(centre, half)?;
        within("importance", importance, 0.0, 1e300, "0 to 1e300")?;
        Ok(Target { centre, half, size: DVec3::splat(importance), form: Form::Leaf, facet: None })
    }

    /// A group (or a far leaf) by its box, metres, and Σ importance × face area by axis, m².
    ///
    /// # Errors
    /// What is NaN, negative, or beyond 10³⁰ m or 10²⁵⁰ m².
    pub fn group(centre: DVec3, half: DVec3, face_areas: DVec3) -> Result<Target, IntegralError> {
        check_box(centre, half)?;
        for area in face_areas.to_array() {
            within("face area", area, 0.0, 1e250, "0 to 1e250 m²")?;
        }
        Ok(Target { centre, half, size: face_areas, form: Form::Group, facet: None })
    }

    /// Middle of its box, metres.
    pub fn centre(&self) -> DVec3 {
        self.centre
    }

    /// Half sides of its box, metres.
    pub fn half(&self) -> DVec3 {
        self.half
    }

    /// By which formulas it weighs.
    pub fn form(&self) -> Form {
        self.form
    }

    /// Importance of a leaf; of what is far, 1: its areas hold it.
    pub fn importance(&self) -> f64 {
        if self.form == Form::Leaf { self.size.x } else { 1.0 }
    }

    /// Σ importance × face area by axis, m²; zero for a near leaf.
    pub fn face_areas(&self) -> DVec3 {
        if self.form == Form::Leaf { DVec3::ZERO } else { self.size }
    }

    /// What is seen of it at `u` seconds.
    pub fn seen(&self, leg: &Leg, cut: &CutSettings, u: f64) -> Sight {
        let frustum = leg.frustum(u);
        let centre = leg.relative(self.centre, u);
        let side = frustum.side(centre, self.half);
        self.weigh(&frustum, centre, side, cut)
    }

    /// As [`Target::seen`], for a centre relative to the eye whose `side` is known. Where `side` is inside, the
    /// frustum's orientation matters only for κ.
    pub(super) fn weigh(&self, frustum: &Frustum, centre: DVec3, side: Side, cut: &CutSettings) -> Sight {
        let straddled = match side {
            Side::Outside => return Sight::default(),
            Side::Inside => 0,
            Side::Straddles(planes) => planes,
        };
        // Groups are far; the floor keeps them finite where a path leads through their centre all the same.
        let centre_distance = centre.length().max(cut.near);
        let mut weight = match self.form {
            Form::Leaf => self.size.x * solid_angle::of_box_in_frustum(centre, self.half, frustum, straddled),
            Form::FarLeaf | Form::Group => {
                let whole = weight::of_group(self.size, centre, centre_distance);
                if straddled == 0 {
                    whole
                } else {
                    whole * weight::share_inside(&frustum.planes, centre, self.half, straddled)
                }
            }
        };
        if let Some(facet) = &self.facet {
            weight *= facet.share(centre, self.half);
        }
        if cut.centre_falloff > 0.0 {
            weight /= weight::off_centre(cut.centre_falloff, frustum.forward, centre, centre_distance);
        }
        let distance = match self.form {
            Form::Group => centre_distance,
            Form::Leaf | Form::FarLeaf => weight::nearest_distance(centre, self.half).max(cut.near),
        };
        Sight { weight, sharpness: sharpness(frustum.pixels_per_radian, distance) }
    }
}

impl Facet {
    /// Its share of what faces the eye, for the middle of the box at `centre` from it.
    pub fn share(&self, centre: DVec3, half: DVec3) -> f64 {
        let facing = element::facing(centre, half, 0.0);
        let whole = element::projected(&self.surface.map(f64::from), &facing);
        let element = usize::from(self.element);
        if whole > 0.0 { f64::from(self.surface[element]) * facing[element] / whole } else { 0.0 }
    }

    /// Mean height of the eye over what faces it, metres: what shares change over.
    pub(super) fn height(&self, centre: DVec3, half: DVec3) -> f64 {
        let facing = element::facing(centre, half, 0.0);
        let (mut sum, mut area) = (0.0, 0.0);
        for (m, a) in facing.into_iter().zip(self.surface.map(f64::from)).filter(|(m, _)| *m > 0.0) {
            sum += a * m;
            area += a;
        }
        if area > 0.0 { sum / area } else { 0.0 }
    }
}

fn check_box(centre: DVec3, half: DVec3) -> Result<(), IntegralError> {
    for value in centre.to_array() {
        within("centre", value.abs(), 0.0, METRES_MAX, "coordinates up to 1e30 m")?;
    }
    for value in half.to_array() {
        within("half side", value, 0.0, METRES_MAX, "0 to 1e30 m")?;
    }
    Ok(())
}

/// Refuses settings with which weights would not be finite.
pub(super) fn check_cut(cut: &CutSettings) -> Result<(), IntegralError> {
    within("near", cut.near, 1e-9, 1e9, "1e-9 to 1e9 m")?;
    within("centre_falloff", cut.centre_falloff, 0.0, 1e9, "0 to 1e9")?;
    within("opening", cut.opening, 0.0, f64::MAX, "a finite number ≥ 0")
}
