//! `suite --alpha-sweep`: α adapted and solved for against the best fixed α in hindsight.

use super::replay;
use super::suite::{Line, SuiteArgs, completed, set};
use anyhow::Context;
use clap::Parser;
use foresight_sim::outcome::Comparison;
use foresight_sim::report;
use foresight_sim::suite::Case;
use foresight_sim::suite::alpha::{self, AlphaSweep};
use std::io::{IsTerminal, Write};
use std::path::Path;

/// Replays each case at every α; cases that need data which are not there are left out, and said on stderr.
pub(super) fn run(args: &SuiteArgs, cases: &[&Case], data: &Path, out: &mut impl Write) -> anyhow::Result<()> {
    let mut rows = Vec::new();
    for case in cases {
        if case.needs_data() && !data.is_dir() {
            eprintln!("skipped {}: needs recorded data, and {} is not there", case.name, data.display());
            continue;
        }
        let commands = case.commands(data);
        let several = commands.len() > 1;
        for (place, command) in commands.into_iter().enumerate() {
            let name = if several { format!("{} {}", case.name, place + 1) } else { case.name.to_owned() };
            let options = own_options(&command);
            let mut command = completed(command, args);
            command.push("--no-bound".to_owned());
            set(&mut command, "--policy", Some(alpha::policies(&options)));
            let fixed = compare(&name, &command)?;
            let Some(mut row) = alpha::row(name.clone(), command.clone(), &fixed) else { continue };
            set(&mut command, "--policy", Some(alpha::solved_policy(row.at_least, &options)));
            let solved = compare(&name, &command)?;
            if let Some(contender) = row.contender(&solved, 0) {
                row.solved = contender;
            }
            rows.push(row);
        }
    }
    let sweep = AlphaSweep::new(rows);
    if args.json {
        serde_json::to_writer(&mut *out, &sweep)?;
        writeln!(out)?;
    } else {
        write!(out, "{}", report::alpha_sweep_text(&sweep))?;
    }
    Ok(())
}

fn compare(name: &str, command: &[String]) -> anyhow::Result<Comparison> {
    let shows_progress = std::io::stderr().is_terminal();
    let line = Line::try_parse_from(command).with_context(|| format!("case {name}"))?;
    let comparison = replay::execute(&line.replay, &|done, all| {
        if shows_progress {
            eprint!("\r\x1b[K{name}: {done} of {all} replays");
        }
    });
    if shows_progress {
        eprint!("\r\x1b[K");
    }
    comparison.with_context(|| format!("case {name}: {}", command.join(" ")))
}

/// Options of a case's own `foresight`, as in `:predictor=known-path`.
fn own_options(command: &[String]) -> String {
    let policies = command.iter().position(|word| word == "--policy").and_then(|at| command.get(at + 1));
    let own = policies.and_then(|list| list.split(',').find_map(|p| p.strip_prefix("foresight:")));
    own.map(|options| format!(":{options}")).unwrap_or_default()
}
