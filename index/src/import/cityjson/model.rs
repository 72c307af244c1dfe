//! From what is written to what is there: vertices in metres, objects with their parents, triangles for every level.

use std::collections::BTreeMap;

use foresight_scheduler::lod_tree::Aabb;
use glam::{DMat4, DVec3};

use super::CityJsonFault;
use super::document::{Boundaries, CityObject, Document, Geometry, Lod, Part};
use super::georeference::{self, Placement};
use super::limits::{FARTHEST, MAX_FACE_VERTICES, MAX_LEVELS, MAX_PARENTS, MAX_TRIANGLES, MAX_VERTICES};
use super::triangulate::{Face, Triangulator};
use crate::world::{Georeference, Note, Severity};

/// A file as surfaces.
#[derive(Debug)]
pub struct Model {
    /// World coordinates, metres.
    pub(super) vertices: Vec<DVec3>,
    /// In order of their identifiers.
    pub(super) objects: Vec<Object>,
    pub(super) georeference: Option<Georeference>,
    pub(super) notes: Vec<Note>,
}

/// A city object.
#[derive(Debug)]
pub(super) struct Object {
    pub(super) kind: String,
    /// Index of the object that it is a part of.
    pub(super) parent: Option<usize>,
    /// Triangles by level of detail, in thousandths: level 2.2 is 2200.
    pub(super) levels: BTreeMap<i32, Vec<[u32; 3]>>,
}

/// What can be said about a file's content, in the order of the notes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Finding {
    Uneven,
    Degenerate,
    NoLevel,
    UnknownParent,
    NoSurface,
    UnknownGeometry,
}

impl Finding {
    fn say(self, count: u64) -> (Severity, String) {
        match self {
            Finding::Uneven => (
                Severity::Trap,
                format!("{count} faces cross themselves or are far from flat: their triangles are a guess"),
            ),
            Finding::Degenerate => (Severity::Repair, format!("{count} faces without area: left out")),
            Finding::NoLevel => {
                (Severity::Trap, format!("{count} geometries without a level of detail: taken as level 0"))
            }
            Finding::UnknownParent => {
                (Severity::Repair, format!("{count} objects name a parent that is not there: taken as whole objects"))
            }
            Finding::NoSurface => (Severity::Missing, format!("{count} geometries of points or lines: left out")),
            Finding::UnknownGeometry => {
                (Severity::Missing, format!("{count} geometries of a type that CityJSON does not know: left out"))
            }
        }
    }
}

/// How often each finding was made, and where first.
#[derive(Default)]
struct Findings(BTreeMap<Finding, (u64, String)>);

impl Findings {
    fn add(&mut self, finding: Finding, place: impl FnOnce() -> String) {
        self.0.entry(finding).or_insert_with(|| (0, place())).0 += 1;
    }
}

/// What a geometry's type makes of its boundaries.
enum Shape {
    /// Surfaces in arrays of this depth.
    Surfaces(u8),
    Instance,
    NoSurface,
    Unknown,
}

fn shape(kind: &str) -> Shape {
    match kind {
        "MultiSurface" | "CompositeSurface" => Shape::Surfaces(3),
        "Solid" => Shape::Surfaces(4),
        "MultiSolid" | "CompositeSolid" => Shape::Surfaces(5),
        "GeometryInstance" => Shape::Instance,
        "MultiPoint" | "MultiLineString" => Shape::NoSurface,
        _ => Shape::Unknown,
    }
}

/// A level of detail in thousandths.
fn level(lod: &Lod, place: &str) -> Result<i32, CityJsonFault> {
    let number = match lod {
        Lod::Number(number) => Some(*number),
        Lod::Text(text) => text.trim().parse().ok(),
    };
    match number.filter(|number| (0.0..=1000.0).contains(number)) {
        Some(number) => Ok((number * 1000.0).round() as i32),
        None => {
            let found = match lod {
                Lod::Number(number) => number.to_string(),
                Lod::Text(text) => format!("{text:?}"),
            };
            Err(CityJsonFault::new(format!("{place}.lod"), format!("{found}; expected a number from 0 to 1000")))
        }
    }
}

/// Checks that boundaries have the depth of their type and name vertices that there are.
fn check(boundaries: &Boundaries, depth: u8, vertices: usize, kind: &str, place: &str) -> Result<(), CityJsonFault> {
    let fault = |text: String| Err(CityJsonFault::new(format!("{place}.boundaries"), text));
    if boundaries.depth != depth && !boundaries.indices().is_empty() {
        return fault(format!("arrays {} deep; expected {depth} for {kind}", boundaries.depth));
    }
    match boundaries.indices().iter().find(|&&index| index as usize >= vertices) {
        Some(index) => fault(format!("vertex {index}; expected one of the {vertices} there are")),
        None => Ok(()),
    }
}

