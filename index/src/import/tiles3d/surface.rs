//! What a tileset's finest contents look like: triangles with their materials, a content at a time, so that no more than
//! one has to be in memory.

use glam::{DMat4, DVec2, DVec3};
use gltf::json::material::{AlphaMode, Material as GltfMaterial};
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::validation::Checked;

use foresight_scheduler::lod_tree::Aabb;

use super::content::{self, ContentError};
use super::limits::MAX_TRIANGLES;
use super::mesh::{self, Asset, Geometry};
use super::resolve::Folder;
use super::walk::{NONE, Walk, Walked};
use super::{Source, Tiles3dError};
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::{Material, Materials, Texture};
use std::path::Path;

/// The finest contents of a tileset.
pub struct FinestContents {
    folder: Folder,
    walked: Walked,
    items: Vec<Item>,
}

/// A content in its place.
#[derive(Clone, Copy, Debug)]
struct Item {
    node: u32,
    bounds: Aabb,
}

/// A content's triangles in world space.
#[derive(Clone, Debug, Default)]
pub struct Surfaces {
    /// Counter-clockwise from the front.
    pub triangles: Vec<Triangle>,
    /// What they look like.
    pub materials: Materials,
    /// What was left out, in words.
    pub left_out: Vec<String>,
}

impl Surfaces {
    /// Box around the finite corners; empty without any.
    pub fn bounds(&self) -> Aabb {
        let corners = self.triangles.iter().flat_map(|t| t.corners).filter(|c| c.is_finite());
        corners.fold(Aabb::EMPTY, |bounds, corner| bounds.union(Aabb { min: corner, max: corner }))
    }
}

impl FinestContents {
    /// Opens the tileset `file`: every content that no other replaces.
    ///
    /// # Errors
    /// As [`super::open`], but contents are not read yet.
    pub fn open(file: &Path) -> Result<FinestContents, Tiles3dError> {
        let path = file.parent().map_or_else(Default::default, Path::to_path_buf);
        let name = file.file_name().and_then(|name| name.to_str()).ok_or_else(|| Tiles3dError::Io {
            file: file.to_owned(),
            source: std::io::Error::new(std::io::ErrorKind::InvalidInput, "not the name of a file"),
        })?;
        let manifest = super::manifest_beside(&path)?;
        let folder = Folder { source: Source::Files(path), manifest };
        let walked = Walk::run(&folder, name, super::MAX_TILES)?;
        let mut replaced = vec![false; walked.nodes.len()];
        // Preorder: from the last on, so that what lies beneath is known.
        for index in (0..walked.nodes.len()).rev() {
            let node = &walked.nodes[index];
            if node.parent != NONE && (node.variant != NONE || replaced[index]) {
                replaced[node.parent as usize] = true;
            }
        }
        let finest = walked.nodes.iter().enumerate().filter(|(i, node)| node.variant != NONE && !replaced[*i]);
        let items = finest.map(|(i, node)| Item { node: i as u32, bounds: node.declared }).collect();
        Ok(FinestContents { folder, walked, items })
    }

    /// Number of contents.
    pub fn len(&self) -> usize {
        self.items.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    /// The declared bounds of a content: not always those of what is in it.
    pub fn declared(&self, index: usize) -> Aabb {
        self.items[index].bounds
    }

    /// Name of a content's file, relative to the tileset's folder.
    pub fn file(&self, index: usize) -> &str {
        &self.walked.files[self.walked.variants[self.variant(index)].file as usize]
    }

    fn variant(&self, index: usize) -> usize {
        self.walked.nodes[self.items[index].node as usize].variant as usize
    }

    /// Reads a content.
    ///
    /// # Errors
    /// A file that cannot be read or is no content that has a mesh.
    pub fn load(&self, index: usize) -> Result<Surfaces, ContentError> {
        let node = &self.walked.nodes[self.items[index].node as usize];
        let variant = self.walked.variants[node.variant as usize];
        let file = self.file(index).to_owned();
        let at = |fault: String| ContentError::new(file.clone(), fault);
        let bytes = self.folder.read(&file).map_err(|error| at(format!("{error}; expected a content")))?;
        let parts = content::gltf(&bytes).map_err(|error| at(error.to_string()))?;
        let Some((json, binary, centre)) = parts else {
            return Err(at("instances, points or a composite; expected glTF, GLB or b3dm".to_owned()));
        };
        let base = super::resolve::folder_of(&file).to_owned();
        let fetch = |uri: &str| self.folder.fetch(&base, uri).map(|(_, bytes)| bytes);
        let linear = self.walked.linears[variant.linear as usize];
        let world = DMat4::from_translation(node.translation)
            * DMat4::from_mat3(linear)
            * DMat4::from_translation(centre)
            * DMat4::from_mat3(variant.up.rotation());
        read(json, binary, &fetch, &world).map_err(|error| at(error.to_string()))
    }
}

/// Reads the triangles of an asset, placed by `world`.
fn read(
    json: &[u8],
    binary: Option<&[u8]>,
    fetch: &dyn Fn(&str) -> Option<Vec<u8>>,
    world: &DMat4,
) -> Result<Surfaces, ContentError> {
    let root = mesh::root(json)?;
    let mut geometry = Geometry::default();
    let asset = Asset::open(&root, binary, fetch, &mut geometry);
    let mut out = Surfaces::default();
    for texture in &root.textures {
        let image = root.images.get(mesh::shown_image(texture));
        let fetched = image.and_then(|image| match (&image.uri, image.buffer_view) {
            (Some(uri), _) => mesh::resource(uri, fetch, &mut geometry),
            (None, Some(view)) => asset.view(view.value()).map(|(bytes, _)| bytes.to_vec()),
            (None, None) => None,
        });
        let decoded = match fetched.as_deref().map(Texture::decode) {
            Some(Ok(texture)) => Some(texture),
            Some(Err(error)) => {
                out.left_out.push(format!("a texture: {error}"));
                None
            }
            None => {
                out.left_out.push("a texture that is not there".to_owned());
                None
            }
        };
        out.materials.textures.push(decoded);
    }
    out.materials.materials = root.materials.iter().map(material).collect();
    // What has no material is white.
    let plain = out.materials.materials.len() as u32;
    out.materials.materials.push(Material::default());
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
        triangles.push(Triangle { corners: vertices.map(point), uv: vertices.map(uv), material, two_sided });
    }
    Ok(())
}
