//! Pages of the tree: a subtree's nodes in preorder, cut where other pages take over, so that a client reads the pages
//! that its traversal touches and no others.
//!
//! ```text
//! 0   "FSNP", version (u8), elements of a surface (u8), level of the first cell (u8), 0
//! 8   place of the first cell along x, y, z (u64 each)
//! 32  the first cell's node
//!
//! node: halves (u8: bits 0 to 2 say which half of its parent it takes along x, y, z; bit 6 for a leaf; bit 7 for a page)
//!   of a page: hash (16 bytes), bytes (u32), summary
//!   else:      number of representations (u8), number of children (u8), for a leaf its bounds (6 f64), its ground (f64) and the
//!              shares of its surface (u16 each, in 65535ths), the representations, the children
//! representation: kind (u8: a direction's code, or 32 + level of detail; bit 7 if it tells what it shows), wire bytes, decoded
//!   bytes (u32 each), error (f32, metres), hash (16 bytes), what it shows of each element of a surface
//!   ([`Shown`], u8 each; not in version 1)
//! summary: leaves, nodes, orthoviews, their bytes, geometries, their bytes, decoded bytes (u64 each), bounds (6 f64)
//! ```
//!
//! Numbers are little-endian. Hashes are the first 16 bytes of BLAKE3 over the file named: the root page's hash therefore
//! covers everything.

use crate::octree::{Cell, LEVELS_MAX, Octree};
use crate::orthoview::Direction;
use foresight_scheduler::benefit::element::{HIDDEN, Shown};
use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;

/// Version that is written. Version 1, which does not tell what orthoviews hide, is read too.
pub const VERSION: u8 = 2;

/// Most bytes of a page that is written. Larger ones, up to [`READ_MAX`], are read.
pub const PAGE_MAX: usize = 32 << 10;

/// Most bytes of a page that is read.
pub const READ_MAX: usize = 1 << 20;

/// Bytes before the first node.
const HEADER: usize = 32;
/// Bit of a leaf.
const LEAF: u8 = 1 << 6;
/// Bit of a page.
const PAGE: u8 = 1 << 7;
/// Least kind of a geometry.
const GEOMETRY: u8 = 32;
/// Bit of a representation that tells what it shows.
const TELLS: u8 = 1 << 7;
/// Most levels of detail of a leaf's geometry.
pub const GEOMETRIES_MAX: u8 = 64;

/// First 16 bytes of the BLAKE3 hash of a file.
pub type Hash = [u8; 16];

/// The hash of a file's bytes.
pub fn hash(bytes: &[u8]) -> Hash {
    let mut short = [0; 16];
    short.copy_from_slice(&blake3::hash(bytes).as_bytes()[..16]);
    short
}

/// What a representation is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// The cell seen along a direction.
    Orthoview(Direction),
    /// The leaf's geometry; 0 is the finest level of detail.
    Geometry(u8),
}

/// A file that shows a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stored {
    /// What it is.
    pub kind: Kind,
    /// Its bytes.
    pub wire_bytes: u32,
    /// What it takes in a client's memory.
    pub decoded_bytes: u32,
    /// Metres.
    pub error: f32,
    /// Of its bytes.
    pub hash: Hash,
    /// How well an orthoview shows each element of a surface, if it tells.
    pub shown: Option<Shown>,
}

/// What a leaf holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Leaf {
    /// Around what is in it, metres.
    pub bounds: Aabb,
    /// Height of the ground along up, metres.
    pub ground: f64,
    /// Of its surface by orientation, in 65535ths; as many as the page says.
    pub shares: Vec<u16>,
}

/// What lies in a subtree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Leaves.
    pub leaves: u64,
    /// Nodes, leaves included.
    pub nodes: u64,
    /// Orthoviews.
    pub orthoviews: u64,
    /// Their bytes on the wire.
    pub orthoview_bytes: u64,
    /// Geometries, every level of detail counted.
    pub geometries: u64,
    /// Their bytes on the wire.
    pub geometry_bytes: u64,
    /// Bytes in memory of both.
    pub decoded_bytes: u64,
    /// Around the leaves' contents, metres.
    pub bounds: Aabb,
}

impl Default for Summary {
    fn default() -> Summary {
        Summary {
            leaves: 0,
            nodes: 0,
            orthoviews: 0,
            orthoview_bytes: 0,
            geometries: 0,
            geometry_bytes: 0,
            decoded_bytes: 0,
            bounds: Aabb::EMPTY,
        }
    }
}

