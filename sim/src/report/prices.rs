//! What a little more link or memory would have bought: the bound's shadow prices.

use maud::{Markup, html};

use super::number::{fixed, significant};
use super::plot::{Axis, bars, frame};
use crate::outcome::{Comparison, ShadowPrices};

/// Quality is drawn in thousandths.
const THOUSANDTHS: f64 = 1e3;

/// A picture for the link and one for memory; `None` without a bound.
pub(super) fn prices(comparison: &Comparison, x: &Axis) -> Option<Markup> {
    let prices = comparison.shadow_prices.as_ref()?;
    let picture = |heading: &str, unit: &str, values: &[f64], throughout: f64| {
        let bars_of: Vec<[f64; 3]> = (0..)
            .zip(values)
            .map(|(i, &v)| [f64::from(i) * prices.interval_s, f64::from(i + 1) * prices.interval_s, v * THOUSANDTHS])
            .filter(|[_, _, v]| v.is_finite())
            .collect();
        let most = bars_of.iter().map(|b| b[2]).fold(0.0, f64::max);
        let y = Axis::linear(0.0, most * 1.02, 3, "Q/1000");
        html! {
            figure {
                figcaption {
                    b { (heading) } " "
                    span.note { "throughout: +" (significant(throughout * THOUSANDTHS)) " thousandths of Q per " (unit) " more" }
                }
                (frame("short", heading, x, &y, &html! { path.capacity d=(bars(x, &y, &bars_of)) {} }, &html! {}))
            }
        }
    };
    Some(html! {
        div.multiples {
            (picture("1 Mbit/s more in this interval", "Mbit/s", &prices.per_mbit_s, prices.per_mbit_s_throughout))
            (picture("1 MiB more in this interval", "MiB", &prices.per_mib, prices.per_mib_throughout))
        }
        p.note { (sentence(prices)) }
    })
}

/// The prices of a small change, in words.
pub(super) fn sentence(prices: &ShadowPrices) -> String {
    format!(
        "1 % more link would raise the bound by {} thousandths of Q, 1 % more memory by {}",
        fixed(prices.per_percent_of_link * THOUSANDTHS, 3),
        fixed(prices.per_percent_of_memory * THOUSANDTHS, 3)
    )
}
