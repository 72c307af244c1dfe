//! From walked tiles to a world: contents are read, once each and in parallel; the vertical is found; what shows
//! nothing is pruned; errors are made monotone; the tree is built.

use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, LodTreeError, Representation};
use glam::DVec3;
use rayon::prelude::*;

use super::content::{self, ContentKind, Placed};
use super::limits::MAX_NOTED_FILES;
use super::resolve::{Folder, folder_of};
use super::walk::{NONE, Placement, Variant, Walked};
use super::{Places, Tiles3dError};
use crate::geodesy::{WGS84_A, WGS84_B};
use crate::ground::{Ground, LeafHeights};
use crate::uris::UriTable;
use crate::world::{Georeference, Note, Severity, World, WorldKind};

/// Contents further than this from the origin are taken as Earth-centred, metres.
const PLANETARY: f64 = 6.0e6;

/// Contents further than this from the origin are refused, metres: an area must still be an f32.
const FARTHEST: f64 = 1.0e12;

/// A content file that was read.
struct Read {
    wire_bytes: u32,
    decoded_bytes: u32,
    /// For each of the file's variants, in order: what it shows, if vertices are known.
    placed: Vec<Option<Placed>>,
    /// What was found, where (a byte or a JSON path; empty for the whole file), and its particulars.
    notes: Vec<(Finding, String, String)>,
    files: Vec<String>,
}

/// What can be said about a content file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Finding {
    NotThere,
    Unreadable,
    NoMesh,
    NotExact,
    BadVertices,
    UnreadImages,
    MissingFiles,
    TooLarge,
    TooFar,
}

/// A world and what it was made of.
pub(crate) struct Assembled {
    pub(crate) world: World,
    /// Files that it was read from.
    pub(crate) files: Vec<String>,
    /// If they were asked for.
    pub(crate) places: Option<Places>,
}

/// Builds the world, `placed` with where its contents stand.
pub(crate) fn assemble(folder: &Folder, name: &str, walked: Walked, placed: bool) -> Result<Assembled, Tiles3dError> {
    let Walked { nodes, variants, linears, files, mut other_files, uris, mut notes, has_region, credit, .. } = walked;
    let is_placed = placed;
    let mut of_file: Vec<Vec<u32>> = vec![Vec::new(); files.len()];
    for (id, variant) in variants.iter().enumerate() {
        of_file[variant.file as usize].push(id as u32);
    }
    let read_one = |(file, ids): (&String, &Vec<u32>)| {
        let linear = |id: &u32| &linears[variants[*id as usize].linear as usize];
        let wanted = ids.iter().map(|id| (&variants[*id as usize], linear(id)));
        read_content(folder, file, &wanted.collect::<Vec<_>>())
    };
    let read: Vec<Read> = folder.source.in_parallel(|| files.par_iter().zip(&of_file).map(read_one).collect());
    let mut placed: Vec<Option<Placed>> = vec![None; variants.len()];
    for (read, ids) in read.iter().zip(&of_file) {
        for (&id, &found) in ids.iter().zip(&read.placed) {
            placed[id as usize] = found;
        }
    }
    summarise(&files, &read, &mut notes);
    other_files.extend(files.iter().zip(&read).filter(|(_, read)| read.wire_bytes > 0).map(|(file, _)| file.clone()));
    other_files.extend(read.iter().flat_map(|read| read.files.iter().cloned()));

    let scene = Scene { nodes: &nodes, variants: &variants, placed: &placed, read: &read };
    let root_file = folder.at(name);
    let shows = scene.shows();
    if !shows.first().is_some_and(|&root| root) {
        let first = notes.first().map_or_else(String::new, |note| format!(" ({note})"));
        return Err(Tiles3dError::Empty { file: root_file, first });
    }
    let leaves = scene.leaves(&shows);
    let middle = leaves.iter().fold(Aabb::EMPTY, |sum, &leaf| sum.union(scene.bounds(leaf))).centre();
    let facing = scene.facing(&leaves);
    let (up, is_earth) = orientation(middle, has_region, facing, name, &mut notes);
    notes.extend(scene.loose_boxes(&leaves, up, name));
    let (tree, uris, nodes_of) =
        scene.build(&shows, uris, name, &mut notes).map_err(|source| Tiles3dError::Tree { file: root_file, source })?;
    let heights = leaves.iter().map(|&leaf| scene.height(leaf, up));
    let ground = Ground::Leaves(LeafHeights::new(middle.dot(up), heights));
    let georeference = is_earth.then_some(Georeference::Ecef);
    let world = World {
        name: String::new(),
        kind: WorldKind::Tiles3d,
        tree,
        uris,
        up,
        ground,
        georeference,
        root_sample: None,
        notes,
    };
    let places = is_placed.then(|| {
        let place = |&node: &u32| (nodes[node as usize].variant, nodes[node as usize].translation);
        Places { representations: nodes_of.iter().map(place).collect(), variants, linears, files, credit }
    });
    Ok(Assembled { world, files: other_files, places })
}

