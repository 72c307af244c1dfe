//! Orthoviews and maps of their pixels as PNG files.

use foresight_index::orthoview::Orthoview;
use foresight_index::orthoview::connectivity::Links;
use foresight_index::orthoview::texture::encoded;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};

/// What there is nothing to be seen in.
const EMPTY: [u8; 3] = [24, 24, 32];

/// The colours, up is up.
pub fn colours(view: &Orthoview) -> Vec<u8> {
    of(view, |index| view.pixels[index].colour.map(encoded))
}

/// White where connected, grey where not.
pub fn connected(view: &Orthoview, links: &[Links]) -> Vec<u8> {
    of(view, |index| if links[index].is_connected() { [255; 3] } else { [120; 3] })
}

fn of(view: &Orthoview, colour: impl Fn(usize) -> [u8; 3]) -> Vec<u8> {
    let (width, height) = (view.rect.width(), view.rect.height());
    let mut rgb = Vec::with_capacity(3 * width * height);
    for y in (0..height).rev() {
        for x in 0..width {
            let index = y * width + x;
            rgb.extend(if view.pixels[index].is_some() { colour(index) } else { EMPTY });
        }
    }
    let mut png = Vec::new();
    let written = PngEncoder::new(&mut png).write_image(&rgb, width as u32, height as u32, ExtendedColorType::Rgb8);
    debug_assert!(written.is_ok(), "a whole image into memory");
    png
}
