//! `EXT_meshopt_compression` and `KHR_meshopt_compression`: views whose bytes are packed.

use gltf::json::buffer::View;
use meshopt::{
    decode_filter_color, decode_filter_exp, decode_filter_oct, decode_filter_quat, decode_index_buffer,
    decode_index_sequence, decode_vertex_buffer,
};
use serde::Deserialize;

/// A packed vertex is at least this many times smaller at most: a control byte stands for 4 bytes of 256 vertices.
const MOST_UNFOLDED: u64 = 1024;

/// What a view says of its packed bytes.
#[derive(Debug, Deserialize)]
pub(super) struct Packed {
    pub(super) buffer: usize,
    #[serde(rename = "byteOffset", default)]
    pub(super) offset: u64,
    #[serde(rename = "byteLength")]
    pub(super) length: u64,
    #[serde(rename = "byteStride")]
    stride: u64,
    count: u64,
    mode: String,
    #[serde(default)]
    filter: Option<String>,
}

/// How a view is packed, if it is.
pub(super) fn of(view: &View) -> Option<Result<Packed, String>> {
    let others = &view.extensions.as_ref()?.others;
    let given = ["EXT_meshopt_compression", "KHR_meshopt_compression"].into_iter().find_map(|name| others.get(name))?;
    Some(Packed::deserialize(given).map_err(|error| format!("{error}; expected a packed view")))
}

/// A vertex of 4 N bytes.
#[derive(Clone, Copy)]
struct Words<const N: usize>([u32; N]);

impl<const N: usize> Default for Words<N> {
    fn default() -> Words<N> {
        Words([0; N])
    }
}

fn vertices<const N: usize>(bytes: &[u8], count: usize) -> Result<Vec<u8>, meshopt::Error> {
    let words = decode_vertex_buffer::<Words<N>>(bytes, count)?;
    // Words in memory hold the bytes in their order.
    Ok(words.iter().flat_map(|vertex| vertex.0).flat_map(u32::to_ne_bytes).collect())
}

/// Calls `vertices` for a stride of 4 × one of the numbers.
macro_rules! by_stride {
    ($stride:expr, $bytes:expr, $count:expr, $($words:literal)*) => {
        match $stride {
            $(stride if stride == 4 * $words => vertices::<$words>($bytes, $count),)*
            stride => return Err(format!("a stride of {stride} bytes; expected a multiple of 4 from 4 to 256")),
        }
    };
}

impl Packed {
    /// The plain bytes: count × stride of them.
    pub(super) fn decode(&self, bytes: &[u8]) -> Result<Vec<u8>, String> {
        let length = bytes.len() as u64;
        let most = if self.mode == "ATTRIBUTES" { length.saturating_mul(MOST_UNFOLDED) } else { 12 * length };
        let unfolded = self.count.checked_mul(self.stride).filter(|&unfolded| unfolded <= most);
        if unfolded.is_none() || self.stride == 0 {
            let Packed { count, stride, .. } = self;
            return Err(format!("{count} × {stride} bytes in {length}; expected at most {most}"));
        }
        let count = usize::try_from(self.count).map_err(|error| error.to_string())?;
        let fault = |error: meshopt::Error| format!("{error}; expected meshopt's codec");
        match (self.mode.as_str(), self.stride) {
            ("ATTRIBUTES", stride) => {
                let plain = by_stride!(stride, bytes, count, 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22
                    23 24 25 26 27 28 29 30 31 32 33 34 35 36 37 38 39 40 41 42 43 44 45 46 47 48 49 50 51 52 53 54 55 56
                    57 58 59 60 61 62 63 64);
                self.unfiltered(plain.map_err(fault)?)
            }
            ("TRIANGLES", 2) if count.is_multiple_of(3) => {
                let plain = decode_index_buffer::<u16>(bytes, count).map_err(fault)?;
                Ok(plain.into_iter().flat_map(u16::to_le_bytes).collect())
            }
            ("TRIANGLES", 4) if count.is_multiple_of(3) => {
                let plain = decode_index_buffer::<u32>(bytes, count).map_err(fault)?;
                Ok(plain.into_iter().flat_map(u32::to_le_bytes).collect())
            }
            ("INDICES", 2) => {
                let plain = decode_index_sequence::<u16>(bytes, count).map_err(fault)?;
                Ok(plain.into_iter().flat_map(u16::to_le_bytes).collect())
            }
            ("INDICES", 4) => {
                let plain = decode_index_sequence::<u32>(bytes, count).map_err(fault)?;
                Ok(plain.into_iter().flat_map(u32::to_le_bytes).collect())
            }
            (mode, stride) => Err(format!(
                "mode {mode:?}, {count} elements of {stride} bytes; expected ATTRIBUTES, or TRIANGLES or INDICES of 2 or 4 bytes"
            )),
        }
    }

    /// Undoes the filter over a view's vertices.
    fn unfiltered(&self, bytes: Vec<u8>) -> Result<Vec<u8>, String> {
        match (self.filter.as_deref().unwrap_or("NONE"), self.stride) {
            ("NONE", _) => Ok(bytes),
            ("OCTAHEDRAL", 4) => Ok(filtered(&bytes, u8::from_le_bytes, u8::to_le_bytes, decode_filter_oct)),
            ("OCTAHEDRAL", 8) => Ok(filtered(&bytes, u16::from_le_bytes, u16::to_le_bytes, decode_filter_oct)),
            ("QUATERNION", 8) => Ok(filtered(&bytes, i16::from_le_bytes, i16::to_le_bytes, decode_filter_quat)),
            ("COLOR", 4) => Ok(filtered(&bytes, u8::from_le_bytes, u8::to_le_bytes, decode_filter_color)),
            ("COLOR", 8) => Ok(filtered(&bytes, u16::from_le_bytes, u16::to_le_bytes, decode_filter_color)),
            ("EXPONENTIAL", _) => {
                Ok(filtered::<u32, 4, 1>(&bytes, u32::from_le_bytes, u32::to_le_bytes, decode_filter_exp))
            }
            (filter, stride) => Err(format!("filter {filter:?} over {stride} bytes; expected one that is known")),
        }
    }
}

/// Applies a filter to groups of N numbers of B bytes.
fn filtered<T: Copy + Default, const B: usize, const N: usize>(
    bytes: &[u8],
    from: impl Fn([u8; B]) -> T,
    to: impl Fn(T) -> [u8; B],
    filter: impl Fn(&mut [[T; N]]),
) -> Vec<u8> {
    let number = |bytes: &[u8]| bytes.try_into().map_or_else(|_| T::default(), &from);
    let group = |bytes: &[u8]| std::array::from_fn(|at| number(&bytes[at * B..(at + 1) * B]));
    let mut groups: Vec<[T; N]> = bytes.chunks_exact(B * N).map(group).collect();
    filter(&mut groups);
    groups.into_iter().flatten().flat_map(to).collect()
}
