//! Lists of entity tags (RFC 9110, sections 8.8.3, 13.1.1 and 13.1.2).

/// Tags of a field that are looked at.
const TAGS_MAX: usize = 256;

/// Which comparison of tags counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Comparison {
    /// Weak tags are as good: for `If-None-Match`.
    Weak,
    /// Weak tags match nothing: for `If-Match`.
    Strong,
}

/// Whether a list holds a tag, which is a strong one with its quotation marks, or is `*`. What follows something that is
/// no tag does not count, nor does what follows the 256th.
pub fn holds(list: &[u8], tag: &[u8], comparison: Comparison) -> bool {
    let mut rest = list;
    for _ in 0..TAGS_MAX {
        let start = rest.iter().position(|byte| !b" \t,".contains(byte)).unwrap_or(rest.len());
        rest = &rest[start..];
        if list.trim_ascii() == b"*" {
            return true;
        }
        let (weak, quoted) = match rest.strip_prefix(b"W/") {
            Some(quoted) => (true, quoted),
            None => (false, rest),
        };
        let Some(inner) = quoted.strip_prefix(b"\"") else { return false };
        let Some(end) = inner.iter().position(|&byte| byte == b'"') else { return false };
        let (candidate, after) = quoted.split_at(end + 2);
        if candidate == tag && (!weak || comparison == Comparison::Weak) {
            return true;
        }
        rest = after;
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tags_are_compared_as_asked() {
        for (list, weakly, strongly) in [
            (&b"\"a\""[..], true, true),
            (b"W/\"a\"", true, false),
            (b"\"b\", W/\"c\" ,\"a\"", true, true),
            (b",, \"a\"", true, true),
            (b" * ", true, true),
            (b"\"b\", *", false, false),
            (b"a", false, false),
            (b"\"a", false, false),
            (b"b, \"a\"", false, false),
            (b"w/\"a\"", false, false),
            (b"\"\xff\x80\", \"a\"", true, true),
            (b"\"a\"\"b\"", true, true),
            (b"", false, false),
        ] {
            assert_eq!(holds(list, b"\"a\"", Comparison::Weak), weakly, "{list:?}");
            assert_eq!(holds(list, b"\"a\"", Comparison::Strong), strongly, "{list:?}");
        }
        assert!(!holds(&b"\"b\",".repeat(1000), b"\"a\"", Comparison::Weak));
    }
}
