//! The numbers behind the header of a PLY file, whatever way they are written.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::super::inputs::{fault, unreadable};
use super::super::lines::Lines;
use super::header::{Element, Format, Kind, Property};
use crate::import::tiles3d::ContentError;

/// Most items of a list.
const MAX_ITEMS: u64 = 1 << 28;

/// Reads one element after the other.
pub(super) enum Body {
    Ascii { lines: Lines, numbers: Vec<f64>, next: usize },
    Binary { path: PathBuf, reader: BufReader<File>, offset: u64, is_big: bool },
}

impl Body {
    /// Opens the body at a byte behind so many lines.
    pub(super) fn open(path: &Path, format: Format, (offset, line): (u64, u64)) -> Result<Body, ContentError> {
        if format == Format::Ascii {
            let lines = Lines::open(path, offset, line)?;
            return Ok(Body::Ascii { lines, numbers: Vec::new(), next: 0 });
        }
        let opened = File::open(path).and_then(|mut file| {
            file.seek(SeekFrom::Start(offset))?;
            Ok(BufReader::with_capacity(1 << 20, file))
        });
        let reader = opened.map_err(|error| unreadable(path, &error))?;
        Ok(Body::Binary { path: path.to_owned(), reader, offset, is_big: format == Format::Big })
    }

    /// Where the next element begins: byte, and lines before it.
    pub(super) fn place(&self) -> (u64, u64) {
        match self {
            Body::Ascii { lines, .. } => (lines.offset, lines.number),
            Body::Binary { offset, .. } => (*offset, 0),
        }
    }

    pub(super) fn fault(&self, found: impl Into<String>) -> ContentError {
        match self {
            Body::Ascii { lines, .. } => lines.fault(found),
            Body::Binary { path, offset, .. } => fault(path, &format!("byte {offset}"), found),
        }
    }

    /// Begins an element: in a text that is a line with something on it.
    fn begin(&mut self, element: &Element) -> Result<(), ContentError> {
        let Body::Ascii { lines, numbers, next } = self else { return Ok(()) };
        numbers.clear();
        *next = 0;
        if element.properties.is_empty() {
            return Ok(());
        }
        while numbers.is_empty() {
            let Some(line) = lines.next()? else {
                return Err(lines.fault(format!("the end; expected another {}", element.name)));
            };
            for text in line.split_ascii_whitespace() {
                match text.parse() {
                    Ok(number) => numbers.push(number),
                    Err(_) => {
                        let text: String = text.chars().take(60).collect();
                        return Err(lines.fault(format!("{text:?}; expected a number")));
                    }
                }
            }
        }
        Ok(())
    }

    fn number(&mut self, kind: Kind, property: &Property) -> Result<f64, ContentError> {
        match self {
            Body::Ascii { lines, numbers, next } => {
                *next += 1;
                let found = numbers.get(*next - 1).copied();
                found.ok_or_else(|| lines.fault(format!("the end of the line; expected {}", property.name)))
            }
            Body::Binary { path, reader, offset, is_big } => {
                let mut bytes = [0; 8];
                let size = kind.bytes();
                if reader.read_exact(&mut bytes[..size]).is_err() {
                    let found = format!("the end; expected {}", property.name);
                    return Err(fault(path, &format!("byte {offset}"), found));
                }
                *offset += size as u64;
                if *is_big {
                    bytes[..size].reverse();
                }
                let [a, b, c, d, ..] = bytes;
                Ok(match kind {
                    Kind::I8 => f64::from(a as i8),
                    Kind::U8 => f64::from(a),
                    Kind::I16 => f64::from(i16::from_le_bytes([a, b])),
                    Kind::U16 => f64::from(u16::from_le_bytes([a, b])),
                    Kind::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
                    Kind::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
                    Kind::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
                    Kind::F64 => f64::from_le_bytes(bytes),
                })
            }
        }
    }

    /// Reads an element: hands on each number with the place of its property and, in a list, that of the item.
    pub(super) fn element(
        &mut self,
        element: &Element,
        mut take: impl FnMut(usize, usize, f64),
    ) -> Result<(), ContentError> {
        self.begin(element)?;
        for (at, property) in element.properties.iter().enumerate() {
            let Some(count) = property.count else {
                let value = self.number(property.kind, property)?;
                take(at, 0, value);
                continue;
            };
            let items = self.number(count, property)?;
            if !(0.0..=MAX_ITEMS as f64).contains(&items) || items.fract() != 0.0 {
                let found = format!("{items} items of {}; expected 0 to {MAX_ITEMS}", property.name);
                return Err(self.fault(found));
            }
            for item in 0..items as usize {
                let value = self.number(property.kind, property)?;
                take(at, item, value);
            }
        }
        Ok(())
    }
}
