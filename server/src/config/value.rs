//! Values of settings: how each is read from text, said again, and what is said to have been expected.

use foresight_index::database::Location;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

/// A value of a setting.
pub trait Value: Sized {
    /// Whether it is a list: the file has an array, the flag is repeated, the variable separates by semicolons.
    const LIST: bool = false;
    /// Whether the flag stands alone.
    const SWITCH: bool = false;

    /// Reads one text, or several of a list; `None` is what was not expected.
    fn read(texts: &[&str]) -> Option<Self>;

    /// The texts that [`Value::read`] gives it from.
    fn texts(&self) -> Vec<String>;

    /// What is accepted.
    fn expected() -> String;
}

/// The one text of what is no list.
fn single<'a>(texts: &[&'a str]) -> Option<&'a str> {
    match texts {
        [text] => Some(text),
        _ => None,
    }
}

/// A whole number from `MIN` to `MAX`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Whole<const MIN: u64, const MAX: u64>(pub u64);

impl<const MIN: u64, const MAX: u64> Whole<MIN, MAX> {
    /// As a count of things in memory.
    pub fn count(self) -> usize {
        usize::try_from(self.0).unwrap_or(usize::MAX)
    }
}

impl<const MIN: u64, const MAX: u64> Value for Whole<MIN, MAX> {
    fn read(texts: &[&str]) -> Option<Self> {
        single(texts)?.parse().ok().filter(|n| (MIN..=MAX).contains(n)).map(Whole)
    }

    fn texts(&self) -> Vec<String> {
        vec![self.0.to_string()]
    }

    fn expected() -> String {
        format!("a whole number from {MIN} to {MAX}")
    }
}

/// Bytes from `MIN` to `MAX`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bytes<const MIN: u64, const MAX: u64>(pub u64);

impl<const MIN: u64, const MAX: u64> Bytes<MIN, MAX> {
    /// As a length in memory.
    pub fn length(self) -> usize {
        usize::try_from(self.0).unwrap_or(usize::MAX)
    }
}

/// Largest first.
const UNITS: [(&str, u64); 4] = [("TiB", 1 << 40), ("GiB", 1 << 30), ("MiB", 1 << 20), ("KiB", 1 << 10)];

fn bytes(text: &str) -> Option<u64> {
    let (number, unit) = match UNITS.iter().find_map(|(unit, bytes)| Some((text.strip_suffix(unit)?, *bytes))) {
        Some((number, unit)) => (number.trim_end(), unit),
        None => (text, 1),
    };
    number.parse::<u64>().ok()?.checked_mul(unit)
}

fn bytes_text(bytes: u64) -> String {
    match UNITS.iter().find(|(_, unit)| bytes > 0 && bytes.is_multiple_of(*unit)) {
        Some((name, unit)) => format!("{}{name}", bytes / unit),
        None => bytes.to_string(),
    }
}

impl<const MIN: u64, const MAX: u64> Value for Bytes<MIN, MAX> {
    fn read(texts: &[&str]) -> Option<Self> {
        bytes(single(texts)?).filter(|n| (MIN..=MAX).contains(n)).map(Bytes)
    }

    fn texts(&self) -> Vec<String> {
        vec![bytes_text(self.0)]
    }

    fn expected() -> String {
        format!("bytes from {} to {}, such as 500000 or 64MiB", bytes_text(MIN), bytes_text(MAX))
    }
}

/// A time of `MIN_MS` to `MAX_MS` milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span<const MIN_MS: u64, const MAX_MS: u64>(pub Duration);

impl<const MIN_MS: u64, const MAX_MS: u64> Value for Span<MIN_MS, MAX_MS> {
    fn read(texts: &[&str]) -> Option<Self> {
        let span = humantime::parse_duration(single(texts)?).ok()?;
        let range = Duration::from_millis(MIN_MS)..=Duration::from_millis(MAX_MS);
        range.contains(&span).then_some(Span(span))
    }

    fn texts(&self) -> Vec<String> {
        vec![humantime::format_duration(self.0).to_string()]
    }

    fn expected() -> String {
        let text = |ms| humantime::format_duration(Duration::from_millis(ms));
        format!("a time from {} to {}, such as 500ms or 2m", text(MIN_MS), text(MAX_MS))
    }
}

impl Value for bool {
    const SWITCH: bool = true;

    fn read(texts: &[&str]) -> Option<Self> {
        single(texts)?.parse().ok()
    }

    fn texts(&self) -> Vec<String> {
        vec![self.to_string()]
    }

    fn expected() -> String {
        "true or false".to_owned()
    }
}

impl Value for SocketAddr {
    fn read(texts: &[&str]) -> Option<Self> {
        single(texts)?.parse().ok()
    }

    fn texts(&self) -> Vec<String> {
        vec![self.to_string()]
    }

    fn expected() -> String {
        "an address and a port, such as 127.0.0.1:8080 or [::]:8080".to_owned()
    }
}

impl Value for IpAddr {
    fn read(texts: &[&str]) -> Option<Self> {
        single(texts)?.parse().ok()
    }

    fn texts(&self) -> Vec<String> {
        vec![self.to_string()]
    }

    fn expected() -> String {
        "an IP address".to_owned()
    }
}

impl Value for PathBuf {
    fn read(texts: &[&str]) -> Option<Self> {
        single(texts).filter(|text| !text.is_empty()).map(PathBuf::from)
    }

    fn texts(&self) -> Vec<String> {
        vec![self.to_string_lossy().into_owned()]
    }

