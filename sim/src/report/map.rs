//! The world from above: where each policy's bytes went, and when.

use std::collections::BTreeMap;

use maud::{Markup, html};

use super::downsample::drawable;
use super::number::{duration, fixed, printable, trimmed};
use super::plot::{coordinate, nice_step, percent};
use crate::outcome::{Arrival, Comparison};

/// Most footprints drawn per policy.
const FOOTPRINTS: usize = 3000;
/// Most points of the path drawn.
const PATH_POINTS: usize = 1000;
/// Steps of the colour scale; the style sheet has as many classes `v0`, `v1`, ….
const SHADES: usize = 16;
/// Width of the drawing, user units.
const WIDTH: f64 = 1000.0;

/// A rectangle of the ground: least and greatest corner, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Extent {
    least: [f64; 2],
    greatest: [f64; 2],
}

impl Extent {
    fn around(points: impl Iterator<Item = [f64; 2]>) -> Option<Self> {
        points.fold(None, |extent: Option<Self>, p| {
            let e = extent.unwrap_or(Self { least: p, greatest: p });
            Some(Self {
                least: [e.least[0].min(p[0]), e.least[1].min(p[1])],
                greatest: [e.greatest[0].max(p[0]), e.greatest[1].max(p[1])],
            })
        })
    }

    fn sides(&self) -> [f64; 2] {
        [self.greatest[0] - self.least[0], self.greatest[1] - self.least[1]]
    }

    /// With a margin of 4 %, neither side less than half the other, and sides that rounding does not swallow.
    fn framed(&self) -> Self {
        let [w, h] = self.sides();
        let middle = [(self.least[0] + self.greatest[0]) / 2.0, (self.least[1] + self.greatest[1]) / 2.0];
        let far = middle[0].abs().max(middle[1].abs());
        let longest = if w.max(h) > far * 1e-9 { w.max(h) } else { f64::max(1.0, far * 1e-6) };
        let grown = |side: f64| (f64::max(side, longest * 0.5) + longest * 0.08) / 2.0;
        let half = [grown(w), grown(h)];
        Self { least: [middle[0] - half[0], middle[1] - half[1]], greatest: [middle[0] + half[0], middle[1] + half[1]] }
    }

    fn meets(&self, arrival: &Arrival) -> bool {
        (0..2).all(|k| {
            arrival.centre[k] + arrival.half[k] >= self.least[k]
                && arrival.centre[k] - arrival.half[k] <= self.greatest[k]
        })
    }
}

fn can_be_drawn(arrival: &Arrival) -> bool {
    let numbers = [arrival.at_s, arrival.centre[0], arrival.centre[1], arrival.half[0], arrival.half[1]];
    numbers.into_iter().all(drawable) && arrival.half.iter().all(|h| *h >= 0.0)
}

/// What the maps show: the path and every footprint not larger than it; all footprints where there is no path.
fn extent(path: &[[f64; 2]], arrivals: &[&Arrival]) -> Extent {
    let route = Extent::around(path.iter().copied());
    let length = route.map_or(0.0, |r| r.sides()[0].max(r.sides()[1]));
    let corners = |limit: f64| {
        let fitting = arrivals.iter().filter(move |a| 2.0 * a.half[0].max(a.half[1]) <= limit);
        fitting.flat_map(|a| {
            let corner = |sign: f64| [a.centre[0] + sign * a.half[0], a.centre[1] + sign * a.half[1]];
            [corner(-1.0), corner(1.0)]
        })
    };
    let around = if length > 0.0 {
        Extent::around(path.iter().copied().chain(corners(length)))
    } else {
        Extent::around(path.iter().copied().chain(corners(f64::INFINITY)))
    };
    around.unwrap_or(Extent { least: [0.0; 2], greatest: [1.0; 2] }).framed()
}

/// The footprints to draw: of several arrivals on one footprint the last, those within the picture, coarse before
/// fine; thinned evenly to [`FOOTPRINTS`]. Also how many there were before thinning.
fn footprints(arrivals: &[Arrival], seen: &Extent) -> (Vec<Arrival>, usize) {
    let mut last: BTreeMap<(u32, [u64; 4]), Arrival> = BTreeMap::new();
    for arrival in arrivals.iter().filter(|a| can_be_drawn(a) && seen.meets(a)) {
        let place = [arrival.centre[0], arrival.centre[1], arrival.half[0], arrival.half[1]].map(f64::to_bits);
        let entry = last.entry((arrival.depth, place)).or_insert(*arrival);
        if arrival.at_s > entry.at_s {
            *entry = *arrival;
        }
    }
    let all: Vec<Arrival> = last.into_values().collect();
    let total = all.len();
    let kept = total.min(FOOTPRINTS);
    ((0..kept).map(|k| all[k * total / kept]).collect(), total)
}

