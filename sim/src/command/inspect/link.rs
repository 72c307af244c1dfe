//! What a link delivers.

use foresight_traces::link::{LinkStatistics, LinkTrace};
use std::io::Write;

pub(super) fn describe(out: &mut impl Write, file: &str, link: &LinkTrace) -> std::io::Result<()> {
    writeln!(out, "{file}: link")?;
    let (least, greatest) = link.rtt_range();
    writeln!(
        out,
        "  {:.3} Mbit/s on average over {:.2} s, then it repeats; round trip {}",
        link.mean_rate() * 8e-6,
        link.period().secs(),
        if least == greatest {
            format!("{:.1} ms", least.secs() * 1e3)
        } else {
            format!("{:.1} to {:.1} ms", least.secs() * 1e3, greatest.secs() * 1e3)
        }
    )?;
    let statistics = LinkStatistics::new(link);
    let [p05, p25, median, p75, p95] = statistics.percentiles.map(|rate| format!("{:.3}", rate * 8e-6));
    writeln!(out, "  by the second: median {median} Mbit/s; 5, 25, 75, 95 %: {p05}, {p25}, {p75}, {p95} Mbit/s")?;
    writeln!(
        out,
        "  {:.1} % of the seconds deliver less than 5 % of the mean, at most {:.0} s in a row; longest time without a byte {:.3} s",
        statistics.near_zero_share * 100.0,
        statistics.longest_near_zero.secs(),
        statistics.longest_outage.secs()
    )?;
    if link.loss() > 0.0 {
        writeln!(out, "  {:.2} % of the requests fail", link.loss() * 100.0)?;
    }
    for note in link.notes() {
        writeln!(out, "  {note}")?;
    }
    Ok(())
}
