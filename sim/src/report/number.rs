//! Numbers and names as text: fixed digits, so that the same comparison gives the same bytes.

/// Stands for what was never reached or is not known.
pub(super) const NEVER: &str = "–";

/// `value` with a fixed number of decimals; [`NEVER`] if it is not finite.
pub(super) fn fixed(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return NEVER.to_owned();
    }
    if value.abs() >= 1e12 {
        return format!("{value:.2e}");
    }
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(digits) if digits.bytes().all(|b| b == b'0' || b == b'.') => digits.to_owned(),
        _ => text,
    }
}

/// [`fixed`], or [`NEVER`] for `None`.
pub(super) fn optional(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| NEVER.to_owned(), |v| fixed(v, decimals))
}

/// `value` with at most `decimals` decimals and no trailing zeros: tick labels and drawing coordinates.
pub(super) fn trimmed(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    if text.contains('.') && !text.contains('e') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

/// About three significant digits: 0.042, 3.14, 27.2, 314.
pub(super) fn significant(value: f64) -> String {
    let magnitude = value.abs();
    let decimals = match magnitude {
        m if m >= 100.0 => 0,
        m if m >= 10.0 => 1,
        m if m >= 1.0 || m == 0.0 => 2,
        m if m >= 0.1 => 3,
        _ => 4,
    };
    fixed(value, decimals)
}

/// Bytes as MB (10⁶ bytes), about three significant digits.
pub(super) fn megabytes(bytes: f64) -> String {
    format!("{} MB", significant(bytes / 1e6))
}

/// Bytes of memory as MiB (2²⁰ bytes).
pub(super) fn mebibytes(bytes: f64) -> String {
    format!("{} MiB", trimmed(bytes / MEBIBYTE, 1))
}

/// Bytes in a MiB.
pub(super) const MEBIBYTE: f64 = 1_048_576.0;

/// Seconds as `12.3 s`, `2 min 5 s` or `3 h 20 min`.
pub(super) fn duration(seconds: f64) -> String {
    if !(0.0..1e12).contains(&seconds) {
        return NEVER.to_owned();
    }
    if seconds < 120.0 {
        return format!("{} s", trimmed(seconds, 1));
    }
    let whole = seconds.round();
    if whole < 7200.0 {
        let (minutes, rest) = ((whole / 60.0).floor(), whole % 60.0);
        return if rest == 0.0 { format!("{minutes} min") } else { format!("{minutes} min {rest} s") };
    }
    let minutes = (whole / 60.0).round();
    format!("{} h {} min", (minutes / 60.0).floor(), minutes % 60.0)
}

/// `text` without control and text-direction characters (each becomes U+FFFD), at most `limit` characters long.
pub(super) fn printable(text: &str, limit: usize) -> String {
    let mut shown: String = text
        .chars()
        .take(limit)
        .map(|c| {
            let hidden = c.is_control()
                || matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
                || matches!(c, '\u{feff}' | '\u{fffe}' | '\u{ffff}');
            if hidden { '\u{fffd}' } else { c }
        })
        .collect();
    if text.chars().nth(limit).is_some() {
        shown.pop();
        shown.push('…');
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_fixed_digits_and_no_negative_zero() {
        assert_eq!(fixed(0.87349, 3), "0.873");
        assert_eq!(fixed(-0.0001, 2), "0.00");
        assert_eq!(fixed(f64::NAN, 2), NEVER);
        assert_eq!(fixed(f64::INFINITY, 2), NEVER);
        assert_eq!(fixed(1e300, 2), "1.00e300");
        assert_eq!(trimmed(2.50, 2), "2.5");
        assert_eq!(trimmed(100.0, 2), "100");
        assert_eq!(significant(27.15), "27.1");
        assert_eq!(mebibytes(268_435_456.0), "256 MiB");
    }

    #[test]
    fn durations_carry_over() {
        assert_eq!(duration(119.96), "120 s");
        assert_eq!(duration(179.7), "3 min");
        assert_eq!(duration(125.2), "2 min 5 s");
        assert_eq!(duration(7199.9), "2 h 0 min");
        assert_eq!(duration(f64::NAN), NEVER);
        assert_eq!(duration(-1.0), NEVER);
    }

    #[test]
    fn names_lose_control_characters_and_excess() {
        assert_eq!(printable("a\u{1b}[31mb\n", 20), "a\u{fffd}[31mb\u{fffd}");
        assert_eq!(printable("abcdef", 4), "abc…");
        assert_eq!(printable("abcd", 4), "abcd");
    }
}