/// Ground to drawing: y upwards becomes y downwards.
struct Scale {
    seen: Extent,
    per_metre: f64,
}

impl Scale {
    fn new(seen: Extent) -> Self {
        Self { seen, per_metre: WIDTH / seen.sides()[0] }
    }

    fn height(&self) -> f64 {
        self.seen.sides()[1] * self.per_metre
    }

    /// Beyond the picture by a picture's width at most: what lies there is clipped anyway.
    fn place(&self, point: [f64; 2]) -> [f64; 2] {
        let within = |v: f64| v.clamp(-WIDTH, 3.0 * WIDTH);
        [
            within((point[0] - self.seen.least[0]) * self.per_metre),
            within((self.seen.greatest[1] - point[1]) * self.per_metre),
        ]
    }

    fn rectangle(&self, arrival: &Arrival) -> String {
        let corner = |sign: f64| {
            self.place([arrival.centre[0] - sign * arrival.half[0], arrival.centre[1] + sign * arrival.half[1]])
        };
        let (upper_left, lower_right) = (corner(1.0), corner(-1.0));
        let side = |k: usize| coordinate(f64::max(lower_right[k] - upper_left[k], 1.0));
        let (x, y) = (coordinate(upper_left[0]), coordinate(upper_left[1]));
        format!("M{x} {y}h{}v{}H{x}z", side(0), side(1))
    }
}

/// The maps of all policies in one scale, with the scale of colours. `None` where there is nothing to draw.
pub(super) fn maps(comparison: &Comparison) -> Option<Markup> {
    let series = &comparison.series;
    let path: Vec<[f64; 2]> = series.path_xy.iter().copied().filter(|p| p.iter().all(|v| drawable(*v))).collect();
    let arrivals: Vec<&Arrival> =
        series.policies.iter().flat_map(|p| &p.arrivals).filter(|a| can_be_drawn(a)).collect();
    if path.is_empty() && arrivals.is_empty() || series.policies.is_empty() {
        return None;
    }
    let scale = Scale::new(extent(&path, &arrivals));
    let first = arrivals.iter().map(|a| a.at_s).fold(f64::INFINITY, f64::min);
    let last = arrivals.iter().map(|a| a.at_s).fold(f64::NEG_INFINITY, f64::max);
    let times = if arrivals.is_empty() { [0.0, 1.0] } else { [first, last] };
    let route = route(&path, &scale);
    Some(html! {
        (colour_scale(times))
        div.maps {
            @for policy in &series.policies { (one(&policy.name, &policy.arrivals, &scale, times, &route)) }
        }
    })
}

fn shade(at_s: f64, times: [f64; 2]) -> usize {
    let share = (at_s - times[0]) / (times[1] - times[0]);
    if share.is_nan() { 0 } else { ((share * SHADES as f64) as usize).min(SHADES - 1) }
}

fn one(name: &str, arrivals: &[Arrival], scale: &Scale, times: [f64; 2], route: &Markup) -> Markup {
    let (drawn, total) = footprints(arrivals, &scale.seen);
    let mut layers: BTreeMap<(u32, usize), String> = BTreeMap::new();
    for arrival in &drawn {
        layers.entry((arrival.depth, shade(arrival.at_s, times))).or_default().push_str(&scale.rectangle(arrival));
    }
    let bar = nice_step(scale.seen.sides()[0] / 8.0);
    html! {
        figure.map {
            figcaption {
                b { (printable(name, 80)) }
                " " span.note {
                    (total) @if total == 1 { " footprint" } @else { " footprints" }
                    @if drawn.len() < total { ", " (drawn.len()) " of them drawn, evenly chosen" }
                }
            }
            div.ground {
                svg viewBox={ "0 0 " (coordinate(WIDTH)) " " (coordinate(scale.height())) } role="img"
                    aria-label={ "Map of what " (printable(name, 80)) " fetched" } {
                    @for ((depth, step), data) in &layers {
                        path class={ "v" (step) } d=(data) { title { "depth " (depth) ", arrived " (span(*step, times)) } }
                    }
                    (route)
                }
                div.scale-bar style={ "width:" (percent(bar / scale.seen.sides()[0])) } { span { (metres(bar)) } }
            }
        }
    }
}

