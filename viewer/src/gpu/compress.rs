//! Block-compressed planes: 4 × 4 pixels a block.

use super::settings::Compression;
use crate::scene::content::{SplatImage, TextureImage};
use block_compression::encode::compress_rgba8;
use block_compression::{BC7Settings, CompressionVariant};
use std::borrow::Cow;

/// A plane as a texture takes it.
pub(crate) struct Plane<'a> {
    pub(crate) format: wgpu::TextureFormat,
    pub(crate) size: [u32; 2],
    pub(crate) data: Cow<'a, [u8]>,
}

/// The colours: BC1 (half a byte a pixel) or BC7 (a byte) where compressed, else four bytes.
pub(crate) fn colours(image: &SplatImage, compression: Compression) -> Plane<'_> {
    let (format, variant) = match compression {
        Compression::None => {
            let format = wgpu::TextureFormat::Rgba8UnormSrgb;
            return Plane { format, size: image.size, data: Cow::Borrowed(&image.colours) };
        }
        Compression::Small => (wgpu::TextureFormat::Bc1RgbaUnormSrgb, CompressionVariant::BC1),
        Compression::Fine => {
            let settings = BC7Settings::opaque_ultra_fast();
            (wgpu::TextureFormat::Bc7RgbaUnormSrgb, CompressionVariant::BC7(settings))
        }
    };
    blocks(format, variant, image.size, |at| core::array::from_fn(|i| image.colours[4 * at + i]))
}

/// The normals: BC5 (a byte a pixel) where compressed, else two bytes; one pixel where there are none.
pub(crate) fn normals(image: &SplatImage, compression: Compression) -> Plane<'_> {
    let format = wgpu::TextureFormat::Rg8Unorm;
    match (image.normals.as_slice(), compression) {
        ([], _) => Plane { format, size: [1, 1], data: Cow::Borrowed(&[128, 128]) },
        (normals, Compression::None) => Plane { format, size: image.size, data: Cow::Borrowed(normals) },
        (normals, _) => blocks(wgpu::TextureFormat::Bc5RgUnorm, CompressionVariant::BC5, image.size, |at| {
            [normals[2 * at], normals[2 * at + 1], 0, 255]
        }),
    }
}

/// A texture's levels one after the other: BC1, or BC3 where something is not opaque (half a byte and a byte a texel), or BC7 (a byte)
/// where compressed. Sides that are no multiples of 4 stay as they are.
pub(crate) fn levels(image: &TextureImage, compression: Compression) -> Plane<'_> {
    let length = image.levels().map(|(_, texels)| texels.len()).sum();
    let is_opaque = image.texels.as_chunks::<4>().0.iter().all(|texel| texel[3] == 255);
    let (format, variant) = match (compression, is_opaque) {
        _ if image.size.iter().any(|side| !side.is_multiple_of(4)) => {
            return Plane { data: Cow::Borrowed(&image.texels[..length]), ..plain(image.size) };
        }
        (Compression::None, _) => return Plane { data: Cow::Borrowed(&image.texels[..length]), ..plain(image.size) },
        (Compression::Small, true) => (wgpu::TextureFormat::Bc1RgbaUnormSrgb, CompressionVariant::BC1),
        (Compression::Small, false) => (wgpu::TextureFormat::Bc3RgbaUnormSrgb, CompressionVariant::BC3),
        (Compression::Fine, is_opaque) => {
            let settings = if is_opaque { BC7Settings::opaque_ultra_fast() } else { BC7Settings::alpha_ultrafast() };
            (wgpu::TextureFormat::Bc7RgbaUnormSrgb, CompressionVariant::BC7(settings))
        }
    };
    let mut data = Vec::new();
    for (size, texels) in image.levels() {
        let level = blocks(format, variant, size, |at| core::array::from_fn(|i| texels[4 * at + i]));
        data.extend_from_slice(&level.data);
    }
    Plane { format, size: image.size, data: Cow::Owned(data) }
}

/// Four bytes a texel, none yet.
fn plain(size: [u32; 2]) -> Plane<'static> {
    Plane { format: wgpu::TextureFormat::Rgba8UnormSrgb, size, data: Cow::Borrowed(&[]) }
}

