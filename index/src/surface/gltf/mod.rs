//! Triangles of glTF 2.0 assets with their materials: every mode that has triangles, quantised and meshopt-compressed
//! attributes, transformed texture coordinates, colours of vertices, instances.

mod accessor;
mod compression;
mod file;
mod material;
mod primitive;

#[cfg(test)]
mod tests;

pub use file::GltfFile;

use glam::{DMat4, DQuat, DVec3};
use gltf::json::{Node, Root};

use super::Piece;
use crate::import::tiles3d::limits::MAX_TRIANGLES;
use crate::import::tiles3d::mesh;
use crate::import::tiles3d::{ContentError, DRAWN_TRIANGLES_MAX, GltfUp, content};
use accessor::{Asset, Bytes};
use primitive::Mesh;

/// Most instances of one mesh.
const MAX_INSTANCES: usize = 1 << 20;

/// Required extensions that change nothing that is drawn here, or that are read.
const KNOWN: [&str; 12] = [
    "CESIUM_RTC",
    "EXT_mesh_features",
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_structural_metadata",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "KHR_xmp_json_ld",
];

/// How an asset is read.
#[derive(Clone, Copy)]
pub(crate) struct Reading<'a> {
    /// Where it stands in the world, once for each time that it is there.
    pub(crate) places: &'a [DMat4],
    /// Whether normals are kept.
    pub(crate) with_normals: bool,
    /// Most triangles, all places counted; at most [`MAX_TRIANGLES`].
    pub(crate) triangles_max: usize,
}

/// Reads all triangles of an asset. `binary` is the GLB's binary chunk; `fetch` reads a file that the asset names.
///
/// # Errors
/// JSON that is no glTF 2.0, nodes in a circle, extensions without which it cannot be drawn.
pub(crate) fn read(
    json: &[u8],
    binary: Option<&[u8]>,
    fetch: &dyn Fn(&str) -> Option<Vec<u8>>,
    reading: Reading<'_>,
) -> Result<Piece, ContentError> {
    let root = root(json)?;
    let mut out = Piece { credit: root.asset.copyright.clone().filter(|c| !c.trim().is_empty()), ..Piece::default() };
    let buffers = root.buffers.iter().enumerate().map(|(index, buffer)| match &buffer.uri {
        None if index == 0 => binary.map(|bytes| Bytes::Memory(bytes.into())),
        None => None,
        Some(uri) => resource(uri, fetch).map(|bytes| Bytes::Memory(bytes.into())),
    });
    let buffers: Vec<_> = buffers.collect();
    let asset = Asset { root: &root, buffers: &buffers };
    out.images = material::images(&asset, fetch, &mut out.left_out);
    out.materials = material::materials(&root);
    let Piece { triangles, normals, left_out, .. } = &mut out;
    let centre = centre(&root);
    let worlds: Vec<DMat4> = reading.places.iter().map(|place| *place * centre).collect();
    mesh::walk(&root, &mut |node, transform, primitives| {
        let instances = match instances(&asset, node) {
            Ok(instances) => instances,
            Err(why) => return left_out.push(why),
        };
        for given in primitives {
            let read = Mesh::read(&asset, given).and_then(|mesh| {
                let most = reading.triangles_max.min(MAX_TRIANGLES);
                let room = most.saturating_sub(triangles.len());
                let count = mesh.count().saturating_mul(instances.len()).saturating_mul(worlds.len());
                if count > room {
                    return Err(format!("a mesh of {count} triangles; expected at most {most} a content"));
                }
                triangles.reserve(count);
                for place in worlds.iter().flat_map(|world| instances.iter().map(move |own| *world * *transform * *own))
                {
                    mesh.triangles(0..mesh.count(), &place, triangles);
                    if reading.with_normals {
                        mesh.normals(0..mesh.count(), &place, normals);
                    }
                }
                Ok(())
            });
            if let Err(why) = read {
                left_out.push(why);
            }
        }
    })?;
    Ok(out)
}