impl Summary {
    /// Adds what lies in another subtree.
    pub fn add(&mut self, other: &Summary) {
        let counts = [
            (&mut self.leaves, other.leaves),
            (&mut self.nodes, other.nodes),
            (&mut self.orthoviews, other.orthoviews),
            (&mut self.orthoview_bytes, other.orthoview_bytes),
            (&mut self.geometries, other.geometries),
            (&mut self.geometry_bytes, other.geometry_bytes),
            (&mut self.decoded_bytes, other.decoded_bytes),
        ];
        for (sum, more) in counts {
            *sum = sum.saturating_add(more);
        }
        self.bounds = self.bounds.union(other.bounds);
    }

    fn representation(&mut self, rep: &Stored) {
        let (count, bytes) = match rep.kind {
            Kind::Orthoview(_) => (&mut self.orthoviews, &mut self.orthoview_bytes),
            Kind::Geometry(_) => (&mut self.geometries, &mut self.geometry_bytes),
        };
        *count += 1;
        *bytes += u64::from(rep.wire_bytes);
        self.decoded_bytes += u64::from(rep.decoded_bytes);
    }
}

/// A page as another names it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PageReference {
    /// Of its bytes.
    pub hash: Hash,
    /// Its bytes.
    pub bytes: u32,
    /// What lies in it and beneath.
    pub summary: Summary,
}

/// A cell and what lies beneath, as far as the page holds it.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    /// Which.
    pub cell: Cell,
    /// What shows it.
    pub representations: Vec<Stored>,
    /// What it holds, at level 0 and only there.
    pub leaf: Option<Leaf>,
    /// The cells beneath, in order of their halves.
    pub children: Vec<Child>,
}

/// What lies beneath a node.
#[derive(Clone, Debug, PartialEq)]
pub enum Child {
    /// In the same page.
    Node(Node),
    /// In a page of its own.
    Page(Cell, PageReference),
}

impl Child {
    /// Its cell.
    pub fn cell(&self) -> Cell {
        match self {
            Child::Node(node) => node.cell,
            Child::Page(cell, _) => *cell,
        }
    }

    /// What lies in it and beneath.
    pub fn summary(&self) -> Summary {
        match self {
            Child::Node(node) => node.summary(),
            Child::Page(_, page) => page.summary,
        }
    }

    /// Bytes that it takes in a page.
    pub fn size(&self) -> usize {
        match self {
            Child::Node(node) => node.size(),
            Child::Page(..) => 1 + 16 + 4 + SUMMARY,
        }
    }
}

/// Bytes of a summary.
const SUMMARY: usize = 7 * 8 + 6 * 8;

impl Node {
    /// What lies in it and beneath. At most [`LEVELS_MAX`] calls deep.
    pub fn summary(&self) -> Summary {
        let mut sum = Summary { nodes: 1, ..Summary::default() };
        for rep in &self.representations {
            sum.representation(rep);
        }
        if let Some(leaf) = &self.leaf {
            sum.leaves = 1;
            sum.bounds = leaf.bounds;
        }
        for child in &self.children {
            sum.add(&child.summary());
        }
        sum
    }

    /// Bytes that it takes in a page, with what lies beneath.
    pub fn size(&self) -> usize {
        let own = 3 + self.leaf.as_ref().map_or(0, |leaf| 7 * 8 + 2 * leaf.shares.len());
        let tell = |rep: &Stored| 29 + rep.shown.map_or(0, |shown| shown.len());
        own + self.representations.iter().map(tell).sum::<usize>()
            + self.children.iter().map(Child::size).sum::<usize>()
    }
}

/// A fault in a page.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("byte {at}: {found}; expected {expected}")]
pub struct PageError {
    /// Where.
    pub at: usize,
    /// What is there.
    pub found: String,
    /// What ought to be.
    pub expected: &'static str,
}

/// Writes a page whose first node is `node`; its leaves' surfaces have `elements` shares.
pub fn encode(node: &Node, octree: &Octree, elements: u8) -> Vec<u8> {
    let mut out = Vec::with_capacity(HEADER + node.size());
    out.extend_from_slice(b"FSNP");
    out.extend([VERSION, elements, node.cell.level as u8, 0]);
    node.cell.place.iter().for_each(|at| out.extend(at.to_le_bytes()));
    put(&mut out, node, octree, elements);
    out
}

