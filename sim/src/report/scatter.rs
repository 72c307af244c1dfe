//! Points on logarithmic axes: error against cost, cost against size.

use maud::{Markup, html};

use super::downsample::drawable;
use super::number::printable;
use super::plot::{Axis, colour_class, frame, lines, percent};

/// Shapes of points; with the eight colours 40 pairs, all different.
const SHAPES: [&str; 5] = ["●", "■", "▲", "◆", "✕"];

/// A method's points, joined in the order given.
pub(super) struct Series {
    /// Its name.
    pub(super) name: String,
    /// Each with what a pointer over it reads.
    pub(super) points: Vec<Point>,
}

/// A point.
pub(super) struct Point {
    pub(super) x: f64,
    pub(super) y: f64,
    /// Its setting.
    pub(super) label: String,
    /// Ringed: what decisions use.
    pub(super) is_default: bool,
}

/// What a plot says about itself.
pub(super) struct Titles<'a> {
    /// In words, what is to be seen.
    pub(super) described: &'a str,
    pub(super) x: &'a str,
    pub(super) y: &'a str,
    /// Values of y below this, zero included, are drawn on it; the axis says so.
    pub(super) floor: f64,
}

/// A log–log plot with a legend that hides and shows each series; nothing where no point can be drawn.
pub(super) fn scatter(series: &[Series], titles: &Titles) -> Option<Markup> {
    let shown = |p: &&Point| drawable(p.x) && p.x > 0.0 && drawable(p.y) && p.y >= 0.0;
    let all = || series.iter().flat_map(|s| s.points.iter().filter(shown));
    let x = Axis::logarithmic(all().map(|p| p.x), titles.x)?;
    let y = Axis::logarithmic(all().map(|p| p.y.max(titles.floor)), titles.y)?;
    let curve = |s: &Series| {
        let run: Vec<[f64; 2]> = s.points.iter().filter(shown).map(|p| [p.x, p.y.max(titles.floor)]).collect();
        if run.len() > 1 { lines(&x, &y, &[run]) } else { String::new() }
    };
    let drawing = html! {
        @for (index, s) in series.iter().enumerate() {
            path class={ "curve thin s" (index) " " (colour_class(index)) } d=(curve(s)) {}
        }
    };
    let marks = html! {
        @for (index, s) in series.iter().enumerate() {
            @for p in s.points.iter().filter(shown) {
                span class={ "point s" (index) " " (colour_class(index)) @if p.is_default { " chosen" } }
                    style={ "left:" (percent(x.share(p.x))) ";top:" (percent(1.0 - y.share(p.y.max(titles.floor)))) }
                    title={ (printable(&s.name, 60)) " " (printable(&p.label, 120)) } { (shape(index)) }
            }
        }
    };
    Some(html! {
        div.toggles {
            div.legend {
                @for (index, s) in series.iter().enumerate() {
                    label.key {
                        input type="checkbox" checked class={ "t" (index) };
                        span class={ "mark " (colour_class(index)) } { (shape(index)) } span { (printable(&s.name, 60)) }
                    }
                }
            }
            (frame("tall", titles.described, &x, &y, &drawing, &marks))
        }
    })
}

fn shape(index: usize) -> &'static str {
    SHAPES[index % SHAPES.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(points: &[(f64, f64)]) -> Series {
        let point = |&(x, y): &(f64, f64)| Point { x, y, label: "<n=2>".to_owned(), is_default: y == 0.0 };
        Series { name: "a & b".to_owned(), points: points.iter().map(point).collect() }
    }

    #[test]
    fn decades_are_evenly_spaced_and_zeros_lie_on_the_floor() {
        let titles = Titles { described: "", x: "ns", y: "error", floor: 1e-4 };
        let drawn = scatter(&[series(&[(10.0, 1.0), (100.0, 1e-2), (1000.0, 0.0)])], &titles).expect("three points");
        let text = drawn.into_string();
        for place in ["left:0%;top:0%", "left:50%;top:50%", "left:100%;top:100%"] {
            assert!(text.contains(place), "{place}: {text}");
        }
        assert_eq!(text.matches("chosen").count(), 1);
        assert!(text.contains("a &amp; b") && text.contains("&lt;n=2&gt;"), "{text}");
        roxml_like(&text);
    }

    #[test]
    fn what_cannot_be_drawn_is_left_out() {
        let titles = Titles { described: "", x: "", y: "", floor: 1e-16 };
        assert!(scatter(&[series(&[(0.0, 1.0), (f64::NAN, 1.0), (1.0, f64::INFINITY)])], &titles).is_none());
        assert!(scatter(&[], &titles).is_none());
        let one = scatter(&[series(&[(5.0, 5.0), (-1.0, 2.0)])], &titles).expect("a point").into_string();
        assert_eq!(one.matches("class=\"point").count(), 1);
    }

    /// Every element that is opened is closed, in order; no number in it is NaN or infinite.
    fn roxml_like(text: &str) {
        let mut open = Vec::new();
        for tag in text.split('<').skip(1).filter_map(|t| t.split('>').next()) {
            let name = tag.split([' ', '/']).find(|n| !n.is_empty()).unwrap_or_default();
            if let Some(closed) = tag.strip_prefix('/') {
                assert_eq!(open.pop(), Some(closed), "{text}");
            } else if name != "input" {
                open.push(name);
            }
        }
        assert!(open.is_empty(), "{open:?}");
        assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
    }
}
