//! `foresight-viewer`.

use clap::Parser;

/// Flies through a world while it streams.
#[derive(Debug, Parser)]
#[command(name = "foresight-viewer", version)]
struct Cli {}

fn main() {
    Cli::parse();
}
