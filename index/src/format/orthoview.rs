//! Orthoviews as files: one file an image, so that one request brings all of it.
//!
//! ```text
//! 0   "FSOV", version (u8), colour codec (u8), has normals (u8), level (u8)
//! 8   direction's name (3 bytes), 0
//! 12  first column, first row (i64 each), columns, rows (u32 each)
//! 36  near, range (f64 each, metres)
//! 52  bytes of the colours, the shape, the normals (u32 each), 0 (u32)
//! 68  colours: an image file; shape: lossless WebP, red and green the low and high byte of the depth's code
//!     ([`super::prediction`]), blue the 6 bits of the links; normals: lossless WebP, red and green on the octahedron
//! ```
//!
//! Numbers are little-endian. The image is cut to what is occupied. Where nothing is shown, the link's bit for presence is
//! 0, and the other planes repeat their neighbours, which costs next to nothing. 10 bits of depth and 6 of connectivity
//! are \[HIBR\]'s. Every plane is one that a browser decodes.

use super::prediction::{predicted, restored};
use crate::orthoview::Direction;
use crate::orthoview::connectivity::Links;
use crate::orthoview::image::{Orthoview, Pixel, Rect};
use crate::orthoview::texture::{encoded, linear};
use glam::I64Vec2;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ColorType, ExtendedColorType, ImageEncoder, ImageFormat};

/// Version that is written.
pub const VERSION: u8 = 1;

/// Bytes before the planes.
const HEADER: usize = 68;

/// Most columns or rows of an image.
pub const SIDE_MAX: usize = 1 << 13;

/// Steps of a depth over a cell's range: 10 bits.
const DEPTH_STEPS: f64 = 1023.0;

/// How colours are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColourCodec {
    /// Lossless.
    Png,
    /// Lossless, smaller.
    WebpLossless,
    /// Lossy; quality 1 to 100. \[DRVW\] §5 takes 50.
    Jpeg(u8),
    /// Lossy, half of a JPEG at the same fidelity; quality 1 to 100.
    Webp(u8),
}

/// What a file is made with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Encoding {
    /// Of the colours.
    pub colour: ColourCodec,
    /// Whether normals are kept: without them nothing can be lit anew, and splats are not warped.
    pub normals: bool,
}

impl Default for Encoding {
    fn default() -> Encoding {
        Encoding { colour: ColourCodec::Webp(85), normals: true }
    }
}

/// Why a file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum OrthoviewError {
    /// It does not begin like one, or is cut off.
    #[error("byte {at}: {found}; expected {expected}")]
    Header {
        /// Where.
        at: usize,
        /// What is there.
        found: String,
        /// What ought to be.
        expected: &'static str,
    },
    /// A plane is no image, or not one of the right size.
    #[error("the plane of {plane}: {fault}")]
    Plane {
        /// Which.
        plane: &'static str,
        /// What is wrong.
        fault: String,
    },
    /// The image is larger than files may be.
    #[error("{0} × {1} pixels; expected at most {SIDE_MAX} a side")]
    Size(usize, usize),
}

/// A file's content.
#[derive(Clone, Debug, PartialEq)]
pub struct Decoded {
    /// From where it is seen.
    pub direction: Direction,
    /// The image; normals are all zero where the file has none.
    pub view: Orthoview,
    /// A pixel's links.
    pub links: Vec<Links>,
}

/// An image cut to what is occupied, as planes of whole numbers, row by row, upwards.
///
/// Where nothing is shown, the link's bit for presence is 0 and the other planes repeat the pixel before, which costs codecs
/// next to nothing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Planes {
    /// Where they lie.
    pub rect: Rect,
    /// sRGB, three bytes a pixel.
    pub colours: Vec<u8>,
    /// Steps of the cell's depth, 10 bits.
    pub depths: Vec<u16>,
    /// [`Links::bits`].
    pub links: Vec<u8>,
    /// On the octahedron, two bytes a pixel.
    pub normals: Vec<u8>,
}

