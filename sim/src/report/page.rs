//! The page: its sections in order, each with one sentence on how to read it.

use maud::{Markup, html};

use super::downsample::{distribution, drawable, extremes, means};
use super::frame::document;
use super::headline::{findings, verdict};
use super::map;
use super::metric::{Context, METRICS, bound_cell, pressure_word};
use super::number::{self, MEBIBYTE, duration, fixed, mebibytes, megabytes, printable, significant};
use super::plot::{
    Axis, BOUND_CLASS, EndLabel, bands, bars, colour_class, end_labels, frame, legend, level, lines, percent,
    series_class, steps, stroke_class, swatch,
};
use super::prices::prices;
use crate::outcome::{Comparison, PolicyOutcome};

/// Most points of a curve over time.
const CURVE_POINTS: usize = 1000;
/// Most ranks of a distribution.
const RANKS: usize = 400;
/// Most bars of a link's picture.
const LINK_BARS: usize = 240;

/// The whole page.
pub(super) fn page(comparison: &Comparison, command: Option<&str>) -> String {
    let inputs = &comparison.inputs;
    let header = html! {
                    h1 { (verdict(comparison)) }
                    p.subject {
                        b { (printable(&inputs.world, 200)) } " along " b { (printable(&inputs.path, 200)) }
                        " over " b { (printable(&inputs.link, 200)) } ", "
                        (duration(inputs.duration_s)) " with " (mebibytes(inputs.memory_bytes as f64)) " of memory"
                    }
    };
    let main = html! {
                    section.headline { @for finding in findings(comparison) { p { (finding) } } @if let Some(limits) = &comparison.limits { p { (limits.sentence()) "." } } (caution(comparison)) }
                    (section("figures", "Figures",
                        "A row a policy: higher quality and lower deficit are better, bold is the best of its \
                         column, and the last row is what no policy could exceed.",
                        figures(comparison)))
                    (section("quality", "Quality over time",
                        "Higher is better: Q is 1 when everything in view is shown without error, gaps are moments \
                         with nothing in view, grey bands seconds in which the link delivered nothing.",
                        quality(comparison)))
                    (section("distribution", "How often quality was low",
                        "The height of a curve is the share of frames whose Q was at most the value beneath: the \
                         lower and further right a curve, the better.",
                        quality_distribution(comparison)))
                    (section("bytes", "What the bytes were worth",
                        "The longer a bar the more bytes crossed the link; plain is what helped a view, hatched \
                         what was never the best for anything in view, dotted what had crossed when its request was \
                         cancelled.",
                        bytes(comparison)))
                    (section("memory", "Memory",
                        "A curve that runs along the budget has to discard before it can fetch; one that stays \
                         below it has memory to spare.",
                        memory(comparison)))
                    (section("link", "Link",
                        "Grey is what the link could deliver, the coloured area what the policy let cross it: grey \
                         left over was not used.",
                        link(comparison)))
                    @if let Some(prices) = prices(comparison, &time_axis(comparison, 4)) {
                        (section("prices", "What more link or memory would have bought",
                            "The higher a bar, the more a little more just then would have raised the upper bound, in \
                             thousandths of quality averaged over the whole replay; where there is none, more would have \
                             been of no use. The first order only: a price falls as more is given.",
                            prices))
                    }
                    (section("map", "From above",
                        "Each rectangle is the ground beneath something fetched, dark if it arrived early and \
                         bright if late, fine over coarse; the line is the camera's path from the round end to the \
                         square one.",
                        map::maps(comparison).unwrap_or_else(nothing)))
                    (section("replay", "What was replayed",
                        "The pressure figures say whether this comparison can mean anything: with ρ below 0.1 \
                         policies cannot differ.",
                        replayed(comparison, command)))
    };
    document(&printable(&inputs.world, 60), comparison.policies.len(), header, main)
}

fn section(id: &str, heading: &str, how_to_read: &str, content: Markup) -> Markup {
    html! {
        section id=(id) {
            h2 { (heading) }
            p.how { (how_to_read) }
            (content)
        }
    }
}

fn nothing() -> Markup {
    html! { p.nothing { "Nothing was recorded to draw here." } }
}

