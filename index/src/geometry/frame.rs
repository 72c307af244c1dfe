//! The part of a texture that a cell shows: cropped, reduced, and as a file.

use glam::DVec2;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder as _};

use super::GeometryError;
use crate::orthoview::texture::{Texture, linear};

/// Texels kept around what is shown, for interpolation.
const MARGIN: f64 = 2.0;

/// A part of a texture, and the texture coordinates that 0 to 1 stand for in it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Frame {
    /// First column and row, texels; modulo the texture's size.
    first: [i64; 2],
    /// Columns and rows.
    pub(super) size: [usize; 2],
    /// Texture coordinates at 0.
    pub(super) offset: DVec2,
    /// What 1 is further on.
    pub(super) scale: DVec2,
    /// Whether the texture is there as a whole and repeated; else the frame is the picture.
    pub(super) is_repeated: bool,
}

/// An image's file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Picture {
    /// The file.
    pub(super) bytes: Vec<u8>,
    /// PNG, else JPEG.
    pub(super) is_png: bool,
    /// Width and height, texels.
    pub(super) size: [usize; 2],
}

impl Frame {
    /// The frame of texture coordinates from `min` to `max` in a texture of `size` texels. What is wider than the texture
    /// repeats it as a whole.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "texture coordinates are below 10⁶, sides below 2¹⁵"
    )]
    pub(super) fn over(min: DVec2, max: DVec2, size: [usize; 2]) -> Frame {
        let extent = DVec2::new(size[0] as f64, size[1] as f64);
        let span = (max - min).max(DVec2::splat(1e-9));
        if (span * extent).cmpgt(extent + 0.5).any() {
            return Frame { first: [0; 2], size, offset: min, scale: span, is_repeated: true };
        }
        let (mut first, mut texels) = ([0; 2], [0; 2]);
        for axis in 0..2 {
            let side = extent[axis];
            let (mut low, mut high) = ((min[axis] * side - MARGIN).floor(), (max[axis] * side + MARGIN).ceil());
            // A frame within the texture stays there.
            let turn = ((min[axis] + max[axis]) * 0.5).floor() * side;
            if min[axis] * side >= turn - 0.5 && max[axis] * side <= turn + side + 0.5 {
                (low, high) = (low.max(turn), high.min(turn + side));
            }
            high = high.max(low + 1.0);
            first[axis] = low as i64;
            texels[axis] = (high - low) as usize;
        }
        let offset = DVec2::new(first[0] as f64, first[1] as f64) / extent;
        let scale = DVec2::new(texels[0] as f64, texels[1] as f64) / extent;
        Frame { first, size: texels, offset, scale, is_repeated: false }
    }

    /// Texture coordinates in the frame as 16-bit shares of it.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    pub(super) fn narrowed(&self, uv: DVec2) -> [u16; 2] {
        let share = (uv - self.offset) / self.scale;
        share.to_array().map(|s| (s * 65535.0).round().clamp(0.0, 65535.0) as u16)
    }

    /// For a repeated texture, what makes texture coordinates of shares: offset and scale. Whole turns change nothing.
    pub(super) fn transform(&self) -> Option<(DVec2, DVec2)> {
        self.is_repeated.then(|| (self.offset - self.offset.floor(), self.scale))
    }

    /// Times that a side can be halved.
    pub(super) fn halvings_max(&self) -> u32 {
        self.size[0].max(self.size[1]).max(1).ilog2()
    }

    /// The frame's part of the texture, its sides divided by 2^`halvings`: means in linear light, weighted by alpha. PNG with
    /// alpha where it is asked for and there is any, else JPEG.
    pub(super) fn picture(
        &self,
        texture: &Texture,
        halvings: u32,
        with_alpha: bool,
        quality: u8,
    ) -> Result<Picture, GeometryError> {
        let reduced = self.size.map(|side| side.div_ceil(1 << halvings));
        let texels = self.cropped(texture);
        let texels = if reduced == self.size { texels } else { averaged(&texels, self.size, reduced) };
        let is_png = with_alpha && texels.iter().any(|t| t[3] < 255);
        let [width, height] = reduced.map(|side| side as u32);
        let mut bytes = Vec::new();
        if is_png {
            let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, FilterType::Adaptive);
            encoder.write_image(texels.as_flattened(), width, height, ExtendedColorType::Rgba8)?;
        } else {
            let opaque: Vec<u8> = texels.iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect();
            let encoder = JpegEncoder::new_with_quality(&mut bytes, quality);
            encoder.write_image(&opaque, width, height, ExtendedColorType::Rgb8)?;
        }
        Ok(Picture { bytes, is_png, size: reduced })
    }

    fn cropped(&self, texture: &Texture) -> Vec<[u8; 4]> {
        let (width, height) = texture.size();
        let texels = texture.texels();
        let wrapped = |at: i64, side: usize| at.rem_euclid(side as i64) as usize;
        let rows = (0..self.size[1]).map(|y| wrapped(self.first[1] + y as i64, height));
        rows.flat_map(|y| (0..self.size[0]).map(move |x| texels[y * width + wrapped(self.first[0] + x as i64, width)]))
            .collect()
    }
}

