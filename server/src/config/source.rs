//! Where settings come from.

use super::Token;
use super::settings::{Config, SETTINGS, Setting};
use clap::{Arg, ArgAction, ArgMatches, Command};
use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::{Path, PathBuf};

/// Largest configuration or token file that is read, bytes.
const FILE_BYTES_MAX: u64 = 1 << 20;

/// Variables of this prefix are settings, but for these.
const PREFIX: &str = "FORESIGHT_";
const OTHER_VARIABLES: [&str; 5] =
    ["FORESIGHT_TOKEN", "FORESIGHT_CONFIG", "FORESIGHT_DATA", "FORESIGHT_FULL", "FORESIGHT_STORE"];

/// Why there is no configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// A value that is not accepted.
    #[error("{place} {key} = {value:?}; expected {expected}")]
    Value {
        /// File, environment or command line.
        place: String,
        /// As it stands there.
        key: String,
        /// As it stands there.
        value: String,
        /// What is accepted.
        expected: String,
    },
    /// A key that is no setting.
    #[error("{place} {key}: no such setting; expected {expected}")]
    Key {
        /// The file.
        place: String,
        /// As it stands there.
        key: String,
        /// The nearest, or all.
        expected: String,
    },
    /// A file that cannot be read.
    #[error("{}: {source}; expected a readable file", .file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why.
        #[source]
        source: std::io::Error,
    },
    /// A file that is no TOML.
    #[error("{}: {message}", .file.display())]
    Toml {
        /// The file.
        file: PathBuf,
        /// With line and column.
        message: String,
    },
    /// A token that is no token.
    #[error(
        "{place}: the token is too short or has blanks; expected at least 16 printable ASCII characters without blanks"
    )]
    Token {
        /// The file or variable; never the token.
        place: String,
    },
    /// No token where one is needed.
    #[error(
        "listen = {listen}: reachable from other machines, and there is no token; expected a loopback address, \
         FORESIGHT_TOKEN or token_file"
    )]
    TokenMissing {
        /// Where it would listen.
        listen: std::net::SocketAddr,
    },
}

/// Settings from the command line: a flag for each.
#[derive(Clone, Debug, Default)]
pub struct Flags {
    given: BTreeMap<&'static str, Vec<String>>,
}

impl clap::Args for Flags {
    fn augment_args(command: Command) -> Command {
        SETTINGS.iter().fold(command, |command, setting| command.arg(argument(setting)))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Flags::augment_args(command)
    }
}

fn argument(setting: &'static Setting) -> Arg {
    let default = if setting.default.is_empty() { String::new() } else { format!(" [default: {}]", setting.default) };
    let meaning = setting.meaning.trim().trim_end_matches('.');
    let argument = Arg::new(setting.key).long(setting.flag());
    if setting.switch {
        let help = if setting.default == "true" { format!("Set to false: {meaning}") } else { meaning.to_owned() };
        return argument.help(help).action(ArgAction::SetTrue);
    }
    let several = if setting.list { "; may be repeated" } else { "" };
    argument
        .help(format!("{meaning}{several}{default}"))
        .value_name(word(setting))
        .num_args(if setting.list { 1..=usize::MAX } else { 1..=1 })
        .action(if setting.list { ArgAction::Append } else { ArgAction::Set })
}

/// What stands for the value in the help.
fn word(setting: &Setting) -> &'static str {
    match setting.key {
        "world" => "[NAME=]WORLD",
        "listen" => "ADDRESS:PORT",
        "link" => "LINK",
        "token_file" => "FILE",
        "record" => "FOLDER",
        "database" => "sqlite:FILE|URL",
        key if key.contains("bytes") || key.contains("memory") => "BYTES",
        key if key.ends_with("_max") || key.ends_with("threads") => "N",
        key if ["keep_", "ping_", "idle_", "_within"].iter().any(|part| key.contains(part)) => "TIME",
        "origin" => "ORIGIN",
        "policy" => "POLICY",
        _ => "VALUE",
    }
}

impl clap::FromArgMatches for Flags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Flags, clap::Error> {
        let mut given = BTreeMap::new();
        for setting in SETTINGS {
            if setting.switch {
                if matches.get_flag(setting.key) {
                    given.insert(setting.key, vec![(setting.default != "true").to_string()]);
                }
            } else if let Some(values) = matches.get_many::<String>(setting.key) {
                given.insert(setting.key, values.cloned().collect());
            }
        }
        Ok(Flags { given })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        self.given.extend(Flags::from_arg_matches(matches)?.given);
        Ok(())
    }
}

/// A configuration, the token that goes with it, and what deserves a warning.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The settings.
    pub config: Config,
    /// What clients must know, if anything.
    pub token: Option<Token>,
    /// Variables that look like settings and are none.
    pub warnings: Vec<String>,
}

