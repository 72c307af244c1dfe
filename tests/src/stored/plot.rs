//! Curves as SVG files.

use plotters::prelude::*;

use super::Fault;

/// Width and height, user units.
const SIZE: (u32, u32) = (760, 460);

/// How an axis is divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Evenly, from 0 on.
    Linear,
    /// By powers of ten; values that are not positive are left out.
    Logarithmic,
}

/// A curve.
#[derive(Clone, Debug)]
pub struct Curve {
    /// In the legend.
    pub name: String,
    /// x and y.
    pub points: Vec<(f64, f64)>,
    /// Dots at the points.
    pub dotted: bool,
}

/// A drawing of curves.
#[derive(Clone, Debug)]
pub struct Plot {
    /// Of its file.
    pub name: String,
    /// Above it.
    pub title: String,
    /// What x is.
    pub x: (String, Scale),
    /// What y is.
    pub y: (String, Scale),
    /// Each with a colour of its own, the first eight.
    pub curves: Vec<Curve>,
}

/// Distinguishable by all (Okabe and Ito).
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(0, 0, 0),
    RGBColor(140, 140, 140),
];

impl Plot {
    /// The SVG. Axes are drawn in decades or from 0 on; without a point it is empty.
    ///
    /// # Errors
    /// What the drawing library refuses.
    pub fn svg(&self) -> Result<String, Fault> {
        let place = |value: f64, scale: Scale| match scale {
            Scale::Linear => Some(value),
            Scale::Logarithmic => (value > 0.0).then(|| libm::log10(value)),
        };
        let curves: Vec<Vec<(f64, f64)>> = self
            .curves
            .iter()
            .map(|c| c.points.iter().filter_map(|&(x, y)| Some((place(x, self.x.1)?, place(y, self.y.1)?))).collect())
            .collect();
        let range = |of: fn(&(f64, f64)) -> f64, scale: Scale| {
            let values = curves.iter().flatten().map(of).filter(|v| v.is_finite());
            let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            match (low <= high, scale) {
                (false, _) => 0.0..1.0,
                (true, Scale::Linear) => low.min(0.0)..if high > 0.0 { 1.05 * high } else { 1.0 },
                (true, Scale::Logarithmic) => (low - 0.05).floor()..(high + 0.05).ceil(),
            }
        };
        let (xs, ys) = (range(|p| p.0, self.x.1), range(|p| p.1, self.y.1));
        let mut svg = String::new();
        let drawn = draw(self, &curves, (xs, ys), &mut svg);
        drawn.map_err(|e| Fault::new(&self.name, e))?;
        Ok(svg)
    }
}

type Ranges = (std::ops::Range<f64>, std::ops::Range<f64>);

fn draw(
    plot: &Plot,
    curves: &[Vec<(f64, f64)>],
    (xs, ys): Ranges,
    svg: &mut String,
) -> Result<(), Box<dyn std::error::Error>> {
    let area = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&area)
        .caption(&plot.title, ("sans-serif", 17))
        .margin(10)
        .x_label_area_size(42)
        .y_label_area_size(66)
        .build_cartesian_2d(xs.clone(), ys.clone())?;
    let label = |scale: Scale| {
        move |value: &f64| match scale {
            Scale::Linear => super::plot::number(*value),
            Scale::Logarithmic => number(libm::pow(10.0, *value)),
        }
    };
    let decades = |scale: Scale, range: &std::ops::Range<f64>, other: usize| match scale {
        Scale::Linear => other,
        Scale::Logarithmic => ((range.end - range.start) as usize + 1).clamp(2, 12),
    };
    chart
        .configure_mesh()
        .x_labels(decades(plot.x.1, &xs, 9))
        .y_labels(decades(plot.y.1, &ys, 8))
        .x_desc(plot.x.0.as_str())
        .y_desc(plot.y.0.as_str())
        .x_label_formatter(&label(plot.x.1))
        .y_label_formatter(&label(plot.y.1))
        .light_line_style(WHITE.mix(0.0))
        .draw()?;
    for (index, (curve, points)) in plot.curves.iter().zip(curves).enumerate() {
        let colour = COLOURS[index % COLOURS.len()];
        chart
            .draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?
            .label(curve.name.as_str())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
        if curve.dotted {
            chart.draw_series(points.iter().map(|&at| Circle::new(at, 3, colour.filled())))?;
        }
    }
    chart
        .configure_series_labels()
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .position(SeriesLabelPosition::UpperLeft)
        .draw()?;
    area.present()?;
    Ok(())
}

/// A number for an axis: 3 digits, thousands as k, M, G.
fn number(value: f64) -> String {
    let (scaled, unit) = match value.abs() {
        v if v >= 1e9 => (value / 1e9, " G"),
        v if v >= 1e6 => (value / 1e6, " M"),
        v if v >= 1e3 => (value / 1e3, " k"),
        _ => (value, ""),
    };
    let digits =
        if scaled == 0.0 { 0 } else { (2.0 - libm::floor(libm::log10(scaled.abs()))).clamp(0.0, 6.0) as usize };
    let text = format!("{scaled:.digits$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text };
    format!("{text}{unit}")
}