/// A smaller image of the same: each texel the mean of those that it covers, in linear light and weighted by alpha.
fn averaged(texels: &[[u8; 4]], from: [usize; 2], to: [usize; 2]) -> Vec<[u8; 4]> {
    // Colour times alpha, alpha; rows first.
    let premultiplied = |t: &[u8; 4]| {
        let alpha = f32::from(t[3]) / 255.0;
        [linear(t[0]) * alpha, linear(t[1]) * alpha, linear(t[2]) * alpha, alpha]
    };
    let across = covered(from[0], to[0]);
    let mut narrow = Vec::with_capacity(to[0] * from[1]);
    for row in texels.chunks_exact(from[0]) {
        for span in &across {
            narrow.push(span.iter().fold([0.0; 4], |sum, &(at, weight)| add(sum, premultiplied(&row[at]), weight)));
        }
    }
    let mut out = Vec::with_capacity(to[0] * to[1]);
    for span in covered(from[1], to[1]) {
        for x in 0..to[0] {
            let [r, g, b, a] = span.iter().fold([0.0; 4], |sum, &(y, w)| add(sum, narrow[y * to[0] + x], w));
            let per_alpha = if a > 0.0 { 1.0 / a } else { 0.0 };
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a mean of shares")]
            let alpha = (a * 255.0).round().clamp(0.0, 255.0) as u8;
            out.push([byte(r * per_alpha), byte(g * per_alpha), byte(b * per_alpha), alpha]);
        }
    }
    out
}

fn add(sum: [f32; 4], value: [f32; 4], weight: f32) -> [f32; 4] {
    std::array::from_fn(|i| sum[i] + value[i] * weight)
}

/// Which of `from` texels each of `to` covers, and which share of it each is.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "texels of a side")]
fn covered(from: usize, to: usize) -> Vec<Vec<(usize, f32)>> {
    let width = from as f64 / to as f64;
    let span = |i: usize| {
        let (low, high) = (i as f64 * width, (i + 1) as f64 * width);
        let texels = low.floor() as usize..(high.ceil() as usize).min(from);
        let share = move |at: usize| ((high.min(at as f64 + 1.0) - low.max(at as f64)) / width) as f32;
        texels.map(move |at| (at, share(at))).filter(|(_, share)| *share > 0.0).collect()
    };
    (0..to).map(span).collect()
}

/// The sRGB byte nearest to a linear light.
fn byte(light: f32) -> u8 {
    use std::sync::OnceLock;
    static HALFWAY: OnceLock<[f32; 255]> = OnceLock::new();
    let halfway = HALFWAY.get_or_init(|| {
        std::array::from_fn(|i| {
            let v = (i as f64 + 0.5) / 255.0;
            let light = if v <= 0.040_45 { v / 12.92 } else { libm::pow((v + 0.055) / 1.055, 2.4) };
            #[expect(clippy::cast_possible_truncation, reason = "0 to 1")]
            let light = light as f32;
            light
        })
    });
    halfway.partition_point(|&h| h <= light) as u8
}
