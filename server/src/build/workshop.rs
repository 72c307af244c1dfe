//! The build itself: leaves are drawn, images and pages written, finished cells noted.

use super::BuildError;
use super::leaf::measure;
use super::plan::Plan;
use super::progress::Progress;
use super::source::Sources;
use foresight_index::format::orthoview::{encode, uploaded_bytes};
use foresight_index::octree::{Cell, Octree};
use foresight_index::orthoview::build::{LeafContent, Workshop};
use foresight_index::orthoview::connectivity::{Thresholds, links};
use foresight_index::orthoview::raster::Surface;
use foresight_index::orthoview::{Direction, Lattice, Orthoview};
use foresight_index::stored::page::{Child, Kind, Leaf, Node, Stored, Summary, hash};
use foresight_index::stored::publish::Workplace;
use foresight_index::stored::{StoredError, address, checkpoint, packing};
use foresight_index::surface::Surfaces;
use foresight_scheduler::benefit::element::ELEMENTS;
use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Shares that a leaf's surface has.
pub(super) const SHARES: u8 = ELEMENTS as u8;

/// Finished cells from this level on are noted: what an interruption costs is at most the leaves beneath one of them.
const NOTED_FROM: u32 = 2;

/// Which pieces each leaf may hold something of.
#[derive(Debug, Default)]
pub(super) struct Occupied {
    leaves: BTreeMap<[u64; 3], Vec<usize>>,
    cells: BTreeSet<Cell>,
}

impl Occupied {
    /// By the boxes of the pieces.
    pub(super) fn new(octree: &Octree, pieces: &[Aabb]) -> Occupied {
        let mut occupied = Occupied::default();
        for (piece, bounds) in pieces.iter().enumerate().filter(|(_, bounds)| !bounds.is_empty()) {
            let [x, y, z] = octree.leaves(bounds);
            let places = (x[0]..=x[1]).flat_map(|x| (y[0]..=y[1]).map(move |y| [x, y]));
            for place in places.flat_map(|[x, y]| (z[0]..=z[1]).map(move |z| [x, y, z])) {
                occupied.leaves.entry(place).or_default().push(piece);
                let mut next = Some(Cell { level: 0, place });
                while let Some(cell) = next.filter(|cell| occupied.cells.insert(*cell)) {
                    next = octree.parent(cell);
                }
            }
        }
        occupied
    }

    /// Number of leaves.
    pub(super) fn leaves(&self) -> u64 {
        self.leaves.len() as u64
    }
}

/// Takes what is built to its place.
pub(super) struct Shop<'a> {
    /// What to build.
    pub(super) plan: &'a Plan,
    /// From what.
    pub(super) sources: &'a Sources,
    /// Where there is something.
    pub(super) occupied: &'a Occupied,
    /// Where to.
    pub(super) workplace: &'a Workplace,
    /// Who is told.
    pub(super) progress: &'a mut Progress,
    /// Away from the ground.
    pub(super) up: DVec3,
    loaded: BTreeMap<usize, Surfaces>,
    /// Finished cells whose parent is not, by level.
    open: Vec<Vec<Child>>,
    /// Of the cell at work.
    representations: Vec<Stored>,
    leaf: Option<Leaf>,
    leaves_visited: u64,
    /// Leaves that an earlier run made.
    pub(super) leaves_restored: u64,
    bytes: u64,
}

impl<'a> Shop<'a> {
    /// A new one.
    pub(super) fn new(
        plan: &'a Plan,
        sources: &'a Sources,
        occupied: &'a Occupied,
        workplace: &'a Workplace,
        progress: &'a mut Progress,
    ) -> Shop<'a> {
        Shop {
            plan,
            sources,
            occupied,
            workplace,
            progress,
            up: sources.up(),
            loaded: BTreeMap::new(),
            open: vec![Vec::new(); plan.octree.root().level as usize + 1],
            representations: Vec::new(),
            leaf: None,
            leaves_visited: 0,
            leaves_restored: 0,
            bytes: 0,
        }
    }

    /// Writes the page of the root: its name, and what is in the world. `None` if nothing is.
    ///
    /// # Errors
    /// A page that cannot be written.
    pub(super) fn root(&mut self) -> Result<Option<(String, Summary)>, BuildError> {
        let Some(root) = self.open.last_mut().and_then(Vec::pop) else { return Ok(None) };
        let page = packing::page_of(&root, &self.plan.octree, SHARES, &mut |cell, bytes: &[u8]| {
            self.workplace.write(&address::page(cell, &hash(bytes)), bytes)
        })?;
        Ok(match page {
            Child::Page(cell, page) => Some((address::page(cell, &page.hash), page.summary)),
            Child::Node(_) => None,
        })
    }

    fn noted(cell: Cell) -> String {
        let [x, y, z] = cell.place;
        format!("cells/{}_{x}_{y}_{z}.cell", cell.level)
    }

    fn store(&mut self, cell: Cell, kind: Kind, bytes: &[u8], decoded: u64, error: f64) -> Result<(), BuildError> {
        let content = hash(bytes);
        let (folder, name) = address::representation(cell, kind, &content);
        let too_large = || BuildError::TooLarge { file: folder.clone() + &name };
        #[expect(clippy::cast_possible_truncation, reason = "metres, kept to 7 digits")]
        let stored = Stored {
            kind,
            wire_bytes: u32::try_from(bytes.len()).map_err(|_| too_large())?,
            decoded_bytes: u32::try_from(decoded).map_err(|_| too_large())?,
            error: error as f32,
            hash: content,
        };
        self.workplace.write(&(folder + &name), bytes)?;
        self.bytes += bytes.len() as u64;
        self.representations.push(stored);
        Ok(())
    }

    fn tell(&mut self) {
        let more = format!(", {:.1} MB", self.bytes as f64 / 1e6);
        let made_now = self.leaves_visited - self.leaves_restored;
        self.progress.at("leaves", self.leaves_visited, self.occupied.leaves(), made_now, &more);
    }
}

