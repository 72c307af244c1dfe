//! The columns that the terminal's table and the report's table share.

use super::number::{self, NEVER};
use crate::outcome::{Comparison, Interval, Intervals, PolicyOutcome, regime, relative_deficit};

/// Which end of a column is the good one.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Better {
    Higher,
    Lower,
    /// More is neither better nor worse.
    Neither,
}

/// A column of the table.
pub(super) struct Metric {
    pub(super) heading: &'static str,
    pub(super) explained: &'static str,
    pub(super) better: Better,
    decimals: fn(&Context) -> usize,
    value: fn(&PolicyOutcome, &Context) -> Option<f64>,
    interval: fn(&Intervals) -> Option<Interval>,
    /// What an interval's ends are divided by to come into the unit of `value`.
    divisor: f64,
}

/// What a figure needs beside its own policy.
pub(super) struct Context {
    foresight_deficit: Option<f64>,
    megabyte_decimals: usize,
}

impl Context {
    /// Of a whole comparison.
    pub(super) fn new(comparison: &Comparison) -> Self {
        let foresight_deficit = reference(comparison).and_then(|p| p.mean_deficit);
        let most = comparison.policies.iter().map(|p| p.bytes_fetched).filter(|b| b.is_finite()).fold(0.0, f64::max);
        Self { foresight_deficit, megabyte_decimals: if most < 1e7 { 2 } else { 1 } }
    }

    /// `deficit` relative to that of the first policy called `foresight…`.
    pub(super) fn against_foresight(&self, deficit: Option<f64>) -> Option<f64> {
        Some(relative_deficit(deficit?, self.foresight_deficit?))
    }
}

/// The first policy called `foresight…`.
pub(super) fn reference(comparison: &Comparison) -> Option<&PolicyOutcome> {
    comparison.policies.iter().find(|p| p.name.starts_with("foresight"))
}

/// A figure as text.
pub(super) struct Cell {
    pub(super) text: String,
    /// Half the width of the 95 % interval.
    pub(super) half_width: Option<String>,
}

impl Metric {
    /// The figure of one policy.
    pub(super) fn cell(&self, policy: &PolicyOutcome, context: &Context) -> Cell {
        let decimals = (self.decimals)(context);
        let value = (self.value)(policy, context);
        let half_width = value
            .and(policy.interval.as_ref())
            .and_then(self.interval)
            .map(|i| (i.upper - i.lower) / 2.0 / self.divisor)
            .filter(|half| half.is_finite())
            .map(|half| number::fixed(half, decimals));
        Cell { text: number::optional(value, decimals), half_width }
    }

    /// The text of the best figure of the column, where there is more than one policy and they differ.
    pub(super) fn best(&self, policies: &[PolicyOutcome], context: &Context) -> Option<String> {
        let values = policies.iter().filter_map(|p| (self.value)(p, context)).filter(|v| v.is_finite());
        let best = match self.better {
            Better::Higher => values.max_by(f64::total_cmp)?,
            Better::Lower => values.min_by(f64::total_cmp)?,
            Better::Neither => return None,
        };
        let text = number::fixed(best, (self.decimals)(context));
        policies.iter().any(|p| self.cell(p, context).text != text).then_some(text)
    }
}

fn none(_: &Intervals) -> Option<Interval> {
    None
}

