//! Images of meshes, with their mips.

use super::content::{Texels, TextureImage};
use foresight_index::orthoview::texture::{Material, encoded, linear};
use image::{ImageReader, Limits, RgbaImage};
use std::collections::BTreeMap;
use std::io::Cursor;
use std::sync::Arc;

/// Widest and highest texture that is drawn, texels; what is larger is halved until it fits.
const SIDE_MAX: u32 = 8192;

/// Widest and highest image that is read, pixels.
const READ_MAX: u32 = 16_384;

/// Images that were decoded.
pub(super) struct Textures {
    pub(super) textures: Vec<Arc<TextureImage>>,
    /// Number of the texture by that of the image; `None` where there is none to be had.
    pub(super) of_image: Vec<Option<usize>>,
}

/// Decodes the images that materials show, once each.
pub(super) fn decode_all(images: &[Option<Arc<[u8]>>], materials: &[Material], left_out: &mut Vec<String>) -> Textures {
    let mut out = Textures { textures: Vec::new(), of_image: vec![None; images.len()] };
    // By where the bytes lie: several textures of a file may show one image.
    let mut known: BTreeMap<(usize, usize), Option<usize>> = BTreeMap::new();
    let mut shown: Vec<usize> = materials.iter().filter_map(|material| material.texture).collect();
    shown.sort_unstable();
    shown.dedup();
    for number in shown {
        let Some(bytes) = images.get(number).and_then(Option::as_deref) else { continue };
        let texture = known.entry((bytes.as_ptr().addr(), bytes.len())).or_insert_with(|| match decode(bytes) {
            Ok(texture) => {
                out.textures.push(Arc::new(texture));
                Some(out.textures.len() - 1)
            }
            Err(error) => {
                left_out.push(format!("a texture: {error}; expected a PNG, JPEG or WebP image"));
                None
            }
        });
        out.of_image[number] = *texture;
    }
    out
}

/// Reads an image and makes its mips.
fn decode(bytes: &[u8]) -> Result<TextureImage, String> {
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|error| error.to_string())?;
    let mut limits = Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(READ_MAX), Some(READ_MAX));
    reader.limits(limits);
    let image: RgbaImage = reader.decode().map_err(|error| error.to_string())?.into_rgba8();
    if image.width() == 0 || image.height() == 0 {
        return Err("no texels".to_owned());
    }
    let (mut size, mut texels) = ([image.width(), image.height()], image.into_raw());
    while size[0].max(size[1]) > SIDE_MAX {
        (size, texels) = halved(size, &texels);
    }
    Ok(TextureImage::with_mips(size, texels))
}

impl TextureImage {
    /// A texture of its finest level, four bytes a texel, first row first. There must be as many as `size` says, at least one.
    pub fn with_mips(size: [u32; 2], texels: Vec<u8>) -> TextureImage {
        debug_assert_eq!(texels.len(), 4 * size[0] as usize * size[1] as usize);
        let (mut level, mut finer) = (size, texels.clone());
        let mut all = texels;
        while level != [1, 1] {
            (level, finer) = halved(level, &finer);
            all.extend_from_slice(&finer);
        }
        TextureImage { size, texels: all, kept: Texels::Plain }
    }

    /// Size and texels, or blocks, of each level that there is, from the finest on: half of the one before, rounded down, at least 1.
    pub fn levels(&self) -> impl Iterator<Item = ([u32; 2], &[u8])> {
        let (mut size, mut rest) = (Some(self.size), self.texels.as_slice());
        std::iter::from_fn(move || {
            let own = size?;
            let (texels, after) = rest.split_at_checked(usize::try_from(self.kept.bytes(own, 4)).ok()?)?;
            rest = after;
            size = (own != [1, 1]).then(|| own.map(|side| (side / 2).max(1)));
            Some((own, texels))
        })
    }
}

/// The next coarser level: means in linear light over what a texel covers, weighted by opacity.
fn halved([width, height]: [u32; 2], texels: &[u8]) -> ([u32; 2], Vec<u8>) {
    let (w, h) = ((width / 2).max(1), (height / 2).max(1));
    let texel = |x: u32, y: u32| {
        let at = 4 * (y as usize * width as usize + x as usize);
        [texels[at], texels[at + 1], texels[at + 2], texels[at + 3]]
    };
    let mut out = Vec::with_capacity(4 * w as usize * h as usize);
    // A level of odd size gives its last row or column to the last texel.
    let span = |at: u32, coarse: u32, fine: u32| 2 * at..if at + 1 == coarse { fine } else { 2 * at + 2 };
    for y in 0..h {
        for x in 0..w {
            let (mut sum, mut plain, mut alpha, mut count) = ([0.0f32; 3], [0.0f32; 3], 0.0f32, 0.0f32);
            for j in span(y, h, height) {
                for i in span(x, w, width) {
                    let [r, g, b, a] = texel(i, j);
                    let a = f32::from(a);
                    for (channel, value) in [r, g, b].into_iter().enumerate() {
                        sum[channel] += a * linear(value);
                        plain[channel] += linear(value);
                    }
                    alpha += a;
                    count += 1.0;
                }
            }
            let colour = |c: usize| encoded(if alpha > 0.0 { sum[c] / alpha } else { plain[c] / count });
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a mean of bytes")]
            let alpha_byte = (alpha / count).round() as u8;
            out.extend([colour(0), colour(1), colour(2), alpha_byte]);
        }
    }
    ([w, h], out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mips_are_means_of_light_and_holes_have_no_colour() {
        // A row of white, black, white, red with nothing of it there, and a fifth column.
        let texels: Vec<u8> = [[255; 4], [0, 0, 0, 255], [255; 4], [255, 0, 0, 0], [255; 4]].concat();
        let texture = TextureImage::with_mips([5, 1], texels);
        let levels: Vec<_> = texture.levels().collect();
        assert_eq!(levels.iter().map(|(size, _)| *size).collect::<Vec<_>>(), [[5, 1], [2, 1], [1, 1]]);
        // Half of the light of white is 188 in sRGB.
        assert_eq!(levels[1].1[..4], [188, 188, 188, 255]);
        assert_eq!(levels[1].1[4..], [255, 255, 255, 170]);
        assert_eq!(levels.iter().map(|(_, texels)| texels.len()).sum::<usize>(), texture.texels.len());
    }

    #[test]
    fn what_is_no_image_leaves_the_base_colour() {
        let images = [Some(Arc::from(&b"nothing"[..])), None];
        let materials = [0, 1, 9].map(|texture| Material { texture: Some(texture), ..Material::default() });
        let mut left_out = Vec::new();
        let textures = decode_all(&images, &materials, &mut left_out);
        assert!(textures.textures.is_empty() && textures.of_image == [None, None]);
        assert_eq!(left_out.len(), 1);
    }
}
