//! `replay --session`: recordings of live sessions.

use super::replay::ReplayArgs;
use anyhow::{Context, bail};
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_sim::report;
use foresight_sim::session_replay::{SCHEMA_VERSION, SessionOutcome, Simulation, judge, replay_recording};
use foresight_traces::arguments;
use serde::Serialize;
use std::fs::File;
use std::io::{BufReader, Write};

/// What `--json` prints.
#[derive(Serialize)]
struct Document<'a> {
    schema_version: u32,
    sessions: &'a [SessionOutcome],
}

/// Replays each recording, and prints what came of it. An answer that is not made again is an error, said after all of
/// them.
pub(super) fn run(args: &ReplayArgs) -> anyhow::Result<()> {
    args.check()?;
    if args.path.is_some() && args.link.is_none() {
        bail!("--path {} without --link; expected the link to simulate it over", args.path.as_deref().unwrap_or(""));
    }
    let link = args.link.as_deref().map(|link| arguments::open_link(Some(link))).transpose()?;
    let link = link.map(|link| link.with_loss_seed(args.seed));
    let path = args.path.as_deref().map(|path| arguments::open_path(Some(path), &args.path_args)).transpose()?;
    let (_, world) = arguments::open_world(args.world.as_deref())?;
    let placed = path.map(|path| arguments::place(&path, &world, false, &args.path_args)).transpose()?;
    let simulation = link.as_ref().map(|link| Simulation {
        link,
        link_name: args.link.as_deref().unwrap_or_default(),
        flight: placed.as_ref().map(|placed| (&placed.flight, args.path.as_deref().unwrap_or_default())),
        client: args.client(),
    });
    let judging = CutSettings { opening: args.opening, ..CutSettings::default() };
    let mut outcomes = Vec::new();
    for file in &args.session {
        let name = file.display().to_string();
        let recording = File::open(file).with_context(|| name.clone())?;
        let recorded = replay_recording(&name, &world, BufReader::with_capacity(1 << 16, recording))?;
        outcomes.push(judge(&name, &world.tree, &recorded, &judging, simulation.as_ref())?);
    }
    let mut out = std::io::stdout().lock();
    if args.json {
        serde_json::to_writer(&mut out, &Document { schema_version: SCHEMA_VERSION, sessions: &outcomes })?;
        writeln!(out)?;
    } else {
        for outcome in &outcomes {
            write!(out, "{}", report::session_text(outcome))?;
        }
    }
    let differing = outcomes.iter().find(|outcome| !outcome.agreement.is_complete());
    match differing.and_then(|outcome| Some((outcome, outcome.agreement.first_difference.as_ref()?))) {
        None => Ok(()),
        Some((outcome, first)) => bail!(
            "{}, line {}: the session answers otherwise than recorded; expected {} of {} decisions to be made again, {} were",
            outcome.recording,
            first.line,
            outcome.agreement.decisions,
            outcome.agreement.decisions,
            outcome.agreement.decisions_equal
        ),
    }
}