/// An object on the way in: where it is written, and what.
struct Written<'a> {
    part: usize,
    id: &'a str,
    object: &'a CityObject,
}

impl Written<'_> {
    fn place(&self, parts: &[Part], geometry: usize) -> String {
        parts[self.part].place(&format!("$.CityObjects[{:?}].geometry[{geometry}]", self.id))
    }
}

/// A template: its triangles by index of its own vertices.
struct Template {
    level: Option<i32>,
    triangles: Vec<[u32; 3]>,
}

struct Resolver<'a> {
    document: &'a Document,
    triangulator: Triangulator,
    findings: Findings,
    vertices: Vec<DVec3>,
    triangles: usize,
    /// Where each part's vertices begin.
    starts: Vec<usize>,
}

/// Resolves a document; notes name `file`.
pub(super) fn resolve(document: &Document, file: &str) -> Result<Model, CityJsonFault> {
    let parts = &document.parts;
    let mut written: Vec<Written> = Vec::new();
    for (part, content) in parts.iter().enumerate() {
        written.extend(content.objects.iter().map(|(id, object)| Written { part, id, object }));
    }
    written.sort_by_key(|written| written.id);
    if let Some(pair) = written.windows(2).find(|pair| pair[0].id == pair[1].id) {
        let place = parts[pair[1].part].place(&format!("$.CityObjects[{:?}]", pair[1].id));
        return Err(CityJsonFault::new(place, "an object of this identifier a second time; expected each once"));
    }
    let mut starts = Vec::new();
    let mut total = 0_usize;
    for part in parts {
        starts.push(total);
        total += part.vertices.len();
    }
    if total > MAX_VERTICES {
        return Err(CityJsonFault::new("$.vertices", format!("{total} vertices; expected at most {MAX_VERTICES}")));
    }

    let mut notes = Vec::new();
    let raw = raw_bounds(parts, &written)?;
    let metadata = document.metadata.as_ref();
    let placement = georeference::placement(document.transform, metadata, raw, file, &mut notes);
    let vertices = place_vertices(parts, placement, document.transform.is_some())?;
    let triangulator = Triangulator::new();
    let mut resolver =
        Resolver { document, triangulator, findings: Findings::default(), vertices, triangles: 0, starts };
    let templates = resolver.templates()?;
    let parents = resolver.parents(&written)?;
    let mut objects = Vec::with_capacity(written.len());
    for (of, parent) in written.iter().zip(parents) {
        let levels = resolver.levels(of, &templates)?;
        objects.push(Object { kind: of.object.kind.clone(), parent, levels });
    }
    let mut levels: Vec<i32> = objects.iter().flat_map(|object| object.levels.keys().copied()).collect();
    levels.sort_unstable();
    levels.dedup();
    if levels.len() > MAX_LEVELS {
        let found = format!("{} levels of detail; expected at most {MAX_LEVELS}", levels.len());
        return Err(CityJsonFault::new("$.CityObjects", found));
    }
    let Resolver { findings, vertices, .. } = resolver;
    let corners = objects.iter().flat_map(|object| object.levels.values().flatten().flatten());
    let bounds = corners.fold(Aabb::EMPTY, |sum, &corner| {
        let at = vertices[corner as usize];
        sum.union(Aabb { min: at, max: at })
    });
    if bounds.is_empty() {
        return Err(CityJsonFault::new("$.CityObjects", "no face of any object has an area; expected at least one"));
    }
    for (finding, (count, place)) in findings.0 {
        let (severity, text) = finding.say(count);
        notes.push(Note { severity, file: file.to_owned(), place, text });
    }
    let georeference = georeference::georeference(metadata, bounds, file, &mut notes);
    Ok(Model { vertices, objects, georeference, notes })
}

/// Bounds of the raw coordinates of all vertices that a geometry names; empty if none does. Checks every index.
fn raw_bounds(parts: &[Part], written: &[Written]) -> Result<Aabb, CityJsonFault> {
    let mut bounds = Aabb::EMPTY;
    for of in written {
        let vertices = &parts[of.part].vertices;
        for (at, geometry) in of.object.geometry.iter().flatten().enumerate() {
            let depth = match shape(&geometry.kind) {
                Shape::Surfaces(depth) => depth,
                Shape::Instance => 1,
                Shape::NoSurface | Shape::Unknown => continue,
            };
            check(&geometry.boundaries, depth, vertices.len(), &geometry.kind, &of.place(parts, at))?;
            for &index in geometry.boundaries.indices() {
                let vertex = DVec3::from_array(vertices[index as usize]);
                bounds = bounds.union(Aabb { min: vertex, max: vertex });
            }
        }
    }
    Ok(bounds)
}

