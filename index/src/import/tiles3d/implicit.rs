//! Implicit tiling: a tile that stands for a whole quadtree or octree is replaced by the tiles that its subtrees
//! declare.

use std::collections::BTreeMap;

use glam::{DMat3, DVec3};

use super::document::{Content, ImplicitTiling, Tile, TilesetDocument};
use super::limits::MAX_TILES;
use super::subtree::{Subtree, SubtreeError, parse_subtree, tiles_in};
use super::volume::Volume;

/// Why an implicit tiling cannot be expanded.
#[derive(Debug, thiserror::Error)]
pub enum ImplicitError {
    /// A subtree's file is not there.
    #[error("{uri}: not there; expected the subtree that its parent declares")]
    NoSubtree {
        /// Its address, relative to the document.
        uri: String,
    },
    /// A subtree's content is at fault.
    #[error("{uri}: {source}")]
    Subtree {
        /// Its address, relative to the document.
        uri: String,
        /// The fault.
        source: SubtreeError,
    },
    /// A subtree that must have a tile at its top has none.
    #[error("{uri}: $.tileAvailability: no tile at its top; expected one, as the subtree itself is available")]
    NoTop {
        /// Its address, relative to the document.
        uri: String,
    },
    /// More tiles than one world may have.
    #[error("more than {MAX_TILES} implicit tiles; expected at most that")]
    TooMany,
}

/// Place of a tile in the implicit tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Coordinates {
    level: u32,
    x: u64,
    y: u64,
    z: u64,
}

impl Coordinates {
    /// Child `index`: its bits are those of x, y and z.
    fn child(self, index: u64) -> Coordinates {
        Coordinates {
            level: self.level + 1,
            x: self.x << 1 | index & 1,
            y: self.y << 1 | index >> 1 & 1,
            z: self.z << 1 | index >> 2 & 1,
        }
    }

    fn fill(self, template: &str) -> String {
        let mut filled = template.to_owned();
        for (name, value) in [("{level}", u64::from(self.level)), ("{x}", self.x), ("{y}", self.y), ("{z}", self.z)] {
            filled = filled.replace(name, &value.to_string());
        }
        filled
    }
}

/// Replaces the implicit roots of `document` by explicit tiles. `fetch` reads a file by its address relative to the
/// document.
pub(crate) fn expand(
    document: TilesetDocument,
    fetch: &dyn Fn(&str) -> Option<Vec<u8>>,
) -> Result<TilesetDocument, ImplicitError> {
    if document.tiles.iter().all(|tile| tile.implicit.is_none()) {
        return Ok(document);
    }
    let mut out = TilesetDocument { tiles: Vec::new(), contents: Vec::new(), ..document.clone() };
    let mut new_index = Vec::with_capacity(document.tiles.len());
    for tile in &document.tiles {
        new_index.push(out.tiles.len() as u32);
        let contents = &document.contents[tile.contents.0 as usize..tile.contents.1 as usize];
        let mut copy = Tile { implicit: None, ..tile.clone() };
        copy.parent = new_index.get(tile.parent as usize).copied().unwrap_or(u32::MAX);
        match &tile.implicit {
            None => {
                let first = out.contents.len() as u32;
                out.contents.extend_from_slice(contents);
                copy.contents = (first, out.contents.len() as u32);
                out.tiles.push(copy);
            }
            Some(tiling) => Expansion { tiling, root: &copy, templates: contents, fetch, out: &mut out }.run()?,
        }
        if out.tiles.len() > MAX_TILES {
            return Err(ImplicitError::TooMany);
        }
    }
    close_subtrees(&mut out.tiles);
    Ok(out)
}

/// Sets `subtree_end` of tiles in preorder from their parents.
fn close_subtrees(tiles: &mut [Tile]) {
    for index in (0..tiles.len()).rev() {
        let end = tiles[index].subtree_end.max(index as u32 + 1);
        tiles[index].subtree_end = end;
        let parent = tiles[index].parent as usize;
        if let Some(parent) = tiles.get_mut(parent) {
            parent.subtree_end = parent.subtree_end.max(end);
        }
    }
}

struct Expansion<'a> {
    tiling: &'a ImplicitTiling,
    root: &'a Tile,
    templates: &'a [Content],
    fetch: &'a dyn Fn(&str) -> Option<Vec<u8>>,
    out: &'a mut TilesetDocument,
}

/// A tile still to be written.
struct Waiting {
    at: Coordinates,
    parent: u32,
    child: u32,
    /// The subtree it lies in: an index in the list of those read, its level there and its Morton index in the level.
    subtree: usize,
    level: u32,
    morton: u64,
}

/// The subtrees read so far.
struct Subtrees<'a> {
    tiling: &'a ImplicitTiling,
    fetch: &'a dyn Fn(&str) -> Option<Vec<u8>>,
    read: Vec<Subtree>,
    /// By address: a template without coordinates does not make one file be read again and again.
    known: BTreeMap<String, usize>,
}

impl Subtrees<'_> {
    /// Index in `read` of the subtree at a place.
    fn at(&mut self, at: Coordinates) -> Result<usize, ImplicitError> {
        let uri = at.fill(&self.tiling.subtrees);
        if let Some(&index) = self.known.get(&uri) {
            return Ok(index);
        }
        let Some(bytes) = (self.fetch)(&uri) else {
            return Err(ImplicitError::NoSubtree { uri });
        };
        let folder = uri.rfind('/').map_or("", |end| &uri[..=end]);
        let fetch = |buffer: &str| (self.fetch)(&format!("{folder}{buffer}"));
        let parsed = parse_subtree(&bytes, self.tiling.branching, self.tiling.subtree_levels, &fetch);
        let subtree = match parsed {
            Ok(subtree) => subtree,
            Err(source) => return Err(ImplicitError::Subtree { uri, source }),
        };
        if !subtree.tiles.get(0) {
            return Err(ImplicitError::NoTop { uri });
        }
        self.read.push(subtree);
        self.known.insert(uri, self.read.len() - 1);
        Ok(self.read.len() - 1)
    }
}

