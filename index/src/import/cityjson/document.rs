//! CityJSON and CityJSONSeq as they are written: JSON to types, nothing resolved.

use serde::Deserialize;
use serde::de::{self, DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::Value;
use std::fmt;

use super::CityJsonFault;

/// A file: its header, and the objects with the vertices that they name.
#[derive(Debug)]
pub(super) struct Document {
    pub(super) transform: Option<Transform>,
    pub(super) metadata: Option<Value>,
    pub(super) templates: Templates,
    pub(super) parts: Vec<Part>,
}

/// The whole of a CityJSON file, or one line of a CityJSONSeq.
#[derive(Debug)]
pub(super) struct Part {
    /// Line in the file, from 1; `None` if the file is one document.
    pub(super) line: Option<usize>,
    pub(super) objects: Vec<(String, CityObject)>,
    pub(super) vertices: Vec<[f64; 3]>,
}

impl Part {
    /// A JSON path in this part, with its line in a sequence.
    pub(super) fn place(&self, path: &str) -> String {
        self.line.map_or_else(|| path.to_owned(), |line| format!("line {line}, {path}"))
    }
}

/// Metres = scale × integer + translate.
#[derive(Clone, Copy, Debug, Deserialize)]
pub(super) struct Transform {
    pub(super) scale: [f64; 3],
    pub(super) translate: [f64; 3],
}

#[derive(Debug, Default, Deserialize)]
pub(super) struct Templates {
    pub(super) templates: Vec<Geometry>,
    #[serde(rename = "vertices-templates")]
    pub(super) vertices: Vec<[f64; 3]>,
}

#[derive(Debug, Deserialize)]
pub(super) struct CityObject {
    #[serde(rename = "type")]
    pub(super) kind: String,
    pub(super) geometry: Option<Vec<Geometry>>,
    pub(super) parents: Option<Vec<String>>,
    pub(super) children: Option<Vec<String>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Geometry {
    #[serde(rename = "type")]
    pub(super) kind: String,
    pub(super) lod: Option<Lod>,
    #[serde(default)]
    pub(super) boundaries: Boundaries,
    pub(super) template: Option<u64>,
    #[serde(rename = "transformationMatrix")]
    pub(super) matrix: Option<[f64; 16]>,
}

/// A level of detail: a number in 1.0, a string from 1.1 on.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum Lod {
    Number(f64),
    Text(String),
}

/// Nested arrays of vertex indices, flat. A ring is a list of indices, a surface a list of rings, whatever is around them.
#[derive(Debug, Default)]
pub(super) struct Boundaries {
    indices: Vec<u32>,
    ring_ends: Vec<u32>,
    surface_ends: Vec<u32>,
    /// Arrays inside each other; 0 if nowhere is an index.
    pub(super) depth: u8,
}

impl Boundaries {
    /// All indices in order.
    pub(super) fn indices(&self) -> &[u32] {
        &self.indices
    }

    /// The surfaces, each as its rings.
    pub(super) fn surfaces(&self) -> impl Iterator<Item = impl Iterator<Item = &[u32]> + Clone> {
        let ring = |at: usize| {
            let start = if at == 0 { 0 } else { self.ring_ends[at - 1] };
            &self.indices[start as usize..self.ring_ends[at] as usize]
        };
        let starts = std::iter::once(0).chain(self.surface_ends.iter().copied());
        starts.zip(&self.surface_ends).map(move |(start, &end)| (start as usize..end as usize).map(ring))
    }
}

impl<'de> Deserialize<'de> for Boundaries {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Boundaries, D::Error> {
        let mut boundaries = Boundaries::default();
        boundaries.depth = Nested(&mut boundaries).deserialize(deserializer)?.unwrap_or(0);
        Ok(boundaries)
    }
}

/// One value inside boundaries. Gives its depth: 0 for an index, `None` for arrays without any index.
struct Nested<'a>(&'a mut Boundaries);