fn route(path: &[[f64; 2]], scale: &Scale) -> Markup {
    let kept = path.len().min(PATH_POINTS);
    let point = |k: usize| if kept < 2 { 0 } else { k * (path.len() - 1) / (kept - 1) };
    let mut data = String::new();
    for k in 0..kept {
        let [x, y] = scale.place(path[point(k)]).map(coordinate);
        data.push_str(&format!("{}{x} {y}", if k == 0 { 'M' } else { 'L' }));
    }
    let end = |p: Option<&[f64; 2]>| {
        p.map_or_else(String::new, |p| {
            let [x, y] = scale.place(*p).map(coordinate);
            format!("M{x} {y}h0")
        })
    };
    html! {
        path.halo d=(data) {}
        path.route d=(data) {}
        path.last.halo d=(end(path.last())) {}
        path.last d=(end(path.last())) {}
        path.first.halo d=(end(path.first())) {}
        path.first d=(end(path.first())) {}
    }
}

fn span(step: usize, times: [f64; 2]) -> String {
    let at = |k: usize| times[0] + (times[1] - times[0]) * k as f64 / SHADES as f64;
    format!("{} to {}", duration(at(step)), duration(at(step + 1)))
}

fn metres(length: f64) -> String {
    match length {
        l if l >= 1000.0 => format!("{} km", trimmed(l / 1000.0, 0)),
        l if l >= 1.0 => format!("{} m", trimmed(l, 0)),
        l if l >= 1e-3 => format!("{} mm", trimmed(l * 1000.0, 0)),
        l => format!("{l:.0e} m"),
    }
}

fn colour_scale(times: [f64; 2]) -> Markup {
    let cell = |k: usize| fixed(100.0 * k as f64 / SHADES as f64, 2) + "%";
    html! {
        div.colour-scale {
            span { "arrived at " (duration(times[0])) }
            svg height="14" role="img" aria-label="Colour scale from the first to the last arrival" {
                @for k in 0..SHADES {
                    rect class={ "v" (k) } x=(cell(k)) y="0" width="6.3%" height="14" {}
                }
            }
            span { (duration(times[1])) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arrival(at_s: f64, x: f64, half: f64, depth: u32) -> Arrival {
        Arrival { at_s, centre: [x, 0.0], half: [half, half], depth }
    }

    #[test]
    fn the_last_arrival_on_a_footprint_is_drawn_and_coarse_lies_beneath_fine() {
        let seen = Extent { least: [-10.0; 2], greatest: [10.0; 2] };
        let given = [arrival(5.0, 0.0, 1.0, 2), arrival(9.0, 0.0, 1.0, 2), arrival(7.0, 0.0, 4.0, 1)];
        let (drawn, total) = footprints(&given, &seen);
        assert_eq!(total, 2);
        assert_eq!(drawn.iter().map(|a| (a.depth, a.at_s)).collect::<Vec<_>>(), [(1, 7.0), (2, 9.0)]);
    }

    #[test]
    fn thinning_is_bounded_and_told() {
        let seen = Extent { least: [-1.0; 2], greatest: [1e6; 2] };
        let many: Vec<Arrival> = (0..10_000).map(|k| arrival(1.0, f64::from(k), 0.5, 3)).collect();
        let (drawn, total) = footprints(&many, &seen);
        assert_eq!((drawn.len(), total), (FOOTPRINTS, 10_000));
    }

    #[test]
    fn a_world_larger_than_the_path_does_not_hide_it() {
        let globe = arrival(0.0, 0.0, 1e7, 0);
        let near = arrival(0.0, 50.0, 5.0, 9);
        let seen = extent(&[[0.0, 0.0], [100.0, 0.0]], &[&globe, &near]);
        assert!(seen.sides()[0] < 150.0 && seen.sides()[1] >= 50.0, "{seen:?}");
        let standing = extent(&[[0.0, 0.0]], &[&near]);
        assert!(standing.sides()[0] > 55.0, "{standing:?}");
    }
}
