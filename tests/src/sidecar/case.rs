//! One flight, live over real sockets and simulated.

use std::path::Path;
use std::time::Duration;

use clap::{Args, Parser};
use foresight_scheduler::benefit::coverage::Refinement;
use foresight_scheduler::benefit::cut::{Cut, CutSettings};
use foresight_scheduler::policy::specification::{PolicySpec, Trust};
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_scheduler::units::Time;
use foresight_sim::pressure::Needs;
use foresight_sim::replay::{Run, Stage, replay};
use foresight_traces::arguments::{self, PathArgs};
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::Flight;
use foresight_traces::link::LinkTrace;

use super::flown::{self, Flown};
use super::process::{Server, Viewer};
use crate::program;

/// Time that a flight may take beyond its length.
const SLACK: Duration = Duration::from_secs(90);

/// A case as it is written on a command line.
#[derive(Clone, Debug, Args)]
pub struct CaseArgs {
    /// The world
    #[arg(long, value_name = "WORLD")]
    world: String,
    /// The path
    #[arg(long, value_name = "PATH")]
    path: String,
    #[command(flatten)]
    path_args: PathArgs,
    /// The link
    #[arg(long, value_name = "LINK")]
    link: String,
    /// Memory: bytes, 256MiB, 1GB
    #[arg(long, value_name = "SIZE", value_parser = arguments::bytes)]
    memory: u64,
    /// The policy
    #[arg(long, default_value = "foresight", value_name = "POLICY")]
    policy: String,
}

#[derive(Debug, Parser)]
#[command(no_binary_name = true)]
struct Line {
    #[command(flatten)]
    case: CaseArgs,
}

/// A case, opened: what both replays need.
#[derive(Debug)]
pub struct Case {
    /// As given; what the client is given too.
    words: Vec<String>,
    arguments: CaseArgs,
    world: foresight_index::world::World,
    flight: Flight,
    cuts: Vec<Cut>,
    link: LinkTrace,
}

/// What a flight came to.
#[derive(Debug)]
pub struct Live {
    /// The client's log.
    pub flown: Flown,
    /// 1 − Q at every sampled frame.
    pub deficits: Vec<Option<f64>>,
    /// What the client has printed.
    pub summary: serde_json::Value,
}

impl Live {
    /// A figure of the client's summary.
    ///
    /// # Panics
    /// If there is no such number.
    pub fn figure(&self, name: &str) -> f64 {
        self.summary[name].as_f64().unwrap_or_else(|| panic!("{name} in {}", self.summary))
    }

    /// Mean of 1 − Q.
    pub fn deficit(&self) -> f64 {
        flown::mean(&self.deficits)
    }
}

impl Case {
    /// Opens a case: `--world W --path P --link L --memory SIZE` and options of the path. In words that begin with `{data}/` that
    /// stands for the folder of recorded data.
    ///
    /// # Panics
    /// If the line or what it names is at fault.
    pub fn open(line: &str, data: Option<&Path>) -> Case {
        let data = data.map(|data| data.display().to_string()).unwrap_or_default();
        let words: Vec<String> = line.split_whitespace().map(|word| word.replace("{data}", &data)).collect();
        let Line { case } = Line::try_parse_from(&words).unwrap_or_else(|error| panic!("{line}: {error}"));
        Case::new(words, case)
    }

    /// Opens what a command line says; `words` are the same arguments.
    ///
    /// # Panics
    /// If what it names is at fault.
    pub fn new(words: Vec<String>, arguments: CaseArgs) -> Case {
        let world = arguments::world_named(&arguments.world).unwrap_or_else(|error| panic!("{error}"));
        let path = arguments::open_path(Some(&arguments.path), &arguments.path_args);
        let path = path.unwrap_or_else(|error| panic!("{error:#}"));
        let placed = arguments::place(&path, &world, false, &arguments.path_args);
        let flight = placed.unwrap_or_else(|error| panic!("{error:#}")).flight;
        let link = arguments::open_link(Some(&arguments.link)).unwrap_or_else(|error| panic!("{error:#}"));
        let cuts = flight.cuts(&world.tree, &CutSettings::default());
        Case { words, arguments, world, flight, cuts, link }
    }

    /// The world, as `--world` takes it.
    pub fn world(&self) -> &str {
        &self.arguments.world
    }

    /// The link, as `--link` takes it.
    pub fn link(&self) -> &str {
        &self.arguments.link
    }

    /// The world, opened.
    pub fn opened(&self) -> &foresight_index::world::World {
        &self.world
    }

