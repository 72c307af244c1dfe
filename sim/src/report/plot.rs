//! Axes, curves and legends as inline SVG that fills whatever width the page has.
//!
//! Not a plotting library, because those looked at (`plotters`, `kuva`) write labels into the coordinates of the
//! curves at a fixed size: on a phone of 320 px they either shrink to 4 px or scroll, and `plotters` writes no dashes
//! and colours only as literals. Here the SVG stretches (`preserveAspectRatio="none"`, strokes that do not scale), the
//! labels are text of the page beside it, and colours are classes that the style sheet fills for light and dark.

use maud::{Markup, html};

use super::downsample::drawable;
use super::number::{printable, trimmed};

/// Width of the drawing, user units.
const WIDTH: f64 = 1000.0;
/// Height of the drawing, user units.
const HEIGHT: f64 = 300.0;
/// Number of series colours in the style sheet.
const COLOURS: usize = 8;
/// Number of dash patterns in the style sheet; with [`COLOURS`] 40 pairs, all different.
const DASHES: usize = 5;
/// Least distance of two labels at the ends of curves, share of the height.
const LABEL_PITCH: f64 = 0.062;

/// Class of a series' colour.
pub(super) fn colour_class(index: usize) -> String {
    format!("c{}", index % COLOURS)
}

/// Classes of a series' stroke: `c` for its colour, `d` for its dashes.
pub(super) fn stroke_class(index: usize) -> String {
    format!("curve {} d{}", colour_class(index), index % DASHES)
}

/// Classes of a series' curve: [`stroke_class`], and `s` by which its legend hides it.
pub(super) fn series_class(index: usize) -> String {
    format!("s{index} {}", stroke_class(index))
}

/// Classes of the upper bound's curve.
pub(super) const BOUND_CLASS: &str = "curve sb bound";

/// An axis: linear with ticks at 1, 2 or 5 times a power of ten, or logarithmic with ticks at powers of ten.
pub(super) struct Axis {
    lower: f64,
    upper: f64,
    ticks: Vec<(f64, String)>,
    title: String,
    scale: Scale,
}

/// How values become lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Scale {
    Linear,
    Logarithmic,
}

/// Most labelled decades of a logarithmic axis.
const DECADES_LABELLED: i32 = 7;

impl Axis {
    /// From `lower` to `upper` with at most about `count` ticks. An empty, reversed or undrawable range becomes one
    /// that starts at `lower` (or 0).
    pub(super) fn linear(lower: f64, upper: f64, count: usize, title: &str) -> Self {
        let lower = if drawable(lower) { lower } else { 0.0 };
        let upper = if drawable(upper) && upper > lower { upper } else { lower + f64::max(1.0, lower.abs() * 1e-3) };
        let step = nice_step((upper - lower) / count.max(1) as f64);
        let decimals = (-libm::floor(libm::log10(step))).clamp(0.0, 9.0) as usize;
        let first = (lower / step - 1e-9).ceil();
        let ticks = (0..=count + 1)
            .map(|k| (first + k as f64) * step)
            .take_while(|v| *v <= upper + step * 1e-9)
            .map(|v| (v, super::number::fixed(v, decimals)))
            .collect();
        Self { lower, upper, ticks, title: title.to_owned(), scale: Scale::Linear }
    }

    /// Whole decades around `values`, which are positive and drawable; `None` without any.
    pub(super) fn logarithmic(values: impl Iterator<Item = f64>, title: &str) -> Option<Self> {
        let (mut least, mut greatest) = (f64::INFINITY, 0f64);
        for value in values.filter(|v| drawable(*v) && *v > 0.0) {
            (least, greatest) = (least.min(value), greatest.max(value));
        }
        if least > greatest {
            return None;
        }
        let first = libm::floor(libm::log10(least) + 1e-9) as i32;
        let last = (libm::ceil(libm::log10(greatest) - 1e-9) as i32).max(first + 1);
        let step = ((last - first - 1) / DECADES_LABELLED + 1).max(1);
        let ticks = (first..=last)
            .step_by(step as usize)
            .map(|decade| {
                let label = match decade {
                    0..=4 => format!("{}", 10_i64.pow(decade.unsigned_abs())),
                    -3..=-1 => super::number::fixed(libm::pow(10.0, f64::from(decade)), decade.unsigned_abs() as usize),
                    _ => format!("1e{decade}"),
                };
                (libm::pow(10.0, f64::from(decade)), label)
            })
            .collect();
        let (lower, upper) = (libm::pow(10.0, f64::from(first)), libm::pow(10.0, f64::from(last)));
        Some(Self { lower, upper, ticks, title: title.to_owned(), scale: Scale::Logarithmic })
    }

