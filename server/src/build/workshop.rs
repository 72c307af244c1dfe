//! The build itself: leaves are drawn, images and pages written, finished cells noted.

use super::BuildError;
use super::leaf::measure;
use super::plan::Plan;
use super::progress::Progress;
use foresight_index::format::orthoview::{encode, uploaded_bytes};
use foresight_index::geometry::{GeometryError, GeometryLevel, levels};
use foresight_index::octree::Cell;
use foresight_index::orthoview::build::{LeafContent, Workshop};
use foresight_index::orthoview::connectivity::{Thresholds, links};
use foresight_index::orthoview::error::shown;
use foresight_index::orthoview::{Direction, Lattice, Orthoview, SAMPLE_ERROR};
use foresight_index::stored::page::{Child, Hash, Kind, Leaf, Node, Stored, Summary, hash};
use foresight_index::stored::publish::Workplace;
use foresight_index::stored::{StoredError, address, checkpoint, packing};
use foresight_index::surface::Surfaces;
use foresight_index::surface::spool::Spool;
use foresight_scheduler::benefit::element::ELEMENTS;
use glam::DVec3;
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError, channel};

/// Shares that a leaf's surface has.
pub(super) const SHARES: u8 = ELEMENTS as u8;

/// Finished cells from this level on are noted: what an interruption costs is at most the leaves of one parent.
const NOTED_FROM: u32 = 1;

/// What is found out about a leaf beside its images.
type Content = (Option<Leaf>, Vec<GeometryLevel>);

/// A leaf whose images are there, and whose content is being looked at on other threads.
struct Waiting {
    cell: Cell,
    orthoviews: Vec<Stored>,
    content: Receiver<Result<Content, GeometryError>>,
}

/// Takes what is built to its place.
pub(super) struct Shop<'a> {
    plan: Arc<Plan>,
    spool: &'a Spool,
    workplace: &'a Workplace,
    progress: &'a mut Progress,
    /// Away from the ground.
    up: DVec3,
    /// Leaves that there are.
    leaves: u64,
    /// Finished cells whose parent is not, by level.
    open: Vec<Vec<Child>>,
    /// At most the leaves of one parent.
    waiting: Vec<Waiting>,
    /// Of the cell at work.
    representations: Vec<Stored>,
    content: Option<Receiver<Result<Content, GeometryError>>>,
    leaves_visited: u64,
    bytes: u64,
    /// Leaves that an earlier run made.
    pub(super) leaves_restored: u64,
}

impl<'a> Shop<'a> {
    /// A new one.
    pub(super) fn new(
        plan: Arc<Plan>,
        spool: &'a Spool,
        workplace: &'a Workplace,
        progress: &'a mut Progress,
        up: DVec3,
    ) -> Shop<'a> {
        Shop {
            open: vec![Vec::new(); plan.octree.root().level as usize + 1],
            leaves: spool.leaves().count() as u64,
            plan,
            spool,
            workplace,
            progress,
            up,
            waiting: Vec::new(),
            representations: Vec::new(),
            content: None,
            leaves_visited: 0,
            bytes: 0,
            leaves_restored: 0,
        }
    }

    /// Writes the page of the root: its name, its hash, and what is in the world. `None` if nothing is.
    ///
    /// # Errors
    /// A page that cannot be written.
    pub(super) fn root(&mut self) -> Result<Option<(String, Hash, Summary)>, BuildError> {
        self.settle()?;
        let Some(root) = self.open.last_mut().and_then(Vec::pop) else { return Ok(None) };
        let page = packing::page_of(&root, &self.plan.octree, SHARES, &mut page_writer(self.workplace))?;
        Ok(match page {
            Child::Page(cell, page) => Some((address::page(cell, &page.hash), page.hash, page.summary)),
            Child::Node(_) => None,
        })
    }

    fn noted(cell: Cell) -> String {
        let [x, y, z] = cell.place;
        format!("cells/{}_{x}_{y}_{z}.cell", cell.level)
    }

    fn store(&mut self, cell: Cell, kind: Kind, bytes: &[u8], decoded: u64, error: f64) -> Result<Stored, BuildError> {
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
            shown: None,
        };
        self.workplace.write(&(folder + &name), bytes)?;
        self.bytes += bytes.len() as u64;
        Ok(stored)
    }

    /// Waits for what is being found out about leaves, and makes their nodes, in order.
    fn settle(&mut self) -> Result<(), BuildError> {
        for Waiting { cell, mut orthoviews, content } in std::mem::take(&mut self.waiting) {
            let (leaf, levels) = loop {
                match content.try_recv() {
                    Ok(content) => break content?,
                    // A task that is gone without an answer has panicked, and rayon has ended the process.
                    Err(TryRecvError::Disconnected) => break (None, Vec::new()),
                    // This thread is one of those that do the work.
                    Err(TryRecvError::Empty) => match rayon::yield_now() {
                        Some(rayon::Yield::Executed) => {}
                        _ => std::thread::yield_now(),
                    },
                }
            };
            for (at, level) in (0u8..).zip(levels) {
                let error = f64::from(level.error);
                orthoviews.push(self.store(cell, Kind::Geometry(at), &level.glb, level.decoded_bytes, error)?);
            }
            // What no direction sees and has no geometry is not there.
            if let Some(leaf) = leaf.filter(|_| !orthoviews.is_empty()) {
                let node = Node { cell, representations: orthoviews, leaf: Some(leaf), children: Vec::new() };
                self.open[0].push(Child::Node(node));
            }
        }
        Ok(())
    }

    fn tell(&mut self) {
        let more = format!(", {:.1} MB", self.bytes as f64 / 1e6);
        let made_now = self.leaves_visited - self.leaves_restored;
        self.progress.at("leaves", self.leaves_visited, self.leaves, made_now, &more);
    }
}