fn read_content(folder: &Folder, file: &str, wanted: &[(&Variant, &glam::DMat3)]) -> Read {
    let mut read = Read {
        wire_bytes: 0,
        decoded_bytes: 0,
        placed: vec![None; wanted.len()],
        notes: Vec::new(),
        files: Vec::new(),
    };
    let (bytes, stored) = match folder.read_stored(file) {
        Ok((_, 0)) => {
            read.notes.push((Finding::NotThere, String::new(), "an empty file".to_owned()));
            return read;
        }
        Ok(found) => found,
        Err(error) => {
            read.notes.push((Finding::NotThere, String::new(), error.to_string()));
            return read;
        }
    };
    let base = folder_of(file).to_owned();
    let content = match content::parse(&bytes, &|uri| Some(folder.fetch(&base, uri)?.1)) {
        Ok(content) => content,
        Err(error) => {
            read.notes.push((Finding::Unreadable, error.place, error.fault));
            return read;
        }
    };
    let geometry = &content.geometry;
    let wire = stored.saturating_add(geometry.external_bytes);
    if wire > u64::from(u32::MAX) || geometry.decoded_bytes > u64::from(u32::MAX) {
        let found = format!("{wire} bytes on the wire and {} in memory", geometry.decoded_bytes);
        read.notes.push((Finding::TooLarge, String::new(), found));
        return read;
    }
    read.wire_bytes = wire as u32;
    read.decoded_bytes = geometry.decoded_bytes as u32;
    for (slot, (variant, linear)) in read.placed.iter_mut().zip(wanted) {
        *slot = content::place(&content, &variant.up.rotation(), linear);
        if let Some(placed) = slot
            && (placed.bounds.min.abs().max(placed.bounds.max.abs()).max_element() > FARTHEST
                || !placed.mean.is_finite())
        {
            let found = format!("vertices from {} to {}", placed.bounds.min, placed.bounds.max);
            read.notes.push((Finding::TooFar, String::new(), found));
            read.wire_bytes = 0;
            return read;
        }
    }
    let mut note = |happened: bool, finding: Finding, text: String| {
        if happened {
            read.notes.push((finding, String::new(), text));
        }
    };
    note(!content.kind.has_mesh(), Finding::NoMesh, kind_name(content.kind).to_owned());
    note(content.kind.has_mesh() && (!geometry.exact || geometry.instanced), Finding::NotExact, String::new());
    note(geometry.bad_vertices > 0, Finding::BadVertices, format!("{} of them", geometry.bad_vertices));
    note(geometry.unread_images > 0, Finding::UnreadImages, format!("{} of them", geometry.unread_images));
    note(!geometry.missing_files.is_empty(), Finding::MissingFiles, geometry.missing_files.join(", "));
    let resolved = geometry.external_files.iter().map(|uri| folder.resolve(&base, uri));
    read.files = resolved
        .filter_map(|target| match target {
            super::resolve::Target::File { file, .. } => Some(file),
            _ => None,
        })
        .collect();
    read
}

fn kind_name(kind: ContentKind) -> &'static str {
    match kind {
        ContentKind::Glb | ContentKind::Gltf => "a glTF",
        ContentKind::B3dm => "a batched model",
        ContentKind::I3dm => "an instanced model",
        ContentKind::Pnts => "a point cloud",
        ContentKind::Cmpt => "a composite",
    }
}

/// One note per kind of finding for the first files, and the count of the rest.
fn summarise(files: &[String], read: &[Read], notes: &mut Vec<Note>) {
    let mut findings: Vec<(Finding, &String, &String, &String)> = Vec::new();
    for (file, read) in files.iter().zip(read) {
        findings.extend(read.notes.iter().map(|(finding, place, text)| (*finding, file, place, text)));
    }
    findings.sort();
    for group in findings.chunk_by(|a, b| a.0 == b.0) {
        for (at, &(finding, file, place, text)) in group.iter().take(MAX_NOTED_FILES).enumerate() {
            let (severity, mut text) = finding.say(text);
            let unsaid = group.len().saturating_sub(MAX_NOTED_FILES);
            if at + 1 == MAX_NOTED_FILES && unsaid > 0 {
                text.push_str(&format!(" (and {unsaid} more files like it)"));
            }
            notes.push(Note { severity, file: file.clone(), place: place.clone(), text });
        }
    }
}

