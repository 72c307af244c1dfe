//! Where a database is.

use std::path::PathBuf;
use std::{fmt, str::FromStr};

/// Neither a file nor a URL that is known.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{given}`: unknown scheme; expected a file or postgres://USER@HOST/DATABASE")]
pub struct LocationError {
    /// As given, without a password.
    pub given: String,
}

/// Where a database is: a file, or a PostgreSQL database by URL.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Location {
    /// A SQLite file.
    File(PathBuf),
    /// `postgres://…`.
    Postgres(String),
}

impl FromStr for Location {
    type Err = LocationError;

    /// `postgres://…`, `postgresql://…`, `sqlite://FILE`, `sqlite:FILE`, or a file.
    fn from_str(text: &str) -> Result<Location, LocationError> {
        match text.split_once("://") {
            Some(("postgres" | "postgresql", _)) => Ok(Location::Postgres(text.to_owned())),
            Some(("sqlite", file)) if !file.is_empty() => Ok(Location::File(PathBuf::from(file))),
            Some((scheme, _)) if scheme.chars().all(|c| c.is_ascii_alphanumeric() || "+-.".contains(c)) => {
                Err(LocationError { given: without_password(text) })
            }
            _ => Ok(Location::File(PathBuf::from(text.strip_prefix("sqlite:").unwrap_or(text)))),
        }
    }
}

impl fmt::Display for Location {
    /// Without a password.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Location::File(file) => write!(f, "{}", file.display()),
            Location::Postgres(url) => f.write_str(&without_password(url)),
        }
    }
}

/// A URL whose password and parameters, which can hold one too, are left out.
fn without_password(url: &str) -> String {
    let url = url.split(['?', '#']).next().unwrap_or_default();
    let Some((scheme, rest)) = url.split_once("://") else { return url.to_owned() };
    match rest.rsplit_once('@') {
        Some((user, host)) => format!("{scheme}://{}@{host}", user.split(':').next().unwrap_or_default()),
        None => url.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_and_urls_are_told_apart() {
        let file = |text: &str| Location::File(PathBuf::from(text));
        assert_eq!("runs.sqlite".parse::<Location>().unwrap(), file("runs.sqlite"));
        assert_eq!("sqlite:///var/runs.sqlite".parse::<Location>().unwrap(), file("/var/runs.sqlite"));
        assert_eq!("sqlite:/var/runs.sqlite".parse::<Location>().unwrap(), file("/var/runs.sqlite"));
        assert_eq!("a b/ü://x".parse::<Location>().unwrap(), file("a b/ü://x"));
        assert!(matches!("postgresql://localhost/runs".parse(), Ok(Location::Postgres(_))));
        for unknown in ["mysql://localhost/runs", "http://localhost/", "sqlite://"] {
            assert!(unknown.parse::<Location>().unwrap_err().to_string().contains("expected"), "{unknown}");
        }
    }

    #[test]
    fn no_password_is_shown() {
        for url in [
            "postgres://me:secret@host:5/db",
            "postgres://me:se@secret@host:5/db",
            "postgres://me@host:5/db?password=secret",
        ] {
            assert_eq!(url.parse::<Location>().unwrap().to_string(), "postgres://me@host:5/db");
        }
    }
}