fn place_vertices(parts: &[Part], placement: Placement, transformed: bool) -> Result<Vec<DVec3>, CityJsonFault> {
    let mut vertices = Vec::with_capacity(parts.iter().map(|part| part.vertices.len()).sum());
    for part in parts {
        for (at, &vertex) in part.vertices.iter().enumerate() {
            let placed = placement.apply(vertex);
            // NaN fails too.
            if !(placed.abs().max_element() <= FARTHEST && placed.is_finite()) {
                let how = if transformed { ", transformed" } else { "" };
                let found = format!("{placed} m{how}; expected within {FARTHEST:e} m");
                return Err(CityJsonFault::new(part.place(&format!("$.vertices[{at}]")), found));
            }
            vertices.push(placed);
        }
    }
    Ok(vertices)
}

impl Resolver<'_> {
    fn templates(&mut self) -> Result<Vec<Template>, CityJsonFault> {
        let document = self.document;
        let vertices: Vec<DVec3> = document.templates.vertices.iter().map(|&v| DVec3::from_array(v)).collect();
        let mut templates = Vec::new();
        for (at, geometry) in document.templates.templates.iter().enumerate() {
            let place = format!("$.geometry-templates.templates[{at}]");
            let mut triangles = Vec::new();
            match shape(&geometry.kind) {
                Shape::Surfaces(depth) => {
                    check(&geometry.boundaries, depth, vertices.len(), &geometry.kind, &place)?;
                    self.triangulate(geometry, &vertices, 0, &place, &mut triangles)?;
                }
                Shape::NoSurface => self.findings.add(Finding::NoSurface, || place.clone()),
                Shape::Instance | Shape::Unknown => self.findings.add(Finding::UnknownGeometry, || place.clone()),
            }
            let level = geometry.lod.as_ref().map(|lod| level(lod, &place)).transpose()?;
            templates.push(Template { level, triangles });
        }
        Ok(templates)
    }

    /// Adds the triangles of a geometry's surfaces, by index of `vertices`, those of the file beginning at `start`.
    fn triangulate(
        &mut self,
        geometry: &Geometry,
        vertices: &[DVec3],
        start: usize,
        place: &str,
        triangles: &mut Vec<[u32; 3]>,
    ) -> Result<(), CityJsonFault> {
        let before = triangles.len();
        for rings in geometry.boundaries.surfaces() {
            let corners: usize = rings.clone().map(<[u32]>::len).sum();
            if corners > MAX_FACE_VERTICES {
                let found = format!("a face of {corners} vertices; expected at most {MAX_FACE_VERTICES}");
                return Err(CityJsonFault::new(format!("{place}.boundaries"), found));
            }
            match self.triangulator.add(rings, &vertices[start..], triangles) {
                Face::Covered => {}
                Face::Uneven => self.findings.add(Finding::Uneven, || place.to_owned()),
                Face::Degenerate => self.findings.add(Finding::Degenerate, || place.to_owned()),
            }
        }
        for corner in triangles[before..].iter_mut().flatten() {
            *corner += start as u32;
        }
        self.count(triangles.len() - before, place)
    }

    fn count(&mut self, triangles: usize, place: &str) -> Result<(), CityJsonFault> {
        self.triangles += triangles;
        if self.triangles > MAX_TRIANGLES || self.vertices.len() > MAX_VERTICES {
            let found =
                format!("the triangles exceed {MAX_TRIANGLES}, or their vertices {MAX_VERTICES}; expected less");
            return Err(CityJsonFault::new(place, found));
        }
        Ok(())
    }

    /// The object that each object is a part of. Groups are no whole: their members stand for themselves.
    fn parents(&mut self, written: &[Written]) -> Result<Vec<Option<usize>>, CityJsonFault> {
        let parts = &self.document.parts;
        let find = |id: &str| written.binary_search_by(|of| of.id.cmp(id)).ok();
        let is_group = |at: usize| written[at].object.kind == "CityObjectGroup";
        let mut parents = vec![None; written.len()];
        for (parent, of) in written.iter().enumerate().filter(|&(at, _)| !is_group(at)) {
            for child in of.object.children.iter().flatten().filter_map(|id| find(id)) {
                parents[child] = parents[child].or(Some(parent));
            }
        }
        for (child, of) in written.iter().enumerate() {
            let named = of.object.parents.as_deref().unwrap_or_default();
            let known: Vec<usize> = named.iter().filter_map(|id| find(id)).collect();
            if known.len() < named.len() {
                let place = || parts[of.part].place(&format!("$.CityObjects[{:?}].parents", of.id));
                self.findings.add(Finding::UnknownParent, place);
            }
            if let Some(parent) = known.into_iter().find(|&parent| !is_group(parent)) {
                parents[child] = Some(parent);
            }
        }
        for (child, of) in written.iter().enumerate() {
            let above = std::iter::successors(parents[child], |&parent| parents[parent]).take(MAX_PARENTS + 1);
            let mut count = 0;
            for parent in above {
                count += 1;
                if parent == child || count > MAX_PARENTS {
                    let place = parts[of.part].place(&format!("$.CityObjects[{:?}].parents", of.id));
                    let found = if parent == child { "the object itself" } else { "more" };
                    let text =
                        format!("{found} among its parents' parents; expected at most {MAX_PARENTS}, in no circle");
                    return Err(CityJsonFault::new(place, text));
                }
            }
        }
        Ok(parents)
    }

    /// The triangles of an object by level of detail.
    fn levels(&mut self, of: &Written, templates: &[Template]) -> Result<BTreeMap<i32, Vec<[u32; 3]>>, CityJsonFault> {
        let mut levels: BTreeMap<i32, Vec<[u32; 3]>> = BTreeMap::new();
        for (at, geometry) in of.object.geometry.iter().flatten().enumerate() {
            let place = of.place(&self.document.parts, at);
            let mut own = geometry.lod.as_ref().map(|lod| level(lod, &place)).transpose()?;
            let mut triangles = Vec::new();
            match shape(&geometry.kind) {
                Shape::Surfaces(_) => {
                    let vertices = std::mem::take(&mut self.vertices);
                    let start = self.starts[of.part];
                    let added = self.triangulate(geometry, &vertices, start, &place, &mut triangles);
                    self.vertices = vertices;
                    added?;
                }
                Shape::Instance => own = own.or(self.instance(of, geometry, templates, &place, &mut triangles)?),
                Shape::NoSurface => {
                    self.findings.add(Finding::NoSurface, || place.clone());
                    continue;
                }
                Shape::Unknown => {
                    self.findings.add(Finding::UnknownGeometry, || place.clone());
                    continue;
                }
            }
            if triangles.is_empty() {
                continue;
            }
            if own.is_none() {
                self.findings.add(Finding::NoLevel, || place.clone());
            }
            levels.entry(own.unwrap_or(0)).or_default().append(&mut triangles);
        }
        Ok(levels)
    }

    /// Adds a template's triangles at the instance's reference point: each corner is matrix · vertex + point. Gives the
    /// template's level.
    fn instance(
        &mut self,
        of: &Written,
        geometry: &Geometry,
        templates: &[Template],
        place: &str,
        triangles: &mut Vec<[u32; 3]>,
    ) -> Result<Option<i32>, CityJsonFault> {
        let number = geometry.template.and_then(|number| usize::try_from(number).ok());
        let Some(template) = number.and_then(|number| templates.get(number)) else {
            let found = geometry.template.map_or_else(|| "none".to_owned(), |number| number.to_string());
            let text = format!("{found}; expected one of the {} templates there are", templates.len());
            return Err(CityJsonFault::new(format!("{place}.template"), text));
        };
        let [point] = *geometry.boundaries.indices() else {
            let found = geometry.boundaries.indices().len();
            let text = format!("{found} vertices; expected the one reference point of an instance");
            return Err(CityJsonFault::new(format!("{place}.boundaries"), text));
        };
        let point = self.vertices[self.starts[of.part] + point as usize];
        // Rows in the file, columns here.
        let matrix = geometry.matrix.map_or(DMat4::IDENTITY, |rows| DMat4::from_cols_array(&rows).transpose());
        let source = &self.document.templates.vertices;
        let mut number: BTreeMap<u32, u32> = BTreeMap::new();
        for &triangle in &template.triangles {
            let mut corners = [0; 3];
            for (corner, &vertex) in corners.iter_mut().zip(&triangle) {
                *corner = match number.get(&vertex) {
                    Some(&known) => known,
                    None => {
                        let at = matrix.transform_point3(DVec3::from_array(source[vertex as usize])) + point;
                        if !(at.is_finite() && at.abs().max_element() <= FARTHEST) {
                            let text = format!("a corner at {at} m; expected within {FARTHEST:e} m");
                            return Err(CityJsonFault::new(format!("{place}.transformationMatrix"), text));
                        }
                        self.vertices.push(at);
                        number.insert(vertex, (self.vertices.len() - 1) as u32);
                        (self.vertices.len() - 1) as u32
                    }
                };
            }
            triangles.push(corners);
        }
        self.count(template.triangles.len(), place)?;
        Ok(template.level)
    }
}
