//! The configuration: one table of settings, read from a file, the environment and flags, checked, and shown.
//!
//! A flag beats a variable, a variable the file, the file the default. The token is no setting: it comes from
//! `FORESIGHT_TOKEN` or a file, and is never shown.

mod settings;
mod source;
mod value;

pub use settings::{Config, SETTINGS, Setting};
pub use source::{ConfigError, Flags, Loaded, load};
pub use value::{Bytes, LogForm, LogLevels, Origin, PolicyName, Span, Value, Whole};

/// The secret that clients must know; not shown, compared in constant time.
#[derive(Clone)]
pub struct Token(blake3::Hash);

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(not shown)")
    }
}

impl Token {
    /// Shortest that is accepted: 16 random characters cannot be guessed over a network.
    const BYTES_MIN: usize = 16;

    /// Of a text, white space around it left out; `None` if it is too short or cannot stand in a header.
    pub fn new(text: &str) -> Option<Token> {
        let text = text.trim();
        let fits = text.len() >= Token::BYTES_MIN && text.bytes().all(|b| b.is_ascii_graphic());
        fits.then(|| Token(blake3::hash(text.as_bytes())))
    }

    /// Whether a client's text is it. Hashes are compared in constant time.
    pub fn matches(&self, text: &str) -> bool {
        self.0 == blake3::hash(text.as_bytes())
    }
}
