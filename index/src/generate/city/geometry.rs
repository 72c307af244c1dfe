//! A city with its geometry: a 3D Tiles tileset of the tree that the catalogue has, every representation a GLB with its
//! textures. Errors are the catalogue's, which the meshes keep; sizes are the files' own, and differ from the catalogue's.

use std::path::Path;

use foresight_scheduler::lod_tree::{LodTree, NodeId, RepId};
use glam::{DVec2, DVec3};
use serde_json::{Value, json};

use super::super::document::GenerateError;
use super::super::tileset::{self, Written, volume};
use super::facade::{self, Pattern};
use super::model::{self, Detail, Narrowed, Shell};
use super::{BLOCK_ERROR, CityParams, Rectangle, Standing, laid_out};
use crate::format::glb;
use crate::world::World;

/// Most tiles that are written: about 6 km × 6 km.
pub const MAX_WRITTEN_TILES: u64 = 200_000;

/// Linear light of what has no texture of its own.
pub(super) const ROOF: [f32; 3] = [0.16, 0.155, 0.15];
pub(super) const BARK: [f32; 3] = [0.09, 0.06, 0.04];
const LEAVES: [f32; 3] = [0.07, 0.16, 0.05];
const WALL: [f32; 3] = [0.42, 0.38, 0.33];
const PAVING: [f32; 3] = [0.2, 0.2, 0.19];
const WHITE: [f32; 3] = [1.0; 3];

/// Metres to a repetition of the ground's texture.
pub(super) const GROUND_TEXTURE: f64 = 8.0;

/// Writes the folder `out` with a 3D Tiles tileset and its contents. `out` must not exist or be an empty folder.
/// `progress` is told how many files are written, and of how many.
///
/// # Errors
/// Parameters out of range, more than [`MAX_WRITTEN_TILES`] tiles, a folder that is not empty or cannot be written.
pub fn write(params: &CityParams, out: &Path, progress: &mut dyn FnMut(u64, u64)) -> Result<Written, GenerateError> {
    let params = &CityParams { orthoviews: 0, ..params.clone() };
    let (world, standing) = laid_out(params)?;
    let tree = &world.tree;
    let tiles = tree.representations() as u64;
    tileset::check_tiles(tiles, MAX_WRITTEN_TILES)?;
    let city = CityContents { seed: params.seed, standing, first_leaf: first_leaves(tree) };
    let parts: Vec<RepId> = (0..tree.representations() as u32).map(RepId).collect();
    let root = city.tile(&world, tree.root());
    let error = tree.own(tree.root()).map(|rep| tree.error(rep)).fold(0.0, f64::max);
    let content = |&rep: &RepId| (world.uris.get(rep).into_owned(), city.content(tree, rep));
    tileset::write(out, &parts, content, (2.0 * error, root), tiles, progress)
}

/// The number of the first leaf at or beneath each node, leaves counted in their order.
fn first_leaves(tree: &LodTree) -> Vec<u32> {
    let mut first = Vec::with_capacity(tree.nodes());
    let mut leaves = 0;
    for node in (0..tree.nodes() as u32).map(NodeId) {
        first.push(leaves);
        leaves += u32::from(tree.is_leaf(node));
    }
    first.push(leaves);
    first
}

/// The contents of a city, made when they are asked for.
#[derive(Debug)]
pub struct CityContents {
    seed: u64,
    standing: Vec<Standing>,
    first_leaf: Vec<u32>,
}

impl CityContents {
    /// The city of these parameters with its contents; `None` in place of these if it has orthoviews, which are sizes only.
    ///
    /// # Errors
    /// Parameters out of range.
    pub fn open(params: &CityParams) -> Result<(World, Option<CityContents>), GenerateError> {
        let (world, standing) = laid_out(params)?;
        let first_leaf = first_leaves(&world.tree);
        let contents = CityContents { seed: params.seed, standing, first_leaf };
        Ok((world, (params.orthoviews == 0).then_some(contents)))
    }