/// Writes pages into their places.
fn page_writer(workplace: &Workplace) -> impl FnMut(Cell, &[u8]) -> Result<(), StoredError> {
    |cell, bytes| workplace.write(&address::page(cell, &hash(bytes)), bytes)
}

/// Bounds, ground, surface and geometry of a leaf.
fn content(plan: &Plan, cell: Cell, surfaces: &Surfaces, up: DVec3) -> Result<Content, GeometryError> {
    let leaf = measure(surfaces.triangles.iter(), &plan.octree.holds(cell, 0.0), up);
    let levels = match (&leaf, &plan.geometry) {
        (Some(_), Some(settings)) => {
            levels(&[(&surfaces.triangles, &surfaces.materials)], &plan.octree, cell, settings)?
        }
        _ => Vec::new(),
    };
    Ok((leaf, levels))
}

impl Workshop for Shop<'_> {
    type Error = BuildError;

    fn is_occupied(&self, cell: Cell) -> bool {
        self.spool.is_occupied(cell)
    }

    fn with_content(&mut self, cell: Cell, draw: &mut dyn FnMut(&LeafContent<'_>)) -> Result<(), BuildError> {
        let surfaces = Arc::new(self.spool.leaf(cell.place)?);
        let (sender, receiver) = channel();
        let (plan, same, up) = (self.plan.clone(), surfaces.clone(), self.up);
        rayon::spawn(move || {
            // Nobody listens once the build has failed.
            let _ = sender.send(content(&plan, cell, &same, up));
        });
        self.content = Some(receiver);
        draw(&LeafContent { meshes: vec![(&surfaces.triangles, &surfaces.materials)] });
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
        let error = SAMPLE_ERROR * pitch * (1u64 << cell.level) as f64;
        for ((direction, file), shown) in
            files.into_iter().zip(shown(images, origin, pitch)).filter_map(|(file, shown)| Some((file?, shown)))
        {
            let stored = self.store(cell, Kind::Orthoview(direction), &file, uploaded_bytes(&file), error)?;
            self.representations.push(Stored { shown: Some(shown), ..stored });
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
        let mut representations = std::mem::take(&mut self.representations);
        representations.sort_by_key(|rep| rep.kind);
        let Some(beneath) = cell.level.checked_sub(1) else {
            if let Some(content) = self.content.take() {
                self.waiting.push(Waiting { cell, orthoviews: representations, content });
            }
            self.leaves_visited += 1;
            self.tell();
            return Ok(());
        };
        self.settle()?;
        let children = std::mem::take(&mut self.open[beneath as usize]);
        let mut node = (!children.is_empty()).then_some(Node { cell, representations, leaf: None, children });
        let octree = &self.plan.octree;
        if let Some(node) = &mut node {
            packing::pack(node, octree, SHARES, &mut page_writer(self.workplace))?;
        }
        if cell.level >= NOTED_FROM {
            let bytes = checkpoint::encode(node.as_ref(), images, octree, SHARES);
            self.workplace.note(&Shop::noted(cell), &bytes)?;
            for child in octree.children(cell).filter(|child| child.level >= NOTED_FROM) {
                self.workplace.strike(&Shop::noted(child))?;
            }
        }
        if let Some(node) = node {
            self.open[cell.level as usize].push(Child::Node(node));
        }
        Ok(())
    }
}
