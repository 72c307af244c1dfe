//! The header of a PLY file.

use super::super::lines::Lines;
use crate::import::tiles3d::ContentError;

/// Most elements, and most properties of one.
const MOST: usize = 256;

/// How the body is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Format {
    Ascii,
    Little,
    Big,
}

/// A type of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn from_name(name: &str) -> Option<Kind> {
        Some(match name {
            "char" | "int8" => Kind::I8,
            "uchar" | "uint8" => Kind::U8,
            "short" | "int16" => Kind::I16,
            "ushort" | "uint16" => Kind::U16,
            "int" | "int32" => Kind::I32,
            "uint" | "uint32" => Kind::U32,
            "float" | "float32" => Kind::F32,
            "double" | "float64" => Kind::F64,
            _ => return None,
        })
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Kind::I8 | Kind::U8 => 1,
            Kind::I16 | Kind::U16 => 2,
            Kind::I32 | Kind::U32 | Kind::F32 => 4,
            Kind::F64 => 8,
        }
    }
}

/// What an element has, in order.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Kind,
    /// The type of the number of items, for a list.
    pub(super) count: Option<Kind>,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// Which property is called one of these.
    pub(super) fn find(&self, names: &[&str]) -> Option<usize> {
        names.iter().find_map(|name| self.properties.iter().position(|property| property.name == *name))
    }

    /// Least bytes that one of it takes.
    fn least(&self, format: Format) -> u64 {
        let own = |property: &Property| match format {
            Format::Ascii => 2,
            _ => property.count.unwrap_or(property.kind).bytes() as u64,
        };
        // The last line may lack its end.
        self.properties.iter().map(own).sum::<u64>().max(1)
    }
}

/// A header.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Header {
    pub(super) format: Format,
    pub(super) elements: Vec<Element>,
    /// Images that comments name (`comment TextureFile NAME`).
    pub(super) images: Vec<String>,
    /// Where the body begins: byte, and lines before it.
    pub(super) body: (u64, u64),
}

/// Reads the header of a file of `length` bytes; elements that it has no room for are refused.
pub(super) fn read(lines: &mut Lines, length: u64) -> Result<Header, ContentError> {
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut images = Vec::new();
    if lines.next()? != Some("ply") {
        return Err(lines.fault("no \"ply\"; expected a PLY file"));
    }
    loop {
        let Some(line) = lines.next()? else {
            return Err(lines.fault("the end; expected end_header"));
        };
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let found = || format!("{:?}", line.chars().take(60).collect::<String>());
        let fault = match words[..] {
            ["end_header"] => break,
            ["format", name, _] => {
                let known = match name {
                    "ascii" => Some(Format::Ascii),
                    "binary_little_endian" => Some(Format::Little),
                    "binary_big_endian" => Some(Format::Big),
                    _ => None,
                };
                format = format.or(known);
                known.is_none().then_some("expected ascii, binary_little_endian or binary_big_endian")
            }
            ["element", name, count] => match count.parse() {
                Ok(count) if elements.len() < MOST => {
                    elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
                    None
                }
                _ => Some("expected element, a name and a number of them"),
            },
            ["property", ref rest @ ..] => {
                let property = match *rest {
                    ["list", count, kind, name] => Kind::from_name(count)
                        .zip(Kind::from_name(kind))
                        .map(|(count, kind)| Property { name: name.to_owned(), kind, count: Some(count) }),
                    [kind, name] => {
                        Kind::from_name(kind).map(|kind| Property { name: name.to_owned(), kind, count: None })
                    }
                    _ => None,
                };
                match (property, elements.last_mut().filter(|element| element.properties.len() < MOST)) {
                    (Some(property), Some(element)) => {
                        element.properties.push(property);
                        None
                    }
                    _ => Some("expected property, a type and a name, or list, two types and a name, below an element"),
                }
            }
            ["comment", "TextureFile", ..] => {
                let name = line.split_once("TextureFile").map_or("", |(_, name)| name.trim());
                if images.len() < MOST {
                    images.push(name.replace('\\', "/"));
                }
                None
            }
            ["comment" | "obj_info", ..] | [] => None,
            _ => Some("expected a line of a PLY header"),
        };
        if let Some(expected) = fault {
            let text = format!("{}; {expected}", found());
            return Err(lines.fault(text));
        }
    }
    let Some(format) = format else { return Err(lines.fault("no format; expected one before end_header")) };
    let room = length.saturating_sub(lines.offset);
    let mut needed = 0_u64;
    for element in &elements {
        needed = needed.saturating_add(element.count.saturating_mul(element.least(format)));
        // An end of line that the last element may lack.
        if needed > room + 1 {
            let Element { name, count, .. } = element;
            return Err(
                lines.fault(format!("{count} of {name} in {room} bytes; expected no more than there is room for"))
            );
        }
    }
    Ok(Header { format, elements, images, body: (lines.offset, lines.number) })
}