fn put(out: &mut Vec<u8>, node: &Node, octree: &Octree, elements: u8) {
    let leaf = if node.leaf.is_some() { LEAF } else { 0 };
    out.extend([octree.halves(node.cell) | leaf, node.representations.len() as u8, node.children.len() as u8]);
    if let Some(leaf) = &node.leaf {
        put_bounds(out, &leaf.bounds);
        out.extend(leaf.ground.to_le_bytes());
        (0..usize::from(elements)).for_each(|e| out.extend(leaf.shares.get(e).unwrap_or(&0).to_le_bytes()));
    }
    for rep in &node.representations {
        let kind = match rep.kind {
            Kind::Orthoview(direction) => direction.code(),
            Kind::Geometry(level) => GEOMETRY + level.min(GEOMETRIES_MAX - 1),
        };
        out.push(if rep.shown.is_some() { kind | TELLS } else { kind });
        out.extend(rep.wire_bytes.to_le_bytes());
        out.extend(rep.decoded_bytes.to_le_bytes());
        out.extend(rep.error.to_le_bytes());
        out.extend(rep.hash);
        if let Some(shown) = &rep.shown {
            (0..usize::from(elements)).for_each(|e| out.push(*shown.get(e).unwrap_or(&HIDDEN)));
        }
    }
    for child in &node.children {
        match child {
            Child::Node(node) => put(out, node, octree, elements),
            Child::Page(cell, page) => {
                out.push(octree.halves(*cell) | PAGE);
                out.extend(page.hash);
                out.extend(page.bytes.to_le_bytes());
                let s = &page.summary;
                let counts = [s.leaves, s.nodes, s.orthoviews, s.orthoview_bytes, s.geometries, s.geometry_bytes];
                counts.iter().chain([&s.decoded_bytes]).for_each(|count| out.extend(count.to_le_bytes()));
                put_bounds(out, &s.bounds);
            }
        }
    }
}

fn put_bounds(out: &mut Vec<u8>, bounds: &Aabb) {
    for value in bounds.min.to_array().into_iter().chain(bounds.max.to_array()) {
        out.extend(value.to_le_bytes());
    }
}