/// Reads file, variables and flags, and checks all of it.
///
/// # Errors
/// The first value, key or file that is not what was expected.
pub fn load(
    file: Option<&Path>,
    variables: impl IntoIterator<Item = (String, String)>,
    flags: &Flags,
) -> Result<Loaded, ConfigError> {
    let mut config = Config::default();
    if let Some(file) = file {
        apply_file(&mut config, file, &read(file)?)?;
    }
    let mut warnings = Vec::new();
    let mut token = None;
    let variables: BTreeMap<String, String> =
        variables.into_iter().filter(|(name, _)| name.starts_with(PREFIX)).collect();
    for (name, value) in &variables {
        if name == "FORESIGHT_TOKEN" {
            token = Some(Token::new(value).ok_or_else(|| ConfigError::Token { place: name.clone() })?);
        } else if let Some(setting) = SETTINGS.iter().find(|setting| setting.variable() == *name) {
            let texts: Vec<&str> = if setting.list { value.split(';').collect() } else { vec![value] };
            set(&mut config, setting, &texts, "environment:", name)?;
        } else if !OTHER_VARIABLES.contains(&name.as_str()) {
            warnings.push(format!("{name}: no such setting; it is ignored"));
        }
    }
    for setting in SETTINGS {
        if let Some(values) = flags.given.get(setting.key) {
            let texts: Vec<&str> = values.iter().map(String::as_str).collect();
            set(&mut config, setting, &texts, "command line:", &format!("--{}", setting.flag()))?;
        }
    }
    if let Some(file) = &config.token_file {
        let place = || ConfigError::Token { place: file.display().to_string() };
        token = Some(Token::new(&read(file)?).ok_or_else(place)?);
    }
    if token.is_none() && !config.listen.ip().is_loopback() {
        return Err(ConfigError::TokenMissing { listen: config.listen });
    }
    Ok(Loaded { config, token, warnings })
}

fn read(file: &Path) -> Result<String, ConfigError> {
    let io = |source| ConfigError::Io { file: file.to_owned(), source };
    let mut text = String::new();
    let length = std::fs::File::open(file)
        .and_then(|opened| opened.take(FILE_BYTES_MAX + 1).read_to_string(&mut text))
        .map_err(io)?;
    if length as u64 > FILE_BYTES_MAX {
        return Err(io(std::io::Error::other(format!("it has more than {FILE_BYTES_MAX} bytes"))));
    }
    Ok(text)
}

fn apply_file(config: &mut Config, file: &Path, text: &str) -> Result<(), ConfigError> {
    let table: toml::Table = text.parse().map_err(|error: toml::de::Error| ConfigError::Toml {
        file: file.to_owned(),
        message: error.to_string().trim_end().to_owned(),
    })?;
    let place = format!("{}:", file.display());
    for (key, value) in &table {
        let Some(setting) = SETTINGS.iter().find(|setting| setting.key == key) else {
            let keys: Vec<&str> = SETTINGS.iter().map(|setting| setting.key).collect();
            return Err(ConfigError::Key { place, key: key.clone(), expected: keys.join(", ") });
        };
        let scalar = |value: &toml::Value| match value {
            toml::Value::String(text) => Some(text.clone()),
            toml::Value::Integer(number) => Some(number.to_string()),
            toml::Value::Boolean(flag) => Some(flag.to_string()),
            _ => None,
        };
        let texts: Option<Vec<String>> = match value {
            toml::Value::Array(values) if setting.list => values.iter().map(scalar).collect(),
            value => scalar(value).map(|text| vec![text]),
        };
        let Some(texts) = texts else {
            return Err(refusal(setting, &place, key, value.to_string()));
        };
        set(config, setting, &texts.iter().map(String::as_str).collect::<Vec<_>>(), &place, key)?;
    }
    Ok(())
}

fn set(config: &mut Config, setting: &Setting, texts: &[&str], place: &str, key: &str) -> Result<(), ConfigError> {
    // A URL that is refused may hold a password.
    let shown = if setting.key == "database" { "(not shown)".to_owned() } else { texts.join(";") };
    (setting.set)(config, texts).ok_or_else(|| refusal(setting, place, key, shown))
}

fn refusal(setting: &Setting, place: &str, key: &str, value: String) -> ConfigError {
    ConfigError::Value { place: place.to_owned(), key: key.to_owned(), value, expected: (setting.expected)() }
}

impl Config {
    /// Threads that decide on a machine of so many cores.
    pub fn decision_threads(&self, cores: usize) -> usize {
        self.decision_threads.map_or_else(|| cores.saturating_sub(1).max(1), super::Whole::count)
    }

