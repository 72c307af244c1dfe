//! Block-compressed planes, 4 × 4 pixels a block: made where contents are decoded, so that an upload copies and no more.

use super::content::{Content, SplatImage, Texels, TextureImage};
use block_compression::encode::compress_rgba8;
use block_compression::{BC7Settings, CompressionVariant};
use std::sync::Arc;

/// How orthoviews and textures are kept. Depths and links are kept as they are, 2 bytes a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// Colours in 4 bytes a pixel, normals in 2.
    #[default]
    None,
    /// Colours in BC1 blocks, half a byte a pixel, textures with holes in BC3 blocks, a byte; normals in BC5 blocks, a byte.
    Small,
    /// Colours in BC7 blocks, a byte a pixel; normals in BC5 blocks, a byte.
    Fine,
}

impl Compression {
    /// All, from the largest to the smallest.
    pub const ALL: [Compression; 3] = [Compression::None, Compression::Fine, Compression::Small];

    /// Its name in tables and arguments.
    pub fn name(self) -> &'static str {
        match self {
            Compression::None => "none",
            Compression::Small => "small",
            Compression::Fine => "fine",
        }
    }
}

impl Content {
    /// The content with its planes compressed. What is compressed already, or is not as large as it says, stays as it is.
    pub fn compressed(mut self, compression: Compression) -> Content {
        match &mut self {
            _ if compression == Compression::None => {}
            Content::Splats(image) => splats(image, compression),
            Content::Mesh(mesh) => mesh.textures.iter_mut().for_each(|texture| texture_levels(texture, compression)),
            Content::Empty => {}
        }
        self
    }
}

/// Colours: BC1 or BC7; normals, where there are any: BC5.
fn splats(image: &mut SplatImage, compression: Compression) {
    let is_plain =
        |kept, data: &[u8], each| kept == Texels::Plain && data.len() as u64 == Texels::Plain.bytes(image.size, each);
    if is_plain(image.colours_kept, &image.colours, 4) {
        let (kept, variant) = opaque(compression);
        let colours = &image.colours;
        let blocks = blocks(variant, image.size, |at| core::array::from_fn(|i| colours[4 * at + i]));
        (image.colours, image.colours_kept) = (blocks, kept);
    }
    if !image.normals.is_empty() && is_plain(image.normals_kept, &image.normals, 2) {
        let normals = &image.normals;
        let blocks = blocks(CompressionVariant::BC5, image.size, |at| [normals[2 * at], normals[2 * at + 1], 0, 255]);
        (image.normals, image.normals_kept) = (blocks, Texels::Bc5);
    }
}

/// A texture's levels one after the other: BC1, or BC3 where something is not opaque, or BC7. Sides that are no multiples of
/// 4 stay as they are: no texture of blocks may have them.
fn texture_levels(texture: &mut Arc<TextureImage>, compression: Compression) {
    let image = &**texture;
    let is_whole = image.levels().map(|(_, texels)| texels.len()).sum::<usize>() == image.texels.len();
    if image.kept != Texels::Plain || !is_whole || image.size.iter().any(|side| !side.is_multiple_of(4)) {
        return;
    }
    let is_opaque = image.texels.as_chunks::<4>().0.iter().all(|texel| texel[3] == 255);
    let (kept, variant) = match (compression, is_opaque) {
        (_, true) => opaque(compression),
        (Compression::Fine, false) => (Texels::Bc7, CompressionVariant::BC7(BC7Settings::alpha_ultrafast())),
        (_, false) => (Texels::Bc3, CompressionVariant::BC3),
    };
    let level =
        |(size, texels): ([u32; 2], &[u8])| blocks(variant, size, |at| core::array::from_fn(|i| texels[4 * at + i]));
    let texels = image.levels().flat_map(level).collect();
    *texture = Arc::new(TextureImage { size: image.size, texels, kept });
}

/// For what has no holes.
fn opaque(compression: Compression) -> (Texels, CompressionVariant) {
    match compression {
        Compression::Fine => (Texels::Bc7, CompressionVariant::BC7(BC7Settings::opaque_ultra_fast())),
        _ => (Texels::Bc1, CompressionVariant::BC1),
    }
}

