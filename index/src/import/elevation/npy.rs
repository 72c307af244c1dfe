//! One numpy array (`.npy`, versions 1 to 3). Its header is a Python dictionary; only the three members that numpy writes
//! are read, so nothing nests and nothing is evaluated.

use super::GridError;
use crate::terrain::MAX_SAMPLES;

/// Longest header read, bytes: numpy's own limit.
const MAX_HEADER: usize = 10_000;

/// An array of numbers of at most two dimensions.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Array {
    /// Rows and columns; empty for a single number.
    pub(super) shape: Vec<u32>,
    /// Row by row.
    pub(super) values: Vec<f64>,
}

/// Bytes of the largest array read, its header counted.
pub(super) const MAX_BYTES: u64 = MAX_SAMPLES * 8 + MAX_HEADER as u64;

/// Reads an array.
pub(super) fn parse(name: &str, bytes: &[u8]) -> Result<Array, GridError> {
    let fault = |at: usize, text: String| Err(GridError::new(format!("{name}, byte {at}"), text));
    if bytes.get(..6) != Some(b"\x93NUMPY") {
        return fault(0, "no \"\\x93NUMPY\"; expected a numpy array".to_owned());
    }
    let header = match (bytes.get(6..8), bytes.get(8..12)) {
        (Some([1, _]), Some([a, b, _, _])) => Some((10, usize::from(u16::from_le_bytes([*a, *b])))),
        (Some([2 | 3, _]), Some(word)) => word.try_into().ok().map(|word| (12, u32::from_le_bytes(word) as usize)),
        (Some([version, _]), _) => return fault(6, format!("version {version}; expected 1, 2 or 3")),
        _ => None,
    };
    let Some((start, length)) = header else { return fault(bytes.len(), "the end; expected a header".to_owned()) };
    if length > MAX_HEADER {
        return fault(8, format!("a header of {length} bytes; expected at most {MAX_HEADER}"));
    }
    let Some(text) = bytes.get(start..start + length).and_then(|text| std::str::from_utf8(text).ok()) else {
        return fault(start, format!("expected a header of {length} bytes of text"));
    };
    let member = |key: &str| {
        let found = text.split_once(&format!("'{key}':")).map(|(_, rest)| rest.trim_start());
        found.ok_or_else(|| {
            GridError::new(format!("{name}, byte {start}"), format!("no '{key}'; expected a numpy header"))
        })
    };
    let descr = member("descr")?;
    let Some(descr) = descr.strip_prefix('\'').and_then(|rest| rest.split('\'').next()) else {
        return fault(start, "a structured type; expected one number per element".to_owned());
    };
    let fortran = member("fortran_order")?.starts_with("True");
    let shape = member("shape")?.strip_prefix('(').and_then(|rest| rest.split(')').next());
    let sides = shape.unwrap_or("?").split(',').map(str::trim).filter(|side| !side.is_empty());
    let shape: Option<Vec<u32>> = sides.map(|side| side.parse().ok()).collect();
    let Some(shape) = shape.filter(|shape| shape.len() <= 2) else {
        return fault(
            start,
            "a shape of other than whole numbers or more than two; expected rows and columns".to_owned(),
        );
    };
    let count = shape.iter().fold(1_u64, |count, &side| count.saturating_mul(u64::from(side)));
    if count > MAX_SAMPLES {
        return fault(start, format!("{count} elements; expected at most {MAX_SAMPLES}"));
    }
    let Some(kind) = Kind::of(descr) else {
        return fault(start, format!("elements of type {descr:?}; expected integers or floats of up to 8 bytes"));
    };
    let data = &bytes[start + length..];
    if (data.len() as u64) < count * kind.bytes as u64 {
        return fault(bytes.len(), format!("the end; expected {count} elements of {} bytes", kind.bytes));
    }
    let values: Vec<f64> = data.chunks_exact(kind.bytes).take(count as usize).map(|bytes| kind.read(bytes)).collect();
    let values = match shape[..] {
        [rows, columns] if fortran => {
            let (rows, columns) = (rows as usize, columns as usize);
            (0..rows).flat_map(|row| (0..columns).map(move |column| column * rows + row)).map(|at| values[at]).collect()
        }
        _ => values,
    };
    Ok(Array { shape, values })
}

/// How an element is stored.
#[derive(Clone, Copy)]
struct Kind {
    big_endian: bool,
    /// `i`, `u`, `f` or `b`.
    class: char,
    bytes: usize,
}

impl Kind {
    fn of(descr: &str) -> Option<Kind> {
        let mut letters = descr.chars();
        let order = letters.next()?;
        let class = letters.next()?;
        let bytes = letters.as_str().parse().ok()?;
        let known = matches!((class, bytes), ('i' | 'u', 1 | 2 | 4 | 8) | ('f', 4 | 8) | ('b', 1));
        (matches!(order, '<' | '>' | '|' | '=') && known).then_some(Kind { big_endian: order == '>', class, bytes })
    }

    /// One element of exactly the type's bytes. 64-bit integers are rounded to 53 bits.
    fn read(self, stored: &[u8]) -> f64 {
        let mut word = [0; 8];
        for (to, from) in word.iter_mut().zip(0..self.bytes) {
            *to = stored[if self.big_endian { self.bytes - 1 - from } else { from }];
        }
        let bits = u64::from_le_bytes(word);
        match (self.class, self.bytes) {
            ('f', 4) => f64::from(f32::from_bits(bits as u32)),
            ('f', _) => f64::from_bits(bits),
            ('i', bytes) => {
                let unused = 64 - 8 * bytes as u32;
                ((bits << unused) as i64 >> unused) as f64
            }
            _ => bits as f64,
        }
    }
}
