//! What a world contains.

use super::megabytes;
use foresight_index::world::World;
use std::io::Write;

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
    for note in &world.notes {
        writeln!(out, "  {note}")?;
    }
    Ok(())
}
