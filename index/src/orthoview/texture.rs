//! Colours of surfaces: textures with their mips, in linear light.

use super::raster::Surface;
use glam::DVec2;
use std::sync::{Arc, OnceLock};

/// Widest and highest texture that is read, texels.
pub const SIDE_MAX: u32 = 16_384;

/// An image with its mips, sRGB with straight alpha, repeated beyond its borders.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// From the finest on: width, height, texels row by row.
    levels: Vec<(usize, usize, Vec<[u8; 4]>)>,
}

/// Why a texture cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum TextureError {
    /// It is no PNG, JPEG or WebP, or a broken one.
    #[error("{0}; expected a PNG, JPEG or WebP image")]
    Image(#[from] image::ImageError),
    /// It has no texels or far too many.
    #[error("{0} × {1} texels; expected 1 to {SIDE_MAX} a side")]
    Size(u32, u32),
}

impl Texture {
    /// Reads an image and makes its mips: averages of 2 × 2 in linear light, weighted by alpha.
    ///
    /// # Errors
    /// What is no image, or is too large.
    pub fn decode(bytes: &[u8]) -> Result<Texture, TextureError> {
        let mut reader = image::ImageReader::new(std::io::Cursor::new(bytes))
            .with_guessed_format()
            .map_err(|error| TextureError::Image(image::ImageError::IoError(error)))?;
        let mut limits = image::Limits::default();
        limits.max_image_width = Some(SIDE_MAX);
        limits.max_image_height = Some(SIDE_MAX);
        reader.limits(limits);
        let image = reader.decode()?.into_rgba8();
        let (width, height) = image.dimensions();
        if width == 0 || height == 0 {
            return Err(TextureError::Size(width, height));
        }
        Ok(Texture::new(width as usize, height as usize, image.pixels().map(|p| p.0).collect()))
    }

    /// A texture of texels row by row; there must be `width` × `height`, and at least one.
    pub fn new(width: usize, height: usize, texels: Vec<[u8; 4]>) -> Texture {
        assert!(width * height > 0 && texels.len() == width * height, "a whole image");
        let mut levels = vec![(width, height, texels)];
        while let Some((width, height, finer)) = levels.last().filter(|(w, h, _)| *w > 1 || *h > 1) {
            let (w, h) = (width.div_ceil(2), height.div_ceil(2));
            let texel = |x: usize, y: usize| finer[y.min(height - 1) * width + x.min(width - 1)];
            let mut coarser = Vec::with_capacity(w * h);
            for y in 0..h {
                for x in 0..w {
                    let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| texel(2 * x + i, 2 * y + j));
                    coarser.push(average(four));
                }
            }
            levels.push((w, h, coarser));
        }
        Texture { levels }
    }

    /// Width and height, texels.
    pub fn size(&self) -> (usize, usize) {
        (self.levels[0].0, self.levels[0].1)
    }

    /// The texels, row by row.
    pub fn texels(&self) -> &[[u8; 4]] {
        &self.levels[0].2
    }

    /// Bytes of the texels of all mips.
    pub fn bytes(&self) -> usize {
        self.levels.iter().map(|level| level.2.len() * 4).sum()
    }

    /// Colour (linear light) and alpha at texture coordinates, averaged over a square of `footprint` of the whole:
    /// bilinear in the mip whose texels are at least that large.
    #[expect(clippy::cast_possible_truncation, reason = "texels of an image, reduced to its size")]
    pub fn sample(&self, uv: DVec2, footprint: f64) -> ([f32; 3], f32) {
        if !uv.is_finite() {
            return ([0.0; 3], 1.0);
        }
        let finest = self.levels[0].0.max(self.levels[0].1) as f64;
        let (wanted, mut texel, mut level) = (footprint * finest, 1.5, 0);
        while wanted > texel && level + 1 < self.levels.len() {
            texel *= 2.0;
            level += 1;
        }
        let lights = linear_lights();
        let (width, height, texels) = &self.levels[level];
        let at = DVec2::new((uv.x - uv.x.floor()) * *width as f64 - 0.5, (uv.y - uv.y.floor()) * *height as f64 - 0.5);
        let (x, y) = (at.x.floor(), at.y.floor());
        let (fx, fy) = ((at.x - x) as f32, (at.y - y) as f32);
        let wrap = |v: f64, end: usize| (v as i64).rem_euclid(end as i64) as usize;
        let (mut colour, mut alpha) = ([0.0f32; 3], 0.0f32);
        for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let texel = texels[wrap(y + f64::from(j), *height) * width + wrap(x + f64::from(i), *width)];
            let weight = (if i == 1 { fx } else { 1.0 - fx }) * (if j == 1 { fy } else { 1.0 - fy });
            for (sum, value) in colour.iter_mut().zip(texel) {
                *sum += weight * lights[value as usize];
            }
            alpha += weight * f32::from(texel[3]) / 255.0;
        }
        (colour, alpha)
    }
}

fn average(four: [[u8; 4]; 4]) -> [u8; 4] {
    let alpha: f32 = four.iter().map(|t| f32::from(t[3])).sum();
    let channel = |c: usize| {
        let weight = |t: &[u8; 4]| if alpha > 0.0 { f32::from(t[3]) / alpha } else { 0.25 };
        encoded(four.iter().map(|t| weight(t) * linear(t[c])).sum())
    };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a mean of bytes")]
    let alpha = (alpha / 4.0).round() as u8;
    [channel(0), channel(1), channel(2), alpha]
}