    /// The texts of a setting, as they would be given.
    pub fn texts(&self, key: &str) -> Option<Vec<String>> {
        SETTINGS.iter().find(|setting| setting.key == key).map(|setting| (setting.texts)(self))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Args as _, FromArgMatches as _};
    use std::time::Duration;

    fn flags(arguments: &[&str]) -> Flags {
        let command = Flags::augment_args(Command::new("serve").no_binary_name(true));
        Flags::from_arg_matches(&command.get_matches_from(arguments)).expect("flags")
    }

    fn variables(pairs: &[(&str, &str)]) -> Vec<(String, String)> {
        pairs.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect()
    }

    #[test]
    fn a_flag_beats_a_variable_beats_the_file_beats_the_default() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("foresight.toml");
        let text =
            "keep_session = \"2m\"\nsessions_max = 7\nanswers_max = 70\nworld = [\"a\", \"b\"]\ndriving = true\n";
        std::fs::write(&file, text).expect("written");
        let env = variables(&[("FORESIGHT_SESSIONS_MAX", "8"), ("FORESIGHT_ANSWERS_MAX", "80"), ("PATH", "x")]);
        let loaded = load(Some(&file), env, &flags(&["--answers-max", "90", "--no-driving"])).expect("loads");
        let config = loaded.config;
        assert_eq!(config.keep_session.0, Duration::from_secs(120));
        assert_eq!((config.sessions_max.0, config.answers_max.0), (8, 90));
        assert_eq!(config.world, ["a", "b"]);
        assert!(!config.driving);
        assert_eq!(config.message_bytes_max, Config::default().message_bytes_max);
    }

    #[test]
    fn what_is_shown_gives_the_same_configuration() {
        let given = flags(&["--origin", "https://a.example", "--origin", "http://b:1", "--database", "sqlite:x.db"]);
        let config = load(None, [], &given).expect("loads").config;
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("foresight.toml");
        std::fs::write(&file, config.to_toml()).expect("written");
        assert_eq!(load(Some(&file), [], &Flags::default()).expect("loads").config, config);
    }

    #[test]
    fn faults_are_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("foresight.toml");
        let cases = [
            ("sessions_max = 0", "foresight.toml: sessions_max = \"0\"; expected a whole number from 1 to 1000000"),
            ("keep_session = 60", "keep_session = \"60\"; expected a time from"),
            ("sesions_max = 1", "sesions_max: no such setting; expected world, listen"),
            ("world = {}", "world = \"{}\"; expected a list of"),
            ("listen = [\"a\"]", "listen = \"[\\\"a\\\"]\"; expected an address"),
            ("sessions_max = ", "line 1"),
        ];
        for (text, expected) in cases {
            std::fs::write(&file, text).expect("written");
            let message = load(Some(&file), [], &Flags::default()).expect_err(text).to_string();
            assert!(message.contains(expected), "{message}");
        }
        let message =
            load(None, variables(&[("FORESIGHT_LOG", "xml")]), &Flags::default()).expect_err("xml").to_string();
        assert_eq!(message, "environment: FORESIGHT_LOG = \"xml\"; expected text or json");
        let message = load(None, [], &flags(&["--idle-after", "x"])).expect_err("x").to_string();
        assert!(message.starts_with("command line: --idle-after = \"x\"; expected a time"), "{message}");
        let secret = variables(&[("FORESIGHT_DATABASE", "mysql://me:secret@host/db")]);
        let message = load(None, secret, &Flags::default()).expect_err("mysql").to_string();
        assert!(!message.contains("secret"), "{message}");
    }

    #[test]
    fn beyond_loopback_a_token_is_needed_and_never_shown() {
        let wide = flags(&["--listen", "0.0.0.0:80"]);
        assert!(matches!(load(None, [], &wide), Err(ConfigError::TokenMissing { .. })));
        let short = load(None, variables(&[("FORESIGHT_TOKEN", "short")]), &wide).expect_err("short");
        assert!(!short.to_string().contains("short."), "{short}");
        let token = variables(&[("FORESIGHT_TOKEN", "0123456789abcdef")]);
        let loaded = load(None, token, &wide).expect("loads");
        let token = loaded.token.as_ref().expect("a token");
        assert!(token.matches("0123456789abcdef") && !token.matches("0123456789abcdeg"));
        assert!(!format!("{loaded:?}{}", loaded.config.to_toml()).contains("0123456789abcdef"));
    }

    #[test]
    fn a_variable_that_is_no_setting_is_warned_of() {
        let env = variables(&[("FORESIGHT_SESSION_MAX", "8"), ("FORESIGHT_DATA", "/d")]);
        let warnings = load(None, env, &Flags::default()).expect("loads").warnings;
        assert_eq!(warnings, ["FORESIGHT_SESSION_MAX: no such setting; it is ignored"]);
    }
}
