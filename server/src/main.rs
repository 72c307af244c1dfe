//! `foresight-server`.

use clap::Parser;

/// Serves worlds over HTTP and tells clients what to fetch next.
#[derive(Debug, Parser)]
#[command(name = "foresight-server", version)]
struct Cli {}

fn main() {
    Cli::parse();
}