/// All columns, in order.
pub(super) const METRICS: [Metric; 13] = [
    Metric {
        heading: "mean Q",
        explained: "mean quality over the frames with something in view, 1 is perfect",
        better: Better::Higher,
        decimals: |_| 3,
        value: |p, _| p.mean_quality,
        interval: |i| i.mean_quality,
        divisor: 1.0,
    },
    Metric {
        heading: "deficit",
        explained: "mean of 1 − Q",
        better: Better::Lower,
        decimals: |_| 4,
        value: |p, _| p.mean_deficit,
        interval: |i| i.mean_deficit,
        divisor: 1.0,
    },
    Metric {
        heading: "× foresight",
        explained: "mean deficit divided by that of the first policy called foresight (each at least 0.001): above 1 is worse",
        better: Better::Lower,
        decimals: |_| 2,
        value: |p, c| c.against_foresight(p.mean_deficit),
        interval: none,
        divisor: 1.0,
    },
    Metric {
        heading: "p05 Q",
        explained: "5th percentile of quality: one frame in twenty is worse",
        better: Better::Higher,
        decimals: |_| 3,
        value: |p, _| p.p05_quality,
        interval: |i| i.p05_quality,
        divisor: 1.0,
    },
    Metric {
        heading: "s<0.9",
        explained: "seconds with Q below 0.9",
        better: Better::Lower,
        decimals: |_| 1,
        value: |p, _| Some(p.seconds_below_0_9),
        interval: |i| i.seconds_below_0_9,
        divisor: 1.0,
    },
    Metric {
        heading: "s to 0.9",
        explained: "seconds until Q first reached 0.9; – if never",
        better: Better::Lower,
        decimals: |_| 1,
        value: |p, _| p.seconds_to_0_9,
        interval: |i| i.seconds_to_0_9,
        divisor: 1.0,
    },
    Metric {
        heading: "≤16\u{a0}px %",
        explained: "share of the weight in view shown at an error of at most 16 pixels",
        better: Better::Higher,
        decimals: |_| 1,
        value: |p, _| p.share_within_16px.map(|s| s * 100.0),
        interval: |i| i.share_within_16px,
        divisor: 0.01,
    },
    Metric {
        heading: "MB",
        explained: "megabytes that crossed the link, cancelled ones included",
        better: Better::Neither,
        decimals: |c| c.megabyte_decimals,
        value: |p, _| Some(p.bytes_fetched / 1e6),
        interval: |i| i.bytes_fetched,
        divisor: 1e6,
    },
    Metric {
        heading: "wasted %",
        explained: "share of those bytes whose representation was never the best for anything in view",
        better: Better::Lower,
        decimals: |_| 1,
        value: |p, _| (p.bytes_fetched > 0.0).then(|| p.bytes_wasted / p.bytes_fetched * 100.0),
        interval: none,
        divisor: 1.0,
    },
    Metric {
        heading: "cancelled MB",
        explained: "megabytes that had crossed the link when their request was cancelled",
        better: Better::Lower,
        decimals: |c| c.megabyte_decimals,
        value: |p, _| Some(p.bytes_cancelled / 1e6),
        interval: |i| i.bytes_cancelled,
        divisor: 1e6,
    },
    Metric {
        heading: "evictions",
        explained: "representations discarded",
        better: Better::Neither,
        decimals: |_| 0,
        value: |p, _| Some(p.evictions),
        interval: |i| i.evictions,
        divisor: 1.0,
    },
    Metric {
        heading: "p50 µs",
        explained: "median time of a decision on this machine, microseconds",
        better: Better::Neither,
        decimals: |_| 1,
        value: |p, _| (p.decisions > 0.0).then_some(p.decision_ns.p50 as f64 / 1e3),
        interval: none,
        divisor: 1.0,
    },
    Metric {
        heading: "p99 µs",
        explained: "99th percentile of the time of a decision, microseconds",
        better: Better::Neither,
        decimals: |_| 1,
        value: |p, _| (p.decisions > 0.0).then_some(p.decision_ns.p99 as f64 / 1e3),
        interval: none,
        divisor: 1.0,
    },
];

/// The upper bound's figures in the columns where it has one: mean Q, deficit, deficit relative to Foresight's.
pub(super) fn bound_cell(column: usize, comparison: &Comparison, context: &Context) -> String {
    let quality = comparison.upper_bound.mean_quality;
    let deficit = quality.map(|q| (1.0 - q).max(0.0));
    match column {
        0 => number::optional(quality, 3),
        1 => number::optional(deficit, 4),
        2 => number::optional(context.against_foresight(deficit), 2),
        _ => String::new(),
    }
}

/// How tight the link is: `starved` (ρ > 2), `matched`, `ample` (ρ < ½), or [`NEVER`].
pub(super) fn pressure_word(rho: f64) -> &'static str {
    if rho.is_nan() { NEVER } else { regime(rho) }
}