impl Planes {
    /// Whether a pixel shows something.
    pub fn is_shown(&self, index: usize) -> bool {
        Links::from_bits(self.links[index]).is_present()
    }

    /// Number of pixels that show something.
    pub fn shown(&self) -> usize {
        (0..self.links.len()).filter(|&index| self.is_shown(index)).count()
    }
}

/// The planes of an image; `None` if nothing is in it.
pub fn planes(view: &Orthoview, links: &[Links]) -> Option<Planes> {
    let rect = occupied(view)?;
    let area = rect.area();
    let mut planes = Planes {
        rect,
        colours: Vec::with_capacity(3 * area),
        depths: Vec::with_capacity(area),
        links: Vec::with_capacity(area),
        normals: Vec::with_capacity(2 * area),
    };
    let (mut colour, mut depth, mut normal) = ([0u8; 3], 0u16, [128u8; 2]);
    for y in rect.min.y..rect.max.y {
        let first = view.rect.index(I64Vec2::new(rect.min.x, y)).unwrap_or_default();
        for (pixel, link) in view.pixels[first..].iter().zip(&links[first..]).take(rect.width()) {
            if pixel.is_some() {
                colour = pixel.colour.map(encoded);
                depth = steps(pixel.depth, view.range);
                normal = octahedral(pixel.normal);
            }
            planes.colours.extend(colour);
            planes.depths.push(depth);
            planes.links.push(link.bits());
            planes.normals.extend(normal);
        }
    }
    Some(planes)
}

/// Part of an image that is occupied; `None` if nothing is.
fn occupied(view: &Orthoview) -> Option<Rect> {
    let width = view.rect.width().max(1);
    let mut bounds: Option<[usize; 4]> = None;
    for (y, row) in view.pixels.chunks(width).enumerate() {
        let Some(first) = row.iter().position(Pixel::is_some) else { continue };
        let last = row.iter().rposition(Pixel::is_some).unwrap_or(first);
        let [x0, x1, y0, _] = bounds.unwrap_or([first, last, y, y]);
        bounds = Some([x0.min(first), x1.max(last), y0, y]);
    }
    let [x0, x1, y0, y1] = bounds?;
    let at = |x: usize, y: usize| view.rect.min + I64Vec2::new(x as i64, y as i64);
    Some(Rect { min: at(x0, y0), max: at(x1 + 1, y1 + 1) })
}

/// A unit vector on the octahedron, two bytes; the middle for what is none.
pub fn octahedral(normal: [f32; 3]) -> [u8; 2] {
    let [x, y, z] = normal;
    let sum = x.abs() + y.abs() + z.abs();
    if sum.is_nan() || sum <= 0.0 {
        return [128, 128];
    }
    let (x, y) = (x / sum, y / sum);
    let (x, y) = if z < 0.0 { ((1.0 - y.abs()) * x.signum(), (1.0 - x.abs()) * y.signum()) } else { (x, y) };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 255")]
    let byte = |v: f32| (128.0 + 127.0 * v).round().clamp(1.0, 255.0) as u8;
    [byte(x), byte(y)]
}

/// The unit vector of two bytes on the octahedron.
pub fn from_octahedral([x, y]: [u8; 2]) -> [f32; 3] {
    let value = |v: u8| ((f32::from(v) - 128.0) / 127.0).max(-1.0);
    let (x, y) = (value(x), value(y));
    let z = 1.0 - x.abs() - y.abs();
    let (x, y) = if z < 0.0 { ((1.0 - y.abs()) * x.signum(), (1.0 - x.abs()) * y.signum()) } else { (x, y) };
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, y / length, z / length]
}

/// A depth in steps of a range. A range of nothing has one step.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 1023")]
fn steps(depth: f32, range: f64) -> u16 {
    let share = if range > 0.0 { f64::from(depth) / range } else { 0.0 };
    (share * DEPTH_STEPS).round().clamp(0.0, DEPTH_STEPS) as u16
}