/// Compresses an image, its last column and row repeated to whole blocks.
fn blocks(
    format: wgpu::TextureFormat,
    variant: CompressionVariant,
    [width, height]: [u32; 2],
    pixel: impl Fn(usize) -> [u8; 4],
) -> Plane<'static> {
    let size = [width, height].map(|side| side.next_multiple_of(4));
    let mut rgba = Vec::with_capacity(4 * size[0] as usize * size[1] as usize);
    for row in 0..size[1] {
        for column in 0..size[0] {
            let at = row.min(height - 1) as usize * width as usize + column.min(width - 1) as usize;
            rgba.extend(pixel(at));
        }
    }
    let mut data = vec![0; variant.blocks_byte_size(size[0], size[1])];
    compress_rgba8(variant, &rgba, &mut data, size[0], size[1], 4 * size[0]);
    Plane { format, size, data: Cow::Owned(data) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use block_compression::decode::decompress_blocks_as_rgba8;
    use foresight_index::orthoview::direction::nine;
    use foresight_scheduler::lod_tree::Aabb;
    use glam::DVec3;

    /// A gradient of 13 × 7 pixels, so that the last blocks are not whole. Its colours lie on a line, as those of a BC1 block do.
    fn image() -> SplatImage {
        let at: Vec<_> = (0..7u8).flat_map(|row| (0..13u8).map(move |column| [column, row])).collect();
        SplatImage {
            direction: nine()[0],
            origin: DVec3::ZERO,
            right: DVec3::X,
            up: DVec3::Y,
            towards_eye: DVec3::Z,
            pixel: 1.0,
            range: 1.0,
            size: [13, 7],
            colours: at
                .iter()
                .flat_map(|&[column, row]| [60 + 8 * (column + row), 40 + 6 * (column + row), 40, 255])
                .collect(),
            shapes: vec![0x8000; 91],
            normals: at.iter().flat_map(|&[column, row]| [128 + 4 * column, 128 - 6 * row]).collect(),
            bounds: Aabb { min: DVec3::ZERO, max: DVec3::ONE },
        }
    }

    #[test]
    fn blocks_hold_a_gradient_within_a_few_steps() {
        let image = image();
        let normals_rgba: Vec<u8> =
            image.normals.as_chunks::<2>().0.iter().flat_map(|&[x, y]| [x, y, 0, 255]).collect();
        let cases = [
            (colours(&image, Compression::Small), CompressionVariant::BC1, &image.colours, 3, 14, 64),
            (
                colours(&image, Compression::Fine),
                CompressionVariant::BC7(BC7Settings::opaque_ultra_fast()),
                &image.colours,
                3,
                6,
                128,
            ),
            (normals(&image, Compression::Small), CompressionVariant::BC5, &normals_rgba, 2, 4, 128),
        ];
        for (plane, variant, source, channels, most, bytes) in cases {
            assert_eq!((plane.size, plane.data.len()), ([16, 8], bytes));
            let mut decoded = vec![0; 16 * 8 * 4];
            decompress_blocks_as_rgba8(variant, 16, 8, &plane.data, &mut decoded);
            for row in 0..7 {
                for column in 0..13 {
                    for channel in 0..channels {
                        let found = decoded[4 * (16 * row + column) + channel];
                        let expected = source[4 * (13 * row + column) + channel];
                        assert!(found.abs_diff(expected) <= most, "{variant:?} {column} {row}: {found} for {expected}");
                    }
                }
            }
        }
    }

    #[test]
    fn textures_keep_their_mips_and_their_holes() {
        let texels = |alpha: fn(u32) -> u8| {
            let at = (0..64u32).flat_map(|i| [200, (3 * i) as u8, 90, alpha(i)]).collect();
            TextureImage::with_mips([8, 8], at)
        };
        let (opaque, holed) = (texels(|_| 255), texels(|i| if i % 8 < 4 { 0 } else { 255 }));
        // 8 × 8, 4 × 4, 2 × 2 and 1 × 1 texels are 4 + 1 + 1 + 1 blocks.
        for (image, compression, bytes) in [
            (&opaque, Compression::None, 4 * (64 + 16 + 4 + 1)),
            (&opaque, Compression::Small, 7 * 8),
            (&holed, Compression::Small, 7 * 16),
            (&opaque, Compression::Fine, 7 * 16),
            (&holed, Compression::Fine, 7 * 16),
        ] {
            let plane = levels(image, compression);
            assert_eq!(plane.data.len(), bytes, "{compression:?}");
            if compression == Compression::Small && bytes == 7 * 16 {
                let mut decoded = vec![0; 256];
                decompress_blocks_as_rgba8(CompressionVariant::BC3, 8, 8, &plane.data[..64], &mut decoded);
                assert!(
                    decoded.as_chunks::<4>().0.iter().enumerate().all(|(i, t)| t[3] == if i % 8 < 4 { 0 } else { 255 })
                );
            }
        }
        let odd = TextureImage::with_mips([6, 4], vec![255; 96]);
        assert_eq!(levels(&odd, Compression::Fine).format, wgpu::TextureFormat::Rgba8UnormSrgb);
    }

    #[test]
    fn without_normals_there_is_one_pixel() {
        let image = SplatImage { normals: Vec::new(), ..image() };
        assert_eq!(normals(&image, Compression::Fine).size, [1, 1]);
        assert_eq!(normals(&image, Compression::None).data.len(), 2);
    }
}