fn caution(comparison: &Comparison) -> Markup {
    html! {
        @match comparison.warnings.len() {
            0 => {}
            1 => p.caution { "1 warning stands " a href="#warnings" { "at the end" } "." },
            n => p.caution { (n) " warnings stand " a href="#warnings" { "at the end" } "." },
        }
    }
}

fn figures(comparison: &Comparison) -> Markup {
    let context = Context::new(comparison);
    let best: Vec<Option<String>> = METRICS.iter().map(|m| m.best(&comparison.policies, &context)).collect();
    html! {
        div.scroll tabindex="0" role="region" aria-label="Figures of each policy" {
            table {
                thead {
                    tr {
                        th scope="col" { "policy" }
                        @for metric in &METRICS { th scope="col" title=(metric.explained) { (metric.heading) } }
                    }
                }
                tbody {
                    @for (index, policy) in comparison.policies.iter().enumerate() {
                        tr {
                            th scope="row" {
                                div.who { (swatch(&stroke_class(index))) span { (printable(&policy.name, 60)) } }
                            }
                            @for (metric, best) in METRICS.iter().zip(&best) {
                                @let cell = metric.cell(policy, &context);
                                td.best[best.as_ref() == Some(&cell.text)] {
                                    (cell.text) @if let Some(half) = &cell.half_width { span.half { " ±" (half) } }
                                }
                            }
                        }
                    }
                    tr.goal {
                        th scope="row" { div.who { (swatch("curve bound")) span { "upper bound" } } }
                        @for column in 0..METRICS.len() { td { (bound_cell(column, comparison, &context)) } }
                    }
                }
            }
        }
        details {
            summary { "What the columns mean" }
            dl.columns {
                @for metric in &METRICS { dt { (metric.heading) } dd { (metric.explained) } }
                @if comparison.policies.iter().any(|p| p.interval.is_some()) {
                    dt { "±" } dd { "half the width of the 95 % interval of the mean over the starts" }
                }
            }
        }
    }
}

/// From 0, or an earlier first frame, to the end of the replay: its duration where that agrees with the samples.
fn time_axis(comparison: &Comparison, count: usize) -> Axis {
    let series = &comparison.series;
    let frames = series.frame_s.iter().copied().filter(|v| drawable(*v));
    let seconds = series.second_s.iter().map(|s| s + 1.0).filter(|v| drawable(*v));
    let last_frame = frames.clone().fold(0.0, f64::max);
    let last = if last_frame > 0.0 { last_frame } else { seconds.fold(0.0, f64::max) };
    let duration = comparison.inputs.duration_s;
    let upper = if (last..=last * 1.1).contains(&duration) { duration } else { last };
    Axis::time(frames.fold(0.0, f64::min), upper, count)
}

/// Stretches of seconds in which the link delivered nothing.
fn outages(comparison: &Comparison) -> Vec<[f64; 2]> {
    let mut stretches: Vec<[f64; 2]> = Vec::new();
    for (start, capacity) in comparison.series.second_s.iter().zip(&comparison.series.capacity_bytes) {
        if *capacity > 0.0 || !drawable(*start) {
            continue;
        }
        match stretches.last_mut() {
            Some(last) if last[1] == *start => last[1] = start + 1.0,
            _ => stretches.push([*start, start + 1.0]),
        }
    }
    stretches
}

fn names(comparison: &Comparison) -> impl Iterator<Item = &str> {
    comparison.series.policies.iter().map(|p| p.name.as_str())
}

fn drawable_values(values: &[Option<f64>]) -> impl DoubleEndedIterator<Item = f64> {
    values.iter().flatten().copied().filter(|v| drawable(*v))
}

/// The vertical axis of quality: to 1, from the tenth below the least value.
fn quality_axis(comparison: &Comparison) -> Option<Axis> {
    let series = &comparison.series;
    let all = series.policies.iter().map(|p| &p.quality).chain([&series.bound]);
    let least = all.flat_map(|q| drawable_values(q)).fold(f64::INFINITY, f64::min);
    let lower = ((least * 10.0 - 1e-9).floor() / 10.0).clamp(0.0, 0.9);
    least.is_finite().then(|| Axis::linear(lower, 1.0, 5, "Q"))
}