impl Finding {
    fn say(self, text: &str) -> (Severity, String) {
        match self {
            Finding::NotThere => (Severity::Missing, format!("{text}; its tile is without it")),
            Finding::Unreadable => (Severity::Missing, format!("{text}; its tile is without it")),
            Finding::TooLarge => (Severity::Missing, format!("{text}; expected below 4 GiB, its tile is without it")),
            Finding::TooFar => {
                (Severity::Missing, format!("{text}; expected within {FARTHEST:e} m, its tile is without it"))
            }
            Finding::NoMesh => {
                (Severity::Trap, format!("{text}: bounds as declared, bytes in memory counted as those of the file"))
            }
            Finding::NotExact => (
                Severity::Trap,
                "vertices compressed, instanced or not readable: bounds from what is declared".to_owned(),
            ),
            Finding::BadVertices => {
                (Severity::Repair, format!("vertices that are not finite, {text}: left out of the bounds"))
            }
            Finding::UnreadImages => {
                (Severity::Trap, format!("images of unknown size, {text}: not counted in the bytes in memory"))
            }
            Finding::MissingFiles => (Severity::Missing, format!("names {text:?}, not there: not counted")),
        }
    }
}

/// Direction away from the ellipsoid through a point near its surface: the gradient of x²/a² + y²/a² + z²/b².
fn vertical(at: DVec3) -> DVec3 {
    let gradient = at / DVec3::new(WGS84_A * WGS84_A, WGS84_A * WGS84_A, WGS84_B * WGS84_B);
    gradient.try_normalize().unwrap_or(DVec3::Z)
}

/// True if surfaces clearly face `axis` rather than `other`: more than half of their area goes that way, and less than
/// half of that the other way.
fn faces(facing: DVec3, axis: DVec3, other: DVec3) -> bool {
    facing.dot(axis) > 0.5 && facing.dot(other).abs() < 0.5 * facing.dot(axis)
}

/// Declared boxes are loose if they are so many times as high as what they hold.
const LOOSE: f64 = 3.0;

/// The vertical, and whether the world is Earth-centred. What is bounded by regions or lies an Earth's radius away is,
/// unless its surfaces face z and not away from the Earth (a projected system with large northings). Elsewhere z is up,
/// as 3D Tiles says, unless surfaces face another axis.
fn orientation(middle: DVec3, has_region: bool, facing: DVec3, name: &str, notes: &mut Vec<Note>) -> (DVec3, bool) {
    let mut trap = |place: &str, text: String| {
        let (file, place) = (name.to_owned(), place.to_owned());
        notes.push(Note { severity: Severity::Trap, file, place, text });
    };
    if has_region || middle.length() > PLANETARY {
        let up = vertical(middle);
        if has_region || !faces(facing, DVec3::Z, up) {
            return (up, true);
        }
        let far = middle.length();
        trap("", format!("{far:.0} m from the origin, but surfaces face +z: taken as projected coordinates, +z up"));
        return (DVec3::Z, false);
    }
    let axes = [("+x", DVec3::X), ("-x", DVec3::NEG_X), ("+y", DVec3::Y), ("-y", DVec3::NEG_Y)];
    if let Some((axis, up)) = axes.into_iter().find(|&(_, up)| faces(facing, up, DVec3::Z)) {
        let percent = (100.0 * facing.dot(up)).round();
        let text =
            format!("up is declared z, but surfaces face {axis} ({percent} % of their area): {axis} is taken as up");
        trap("$.asset.gltfUpAxis", text);
        return (up, false);
    }
    (DVec3::Z, false)
}

struct Scene<'a> {
    nodes: &'a [Placement],
    variants: &'a [Variant],
    placed: &'a [Option<Placed>],
    read: &'a [Read],
}

