//! `--no-draw`: sessions in real time without a picture.

use crate::arguments::Cli;
use anyhow::{Context, bail};
use foresight_traces::flight::Flight as Path;
use foresight_viewer::clock::Clock;
use foresight_viewer::crowd::crowd;
use foresight_viewer::events::Log;
use foresight_viewer::fetch::{Http, Listed};
use foresight_viewer::session::{Flight, Leave, Plan, Report, fly};
use foresight_viewer::summary::{CrowdSummary, Summary};
use std::io::{IsTerminal, Write};
use std::sync::Arc;

/// Whether memory stayed within its budget.
pub(crate) fn run(cli: &Cli) -> anyhow::Result<bool> {
    let mut plan = cli.plan()?;
    let http = Http::new(cli.http()).context("HTTP")?;
    let path = cli.path(cli.world()?.as_ref())?;
    let runtime = crate::runtime(cli.threads)?;
    let world = runtime.block_on(choose(&http, &plan.address.origin, &plan.world))?;
    plan.has_files = world.content == "files";
    plan.world = world.name;
    let plan = Arc::new(plan);
    let clock = Clock::start();
    if let Some(settings) = cli.no_draw_args.crowd(path.duration().secs()) {
        let views = Arc::new(path.views);
        let summary = runtime.block_on(crowd(&plan, &views, &http, clock, settings));
        print(cli.json, &summary, crowd_text)?;
        return Ok(summary.over_budget == 0);
    }
    let summary = runtime.block_on(alone(cli, &plan, &path, http, clock))?;
    print(cli.json, &summary, text)?;
    Ok(summary.within_budget())
}

/// The world of this name, or the only one if it is empty.
pub(crate) async fn choose(http: &Http, origin: &str, name: &str) -> anyhow::Result<Listed> {
    let worlds = http.worlds(origin).await.with_context(|| origin.to_owned())?;
    let names = worlds.iter().map(|world| world.name.as_str()).collect::<Vec<_>>().join(", ");
    let mut fitting = worlds.into_iter().filter(|world| name.is_empty() || world.name == name);
    match (fitting.next(), fitting.next()) {
        (Some(world), None) => Ok(world),
        (Some(_), Some(_)) => bail!("{origin} has the worlds {names}; choose one with --session-world"),
        (None, _) => bail!("{origin} has no world {name:?}; it has: {names}"),
    }
}

async fn alone(cli: &Cli, plan: &Plan, path: &Path, http: Http, clock: Clock) -> anyhow::Result<Summary> {
    let log = match cli.no_draw_args.events() {
        Some(file) => Some(Log::create(file, &plan.world).with_context(|| file.display().to_string())?),
        None => None,
    };
    let flight = Flight {
        plan,
        views: &path.views,
        offset: 0,
        ticks: path.views.len(),
        leave: Leave::Bye,
        log,
        clock,
        timed_from_ns: 0,
        http,
    };
    let shows = std::io::stderr().is_terminal();
    let (summary, _) = fly(flight, |report| {
        if shows {
            eprint!("\r{}\x1b[K", line(report));
        }
    })
    .await?;
    if shows {
        eprint!("\r\x1b[K");
    }
    Ok(summary)
}

fn line(report: &Report) -> String {
    let quality = report.quality.map_or("–".to_owned(), |quality| format!("{quality:.3}"));
    let state = if report.connected { "" } else { ", no session" };
    format!(
        "{:.0} of {:.0} s: {:.1} MB received, {:.1} MB of memory, quality {quality}{state}",
        report.at_s.0,
        report.at_s.1,
        report.bytes as f64 / 1e6,
        report.memory as f64 / 1e6
    )
}

pub(crate) fn print<T: serde::Serialize>(json: bool, summary: &T, text: impl Fn(&T) -> String) -> anyhow::Result<()> {
    let text = if json { serde_json::to_string_pretty(summary)? + "\n" } else { text(summary) };
    // Whoever reads it may have seen enough.
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != std::io::ErrorKind::BrokenPipe => Err(error.into()),
        _ => Ok(()),
    }
}

fn text(s: &Summary) -> String {
    let failed: u64 = s.failed.values().sum();
    let kinds: Vec<_> = s.failed.iter().map(|(kind, count)| format!("\n    {count} × {kind}")).collect();
    let errors: Vec<_> = s.errors.iter().map(|error| format!("\n  the server found wrong: {error}")).collect();
    let quality = s.mean_quality.map_or("none".to_owned(), |quality| format!("{quality:.4}"));
    format!(
        "{} s over {} ({}), policy {}\n  {} requests, {} shown, {} cancelled, {} freed, {failed} failed{}; {:.2} MB\n  \
         memory: {:.2} of {:.2} MB at most\n  {} views, answered after {:.2} ms (median), {:.2} ms (99 %), {:.2} ms (most); mean estimate of the quality {quality}\n  \
         ticks: {:.1} ms late at most, {} left out; socket opened again {} times, session resumed {} times{}\n",
        s.duration_s,
        s.world,
        s.identity,
        s.policy,
        s.requests,
        s.completed,
        s.cancelled,
        s.discarded,
        kinds.concat(),
        s.bytes_received as f64 / 1e6,
        s.memory_max as f64 / 1e6,
        s.memory_budget as f64 / 1e6,
        s.views,
        s.view_to_decision_ms.p50,
        s.view_to_decision_ms.p99,
        s.view_to_decision_ms.max,
        s.tick_late_ms_max,
        s.ticks_skipped,
        s.reconnections,
        s.resumed,
        errors.concat()
    )
}

fn crowd_text(s: &CrowdSummary) -> String {
    let errors: Vec<_> = s.errors.iter().map(|error| format!("\n  {error}")).collect();
    format!(
        "{} clients, {} sessions, {} broken\n  {} views, {:.1} a second, answered after {:.2} ms (median), {:.2} ms (99 %), {:.2} ms (most); {} ticks left out\n  \
         {} requests, {} shown, {} failed; {:.2} MB; sockets opened again {} times; {} sessions over their memory budget{}\n",
        s.clients,
        s.sessions,
        s.broken,
        s.views,
        s.views_per_second,
        s.view_to_decision_ms.p50,
        s.view_to_decision_ms.p99,
        s.view_to_decision_ms.max,
        s.ticks_skipped,
        s.requests,
        s.completed,
        s.failed,
        s.bytes_received as f64 / 1e6,
        s.reconnections,
        s.over_budget,
        errors.concat()
    )
}
