//! A finished cell on disk, so that an interrupted build goes on from there: its images to the bit, because what is made of
//! them has to be the same, and its node with the pages beneath.
//!
//! ```text
//! 0   "FSCC", version (u8), elements (u8), number of images (u8), has a node (u8)
//! 8   bytes of the node's page (u32), the page
//!     per image: is there (u8); level (u32), first and last column and row (i64 each), near, range (f64 each), a bit for each
//!     pixel, then depth, colour and normal (7 f32) of each that is set
//! end BLAKE3 over everything before (32 bytes)
//! ```

use super::page::{self, Node};
use crate::octree::Octree;
use crate::orthoview::{Orthoview, Pixel, Rect};
use glam::I64Vec2;

const VERSION: u8 = 1;
const HEADER: usize = 12;
const IMAGE: usize = 4 + 4 * 8 + 2 * 8;
const PIXEL: usize = 7 * 4;

/// A finished cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Finished {
    /// Its node; `None` if nothing is in it.
    pub node: Option<Node>,
    /// Its images, one a direction.
    pub images: Vec<Option<Orthoview>>,
}

/// Writes a finished cell.
pub fn encode(node: Option<&Node>, images: &[Option<Orthoview>], octree: &Octree, elements: u8) -> Vec<u8> {
    let page = node.map_or_else(Vec::new, |node| page::encode(node, octree, elements));
    let mut out = Vec::with_capacity(HEADER + page.len());
    out.extend_from_slice(b"FSCC");
    out.extend([VERSION, elements, images.len() as u8, u8::from(node.is_some())]);
    out.extend((page.len() as u32).to_le_bytes());
    out.extend(page);
    for image in images {
        let Some(image) = image else {
            out.push(0);
            continue;
        };
        out.push(1);
        out.extend(image.level.to_le_bytes());
        let Rect { min, max } = image.rect;
        [min.x, min.y, max.x, max.y].iter().for_each(|at| out.extend(at.to_le_bytes()));
        out.extend(image.near.to_le_bytes());
        out.extend(image.range.to_le_bytes());
        for eight in image.pixels.chunks(8) {
            out.push(eight.iter().enumerate().fold(0, |bits, (i, pixel)| bits | u8::from(pixel.is_some()) << i));
        }
        for pixel in image.pixels.iter().filter(|pixel| pixel.is_some()) {
            let values = [pixel.depth].into_iter().chain(pixel.colour).chain(pixel.normal);
            values.for_each(|value| out.extend(value.to_le_bytes()));
        }
    }
    let hash = blake3::hash(&out);
    out.extend_from_slice(hash.as_bytes());
    out
}

/// Reads a finished cell; `None` for what is damaged or cut off, which is then made again.
pub fn decode(bytes: &[u8], octree: &Octree) -> Option<Finished> {
    let (content, hash) = bytes.split_last_chunk::<32>()?;
    if blake3::hash(content).as_bytes() != hash || content.get(..5)? != [b'F', b'S', b'C', b'C', VERSION] {
        return None;
    }
    let (count, has_node) = (*content.get(6)?, *content.get(7)? == 1);
    let mut rest = content.get(8..)?;
    let length = u32::from_le_bytes(take(&mut rest)?) as usize;
    let (page, mut rest) = rest.split_at_checked(length)?;
    let node = if has_node { Some(page::parse(page, octree).ok()?) } else { None };
    let images = (0..count).map(|_| image(&mut rest)).collect::<Option<_>>()?;
    rest.is_empty().then_some(Finished { node, images })
}

fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (first, after) = rest.split_first_chunk::<N>()?;
    *rest = after;
    Some(*first)
}

fn image(rest: &mut &[u8]) -> Option<Option<Orthoview>> {
    if take(rest)? == [0] {
        return Some(None);
    }
    if rest.len() < IMAGE {
        return None;
    }
    let level = u32::from_le_bytes(take(rest)?);
    let mut at = || take(rest).map(i64::from_le_bytes);
    let rect = Rect { min: I64Vec2::new(at()?, at()?), max: I64Vec2::new(at()?, at()?) };
    let (near, range) = (f64::from_le_bytes(take(rest)?), f64::from_le_bytes(take(rest)?));
    let side = |a: i64, b: i64| b.checked_sub(a).and_then(|side| usize::try_from(side).ok());
    let area = side(rect.min.x, rect.max.x)?.checked_mul(side(rect.min.y, rect.max.y)?)?;
    let (bits, after) = rest.split_at_checked(area.div_ceil(8))?;
    let set: usize = bits.iter().map(|byte| byte.count_ones() as usize).sum();
    let (values, after) = after.split_at_checked(set.checked_mul(PIXEL)?)?;
    *rest = after;
    let mut values = values.chunks_exact(PIXEL);
    let pixel = |index: usize| -> Option<Pixel> {
        if bits[index / 8] >> (index % 8) & 1 == 0 {
            return Some(Pixel::EMPTY);
        }
        let mut seven = values.next()?;
        let mut next = || take(&mut seven).map(f32::from_le_bytes);
        let depth = next()?;
        let mut three = || Some([next()?, next()?, next()?]);
        Some(Pixel { depth, colour: three()?, normal: three()? })
    };
    let pixels = (0..area).map(pixel).collect::<Option<_>>()?;
    Some(Some(Orthoview { level, rect, near, range, pixels }))
}
