//! What a world contains.

use super::megabytes;
use foresight_index::world::{World, WorldKind};
use std::io::Write;

/// A world of fewer bytes is complete within seconds on most links.
const SMALL_BYTES: u64 = 16_000_000;

pub(super) fn describe(out: &mut impl Write, file: &str, world: &World) -> std::io::Result<()> {
    let summary = world.summary();
    let size = summary.bounds.max - summary.bounds.min;
    writeln!(out, "{file}: world, {}", world.kind)?;
    writeln!(
        out,
        "  {} representations on {} nodes, {} of them leaves; depth {}",
        summary.representations, summary.nodes, summary.leaves, summary.depth
    )?;
    writeln!(
        out,
        "  {:.2} MB on the wire, {:.2} MB decoded with mips; {:.1} MB of memory for the tree ({:.1} bytes a representation)",
        megabytes(summary.wire_bytes),
        megabytes(summary.decoded_bytes),
        megabytes(world.tree.heap_bytes() as u64),
        world.tree.heap_bytes() as f64 / summary.representations.max(1) as f64
    )?;
    writeln!(out, "  extent {:.2} × {:.2} × {:.2} m, up {:.3}", size.x, size.y, size.z, world.up)?;
    if summary.wire_bytes < SMALL_BYTES {
        let seconds = summary.wire_bytes as f64 * 8.0 / 10e6;
        writeln!(
            out,
            "  mind: small: all of it crosses 10 Mbit/s in {seconds:.1} s, {:.1} kB a representation on average; after that no policy \
             can differ, so take a thin or distant link{}",
            summary.wire_bytes as f64 / 1e3 / summary.representations.max(1) as f64,
            if world.kind == WorldKind::Tiles3d { ", or repeat it as --world mosaic:TILESET,grid=16" } else { "" }
        )?;
    }
    for note in &world.notes {
        writeln!(out, "  {note}")?;
    }
    Ok(())
}