    /// Length, seconds.
    pub fn seconds(&self) -> f64 {
        self.flight.duration().secs()
    }

    /// ρ and μ of the design: what the path needs against what the link brings and what memory holds.
    pub fn pressure(&self) -> (f64, f64) {
        let needs = Needs::new(&self.world.tree, &self.cuts);
        let brings = self.link.bytes_deliverable(Time::ZERO, self.flight.duration());
        let rho = needs.union_bytes as f64 / brings.max(1) as f64;
        (rho, self.arguments.memory as f64 / needs.largest_bytes.max(1) as f64)
    }

    /// Wire bytes of a representation.
    pub fn wire_bytes(&self, rep: u32) -> u64 {
        self.world.tree.wire_bytes(foresight_scheduler::lod_tree::RepId(rep))
    }

    /// The case's words but for these options and their values.
    fn words_without(&self, options: &[&str]) -> Vec<&str> {
        let mut words = self.words.iter().map(String::as_str);
        let mut kept = Vec::new();
        while let Some(word) = words.next() {
            if options.contains(&word) {
                words.next();
            } else {
                kept.push(word);
            }
        }
        kept
    }

    /// Begins the flight with the headless client; `log` is where it writes its events.
    pub fn start(&self, folder: &Path, server: &str, log: &str, options: &[&str]) -> Viewer {
        // The link is the server's.
        let mut given = self.words_without(&["--link"]);
        given.extend(["--events", log, "--json"]);
        given.extend(options);
        Viewer::start(folder, server, None, &given)
    }

    /// Waits for the end of a flight that was begun with [`Case::start`].
    ///
    /// # Panics
    /// If it does not end well.
    pub fn finish(&self, folder: &Path, viewer: Viewer, log: &str) -> Live {
        let ended = viewer.finish(Duration::from_secs_f64(self.seconds()) + SLACK);
        assert_eq!(ended.code, Some(0), "{}\n{}", ended.stdout, ended.stderr);
        let summary = serde_json::from_str(&ended.stdout).expect("the summary is JSON");
        let flown = Flown::read(&folder.join(log));
        let deficits = flown.deficits(&self.world.tree, &self.cuts, Refinement::Partial);
        Live { flown, deficits, summary }
    }

    /// The whole flight against a server.
    ///
    /// # Panics
    /// If it does not end well.
    pub fn fly(&self, folder: &Path, server: &Server, log: &str, options: &[&str]) -> Live {
        self.finish(folder, self.start(folder, &server.url(), log, options), log)
    }

    /// What `foresight-sim replay --session` makes of the one recording in a server's folder of recordings: whether its
    /// decisions are made again, what was seen, and the simulator's flight over the same link.
    ///
    /// # Panics
    /// If there is not exactly one, or it is refused.
    pub fn replay_recording(&self, folder: &Path) -> serde_json::Value {
        let entries = std::fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
        let files: Vec<String> = entries.map(|entry| entry.expect("an entry").path().display().to_string()).collect();
        assert_eq!(files.len(), 1, "{files:?}");
        let mut words = vec!["replay", "--session", &files[0], "--json"];
        // The recording has them.
        words.extend(self.words_without(&["--memory", "--policy"]));
        let replayed = program::sim(folder, &words, SLACK);
        assert_eq!(replayed.code, Some(0), "{}", replayed.stderr);
        let document: serde_json::Value = serde_json::from_str(&replayed.stdout).expect("the outcome is JSON");
        document["sessions"][0].clone()
    }

    /// The same flight in the simulator.
    ///
    /// # Panics
    /// If the policy is unknown or fails.
    pub fn simulate(&self) -> (Run, Vec<Option<f64>>) {
        let trust: Trust = "adapted".parse().expect("a word for trust");
        let policies = PolicySpec::parse_list(&self.arguments.policy, trust, None);
        let policy = policies.unwrap_or_else(|error| panic!("{error}")).remove(0);
        let stage = Stage {
            tree: &self.world.tree,
            flight: &self.flight,
            cuts: &self.cuts,
            link: &self.link,
            link_start: Time::ZERO,
            client: ClientSettings::default(),
            scheduler: SchedulerSettings::with_budget(self.arguments.memory),
            preloaded: &[],
        };
        let run = replay(stage, policy.build(&self.world.tree)).unwrap_or_else(|error| panic!("{error}"));
        let deficits = run.frames.iter().map(|frame| frame.mean().map(|quality| 1.0 - quality)).collect();
        (run, deficits)
    }
}
