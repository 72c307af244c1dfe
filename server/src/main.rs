//! `foresight-server`.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use foresight_server::{build, serve};

/// Builds worlds, serves them over HTTP, and tells clients what to fetch next.
#[derive(Debug, Parser)]
#[command(
    name = "foresight-server",
    version,
    after_help = "Examples:\n  foresight-server build --input tiles/tileset.json --out world/\n  foresight-server serve --world tiles/\n  foresight-server serve --world old=tiles-2024/ --world new=tiles/ --link constant:20Mbit,40ms"
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Builds a stored world: orthoviews and geometry that any web server can serve.
    Build(Box<build::BuildArgs>),
    /// Serves worlds, and hosts sessions for clients that fly through them.
    Serve(Box<serve::ServeArgs>),
}

fn main() -> ExitCode {
    let ended = match Cli::parse().command {
        Command::Build(arguments) => build::run(&arguments),
        Command::Serve(arguments) => serve::run(&arguments),
    };
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", message(&error));
            ExitCode::from(2)
        }
    }
}

/// The error and its causes, each said once: many name their cause in their own text.
fn message(error: &anyhow::Error) -> String {
    error.chain().skip(1).map(ToString::to_string).fold(error.to_string(), |message, cause| {
        if message.contains(&cause) { message } else { format!("{message}: {cause}") }
    })
}
