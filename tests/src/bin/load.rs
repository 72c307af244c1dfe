//! How many moving sessions one core holds, what a session takes of memory, and whether memory stays flat for long.

use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use foresight_tests::program::Ended;
use foresight_tests::sidecar::process::{Server, Viewer};
use foresight_tests::sidecar::slope::{self, Slope};

/// Largest 99th percentile of view → decision that counts as held, milliseconds.
const HELD_MS: f64 = 20.0;
/// Time between two samples of memory in a soak.
const SAMPLED: Duration = Duration::from_secs(5);
/// Share of a soak in the beginning that is not judged.
const SETTLING: f64 = 0.2;

/// Finds how many sessions one core holds, or soaks a server.
#[derive(Debug, Parser)]
#[command(
    after_help = "Examples:\n  load\n  load --sessions 50,100,200 --seconds 30\n  load --soak 20 --world city:blocks=20 --clients 20 --link constant:20Mbit,40ms"
)]
struct Cli {
    /// The world that all sessions share
    #[arg(long, default_value = "city:blocks=150", value_name = "WORLD")]
    world: String,
    /// The path; each session begins at another place of it
    #[arg(long, default_value = "steady:speed=10,duration=120", value_name = "PATH")]
    path: String,
    /// Memory of each client
    #[arg(long, default_value = "64MiB", value_name = "SIZE")]
    memory: String,
    /// Views a second
    #[arg(long, default_value_t = 30)]
    rate: u32,
    /// Numbers of sessions to try, separated by commas; without it they are doubled until the core is saturated, and then the
    /// last gap is halved three times
    #[arg(long, value_delimiter = ',', value_name = "N,…")]
    sessions: Vec<u64>,
    /// How long each number is held, seconds; the first fifth is not timed
    #[arg(long, default_value_t = 20.0, value_name = "SECONDS")]
    seconds: f64,
    /// Processors of the server, as taskset takes them
    #[arg(long, default_value = "0", value_name = "LIST")]
    server_cores: String,
    /// Processors of the clients
    #[arg(long, default_value = "1", value_name = "LIST")]
    client_cores: String,
    /// Soak: virtual clients come and go for so many minutes, at least 3, and the server's memory has to stay flat
    #[arg(long, value_name = "MINUTES")]
    soak: Option<f64>,
    /// Soak: clients at a time
    #[arg(long, default_value_t = 20, value_name = "N")]
    clients: u64,
    /// Soak: mean length of a session, seconds
    #[arg(long, default_value_t = 15.0, value_name = "SECONDS")]
    stay: f64,
    /// Soak: the server's link, and contents are fetched over it; without it each client's requests are carried by a modelled
    /// link of its own
    #[arg(long, value_name = "LINK")]
    link: Option<String>,
    /// Further options of the server, separated by spaces
    #[arg(long, default_value = "", value_name = "OPTIONS", allow_hyphen_values = true)]
    server: String,
}

/// What came of one number of sessions.
struct Row {
    sessions: u64,
    views_per_second: f64,
    p50_ms: f64,
    p99_ms: f64,
    cpu: f64,
    resident_bytes: f64,
    counted_bytes: f64,
    skipped: u64,
    broken: u64,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    match cli.soak {
        Some(minutes) => soak(&cli, minutes),
        None => curve(&cli),
    }
}

fn say(line: &str) {
    // Whoever reads it may have seen enough.
    let _ = writeln!(std::io::stdout(), "{line}");
}

fn server(cli: &Cli, folder: &std::path::Path, cores: Option<&str>) -> Server {
    let mut options = vec!["--world", cli.world.as_str(), "--sessions-max", "100000"];
    options.extend(["--sessions-per-address-max", "100000", "--keep-session", "5s"]);
    if let Some(link) = &cli.link {
        options.extend(["--link", link]);
    }
    options.extend(cli.server.split_whitespace());
    Server::start_on(folder, 0, cores, &options)
}

fn clients(cli: &Cli, server: &Server, folder: &std::path::Path, count: u64, seconds: f64, more: &[&str]) -> Viewer {
    let (count, seconds, rate) = (count.to_string(), seconds.to_string(), cli.rate.to_string());
    let mut options = vec!["--world", &cli.world, "--path", &cli.path, "--memory", &cli.memory, "--rate", &rate];
    options.extend(["--clients", &count, "--duration", &seconds, "--loop", "--json"]);
    if cli.link.is_none() {
        options.push("--no-fetch");
    }
    options.extend(more);
    Viewer::start(folder, &server.url(), Some(&cli.client_cores), &options)
}

fn summary(ended: &Ended) -> serde_json::Value {
    assert_eq!(ended.code, Some(0), "{}\n{}", ended.stdout, ended.stderr);
    serde_json::from_str(&ended.stdout).expect("the summary is JSON")
}