/// Half a step of the depths of a cell this deep, metres: what a file keeps them to.
pub fn depth_error(range: f64) -> f64 {
    0.5 * range / DEPTH_STEPS
}

/// Writes an image; `None` if nothing is in it.
///
/// # Errors
/// An image beyond [`SIDE_MAX`].
pub fn encode(
    view: &Orthoview,
    links: &[Links],
    direction: Direction,
    encoding: Encoding,
) -> Result<Option<Vec<u8>>, OrthoviewError> {
    let Some(planes) = planes(view, links) else { return Ok(None) };
    let rect = planes.rect;
    let (width, height) = (rect.width(), rect.height());
    if width > SIDE_MAX || height > SIDE_MAX {
        return Err(OrthoviewError::Size(width, height));
    }
    let size = (width as u32, height as u32);
    let Planes { colours, depths, links: bits, normals, .. } = planes;
    let colour_file = match encoding.colour {
        ColourCodec::Png => png(&colours, size)?,
        ColourCodec::WebpLossless => webp(&colours, size, None, "colours")?,
        ColourCodec::Webp(quality) => webp(&colours, size, Some(quality), "colours")?,
        ColourCodec::Jpeg(quality) => written(
            |out| {
                JpegEncoder::new_with_quality(out, quality.clamp(1, 100)).encode(
                    &colours,
                    size.0,
                    size.1,
                    ExtendedColorType::Rgb8,
                )
            },
            "colours",
        )?,
    };
    let codes = predicted(&depths, width);
    let shape: Vec<u8> =
        codes.iter().zip(&bits).flat_map(|(code, links)| [*code as u8, (code >> 8) as u8, *links]).collect();
    let shape_file = webp(&shape, size, None, "the shape")?;
    let normal_file = if encoding.normals {
        let three: Vec<u8> = normals.as_chunks::<2>().0.iter().flat_map(|&[x, y]| [x, y, 0]).collect();
        webp(&three, size, None, "normals")?
    } else {
        Vec::new()
    };

    let mut file = Vec::with_capacity(HEADER + colour_file.len() + shape_file.len() + normal_file.len());
    let codec = match encoding.colour {
        ColourCodec::Png => 0,
        ColourCodec::WebpLossless | ColourCodec::Webp(_) => 1,
        ColourCodec::Jpeg(_) => 2,
    };
    file.extend_from_slice(b"FSOV");
    file.extend([VERSION, codec, u8::from(encoding.normals), view.level.min(255) as u8]);
    file.extend_from_slice(direction.name().as_bytes());
    file.push(0);
    file.extend(rect.min.x.to_le_bytes());
    file.extend(rect.min.y.to_le_bytes());
    file.extend(size.0.to_le_bytes());
    file.extend(size.1.to_le_bytes());
    file.extend(view.near.to_le_bytes());
    file.extend(view.range.to_le_bytes());
    let planes = [colour_file, shape_file, normal_file, Vec::new()];
    for plane in &planes {
        file.extend((plane.len() as u32).to_le_bytes());
    }
    planes.iter().for_each(|plane| file.extend_from_slice(plane));
    Ok(Some(file))
}

fn written(
    write: impl FnOnce(&mut Vec<u8>) -> image::ImageResult<()>,
    plane: &'static str,
) -> Result<Vec<u8>, OrthoviewError> {
    let mut out = Vec::new();
    write(&mut out).map_err(|error| OrthoviewError::Plane { plane, fault: error.to_string() })?;
    Ok(out)
}

fn png(data: &[u8], size: (u32, u32)) -> Result<Vec<u8>, OrthoviewError> {
    written(
        |out| {
            PngEncoder::new_with_quality(out, CompressionType::Default, FilterType::Adaptive).write_image(
                data,
                size.0,
                size.1,
                ExtendedColorType::Rgb8,
            )
        },
        "colours",
    )
}

