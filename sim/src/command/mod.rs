//! The command line: parsing, and one module a command.

mod accuracy;
mod alpha_sweep;
mod generate;
mod inspect;
mod replay;
#[cfg(feature = "runs")]
mod runs;
#[cfg(not(feature = "runs"))]
#[path = "runs_absent.rs"]
mod runs;
mod session;
mod suite;

use clap::{Parser, Subcommand};

/// Replays recorded camera paths over large 3D worlds and recorded links, and compares what prefetch policies make of
/// them. Without a command: the built-in city, flight and link, with all policies, and a report in ./report.
#[derive(Debug, Parser)]
#[command(
    name = "foresight-sim",
    version,
    after_help = "Examples:\n  foresight-sim\n  foresight-sim replay --world tiles/ --path walk.txt --link lte.down --memory 256MiB --report out\n  \
                  foresight-sim inspect tiles/ walk.txt lte.down\n  foresight-sim generate mosaic --from tiles/ --grid 16 --out mosaic16"
)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Replays a path over a world and a link with one or more policies.
    Replay(Box<replay::ReplayArgs>),
    /// Tells what a world, path or link contains, its traps, and the pressure to expect.
    Inspect(inspect::InspectArgs),
    /// Runs the named benchmark cases, and sets foresight against each rival.
    Suite(suite::SuiteArgs),
    /// Sets the error of every estimator, method and setting against its run time.
    Accuracy(Box<accuracy::AccuracyArgs>),
    /// The store of past runs: lists, shows, compares, exports and repeats them.
    Runs(runs::RunsArgs),
    /// Makes worlds of any size, and recordings of paths.
    Generate(generate::GenerateArgs),
}

/// Runs the command.
pub(crate) fn run(cli: Cli) -> anyhow::Result<()> {
    match cli.command {
        None => replay::run(replay::ReplayArgs::built_in()),
        Some(Command::Replay(args)) => replay::run(*args),
        Some(Command::Inspect(args)) => inspect::run(&args),
        Some(Command::Suite(args)) => suite::run(&args),
        Some(Command::Accuracy(args)) => accuracy::run(&args),
        Some(Command::Runs(args)) => runs::run(&args),
        Some(Command::Generate(args)) => generate::run(args),
    }
}

/// The options of a stored command line, which is one of `replay`.
#[cfg(feature = "runs")]
fn replay_args(words: &[String]) -> anyhow::Result<replay::ReplayArgs> {
    let cli = Cli::try_parse_from(std::iter::once("foresight-sim").chain(words.iter().map(String::as_str)))?;
    match cli.command {
        Some(Command::Replay(args)) => Ok(*args),
        _ => anyhow::bail!("`{}`; expected a command line of replay", words.join(" ")),
    }
}