/// Compresses an image, its last column and row repeated to whole blocks.
fn blocks(variant: CompressionVariant, [width, height]: [u32; 2], pixel: impl Fn(usize) -> [u8; 4]) -> Vec<u8> {
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
    data
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
            colours_kept: Texels::Plain,
            normals_kept: Texels::Plain,
            bounds: Aabb { min: DVec3::ZERO, max: DVec3::ONE },
        }
    }

    #[test]
    fn blocks_hold_a_gradient_within_a_few_steps() {
        let image = image();
        let normals_rgba: Vec<u8> =
            image.normals.as_chunks::<2>().0.iter().flat_map(|&[x, y]| [x, y, 0, 255]).collect();
        let compressed = |compression| match Content::Splats(image.clone()).compressed(compression) {
            Content::Splats(image) => image,
            other => panic!("{other:?}"),
        };
        let (small, fine) = (compressed(Compression::Small), compressed(Compression::Fine));
        assert_eq!(
            (small.colours_kept, fine.colours_kept, small.normals_kept),
            (Texels::Bc1, Texels::Bc7, Texels::Bc5)
        );
        assert_eq!(fine.normals, small.normals);
        // Compressed once, whatever is asked for then.
        assert_eq!(Content::Splats(small.clone()).compressed(Compression::Fine).bytes(), 64 + 2 * 91 + 128);
        let fine_blocks = CompressionVariant::BC7(BC7Settings::opaque_ultra_fast());
        let cases = [
            (&small.colours, CompressionVariant::BC1, &image.colours, 3, 14, 64),
            (&fine.colours, fine_blocks, &image.colours, 3, 6, 128),
            (&small.normals, CompressionVariant::BC5, &normals_rgba, 2, 4, 128),
        ];
        for (data, variant, source, channels, most, bytes) in cases {
            assert_eq!(data.len(), bytes);
            let mut decoded = vec![0; 16 * 8 * 4];
            decompress_blocks_as_rgba8(variant, 16, 8, data, &mut decoded);
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
            (&opaque, Compression::Small, 7 * 8),
            (&holed, Compression::Small, 7 * 16),
            (&opaque, Compression::Fine, 7 * 16),
            (&holed, Compression::Fine, 7 * 16),
        ] {
            let mut texture = Arc::new(image.clone());
            texture_levels(&mut texture, compression);
            assert_eq!(texture.texels.len(), bytes, "{compression:?}");
            assert_eq!(texture.levels().map(|(_, blocks)| blocks.len()).sum::<usize>(), bytes);
            if compression == Compression::Small && bytes == 7 * 16 {
                let mut decoded = vec![0; 256];
                decompress_blocks_as_rgba8(CompressionVariant::BC3, 8, 8, &texture.texels[..64], &mut decoded);
                assert!(
                    decoded.as_chunks::<4>().0.iter().enumerate().all(|(i, t)| t[3] == if i % 8 < 4 { 0 } else { 255 })
                );
            }
        }
        // Sides that are no multiples of 4, and a texture cut off.
        for (image, bytes) in [
            (TextureImage::with_mips([6, 4], vec![255; 96]), 4 * (24 + 6 + 1)),
            (TextureImage { size: [4, 4], texels: vec![0; 63], kept: Texels::Plain }, 63),
        ] {
            let mut texture = Arc::new(image);
            texture_levels(&mut texture, Compression::Fine);
            assert_eq!((texture.kept, texture.texels.len()), (Texels::Plain, bytes));
        }
    }

    #[test]
    fn what_is_not_there_or_cut_off_stays_as_it_is() {
        let bare = SplatImage { normals: Vec::new(), ..image() };
        let mut cut = image();
        cut.colours.pop();
        for (image, kept, bytes) in [(bare, Texels::Bc7, 128), (cut, Texels::Plain, 4 * 91 - 1)] {
            let normals = image.normals.len();
            let Content::Splats(image) = Content::Splats(image).compressed(Compression::Fine) else { panic!("splats") };
            assert_eq!((image.colours_kept, image.colours.len()), (kept, bytes));
            assert_eq!(image.normals.is_empty(), normals == 0);
        }
    }
}