/// WebP of three channels by libwebp, lossless without a quality. Lossless takes the effort of a quality of 75.
fn webp(
    data: &[u8],
    (width, height): (u32, u32),
    quality: Option<u8>,
    plane: &'static str,
) -> Result<Vec<u8>, OrthoviewError> {
    let encoder = webp::Encoder::from_rgb(data, width, height);
    let quality_or_effort = f32::from(quality.unwrap_or(75).clamp(1, 100));
    let file = encoder.encode_simple(quality.is_none(), quality_or_effort);
    file.map(|file| file.to_vec()).map_err(|error| OrthoviewError::Plane { plane, fault: format!("{error:?}") })
}

/// Bytes of a file's pixels once a client has uploaded them: colour (4), depth and links (2), and normal (2) where there is
/// one. 0 for what is no such file.
pub fn uploaded_bytes(file: &[u8]) -> u64 {
    let Some(header) = file.first_chunk::<HEADER>().filter(|header| header.starts_with(b"FSOV")) else { return 0 };
    let four = |at: usize| u64::from(u32::from_le_bytes(<[u8; 4]>::try_from(&header[at..at + 4]).unwrap_or_default()));
    let pixel = if header[6] == 0 { 6 } else { 8 };
    four(28).saturating_mul(four(32)).saturating_mul(pixel)
}

/// A file's content in whole numbers, as [`planes`] made them.
#[derive(Clone, Debug, PartialEq)]
pub struct DecodedPlanes {
    /// From where it is seen.
    pub direction: Direction,
    /// Level of the pixels, and of the cell.
    pub level: u32,
    /// Least depth of the cell, metres.
    pub near: f64,
    /// Depth of the cell, metres: [`Planes::depths`] are steps of 1/1023 of it.
    pub range: f64,
    /// The planes; `normals` is empty where the file has none.
    pub planes: Planes,
}

/// Reads a file. Pixels outside of what was occupied are not there: the image's `rect` is the smaller one.
///
/// # Errors
/// What is no such file, is cut off, or contradicts itself.
pub fn decode(bytes: &[u8]) -> Result<Decoded, OrthoviewError> {
    let DecodedPlanes { direction, level, near, range, planes } = decode_planes(bytes)?;
    let pixel = |index: usize| {
        if !planes.is_shown(index) {
            return Pixel::EMPTY;
        }
        #[expect(clippy::cast_possible_truncation, reason = "relative to the cell's near end")]
        let depth = (f64::from(planes.depths[index]) / DEPTH_STEPS * range) as f32;
        let normal = planes.normals.get(2 * index..2 * index + 2).map_or([0.0; 3], |n| from_octahedral([n[0], n[1]]));
        Pixel { depth, colour: std::array::from_fn(|c| linear(planes.colours[3 * index + c])), normal }
    };
    let pixels = (0..planes.links.len()).map(pixel).collect();
    let view = Orthoview { level, rect: planes.rect, near, range, pixels };
    Ok(Decoded { direction, view, links: planes.links.into_iter().map(Links::from_bits).collect() })
}

