//! Orthoviews of a made-up city: one of every cell (a district, a block) from each of nine directions, with the sizes that
//! those of a built city have, and what its leaves' surfaces face.
//!
//! A pixel's side is the cell's ÷ [`super::CityParams::orthoviews`]; the error is [`SAMPLE_ERROR`] sides, as if nothing hid
//! anything. An image has as many pixels as the cell's box projected
//! along its direction; bytes a pixel are those of `foresight-server build` over a generated city of 4 × 4 blocks, lossless
//! WebP colours, depth and normals: 0.4 from above, 1.0 from the sides (there is much that stands in front of the sky), 0.9
//! from the upper corners; decoded 8, as a client uploads them.

use super::{City, Level, Rectangle, Standing};
use crate::orthoview::SAMPLE_ERROR;
use foresight_scheduler::benefit::element::{ELEMENTS, nearest};
use foresight_scheduler::lod_tree::{LodTreeError, Representation};
use glam::DVec3;

/// From above, the four sides, the four upper corners: the direction from the cell to the eye, its code, and wire bytes a
/// pixel.
const DIRECTIONS: [([i8; 3], f64); 9] = [
    ([0, 0, 1], 0.4),
    ([1, 0, 0], 1.0),
    ([-1, 0, 0], 1.0),
    ([0, 1, 0], 1.0),
    ([0, -1, 0], 1.0),
    ([1, 1, 1], 0.9),
    ([1, -1, 1], 0.9),
    ([-1, 1, 1], 0.9),
    ([-1, -1, 1], 0.9),
];
const DECODED_PER_PIXEL: f64 = 8.0;

impl City<'_> {
    /// A cell's own representations: its coarse geometry, or its orthoviews in a city that has them.
    pub(super) fn cell(
        &mut self,
        cell: Rectangle,
        coarse: &Level,
        folder: &str,
        file: &str,
    ) -> Result<(), LodTreeError> {
        if self.params.orthoviews == 0 {
            return self.add(coarse, None, folder, file).map(|_| ());
        }
        let folder = format!("{folder}{}/", file.trim_end_matches(".glb"));
        let size = cell.size();
        let pixel = size.max_element() / f64::from(self.params.orthoviews);
        let height = self.usual_height(cell);
        let faces = DVec3::new(size.y * height, size.x * height, size.x * size.y);
        for (signs, bytes) in DIRECTIONS {
            let along = DVec3::from_array(signs.map(f64::from)).normalize();
            let pixels = (faces.dot(along.abs()) / (pixel * pixel)).max(1.0);
            let [x, y, z] = signs.map(|sign| (sign + 1) as u8);
            let name: String = signs.iter().map(|s| ["n", "o", "p"][(s + 1) as usize]).collect();
            let (prefix, tail) = (self.uris.intern(&folder), self.uris.intern(&format!("{name}.fsov")));
            self.uris.push(prefix, tail);
            #[expect(clippy::cast_possible_truncation, reason = "metres, to 7 digits")]
            let error = (SAMPLE_ERROR * pixel) as f32;
            self.builder.add(Representation {
                wire_bytes: (pixels * bytes).max(1.0) as u32,
                decoded_bytes: (pixels * DECODED_PER_PIXEL) as u32,
                error,
                prerequisite: None,
                direction: Some(9 * x + 3 * y + z),
            })?;
        }
        Ok(())
    }

    /// How high a cell is built up, metres: as its place nearest to the middle of the city.
    fn usual_height(&self, cell: Rectangle) -> f64 {
        let nearest = cell.min.max(-cell.max).max(glam::DVec2::ZERO);
        16.0 + self.params.tower_height * self.centrality(nearest) / 3.0
    }
}

impl Standing {
    /// μ: ground faces up, a tree every way but down, a building by its walls and its roof.
    pub(super) fn surface(self) -> [f32; ELEMENTS] {
        let mut shares = [0.0; ELEMENTS];
        match self {
            Standing::Ground(_) => shares[nearest(DVec3::Z)] = 1.0,
            Standing::Tree { .. } => {
                for (signs, _) in DIRECTIONS {
                    shares[nearest(DVec3::from_array(signs.map(f64::from)))] = 1.0;
                }
            }
            Standing::Building { footprint, height } => {
                let size = footprint.size();
                for (normal, area) in [
                    (DVec3::X, size.y * height),
                    (DVec3::NEG_X, size.y * height),
                    (DVec3::Y, size.x * height),
                    (DVec3::NEG_Y, size.x * height),
                    (DVec3::Z, size.x * size.y),
                ] {
                    #[expect(clippy::cast_possible_truncation, reason = "square metres of a building")]
                    let area = area as f32;
                    shares[nearest(normal)] = area;
                }
            }
        }
        shares
    }
}

#[cfg(test)]
mod tests {
    use super::super::{CityParams, city};
    use super::*;
    use foresight_scheduler::lod_tree::{NodeId, RepId};

    #[test]
    fn cells_have_nine_directions_and_leaves_their_geometry() {
        let params = CityParams { blocks_x: 4, blocks_y: 3, orthoviews: 256, ..CityParams::default() };
        let (with, without) = (city(&params).unwrap(), city(&CityParams { orthoviews: 0, ..params }).unwrap());
        let tree = &with.tree;
        assert!(tree.has_directions() && tree.nodes() == without.tree.nodes());
        let directed = (0..tree.representations() as u32).map(RepId).filter(|&rep| tree.direction(rep).is_some());
        let directed: Vec<RepId> = directed.collect();
        let inner = (0..tree.nodes() as u32).filter(|&n| !tree.is_leaf(NodeId(n))).count();
        assert_eq!(directed.len(), 9 * inner);
        for &rep in &directed {
            assert!(with.uri(rep).to_string().ends_with(".fsov"), "{rep:?}");
            assert!(tree.error(rep) >= 100.0 / 256.0 * 0.8 && tree.wire_bytes(rep) > 1000, "{rep:?}");
        }
        // Nothing faces down.
        let below = nearest(DVec3::NEG_Z);
        assert!(tree.surface(tree.root())[below] == 0.0 && tree.surface(tree.root())[nearest(DVec3::Z)] > 120_000.0);
        // 100 bytes a representation, surfaces included.
        assert!(tree.heap_bytes() <= 100 * tree.representations(), "{}", tree.heap_bytes() / tree.representations());
    }
}
