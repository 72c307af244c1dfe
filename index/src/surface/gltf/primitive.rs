//! One primitive of a mesh as triangles.

use std::ops::Range;
use std::sync::OnceLock;

use glam::{DMat3, DMat4, DVec2, DVec3};
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::validation::Checked;

use super::accessor::{Asset, Unfolded};
use super::material::Coordinates;
use crate::import::tiles3d::mesh::Elements;
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::encoded;

/// The vertices of a primitive, and how they make triangles.
pub(super) struct Mesh {
    mode: Mode,
    positions: Elements<'static>,
    coordinates: Option<Elements<'static>>,
    colours: Option<Elements<'static>>,
    normals: Option<Elements<'static>>,
    indices: Option<Elements<'static>>,
    transform: Coordinates,
    material: u32,
    two_sided: bool,
}

/// Number of triangles among `corners`.
fn triangles(mode: Mode, corners: u64) -> u64 {
    match mode {
        Mode::Triangles => corners / 3,
        Mode::TriangleStrip | Mode::TriangleFan => corners.saturating_sub(2),
        _ => 0,
    }
}

/// Number of triangles that a primitive says it has.
pub(super) fn declared(asset: &Asset<'_>, primitive: &Primitive) -> u64 {
    let Checked::Valid(mode) = primitive.mode else { return 0 };
    let positions = primitive.attributes.get(&Checked::Valid(Semantic::Positions));
    let corners = primitive.indices.or_else(|| positions.copied());
    let count = corners.and_then(|index| asset.root.accessors.get(index.value())).map_or(0, |a| a.count.0);
    triangles(mode, count)
}

impl Mesh {
    /// Reads the accessors of a primitive; otherwise says why not.
    pub(super) fn read(asset: &Asset<'_>, primitive: &Primitive) -> Result<Mesh, String> {
        let Checked::Valid(mode) = primitive.mode else { return Err("a mesh of no known mode".to_owned()) };
        if !matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
            return Err("points or lines".to_owned());
        }
        if primitive.extensions.as_ref().is_some_and(|e| e.others.contains_key("KHR_draco_mesh_compression")) {
            return Err("a mesh packed with KHR_draco_mesh_compression, which is not read".to_owned());
        }
        let mut unfolded = Unfolded::new();
        let plain = asset.root.materials.len();
        let material = primitive.material.map_or(plain, |m| m.value()).min(plain);
        let transform = Coordinates::of(asset.root, material);
        let mut attribute = |semantic: Semantic| {
            let index = primitive.attributes.get(&Checked::Valid(semantic))?;
            Some(asset.elements(index.value(), &mut unfolded))
        };
        let positions = attribute(Semantic::Positions).ok_or("a mesh without positions")?;
        let positions = positions.map_err(|why| format!("a mesh whose positions are in {why}"))?;
        let coordinates = attribute(Semantic::TexCoords(transform.set)).and_then(Result::ok);
        let colours = attribute(Semantic::Colors(0)).and_then(Result::ok);
        let normals = attribute(Semantic::Normals).and_then(Result::ok);
        let indices = primitive.indices.map(|index| asset.elements(index.value(), &mut unfolded)).transpose();
        let indices = indices.map_err(|why| format!("a mesh whose indices are in {why}"))?;
        if positions.components != 3 || indices.as_ref().is_some_and(|indices| indices.components != 1) {
            return Err("a mesh whose positions are no vectors or whose indices are no numbers".to_owned());
        }
        Ok(Mesh {
            mode,
            positions,
            coordinates: coordinates.filter(|c| c.components >= 2),
            colours: colours.filter(|c| c.components >= 3),
            normals: normals.filter(|n| n.components >= 3),
            indices,
            transform,
            material: material as u32,
            two_sided: asset.root.materials.get(material).is_none_or(|m| m.double_sided),
        })
    }

    /// Number of triangles.
    pub(super) fn count(&self) -> usize {
        let corners = self.indices.as_ref().map_or(self.positions.count, |indices| indices.count);
        triangles(self.mode, corners as u64) as usize
    }

    /// Adds the triangles of a range, placed by `world`. A corner that names no vertex is NaN.
    pub(super) fn triangles(&self, range: Range<usize>, world: &DMat4, out: &mut Vec<Triangle>) {
        let point = |at: usize| {
            if at < self.positions.count { world.transform_point3(self.positions.vec3(at)) } else { DVec3::NAN }
        };
        let uv = |at: usize| match &self.coordinates {
            Some(c) if at < c.count => self.transform.apply(DVec2::new(c.normalised(at, 0), c.normalised(at, 1))),
            _ => DVec2::ZERO,
        };
        let tint = |at: usize| match &self.colours {
            Some(c) if at < c.count => [0, 1, 2].map(|channel| srgb(c.normalised(at, channel))),
            _ => [255; 3],
        };
        let is_mirrored = world.determinant() < 0.0;
        for t in range {
            let vertices = self.corners(t, is_mirrored);
            let corners = vertices.map(point);
            let (uv, tint) = (vertices.map(uv), vertices.map(tint));
            out.push(Triangle { corners, uv, material: self.material, tint, two_sided: self.two_sided });
        }
    }

    /// Adds the unit normals at the corners of a range of triangles, placed by `world`; zero where the file has none.
    pub(super) fn normals(&self, range: Range<usize>, world: &DMat4, out: &mut Vec<[[f32; 3]; 3]>) {
        let linear = DMat3::from_mat4(*world);
        let determinant = linear.determinant();
        // Of a flat placement nothing is left to stand upright on.
        let turn = if determinant.abs() > 0.0 { linear.inverse().transpose() } else { DMat3::ZERO };
        let normal = |at: usize| match &self.normals {
            Some(normals) if at < normals.count => {
                let normal = (turn * normals.vec3(at)).normalize_or_zero();
                #[expect(clippy::cast_possible_truncation, reason = "a unit vector")]
                let narrow = normal.to_array().map(|v| v as f32);
                narrow
            }
            _ => [0.0; 3],
        };
        out.extend(range.map(|t| self.corners(t, determinant < 0.0).map(normal)));
    }

    /// The vertices of a triangle. A mirrored placement turns fronts into backs.
    fn corners(&self, t: usize, is_mirrored: bool) -> [usize; 3] {
        let corner = |at: usize| self.indices.as_ref().map_or(at, |indices| indices.component(at, 0) as usize);
        let mut vertices = match self.mode {
            Mode::TriangleStrip => [t, t + 1 + t % 2, t + 2 - t % 2],
            Mode::TriangleFan => [t + 1, t + 2, 0],
            _ => [3 * t, 3 * t + 1, 3 * t + 2],
        }
        .map(corner);
        if is_mirrored {
            vertices.swap(1, 2);
        }
        vertices
    }
}

/// The sRGB byte of a linear light, to 16 bits of it.
fn srgb(light: f64) -> u8 {
    static TABLE: OnceLock<Vec<u8>> = OnceLock::new();
    const LAST: f64 = u16::MAX as f64;
    let table = TABLE.get_or_init(|| (0..=u16::MAX).map(|step| encoded(f32::from(step) / LAST as f32)).collect());
    table[(light.clamp(0.0, 1.0) * LAST).round() as usize]
}
