//! Paths below a world's folder as requests name them.

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, percent_decode_str, utf8_percent_encode};

/// Longest path below a world, bytes after decoding.
pub const PATH_BYTES_MAX: usize = 1024;

/// What a path segment holds without an escape.
const SEGMENT: &AsciiSet = &NON_ALPHANUMERIC
    .remove(b'-')
    .remove(b'.')
    .remove(b'_')
    .remove(b'~')
    .remove(b'!')
    .remove(b'$')
    .remove(b'\'')
    .remove(b'(')
    .remove(b')')
    .remove(b'*')
    .remove(b'+')
    .remove(b',')
    .remove(b'=')
    .remove(b'@')
    .remove(b'/');

/// The path with `/` between its parts, its escapes undone once. `None` unless it is UTF-8 and stays below where it starts: no
/// part is empty, begins with `.`, or holds `/`, `\`, `:` or a control character after decoding.
pub fn decode(raw: &str) -> Option<String> {
    if raw.len() > 3 * PATH_BYTES_MAX {
        return None;
    }
    let mut path = String::with_capacity(raw.len());
    for part in raw.split('/') {
        let part = percent_decode_str(part).decode_utf8().ok()?;
        let refused = |c: char| matches!(c, '/' | '\\' | ':') || c.is_control();
        if part.is_empty() || part.starts_with('.') || part.contains(refused) {
            return None;
        }
        if !path.is_empty() {
            path.push('/');
        }
        path.push_str(&part);
    }
    (path.len() <= PATH_BYTES_MAX).then_some(path)
}

/// The path as a relative reference.
pub fn encode(path: &str) -> String {
    utf8_percent_encode(path, SEGMENT).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stays_below() {
        assert_eq!(decode("a/b%20c/d.glb").as_deref(), Some("a/b c/d.glb"));
        assert_eq!(decode("%C3%A4.glb").as_deref(), Some("ä.glb"));
        assert_eq!(decode("a%252e").as_deref(), Some("a%2e"));
        for raw in [
            "", "/", "a/", "/a", "a//b", ".", "..", "a/../b", "%2e%2e/a", "a%2Fb", "a%5cb", "c:/a", "a%00", ".git/x",
            "%ff", "a%0a",
        ] {
            assert_eq!(decode(raw), None, "{raw}");
        }
        assert_eq!(decode(&"a".repeat(PATH_BYTES_MAX + 1)), None);
        for path in ["a/b c/ä#?%.glb", "x+y=z,@!.json"] {
            assert_eq!(decode(&encode(path)).as_deref(), Some(path));
        }
    }
}