/// Linear light of an sRGB byte (IEC 61966-2-1).
pub fn linear(byte: u8) -> f32 {
    linear_lights()[byte as usize]
}

fn linear_lights() -> &'static [f32; 256] {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    TABLE.get_or_init(|| {
        std::array::from_fn(|byte| {
            let v = byte as f64 / 255.0;
            let light = if v <= 0.040_45 { v / 12.92 } else { libm::pow((v + 0.055) / 1.055, 2.4) };
            #[expect(clippy::cast_possible_truncation, reason = "0 to 1")]
            let light = light as f32;
            light
        })
    })
}

/// The sRGB byte nearest to a linear light; 0 for NaN.
pub fn encoded(light: f32) -> u8 {
    /// Least light of each byte but 0, and for each of 1024 equal parts of 0 to 1 the byte of its lower end.
    type Table = ([f32; 255], [u8; 1025]);
    static TABLE: OnceLock<Table> = OnceLock::new();
    let (least, parts) = TABLE.get_or_init(|| {
        // Bytes change halfway between them on the encoded scale.
        let least: [f32; 255] = std::array::from_fn(|below| {
            let v = (below as f64 + 0.5) / 255.0;
            let light = if v <= 0.040_45 { v / 12.92 } else { libm::pow((v + 0.055) / 1.055, 2.4) };
            #[expect(clippy::cast_possible_truncation, reason = "0 to 1")]
            let light = light as f32;
            light
        });
        let byte = |part: usize| least.partition_point(|l| *l <= part as f32 / 1024.0) as u8;
        (least, std::array::from_fn(byte))
    });
    let light = if light > 0.0 { light.min(1.0) } else { 0.0 };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 1024")]
    let mut byte = parts[(light * 1024.0) as usize];
    while byte < 255 && least[byte as usize] <= light {
        byte += 1;
    }
    byte
}

/// What a material looks like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Linear light, multiplied with the texture.
    pub base: [f32; 3],
    /// Which texture.
    pub texture: Option<usize>,
    /// What is less opaque than this is a hole.
    pub cutoff: f32,
}

impl Default for Material {
    fn default() -> Material {
        Material { base: [1.0; 3], texture: None, cutoff: 0.0 }
    }
}

/// Materials and their textures.
#[derive(Clone, Debug, Default)]
pub struct Materials {
    /// By number.
    pub materials: Vec<Material>,
    /// By number; absent where it could not be read.
    pub textures: Vec<Option<Arc<Texture>>>,
}

impl Surface for Materials {
    fn colour(&self, material: u32, uv: DVec2, footprint: f64) -> Option<[f32; 3]> {
        let material = self.materials.get(material as usize).copied().unwrap_or_default();
        let texture = material.texture.and_then(|t| self.textures.get(t)?.as_ref());
        let Some(texture) = texture else { return Some(material.base) };
        let (colour, alpha) = texture.sample(uv, footprint);
        (alpha >= material.cutoff).then(|| std::array::from_fn(|c| colour[c] * material.base[c]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_survive_linear_light() {
        for byte in 0..=255u8 {
            assert_eq!(encoded(linear(byte)), byte);
        }
        assert_eq!((encoded(-1.0), encoded(9.0), encoded(f32::NAN)), (0, 255, 0));
    }

    #[test]
    fn wide_footprints_average_and_narrow_ones_show_texels() {
        // Black and white halves in linear light: the mean is ½, not the sRGB middle.
        let texels = (0..16).map(|i| if i % 4 < 2 { [0, 0, 0, 255] } else { [255; 4] }).collect();
        let texture = Texture::new(4, 4, texels);
        let (far, alpha) = texture.sample(DVec2::new(0.3, 0.6), 8.0);
        assert!((far[0] - 0.5).abs() < 5e-3 && alpha > 0.999, "{far:?}");
        assert_eq!(texture.sample(DVec2::new(0.25, 0.5), 0.0).0, [0.0; 3]);
        assert_eq!(texture.sample(DVec2::new(-0.25, 7.5), 0.0).0, [1.0; 3]);
        assert_eq!(texture.sample(DVec2::new(f64::NAN, 0.0), 0.0).0, [0.0; 3]);
        // Bilinear between black and white.
        assert!((texture.sample(DVec2::new(0.5, 0.5), 0.0).0[1] - 0.5).abs() < 1e-6);
    }

    #[test]
    fn transparent_texels_are_holes_and_tint_nothing() {
        let texture = Texture::new(2, 1, vec![[255, 0, 0, 255], [0, 255, 0, 0]]);
        assert_eq!(texture.levels[1].2, [[255, 0, 0, 128]]);
        let material = Material { texture: Some(0), cutoff: 0.5, ..Material::default() };
        let surface = Materials { materials: vec![material], textures: vec![Some(Arc::new(texture))] };
        assert_eq!(surface.colour(0, DVec2::new(0.75, 0.5), 0.0), None);
        assert_eq!(surface.colour(0, DVec2::new(0.25, 0.5), 0.0), Some([1.0, 0.0, 0.0]));
        assert_eq!(surface.colour(7, DVec2::ZERO, 0.0), Some([1.0; 3]), "no such material: white");
        assert!(Texture::decode(b"not an image").is_err());
    }
}