impl Workshop for Shop<'_> {
    type Error = BuildError;

    fn is_occupied(&self, cell: Cell) -> bool {
        self.occupied.cells.contains(&cell)
    }

    fn with_content(&mut self, cell: Cell, draw: &mut dyn FnMut(&LeafContent<'_>)) -> Result<(), BuildError> {
        let none = Vec::new();
        let pieces = self.occupied.leaves.get(&cell.place).unwrap_or(&none);
        self.loaded.retain(|piece, _| pieces.contains(piece));
        let missing: Vec<usize> = pieces.iter().copied().filter(|piece| !self.loaded.contains_key(piece)).collect();
        let sources = self.sources;
        let loaded: Vec<_> =
            missing.par_iter().map(|&piece| Ok((piece, sources.load(piece)?))).collect::<Result<_, BuildError>>()?;
        self.loaded.extend(loaded);
        let surfaces: Vec<&Surfaces> = pieces.iter().filter_map(|piece| self.loaded.get(piece)).collect();
        let holds = self.plan.octree.holds(cell, 0.0);
        self.leaf = measure(surfaces.iter().flat_map(|s| &s.triangles), &holds, self.up);
        let meshes = surfaces.iter().map(|s| (&s.triangles[..], &s.materials as &(dyn Surface + Sync))).collect();
        draw(&LeafContent { meshes });
        Ok(())
    }

    fn keep(&mut self, cell: Cell, images: &[(Direction, &Orthoview)]) -> Result<(), BuildError> {
        let (origin, pitch) = (self.plan.octree.origin(), self.plan.pixel);
        let files: Vec<_> = images
            .par_iter()
            .map(|&(direction, view)| {
                let lattice = Lattice { direction, origin, pitch };
                let links = links(view, &lattice, &Thresholds::default());
                let file = encode(view, &links, direction, self.plan.encoding)?;
                Ok(file.map(|file| (direction, file)))
            })
            .collect::<Result<_, BuildError>>()?;
        let error = pitch * (1u64 << cell.level) as f64;
        for (direction, file) in files.into_iter().flatten() {
            self.store(cell, Kind::Orthoview(direction), &file, uploaded_bytes(&file), error)?;
        }
        Ok(())
    }

    fn restored(&mut self, cell: Cell) -> Result<Option<Vec<Option<Orthoview>>>, BuildError> {
        if cell.level < NOTED_FROM {
            return Ok(None);
        }
        let Ok(bytes) = std::fs::read(self.workplace.noted(&Shop::noted(cell))) else { return Ok(None) };
        let Some(finished) = checkpoint::decode(&bytes, &self.plan.octree) else { return Ok(None) };
        if finished.images.len() != self.plan.directions.len() || finished.node.as_ref().is_some_and(|n| n.cell != cell)
        {
            return Ok(None);
        }
        if let Some(node) = finished.node {
            let summary = node.summary();
            self.leaves_visited += summary.leaves;
            self.leaves_restored += summary.leaves;
            self.bytes += summary.orthoview_bytes + summary.geometry_bytes;
            self.open[cell.level as usize].push(Child::Node(node));
        }
        self.tell();
        Ok(Some(finished.images))
    }

    fn finished(&mut self, cell: Cell, images: &[Option<Orthoview>]) -> Result<(), BuildError> {
        let level = cell.level as usize;
        let mut representations = std::mem::take(&mut self.representations);
        representations.sort_by_key(|rep| rep.kind);
        let (leaf, children) = match level.checked_sub(1) {
            Some(beneath) => (None, std::mem::take(&mut self.open[beneath])),
            None => (self.leaf.take().filter(|_| !representations.is_empty()), Vec::new()),
        };
        let is_there = leaf.is_some() || !children.is_empty();
        let mut node = is_there.then_some(Node { cell, representations, leaf, children });
        let octree = &self.plan.octree;
        if let Some(node) = &mut node {
            packing::pack(node, octree, SHARES, &mut |cell, bytes: &[u8]| {
                self.workplace.write(&address::page(cell, &hash(bytes)), bytes)
            })?;
        }
        if cell.level >= NOTED_FROM {
            let bytes = checkpoint::encode(node.as_ref(), images, octree, SHARES);
            self.workplace.note(&Shop::noted(cell), &bytes)?;
            for child in octree.children(cell).filter(|child| child.level >= NOTED_FROM) {
                let file = self.workplace.noted(&Shop::noted(child));
                match std::fs::remove_file(&file) {
                    Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                        return Err(StoredError::Io { file, source: error }.into());
                    }
                    _ => {}
                }
            }
        }
        if let Some(node) = node {
            self.open[level].push(Child::Node(node));
        }
        if level == 0 {
            self.leaves_visited += 1;
            self.tell();
        }
        Ok(())
    }
}
