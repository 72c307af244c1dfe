//! Content codings of files that lie compressed beside the plain ones, chosen by `Accept-Encoding` (RFC 9110, section 12.5.3).

/// A coding, better ones first where a client likes several equally.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Coding {
    /// `br`, in `NAME.br`.
    Brotli,
    /// `zstd`, in `NAME.zst`.
    Zstd,
    /// `gzip`, in `NAME.gz`.
    Gzip,
}

impl Coding {
    const ALL: [Coding; 3] = [Coding::Brotli, Coding::Zstd, Coding::Gzip];

    /// As in `Content-Encoding`.
    pub fn name(self) -> &'static str {
        match self {
            Coding::Brotli => "br",
            Coding::Zstd => "zstd",
            Coding::Gzip => "gzip",
        }
    }

    /// What the file's name has besides.
    pub fn suffix(self) -> &'static str {
        match self {
            Coding::Brotli => ".br",
            Coding::Zstd => ".zst",
            Coding::Gzip => ".gz",
        }
    }
}

/// The codings that a client accepts, the most welcome first, none that it likes less than the plain content. A weight
/// that is not one counts as 0.
pub fn accepted(header: &str) -> Vec<Coding> {
    let weight = |name: &str| {
        let mut any = None;
        for item in header.split(',') {
            let mut parts = item.split(';').map(str::trim);
            let coding = parts.next().unwrap_or_default();
            let matches =
                coding.eq_ignore_ascii_case(name) || (name == "gzip" && coding.eq_ignore_ascii_case("x-gzip"));
            if !matches && coding != "*" {
                continue;
            }
            let q = parts
                .find_map(|part| part.strip_prefix("q=").or_else(|| part.strip_prefix("Q=")))
                .map_or(1000, thousandths);
            if matches {
                return Some(q);
            }
            any = Some(q);
        }
        any
    };
    // What is not named is acceptable as plain content, and less welcome than anything named.
    let plain =
        if header.split(',').any(|item| item.trim_start().starts_with("identity")) { weight("identity") } else { None };
    let plain = plain.unwrap_or(1);
    let mut codings: Vec<(u16, Coding)> = Coding::ALL
        .into_iter()
        .filter_map(|coding| Some((weight(coding.name())?, coding)))
        .filter(|&(q, _)| q > 0 && q >= plain)
        .collect();
    codings.sort_by_key(|&(q, coding)| (std::cmp::Reverse(q), coding));
    codings.into_iter().map(|(_, coding)| coding).collect()
}

/// A weight of at most 1 with at most three decimals, in thousandths; 0 for anything else.
fn thousandths(text: &str) -> u16 {
    let (whole, decimals) = text.split_once('.').unwrap_or((text, ""));
    if decimals.len() > 3 || !decimals.bytes().all(|byte| byte.is_ascii_digit()) {
        return 0;
    }
    let decimals: u16 = format!("{decimals:0<3}").parse().unwrap_or(0);
    match (whole, decimals) {
        ("0", decimals) => decimals,
        ("1", 0) => 1000,
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codings_in_the_order_of_the_client() {
        use Coding::{Brotli, Gzip, Zstd};
        for (header, codings) in [
            ("", vec![]),
            ("gzip", vec![Gzip]),
            ("gzip, deflate, br, zstd", vec![Brotli, Zstd, Gzip]),
            ("br;q=0.5, gzip;q=0.8", vec![Gzip, Brotli]),
            ("br;q=0, *", vec![Zstd, Gzip]),
            ("*;q=0", vec![]),
            ("identity, gzip;q=0.5", vec![]),
            ("identity;q=0.5, gzip", vec![Gzip]),
            ("GZIP; q=1.000", vec![Gzip]),
            ("x-gzip", vec![Gzip]),
            ("gzip;q=1.5, br;q=0.1234, zstd;q=x", vec![]),
            ("deflate", vec![]),
        ] {
            assert_eq!(accepted(header), codings, "{header}");
        }
    }
}