    /// Seconds from `lower` to `upper`, labelled in seconds, minutes or hours.
    pub(super) fn time(lower: f64, upper: f64, count: usize) -> Self {
        let (unit, title) = match upper - lower {
            span if span > 10_800.0 => (3600.0, "time, hours"),
            span if span > 300.0 => (60.0, "time, minutes"),
            _ => (1.0, "time, seconds"),
        };
        let mut axis = Self::linear(lower / unit, upper / unit, count, title);
        axis.lower *= unit;
        axis.upper *= unit;
        for tick in &mut axis.ticks {
            tick.0 *= unit;
        }
        axis
    }

    /// Lower and upper end.
    pub(super) fn range(&self) -> (f64, f64) {
        (self.lower, self.upper)
    }

    /// Where `value` lies between the ends, 0 to 1; beyond an end counts as the end.
    pub(super) fn share(&self, value: f64) -> f64 {
        let share = match self.scale {
            Scale::Linear => (value - self.lower) / (self.upper - self.lower),
            Scale::Logarithmic => libm::log(value / self.lower) / libm::log(self.upper / self.lower),
        };
        let share = share.clamp(0.0, 1.0);
        if share.is_nan() { 0.0 } else { share }
    }
}

/// The least of 1, 2, 5 × 10ⁿ that is at least `raw` (> 0).
pub(super) fn nice_step(raw: f64) -> f64 {
    let base = libm::pow(10.0, libm::floor(libm::log10(raw)));
    [1.0, 2.0, 5.0].into_iter().map(|m| m * base).find(|s| *s >= raw * (1.0 - 1e-9)).unwrap_or(10.0 * base)
}

/// A drawing coordinate.
pub(super) fn coordinate(value: f64) -> String {
    trimmed(value, 1)
}

/// A percentage for a style attribute or an SVG length.
pub(super) fn percent(share: f64) -> String {
    format!("{}%", trimmed(share * 100.0, 2))
}

fn horizontal(x: &Axis, value: f64) -> String {
    coordinate(x.share(value) * WIDTH)
}

fn vertical(y: &Axis, value: f64) -> String {
    coordinate((1.0 - y.share(value)) * HEIGHT)
}

/// Path data of straight lines through each run of points; a run of one point is a short dash.
pub(super) fn lines(x: &Axis, y: &Axis, runs: &[Vec<[f64; 2]>]) -> String {
    let mut path = String::new();
    for run in runs {
        for (index, point) in run.iter().enumerate() {
            path.push(if index == 0 { 'M' } else { 'L' });
            path.push_str(&format!("{} {}", horizontal(x, point[0]), vertical(y, point[1])));
        }
        if run.len() == 1 {
            path.push_str("h2");
        }
    }
    path
}

/// Path data of a distribution's steps, from the left end to the right end of the axis.
pub(super) fn steps(x: &Axis, y: &Axis, points: &[[f64; 2]]) -> String {
    if points.is_empty() {
        return String::new();
    }
    let mut path = format!("M0 {}", vertical(y, 0.0));
    for point in points {
        path.push_str(&format!("H{}V{}", horizontal(x, point[0]), vertical(y, point[1])));
    }
    path.push_str(&format!("H{}", coordinate(WIDTH)));
    path
}

/// Path data of the area between the axis and bars `(start, end, height)`.
pub(super) fn bars(x: &Axis, y: &Axis, bars: &[[f64; 3]]) -> String {
    let (Some(first), Some(last)) = (bars.first(), bars.last()) else { return String::new() };
    let floor = vertical(y, 0.0);
    let mut path = format!("M{} {floor}", horizontal(x, first[0]));
    for bar in bars {
        path.push_str(&format!("V{}H{}", vertical(y, bar[2]), horizontal(x, bar[1])));
    }
    path.push_str(&format!("L{} {floor}Z", horizontal(x, last[1])));
    path
}

/// Path data of full-height bands over stretches of the horizontal axis.
pub(super) fn bands(x: &Axis, stretches: &[[f64; 2]]) -> String {
    let band = |s: &[f64; 2]| format!("M{} 0V{HEIGHT}H{}V0Z", horizontal(x, s[0]), horizontal(x, s[1]));
    stretches.iter().map(band).collect()
}

/// Path data of a line across at a height.
pub(super) fn level(y: &Axis, value: f64) -> String {
    format!("M0 {}H{}", vertical(y, value), coordinate(WIDTH))
}

