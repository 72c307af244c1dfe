//! What a glTF asset costs once decoded, and where its vertices lie. Indices and lengths of the asset are checked here
//! one by one: nothing in it is trusted.

use std::borrow::Cow;
use std::collections::BTreeSet;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat4, DQuat, DVec3};
use gltf::json::accessor::{Accessor, ComponentType};
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::validation::Checked;
use gltf::json::{Index, Root, Value};

use super::content::ContentError;
use super::limits::MAX_POINTS;
use super::limits::MAX_TRIANGLES;

/// Geometry of an asset in its own axes.
#[derive(Debug, Default)]
pub(crate) struct Geometry {
    /// Vertex and index buffers, and every image with its mips.
    pub(crate) decoded_bytes: u64,
    /// Vertices in the asset's space, or corners of boxes around them.
    pub(crate) points: Vec<DVec3>,
    /// True if `points` are the vertices themselves.
    pub(crate) exact: bool,
    /// True if a mesh is drawn at places that are not looked at: `points` do not bound it.
    pub(crate) instanced: bool,
    /// Σ over the triangles of ½ (b − a) × (c − a): their area and where they face, m².
    pub(crate) area_vector: DVec3,
    /// Σ of the triangles' areas, m².
    pub(crate) area: f64,
    /// Number of triangles summed.
    pub(crate) triangles: usize,
    /// Images whose size could not be read; they count for nothing in `decoded_bytes`.
    pub(crate) unread_images: u32,
    /// Vertices that are not finite; they are left out.
    pub(crate) bad_vertices: u32,
    /// Bytes of files that the asset names.
    pub(crate) external_bytes: u64,
    /// Those files.
    pub(crate) external_files: Vec<String>,
    /// Buffers or images that the asset names and that are not there.
    pub(crate) missing_files: Vec<String>,
}

/// A glTF asset's JSON.
pub(crate) fn root(json: &[u8]) -> Result<Root, ContentError> {
    let root = Root::from_slice(json)
        .map_err(|error| ContentError::new("glTF JSON", format!("{error}; expected a glTF 2.0 asset")))?;
    if !root.asset.version.starts_with("2.") {
        let found = format!("version {:?}; expected \"2.0\"", root.asset.version);
        return Err(ContentError::new("$.asset.version", found));
    }
    Ok(root)
}

/// Reads the geometry of an asset. `binary` is the GLB's binary chunk; `fetch` reads a file that the asset names.
pub(crate) fn read(
    json: &[u8],
    binary: Option<&[u8]>,
    fetch: &dyn Fn(&str) -> Option<Vec<u8>>,
) -> Result<Geometry, ContentError> {
    let root = root(json)?;
    let mut geometry = Geometry { exact: true, ..Geometry::default() };
    let asset = Asset::open(&root, binary, fetch, &mut geometry);
    asset.images(fetch, &mut geometry);
    asset.count_buffers(&mut geometry);
    asset.place(&mut geometry)?;
    Ok(geometry)
}

/// The bytes behind a data URI or a file's name.
pub(crate) fn resource(uri: &str, fetch: &dyn Fn(&str) -> Option<Vec<u8>>, geometry: &mut Geometry) -> Option<Vec<u8>> {
    if uri.starts_with("data:") {
        return inline(uri);
    }
    let bytes = fetch(uri);
    match &bytes {
        Some(bytes) => {
            geometry.external_bytes = geometry.external_bytes.saturating_add(bytes.len() as u64);
            geometry.external_files.push(uri.to_owned());
        }
        None => geometry.missing_files.push(uri.to_owned()),
    }
    bytes
}

/// The bytes inside a data URI.
pub(crate) fn inline(uri: &str) -> Option<Vec<u8>> {
    STANDARD.decode(uri.strip_prefix("data:")?.split_once(";base64,")?.1).ok()
}

/// An asset with the bytes of its buffers.
pub(crate) struct Asset<'a> {
    pub(crate) root: &'a Root,
    buffers: Vec<Option<Cow<'a, [u8]>>>,
}

