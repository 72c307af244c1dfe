//! Every setting, once.

use super::value::{Bytes, LogForm, LogLevels, Origin, PolicyName, Span, Value, Whole};
use foresight_index::database::Location;
use std::fmt::Write as _;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;

/// What is known of a setting.
#[derive(Debug)]
pub struct Setting {
    /// In the file; the flag has `-` for `_`, the variable is in capitals after `FORESIGHT_`.
    pub key: &'static str,
    /// As it would be given.
    pub default: &'static str,
    /// What it is for.
    pub meaning: &'static str,
    /// Whether several are given.
    pub list: bool,
    /// Whether its flag stands alone.
    pub switch: bool,
    /// What is accepted.
    pub expected: fn() -> String,
    pub(super) set: fn(&mut Config, &[&str]) -> Option<()>,
    pub(super) texts: fn(&Config) -> Vec<String>,
}

impl Setting {
    /// Its flag, without the dashes before it: `no-…` for what is on by default.
    pub fn flag(&self) -> String {
        let name = self.key.replace('_', "-");
        if self.switch && self.default == "true" { format!("no-{name}") } else { name }
    }

    /// Its environment variable.
    pub fn variable(&self) -> String {
        format!("FORESIGHT_{}", self.key.to_ascii_uppercase())
    }
}