    /// The JSON of a node: its levels inside each other, coarse to fine, then its children. Recursion goes down the tree:
    /// at most 20 deep.
    fn tile(&self, world: &World, node: NodeId) -> Value {
        let tree = &world.tree;
        let bounds = volume(tree.bounds(node));
        let children: Vec<Value> = tree.children(node).map(|child| self.tile(world, child)).collect();
        let mut levels: Vec<RepId> = tree.own(node).collect();
        levels.sort_by(|a, b| tree.error(*a).total_cmp(&tree.error(*b)).then(a.cmp(b)));
        let mut beneath = children;
        for rep in levels {
            let mut tile = json!({
                "boundingVolume": bounds,
                "geometricError": tree.error(rep),
                "refine": "REPLACE",
                "content": { "uri": world.uris.get(rep) },
            });
            if !beneath.is_empty() {
                tile["children"] = Value::Array(std::mem::take(&mut beneath));
            }
            beneath = vec![tile];
        }
        beneath.pop().unwrap_or_else(|| json!({ "boundingVolume": bounds, "geometricError": 0.0 }))
    }

    /// What stands beneath a node.
    fn standing(&self, tree: &LodTree, node: NodeId) -> &[Standing] {
        let end = tree.subtree_end(node).index();
        &self.standing[self.first_leaf[node.index()] as usize..self.first_leaf[end] as usize]
    }

    /// A representation of the city that has this tree, as GLB.
    pub fn content(&self, tree: &LodTree, rep: RepId) -> Vec<u8> {
        let node = tree.node_of(rep);
        let centre = tree.centre(node).truncate();
        let origin = centre.extend(0.0);
        let finer = tree.own(node).filter(|r| tree.error(*r) < tree.error(rep)).count();
        let seed = self.seed ^ (u64::from(self.first_leaf[node.index()]) << 20);
        if !tree.is_leaf(node) {
            let parts = merged(self.standing(tree, node), centre, tree.error(rep));
            return encode(origin, &parts, &[]);
        }
        match (&self.standing[self.first_leaf[node.index()] as usize], finer) {
            (&Standing::Ground(whole), 0) => {
                let shell = model::ground(shifted(whole, centre), GROUND_TEXTURE);
                let texture = facade::png(Pattern::Ground { side: 128, seed });
                encode(origin, &[(shell, WHITE, Some(0))], &[texture])
            }
            (&Standing::Ground(whole), _) => {
                encode(origin, &[(model::ground(shifted(whole, centre), GROUND_TEXTURE), PAVING, None)], &[])
            }
            (&Standing::Tree { at, radius, height }, finer) => {
                let tree = model::tree(at - centre, radius, height, if finer == 0 { 3 } else { 1 });
                let textures =
                    if finer == 0 { vec![facade::png(Pattern::Foliage { side: 64, seed })] } else { Vec::new() };
                let crown = if finer == 0 { (tree.crown, WHITE, Some(0)) } else { (tree.crown, LEAVES, None) };
                encode(origin, &[(tree.trunk, BARK, None), crown], &textures)
            }
            (&Standing::Building { footprint, height }, finer) => {
                let detail = [Detail::Windows, Detail::Parapet, Detail::Box][finer.min(2)];
                let building = model::building(shifted(footprint, centre), height, detail);
                let side = [256, 96][finer.min(1)];
                let textures = if finer < 2 { vec![facade::png(Pattern::Facade { side, seed })] } else { Vec::new() };
                let walls = if finer < 2 { (building.walls, WHITE, Some(0)) } else { (building.walls, WALL, None) };
                encode(origin, &[walls, (building.roof, ROOF, None)], &textures)
            }
        }
    }
}

pub(super) fn shifted(rectangle: Rectangle, origin: DVec2) -> Rectangle {
    Rectangle { min: rectangle.min - origin, max: rectangle.max - origin }
}

type Painted = (Shell, [f32; 3], Option<usize>);