impl<'a> Asset<'a> {
    /// Reads the buffers; what is missing is noted in `geometry`.
    pub(crate) fn open(
        root: &'a Root,
        binary: Option<&'a [u8]>,
        fetch: &dyn Fn(&str) -> Option<Vec<u8>>,
        geometry: &mut Geometry,
    ) -> Asset<'a> {
        let mut buffers = Vec::with_capacity(root.buffers.len().min(1024));
        for (index, buffer) in root.buffers.iter().enumerate() {
            buffers.push(match &buffer.uri {
                None if index == 0 => binary.map(Cow::Borrowed),
                None => None,
                Some(uri) => resource(uri, fetch, geometry).map(Cow::Owned),
            });
        }
        Asset { root, buffers }
    }

    /// Adds each image that a texture shows: 4 bytes a pixel, and a third more for the mips.
    fn images(&self, fetch: &dyn Fn(&str) -> Option<Vec<u8>>, geometry: &mut Geometry) {
        let mut shown = BTreeSet::new();
        for texture in &self.root.textures {
            shown.insert(shown_image(texture));
        }
        for image in shown.into_iter().filter_map(|index| self.root.images.get(index)) {
            let fetched;
            let bytes = match (&image.uri, image.buffer_view) {
                (Some(uri), _) => {
                    fetched = resource(uri, fetch, geometry);
                    fetched.as_deref()
                }
                (None, Some(view)) => self.view(view.value()).map(|(bytes, _)| bytes),
                (None, None) => None,
            };
            match bytes.and_then(|bytes| imagesize::blob_size(bytes).ok()) {
                Some(size) => {
                    let pixels = (size.width as u64).saturating_mul(size.height as u64);
                    geometry.decoded_bytes = geometry.decoded_bytes.saturating_add(pixels.saturating_mul(16) / 3);
                }
                None => geometry.unread_images += 1,
            }
        }
    }

    /// The bytes of a buffer view and its stride; `None` if it lies outside its buffer or is compressed.
    pub(crate) fn view(&self, index: usize) -> Option<(&[u8], Option<usize>)> {
        let view = self.root.buffer_views.get(index)?;
        let compressed = |name: &String| name.ends_with("_meshopt_compression");
        if view.extensions.iter().any(|extensions| extensions.others.keys().any(compressed)) {
            return None;
        }
        let buffer = self.buffers.get(view.buffer.value())?.as_deref()?;
        let start = usize::try_from(view.byte_offset.map_or(0, |offset| offset.0)).ok()?;
        let end = start.checked_add(usize::try_from(view.byte_length.0).ok()?)?;
        Some((buffer.get(start..end)?, view.byte_stride.map(|stride| stride.0)))
    }

    /// Adds the vertex and index buffers as they are uploaded: each accessor once, tightly packed.
    fn count_buffers(&self, geometry: &mut Geometry) {
        let mut used = BTreeSet::new();
        for primitive in self.root.meshes.iter().flat_map(|mesh| &mesh.primitives) {
            used.extend(primitive.attributes.values().map(Index::value));
            used.extend(primitive.indices.iter().map(Index::value));
            for target in primitive.targets.iter().flatten() {
                let parts = [target.positions, target.normals, target.tangents];
                used.extend(parts.iter().flatten().map(Index::value));
            }
        }
        for accessor in used.into_iter().filter_map(|index| self.root.accessors.get(index)) {
            let bytes = accessor.count.0.saturating_mul(element_bytes(accessor).unwrap_or(0) as u64);
            geometry.decoded_bytes = geometry.decoded_bytes.saturating_add(bytes);
        }
    }

    /// Places every mesh.
    fn place(&self, geometry: &mut Geometry) -> Result<(), ContentError> {
        walk(self.root, &mut |node, transform, primitives| {
            geometry.instanced |=
                node.extensions.iter().any(|extensions| extensions.others.contains_key("EXT_mesh_gpu_instancing"));
            for primitive in primitives {
                self.primitive(primitive, transform, geometry);
            }
        })
    }

    fn primitive(&self, primitive: &Primitive, transform: &DMat4, geometry: &mut Geometry) {
        let Some(index) = primitive.attributes.get(&Checked::Valid(Semantic::Positions)) else {
            return;
        };
        let Some(accessor) = self.root.accessors.get(index.value()) else {
            return;
        };
        let first = geometry.points.len();
        let room = MAX_POINTS.saturating_sub(first);
        let vertices = self.elements(accessor).filter(|_| accessor.count.0 <= room as u64);
        let Some(vertices) = vertices else {
            geometry.exact = false;
            let corners = corners(accessor).into_iter().flatten();
            geometry.points.extend(corners.map(|corner| transform.transform_point3(corner)).filter(|p| p.is_finite()));
            return;
        };
        let point = |at: usize| transform.transform_point3(vertices.vec3(at));
        for at in 0..vertices.count {
            let placed = point(at);
            if placed.is_finite() {
                geometry.points.push(placed);
            } else {
                geometry.bad_vertices = geometry.bad_vertices.saturating_add(1);
            }
        }
        if primitive.mode != Checked::Valid(Mode::Triangles) {
            return;
        }
        let indices =
            primitive.indices.map(|index| self.root.accessors.get(index.value()).and_then(|a| self.elements(a)));
        let count = match &indices {
            None => vertices.count / 3,
            Some(indices) => indices.as_ref().map_or(0, |indices| indices.count / 3),
        };
        if count > MAX_TRIANGLES.saturating_sub(geometry.triangles) {
            return;
        }
        geometry.triangles += count;
        let mut triangle = |corners: [usize; 3]| {
            let [a, b, c] = corners.map(|at| if at < vertices.count { point(at) } else { DVec3::NAN });
            let area = 0.5 * (b - a).cross(c - a);
            if area.is_finite() {
                geometry.area_vector += area;
                geometry.area += area.length();
            }
        };
        match indices {
            None => (0..count).for_each(|t| triangle([3 * t, 3 * t + 1, 3 * t + 2])),
            Some(Some(indices)) if indices.components == 1 => {
                let at = |i: usize| indices.component(i, 0) as usize;
                (0..count).for_each(|t| triangle([at(3 * t), at(3 * t + 1), at(3 * t + 2)]));
            }
            Some(_) => {}
        }
    }

    /// The elements of an accessor; `None` if they are not there, compressed, sparse or out of range.
    pub(crate) fn elements(&self, accessor: &Accessor) -> Option<Elements<'_>> {
        if accessor.sparse.is_some() {
            return None;
        }
        let (bytes, stride) = self.view(accessor.buffer_view?.value())?;
        let size = element_bytes(accessor)?;
        let stride = stride.unwrap_or(size).max(size);
        let start = usize::try_from(accessor.byte_offset.map_or(0, |offset| offset.0)).ok()?;
        let bytes = bytes.get(start..)?;
        Elements::new(bytes.into(), stride, accessor)
    }
}

