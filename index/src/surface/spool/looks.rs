//! Materials and images of a whole source, each once.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::{Arc, Mutex, PoisonError};

use super::block::MAX_MATERIALS;
use crate::orthoview::texture::{Material, Texture};
use crate::surface::Piece;

/// Bytes of decoded images that are kept for the leaves to come.
const KEPT: usize = 256 << 20;

/// Where an image lies in the file of images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Stored {
    pub(super) offset: u64,
    pub(super) length: u64,
}

/// The table as it fills.
#[derive(Default)]
pub(super) struct Looks {
    pub(super) materials: Vec<Material>,
    pub(super) images: Vec<Stored>,
    bytes: u64,
    known: BTreeMap<([u32; 4], Option<u32>), u32>,
    /// Images by their hash; `None` for those that cannot be drawn.
    hashes: BTreeMap<[u8; 32], Option<u32>>,
}

impl Looks {
    /// Takes what a piece looks like: its triangles get the table's materials. Images are appended to `file`.
    pub(super) fn take(
        &mut self,
        piece: &mut Piece,
        left_out: &mut dyn FnMut(String),
        file: &mut impl Write,
    ) -> io::Result<()> {
        let mut own: BTreeMap<u32, u32> = BTreeMap::new();
        for at in 0..piece.triangles.len() {
            let given = piece.triangles[at].material;
            let number = match own.get(&given) {
                Some(&number) => number,
                None => {
                    let number = self.material(piece, given, left_out, file)?;
                    own.insert(given, number);
                    number
                }
            };
            piece.triangles[at].material = number;
        }
        Ok(())
    }

    fn material(
        &mut self,
        piece: &Piece,
        given: u32,
        left_out: &mut dyn FnMut(String),
        file: &mut impl Write,
    ) -> io::Result<u32> {
        let look = piece.materials.get(given as usize).copied().unwrap_or_default();
        let image = look.texture.and_then(|texture| piece.images.get(texture)?.as_ref());
        let image = match image {
            Some(bytes) => self.image(bytes, left_out, file)?,
            None => None,
        };
        let [r, g, b] = look.base.map(f32::to_bits);
        let key = ([r, g, b, look.cutoff.to_bits()], image);
        if let Some(&number) = self.known.get(&key) {
            return Ok(number);
        }
        if self.materials.len() >= MAX_MATERIALS as usize {
            return Err(io::Error::other(format!("more than {MAX_MATERIALS} materials; expected at most that")));
        }
        let number = self.materials.len() as u32;
        self.materials.push(Material { texture: image.map(|image| image as usize), ..look });
        self.known.insert(key, number);
        Ok(number)
    }

    /// The number of an image, which is written if it is new.
    fn image(
        &mut self,
        bytes: &Arc<[u8]>,
        left_out: &mut dyn FnMut(String),
        file: &mut impl Write,
    ) -> io::Result<Option<u32>> {
        let hash = *blake3::hash(bytes).as_bytes();
        if let Some(&known) = self.hashes.get(&hash) {
            return Ok(known);
        }
        use image::ImageFormat::{Jpeg, Png, WebP};
        let number = if matches!(image::guess_format(bytes), Ok(Png | Jpeg | WebP)) {
            file.write_all(bytes)?;
            self.images.push(Stored { offset: self.bytes, length: bytes.len() as u64 });
            self.bytes += bytes.len() as u64;
            Some(self.images.len() as u32 - 1)
        } else {
            left_out("an image that is no PNG, JPEG or WebP: its materials have their base colour".to_owned());
            None
        };
        self.hashes.insert(hash, number);
        Ok(number)
    }
}

/// Decoded images, those that were used last.
#[derive(Default)]
pub(super) struct Decoded(Mutex<Kept>);

#[derive(Default)]
struct Kept {
    /// By number: when it was used last, and what it is; absent if it cannot be decoded.
    images: BTreeMap<u32, (u64, Option<Arc<Texture>>)>,
    bytes: usize,
    uses: u64,
}

impl Decoded {
    /// The image of a number, decoded by `decode` if it is not kept.
    pub(super) fn get(
        &self,
        number: u32,
        decode: impl FnOnce() -> io::Result<Option<Arc<Texture>>>,
    ) -> io::Result<Option<Arc<Texture>>> {
        {
            let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            kept.uses += 1;
            let now = kept.uses;
            if let Some((used, image)) = kept.images.get_mut(&number) {
                *used = now;
                return Ok(image.clone());
            }
        }
        let image = decode()?;
        let size = |image: &Option<Arc<Texture>>| image.as_ref().map_or(64, |image| image.bytes());
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let now = kept.uses;
        if kept.images.insert(number, (now, image.clone())).is_none() {
            kept.bytes += size(&image);
        }
        while kept.bytes > KEPT && kept.images.len() > 1 {
            let oldest = kept.images.iter().min_by_key(|(_, (used, _))| *used).map(|(&number, _)| number);
            let Some((_, dropped)) = oldest.and_then(|number| kept.images.remove(&number)) else { break };
            kept.bytes -= size(&dropped);
        }
        Ok(image)
    }
}