/// Reads a page.
///
/// # Errors
/// What is no page, is cut off, contradicts itself, or does not belong into this octree.
pub fn parse(bytes: &[u8], octree: &Octree) -> Result<Node, PageError> {
    if bytes.len() > READ_MAX {
        return Err(PageError { at: 0, found: format!("{} bytes", bytes.len()), expected: "at most 1 MiB" });
    }
    let mut reader = Reader { bytes, at: 0 };
    let magic = reader.take::<4>("\"FSNP\"")?;
    if &magic != b"FSNP" {
        return Err(reader.fault(4, String::from_utf8_lossy(&magic).into_owned(), "\"FSNP\""));
    }
    let [version, elements, level, _] = reader.take::<4>("version, elements and level")?;
    if !(1..=VERSION).contains(&version) {
        return Err(reader.fault(4, format!("version {version}"), "version 1 or 2"));
    }
    let mut place = [0; 3];
    for at in &mut place {
        *at = reader.u64("the place of a cell")?;
    }
    let cell = Cell { level: u32::from(level), place };
    let root = octree.root();
    let inside = cell.level <= root.level && (0..3).all(|axis| place[axis] < octree.cells_at(cell.level)[axis]);
    if !inside {
        return Err(reader.fault(24, format!("level {level}, place {place:?}"), "a cell of the world's octree"));
    }
    let [first] = reader.take::<1>("a node")?;
    if first & PAGE != 0 || first & 7 != octree.halves(cell) {
        return Err(reader.fault(1, format!("{first:#04x}"), "the node of the page's own cell"));
    }
    let node = reader.node(first, cell, octree, elements)?;
    match bytes.len() - reader.at {
        0 => Ok(node),
        more => Err(reader.fault(0, format!("{more} more bytes"), "the end")),
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    /// A fault in what began `back` bytes ago.
    fn fault(&self, back: usize, found: String, expected: &'static str) -> PageError {
        PageError { at: self.at.saturating_sub(back), found, expected }
    }

    fn take<const N: usize>(&mut self, expected: &'static str) -> Result<[u8; N], PageError> {
        let found = self.bytes.get(self.at..).and_then(|rest| rest.first_chunk::<N>());
        let taken = *found.ok_or_else(|| self.fault(0, "the end".to_owned(), expected))?;
        self.at += N;
        Ok(taken)
    }

    fn u64(&mut self, expected: &'static str) -> Result<u64, PageError> {
        self.take(expected).map(u64::from_le_bytes)
    }

    fn u32(&mut self, expected: &'static str) -> Result<u32, PageError> {
        self.take(expected).map(u32::from_le_bytes)
    }

    fn f64(&mut self, expected: &'static str) -> Result<f64, PageError> {
        self.take(expected).map(f64::from_le_bytes)
    }

    fn bounds(&mut self) -> Result<Aabb, PageError> {
        const EXPECTED: &str = "bounds: finite corners in order";
        let mut corner = || -> Result<DVec3, PageError> {
            Ok(DVec3::new(self.f64(EXPECTED)?, self.f64(EXPECTED)?, self.f64(EXPECTED)?))
        };
        let (min, max) = (corner()?, corner()?);
        let sound = min.is_finite() && max.is_finite() && min.cmple(max).all();
        if sound { Ok(Aabb { min, max }) } else { Err(self.fault(48, format!("{min} to {max}"), EXPECTED)) }
    }

    /// A node whose first byte is read. Levels fall from call to call: at most [`LEVELS_MAX`] deep.
    fn node(&mut self, first: u8, cell: Cell, octree: &Octree, elements: u8) -> Result<Node, PageError> {
        debug_assert!(cell.level <= LEVELS_MAX);
        let [representations, children] = self.take::<2>("numbers of representations and children")?;
        let is_leaf = first & LEAF != 0;
        if is_leaf != (cell.level == 0) || is_leaf != (children == 0) || children > 8 {
            let found = format!("level {} with {children} children, leaf {is_leaf}", cell.level);
            return Err(self.fault(3, found, "a leaf at level 0, and 1 to 8 children elsewhere"));
        }
        let leaf = if is_leaf { Some(self.leaf(elements)?) } else { None };
        let mut node = Node { cell, representations: Vec::new(), leaf, children: Vec::new() };
        for _ in 0..representations {
            let rep = self.representation(is_leaf, elements)?;
            if node.representations.last().is_some_and(|last| last.kind >= rep.kind) {
                return Err(self.fault(29, format!("{:?}", rep.kind), "representations in order, each once"));
            }
            node.representations.push(rep);
        }
        let mut last = None;
        for _ in 0..children {
            let [first] = self.take::<1>("a node")?;
            let halves = first & 7;
            let child = octree.child(cell, halves).filter(|_| first & !(7 | LEAF | PAGE) == 0);
            let child = child.filter(|_| last.replace(halves).is_none_or(|last| last < halves));
            let Some(child) = child else {
                return Err(self.fault(1, format!("{first:#04x}"), "the cells beneath in order, each once"));
            };
            node.children.push(if first & PAGE != 0 {
                Child::Page(child, self.page()?)
            } else {
                Child::Node(self.node(first, child, octree, elements)?)
            });
        }
        Ok(node)
    }

    fn leaf(&mut self, elements: u8) -> Result<Leaf, PageError> {
        let bounds = self.bounds()?;
        let ground = self.f64("the height of the ground")?;
        if !ground.is_finite() {
            return Err(self.fault(8, ground.to_string(), "the height of the ground, finite"));
        }
        let share = |_| self.take("shares of a surface").map(u16::from_le_bytes);
        let shares = (0..elements).map(share).collect::<Result<_, _>>()?;
        Ok(Leaf { bounds, ground, shares })
    }

    fn representation(&mut self, of_leaf: bool, elements: u8) -> Result<Stored, PageError> {
        let [code] = self.take::<1>("a representation")?;
        let tells = code & TELLS != 0;
        let kind = match (code & !TELLS).checked_sub(GEOMETRY) {
            Some(level) => Some(Kind::Geometry(level)).filter(|_| of_leaf && !tells && level < GEOMETRIES_MAX),
            None => Direction::from_code(code & !TELLS).map(Kind::Orthoview),
        };
        let kind = kind.ok_or_else(|| self.fault(1, code.to_string(), "a direction's code, or 32 to 95 at a leaf"))?;
        let wire_bytes = self.u32("bytes of a file")?;
        if wire_bytes == 0 {
            return Err(self.fault(4, "0 bytes".to_owned(), "at least 1"));
        }
        let decoded_bytes = self.u32("bytes in memory")?;
        let error = self.take("an error").map(f32::from_le_bytes)?;
        if !(error.is_finite() && error >= 0.0) {
            return Err(self.fault(4, format!("an error of {error} m"), "a finite number ≥ 0"));
        }
        let hash = self.take("a hash")?;
        let mut told = Vec::new();
        for _ in 0..if tells { elements } else { 0 } {
            told.extend(self.take::<1>("what an orthoview shows")?);
        }
        // Other elements than this program's say nothing to it, as with surfaces.
        Ok(Stored { kind, wire_bytes, decoded_bytes, error, hash, shown: told.try_into().ok() })
    }

    fn page(&mut self) -> Result<PageReference, PageError> {
        let hash = self.take("a page's hash")?;
        let bytes = self.u32("a page's bytes")?;
        let mut counts = [0; 7];
        for count in &mut counts {
            *count = self.u64("counts of a page")?;
        }
        let [leaves, nodes, orthoviews, orthoview_bytes, geometries, geometry_bytes, decoded_bytes] = counts;
        if leaves == 0 || nodes < leaves {
            return Err(self.fault(56, format!("{nodes} nodes, {leaves} of them leaves"), "at least one leaf"));
        }
        let bounds = self.bounds()?;
        let summary =
            Summary { leaves, nodes, orthoviews, orthoview_bytes, geometries, geometry_bytes, decoded_bytes, bounds };
        Ok(PageReference { hash, bytes, summary })
    }
}
