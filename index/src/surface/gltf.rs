//! Triangles of a glTF asset with their materials.

use std::sync::Arc;

use glam::{DMat4, DVec2, DVec3};
use gltf::json::material::{AlphaMode, Material as GltfMaterial};
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::validation::Checked;

use super::Piece;
use crate::import::tiles3d::ContentError;
use crate::import::tiles3d::mesh::{self, Asset, Geometry, MAX_TRIANGLES};
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::Material;

/// Reads the triangles of an asset, placed by `world`.
pub(crate) fn read(
    json: &[u8],
    binary: Option<&[u8]>,
    fetch: &dyn Fn(&str) -> Option<Vec<u8>>,
    world: &DMat4,
) -> Result<Piece, ContentError> {
    let root = mesh::root(json)?;
    let mut geometry = Geometry::default();
    let asset = Asset::open(&root, binary, fetch, &mut geometry);
    let mut out = Piece::default();
    for texture in &root.textures {
        let image = root.images.get(mesh::shown_image(texture));
        let fetched = image.and_then(|image| match (&image.uri, image.buffer_view) {
            (Some(uri), _) => mesh::resource(uri, fetch, &mut geometry),
            (None, Some(view)) => asset.view(view.value()).map(|(bytes, _)| bytes.to_vec()),
            (None, None) => None,
        });
        if fetched.is_none() {
            out.left_out.push("a texture that is not there".to_owned());
        }
        out.images.push(fetched.map(Arc::from));
    }
    out.materials = root.materials.iter().map(material).collect();
    // What has no material is white.
    let plain = out.materials.len() as u32;
    out.materials.push(Material::default());
    let two_sided: Vec<bool> = root.materials.iter().map(|m| m.double_sided).chain([true]).collect();
    let mut left_out = Vec::new();
    let triangles = &mut out.triangles;
    asset.walk(&mut |_, transform, primitives| {
        for primitive in primitives {
            let material = primitive.material.map_or(plain, |m| m.value() as u32).min(plain);
            let sided = two_sided[material as usize];
            if let Err(why) = add(&asset, primitive, &(*world * *transform), material, sided, triangles) {
                left_out.push(why);
            }
        }
    })?;
    out.left_out.append(&mut left_out);
    Ok(out)
}

fn material(given: &GltfMaterial) -> Material {
    let pbr = &given.pbr_metallic_roughness;
    let [r, g, b, a] = pbr.base_color_factor.0;
    let cutoff = match given.alpha_mode {
        Checked::Valid(AlphaMode::Mask) => given.alpha_cutoff.map_or(0.5, |c| c.0),
        Checked::Valid(AlphaMode::Blend) => 0.5,
        _ => 0.0,
    };
    let texture = pbr.base_color_texture.as_ref().map(|info| info.index.value());
    Material { base: [r, g, b], texture, cutoff: cutoff / a.max(1e-3) }
}

/// Adds the triangles of a primitive; otherwise says why not.
fn add(
    asset: &Asset<'_>,
    primitive: &Primitive,
    transform: &DMat4,
    material: u32,
    two_sided: bool,
    triangles: &mut Vec<Triangle>,
) -> Result<(), String> {
    if primitive.mode != Checked::Valid(Mode::Triangles) {
        return Err("points, lines, strips or fans".to_owned());
    }
    let attribute = |semantic: Semantic| {
        let index = primitive.attributes.get(&Checked::Valid(semantic))?;
        asset.elements(asset.root.accessors.get(index.value())?)
    };
    let positions = attribute(Semantic::Positions).ok_or("a mesh whose positions cannot be read")?;
    let coordinates = attribute(Semantic::TexCoords(0)).filter(|c| c.components >= 2);
    let indices = match primitive.indices {
        None => None,
        Some(index) => {
            let accessor = asset.root.accessors.get(index.value());
            let elements = accessor.and_then(|a| asset.elements(a)).filter(|e| e.components == 1);
            Some(elements.ok_or("a mesh whose indices cannot be read")?)
        }
    };
    let count = indices.as_ref().map_or(positions.count, |i| i.count) / 3;
    if count > MAX_TRIANGLES.saturating_sub(triangles.len()) {
        return Err(format!("a mesh of {count} triangles; expected at most {MAX_TRIANGLES} a content"));
    }
    let corner = |at: usize| indices.as_ref().map_or(at, |i| i.component(at, 0) as usize);
    let point =
        |at: usize| if at < positions.count { transform.transform_point3(positions.vec3(at)) } else { DVec3::NAN };
    let uv = |at: usize| match &coordinates {
        Some(c) if at < c.count => DVec2::new(c.normalised(at, 0), c.normalised(at, 1)),
        _ => DVec2::ZERO,
    };
    // A mirrored transform turns fronts into backs.
    let mirrored = transform.determinant() < 0.0;
    triangles.reserve(count);
    for t in 0..count {
        let mut vertices = [corner(3 * t), corner(3 * t + 1), corner(3 * t + 2)];
        if mirrored {
            vertices.swap(1, 2);
        }
        triangles.push(Triangle {
            corners: vertices.map(point),
            uv: vertices.map(uv),
            material,
            tint: Triangle::WHITE,
            two_sided,
        });
    }
    Ok(())
}