    fn expected() -> String {
        "a path".to_owned()
    }
}

impl Value for String {
    fn read(texts: &[&str]) -> Option<Self> {
        single(texts).filter(|text| !text.is_empty()).map(str::to_owned)
    }

    fn texts(&self) -> Vec<String> {
        vec![self.clone()]
    }

    fn expected() -> String {
        "a text".to_owned()
    }
}

impl Value for Location {
    fn read(texts: &[&str]) -> Option<Self> {
        single(texts).filter(|text| !text.is_empty())?.parse().ok()
    }

    /// Without a password.
    fn texts(&self) -> Vec<String> {
        vec![self.to_string()]
    }

    fn expected() -> String {
        "sqlite:FILE or postgres://USER@HOST/DATABASE".to_owned()
    }
}

/// Lines or records.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogForm {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

impl Value for LogForm {
    fn read(texts: &[&str]) -> Option<Self> {
        match single(texts)? {
            "text" => Some(LogForm::Text),
            "json" => Some(LogForm::Json),
            _ => None,
        }
    }

    fn texts(&self) -> Vec<String> {
        vec![if *self == LogForm::Text { "text" } else { "json" }.to_owned()]
    }

    fn expected() -> String {
        "text or json".to_owned()
    }
}

/// Which log lines are written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLevels(pub String);

impl Value for LogLevels {
    fn read(texts: &[&str]) -> Option<Self> {
        let text = single(texts)?;
        tracing_subscriber::EnvFilter::try_new(text).ok().map(|_| LogLevels(text.to_owned()))
    }

    fn texts(&self) -> Vec<String> {
        vec![self.0.clone()]
    }

    fn expected() -> String {
        "levels, for all or by module, such as info or warn,foresight_server::session=debug".to_owned()
    }
}

/// A policy with its options.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PolicyName(pub String);

impl Value for PolicyName {
    fn read(texts: &[&str]) -> Option<Self> {
        let text = single(texts)?;
        foresight_wire::session::SessionLimits::default().policy(text).ok().map(|_| PolicyName(text.to_owned()))
    }

    fn texts(&self) -> Vec<String> {
        vec![self.0.clone()]
    }

    fn expected() -> String {
        "a policy with its options, such as foresight or foresight:alpha=0.8".to_owned()
    }
}

/// An origin that a page may come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin(pub String);

impl Value for Origin {
    fn read(texts: &[&str]) -> Option<Self> {
        // Browsers send origins in lower case.
        let text = single(texts)?.to_ascii_lowercase();
        let host = text.strip_prefix("https://").or_else(|| text.strip_prefix("http://"))?;
        let plain = |c: char| c.is_ascii_alphanumeric() || ".-:[]".contains(c);
        (!host.is_empty() && host.chars().all(plain)).then(|| Origin(text.clone()))
    }

    fn texts(&self) -> Vec<String> {
        vec![self.0.clone()]
    }

    fn expected() -> String {
        "an origin without a path, such as https://maps.example.org".to_owned()
    }
}

/// Several; none by default.
impl<V: Value> Value for Vec<V> {
    const LIST: bool = true;

    fn read(texts: &[&str]) -> Option<Self> {
        texts.iter().filter(|text| !text.is_empty()).map(|text| V::read(&[text])).collect()
    }

    fn texts(&self) -> Vec<String> {
        self.iter().flat_map(V::texts).collect()
    }

    fn expected() -> String {
        format!("a list of: {}", V::expected())
    }
}

/// One or none; the empty text is none.
impl<V: Value> Value for Option<V> {
    const LIST: bool = V::LIST;

    fn read(texts: &[&str]) -> Option<Self> {
        if *texts == [""] { Some(None) } else { V::read(texts).map(Some) }
    }

    fn texts(&self) -> Vec<String> {
        self.as_ref().map_or_else(|| vec![String::new()], V::texts)
    }

    fn expected() -> String {
        V::expected()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_shown_is_read_again() {
        fn round<V: Value + PartialEq + std::fmt::Debug>(text: &str) -> V {
            let value = V::read(&[text]).unwrap_or_else(|| panic!("{text}"));
            let shown = value.texts();
            assert_eq!(V::read(&shown.iter().map(String::as_str).collect::<Vec<_>>()).as_ref(), Some(&value));
            value
        }
        assert_eq!(round::<Bytes<1, { u64::MAX }>>("64 MiB").0, 64 << 20);
        assert_eq!(round::<Bytes<1, { u64::MAX }>>("1000").0, 1000);
        assert_eq!(round::<Span<1, 100_000>>("1m 30s").0, Duration::from_secs(90));
        assert_eq!(round::<Option<Whole<1, 9>>>(""), None);
        assert_eq!(round::<Origin>("HTTPS://Maps.example:8443").0, "https://maps.example:8443");
        assert_eq!(round::<LogLevels>("warn,foresight_server=debug").0, "warn,foresight_server=debug");
    }

    #[test]
    fn what_is_out_of_range_is_refused() {
        assert_eq!(Whole::<1, 9>::read(&["10"]), None);
        assert_eq!(Whole::<1, 9>::read(&["-1"]), None);
        assert_eq!(Bytes::<1, 9>::read(&["99999999999999999TiB"]), None);
        assert_eq!(Span::<1, 9>::read(&["10"]), None);
        assert_eq!(Origin::read(&["https://a/b"]), None);
        assert_eq!(Origin::read(&["null"]), None);
        assert_eq!(PolicyName::read(&["no-such-policy"]), None);
    }
}