fn quality(comparison: &Comparison) -> Markup {
    let series = &comparison.series;
    let Some(y) = quality_axis(comparison) else { return nothing() };
    let x = time_axis(comparison, 6);
    let curve = |q: &[Option<f64>]| lines(&x, &y, &extremes(&series.frame_s, q, CURVE_POINTS));
    let drawing = html! {
        path.outage d=(bands(&x, &outages(comparison))) {}
        path class=(BOUND_CLASS) d=(curve(&series.bound)) { title { "upper bound" } }
        @for (index, policy) in series.policies.iter().enumerate() {
            path class=(series_class(index)) d=(curve(&policy.quality)) { title { (printable(&policy.name, 80)) } }
        }
    };
    let ends = series.policies.iter().enumerate().filter_map(|(index, p)| {
        let value = drawable_values(&p.quality).next_back()?;
        Some(EndLabel { name: p.name.clone(), series: index, value })
    });
    let labels = end_labels(&y, ends.collect());
    html! {
        div.toggles {
            (legend(names(comparison), !series.bound.is_empty()))
            (frame("tall labelled", "Quality over time, a curve a policy, and the upper bound", &x, &y, &drawing, &labels))
        }
    }
}

fn quality_distribution(comparison: &Comparison) -> Markup {
    let series = &comparison.series;
    let Some(x) = quality_axis(comparison) else { return nothing() };
    let x = Axis::linear(x.range().0, 1.0, 5, "Q");
    let y = Axis::linear(0.0, 100.0, 5, "% of frames");
    let curve = |q: &[Option<f64>]| {
        let points: Vec<[f64; 2]> = distribution(q, RANKS).into_iter().map(|[v, s]| [v, s * 100.0]).collect();
        steps(&x, &y, &points)
    };
    let drawing = html! {
        path class=(BOUND_CLASS) d=(curve(&series.bound)) { title { "upper bound" } }
        @for (index, policy) in series.policies.iter().enumerate() {
            path class=(series_class(index)) d=(curve(&policy.quality)) { title { (printable(&policy.name, 80)) } }
        }
    };
    html! {
        div.toggles {
            (legend(names(comparison), !series.bound.is_empty()))
            (frame("tall", "Share of frames against quality, a curve a policy, and the upper bound", &x, &y, &drawing, &html! {}))
        }
    }
}

/// Useful, wasted and cancelled bytes; together what crossed the link.
fn split(policy: &PolicyOutcome) -> [f64; 3] {
    let sane = |v: f64| if drawable(v) { v.max(0.0) } else { 0.0 };
    let fetched = sane(policy.bytes_fetched);
    let cancelled = sane(policy.bytes_cancelled).min(fetched);
    let wasted = sane(policy.bytes_wasted).min(fetched - cancelled);
    [fetched - cancelled - wasted, wasted, cancelled]
}

fn bytes(comparison: &Comparison) -> Markup {
    let longest = comparison.policies.iter().map(|p| split(p).iter().sum()).fold(0.0, f64::max);
    if longest <= 0.0 {
        return nothing();
    }
    html! {
        svg.defs width="0" height="0" aria-hidden="true" {
            defs {
                pattern id="hatched" width="6" height="6" patternUnits="userSpaceOnUse" patternTransform="rotate(45)" {
                    rect.ground width="6" height="6" {} rect.mark width="3" height="6" {}
                }
                pattern id="dotted" width="7" height="7" patternUnits="userSpaceOnUse" {
                    rect.ground width="7" height="7" {} circle.mark cx="3.5" cy="3.5" r="1.8" {}
                }
            }
        }
        div.legend {
            @for (class, name) in [("useful", "useful"), ("wasted", "wasted"), ("cancelled", "cancelled")] {
                span.key {
                    svg width="22" height="12" aria-hidden="true" { rect class=(class) width="22" height="12" {} }
                    span { (name) }
                }
            }
        }
        div.bars {
            @for policy in &comparison.policies {
                @let parts = split(policy);
                @let ends = [parts[0], parts[0] + parts[1], parts[0] + parts[1] + parts[2]];
                div.bar {
                    p { b { (printable(&policy.name, 80)) } " " span.note { (megabytes(ends[2])) } }
                    svg height="20" role="img" aria-label={ "Bytes fetched by " (printable(&policy.name, 80)) } {
                        rect.useful x="0" width=(percent(ends[0] / longest)) height="20" {}
                        rect.wasted x=(percent(ends[0] / longest)) width=(percent(parts[1] / longest)) height="20" {}
                        rect.cancelled x=(percent(ends[1] / longest)) width=(percent(parts[2] / longest)) height="20" {}
                    }
                    p.note {
                        (megabytes(parts[0])) " useful, " (megabytes(parts[1])) " wasted, "
                        (megabytes(parts[2])) " cancelled"
                    }
                }
            }
        }
    }
}

