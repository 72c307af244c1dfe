//! What a world is built from: one or more inputs as one source, and how large its leaves ought to be.

use super::BuildError;
use foresight_index::import::tiles3d::ContentError;
use foresight_index::specification::Progress;
use foresight_index::surface::{self, Piece, SurfaceSource};
use foresight_index::world::Georeference;
use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;
use rayon::prelude::*;
use std::sync::Arc;

/// The inputs of a build, their pieces one after the other.
pub(super) struct Sources {
    inputs: Vec<Input>,
    /// First piece of each input, and the number of all.
    first: Vec<usize>,
}

/// One input.
struct Input {
    name: String,
    source: Box<dyn SurfaceSource>,
    identity: [u8; 32],
}

impl Sources {
    /// Opens inputs as they are named on the command line.
    ///
    /// # Errors
    /// An input that cannot be opened, and inputs that lie in different coordinates.
    pub(super) fn open(names: &[String]) -> Result<Sources, BuildError> {
        let silent: Progress = Arc::new(|_, _| {});
        let mut sources = Sources { inputs: Vec::new(), first: vec![0] };
        for name in names {
            let source = surface::open(name, &silent)?;
            if let Some(first) = sources.inputs.first() {
                let (a, b) = (first.source.georeference(), source.georeference());
                if a != b || first.source.up().dot(source.up()) < 0.999 {
                    return Err(BuildError::Inputs { first: first.name.clone(), other: name.clone() });
                }
            }
            let identity = source.identity()?;
            sources.first.push(sources.pieces() + source.pieces());
            sources.inputs.push(Input { name: name.clone(), source, identity });
        }
        if sources.pieces() == 0 {
            return Err(BuildError::Nothing);
        }
        Ok(sources)
    }

    /// Names and identities.
    pub(super) fn identities(&self) -> impl Iterator<Item = (&str, [u8; 32])> {
        self.inputs.iter().map(|input| (input.name.as_str(), input.identity))
    }

    fn place(&self, piece: usize) -> (&dyn SurfaceSource, usize) {
        let input = self.first.partition_point(|&first| first <= piece) - 1;
        (&*self.inputs[input].source, piece - self.first[input])
    }

    /// A power of two in metres, so that a leaf of the world's larger two extents holds about so many triangles on average.
    /// What lies farther out than all but a fifth of a percent of the triangles does not count.
    ///
    /// # Errors
    /// A piece that cannot be read.
    pub(super) fn leaf_side(&self, triangles_a_leaf: f64) -> Result<f64, BuildError> {
        let pieces: Vec<usize> = (0..self.pieces()).collect();
        let mut sample = Vec::new();
        for some in pieces.chunks(64) {
            let read: Vec<_> = some.par_iter().map(|&piece| self.read(piece).map(|read| middles(&read))).collect();
            for middles in read {
                sample.extend(middles?);
            }
        }
        let total: f64 = sample.iter().map(|(_, weight)| weight).sum();
        let mut extents = [0, 1, 2].map(|axis| {
            let mut values: Vec<(f64, f64)> = sample.iter().map(|(at, weight)| (at[axis], *weight)).collect();
            values.sort_by(|a, b| a.0.total_cmp(&b.0));
            let at = |share: f64| {
                let mut below = 0.0;
                let found = values.iter().find(|(_, weight)| {
                    below += weight;
                    below >= share * total
                });
                found.or(values.last()).map_or(0.0, |(value, _)| *value)
            };
            at(0.998) - at(0.002)
        });
        extents.sort_by(f64::total_cmp);
        let [_, second, largest] = extents;
        let least = (largest * 1e-6).max(1e-3);
        let area = largest * second.max(least);
        let side = (area * triangles_a_leaf / total.max(1.0)).sqrt();
        let side = if side.is_finite() { side.clamp(least, largest.max(least)) } else { largest.max(least) };
        Ok(libm::exp2(libm::round(libm::log2(side))))
    }
}

/// Middles of at most 256 of a piece's triangles, evenly spaced, and how many each stands for.
fn middles(piece: &Piece) -> Vec<(DVec3, f64)> {
    let step = piece.triangles.len().div_ceil(256).max(1);
    let some = piece.triangles.iter().step_by(step).map(|t| (t.corners[0] + t.corners[1] + t.corners[2]) / 3.0);
    let some: Vec<DVec3> = some.filter(|at| at.is_finite()).collect();
    let weight = piece.triangles.len() as f64 / some.len().max(1) as f64;
    some.into_iter().map(|at| (at, weight)).collect()
}

impl SurfaceSource for Sources {
    fn pieces(&self) -> usize {
        self.first.last().copied().unwrap_or(0)
    }

    fn declared(&self, piece: usize) -> Option<Aabb> {
        let (source, piece) = self.place(piece);
        source.declared(piece)
    }

    fn name(&self, piece: usize) -> &str {
        let (source, piece) = self.place(piece);
        source.name(piece)
    }

    fn read(&self, piece: usize) -> Result<Piece, ContentError> {
        let (source, piece) = self.place(piece);
        source.read(piece)
    }

    fn up(&self) -> DVec3 {
        self.inputs[0].source.up()
    }

    fn georeference(&self) -> Option<Georeference> {
        self.inputs[0].source.georeference()
    }

    fn identity(&self) -> Result<[u8; 32], ContentError> {
        let mut hasher = blake3::Hasher::new();
        for input in &self.inputs {
            hasher.update(&input.identity);
        }
        Ok(*hasher.finalize().as_bytes())
    }
}