/// A drawing within its axes. `described` says in words what is to be seen.
pub(super) fn frame(class: &str, described: &str, x: &Axis, y: &Axis, drawing: &Markup, beside: &Markup) -> Markup {
    let mut grid = String::new();
    for (value, _) in &x.ticks {
        grid.push_str(&format!("M{} 0V{HEIGHT}", horizontal(x, *value)));
    }
    for (value, _) in &y.ticks {
        grid.push_str(&level(y, *value));
    }
    html! {
        div class={ "plot " (class) } {
            div.y-title { (y.title) }
            div.area {
                svg viewBox={ "0 0 " (coordinate(WIDTH)) " " (coordinate(HEIGHT)) } preserveAspectRatio="none"
                    role="img" aria-label=(described) {
                    path.grid d=(grid) {}
                    (drawing)
                }
                @for (value, label) in &y.ticks {
                    span.yt style={ "top:" (percent(1.0 - y.share(*value))) } { (label) }
                }
                @for (value, label) in &x.ticks {
                    span.xt style={ "left:" (percent(x.share(*value))) } { (label) }
                }
                (beside)
            }
            div.x-title { (x.title) }
        }
    }
}

/// A curve's name and its last value, for a label at its end.
pub(super) struct EndLabel {
    pub(super) name: String,
    /// Which series it is.
    pub(super) series: usize,
    pub(super) value: f64,
}

/// Names beside the ends of their curves, moved apart so that none covers another; none where they do not all fit.
pub(super) fn end_labels(y: &Axis, mut labels: Vec<EndLabel>) -> Markup {
    labels.sort_by(|a, b| b.value.total_cmp(&a.value));
    let mut places: Vec<f64> = Vec::with_capacity(labels.len());
    for label in &labels {
        let free = places.last().map_or(f64::NEG_INFINITY, |p| p + LABEL_PITCH);
        places.push(f64::max(1.0 - y.share(label.value), free));
    }
    let mut limit = 1.0;
    for place in places.iter_mut().rev() {
        *place = f64::min(*place, limit);
        limit = *place - LABEL_PITCH;
    }
    html! {
        @if places.first().is_some_and(|p| *p >= 0.0) {
            @for (label, place) in labels.iter().zip(&places) {
                span class={ "end s" (label.series) " " (colour_class(label.series)) } title=(printable(&label.name, 200)) style={ "top:" (percent(*place)) } {
                    (printable(&label.name, 60))
                }
            }
        }
    }
}

/// A stroke as the curve has it.
pub(super) fn swatch(class: &str) -> Markup {
    html! {
        svg.swatch width="34" height="10" viewBox="0 0 34 10" aria-hidden="true" {
            path class={ (class) } d="M0 5H34" {}
        }
    }
}

/// Names with their strokes; each hides or shows its curves in the element of class `toggles` around it.
pub(super) fn legend<'a>(names: impl Iterator<Item = &'a str>, bound: bool) -> Markup {
    let key = |name: &str, mark: &str, class: &str| {
        html! {
            label.key {
                input type="checkbox" checked class={ "t" (mark) };
                (swatch(class)) span { (printable(name, 60)) }
            }
        }
    };
    html! {
        div.legend {
            @for (index, name) in names.enumerate() {
                (key(name, &index.to_string(), &stroke_class(index)))
            }
            @if bound { (key("upper bound", "b", "curve bound")) }
        }
    }
}

/// Style rules by which the legends of `count` series work.
pub(super) fn toggle_rules(count: usize) -> String {
    let rule = |mark: String| format!(".toggles:has(.t{mark}:not(:checked)) .s{mark}{{display:none}}\n");
    (0..count).map(|i| rule(i.to_string())).chain(std::iter::once(rule("b".to_owned()))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let labels = |axis: &Axis| axis.ticks.iter().map(|t| t.1.clone()).collect::<Vec<_>>();
        assert_eq!(labels(&Axis::linear(0.0, 1.0, 5, "")), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels(&Axis::linear(0.0, 0.0, 4, "")), ["0.0", "0.5", "1.0"]);
        assert_eq!(labels(&Axis::linear(f64::NAN, f64::INFINITY, 2, "")), ["0.0", "0.5", "1.0"]);
        let axis = Axis::time(0.0, 600.0, 5);
        assert_eq!(labels(&axis), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(axis.ticks[1].0, 120.0);
        for (lower, upper) in [(1e29, 1e30), (-1e30, 1e30), (0.0, 1e-300), (5.0, 5.0 + 1e-15)] {
            let axis = Axis::linear(lower, upper, 5, "");
            assert!(axis.ticks.len() <= 7 && axis.ticks.iter().all(|t| t.0.is_finite()), "{lower} to {upper}");
        }
    }

    #[test]
    fn labels_at_the_ends_keep_apart() {
        let y = Axis::linear(0.0, 1.0, 5, "");
        let labels =
            |n: usize| (0..n).map(|i| EndLabel { name: format!("p{i}"), series: i, value: 0.5 }).collect::<Vec<_>>();
        let text = end_labels(&y, labels(3)).into_string();
        assert!(text.contains("top:50%") && text.contains("top:56.2%") && text.contains("top:62.4%"), "{text}");
        assert_eq!(end_labels(&y, labels(40)).into_string(), "");
    }
}
