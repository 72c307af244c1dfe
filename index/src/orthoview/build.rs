//! All orthoviews of a world, depth first: a leaf is drawn once, a parent is made of its children's images, and no more is
//! in memory than the images along one path of the tree (\[HIBR\] §4.1).

use super::composite::{doubled, halved, overlay};
use super::direction::Direction;
use super::image::{Lattice, Orthoview};
use super::raster::{self, Drawn, Surface, Triangle};
use crate::octree::{Cell, Octree};
use rayon::prelude::*;

/// What a leaf holds: triangles in world space, and what they look like.
pub struct LeafContent<'a> {
    /// Meshes, each with its own materials.
    pub meshes: Vec<(&'a [Triangle], &'a (dyn Surface + Sync))>,
}

/// Where contents come from and images go to.
pub trait Workshop {
    /// Why it stops.
    type Error: Send;

    /// Whether anything lies in a cell: empty ones are not visited.
    fn is_occupied(&self, cell: Cell) -> bool;

    /// Hands a leaf's content to `draw`.
    ///
    /// # Errors
    /// Content that cannot be had.
    fn with_content(&mut self, cell: Cell, draw: &mut dyn FnMut(&LeafContent<'_>)) -> Result<(), Self::Error>;

    /// Takes a finished image of each direction that shows something, in the order of the directions.
    ///
    /// # Errors
    /// Images that cannot be kept.
    fn keep(&mut self, cell: Cell, images: &[(Direction, &Orthoview)]) -> Result<(), Self::Error>;

    /// A cell's images as [`Workshop::finished`] was given them in an earlier run, if that is known: then neither it nor
    /// what lies beneath is made again.
    ///
    /// # Errors
    /// What was kept and cannot be read.
    fn restored(&mut self, cell: Cell) -> Result<Option<Vec<Option<Orthoview>>>, Self::Error> {
        let _ = cell;
        Ok(None)
    }

    /// Told that a cell is done, after everything beneath it: with its image in each direction, in their order.
    ///
    /// # Errors
    /// What cannot be noted.
    fn finished(&mut self, cell: Cell, images: &[Option<Orthoview>]) -> Result<(), Self::Error> {
        let _ = (cell, images);
        Ok(())
    }
}

/// What was done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Made {
    /// Leaves that show something.
    pub leaves: u64,
    /// Other cells that do.
    pub inner: u64,
    /// Images.
    pub images: u64,
    /// What drawing the leaves took, over all directions.
    pub drawn: Drawn,
    /// Most bytes of images held at a time, those that a leaf is being drawn into not counted.
    pub peak_bytes: usize,
}

/// Every cell's images in `directions`; a leaf's pixels are `pitch` metres wide.
///
/// # Errors
/// Those of the workshop, at the first.
pub fn build<W: Workshop>(
    octree: &Octree,
    directions: &[Direction],
    pitch: f64,
    workshop: &mut W,
) -> Result<Made, W::Error> {
    let lattices = directions.iter().map(|&direction| Lattice { direction, origin: octree.origin(), pitch }).collect();
    let mut builder = Builder { octree, lattices, workshop, made: Made::default(), held: 0 };
    let root = octree.root();
    if builder.workshop.is_occupied(root) {
        builder.cell(root)?;
    }
    Ok(builder.made)
}

struct Builder<'a, W> {
    octree: &'a Octree,
    lattices: Vec<Lattice>,
    workshop: &'a mut W,
    made: Made,
    /// Bytes of images that are held.
    held: usize,
}

impl<W: Workshop> Builder<'_, W> {
    /// A cell's images, one a direction. At most [`crate::octree::LEVELS_MAX`] calls deep.
    fn cell(&mut self, cell: Cell) -> Result<Vec<Option<Orthoview>>, W::Error> {
        if let Some(images) = self.workshop.restored(cell)? {
            self.hold(bytes(&images));
            return Ok(images);
        }
        let images = if cell.level == 0 { self.leaf(cell)? } else { self.inner(cell)? };
        let shown: Vec<_> =
            self.lattices.iter().zip(&images).filter_map(|(l, image)| Some((l.direction, image.as_ref()?))).collect();
        if !shown.is_empty() {
            *(if cell.level == 0 { &mut self.made.leaves } else { &mut self.made.inner }) += 1;
            self.made.images += shown.len() as u64;
            self.workshop.keep(cell, &shown)?;
        }
        self.workshop.finished(cell, &images)?;
        Ok(images)
    }

    fn leaf(&mut self, cell: Cell) -> Result<Vec<Option<Orthoview>>, W::Error> {
        let (octree, lattices) = (self.octree, &self.lattices);
        let mut images = Vec::new();
        let mut total = Drawn::default();
        self.workshop.with_content(cell, &mut |content| {
            let drawn: Vec<(Option<Orthoview>, Drawn)> = lattices
                .par_iter()
                .map(|lattice| {
                    let mut drawn = Drawn::default();
                    let meshes = content.meshes.iter().map(|&(t, s)| (t, s as &dyn Surface));
                    let image = raster::leaf(octree, cell, lattice, meshes, &mut drawn);
                    (image, drawn)
                })
                .collect();
            for (image, drawn) in drawn {
                total.add(&drawn);
                images.push(image);
            }
        })?;
        self.made.drawn.add(&total);
        images.resize_with(self.lattices.len(), || None);
        self.hold(bytes(&images));
        Ok(images)
    }

    fn inner(&mut self, cell: Cell) -> Result<Vec<Option<Orthoview>>, W::Error> {
        let bounds = self.octree.bounds(cell);
        let mut doubles: Vec<Option<Orthoview>> = self.lattices.iter().map(|_| None).collect();
        for child in self.octree.children(cell) {
            if !self.workshop.is_occupied(child) {
                continue;
            }
            let images = self.cell(child)?;
            let (lattices, before) = (&self.lattices, bytes(&doubles));
            doubles.par_iter_mut().zip(&images).zip(lattices).for_each(|((double, image), lattice)| {
                if let Some(image) = image {
                    let target = double.get_or_insert_with(|| doubled(&Orthoview::empty(lattice, &bounds, cell.level)));
                    overlay(target, image);
                }
            });
            self.hold(bytes(&doubles) - before);
            self.held -= bytes(&images);
        }
        let side = (1u64 << cell.level) as f64;
        let halve = |(double, lattice): (&Option<Orthoview>, &Lattice)| {
            let mut image = Orthoview::empty(lattice, &bounds, cell.level);
            halved(double.as_ref()?, &mut image, lattice.pitch * side);
            Some(image)
        };
        let images: Vec<_> = doubles.par_iter().zip(&self.lattices).map(halve).collect();
        self.hold(bytes(&images));
        self.held -= bytes(&doubles);
        Ok(images)
    }

    fn hold(&mut self, bytes: usize) {
        self.held += bytes;
        self.made.peak_bytes = self.made.peak_bytes.max(self.held);
    }
}

fn bytes(images: &[Option<Orthoview>]) -> usize {
    images.iter().flatten().map(Orthoview::heap_bytes).sum()
}