/// What a GLB shows that stands by itself, with normals: y up in the file, z up in the world, files beside it left out. More than
/// [`DRAWN_TRIANGLES_MAX`] triangles are refused.
///
/// # Errors
/// Bytes that are no GLB, are cut off, or ask for what is not read.
pub fn read_glb(bytes: &[u8]) -> Result<Piece, ContentError> {
    let Some((json, binary, _)) = content::gltf(bytes)?.filter(|_| bytes.starts_with(b"glTF")) else {
        let start = String::from_utf8_lossy(&bytes[..bytes.len().min(4)]);
        return Err(ContentError::new("byte 0", format!("{start:?}; expected \"glTF\"")));
    };
    let places = [DMat4::from_mat3(GltfUp::Y.rotation())];
    let reading = Reading { places: &places, with_normals: true, triangles_max: DRAWN_TRIANGLES_MAX };
    read(json, binary, &|_| None, reading)
}

/// An asset's JSON, which asks for nothing that is not read.
fn root(json: &[u8]) -> Result<Root, ContentError> {
    let root = mesh::root(json)?;
    let unknown = |name: &&String| !KNOWN.contains(&name.as_str()) && !name.starts_with("KHR_materials_");
    if let Some(name) = root.extensions_required.iter().find(unknown) {
        let fault = format!("{name}; expected an asset that can be drawn without it");
        return Err(ContentError::new("$.extensionsRequired", fault));
    }
    Ok(root)
}

/// The bytes behind a data URI or a file's name.
fn resource(uri: &str, fetch: &dyn Fn(&str) -> Option<Vec<u8>>) -> Option<Vec<u8>> {
    if uri.starts_with("data:") { mesh::inline(uri) } else { fetch(uri) }
}

/// What the positions of an asset are relative to (`CESIUM_RTC`): said with z up, given in the asset's axes with y up.
fn centre(root: &Root) -> DMat4 {
    let given = root.extensions.as_ref().and_then(|extensions| extensions.others.get("CESIUM_RTC")?.get("center"));
    let number = |axis: usize| given?.get(axis)?.as_f64();
    match (number(0), number(1), number(2)) {
        (Some(x), Some(y), Some(z)) => DMat4::from_translation(DVec3::new(x, z, -y)),
        _ => DMat4::IDENTITY,
    }
}

/// Where a node's mesh is drawn, relative to the node: once, or at the places of its instances.
fn instances(asset: &Asset<'_>, node: &Node) -> Result<Vec<DMat4>, String> {
    let extension = node.extensions.as_ref().and_then(|e| e.others.get("EXT_mesh_gpu_instancing"));
    let Some(attributes) = extension.map(|extension| extension.get("attributes")) else {
        return Ok(vec![DMat4::IDENTITY]);
    };
    let attribute = |name: &str| {
        let Some(index) = attributes.and_then(|a| a.get(name)?.as_u64()) else { return Ok(None) };
        let components = if name == "ROTATION" { 4 } else { 3 };
        let elements = asset.elements(usize::try_from(index).unwrap_or(usize::MAX), &mut Default::default())?;
        if elements.components < components {
            return Err(format!(
                "instances whose {name} has {} components; expected {components}",
                elements.components
            ));
        }
        Ok(Some(elements))
    };
    let (moved, turned, scaled) = (attribute("TRANSLATION")?, attribute("ROTATION")?, attribute("SCALE")?);
    let count = [&moved, &turned, &scaled].into_iter().flatten().map(|elements| elements.count).min().unwrap_or(0);
    if count > MAX_INSTANCES {
        return Err(format!("{count} instances of a mesh; expected at most {MAX_INSTANCES}"));
    }
    let vector = |given: &Option<mesh::Elements<'_>>, at: usize, or: DVec3| given.as_ref().map_or(or, |e| e.vec3(at));
    let place = |at: usize| {
        let rotation = turned.as_ref().map_or(DQuat::IDENTITY, |e| {
            DQuat::from_array(std::array::from_fn(|component| e.normalised(at, component)))
        });
        let rotation = if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY };
        let (scale, translation) = (vector(&scaled, at, DVec3::ONE), vector(&moved, at, DVec3::ZERO));
        DMat4::from_scale_rotation_translation(scale, rotation, translation)
    };
    Ok((0..count).map(place).collect())
}