/// Walks the scene: each node with its transform and the primitives of its mesh.
pub(crate) fn walk(
    root: &Root,
    visit: &mut dyn FnMut(&gltf::json::Node, &DMat4, &[Primitive]),
) -> Result<(), ContentError> {
    let mut seen = vec![false; root.nodes.len()];
    let mut stack: Vec<(usize, DMat4)> = Vec::new();
    match root.scene.map_or(root.scenes.first(), |scene| root.scenes.get(scene.value())) {
        Some(scene) => stack.extend(scene.nodes.iter().rev().map(|node| (node.value(), DMat4::IDENTITY))),
        None => {
            let mut beneath = vec![false; root.nodes.len()];
            for child in root.nodes.iter().flat_map(|node| node.children.iter().flatten()) {
                if let Some(flag) = beneath.get_mut(child.value()) {
                    *flag = true;
                }
            }
            stack.extend((0..root.nodes.len()).rev().filter(|&node| !beneath[node]).map(|n| (n, DMat4::IDENTITY)));
        }
    }
    while let Some((index, above)) = stack.pop() {
        let place = || format!("$.nodes[{index}]");
        let Some(node) = root.nodes.get(index) else {
            return Err(ContentError::new(place(), format!("not there; expected one of {} nodes", root.nodes.len())));
        };
        if std::mem::replace(&mut seen[index], true) {
            return Err(ContentError::new(place(), "beneath two nodes or itself; expected a tree".to_owned()));
        }
        let transform = above * local(node);
        if !transform.is_finite() {
            return Err(ContentError::new(place(), "a transform that is not finite; expected numbers".to_owned()));
        }
        let primitives = match node.mesh {
            None => &[][..],
            Some(mesh) => match root.meshes.get(mesh.value()) {
                Some(mesh) => &mesh.primitives,
                None => {
                    let found = format!("mesh {}; expected one of {}", mesh.value(), root.meshes.len());
                    return Err(ContentError::new(place(), found));
                }
            },
        };
        visit(node, &transform, primitives);
        stack.extend(node.children.iter().flatten().rev().map(|child| (child.value(), transform)));
    }
    Ok(())
}

/// The image that a texture shows: an extension's (WebP, KTX2) in place of the fallback.
pub(crate) fn shown_image(texture: &gltf::json::Texture) -> usize {
    let extensions = texture.extensions.iter().flat_map(|extensions| extensions.others.values());
    let extended = extensions.filter_map(|extension| usize::try_from(extension.get("source")?.as_u64()?).ok()).next();
    extended.unwrap_or(texture.source.value())
}

