//! What the command line says.
//!
//! One program, three ways to run it: `--no-draw` ([`no_draw`]), `--headless` ([`headless`]), and a window ([`window`]).

pub(crate) mod headless;
pub(crate) mod no_draw;
pub(crate) mod window;

use anyhow::{Context, bail};
use clap::{Parser, ValueEnum};
use foresight_index::world::World;
#[cfg(feature = "draw")]
use foresight_scheduler::benefit::coverage::Refinement;
#[cfg(feature = "draw")]
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_traces::arguments::{self, PathArgs};
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{Flight, TICKS_PER_SECOND};
#[cfg(feature = "draw")]
use foresight_traces::link::LinkTrace;
use foresight_viewer::connection::Address;
#[cfg(feature = "draw")]
use foresight_viewer::draw::environment::EnvironmentSettings;
use foresight_viewer::fetch::HttpSettings;
#[cfg(feature = "draw")]
use foresight_viewer::gpu::Sky;
#[cfg(feature = "draw")]
use foresight_viewer::scene::compress::Compression;
#[cfg(feature = "draw")]
use foresight_viewer::scene::source::Source;
use foresight_viewer::session::Plan;
use foresight_wire::encoding::Encoding;
use foresight_wire::message;
use headless::HeadlessArgs;
use no_draw::{ModeWord, NoDrawArgs};
use std::time::Duration;
use window::WindowArgs;

/// Flies through a world while it streams.
#[derive(Debug, Parser)]
#[command(
    name = "foresight-viewer",
    version,
    after_help = "Examples:\n  foresight-viewer --world mars\n  \
    foresight-viewer --world mars --path flight.jsonl --link constant:20Mbit,40ms --memory 64MiB\n  \
    foresight-viewer --server http://127.0.0.1:8080 --world mars\n  \
    foresight-viewer --world mars --path flight.jsonl --headless --frames frames\n  \
    foresight-viewer --world mars --environment 2 --memory 1GiB\n  \
    foresight-viewer --world belt --sky space --textures small\n  \
    foresight-viewer --server http://127.0.0.1:8080 --no-draw --world city:blocks=20 --path steady:speed=10,duration=60\n  \
    foresight-viewer --server http://127.0.0.1:8080 --no-draw --session-world mars --path flight.jsonl --memory 64MiB --json\n  \
    foresight-viewer --server http://127.0.0.1:8080 --no-draw --world city:blocks=20 --clients 100 --rate 30 --no-fetch --duration 30 --loop\n\n\
    Exit status: 0; 1 if memory exceeded its budget; 2 for an error, which stderr names."
)]
pub(crate) struct Cli {
    /// The server: http://HOST:PORT. Without it the scheduler runs in this program, and contents come from the world itself
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    /// Play without a picture: views are sent, contents fetched, decoding is modelled and nothing drawn
    #[arg(long, requires = "server", conflicts_with = "headless")]
    no_draw: bool,
    /// Draw into files on a virtual clock, without a window
    #[arg(long, requires = "frames")]
    headless: bool,
    /// The world's name on the server; without it the only one there
    #[arg(long, value_name = "NAME", requires = "server")]
    session_world: Option<String>,
    /// The world: a folder, a file, or a generated one. With --no-draw it places the path, which without it is taken as it is
    #[arg(long, value_name = "WORLD")]
    world: Option<String>,
    /// A recording, or steady, turn (with :speed=5,duration=60), teleport. If not given: in a window the camera is moved by
    /// hand, else the built-in flight is flown
    #[arg(long, value_name = "PATH")]
    path: Option<String>,
    #[command(flatten)]
    pub(crate) path_args: PathArgs,
    /// Memory budget: bytes, 256MiB, 1GB
    #[arg(long, default_value = "256MiB", value_name = "SIZE", value_parser = arguments::bytes)]
    pub(crate) memory: u64,
    /// Policy with its options, such as foresight:alpha=0.8; the server's default, or foresight, if not given
    #[arg(long, value_name = "POLICY")]
    pub(crate) policy: Option<String>,
    /// Views a second with --no-draw, 60 if not given; pictures a second with --headless, 2 if not given: 60 or what
    /// divides it
    #[arg(long, value_name = "N")]
    rate: Option<u64>,
    /// When children may be drawn
    #[arg(long, default_value = "partial", value_name = "KIND")]
    refinement: RefinementWord,
    /// Announce the path so many seconds ahead, renewed once a second
    #[arg(long, default_value_t = 0.0, value_name = "SECONDS", value_parser = seconds)]
    pub(crate) announce: f64,
    /// A modelled link, as `foresight-sim replay` takes it, without a server or with --no-fetch (there and with --headless
    /// constant:20Mbit,40ms if not given); without it contents come as fast as they can be read
    #[arg(long, value_name = "LINK")]
    link: Option<String>,
    /// Name under which the server keeps what it learns of this client's link
    #[arg(long, value_name = "NAME", requires = "server")]
    client: Option<String>,
    /// How messages are written
    #[arg(long, default_value = "json", value_name = "ENCODING", requires = "server")]
    encoding: EncodingWord,
    /// Fetch over HTTP/2, spoken from the first byte
    #[arg(long, requires = "server")]
    http2: bool,
    /// A request fails when nothing comes for so long
    #[arg(long, default_value_t = 60.0, value_name = "SECONDS", value_parser = seconds, requires = "server")]
    stall: f64,
    /// Token that the server asks for
    #[arg(long, env = "FORESIGHT_TOKEN", hide_env_values = true, value_name = "TOKEN")]
    token: Option<String>,
    /// What is far is drawn from environment maps, which are made while it is flown: cells of SIDE metres, far being what is
    /// more than eight sides away; auto takes a 64th of the world's largest side. Half the memory is kept for them
    #[arg(long, value_name = "SIDE", num_args = 0..=1, default_missing_value = "auto", value_parser = environment, conflicts_with = "no_draw")]
    environment: Option<EnvironmentWord>,
    /// How colours, normals and textures are kept on the GPU, where it has block-compressed textures: none (as they are), fine
    /// (BC7, BC5) or small (BC1, BC3, BC5)
    #[arg(long, default_value = "none", value_name = "HOW", conflicts_with = "no_draw")]
    textures: TexturesWord,
    /// What is behind everything: horizon, space (dark all round), or auto: space where the world has no ground
    #[arg(long, default_value = "auto", value_name = "WHAT", conflicts_with = "no_draw")]
    sky: SkyWord,
    /// Threads; as many as there are processors if not given
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub(crate) threads: Option<u32>,
    /// Print one JSON document
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) no_draw_args: NoDrawArgs,
    #[command(flatten)]
    pub(crate) headless_args: HeadlessArgs,
    #[command(flatten)]
    pub(crate) window_args: WindowArgs,
}

