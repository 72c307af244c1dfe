//! What the command line says.

use anyhow::{Context, bail};
use clap::{Parser, ValueEnum};
use foresight_traces::arguments::{self, PathArgs};
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{Flight, TICKS_PER_SECOND};
use foresight_viewer::connection::Address;
use foresight_viewer::crowd::CrowdSettings;
use foresight_viewer::fetch::HttpSettings;
use foresight_viewer::session::Plan;
use foresight_wire::encoding::Encoding;
use foresight_wire::message;
use std::path::PathBuf;
use std::time::Duration;

/// Flies through a world while it streams.
#[derive(Debug, Parser)]
#[command(
    name = "foresight-viewer",
    version,
    after_help = "Examples:\n  foresight-viewer --server http://127.0.0.1:8080 --no-draw --world city:blocks=20 --path steady:speed=10,duration=60\n  \
    foresight-viewer --server http://127.0.0.1:8080 --no-draw --session-world mars --path flight.jsonl --memory 64MiB --json\n  \
    foresight-viewer --server http://127.0.0.1:8080 --no-draw --world city:blocks=20 --clients 100 --rate 30 --no-fetch --duration 30 --loop\n\n\
    Exit status: 0; 1 if memory exceeded its budget; 2 for an error, which stderr names."
)]
pub(crate) struct Cli {
    /// The server: http://HOST:PORT
    #[arg(long, value_name = "URL")]
    server: String,
    /// Play without a window: views are sent, contents fetched, decoding is modelled and nothing drawn
    #[arg(long, required = true)]
    no_draw: bool,
    /// The world's name on the server; without it the only one there
    #[arg(long, value_name = "NAME")]
    session_world: Option<String>,
    /// The same world by itself, to place the path in it; without it the path is taken as it is
    #[arg(long, value_name = "WORLD")]
    world: Option<String>,
    /// A recording, or steady, turn (with :speed=5,duration=60), teleport; the built-in flight if not given
    #[arg(long, value_name = "PATH")]
    path: Option<String>,
    #[command(flatten)]
    path_args: PathArgs,
    /// Memory budget: bytes, 256MiB, 1GB
    #[arg(long, default_value = "256MiB", value_name = "SIZE", value_parser = arguments::bytes)]
    memory: u64,
    /// Policy with its options, such as foresight:alpha=0.8; the server's default if not given
    #[arg(long, value_name = "POLICY")]
    policy: Option<String>,
    /// When children may be drawn
    #[arg(long, default_value = "partial", value_name = "KIND")]
    refinement: RefinementWord,
    /// What the server's answers are for: drive (they are obeyed), warm (for clients with rules of their own), shadow
    /// (made and recorded, not sent)
    #[arg(long, default_value = "drive", value_name = "MODE")]
    mode: ModeWord,
    /// Announce the path so many seconds ahead, renewed once a second
    #[arg(long, default_value_t = 0.0, value_name = "SECONDS", value_parser = seconds)]
    announce: f64,
    /// Name under which the server keeps what it learns of this client's link
    #[arg(long, value_name = "NAME")]
    client: Option<String>,
    /// How messages are written
    #[arg(long, default_value = "json", value_name = "ENCODING")]
    encoding: EncodingWord,
    /// Fetch over HTTP/2, spoken from the first byte
    #[arg(long)]
    http2: bool,
    /// A request fails when nothing comes for so long
    #[arg(long, default_value_t = 60.0, value_name = "SECONDS", value_parser = seconds)]
    stall: f64,
    /// Token that the server asks for
    #[arg(long, env = "FORESIGHT_TOKEN", hide_env_values = true, value_name = "TOKEN")]
    token: Option<String>,
    /// Decoded bytes per second that each of two workers decodes
    #[arg(long, default_value_t = 200e6, value_name = "BYTES/S")]
    decode_rate: f64,
    /// Decoded bytes uploaded per 1/60 s
    #[arg(long, default_value_t = 8 << 20, value_name = "BYTES")]
    upload_budget: u64,
    /// Views a second: 60, or what divides it
    #[arg(long, default_value_t = 60, value_name = "N")]
    rate: u64,
    /// Write what happens to each representation into this file, JSON lines
    #[arg(long, value_name = "FILE", conflicts_with = "clients")]
    events: Option<PathBuf>,
    /// So many independent sessions at seeded places of the path, which they fly round and round
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=100_000))]
    clients: Option<u64>,
    /// With --clients: sessions end after so many seconds in the mean, one in four without a word, and others come
    #[arg(long, value_name = "SECONDS", value_parser = seconds, requires = "clients")]
    stay: Option<f64>,
    /// With --clients: answers in the first so many seconds are not timed
    #[arg(long, default_value_t = 0.0, value_name = "SECONDS", value_parser = seconds, requires = "clients")]
    warm_up: f64,
    /// With --clients: seed of the places and of the lengths
    #[arg(long, default_value_t = 1, requires = "clients")]
    seed: u64,
    /// Fetch nothing: each session's requests are carried by a modelled link of its own
    #[arg(long)]
    no_fetch: bool,
    /// The modelled link, as `foresight-sim replay` takes it
    #[arg(long, default_value = "constant:20Mbit,40ms", value_name = "LINK", requires = "no_fetch")]
    link: String,
    /// Threads; as many as there are processors if not given
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub(crate) threads: Option<u32>,
    /// Print one JSON document
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum RefinementWord {
    Partial,
    Atomic,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum ModeWord {
    Drive,
    Warm,
    Shadow,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum EncodingWord {
    Json,
    Messagepack,
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| (0.0..=86_400.0).contains(seconds));
    seconds.ok_or_else(|| format!("`{text}`; expected seconds from 0 to 86400"))
}

impl Cli {
    /// Where what happens is written.
    pub(crate) fn events(&self) -> Option<&std::path::Path> {
        self.events.as_deref()
    }

    /// Settings of the requests.
    pub(crate) fn http(&self) -> HttpSettings {
        HttpSettings { http2: self.http2, stall: Duration::from_secs_f64(self.stall), token: self.token.clone() }
    }

    /// What every session has in common.
    pub(crate) fn plan(&self) -> anyhow::Result<Plan> {
        if self.rate == 0 || !TICKS_PER_SECOND.is_multiple_of(self.rate) {
            bail!("--rate {}; expected 60 or what divides it", self.rate);
        }
        if self.decode_rate.is_nan() || self.decode_rate <= 0.0 || self.upload_budget == 0 {
            bail!(
                "--decode-rate {} and --upload-budget {}; expected more than 0",
                self.decode_rate,
                self.upload_budget
            );
        }
        let encoding = match self.encoding {
            EncodingWord::Json => Encoding::Json,
            EncodingWord::Messagepack => Encoding::MessagePack,
        };
        let refinement = match self.refinement {
            RefinementWord::Partial => message::Refinement::Partial,
            RefinementWord::Atomic => message::Refinement::Atomic,
        };
        let mode = match self.mode {
            ModeWord::Drive => message::Mode::Drive,
            ModeWord::Warm => message::Mode::Warm,
            ModeWord::Shadow => message::Mode::Shadow,
        };
        Ok(Plan {
            address: Address::new(&self.server, encoding, self.token.clone())?,
            world: self.session_world.clone().unwrap_or_default(),
            has_files: false,
            memory: self.memory,
            policy: self.policy.clone(),
            refinement,
            mode,
            client: self.client.clone(),
            settings: ClientSettings {
                decode_rate: self.decode_rate,
                upload_bytes_per_tick: self.upload_budget,
                announce_s: self.announce,
                ..ClientSettings::default()
            },
            ticks_per_view: TICKS_PER_SECOND / self.rate,
            modelled: if self.no_fetch { Some(arguments::open_link(Some(&self.link))?) } else { None },
        })
    }

    /// The camera's path, placed.
    pub(crate) fn path(&self) -> anyhow::Result<Flight> {
        let path = arguments::open_path(self.path.as_deref(), &self.path_args).context("--path")?;
        let Some(world) = &self.world else { return arguments::sample(&path, &self.path_args) };
        let world = arguments::world_named(world).context("--world")?;
        // The built-in flight stands in the built-in world as it is.
        let as_is = self.path.is_none() && world.hash() == foresight_index::world::built_in_city().hash();
        Ok(arguments::place(&path, &world, as_is, &self.path_args)?.flight)
    }

    /// How many fly at once, if more than one does.
    pub(crate) fn crowd(&self, path: &Flight) -> Option<CrowdSettings> {
        Some(CrowdSettings {
            clients: self.clients?,
            duration_s: path.duration().secs(),
            stay_s: self.stay.filter(|&stay| stay > 0.0),
            warm_up_s: self.warm_up,
            seed: self.seed,
        })
    }
}
