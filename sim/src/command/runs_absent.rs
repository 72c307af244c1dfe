//! Stands where `runs` is in a build with the store of past runs, and says how to build that.

use super::replay::ReplayArgs;
use anyhow::bail;
use clap::Args;
use foresight_sim::outcome::Comparison;
use foresight_sim::stopwatch::Stopwatch;

#[derive(Debug, Args)]
#[command(
    after_help = "This build has no store of runs; one that has:\n  cargo run --release --features runs -- runs list"
)]
pub(crate) struct RunsArgs {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    words: Vec<String>,
}

pub(crate) fn run(args: &RunsArgs) -> anyhow::Result<()> {
    bail!(
        "this build has no store of runs; expected `cargo run --release --features runs -- runs {}`",
        args.words.join(" ")
    );
}

/// There is none in this build.
pub(crate) enum Recorder {}

impl Recorder {
    /// Always refuses.
    pub(crate) fn open(_store: &str) -> anyhow::Result<Recorder> {
        bail!(
            "--store: this build has no store of runs; expected one built with `--features runs`: cargo run --release --features runs -- …"
        );
    }

    pub(crate) fn record(
        &mut self,
        _comparison: &Comparison,
        _args: &ReplayArgs,
        _watch: Stopwatch,
        _line: Option<(&str, &[String])>,
    ) -> anyhow::Result<String> {
        match *self {}
    }
}
