//! Lines of a text file with their places.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::inputs::{fault, unreadable};
use crate::import::tiles3d::ContentError;

/// Longest line, bytes.
const MAX_LINE: u64 = 1 << 24;

/// Reads a file line by line.
pub(super) struct Lines {
    path: PathBuf,
    reader: BufReader<File>,
    line: Vec<u8>,
    /// Byte at which the next line begins.
    pub(super) offset: u64,
    /// Number of the line that was read last, from 1.
    pub(super) number: u64,
}

impl Lines {
    /// Opens a file at a byte behind so many lines.
    pub(super) fn open(path: &Path, offset: u64, number: u64) -> Result<Lines, ContentError> {
        let opened = File::open(path).and_then(|mut file| {
            file.seek(SeekFrom::Start(offset))?;
            Ok(file)
        });
        let file = opened.map_err(|error| unreadable(path, &error))?;
        let (reader, line) = (BufReader::with_capacity(1 << 18, file), Vec::new());
        Ok(Lines { path: path.to_owned(), reader, line, offset, number })
    }

    /// A fault in the line that was read last.
    pub(super) fn fault(&self, found: impl Into<String>) -> ContentError {
        fault(&self.path, &format!("line {}", self.number), found)
    }

    /// The next line without its end; a backslash at its end joins it with the one after it. `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<&str>, ContentError> {
        self.line.clear();
        loop {
            let start = self.line.len();
            let read = (&mut self.reader).take(MAX_LINE).read_until(b'\n', &mut self.line);
            let read = read.map_err(|error: io::Error| unreadable(&self.path, &error))?;
            if read == 0 && start == 0 {
                return Ok(None);
            }
            self.offset += read as u64;
            self.number += u64::from(read > 0);
            if self.line.len() as u64 >= MAX_LINE {
                return Err(self.fault(format!("a line of more than {MAX_LINE} bytes; expected shorter ones")));
            }
            let end = self.line.trim_ascii_end().len();
            self.line.truncate(end);
            if read > 0 && self.line.last() == Some(&b'\\') {
                self.line.pop();
                self.line.push(b' ');
                continue;
            }
            break;
        }
        if std::str::from_utf8(&self.line).is_err() {
            // Names may be in any encoding; numbers are ASCII in all of them.
            self.line.iter_mut().filter(|byte| !byte.is_ascii()).for_each(|byte| *byte = b'?');
        }
        Ok(std::str::from_utf8(&self.line).ok())
    }
}
