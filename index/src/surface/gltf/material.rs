//! Materials of an asset, as far as unlit surfaces show them: base colour, its texture, cut-outs, which sides are seen.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::DVec2;
use gltf::json::material::{AlphaMode, Material as GltfMaterial};
use gltf::json::validation::Checked;
use gltf::json::{Root, Value};

use super::accessor::Asset;
use super::resource;
use crate::import::tiles3d::mesh::shown_image;
use crate::orthoview::texture::Material;

/// The image of each texture, once where several show the same.
pub(super) fn images(
    asset: &Asset<'_>,
    fetch: &dyn Fn(&str) -> Option<Vec<u8>>,
    left_out: &mut Vec<String>,
) -> Vec<Option<Arc<[u8]>>> {
    let mut read: BTreeMap<usize, Option<Arc<[u8]>>> = BTreeMap::new();
    let shown = asset.root.textures.iter().map(|texture| {
        let number = shown_image(texture);
        let bytes = read.entry(number).or_insert_with(|| match image(asset, number, fetch) {
            Ok(bytes) => Some(bytes.into()),
            Err(why) => {
                left_out.push(format!("a texture: {why}"));
                None
            }
        });
        bytes.clone()
    });
    shown.collect()
}

/// The image of one texture.
pub(super) fn image_of(
    asset: &Asset<'_>,
    texture: usize,
    fetch: &dyn Fn(&str) -> Option<Vec<u8>>,
    left_out: &mut Vec<String>,
) -> Option<Arc<[u8]>> {
    let given = asset.root.textures.get(texture).ok_or_else(|| "one that is not declared".to_owned());
    match given.and_then(|given| image(asset, shown_image(given), fetch)) {
        Ok(bytes) => Some(bytes.into()),
        Err(why) => {
            left_out.push(format!("a texture: {why}"));
            None
        }
    }
}

fn image(asset: &Asset<'_>, number: usize, fetch: &dyn Fn(&str) -> Option<Vec<u8>>) -> Result<Vec<u8>, String> {
    let image = asset.root.images.get(number).ok_or("an image that is not declared")?;
    match (&image.uri, image.buffer_view) {
        (Some(uri), _) => resource(uri, fetch).ok_or_else(|| {
            let uri: String = uri.chars().take(80).collect();
            format!("image {uri:?}, which is not there")
        }),
        (None, Some(view)) => asset.view(view.value()),
        (None, None) => Err("an image without bytes".to_owned()),
    }
}

/// The materials in order, and behind them the white one of what has none.
pub(super) fn materials(root: &Root) -> Vec<Material> {
    root.materials.iter().map(material).chain([Material::default()]).collect()
}

fn material(given: &GltfMaterial) -> Material {
    let pbr = &given.pbr_metallic_roughness;
    let mut base = pbr.base_color_factor.0;
    if let Some(factor) = glossy(given).and_then(|glossy| glossy.get("diffuseFactor")) {
        for (at, value) in base.iter_mut().enumerate() {
            *value = factor.get(at).and_then(Value::as_f64).map_or(1.0, |v| v as f32);
        }
    }
    let [r, g, b, a] = base;
    let cutoff = match given.alpha_mode {
        Checked::Valid(AlphaMode::Mask) => given.alpha_cutoff.map_or(0.5, |c| c.0),
        Checked::Valid(AlphaMode::Blend) => 0.5,
        _ => 0.0,
    };
    let texture = shown(given).map(|shown| shown.texture);
    Material { base: [r, g, b].map(|v| if v.is_finite() { v } else { 1.0 }), texture, cutoff: cutoff / a.max(1e-3) }
}

/// The older way to say what a material looks like.
fn glossy(given: &GltfMaterial) -> Option<&Value> {
    given.extensions.as_ref()?.others.get("KHR_materials_pbrSpecularGlossiness")
}

/// The texture that a material shows.
struct Shown<'a> {
    texture: usize,
    set: u32,
    transform: Option<&'a Value>,
}

fn shown(given: &GltfMaterial) -> Option<Shown<'_>> {
    if let Some(info) = &given.pbr_metallic_roughness.base_color_texture {
        let transform = info.extensions.as_ref().and_then(|e| e.others.get("KHR_texture_transform"));
        return Some(Shown { texture: info.index.value(), set: info.tex_coord, transform });
    }
    let info = glossy(given)?.get("diffuseTexture")?;
    let number = |name: &str| info.get(name).and_then(Value::as_u64);
    Some(Shown {
        texture: usize::try_from(number("index")?).ok()?,
        set: number("texCoord").and_then(|set| u32::try_from(set).ok()).unwrap_or(0),
        transform: info.get("extensions").and_then(|extensions| extensions.get("KHR_texture_transform")),
    })
}

/// How a material's texture coordinates come from the mesh's: which set, and x ↦ offset + R (scale × x), R a turn to the
/// left of an image whose second coordinate runs downwards (`KHR_texture_transform`).
#[derive(Clone, Copy, Debug)]
pub(super) struct Coordinates {
    pub(super) set: u32,
    columns: [DVec2; 2],
    offset: DVec2,
}

impl Coordinates {
    pub(super) fn of(root: &Root, material: usize) -> Coordinates {
        let mut out = Coordinates { set: 0, columns: [DVec2::X, DVec2::Y], offset: DVec2::ZERO };
        let Some(Shown { set, transform, .. }) = root.materials.get(material).and_then(shown) else { return out };
        out.set = set;
        let Some(given) = transform else { return out };
        let pair = |name: &str, or: DVec2| {
            let number = |at: usize| given.get(name)?.get(at)?.as_f64();
            number(0).zip(number(1)).map_or(or, |(x, y)| DVec2::new(x, y))
        };
        if let Some(set) = given.get("texCoord").and_then(|set| u32::try_from(set.as_u64()?).ok()) {
            out.set = set;
        }
        let angle = given.get("rotation").and_then(Value::as_f64).unwrap_or(0.0);
        let (sin, cos) = (libm::sin(angle), libm::cos(angle));
        let scale = pair("scale", DVec2::ONE);
        out.columns = [scale.x * DVec2::new(cos, -sin), scale.y * DVec2::new(sin, cos)];
        out.offset = pair("offset", DVec2::ZERO);
        out
    }

    pub(super) fn apply(&self, uv: DVec2) -> DVec2 {
        self.offset + self.columns[0] * uv.x + self.columns[1] * uv.y
    }
}