fn memory(comparison: &Comparison) -> Markup {
    let series = &comparison.series;
    let budget = comparison.inputs.memory_bytes as f64 / MEBIBYTE;
    let in_mebibytes = |values: &[u64]| values.iter().map(|b| Some(*b as f64 / MEBIBYTE)).collect::<Vec<_>>();
    let most = series.policies.iter().flat_map(|p| &p.memory_bytes).max().map(|b| *b as f64 / MEBIBYTE);
    let Some(most) = most.filter(|_| !series.frame_s.is_empty()) else { return nothing() };
    let beyond = budget > most * 8.0;
    let x = time_axis(comparison, 6);
    let y = Axis::linear(0.0, if beyond { most } else { most.max(budget) } * 1.08, 5, "MiB");
    let drawing = html! {
        @if !beyond { path.budget d=(level(&y, budget)) { title { "budget" } } }
        @for (index, policy) in series.policies.iter().enumerate() {
            @let runs = extremes(&series.frame_s, &in_mebibytes(&policy.memory_bytes), CURVE_POINTS);
            path class=(series_class(index)) d=(lines(&x, &y, &runs)) { title { (printable(&policy.name, 80)) } }
        }
    };
    let ends = series.policies.iter().enumerate().filter_map(|(index, p)| {
        let value = *p.memory_bytes.last()? as f64 / MEBIBYTE;
        Some(EndLabel { name: p.name.clone(), series: index, value })
    });
    let mark = html! {
        (end_labels(&y, ends.collect()))
        @if !beyond {
            span.budget-label style={ "top:" (percent(1.0 - y.share(budget))) } {
                "budget " (mebibytes(budget * MEBIBYTE))
            }
        }
    };
    html! {
        div.toggles {
            (legend(names(comparison), false))
            @if beyond { p.note { "The budget of " (mebibytes(budget * MEBIBYTE)) " lies far above the picture." } }
            (frame("tall labelled", "Memory in use over time, a curve a policy, and the budget", &x, &y, &drawing, &mark))
        }
    }
}

fn link(comparison: &Comparison) -> Markup {
    let series = &comparison.series;
    if series.second_s.is_empty() || series.policies.is_empty() {
        return nothing();
    }
    let origin = series.second_s.first().copied().filter(|s| drawable(*s)).unwrap_or(0.0);
    let megabits = |bytes: &[f64]| {
        let counted = &bytes[..bytes.len().min(series.second_s.len())];
        let placed = means(counted, LINK_BARS).into_iter().map(|[a, b, v]| [origin + a, origin + b, v * 8e-6]);
        placed.collect::<Vec<[f64; 3]>>()
    };
    let capacity = megabits(&series.capacity_bytes);
    let used: Vec<Vec<[f64; 3]>> = series.policies.iter().map(|p| megabits(&p.used_bytes)).collect();
    let most = used.iter().chain([&capacity]).flatten().map(|b| b[2]).fold(0.0, f64::max);
    let x = time_axis(comparison, 4);
    let y = Axis::linear(0.0, most * 1.02, 3, "Mbit/s");
    let sum = |bytes: &[f64]| bytes.iter().filter(|v| drawable(**v)).sum::<f64>();
    let available = sum(&series.capacity_bytes);
    html! {
        div.multiples {
            @for (index, (policy, used)) in series.policies.iter().zip(&used).enumerate() {
                figure {
                    figcaption {
                        b { (printable(&policy.name, 80)) } " "
                        @if available > 0.0 {
                            span.note { (fixed(sum(&policy.used_bytes) / available * 100.0, 1)) " % of the link used" }
                        }
                    }
                    (frame("short", &format!("Link capacity and its use by {}", printable(&policy.name, 80)), &x, &y, &html! {
                        path.capacity d=(bars(&x, &y, &capacity)) {}
                        path class={ "used " (colour_class(index)) } d=(bars(&x, &y, used)) {}
                    }, &html! {}))
                }
            }
        }
    }
}

