//! Elements of an XML file one after the other, with where they stand.

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use crate::path::PathError;

/// Deepest nesting of elements accepted.
const DEPTH_MAX: usize = 256;

/// Longest own text of an element accepted, bytes; what is longer is no number and no time.
const TEXT_BYTES_MAX: usize = 1 << 12;

/// An XML file's elements by their local names (without namespace prefixes).
pub(super) struct Xml<'a> {
    name: &'a str,
    text: &'a str,
    reader: Reader<&'a [u8]>,
    /// Open elements, each with its own text so far.
    open: Vec<(String, String)>,
}

/// What comes next.
pub(super) enum Node<'a> {
    /// An element begins.
    Open(String, BytesStart<'a>),
    /// An element ends: its name and its own text, trimmed.
    Close(String, String),
    /// The file ends, every element closed.
    End,
}

impl<'a> Xml<'a> {
    pub(super) fn new(name: &'a str, bytes: &'a [u8]) -> Result<Xml<'a>, PathError> {
        let text = std::str::from_utf8(bytes).map_err(|error| PathError::Place {
            name: name.to_owned(),
            place: format!("byte {}", error.valid_up_to()),
            message: "not UTF-8; expected XML in UTF-8".to_owned(),
        })?;
        let mut reader = Reader::from_str(text);
        reader.config_mut().expand_empty_elements = true;
        Ok(Xml { name, text, reader, open: Vec::new() })
    }

    /// Name of the outermost element.
    pub(super) fn root(mut self) -> Result<String, PathError> {
        match self.next()? {
            Node::Open(name, _) => Ok(name),
            _ => Err(self.error("no element; expected one".to_owned())),
        }
    }

    /// An error where the reader stands.
    pub(super) fn error(&self, message: String) -> PathError {
        let at = usize::try_from(self.reader.buffer_position()).unwrap_or(usize::MAX).min(self.text.len());
        let line = 1 + self.text.as_bytes()[..at].iter().filter(|&&b| b == b'\n').count();
        PathError::Line { name: self.name.to_owned(), line, message }
    }

    /// Is an element of that name open?
    pub(super) fn is_within(&self, name: &str) -> bool {
        self.open.iter().any(|(open, _)| open == name)
    }

    /// Name of the innermost open element.
    pub(super) fn parent(&self) -> &str {
        self.open.last().map_or("", |(name, _)| name)
    }

    pub(super) fn next(&mut self) -> Result<Node<'a>, PathError> {
        loop {
            let event = match self.reader.read_event() {
                Ok(event) => event,
                Err(error) => return Err(self.error(format!("{error}; expected well-formed XML"))),
            };
            match event {
                Event::Start(start) => {
                    if self.open.len() == DEPTH_MAX {
                        return Err(self.error(format!("elements nested deeper than the {DEPTH_MAX} expected at most")));
                    }
                    let local = start.local_name().as_ref().to_owned();
                    self.open.push((local.clone(), String::new()));
                    return Ok(Node::Open(local, start));
                }
                Event::End(_) => {
                    let Some((name, text)) = self.open.pop() else {
                        return Err(self.error("an element that ends before it begins".to_owned()));
                    };
                    return Ok(Node::Close(name, text.trim().to_owned()));
                }
                Event::Text(text) => self.add(&text.xml10_content()),
                Event::CData(text) => self.add(&text.xml10_content()),
                Event::Eof => match self.open.last() {
                    None => return Ok(Node::End),
                    Some((name, _)) => {
                        let message = format!("the file ends within <{name}>; expected </{name}>");
                        return Err(self.error(message));
                    }
                },
                _ => {}
            }
        }
    }

    fn add(&mut self, text: &str) {
        if let Some((_, own)) = self.open.last_mut()
            && own.len() + text.len() <= TEXT_BYTES_MAX
        {
            own.push_str(text);
        }
    }

    /// A number of an element's text or of an attribute.
    pub(super) fn number(&self, what: &str, text: &str) -> Result<f64, PathError> {
        match text.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(self.error(format!("{what} `{}`; expected a number", excerpt(text)))),
        }
    }
}

/// The beginning of a text.
pub(super) fn excerpt(text: &str) -> String {
    text.chars().take(40).collect()
}
