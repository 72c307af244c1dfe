//! Textures of a city, drawn from a seed: façades of four storeys and four windows, roofs, ground, foliage. They tile.

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

use super::super::random::Random;

/// Storeys and windows of one façade texture.
pub(super) const PANES: u32 = 4;

/// What a texture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Pattern {
    Facade { side: u32, seed: u64 },
    Ground { side: u32, seed: u64 },
    Foliage { side: u32, seed: u64 },
}

/// Streams of random numbers.
const PAINT: u64 = 101;
const GRAIN: u64 = 102;

/// Bases of façades, sRGB: brick, plaster, sandstone, concrete, glass.
const WALLS: [[f64; 3]; 5] =
    [[150.0, 84.0, 66.0], [214.0, 205.0, 186.0], [196.0, 172.0, 128.0], [158.0, 158.0, 154.0], [92.0, 116.0, 132.0]];

/// The texture as PNG.
pub(super) fn png(pattern: Pattern) -> Vec<u8> {
    let (Pattern::Facade { side, .. } | Pattern::Ground { side, .. } | Pattern::Foliage { side, .. }) = pattern;
    let mut pixels = Vec::with_capacity((side * side * 3) as usize);
    for y in 0..side {
        for x in 0..side {
            let colour = match pattern {
                Pattern::Facade { seed, .. } => facade(seed, x, y, side),
                Pattern::Ground { seed, .. } => grained([128.0, 126.0, 120.0], 26.0, seed, x, y),
                Pattern::Foliage { seed, .. } => grained([58.0, 96.0, 44.0], 70.0, seed, x, y),
            };
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a byte")]
            pixels.extend(colour.map(|v| v.round().clamp(0.0, 255.0) as u8));
        }
    }
    let mut png = Vec::new();
    let written = PngEncoder::new(&mut png).write_image(&pixels, side, side, ExtendedColorType::Rgb8);
    debug_assert!(written.is_ok(), "a whole image into memory");
    png
}

/// Noise of a pixel, the same for each channel.
fn grained(base: [f64; 3], by: f64, seed: u64, x: u32, y: u32) -> [f64; 3] {
    let noise = by * (Random::at(seed, GRAIN, u64::from(x), u64::from(y)).unit() - 0.5);
    base.map(|v| v + noise)
}

fn facade(seed: u64, x: u32, y: u32, side: u32) -> [f64; 3] {
    let mut paint = Random::at(seed, PAINT, 0, 0);
    let wall = WALLS[(paint.next() % WALLS.len() as u64) as usize].map(|v| v * paint.within(0.85, 1.12));
    let pane = side / PANES;
    let (column, row) = (x / pane, y / pane);
    let (u, v) = (f64::from(x % pane) / f64::from(pane), f64::from(y % pane) / f64::from(pane));
    let is_window = (WINDOW[0]..WINDOW[1]).contains(&u) && (WINDOW[2]..WINDOW[3]).contains(&v);
    if !is_window {
        return grained(wall, 14.0, seed, x, y);
    }
    // Sky in the glass, brighter above; some blinds are down.
    let mut own = Random::at(seed, PAINT, u64::from(column) + 1, u64::from(row) + 1);
    let blind = own.unit();
    let glass = if v < WINDOW[2] + 0.6 * blind * (WINDOW[3] - WINDOW[2]) && blind > 0.6 {
        [206.0, 200.0, 186.0]
    } else {
        [46.0, 62.0, 78.0].map(|c| c + 40.0 * (1.0 - v))
    };
    let frame = [u - WINDOW[0], WINDOW[1] - u, v - WINDOW[2], WINDOW[3] - v].iter().any(|d| *d < 0.04);
    grained(if frame { [228.0, 226.0, 220.0] } else { glass }, 6.0, seed, x, y)
}

/// Left, right, top and bottom of a window in its pane, from its upper left corner.
pub(super) const WINDOW: [f64; 4] = [0.26, 0.74, 0.22, 0.76];