fn replayed(comparison: &Comparison, command: Option<&str>) -> Markup {
    let (inputs, pressure) = (&comparison.inputs, &comparison.pressure);
    let row = |name: &str, value: String, hash: &str| {
        html! {
            dt { (name) }
            dd { (value) @if !hash.is_empty() { " " span.hash { (hash) } } }
        }
    };
    let start = if inputs.warm { "warm: what the first view needs was there" } else { "cold: nothing was there" };
    let [across, down] = inputs.viewport;
    let viewport = format!("{across} × {down} px, {}° vertically", number::trimmed(inputs.fov_y_deg, 2));
    let hash = |hash: &str| printable(hash, 64);
    html! {
        div.pressure {
            div.card {
                b { "ρ " (significant(pressure.rho)) }
                span { (pressure_word(pressure.rho)) ": bytes that the whole path needs ÷ bytes that the link delivers" }
            }
            div.card {
                b { "λ " (significant(pressure.lambda)) }
                span { "bytes newly needed after the first frame, re-fetches included ÷ bytes that the link delivers" }
            }
            div.card {
                b { "μ " (significant(pressure.mu)) }
                span { "memory budget ÷ largest need of a frame, " (mebibytes(pressure.largest_need_bytes as f64)) }
            }
            div.card {
                b { (fixed((1.0 - comparison.nonempty_share) * 100.0, 1)) " %" }
                span { "of the frames have nothing in view and are not counted" }
            }
        }
        dl.inputs {
            (row("world", printable(&inputs.world, 300), &hash(&inputs.world_hash)))
            (row("representations", inputs.representations.to_string(), ""))
            (row("path", printable(&inputs.path, 300), &hash(&inputs.path_hash)))
            (row("placed", printable(&inputs.place, 300), ""))
            (row("link", printable(&inputs.link, 300), &hash(&inputs.link_hash)))
            (row("offsets into the link", starts(&inputs.starts_s), ""))
            (row("duration", duration(inputs.duration_s), ""))
            (row("memory budget", mebibytes(inputs.memory_bytes as f64), ""))
            (row("trust in the prediction, α", number::trimmed(inputs.alpha, 4), ""))
            (row("worst case", printable(&inputs.worst_case, 60), ""))
            (row("refinement", printable(&inputs.refinement, 60), ""))
            (row("start", start.to_owned(), ""))
            (row("viewport", viewport, ""))
            (row("seed", inputs.seed.to_string(), ""))
            @if !comparison.upper_bound.method.is_empty() {
                (row("upper bound by", printable(&comparison.upper_bound.method, 600), ""))
            }
        }
        @if let Some(command) = command {
            p.how { "To repeat it:" }
            pre.scroll { code { (printable(command, 4000)) } }
        }
        h3 id="warnings" { "Warnings" }
        @if comparison.warnings.is_empty() {
            p.nothing { "None." }
        } @else {
            ul { @for warning in &comparison.warnings { li { (printable(warning, 2000)) } } }
        }
    }
}

fn starts(starts_s: &[f64]) -> String {
    let shown: Vec<String> = starts_s.iter().take(40).map(|s| number::trimmed(*s, 2)).collect();
    match (starts_s.len(), starts_s.len() > shown.len()) {
        (0, _) => "0 s".to_owned(),
        (n, true) => format!("{} … ({n} in all) s; the curves show the first", shown.join(", ")),
        (1, _) => format!("{} s", shown.join(", ")),
        _ => format!("{} s; the curves show the first", shown.join(", ")),
    }
}