impl Expansion<'_> {
    fn run(mut self) -> Result<(), ImplicitError> {
        let top = Coordinates { level: 0, x: 0, y: 0, z: 0 };
        let mut subtrees =
            Subtrees { tiling: self.tiling, fetch: self.fetch, read: Vec::new(), known: BTreeMap::new() };
        subtrees.at(top)?;
        let mut waiting = vec![Waiting {
            at: top,
            parent: self.root.parent,
            child: self.root.child,
            subtree: 0,
            level: 0,
            morton: 0,
        }];
        let branching = self.tiling.branching;
        while let Some(tile) = waiting.pop() {
            if self.out.tiles.len() >= MAX_TILES {
                return Err(ImplicitError::TooMany);
            }
            let index = tiles_in(branching, tile.level) + tile.morton;
            let parent = self.out.tiles.len() as u32;
            self.write(&tile, &subtrees.read[tile.subtree], index);
            // Pushed last to first, so that they are written first to last.
            for child in (0..u64::from(branching)).rev() {
                let at = tile.at.child(child);
                if at.level >= self.tiling.available_levels {
                    continue;
                }
                let (level, morton) = (tile.level + 1, tile.morton * u64::from(branching) + child);
                let below = if level < self.tiling.subtree_levels {
                    let bit = tiles_in(branching, level) + morton;
                    subtrees.read[tile.subtree].tiles.get(bit).then_some((tile.subtree, level, morton))
                } else if subtrees.read[tile.subtree].child_subtrees.get(morton) {
                    Some((subtrees.at(at)?, 0, 0))
                } else {
                    None
                };
                if let Some((subtree, level, morton)) = below {
                    waiting.push(Waiting { at, parent, child: child as u32, subtree, level, morton });
                }
            }
        }
        Ok(())
    }

    fn write(&mut self, tile: &Waiting, subtree: &Subtree, index: u64) {
        let first = self.out.contents.len() as u32;
        for (template, bits) in self.templates.iter().zip(&subtree.contents) {
            if bits.get(index) {
                self.out.contents.push(Content { uri: tile.at.fill(&template.uri), volume: None });
            }
        }
        let is_top = tile.at.level == 0;
        self.out.tiles.push(Tile {
            parent: tile.parent,
            child: tile.child,
            subtree_end: 0,
            transform: if is_top { self.root.transform.clone() } else { None },
            volume: subdivided(&self.root.volume, tile.at, self.tiling.branching == 8),
            // Halved from level to level.
            geometric_error: libm::ldexp(self.root.geometric_error, -(tile.at.level as i32)),
            refine: self.root.refine,
            contents: (first, self.out.contents.len() as u32),
            implicit: None,
        });
    }
}

/// The part of the root's volume that belongs to a tile. A sphere cannot be subdivided: it stays as it is.
fn subdivided(root: &Volume, at: Coordinates, vertical: bool) -> Volume {
    let size = libm::ldexp(1.0, -(at.level as i32));
    match *root {
        Volume::Sphere { .. } => *root,
        Volume::Box { centre, half_axes } => {
            // From −1 to 1 along each half axis.
            let middle = |index: u64| (2.0 * index as f64 + 1.0) * size - 1.0;
            let up = if vertical { (middle(at.z), size) } else { (0.0, 1.0) };
            Volume::Box {
                centre: centre + half_axes * DVec3::new(middle(at.x), middle(at.y), up.0),
                half_axes: half_axes * DMat3::from_diagonal(DVec3::new(size, size, up.1)),
            }
        }
        Volume::Region([west, south, east, north, low, high]) => {
            let east = if east < west { east + core::f64::consts::TAU } else { east };
            let part = |from: f64, to: f64, index: u64| {
                let step = (to - from) * size;
                (from + step * index as f64, from + step * (index as f64 + 1.0))
            };
            let (longitude, latitude) = (part(west, east, at.x), part(south, north, at.y));
            let height = if vertical { part(low, high, at.z) } else { (low, high) };
            Volume::Region([longitude.0, latitude.0, longitude.1, latitude.1, height.0, height.1])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_of_a_box_and_of_a_region() {
        let root = Volume::Box { centre: DVec3::splat(8.0), half_axes: DMat3::from_diagonal(DVec3::splat(8.0)) };
        let at = Coordinates { level: 2, x: 3, y: 0, z: 1 };
        let Volume::Box { centre, half_axes } = subdivided(&root, at, true) else { panic!("a box stays a box") };
        assert_eq!((centre, half_axes.x_axis.x), (DVec3::new(14.0, 2.0, 6.0), 2.0));
        let Volume::Box { centre, .. } = subdivided(&root, at, false) else { panic!("a box stays a box") };
        assert_eq!(centre.z, 8.0);
        let region = Volume::Region([0.0, 0.0, 1.0, 0.5, 0.0, 100.0]);
        assert_eq!(subdivided(&region, at, true), Volume::Region([0.75, 0.0, 1.0, 0.125, 25.0, 50.0]));
    }

    #[test]
    fn templates_are_filled() {
        let at = Coordinates { level: 0, x: 0, y: 0, z: 0 }.child(5).child(2);
        assert_eq!(at.fill("s/{level}/{x}_{y}_{z}.subtree"), "s/2/2_1_2.subtree");
    }
}
