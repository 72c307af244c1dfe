//! NumPy arrays of numbers (`.npy`, format versions 1 to 3): little-endian floats of 4 or 8 bytes in C order, of one or
//! two dimensions.

/// First bytes of every such file.
pub(super) const MAGIC: &[u8] = b"\x93NUMPY";

/// Longest header accepted, bytes.
const HEADER_BYTES_MAX: usize = 1 << 16;

/// Rows of numbers.
#[derive(Debug, PartialEq)]
pub(super) struct Array {
    pub(super) columns: usize,
    pub(super) values: Vec<f64>,
}

/// Reads an array. The error says at which byte, what was found and what was expected.
pub(super) fn parse(bytes: &[u8]) -> Result<Array, String> {
    if !bytes.starts_with(MAGIC) {
        return Err("byte 0: no NumPy array; expected \\x93NUMPY".to_owned());
    }
    let (start, length) = match bytes.get(6..12) {
        Some([1, _, a, b, ..]) => (10, usize::from(u16::from_le_bytes([*a, *b]))),
        Some([2 | 3, _, a, b, c, d]) => (12, u32::from_le_bytes([*a, *b, *c, *d]) as usize),
        Some([version, ..]) => return Err(format!("byte 6: format version {version}; expected 1, 2 or 3")),
        _ => return Err(format!("byte {}: ends within the header; expected its length", bytes.len())),
    };
    if length > HEADER_BYTES_MAX {
        return Err(format!("byte 8: a header of {length} bytes; expected at most {HEADER_BYTES_MAX}"));
    }
    let header = bytes.get(start..start + length).and_then(|header| std::str::from_utf8(header).ok());
    let header = header.ok_or_else(|| format!("byte {start}: no header of {length} bytes of text; expected one"))?;
    let field = |key: &str| {
        let missing = || format!("byte {start}: a header without '{key}'; expected one");
        let at = header.find(&format!("'{key}'")).ok_or_else(missing)?;
        let rest = header[at + key.len() + 2..].trim_start();
        rest.strip_prefix(':').map(str::trim_start).ok_or_else(missing)
    };
    let kind = field("descr")?;
    let width = match kind {
        _ if kind.starts_with("'<f8'") => 8,
        _ if kind.starts_with("'<f4'") => 4,
        _ => {
            let found: String = kind.chars().take(12).collect();
            return Err(format!("byte {start}: elements of type {found}; expected '<f8' or '<f4'"));
        }
    };
    if !field("fortran_order")?.starts_with("False") {
        return Err(format!("byte {start}: Fortran order; expected 'fortran_order': False"));
    }
    let shape = field("shape")?;
    let inner = shape.strip_prefix('(').and_then(|rest| rest.split_once(')')).map(|(inner, _)| inner);
    let expected = || {
        let found: String = shape.chars().take(20).collect();
        format!("byte {start}: shape {found}; expected (rows,) or (rows, columns)")
    };
    let sides: Option<Vec<usize>> = inner
        .ok_or_else(expected)?
        .split(',')
        .map(str::trim)
        .filter(|side| !side.is_empty())
        .take(3)
        .map(|side| side.parse().ok())
        .collect();
    let (rows, columns) = match sides.as_deref() {
        Some([rows]) => (*rows, 1),
        Some([rows, columns]) => (*rows, *columns),
        _ => return Err(expected()),
    };
    let data = &bytes[start + length..];
    let count = rows.checked_mul(columns).filter(|count| count.checked_mul(width) == Some(data.len()));
    let Some(count) = count else {
        let at = start + length;
        return Err(format!("byte {at}: {} bytes of data; expected {rows} × {columns} × {width}", data.len()));
    };
    let mut values = Vec::with_capacity(count);
    if width == 8 {
        values.extend(data.as_chunks::<8>().0.iter().map(|chunk| f64::from_le_bytes(*chunk)));
    } else {
        values.extend(data.as_chunks::<4>().0.iter().map(|chunk| f64::from(f32::from_le_bytes(*chunk))));
    }
    Ok(Array { columns, values })
}
