//! Plays flights over real sockets and in the simulator, and prints how far apart they are.

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;
use foresight_tests::sidecar::case::Case;
use foresight_tests::sidecar::flown;
use foresight_tests::sidecar::process::Server;

/// Plays flights with the real server under a shaped link and the headless client, and the same in the simulator.
#[derive(Debug, Parser)]
#[command(
    after_help = "Example:\n  live\n  live --case '--world city:blocks=20 --path steady:speed=10,duration=45 --link constant:20Mbit,40ms --memory 64MiB'"
)]
struct Cli {
    /// A case as one argument: --world W --path P --link L --memory SIZE and options of the path; a starved, a matched and an
    /// ample one if none is given
    #[arg(long = "case", value_name = "LINE", allow_hyphen_values = true)]
    cases: Vec<String>,
    /// Options of the client, separated by spaces, such as '--http2 --encoding messagepack'
    #[arg(long, default_value = "", value_name = "OPTIONS", allow_hyphen_values = true)]
    client: String,
    /// How often each is flown
    #[arg(long, default_value_t = 1, value_name = "N")]
    times: u32,
    /// Fail where a deficit differs by more than this many percent, or a decision is not made again
    #[arg(long, value_name = "PERCENT")]
    at_most: Option<f64>,
    /// Only simulate, to see pressure and deficit
    #[arg(long)]
    simulated: bool,
}

/// A generated city and a mosaic of real tiles, each over a starved, a matched and an ample link.
const CASES: [&str; 6] = [
    "--world city:blocks=20 --path steady:speed=10,duration=45 --link constant:0.8Mbit,40ms --memory 64MiB",
    "--world city:blocks=20 --path steady:speed=10,duration=45 --link constant:2Mbit,40ms --memory 64MiB",
    "--world city:blocks=20 --path steady:speed=10,duration=45 --link constant:8Mbit,40ms --memory 64MiB",
    "--world mosaic:{data}/scenes/mars_dingo_gap_3dtiles,grid=16 --path {data}/paths/walk_udel_gore.txt --duration 45 \
     --link {data}/network/norway3g_car_10.txt,scale=3 --memory 120MiB",
    "--world mosaic:{data}/scenes/mars_dingo_gap_3dtiles,grid=16 --path {data}/paths/walk_udel_gore.txt --duration 45 \
     --link {data}/network/mahimahi_ATT-LTE-driving.down,scale=6 --memory 120MiB",
    "--world mosaic:{data}/scenes/mars_dingo_gap_3dtiles,grid=16 --path {data}/paths/walk_udel_gore.txt --duration 45 \
     --link {data}/network/mahimahi_ATT-LTE-driving.down,scale=20 --memory 120MiB",
];

fn main() -> ExitCode {
    let mut apart = false;
    let cli = Cli::parse();
    let data = foresight_tests::data_folder();
    let own = CASES.iter().filter(|line| data.is_some() || !line.contains("{data}")).map(ToString::to_string);
    let cases: Vec<String> = if cli.cases.is_empty() { own.collect() } else { cli.cases };
    let options: Vec<&str> = cli.client.split_whitespace().collect();
    for line in cases {
        let case = Case::open(&line, data.as_deref());
        let (rho, mu) = case.pressure();
        let (run, simulated) = case.simulate();
        let d_simulated = flown::mean(&simulated);
        say(&format!(
            "{line}\n  ρ = {rho:.2}, μ = {mu:.2}; simulated: deficit {d_simulated:.4}, {} requests, {:.2} MB",
            run.requests.len(),
            run.bytes_fetched as f64 / 1e6
        ));
        for _ in 0..if cli.simulated { 0 } else { cli.times } {
            let folder = tempfile::tempdir().expect("a temporary folder");
            let served = ["--world", case.world(), "--link", case.link(), "--record", "recordings"];
            let server = Server::start(folder.path(), &served);
            let live = case.fly(folder.path(), &server, "events.jsonl", &options);
            let d_live = live.deficit();
            let difference = (d_live - d_simulated).abs() / d_simulated.max(1e-3);
            let requests = live.flown.requests();
            let common = requests.iter().zip(&run.requests).take_while(|(live, sim)| live.1 == sim.rep.0).count();
            let mut shifts: Vec<f64> = requests
                .iter()
                .zip(&run.requests)
                .take(common)
                .map(|(live, sim)| (live.0 as f64 - sim.at.0 as f64) / 1e6)
                .collect();
            shifts.sort_by(f64::total_cmp);
            let mut latencies = live.flown.latencies_s();
            latencies.sort_by(f64::total_cmp);
            // By reason.
            let failed = live.summary["failed"].as_object().into_iter().flatten();
            let failed: u64 = failed.filter_map(|(_, count)| count.as_u64()).sum();
            say(&format!(
                "  live:      deficit {d_live:.4}, {} requests, {:.2} MB, difference {:.2} %\n  the first {common} requests are the same; these came {:.1} ms later (median), {:.1} ms (most)\n  \
                 first byte after {:.1} ms (median); ticks {:.1} ms late at most, {} left out; {} bytes of memory of {}; {failed} failed",
                requests.len(),
                live.figure("bytes_received") / 1e6,
                difference * 100.0,
                shifts.get(shifts.len() / 2).copied().unwrap_or_default(),
                shifts.last().copied().unwrap_or_default(),
                latencies.get(latencies.len() / 2).copied().unwrap_or_default() * 1e3,
                live.figure("tick_late_ms_max"),
                live.figure("ticks_skipped"),
                live.figure("memory_max"),
                live.figure("memory_budget"),
            ));
            server.stop();
            let replayed = case.replay_recording(&folder.path().join("recordings"));
            let (agreement, again) = (&replayed["agreement"], &replayed["simulated"]);
            if let Some(percent) = cli.at_most {
                // Whatever is no number is too far apart.
                let near = difference * 100.0 <= percent;
                apart |= !near || agreement["decisions_equal"] != agreement["decisions"];
            }
            say(&format!(
                "  recorded:  deficit {:.4}; {} of {} decisions are made again; {:.2} % from the simulator's {:.4}",
                replayed["live"]["mean_deficit"].as_f64().unwrap_or(f64::NAN),
                agreement["decisions_equal"],
                agreement["decisions"],
                again["relative_difference"].as_f64().unwrap_or(f64::NAN) * 100.0,
                again["outcome"]["mean_deficit"].as_f64().unwrap_or(f64::NAN)
            ));
        }
    }
    if apart { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

fn say(line: &str) {
    // Whoever reads it may have seen enough.
    let _ = writeln!(std::io::stdout(), "{line}");
}
