//! What generated worlds with geometry share: a 3D Tiles 1.1 tileset in a folder that appears whole.

use std::fs;
use std::io;
use std::path::Path;

use foresight_scheduler::lod_tree::Aabb;
use rayon::prelude::*;
use serde_json::{Value, json};

use super::document::GenerateError;
use super::staging::Staging;

/// Contents made and written at a time, between two reports of progress.
const BATCH: usize = 256;

/// What was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Written {
    /// Tiles of the tileset.
    pub tiles: u64,
    /// Files of contents.
    pub files: u64,
    /// Their bytes.
    pub bytes: u64,
}

/// `box` of 3D Tiles.
pub(super) fn volume(bounds: Aabb) -> Value {
    let (middle, half) = (bounds.centre(), 0.5 * (bounds.max - bounds.min));
    json!({ "box": [middle.x, middle.y, middle.z, half.x, 0.0, 0.0, 0.0, half.y, 0.0, 0.0, 0.0, half.z] })
}

/// Refuses more tiles than are written.
pub(super) fn check_tiles(found: u64, most: u64) -> Result<(), GenerateError> {
    if found <= most {
        return Ok(());
    }
    Err(GenerateError::TooMany {
        found,
        what: "tiles with geometry",
        limit: format!("{most}; with --catalogue-only only the parameters are written, and the world may have more"),
    })
}

/// Writes the folder `out`: the contents, made in parallel from `parts`, then the tileset.
pub(super) fn write<T: Sync>(
    out: &Path,
    parts: &[T],
    content: impl Fn(&T) -> (String, Vec<u8>) + Sync,
    root: (f64, Value),
    tiles: u64,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Written, GenerateError> {
    let fault = |source| GenerateError::Io { file: out.to_owned(), source };
    let staging = Staging::begin(out).map_err(fault)?;
    let mut written = Written { tiles, files: 0, bytes: 0 };
    for batch in parts.chunks(BATCH) {
        progress(written.files, parts.len() as u64);
        let lengths: io::Result<Vec<u64>> = batch
            .par_iter()
            .map(|part| {
                let (file, bytes) = content(part);
                fs::write(staging.place(&file)?, &bytes)?;
                Ok(bytes.len() as u64)
            })
            .collect();
        written.files += batch.len() as u64;
        written.bytes += lengths.map_err(fault)?.iter().sum::<u64>();
    }
    progress(written.files, parts.len() as u64);
    let (error, root) = root;
    let tileset = json!({
        "asset": { "version": "1.1", "generator": "foresight" },
        "extras": { "synthetic": true },
        "geometricError": error,
        "root": root,
    });
    let text = serde_json::to_vec(&tileset).map_err(|error| fault(error.into()))?;
    staging.place("tileset.json").and_then(|place| fs::write(place, text)).map_err(fault)?;
    staging.finish().map_err(fault)?;
    Ok(written)
}
