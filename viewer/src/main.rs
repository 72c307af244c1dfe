//! `foresight-viewer`.

mod arguments;
#[cfg(feature = "draw")]
mod frames;
mod no_draw;
#[cfg(feature = "window")]
mod windowed;

use anyhow::Context;
use arguments::{Cli, Way};
use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => {
            eprintln!("error: memory exceeded its budget");
            ExitCode::FAILURE
        }
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

/// Whether memory stayed within its budget.
fn run(cli: &Cli) -> anyhow::Result<bool> {
    match cli.way() {
        Way::NoDraw => no_draw::run(cli),
        Way::Headless => headless(cli),
        Way::Window => window(cli),
    }
}

/// Threads for what waits for sockets.
fn runtime(threads: Option<u32>) -> anyhow::Result<tokio::runtime::Runtime> {
    let mut runtime = tokio::runtime::Builder::new_multi_thread();
    if let Some(threads) = threads {
        runtime.worker_threads(threads as usize);
    }
    runtime.enable_all().build().context("starting threads")
}

#[cfg(feature = "draw")]
fn headless(cli: &Cli) -> anyhow::Result<bool> {
    frames::run(cli)
}

#[cfg(not(feature = "draw"))]
fn headless(cli: &Cli) -> anyhow::Result<bool> {
    anyhow::bail!(
        "this build draws nothing: --frames {:?} needs its feature `draw`; expected --no-draw",
        cli.headless_args.frames
    )
}

#[cfg(feature = "window")]
fn window(cli: &Cli) -> anyhow::Result<bool> {
    windowed::run(cli)
}

#[cfg(not(feature = "window"))]
fn window(cli: &Cli) -> anyhow::Result<bool> {
    let others = if cfg!(feature = "draw") { "--headless or --no-draw" } else { "--no-draw" };
    anyhow::bail!(
        "this build opens no window: --controls {:?} needs its feature `window`; expected {others}",
        cli.window_args.controls
    )
}
