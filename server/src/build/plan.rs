//! What is built: settings as given, made whole by what the survey found, and what the world does not need.

use super::{BuildError, Settings};
use foresight_index::format::orthoview::{ColourCodec, Encoding};
use foresight_index::geometry::GeometrySettings;
use foresight_index::octree::Octree;
use foresight_index::orthoview::Direction;
use foresight_index::orthoview::direction::{Sight, choose, sight};
use foresight_index::stored::document::{Directions, LeftOut};
use foresight_index::surface::spool::Statistics;
use glam::DVec3;
use std::str::FromStr;

/// Triangles that a leaf is to hold on average if its side is not given: some hundred kilobytes of geometry, about what its
/// orthoviews take.
pub(super) const TRIANGLES_A_LEAF: f64 = 8192.0;

/// Directions are not added for less than this share of the surface, each area times the cosine gained.
const LEAST_GAIN: f64 = 2e-3;

/// Fewest and most pixels along a leaf.
pub const PIXELS: std::ops::RangeInclusive<f64> = 8.0..=4096.0;

/// The angle that surfaces are to be seen within, degrees: what the nine directions of \[HIBR\] reach as the design picks
/// them.
pub(super) const WITHIN_DEGREES: f64 = 36.3;

/// Which directions orthoviews are made along.
#[derive(Clone, Debug, PartialEq)]
pub enum DirectionsWanted {
    /// At most so many, chosen for the world.
    Most(usize),
    /// These.
    These(Vec<Direction>),
}

impl FromStr for DirectionsWanted {
    type Err = String;

    fn from_str(text: &str) -> Result<DirectionsWanted, String> {
        let expected = "expected `auto`, a number from 1 to 26, or names such as oop,pop,nnp";
        if text == "auto" {
            return Ok(DirectionsWanted::Most(9));
        }
        if let Ok(most) = text.parse::<usize>() {
            return if (1..=26).contains(&most) { Ok(DirectionsWanted::Most(most)) } else { Err(expected.to_owned()) };
        }
        let mut named = Vec::new();
        for name in text.split(',') {
            let direction = Direction::from_name(name).ok_or_else(|| {
                format!(
                    "{name:?}; {expected}: n, o and p stand for −1, 0 and 1 along x, y and z, from the world to the eye"
                )
            })?;
            if !named.contains(&direction) {
                named.push(direction);
            }
        }
        Ok(DirectionsWanted::These(named))
    }
}

/// How sharp orthoviews are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sharpness {
    /// So many pixels along a leaf: q.
    Pixels(f64),
    /// As sharp as the screen from this distance on, metres: r.
    Radius(f64),
}

/// The screen that r is meant for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Screen {
    /// p, pixels across.
    pub width: f64,
    /// Field of view across, degrees.
    pub field: f64,
    /// θ, the angle at which surfaces are seen at worst, degrees.
    pub angle: f64,
}

impl Screen {
    /// q of a leaf of side s at distance r, \[HIBR\] §4.1: (s / cos θ) · p / (2 r tan(fov / 2)).
    pub fn pixels(&self, side: f64, radius: f64) -> f64 {
        side * self.per_metre() / radius
    }

    /// r for q pixels along a leaf of side s.
    pub fn radius(&self, side: f64, pixels: f64) -> f64 {
        side * self.per_metre() / pixels
    }

    fn per_metre(&self) -> f64 {
        self.width / (2.0 * libm::tan(0.5 * self.field.to_radians()) * libm::cos(self.angle.to_radians()))
    }
}

/// Everything decided.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    /// The cells.
    pub octree: Octree,
    /// Side of a leaf's pixel, metres.
    pub pixel: f64,
    /// From where cells are seen.
    pub directions: Vec<Direction>,
    /// How well that shows the world.
    pub sight: Directions,
    /// How images are kept.
    pub encoding: Encoding,
    /// How geometry is made; `None` for none.
    pub geometry: Option<GeometrySettings>,
    /// What the world does not need.
    pub left_out: Vec<LeftOut>,
}

