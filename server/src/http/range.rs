//! `Range` of bytes (RFC 9110, section 14).

use std::ops::Range;

/// Most ranges of one request that are looked at; with more the header counts as absent.
const RANGES_MAX: usize = 64;

/// What a `Range` header asks of a representation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Asked {
    /// All of it: another unit, a malformed header, or several ranges that do not join.
    Whole,
    /// These bytes, not empty.
    Part(Range<u64>),
    /// Nothing that there is.
    Unsatisfiable,
}

/// Reads a `Range` header for a representation of `length` bytes. Several ranges are answered as one if, those beyond the
/// end left out, together they cover one stretch without a gap; a server may ignore a range that it does not serve.
pub fn parse(header: &[u8], length: u64) -> Asked {
    let Some(set) = std::str::from_utf8(header).ok().and_then(bytes_unit) else { return Asked::Whole };
    let mut parts: Vec<Range<u64>> = Vec::new();
    for (index, spec) in set.split(',').enumerate() {
        if index == RANGES_MAX {
            return Asked::Whole;
        }
        match one(spec.trim_matches([' ', '\t']), length) {
            Ok(Some(part)) => parts.push(part),
            Ok(None) => {}
            Err(()) => return Asked::Whole,
        }
    }
    parts.sort_unstable_by_key(|part| part.start);
    let mut parts = parts.into_iter();
    let Some(mut whole) = parts.next() else { return Asked::Unsatisfiable };
    for part in parts {
        if part.start > whole.end {
            return Asked::Whole;
        }
        whole.end = whole.end.max(part.end);
    }
    Asked::Part(whole)
}

fn bytes_unit(text: &str) -> Option<&str> {
    let (unit, set) = text.trim_matches([' ', '\t']).split_once('=')?;
    unit.eq_ignore_ascii_case("bytes").then_some(set)
}

/// `first-last`, `first-` or `-count`; `None` for what lies beyond the end.
fn one(spec: &str, length: u64) -> Result<Option<Range<u64>>, ()> {
    let (first, last) = spec.split_once('-').ok_or(())?;
    let part = match (first, last) {
        ("", count) => length.saturating_sub(number(count)?)..length,
        (first, "") => number(first)?..length,
        (first, last) => {
            let (first, last) = (number(first)?, number(last)?);
            if last < first {
                return Err(());
            }
            first..last.saturating_add(1).min(length)
        }
    };
    Ok((part.start < part.end).then_some(part))
}

/// Digits only; what is too large for 64 bits is as large as they hold.
fn number(text: &str) -> Result<u64, ()> {
    if text.is_empty() || !text.bytes().all(|byte| byte.is_ascii_digit()) {
        return Err(());
    }
    Ok(text.parse().unwrap_or(u64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_of_ten_bytes() {
        for (header, asked) in [
            ("bytes=0-0", Asked::Part(0..1)),
            ("bytes=3-", Asked::Part(3..10)),
            ("bytes=-4", Asked::Part(6..10)),
            ("bytes=-40", Asked::Part(0..10)),
            ("bytes=5-99", Asked::Part(5..10)),
            ("Bytes = 0-1", Asked::Whole),
            ("BYTES=0-1", Asked::Part(0..2)),
            ("bytes=10-", Asked::Unsatisfiable),
            ("bytes=-0", Asked::Unsatisfiable),
            ("bytes=10-11, 12-", Asked::Unsatisfiable),
            ("bytes=0-2, 3-5", Asked::Part(0..6)),
            ("bytes=3-5,0-2,1-8", Asked::Part(0..9)),
            ("bytes=0-1,90-99", Asked::Part(0..2)),
            ("bytes=0-1,4-5", Asked::Whole),
            ("bytes=5-4", Asked::Whole),
            ("bytes=", Asked::Whole),
            ("bytes=-", Asked::Whole),
            ("bytes=+1-2", Asked::Whole),
            ("bytes=1-2x", Asked::Whole),
            ("items=0-1", Asked::Whole),
            ("bytes=0-99999999999999999999999", Asked::Part(0..10)),
            ("bytes=99999999999999999999999-", Asked::Unsatisfiable),
        ] {
            assert_eq!(parse(header.as_bytes(), 10), asked, "{header}");
        }
        assert_eq!(parse(b"bytes=0-", 0), Asked::Unsatisfiable);
        assert_eq!(parse(format!("bytes={}", "0-0,".repeat(65)).as_bytes(), 10), Asked::Whole);
        assert_eq!(parse(b"bytes=\xff", 10), Asked::Whole);
    }
}
