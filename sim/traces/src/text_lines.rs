//! Lines of a text file with their numbers, as every line-based reader takes them.

use std::borrow::Cow;

/// Longest line accepted, bytes.
pub(crate) const LINE_BYTES_MAX: usize = 1 << 16;

/// Lines with content that do not begin with `#`, trimmed, their numbers from 1. What is not UTF-8 is replaced, so that
/// it fails where a number is expected.
#[derive(Clone)]
pub(crate) struct TextLines<'a> {
    bytes: &'a [u8],
    number: usize,
}

impl<'a> TextLines<'a> {
    /// The lines of a file, a byte-order mark skipped.
    ///
    /// # Errors
    /// The number of a line longer than [`LINE_BYTES_MAX`].
    pub(crate) fn new(bytes: &'a [u8]) -> Result<TextLines<'a>, usize> {
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        match bytes.split(|&b| b == b'\n').position(|line| line.len() > LINE_BYTES_MAX) {
            Some(index) => Err(index + 1),
            None => Ok(TextLines { bytes, number: 0 }),
        }
    }
}

impl<'a> Iterator for TextLines<'a> {
    type Item = (usize, Cow<'a, str>);

    fn next(&mut self) -> Option<Self::Item> {
        while !self.bytes.is_empty() {
            let end = self.bytes.iter().position(|&b| b == b'\n').unwrap_or(self.bytes.len());
            let line = self.bytes[..end].trim_ascii();
            self.bytes = self.bytes.get(end + 1..).unwrap_or_default();
            self.number += 1;
            if !line.is_empty() && line[0] != b'#' {
                return Some((self.number, String::from_utf8_lossy(line)));
            }
        }
        None
    }
}