/// A node's own transform.
fn local(node: &gltf::json::Node) -> DMat4 {
    if let Some(matrix) = node.matrix {
        return DMat4::from_cols_array(&matrix.map(f64::from));
    }
    let vector =
        |given: Option<[f32; 3]>, default: DVec3| given.map_or(default, |v| DVec3::from_array(v.map(f64::from)));
    let rotation = node.rotation.map_or(DQuat::IDENTITY, |q| DQuat::from_array(q.0.map(f64::from)));
    let rotation = if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY };
    DMat4::from_scale_rotation_translation(
        vector(node.scale, DVec3::ONE),
        rotation,
        vector(node.translation, DVec3::ZERO),
    )
}

pub(crate) fn element_bytes(accessor: &Accessor) -> Option<usize> {
    match (&accessor.component_type, &accessor.type_) {
        (Checked::Valid(kind), Checked::Valid(shape)) => Some(kind.0.size() * shape.multiplicity()),
        _ => None,
    }
}

/// The corners of the box that an accessor declares.
fn corners(accessor: &Accessor) -> Option<[DVec3; 8]> {
    let vector = |value: &Option<Value>| {
        let array = value.as_ref()?.as_array()?;
        let number = |at: usize| array.get(at)?.as_f64();
        Some(DVec3::new(number(0)?, number(1)?, number(2)?))
    };
    let scale = match (&accessor.component_type, accessor.normalized) {
        (Checked::Valid(kind), true) => normalisation(kind.0),
        _ => 1.0,
    };
    let (min, max) = (vector(&accessor.min)? * scale, vector(&accessor.max)? * scale);
    let pick = |bits: usize| {
        let axis = |at: usize| if bits >> at & 1 == 1 { max[at] } else { min[at] };
        DVec3::new(axis(0), axis(1), axis(2))
    };
    Some(std::array::from_fn(pick))
}

/// What a normalised integer is multiplied by.
fn normalisation(kind: ComponentType) -> f64 {
    match kind {
        ComponentType::I8 => 1.0 / 127.0,
        ComponentType::U8 => 1.0 / 255.0,
        ComponentType::I16 => 1.0 / 32767.0,
        ComponentType::U16 => 1.0 / 65535.0,
        ComponentType::U32 | ComponentType::F32 => 1.0,
    }
}

/// An accessor's elements, every one of which lies inside `bytes`.
#[derive(Debug)]
pub(crate) struct Elements<'a> {
    bytes: Cow<'a, [u8]>,
    stride: usize,
    pub(crate) count: usize,
    kind: ComponentType,
    pub(crate) components: usize,
    normalized: bool,
}

impl<'a> Elements<'a> {
    /// Elements that lie `stride` bytes apart; `None` if the accessor has no known type.
    pub(crate) fn new(bytes: Cow<'a, [u8]>, stride: usize, accessor: &Accessor) -> Option<Elements<'a>> {
        let (Checked::Valid(kind), Checked::Valid(shape)) = (&accessor.component_type, &accessor.type_) else {
            return None;
        };
        let (components, count) = (shape.multiplicity(), usize::try_from(accessor.count.0).ok()?);
        let needed = count
            .checked_sub(1)
            .map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(kind.0.size() * components))?;
        let normalized = accessor.normalized;
        (needed <= bytes.len()).then_some(Elements { bytes, stride, count, kind: kind.0, components, normalized })
    }

    /// Overwrites an element; false if there is none of that number or size.
    #[cfg(feature = "orthoviews")]
    pub(crate) fn replace(&mut self, element: usize, value: &[u8]) -> bool {
        if element >= self.count || value.len() != self.kind.size() * self.components {
            return false;
        }
        let at = element * self.stride;
        self.bytes.to_mut()[at..at + value.len()].copy_from_slice(value);
        true
    }

    /// One component as stored; integers without their normalisation.
    pub(crate) fn component(&self, element: usize, component: usize) -> f64 {
        let at = element * self.stride + component * self.kind.size();
        let b = &self.bytes[at..];
        match self.kind {
            ComponentType::I8 => f64::from(b[0] as i8),
            ComponentType::U8 => f64::from(b[0]),
            ComponentType::I16 => f64::from(i16::from_le_bytes([b[0], b[1]])),
            ComponentType::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])),
            ComponentType::U32 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            ComponentType::F32 => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
        }
    }

    /// One component as it is meant.
    pub(crate) fn normalised(&self, element: usize, component: usize) -> f64 {
        let scale = if self.normalized { normalisation(self.kind) } else { 1.0 };
        self.component(element, component) * scale
    }

    /// A vertex; NaN if the elements have fewer than 3 components.
    pub(crate) fn vec3(&self, element: usize) -> DVec3 {
        if self.components < 3 {
            return DVec3::NAN;
        }
        DVec3::new(self.normalised(element, 0), self.normalised(element, 1), self.normalised(element, 2))
    }
}