/// Reads a file as [`decode`] does, into planes of whole numbers: what a GPU takes.
///
/// # Errors
/// As [`decode`].
pub fn decode_planes(bytes: &[u8]) -> Result<DecodedPlanes, OrthoviewError> {
    let fault = |at: usize, found: String, expected| OrthoviewError::Header { at, found, expected };
    let Some(header) = bytes.get(..HEADER) else {
        return Err(fault(bytes.len(), "the end".to_owned(), "a header of 68 bytes"));
    };
    if &header[..4] != b"FSOV" {
        return Err(fault(0, format!("{:?}", String::from_utf8_lossy(&header[..4])), "\"FSOV\""));
    }
    if header[4] != VERSION {
        return Err(fault(4, format!("version {}", header[4]), "version 1"));
    }
    let format = match header[5] {
        0 => ImageFormat::Png,
        1 => ImageFormat::WebP,
        2 => ImageFormat::Jpeg,
        other => return Err(fault(5, format!("codec {other}"), "0, 1 or 2")),
    };
    let name = String::from_utf8_lossy(&header[8..11]).into_owned();
    let direction =
        Direction::from_name(&name).ok_or_else(|| fault(8, format!("{name:?}"), "a canonical direction"))?;
    let eight = |at: usize| <[u8; 8]>::try_from(&header[at..at + 8]).unwrap_or_default();
    let four = |at: usize| u32::from_le_bytes(<[u8; 4]>::try_from(&header[at..at + 4]).unwrap_or_default());
    let min = I64Vec2::new(i64::from_le_bytes(eight(12)), i64::from_le_bytes(eight(20)));
    let (width, height) = (four(28) as usize, four(32) as usize);
    if width == 0 || height == 0 || width > SIDE_MAX || height > SIDE_MAX {
        return Err(OrthoviewError::Size(width, height));
    }
    const FAR: i64 = 1 << 60;
    if min.cmplt(I64Vec2::splat(-FAR)).any() || min.cmpgt(I64Vec2::splat(FAR)).any() {
        return Err(fault(12, format!("pixel {min}"), "within 2⁶⁰"));
    }
    let (near, range) = (f64::from_le_bytes(eight(36)), f64::from_le_bytes(eight(44)));
    if !(near.is_finite() && range.is_finite() && range >= 0.0) {
        return Err(fault(36, format!("depths from {near} over {range}"), "finite metres"));
    }
    let mut at = HEADER;
    let mut plane = |index: usize, name| {
        let length = four(52 + 4 * index) as usize;
        let found = at.checked_add(length).and_then(|end| bytes.get(at..end));
        at = at.saturating_add(length);
        found.ok_or_else(|| fault(52 + 4 * index, format!("{name} of {length} bytes"), "planes within the file"))
    };
    let (colours, shape, normals) = (plane(0, "colours")?, plane(1, "the shape")?, plane(2, "normals")?);
    let size = (width as u32, height as u32);
    let colours = samples(colours, format, size, ColorType::Rgb8, "colours")?;
    let shape = samples(shape, ImageFormat::WebP, size, ColorType::Rgb8, "the shape")?;
    let normals = match header[6] {
        0 => None,
        _ => Some(samples(normals, ImageFormat::WebP, size, ColorType::Rgb8, "normals")?),
    };
    let normals =
        normals.map_or_else(Vec::new, |n| n.as_chunks::<3>().0.iter().flat_map(|&[x, y, _]| [x, y]).collect());
    let shape = shape.as_chunks::<3>().0;
    let codes: Vec<u16> = shape.iter().map(|&[low, high, _]| u16::from_le_bytes([low, high])).collect();
    let depths = restored(&codes, width);
    let links = shape.iter().map(|&[_, _, bits]| Links::from_bits(bits).bits()).collect();
    let rect = Rect { min, max: min + I64Vec2::new(width as i64, height as i64) };
    let planes = Planes { rect, colours, depths, links, normals };
    Ok(DecodedPlanes { direction, level: u32::from(header[7]), near, range, planes })
}