impl Scene<'_> {
    /// What a node's content costs, if it can be had.
    fn content(&self, node: u32) -> Option<&Read> {
        let variant = self.nodes[node as usize].variant;
        let read = &self.read[self.variants.get(variant as usize)?.file as usize];
        (read.wire_bytes > 0).then_some(read)
    }

    /// Which nodes have a content at or beneath them.
    fn shows(&self) -> Vec<bool> {
        let mut shows: Vec<bool> = (0..self.nodes.len() as u32).map(|node| self.content(node).is_some()).collect();
        for node in (1..self.nodes.len()).rev() {
            if shows[node] {
                shows[self.nodes[node].parent as usize] = true;
            }
        }
        shows
    }

    /// The nodes that will be leaves, in order.
    fn leaves(&self, shows: &[bool]) -> Vec<u32> {
        let mut inner = vec![false; self.nodes.len()];
        for (node, _) in self.nodes.iter().zip(shows).filter(|&(node, &shows)| shows && node.parent != NONE) {
            inner[node.parent as usize] = true;
        }
        (0..self.nodes.len() as u32).filter(|&node| shows[node as usize] && !inner[node as usize]).collect()
    }

    fn placed(&self, node: u32) -> Option<&Placed> {
        let variant = self.nodes[node as usize].variant as usize;
        if self.variants.get(variant)?.stand_in { None } else { self.placed[variant].as_ref() }
    }

    /// Bounds of what a node's own content shows: of its vertices, else as declared.
    fn bounds(&self, node: u32) -> Aabb {
        let given = &self.nodes[node as usize];
        match self.placed(node) {
            Some(Placed { bounds, .. }) => {
                Aabb { min: bounds.min + given.translation, max: bounds.max + given.translation }
            }
            None => given.declared,
        }
    }

    /// What to say where declared boxes are much higher than what the leaves show, by their medians.
    fn loose_boxes(&self, leaves: &[u32], up: DVec3, name: &str) -> Option<Note> {
        let placed = || leaves.iter().filter_map(|&leaf| Some((self.placed(leaf)?, &self.nodes[leaf as usize])));
        let median = |mut heights: Vec<f64>| {
            let middle = heights.len() / 2;
            (!heights.is_empty()).then(|| *heights.select_nth_unstable_by(middle, f64::total_cmp).1)
        };
        let height = |bounds: Aabb| (bounds.max - bounds.min).dot(up.abs());
        let declared = median(placed().map(|(_, node)| height(node.declared)).collect())?;
        let shown = median(placed().map(|(placed, _)| height(placed.bounds)).collect())?;
        (declared > LOOSE * shown).then(|| Note {
            severity: Severity::Trap,
            file: name.to_owned(),
            place: String::new(),
            text: format!(
                "declared boxes are {declared:.0} m high around contents of {shown:.1} m (medians over the leaves): bounds are \
                 taken from the contents"
            ),
        })
    }

    /// Mean height of a leaf's vertices; without vertices, that of the bottom of its bounds. Metres along up.
    fn height(&self, node: u32, up: DVec3) -> f64 {
        match self.placed(node) {
            Some(placed) => (placed.mean + self.nodes[node as usize].translation).dot(up),
            None => {
                let bounds = self.bounds(node);
                bounds.centre().dot(up) - (0.5 * (bounds.max - bounds.min)).dot(up.abs())
            }
        }
    }

    /// Sum of the area vectors of the leaves' surfaces over the sum of their areas: near a unit vector for terrain, near
    /// 0 for closed bodies, NaN without triangles.
    fn facing(&self, leaves: &[u32]) -> DVec3 {
        let (mut vector, mut area) = (DVec3::ZERO, 0.0);
        for placed in leaves.iter().filter_map(|&leaf| self.placed(leaf)) {
            vector += placed.area_vector;
            area += placed.area;
        }
        vector / area
    }

    /// The tree, with the address and the node of every representation.
    fn build(
        &self,
        shows: &[bool],
        mut uris: crate::uris::UriTableBuilder,
        name: &str,
        notes: &mut Vec<Note>,
    ) -> Result<(LodTree, UriTable, Vec<u32>), LodTreeError> {
        let mut builder = LodTreeBuilder::default();
        let mut nodes = Vec::new();
        // Open nodes: which, and the error of the nearest representation at or above each.
        let mut open: Vec<(u32, f32)> = Vec::new();
        let (mut clamped, mut worst) = (0_u64, 0.0_f32);
        for (id, node) in (0..self.nodes.len() as u32).zip(self.nodes) {
            if !shows[id as usize] {
                continue;
            }
            while let Some(&(top, _)) = open.last().filter(|&&(top, _)| top != node.parent) {
                self.close(&mut builder, top)?;
                open.pop();
            }
            builder.open()?;
            let above = open.last().map_or(f32::INFINITY, |&(_, error)| error);
            let mut nearest = above;
            if let Some(read) = self.content(id) {
                nearest = node.error.min(above);
                if node.error > above {
                    clamped += 1;
                    worst = worst.max(node.error - above);
                }
                builder.add(Representation {
                    wire_bytes: read.wire_bytes,
                    decoded_bytes: read.decoded_bytes,
                    error: nearest,
                    prerequisite: None,
                    direction: None,
                })?;
                uris.push(node.uri.0, node.uri.1);
                nodes.push(id);
            }
            open.push((id, nearest));
        }
        while let Some((top, _)) = open.pop() {
            self.close(&mut builder, top)?;
        }
        if clamped > 0 {
            let text = format!(
                "{clamped} tiles with an error above that of the tile they refine, by up to {worst} m: lowered to it"
            );
            notes.push(Note { severity: Severity::Repair, file: name.to_owned(), place: String::new(), text });
        }
        Ok((builder.finish()?, uris.finish(), nodes))
    }

    fn close(&self, builder: &mut LodTreeBuilder, node: u32) -> Result<(), LodTreeError> {
        let bounds = self.content(node).map(|_| self.bounds(node));
        builder.close(bounds, 1.0)
    }
}
