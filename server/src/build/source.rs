//! What a world is built from: one or more inputs as one source, and what a first pass over them finds.

use super::BuildError;
use foresight_index::specification::Progress;
use foresight_index::surface::{self, SurfaceSource, Surfaces};
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

    /// Away from the ground, unit length.
    pub(super) fn up(&self) -> DVec3 {
        self.inputs[0].source.up()
    }

    /// How world space lies on the Earth, if it does.
    pub(super) fn georeference(&self) -> Option<Georeference> {
        self.inputs[0].source.georeference()
    }

    /// Number of pieces.
    pub(super) fn pieces(&self) -> usize {
        self.first.last().copied().unwrap_or(0)
    }

    fn place(&self, piece: usize) -> (&Input, usize) {
        let input = self.first.partition_point(|&first| first <= piece) - 1;
        (&self.inputs[input], piece - self.first[input])
    }

    /// A piece with its textures.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub(super) fn load(&self, piece: usize) -> Result<Surfaces, BuildError> {
        let (input, piece) = self.place(piece);
        Ok(input.source.load(piece)?)
    }

    /// Looks at every piece once.
    ///
    /// # Errors
    /// A file that cannot be read; nothing to build from.
    pub(super) fn survey(&self, told: &(dyn Fn(usize) + Sync)) -> Result<Survey, BuildError> {
        let mut survey = Survey::default();
        let pieces: Vec<usize> = (0..self.pieces()).collect();
        for some in pieces.chunks(64) {
            let looked: Vec<_> = some
                .par_iter()
                .map(|&piece| {
                    let (input, at) = self.place(piece);
                    input.source.read(at).map(|read| Look::at(&read.triangles, read.left_out))
                })
                .collect();
            for look in looked {
                survey.add(look?);
            }
            told(survey.pieces.len());
        }
        if survey.bounds.is_empty() {
            return Err(BuildError::Nothing);
        }
        Ok(survey)
    }
}

/// What a first pass found.
#[derive(Debug)]
pub(super) struct Survey {
    /// Box around each piece's finite corners; empty where there are none.
    pub(super) pieces: Vec<Aabb>,
    /// Box around all.
    pub(super) bounds: Aabb,
    /// Triangles.
    pub(super) triangles: u64,
    /// Triangles with a corner that is not finite, which are left out.
    pub(super) not_finite: u64,
    /// Area by orientation, m².
    pub(super) orientations: Vec<(DVec3, f64)>,
    /// What was left out, in words.
    pub(super) left_out: Vec<String>,
    sums: Vec<[f64; 4]>,
}

impl Default for Survey {
    fn default() -> Survey {
        Survey {
            pieces: Vec::new(),
            bounds: Aabb::EMPTY,
            triangles: 0,
            not_finite: 0,
            orientations: Vec::new(),
            left_out: Vec::new(),
            sums: vec![[0.0; 4]; BINS],
        }
    }
}

/// Most remarks that are kept.
const REMARKS_MAX: usize = 20;

/// Bins of orientations: the faces of a cube in 8 × 8.
const BINS: usize = 6 * GRID * GRID;
const GRID: usize = 8;

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the grid")]
fn bin(normal: DVec3) -> usize {
    let axis = if normal.abs().x >= normal.abs().max_element() {
        0
    } else if normal.abs().y >= normal.abs().z {
        1
    } else {
        2
    };
    let along = normal[axis];
    let at = |v: f64| ((0.5 + 0.5 * v / along.abs()) * GRID as f64).clamp(0.0, GRID as f64 - 1.0) as usize;
    let (u, v) = (at(normal[(axis + 1) % 3]), at(normal[(axis + 2) % 3]));
    ((2 * axis + usize::from(along > 0.0)) * GRID + u) * GRID + v
}

/// What is found in a piece.
struct Look {
    bounds: Aabb,
    triangles: u64,
    not_finite: u64,
    sums: Vec<[f64; 4]>,
    left_out: Vec<String>,
}

impl Look {
    fn at(triangles: &[foresight_index::orthoview::raster::Triangle], left_out: Vec<String>) -> Look {
        let mut look = Look {
            bounds: Aabb::EMPTY,
            triangles: triangles.len() as u64,
            not_finite: 0,
            sums: vec![[0.0; 4]; BINS],
            left_out,
        };
        for triangle in triangles {
            let [a, b, c] = triangle.corners;
            if !(a.is_finite() && b.is_finite() && c.is_finite()) {
                look.not_finite += 1;
                continue;
            }
            look.bounds = look.bounds.union(Aabb { min: a.min(b).min(c), max: a.max(b).max(c) });
            let twice = (b - a).cross(c - a);
            let area = 0.5 * twice.length();
            if area > 0.0 && area.is_finite() {
                let normal = 0.5 * twice / area;
                // Either side of what is two-sided does.
                let sides: &[DVec3] = if triangle.two_sided { &[normal, -normal] } else { &[normal] };
                for &side in sides {
                    let area = area / sides.len() as f64;
                    let sum = &mut look.sums[bin(side)];
                    (0..3).for_each(|axis| sum[axis] += area * side[axis]);
                    sum[3] += area;
                }
            }
        }
        look
    }
}

impl Survey {
    fn add(&mut self, look: Look) {
        self.pieces.push(look.bounds);
        self.bounds = self.bounds.union(look.bounds);
        self.triangles += look.triangles;
        self.not_finite += look.not_finite;
        for (sum, more) in self.sums.iter_mut().zip(&look.sums) {
            (0..4).for_each(|i| sum[i] += more[i]);
        }
        for text in look.left_out {
            if self.left_out.len() < REMARKS_MAX && !self.left_out.contains(&text) {
                self.left_out.push(text);
            }
        }
        self.orientations = self
            .sums
            .iter()
            .filter(|sum| sum[3] > 0.0)
            .map(|sum| (DVec3::new(sum[0], sum[1], sum[2]).normalize_or(DVec3::Z), sum[3]))
            .collect();
    }
}