/// What stands there, relative to `origin`, without what is lower than `error`: boxes, coarse trees, level ground.
fn merged(standing: &[Standing], origin: DVec2, error: f64) -> Vec<Painted> {
    let mut parts: Vec<Painted> = Vec::new();
    let [mut walls, mut roofs, mut trunks, mut crowns, mut grounds] = std::array::from_fn(|_| Shell::default());
    for thing in standing {
        match *thing {
            Standing::Ground(whole) => grounds.join(model::ground(shifted(whole, origin), GROUND_TEXTURE)),
            Standing::Tree { at, radius, height } if height > error => {
                let divisions = u32::from(error <= BLOCK_ERROR);
                let tree = model::tree(at - origin, radius, height, divisions);
                trunks.join(tree.trunk);
                crowns.join(tree.crown);
            }
            Standing::Building { footprint, height } if height > error => {
                let building = model::building(shifted(footprint, origin), height, Detail::Box);
                walls.join(building.walls);
                roofs.join(building.roof);
            }
            Standing::Tree { .. } | Standing::Building { .. } => {}
        }
    }
    for (shell, colour) in [(walls, WALL), (roofs, ROOF), (trunks, BARK), (crowns, LEAVES), (grounds, PAVING)] {
        parts.push((shell, colour, None));
    }
    parts
}

fn encode(origin: DVec3, parts: &[Painted], images: &[Vec<u8>]) -> Vec<u8> {
    let narrowed: Vec<Narrowed> = parts.iter().map(|(shell, ..)| shell.narrowed()).collect();
    let parts: Vec<glb::Part<'_>> = narrowed
        .iter()
        .zip(parts)
        .map(|(shell, &(_, colour, texture))| glb::Part {
            positions: &shell.positions,
            normals: &shell.normals,
            uv: if texture.is_some() { &shell.uv } else { &[] },
            triangles: &shell.triangles,
            colour,
            texture,
        })
        .collect();
    let images: Vec<&[u8]> = images.iter().map(Vec::as_slice).collect();
    glb::encode_model(origin, &parts, &images)
}

#[cfg(all(test, feature = "tiles3d"))]
mod tests {
    use super::*;
    use crate::generate::city::city;
    use crate::world::open;

    #[test]
    fn a_written_city_has_the_catalogues_tree_and_contents_that_fill_it() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().join("city");
        let params = CityParams { blocks_x: 3, blocks_y: 2, ..CityParams::default() };
        let written = write(&params, &out, &mut |_, _| {}).expect("in range");
        let catalogue = city(&params).expect("in range");
        let world = open(&out).expect("just written");
        assert_eq!(written.files, catalogue.tree.representations() as u64);
        assert_eq!(world.tree.representations(), catalogue.tree.representations());
        let [a, b] = [&world, &catalogue].map(|w| w.summary().bounds);
        // The ground's skirt of 0.2 m is not made.
        assert!(
            (a.min - b.min).abs().max_element() < 0.21 && (a.max - b.max).abs().max_element() < 1e-3,
            "{a:?} {b:?}"
        );
        let errors = |w: &World| {
            let tree = &w.tree;
            let mut errors: Vec<f64> = (0..tree.representations() as u32).map(|r| tree.error(RepId(r))).collect();
            errors.sort_by(f64::total_cmp);
            errors
        };
        assert_eq!(errors(&world), errors(&catalogue));
        assert!(world.notes.iter().all(|note| note.severity != crate::world::Severity::Missing), "{:?}", world.notes);
        let again = folder.path().join("again");
        write(&params, &again, &mut |_, _| {}).expect("in range");
        assert_eq!(open(&again).expect("written").hash(), world.hash(), "the same bytes from the same seed");
        let many = CityParams { blocks_x: 200, blocks_y: 200, ..CityParams::default() };
        assert!(write(&many, &folder.path().join("many"), &mut |_, _| {}).is_err());
    }
}
