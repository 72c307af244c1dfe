//! What a link delivers.

use foresight_sim::link::LinkTrace;
use std::io::Write;

pub(super) fn describe(out: &mut impl Write, file: &str, link: &LinkTrace) -> std::io::Result<()> {
    writeln!(out, "{file}: link")?;
    writeln!(
        out,
        "  {:.3} Mbit/s on average over {:.2} s, then it repeats; round trip {:.1} ms",
        link.mean_rate() * 8e-6,
        link.period().secs(),
        link.rtt().secs() * 1e3
    )?;
    for note in link.notes() {
        writeln!(out, "  {note}")?;
    }
    Ok(())
}