impl<'de> DeserializeSeed<'de> for Nested<'_> {
    type Value = Option<u8>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Option<u8>, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Nested<'_> {
    type Value = Option<u8>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an index of a vertex from 0 to 4294967295, or an array of such")
    }

    fn visit_u64<E: de::Error>(self, value: u64) -> Result<Option<u8>, E> {
        let index = u32::try_from(value).map_err(|_| E::invalid_value(de::Unexpected::Unsigned(value), &self))?;
        self.0.indices.push(index);
        Ok(Some(0))
    }

    fn visit_unit<E: de::Error>(self) -> Result<Option<u8>, E> {
        Ok(None)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<Option<u8>, A::Error> {
        let mut depth = None;
        while let Some(element) = elements.next_element_seed(Nested(self.0))? {
            match (depth, element) {
                (Some(one), Some(other)) if one != other => {
                    return Err(de::Error::custom("arrays of different depths beside each other in boundaries"));
                }
                (None, Some(_)) => depth = element,
                _ => {}
            }
        }
        let ends = match depth {
            Some(0) => Some((&mut self.0.ring_ends, self.0.indices.len())),
            Some(1) => Some((&mut self.0.surface_ends, self.0.ring_ends.len())),
            _ => None,
        };
        if let Some((ends, end)) = ends {
            ends.push(u32::try_from(end).map_err(|_| de::Error::custom("more than 2^32 indices in boundaries"))?);
        }
        Ok(depth.map(|depth| depth.saturating_add(1)))
    }
}

/// The members of `CityObjects` in the file's order, repeated ones included.
#[derive(Debug, Default)]
struct Objects(Vec<(String, CityObject)>);

impl<'de> Deserialize<'de> for Objects {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Objects, D::Error> {
        struct Members;
        impl<'de> Visitor<'de> for Members {
            type Value = Objects;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object with a city object for each identifier")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut members: A) -> Result<Objects, A::Error> {
                let mut objects = Vec::new();
                while let Some(member) = members.next_entry()? {
                    objects.push(member);
                }
                Ok(Objects(objects))
            }
        }
        deserializer.deserialize_map(Members)
    }
}

#[derive(Deserialize)]
struct Raw {
    #[serde(rename = "type")]
    kind: String,
    version: Option<String>,
    transform: Option<Transform>,
    metadata: Option<Value>,
    #[serde(rename = "CityObjects", default)]
    objects: Objects,
    #[serde(default)]
    vertices: Vec<[f64; 3]>,
    #[serde(rename = "geometry-templates")]
    templates: Option<Templates>,
}

/// Reads a file: one document, or a header and features, one a line.
pub(super) fn read(bytes: &[u8]) -> Result<Document, CityJsonFault> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let mut values = serde_json::Deserializer::from_slice(bytes).into_iter::<Raw>();
    let header = match values.next() {
        Some(Ok(header)) => header,
        Some(Err(error)) => return Err(malformed(&error, 0)),
        None => return Err(CityJsonFault::new("line 1", "nothing; expected a CityJSON document")),
    };
    if header.kind != "CityJSON" {
        let found = format!("{:?}; expected \"CityJSON\", in a sequence as the first line", header.kind);
        return Err(CityJsonFault::new("$.type", found));
    }
    let version = header.version.as_deref().unwrap_or_default();
    if !["1.0", "1.1", "2.0"].iter().any(|known| version == *known || version.starts_with(&format!("{known}."))) {
        let found = format!("{version:?}; expected \"1.0\", \"1.1\" or \"2.0\"");
        return Err(CityJsonFault::new("$.version", found));
    }
    let end = values.byte_offset();
    let is_sequence = !bytes[end..].trim_ascii().is_empty();
    let first = is_sequence.then_some(1);
    let mut document = Document {
        transform: header.transform,
        metadata: header.metadata,
        templates: header.templates.unwrap_or_default(),
        parts: vec![Part { line: first, objects: header.objects.0, vertices: header.vertices }],
    };
    // A header that was spread over lines is counted as they are.
    let before = bytes[..end].iter().filter(|&&byte| byte == b'\n').count();
    for (at, line) in bytes[end..].split(|&byte| byte == b'\n').enumerate() {
        if line.trim_ascii().is_empty() {
            continue;
        }
        let number = before + at + 1;
        let feature: Raw = serde_json::from_slice(line).map_err(|error| malformed(&error, number - 1))?;
        if feature.kind != "CityJSONFeature" {
            let found = format!("{:?}; expected \"CityJSONFeature\" after the first line", feature.kind);
            return Err(CityJsonFault::new(format!("line {number}, $.type"), found));
        }
        document.parts.push(Part { line: Some(number), objects: feature.objects.0, vertices: feature.vertices });
    }
    Ok(document)
}

fn malformed(error: &serde_json::Error, lines_before: usize) -> CityJsonFault {
    let text = error.to_string();
    // serde_json appends the place; ours counts the file's lines.
    let what = text.rfind(" at line ").map_or(text.as_str(), |end| &text[..end]);
    CityJsonFault::new(format!("line {}, column {}", error.line() + lines_before, error.column()), what)
}