fn curve(cli: &Cli) -> ExitCode {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut representations = 0.0;
    let mut rows: Vec<Row> = Vec::new();
    say(
        "sessions | views/s | p50 ms | p99 ms | server's core | resident kB/session | counted kB/session | ticks left out | broken",
    );
    let mut measure = |sessions: u64| -> bool {
        let server = server(cli, folder.path(), Some(&cli.server_cores));
        let (_, worlds) = server.get("/worlds");
        let worlds: serde_json::Value = serde_json::from_str(&worlds).expect("a list of worlds");
        representations = worlds[0]["representations"].as_f64().unwrap_or_default();
        let row = hold(cli, &server, folder.path(), sessions);
        server.stop();
        say(&format!(
            "{:8} | {:7.0} | {:6.2} | {:6.2} | {:12.0}% | {:19.0} | {:18.0} | {:14} | {:6}",
            row.sessions,
            row.views_per_second,
            row.p50_ms,
            row.p99_ms,
            row.cpu * 100.0,
            row.resident_bytes / 1e3,
            row.counted_bytes / 1e3,
            row.skipped,
            row.broken
        ));
        let held = row.p99_ms <= HELD_MS && row.broken == 0;
        rows.push(row);
        held
    };
    if cli.sessions.is_empty() {
        let mut held = 0;
        let mut lost = 8;
        while lost <= 65_536 && measure(lost) {
            (held, lost) = (lost, lost * 2);
        }
        for _ in 0..3 {
            let middle = held.midpoint(lost);
            if middle == held {
                break;
            }
            if measure(middle) { held = middle } else { lost = middle }
        }
    } else {
        cli.sessions.iter().for_each(|&sessions| {
            measure(sessions);
        });
    }
    let held = rows.iter().filter(|row| row.p99_ms <= HELD_MS && row.broken == 0).max_by_key(|row| row.sessions);
    match held {
        Some(row) => say(&format!(
            "one core holds {} sessions of {} views/s over {representations} representations with a 99th percentile of view → decision of {:.1} ms",
            row.sessions, cli.rate, row.p99_ms
        )),
        None => say("one core holds none of these"),
    }
    ExitCode::SUCCESS
}

/// Holds so many sessions. Memory is what the server holds with them in their last second, less what it held before.
fn hold(cli: &Cli, server: &Server, folder: &std::path::Path, sessions: u64) -> Row {
    let warm_up = (cli.seconds / 5.0).to_string();
    let before = server.resident_bytes();
    let viewer = clients(cli, server, folder, sessions, cli.seconds, &["--warm-up", &warm_up]);
    // Opening the world takes the clients a while too.
    while server.metric("foresight_sessions_connected").is_none_or(|connected| connected < sessions as f64 * 0.99) {
        std::thread::sleep(Duration::from_millis(100));
        if server.metric("foresight_sessions_refused_total").is_some_and(|refused| refused > 0.0) {
            break;
        }
    }
    let began = server.cpu_seconds();
    let watched = cli.seconds * 0.8;
    std::thread::sleep(Duration::from_secs_f64(watched));
    let cpu = (server.cpu_seconds() - began) / watched;
    let resident_bytes = server.resident_bytes().saturating_sub(before) as f64 / sessions as f64;
    let connected = server.metric("foresight_sessions_connected").unwrap_or_default().max(1.0);
    let counted_bytes = server.metric("foresight_session_memory_bytes").unwrap_or_default() / connected;
    let summary = summary(&viewer.finish(Duration::from_secs_f64(cli.seconds + 120.0)));
    let figure = |value: &serde_json::Value| value.as_f64().unwrap_or(f64::INFINITY);
    Row {
        sessions,
        views_per_second: figure(&summary["views_per_second"]),
        p50_ms: figure(&summary["view_to_decision_ms"]["p50"]),
        p99_ms: figure(&summary["view_to_decision_ms"]["p99"]),
        cpu,
        resident_bytes,
        counted_bytes,
        skipped: summary["ticks_skipped"].as_u64().unwrap_or_default(),
        broken: summary["broken"].as_u64().unwrap_or_default(),
    }
}

fn soak(cli: &Cli, minutes: f64) -> ExitCode {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let server = server(cli, folder.path(), None);
    let stay = cli.stay.to_string();
    let seconds = minutes * 60.0;
    let viewer = clients(cli, &server, folder.path(), cli.clients, seconds, &["--stay", &stay]);
    let mut samples = Vec::new();
    for sample in 0..(seconds / SAMPLED.as_secs_f64()) as u64 {
        std::thread::sleep(SAMPLED);
        let at_s = (sample + 1) as f64 * SAMPLED.as_secs_f64();
        samples.push((at_s, server.resident_bytes() as f64));
        if (sample + 1).is_multiple_of(12) {
            say(&format!(
                "{:5.1} min: {:.1} MB resident, {} sessions connected, {} opened",
                at_s / 60.0,
                server.resident_bytes() as f64 / 1e6,
                server.metric("foresight_sessions_connected").unwrap_or_default(),
                server.metric("foresight_sessions_opened_total").unwrap_or_default()
            ));
        }
    }
    let summary = summary(&viewer.finish(Duration::from_secs(120)));
    let judged: Vec<(f64, f64)> = samples.iter().copied().filter(|(at, _)| *at >= SETTLING * seconds).collect();
    let Some(Slope { per_second, half_width }) = slope::of(&judged) else {
        say("too few samples to judge");
        return ExitCode::FAILURE;
    };
    let (mb_per_hour, half) = (per_second * 3600.0 / 1e6, half_width * 3600.0 / 1e6);
    let mean_mb = judged.iter().map(|(_, bytes)| bytes).sum::<f64>() / judged.len() as f64 / 1e6;
    // What grows by less than a tenth in a day is flat.
    let flat = mb_per_hour - half <= mean_mb / 240.0;
    say(&format!(
        "{} sessions, {} requests, {} failed, {} broken, {} over their memory budget; memory {mean_mb:.1} MB in the mean, \
         changing by {mb_per_hour:+.2} ± {half:.2} MB an hour (95 %): {}",
        summary["sessions"],
        summary["requests"],
        summary["failed"],
        summary["broken"],
        summary["over_budget"],
        if flat { "flat" } else { "it grows" }
    ));
    let (code, log) = server.stop();
    let clean = code == Some(0) && !log.contains("panic");
    if flat && clean { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