/// Decides.
///
/// # Errors
/// Settings that contradict each other or the world.
pub(super) fn plan(settings: &Settings, octree: Octree, survey: &Statistics, up: DVec3) -> Result<Plan, BuildError> {
    let extent = survey.bounds.max - survey.bounds.min;
    let side = octree.leaf_side();
    let pixels = match settings.sharpness {
        Sharpness::Pixels(pixels) => pixels,
        Sharpness::Radius(radius) => settings.screen.pixels(side, radius),
    };
    if !PIXELS.contains(&pixels) {
        let text =
            format!("{pixels:.1} pixels along a leaf of {side} m; expected {} to {}", PIXELS.start(), PIXELS.end());
        return Err(BuildError::Settings(text));
    }
    let directions = match &settings.directions {
        DirectionsWanted::These(these) => these.clone(),
        DirectionsWanted::Most(most) => choose(&survey.orientations, *most, LEAST_GAIN),
    };
    let mut directions = directions;
    directions.sort_unstable();
    if directions.is_empty() {
        return Err(BuildError::Nothing);
    }
    let seen = sight(&directions, &survey.orientations, WITHIN_DEGREES.to_radians());
    let mut left_out = Vec::new();
    let mut leave_out = |what: String, because: String, figure: f64, unit: &str| {
        left_out.push(LeftOut { what, because, figure, unit: unit.to_owned() });
    };
    let splits = octree.splits();
    if splits.iter().any(|&n| n > 0) {
        for (axis, name) in ["x", "y", "z"].into_iter().enumerate().filter(|&(axis, _)| splits[axis] == 0) {
            let because = "one leaf covers the whole extent along it".to_owned();
            leave_out(format!("splits along {name}"), because, round(extent[axis]), "m");
        }
    }
    if let DirectionsWanted::Most(most) = settings.directions {
        let others: Vec<_> = Direction::all().filter(|d| !directions.contains(d)).collect();
        if directions.len() < most {
            let names: Vec<_> = others.iter().map(|d| d.name()).collect();
            let because = format!("none of {} adds as much of the surface, area times cosine gained", names.join(", "));
            leave_out(format!("{} directions", others.len()), because, LEAST_GAIN, "of the surface");
        }
        let below = faces(survey, |normal| normal.dot(up) < -0.5);
        if !directions.iter().any(|d| d.towards_eye().dot(up) < -1e-9) {
            leave_out(
                "directions from below".to_owned(),
                "little faces down by more than 30°".to_owned(),
                below,
                "of the surface",
            );
        }
    }
    if settings.baked_lighting {
        leave_out("normals".to_owned(), "the lighting is baked, so none is lit anew".to_owned(), 0.0, "lights");
    }
    if settings.geometry.is_none() {
        leave_out("geometry".to_owned(), "so wished".to_owned(), 0.0, "levels of detail");
    }
    Ok(Plan {
        octree,
        pixel: side / pixels,
        directions,
        sight: told(&seen),
        encoding: Encoding { colour: settings.colour, normals: !settings.baked_lighting },
        geometry: settings.geometry,
        left_out,
    })
}

/// Share of the surface whose normal is so.
fn faces(survey: &Statistics, so: impl Fn(DVec3) -> bool) -> f64 {
    let sum = |so: &dyn Fn(DVec3) -> bool| -> f64 {
        survey.orientations.iter().filter(|(normal, _)| so(*normal)).map(|(_, area)| area).sum()
    };
    let all = sum(&|_| true);
    if all > 0.0 { round(sum(&so) / all) } else { 0.0 }
}

fn told(sight: &Sight) -> Directions {
    Directions {
        within_degrees: WITHIN_DEGREES,
        share_not_within: round(1.0 - sight.share_within),
        share_unseen: round(sight.share_unseen),
        largest_degrees: round(sight.largest_angle.to_degrees()),
    }
}

/// To six places, for people.
pub(super) fn round(value: f64) -> f64 {
    // Not −0.
    (value * 1e6).round() / 1e6 + 0.0
}

/// `webp:QUALITY`, `jpeg:QUALITY`, or without loss `webp` or `png`.
///
/// # Errors
/// Anything else.
pub(super) fn colour_codec(text: &str) -> Result<ColourCodec, String> {
    let expected = "expected webp (lossless), png, or webp:QUALITY or jpeg:QUALITY with a quality from 1 to 100";
    match text.split_once(':') {
        None if text == "webp" => Ok(ColourCodec::WebpLossless),
        None if text == "png" => Ok(ColourCodec::Png),
        None if text == "jpeg" => Ok(ColourCodec::Jpeg(85)),
        Some(("webp", quality)) => match quality.parse() {
            Ok(quality @ 1..=100) => Ok(ColourCodec::Webp(quality)),
            _ => Err(expected.to_owned()),
        },
        Some(("jpeg", quality)) => match quality.parse() {
            Ok(quality @ 1..=100) => Ok(ColourCodec::Jpeg(quality)),
            _ => Err(expected.to_owned()),
        },
        _ => Err(expected.to_owned()),
    }
}

/// As [`colour_codec`] reads it.
pub(super) fn codec_name(codec: ColourCodec) -> String {
    match codec {
        ColourCodec::Png => "png".to_owned(),
        ColourCodec::WebpLossless => "webp".to_owned(),
        ColourCodec::Jpeg(quality) => format!("jpeg:{quality}"),
        ColourCodec::Webp(quality) => format!("webp:{quality}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_formula_and_its_inverse() {
        let screen = Screen { width: 1920.0, field: 90.0, angle: 60.0 };
        // tan 45° = 1, cos 60° = ½: q = 2 s p / (2 r).
        assert!((screen.pixels(64.0, 480.0) - 256.0).abs() < 1e-9);
        assert!((screen.radius(64.0, 256.0) - 480.0).abs() < 1e-9);
    }

    #[test]
    fn directions_and_codecs_by_name() {
        assert_eq!("auto".parse(), Ok(DirectionsWanted::Most(9)));
        assert_eq!("5".parse(), Ok(DirectionsWanted::Most(5)));
        let top = Direction::from_name("oop").expect("a name");
        assert_eq!("oop,oop".parse(), Ok(DirectionsWanted::These(vec![top])));
        for wrong in ["0", "27", "ooo", "up", ""] {
            assert!(wrong.parse::<DirectionsWanted>().is_err(), "{wrong}");
        }
        for name in ["webp", "png", "jpeg:50"] {
            assert_eq!(codec_name(colour_codec(name).expect("a codec")), name);
        }
        assert!(colour_codec("jpeg:0").is_err() && colour_codec("gif").is_err());
    }
}
