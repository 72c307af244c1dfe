//! A cell's share of its content: triangles clipped to it, by what they look like.

use std::collections::BTreeMap;

use glam::{DVec2, DVec3};

use super::GeometryError;
use super::clip::{Region, Whole};
use super::frame::Frame;
use crate::mesh::Triangle;
use crate::octree::{Cell, Octree};
use crate::orthoview::raster;
use crate::orthoview::texture::{Material, Materials, Texture, encoded, linear};

/// Most triangles of a cell after clipping.
pub const TRIANGLES_MAX: usize = 1 << 24;
/// Texture coordinates beyond this are taken for broken ones, which are 0.
const UV_MAX: f64 = 1e6;

/// Triangles that look alike.
#[derive(Clone, Debug)]
pub(super) struct Group<'a> {
    pub(super) material: Material,
    pub(super) two_sided: bool,
    pub(super) texture: Option<(&'a Texture, Frame)>,
    /// Metres to a texel's side; infinite where all of a triangle shows one texel.
    pub(super) texel: f64,
}

/// A piece of a triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    /// Metres from the cell's least corner.
    pub(super) corners: Triangle,
    pub(super) uv: [DVec2; 3],
    /// sRGB.
    pub(super) tint: [[u8; 3]; 3],
    pub(super) group: u32,
}

/// What lies in a cell.
#[derive(Clone, Debug, Default)]
pub(super) struct Soup<'a> {
    pub(super) pieces: Vec<Piece>,
    pub(super) groups: Vec<Group<'a>>,
}

/// What makes triangles look alike: texture by its place in memory, base colour, cutoff, sides. Looked up only.
type Key = (Option<usize>, [u32; 3], u32, bool);

/// The pieces of `meshes` in a cell, in their order; groups in the order of their first piece.
pub(super) fn gathered<'a>(
    meshes: &[(&[raster::Triangle], &'a Materials)],
    octree: &Octree,
    cell: Cell,
) -> Result<Soup<'a>, GeometryError> {
    let region = Region::of(octree, cell);
    let origin = octree.bounds(cell).min;
    let mut soup = Soup::default();
    let mut known: BTreeMap<Key, u32> = BTreeMap::new();
    let mut polygon = Vec::new();
    for (triangles, materials) in meshes {
        // Triangles of a material tend to follow each other.
        let mut last: Option<((u32, bool), u32)> = None;
        for triangle in *triangles {
            let light = |srgb: [u8; 3]| DVec3::from_array(srgb.map(|byte| f64::from(linear(byte))));
            let (uv, tint) = (triangle.uv.map(sound), triangle.tint.map(light));
            region.clip(&Whole { corners: triangle.corners, uv, tint }, &mut polygon);
            if polygon.is_empty() {
                continue;
            }
            let looks = (triangle.material, triangle.two_sided);
            let group = match last.filter(|(of, _)| *of == looks) {
                Some((_, group)) => group,
                None => group(&mut soup.groups, &mut known, materials, looks),
            };
            last = Some((looks, group));
            let found = polygon.len() - 2;
            if soup.pieces.len() + found > TRIANGLES_MAX {
                return Err(GeometryError::TooMany { most: TRIANGLES_MAX });
            }
            for i in 0..found {
                let fan = [polygon[0], polygon[i + 1], polygon[i + 2]];
                let corners = fan.map(|c| c.at - origin);
                #[expect(clippy::cast_possible_truncation, reason = "0 to 1")]
                let srgb = |tint: DVec3| tint.to_array().map(|light| encoded(light as f32));
                let tint =
                    if triangle.tint == raster::Triangle::WHITE { triangle.tint } else { fan.map(|c| srgb(c.tint)) };
                soup.pieces.push(Piece { corners, uv: fan.map(|c| c.uv), tint, group });
            }
        }
    }
    soup.frame();
    Ok(soup)
}

/// Texture coordinates that can be worked with.
fn sound(uv: DVec2) -> DVec2 {
    if uv.is_finite() && uv.abs().max_element() <= UV_MAX { uv } else { DVec2::ZERO }
}

fn group<'a>(
    groups: &mut Vec<Group<'a>>,
    known: &mut BTreeMap<Key, u32>,
    materials: &'a Materials,
    (number, two_sided): (u32, bool),
) -> u32 {
    let mut material = materials.materials.get(number as usize).copied().unwrap_or_default();
    material.base = material.base.map(|c| if c.is_finite() { c.clamp(0.0, 1.0) } else { 1.0 });
    if !(material.cutoff.is_finite() && material.cutoff >= 0.0) {
        material.cutoff = 0.0;
    }
    let texture = material.texture.and_then(|t| materials.textures.get(t)?.as_deref());
    let key = (
        texture.map(|texture| std::ptr::from_ref(texture) as usize),
        material.base.map(f32::to_bits),
        material.cutoff.to_bits(),
        two_sided,
    );
    *known.entry(key).or_insert_with(|| {
        let texture = texture.map(|texture| (texture, Frame::default()));
        groups.push(Group { material, two_sided, texture, texel: f64::INFINITY });
        groups.len() as u32 - 1
    })
}

impl Soup<'_> {
    /// Finds which part of its texture each group shows, and how large its texels are.
    fn frame(&mut self) {
        #[derive(Clone, Copy)]
        struct Shown {
            min: DVec2,
            max: DVec2,
            area: f64,
            texels: f64,
        }
        let none = Shown { min: DVec2::INFINITY, max: DVec2::NEG_INFINITY, area: 0.0, texels: 0.0 };
        let mut shown = vec![none; self.groups.len()];
        for piece in &self.pieces {
            let shown = &mut shown[piece.group as usize];
            for uv in piece.uv {
                shown.min = shown.min.min(uv);
                shown.max = shown.max.max(uv);
            }
            let [a, b, c] = piece.corners;
            let [u, v, w] = piece.uv;
            shown.area += (b - a).cross(c - a).length();
            shown.texels += (v - u).perp_dot(w - u).abs();
        }
        for (group, shown) in self.groups.iter_mut().zip(shown) {
            if let Some((texture, frame)) = &mut group.texture {
                let (width, height) = texture.size();
                *frame = Frame::over(shown.min, shown.max, [width, height]);
                let texels = shown.texels * (width * height) as f64;
                group.texel = if texels > 0.0 { (shown.area / texels).sqrt() } else { f64::INFINITY };
            }
        }
    }

    /// The corners of all pieces.
    pub(super) fn corners(&self) -> impl Iterator<Item = DVec3> + '_ {
        self.pieces.iter().flat_map(|piece| piece.corners)
    }
}