/// Ways to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    NoDraw,
    Headless,
    Window,
}

/// What `--environment` says.
#[derive(Clone, Copy, Debug, PartialEq)]
enum EnvironmentWord {
    Auto,
    Side(f64),
}

fn environment(text: &str) -> Result<EnvironmentWord, String> {
    if text == "auto" {
        return Ok(EnvironmentWord::Auto);
    }
    let side = text.parse::<f64>().ok().filter(|side| (1e-3..=1e9).contains(side));
    side.map(EnvironmentWord::Side).ok_or_else(|| format!("`{text}`; expected auto, or metres from 0.001 to 1e9"))
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum TexturesWord {
    None,
    Fine,
    Small,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum SkyWord {
    Auto,
    Horizon,
    Space,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum RefinementWord {
    Partial,
    Atomic,
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

/// The link of `--no-fetch` and of `--headless` if none is given.
pub(crate) const LINK: &str = "constant:20Mbit,40ms";

impl Cli {
    /// How it is to run.
    pub(crate) fn way(&self) -> Way {
        match (self.no_draw, self.headless) {
            (true, _) => Way::NoDraw,
            (_, true) => Way::Headless,
            _ => Way::Window,
        }
    }

    /// Settings of the requests.
    pub(crate) fn http(&self) -> HttpSettings {
        HttpSettings { http2: self.http2, stall: Duration::from_secs_f64(self.stall), token: self.token.clone() }
    }

    /// Ticks from one view, or picture, to the next; `default` of them are made a second where nothing is said.
    pub(crate) fn ticks(&self, default: u64) -> anyhow::Result<u64> {
        let rate = self.rate.unwrap_or(default);
        if rate == 0 || !TICKS_PER_SECOND.is_multiple_of(rate) {
            bail!("--rate {rate}; expected 60 or what divides it");
        }
        Ok(TICKS_PER_SECOND / rate)
    }

    /// The modelled link, if one is asked for.
    #[cfg(feature = "draw")]
    pub(crate) fn link(&self) -> anyhow::Result<Option<LinkTrace>> {
        self.link.as_deref().map(|link| arguments::open_link(Some(link)).context("--link")).transpose()
    }

    /// The server's address, if there is a server.
    #[cfg(feature = "draw")]
    pub(crate) fn server(&self) -> Option<&str> {
        self.server.as_deref()
    }

    /// What every session has in common.
    pub(crate) fn plan(&self) -> anyhow::Result<Plan> {
        let NoDrawArgs { decode_rate, upload_budget, no_fetch, mode, .. } = &self.no_draw_args;
        if decode_rate.is_nan() || *decode_rate <= 0.0 || *upload_budget == 0 {
            bail!("--decode-rate {decode_rate} and --upload-budget {upload_budget}; expected more than 0");
        }
        if self.link.is_some() && !no_fetch {
            bail!("--link is modelled, and a server has a link of its own: with --server it needs --no-fetch");
        }
        let server = self.server.as_deref().context("a session needs --server URL")?;
        let encoding = match self.encoding {
            EncodingWord::Json => Encoding::Json,
            EncodingWord::Messagepack => Encoding::MessagePack,
        };
        let refinement = match self.refinement {
            RefinementWord::Partial => message::Refinement::Partial,
            RefinementWord::Atomic => message::Refinement::Atomic,
        };
        let mode = match mode {
            ModeWord::Drive => message::Mode::Drive,
            ModeWord::Warm => message::Mode::Warm,
            ModeWord::Shadow => message::Mode::Shadow,
        };
        Ok(Plan {
            address: Address::new(server, encoding, self.token.clone())?,
            world: self.session_world.clone().unwrap_or_default(),
            has_files: false,
            memory: self.contents_memory(),
            policy: self.policy.clone(),
            refinement,
            mode,
            client: self.client.clone(),
            settings: ClientSettings {
                decode_rate: *decode_rate,
                upload_bytes_per_tick: *upload_budget,
                announce_s: self.announce,
                ..ClientSettings::default()
            },
            ticks_per_view: self.ticks(TICKS_PER_SECOND)?,
            modelled: if *no_fetch {
                Some(arguments::open_link(Some(self.link.as_deref().unwrap_or(LINK)))?)
            } else {
                None
            },
        })
    }

    /// What `--world` says.
    #[cfg(feature = "draw")]
    pub(crate) fn world_name(&self) -> Option<&str> {
        self.world.as_deref()
    }

    /// What `--environment` asks for in a world.
    #[cfg(feature = "draw")]
    pub(crate) fn environment(&self, world: &World) -> Option<EnvironmentSettings> {
        Some(match self.environment? {
            EnvironmentWord::Auto => EnvironmentSettings::for_world(&world.tree.bounds(world.tree.root())),
            EnvironmentWord::Side(side) => EnvironmentSettings::with_side(side),
        })
    }

    /// What `--textures` says.
    #[cfg(feature = "draw")]
    pub(crate) fn compression(&self) -> Compression {
        match self.textures {
            TexturesWord::None => Compression::None,
            TexturesWord::Fine => Compression::Fine,
            TexturesWord::Small => Compression::Small,
        }
    }

    /// What `--sky` says of a world.
    #[cfg(feature = "draw")]
    pub(crate) fn sky(&self, world: &World, source: &Source) -> Sky {
        match self.sky {
            SkyWord::Auto => source.sky(world),
            SkyWord::Horizon => Sky::Horizon,
            SkyWord::Space => Sky::Space,
        }
    }

    /// Memory for what is fetched: half of it where environment maps are asked for.
    pub(crate) fn contents_memory(&self) -> u64 {
        if self.environment.is_some() { self.memory / 2 } else { self.memory }
    }

    /// Memory and refinement of a scheduler in this program.
    #[cfg(feature = "draw")]
    pub(crate) fn scheduler(&self) -> SchedulerSettings {
        let refinement = match self.refinement {
            RefinementWord::Partial => Refinement::Partial,
            RefinementWord::Atomic => Refinement::Atomic,
        };
        SchedulerSettings { refinement, ..SchedulerSettings::with_budget(self.contents_memory()) }
    }

    /// The world, if one is named.
    pub(crate) fn world(&self) -> anyhow::Result<Option<World>> {
        self.world.as_deref().map(|world| arguments::world_named(world).context("--world")).transpose()
    }

    /// What `--rate` says.
    #[cfg(feature = "window")]
    pub(crate) fn rate(&self) -> Option<u64> {
        self.rate
    }

    /// Whether a path is named.
    #[cfg(feature = "window")]
    pub(crate) fn has_path(&self) -> bool {
        self.path.is_some()
    }

    /// The camera's path, placed in `world` if it is there.
    pub(crate) fn path(&self, world: Option<&World>) -> anyhow::Result<Flight> {
        let path = arguments::open_path(self.path.as_deref(), &self.path_args).context("--path")?;
        let Some(world) = world else { return arguments::sample(&path, &self.path_args) };
        // The built-in flight stands in the built-in world as it is.
        let as_is = self.path.is_none() && world.hash() == foresight_index::world::built_in_city().hash();
        Ok(arguments::place(&path, world, as_is, &self.path_args)?.flight)
    }
}