macro_rules! settings {
    ($($(#[doc = $doc:literal])+ $key:ident: $type:ty = $default:literal;)+) => {
        /// The settings of a server, checked.
        #[derive(Clone, Debug, PartialEq)]
        pub struct Config {
            $($(#[doc = $doc])+ pub $key: $type,)+
        }

        impl Default for Config {
            fn default() -> Config {
                Config { $($key: <$type as Value>::read(&[$default]).expect("the default is accepted"),)+ }
            }
        }

        /// All settings, in the order in which they are shown.
        pub const SETTINGS: &[Setting] = &[$(Setting {
            key: stringify!($key),
            default: $default,
            meaning: concat!($($doc),+),
            list: <$type as Value>::LIST,
            switch: <$type as Value>::SWITCH,
            expected: <$type as Value>::expected,
            set: |config, texts| <$type as Value>::read(texts).map(|value| config.$key = value),
            texts: |config| config.$key.texts(),
        },)+];
    };
}

settings! {
    /// Worlds to serve: a folder, a tileset, a generated world such as city:blocks=20, a city model, an elevation grid;
    /// NAME=WORLD gives it a name.
    world: Vec<String> = "";
    /// Where to listen; beyond loopback a token is needed.
    listen: SocketAddr = "127.0.0.1:8080";
    /// Link by which each session's responses are shaped, as in foresight-sim; unshaped if empty.
    link: Option<String> = "";
    /// File that holds the token; FORESIGHT_TOKEN may hold it instead.
    token_file: Option<PathBuf> = "";
    /// Origins of pages that may open sessions, beside the server's own and loopback.
    origin: Vec<Origin> = "";
    /// Whether the worlds' content needs the token too.
    guard_worlds: bool = "false";
    /// Proxies whose X-Forwarded-For names the client.
    trusted_proxy: Vec<IpAddr> = "";
    /// Whether clients are told what to do; false is the kill switch: they fetch by their own rules.
    driving: bool = "true";
    /// Worlds, by name, whose clients are not told what to do.
    not_driven: Vec<String> = "";
    /// Policy of sessions that ask for none.
    policy: PolicyName = "foresight";
    /// Threads that decide; one less than there are cores if empty.
    decision_threads: Option<Whole<1, 1024>> = "";
    /// Sessions at a time.
    sessions_max: Whole<1, 1_000_000> = "1000";
    /// Sessions at a time of one client address.
    sessions_per_address_max: Whole<1, 1_000_000> = "100";
    /// How long a session without a connection is kept for its client to come back.
    keep_session: Span<0, 86_400_000> = "1m";
    /// Time for the first message of a connection.
    hello_within: Span<10, 600_000> = "10s";
    /// Between two pings.
    ping_every: Span<10, 600_000> = "15s";
    /// A connection from which nothing came for so long is closed.
    idle_after: Span<10, 3_600_000> = "45s";
    /// Largest frame of a client.
    message_bytes_max: Bytes<1024, 67_108_864> = "1MiB";
    /// Frames of a connection per second, on average over two seconds.
    frames_per_second_max: Whole<1, 100_000> = "250";
    /// Bytes of a connection's frames per second, on average over two seconds or one largest frame.
    bytes_per_second_max: Bytes<1024, 1_073_741_824> = "512KiB";
    /// Answers that may wait for a slow connection before it is closed.
    answers_max: Whole<16, 1_000_000> = "1024";
    /// Most memory that a client may announce.
    client_memory_max: Bytes<1, 1_125_899_906_842_624> = "1TiB";
    /// Most memory of this machine for one session; one that needs more is ended.
    session_memory_max: Bytes<65_536, 17_179_869_184> = "64MiB";
    /// HTTP connections at a time.
    connections_max: Whole<1, 1_000_000> = "4096";
    /// Requests being answered at a time, and contents on their way; further ones are told to come back later.
    requests_max: Whole<1, 1_000_000> = "4096";
    /// Time for the head of a request.
    head_within: Span<10, 600_000> = "10s";
    /// An HTTP connection on which nothing moves, and on which the server owes nothing, is closed after so long.
    connection_idle_after: Span<10, 86_400_000> = "1m";
    /// Memory for small files of worlds.
    store_bytes: Bytes<0, 1_099_511_627_776> = "256MiB";
    /// Folder for recordings of sessions; none are made if empty.
    record: Option<PathBuf> = "";
    /// Bytes of all recordings in the folder together; then no more is recorded.
    record_bytes_max: Bytes<1024, 1_125_899_906_842_624> = "1GiB";
    /// Database for link estimates, which then survive a restart.
    database: Option<Location> = "";
    /// Time for sessions, recordings and estimates to be closed at the end.
    shutdown_within: Span<0, 600_000> = "10s";
    /// Form of the log lines on stderr.
    log: LogForm = "text";
    /// Which log lines are written.
    log_levels: LogLevels = "info";
}

impl Config {
    /// The effective configuration as a file that gives it again, each setting with its meaning. Passwords in URLs are
    /// left out; there is no token in it.
    pub fn to_toml(&self) -> String {
        let mut text = String::new();
        for setting in SETTINGS {
            let _ = writeln!(text, "#{}\n# Expected: {}.", setting.meaning, (setting.expected)());
            let _ = writeln!(text, "{} = {}\n", setting.key, self.toml_value(setting));
        }
        text.push_str("# The token is not shown; it comes from FORESIGHT_TOKEN or token_file.\n");
        text
    }

    fn toml_value(&self, setting: &Setting) -> toml::Value {
        let mut texts = (setting.texts)(self);
        if setting.list {
            return toml::Value::Array(texts.into_iter().map(toml::Value::String).collect());
        }
        let text = texts.pop().unwrap_or_default();
        match (setting.switch, text.parse()) {
            (true, Ok(value)) => toml::Value::Boolean(value),
            _ => text.parse().map_or(toml::Value::String(text), toml::Value::Integer),
        }
    }

    /// The table of all settings, in Markdown.
    pub fn markdown() -> String {
        let mut text = "| key | flag | default | what it is | expected |\n|---|---|---|---|---|\n".to_owned();
        for setting in SETTINGS {
            let default = if setting.default.is_empty() { "–".to_owned() } else { format!("`{}`", setting.default) };
            let _ = writeln!(
                text,
                "| `{}` | `--{}` | {default} | {} | {} |",
                setting.key,
                setting.flag(),
                setting.meaning.trim(),
                (setting.expected)()
            );
        }
        text
    }
}
