//! Prints how many files a second the server delivers, beside nginx on the same folder.

use std::path::PathBuf;

use clap::Parser;
use foresight_tests::delivery::{Plan, compare};

/// Compares static delivery with nginx on the same folder: requests per second and 99th percentile, medians of rounds in turn
///
/// Needs nginx and wrk, which it installs with apt-get where it can. Both servers and wrk share this machine's cores, so
/// only ratios within one run mean anything. Build the server for speed first: cargo build --release -p foresight-server.
#[derive(Parser)]
#[command(
    after_help = "Example:\n  cargo build --release -p foresight-server && cargo run -p foresight-tests --bin delivery -- \
--program target/release/foresight-server"
)]
struct Arguments {
    /// foresight-server as it is to be measured
    #[arg(long, value_name = "FILE")]
    program: PathBuf,
    /// Seconds of each round
    #[arg(long, value_name = "S", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=600))]
    seconds: u32,
    /// Rounds of each server
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=100))]
    rounds: u32,
    /// Sizes of the files, bytes
    #[arg(long, value_name = "BYTES", value_delimiter = ',', default_value = "2000,1000000")]
    bytes: Vec<usize>,
    /// Connections that are kept busy
    #[arg(long, value_name = "N", value_delimiter = ',', default_value = "1,16,64", value_parser = clap::value_parser!(u32).range(1..=1000))]
    connections: Vec<u32>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments = Arguments::parse();
    let plan = Plan {
        program: arguments.program,
        seconds: arguments.seconds,
        rounds: arguments.rounds as usize,
        bytes: arguments.bytes,
        connections: arguments.connections,
    };
    let measured = compare(&plan, |what| eprintln!("{what}"))?;
    if arguments.json {
        println!("{}", serde_json::json!({ "schema_version": 1, "delivery": measured }));
        return Ok(());
    }
    println!("    bytes  connections   ours req/s  nginx req/s  ratio   ours p99 ms  nginx p99 ms  ratio  errors");
    for pair in measured.chunks_exact(2) {
        let (ours, nginx) = (&pair[0], &pair[1]);
        println!(
            "{:9}  {:11}  {:11.0}  {:11.0}  {:5.2}  {:12.3}  {:12.3}  {:5.2}  {:6}",
            ours.bytes,
            ours.connections,
            ours.requests_per_second,
            nginx.requests_per_second,
            ours.requests_per_second / nginx.requests_per_second,
            ours.p99_ms,
            nginx.p99_ms,
            ours.p99_ms / nginx.p99_ms,
            ours.errors + nginx.errors
        );
    }
    Ok(())
}