/// The samples of an image of the size and kind expected.
fn samples(
    bytes: &[u8],
    format: ImageFormat,
    size: (u32, u32),
    kind: ColorType,
    plane: &'static str,
) -> Result<Vec<u8>, OrthoviewError> {
    let fault = |fault: String| OrthoviewError::Plane { plane, fault };
    let mut reader = image::ImageReader::with_format(std::io::Cursor::new(bytes), format);
    let mut limits = image::Limits::default();
    (limits.max_image_width, limits.max_image_height) = (Some(size.0), Some(size.1));
    reader.limits(limits);
    let image = reader.decode().map_err(|error| fault(error.to_string()))?;
    if (image.width(), image.height()) != size || image.color() != kind {
        let found = format!("{} × {} of {:?}", image.width(), image.height(), image.color());
        return Err(fault(format!("{found}; expected {} × {} of {kind:?}", size.0, size.1)));
    }
    Ok(image.into_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::orthoview::connectivity::{Thresholds, links};
    use crate::orthoview::direction::nine;
    use crate::orthoview::image::Lattice;
    use glam::DVec3;
    use proptest::prelude::*;

    fn view(seed: u64, width: usize, height: usize) -> (Orthoview, Vec<Links>) {
        let rect =
            Rect { min: I64Vec2::new(-5, 1 << 40), max: I64Vec2::new(width as i64 - 5, (1 << 40) + height as i64) };
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / (1u64 << 24) as f32
        };
        let pixels = (0..rect.area())
            .map(|_| {
                if next() < 0.3 {
                    return Pixel::EMPTY;
                }
                let normal = DVec3::new(f64::from(next()) - 0.5, f64::from(next()) - 0.5, f64::from(next()) - 0.5);
                let normal = normal.normalize_or(DVec3::Z).to_array().map(|v| v as f32);
                Pixel { depth: next() * 100.0, colour: [next(), next(), next()], normal }
            })
            .collect();
        let view = Orthoview { level: 3, rect, near: -6.4e6, range: 100.0, pixels };
        let lattice = Lattice { direction: nine()[5], origin: DVec3::ZERO, pitch: 0.5 };
        let links = links(&view, &lattice, &Thresholds::default());
        (view, links)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn what_is_written_is_read_within_half_a_step(seed: u64, width in 1..20usize, height in 1..20usize) {
            let (view, links) = view(seed, width, height);
            let encoding = Encoding { colour: ColourCodec::WebpLossless, normals: true };
            let Some(file) = encode(&view, &links, nine()[5], encoding).expect("small") else {
                prop_assert!(view.is_empty());
                return Ok(());
            };
            let read = decode(&file).expect("just written");
            prop_assert_eq!((read.direction, read.view.level, read.view.near, read.view.range), (nine()[5], 3, -6.4e6, 100.0));
            for (index, pixel) in view.pixels.iter().enumerate() {
                let again = read.view.get(view.rect.at(index));
                prop_assert_eq!(pixel.is_some(), again.is_some());
                if pixel.is_some() {
                    prop_assert!(f64::from((pixel.depth - again.depth).abs()) <= depth_error(100.0) + 1e-5);
                    for axis in 0..3 {
                        prop_assert_eq!(encoded(pixel.colour[axis]), encoded(again.colour[axis]));
                        prop_assert!((pixel.normal[axis] - again.normal[axis]).abs() < 0.02);
                    }
                    let place = read.view.rect.index(view.rect.at(index)).expect("occupied");
                    prop_assert_eq!(read.links[place], links[index]);
                }
            }
        }

        #[test]
        fn no_bytes_make_it_panic(seed: u64, cut in 0..4000usize, flips in prop::collection::vec((0..4000usize, 0..8u32), 0..4)) {
            let (view, links) = view(seed, 8, 8);
            let encoding = Encoding { colour: ColourCodec::Jpeg(50), normals: seed % 2 == 0 };
            let mut file = encode(&view, &links, nine()[0], encoding).expect("small").unwrap_or_default();
            for (at, bit) in flips {
                if let Some(byte) = file.get_mut(at) {
                    *byte ^= 1 << bit;
                }
            }
            file.truncate(cut);
            drop(decode(&file));
        }
    }

    #[test]
    fn normals_lose_at_most_a_degree() {
        for i in 0..2000 {
            let (z, angle) = (1.0 - f64::from(i) / 1000.0, f64::from(i) * 2.4);
            let radius = (1.0 - z * z).max(0.0).sqrt();
            let normal = DVec3::new(radius * libm::cos(angle), radius * libm::sin(angle), z);
            let again = from_octahedral(octahedral(normal.to_array().map(|v| v as f32)));
            let cosine = DVec3::from_array(again.map(f64::from)).dot(normal);
            assert!(cosine > libm::cos(1f64.to_radians()), "{normal}");
        }
        assert_eq!(octahedral([f32::NAN; 3]), [128; 2]);
    }
}
