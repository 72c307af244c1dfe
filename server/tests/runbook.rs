//! The runbook says what the program does.

use foresight_server::config::Config;
use foresight_server::http::metrics::Metrics;
use foresight_server::session::metrics::SessionMetrics;
use std::path::Path;

fn read(name: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(name)).expect(name)
}

/// Names that begin with `foresight_` in a text.
fn named(text: &str) -> Vec<String> {
    let word = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
    let words = text.split(|c| !word(c)).filter(|name| name.starts_with("foresight_") && *name != "foresight_server");
    words.map(str::to_owned).collect()
}

#[test]
fn every_metric_that_is_named_exists() {
    let metrics = SessionMetrics::default();
    let text = Metrics::new(|registry| metrics.register(registry)).text();
    let samples: Vec<&str> = text.lines().filter_map(|line| line.split(['{', ' ']).next()).collect();
    // A family without a sample is known by its type.
    let families: Vec<String> =
        text.lines().filter_map(|line| line.strip_prefix("# TYPE ")?.split(' ').next().map(str::to_owned)).collect();
    let names: Vec<String> = ["alerts.yaml", "RUNBOOK.md"].iter().flat_map(|name| named(&read(name))).collect();
    assert!(names.len() > 20, "{names:?}");
    for name in names {
        let family = name.trim_end_matches("_total");
        let known = samples.contains(&name.as_str()) || families.iter().any(|known| *known == name || known == family);
        assert!(known, "{name} is not in /metrics:\n{text}");
    }
}

#[test]
fn every_alert_is_explained() {
    let (rules, runbook) = (read("alerts.yaml"), read("RUNBOOK.md"));
    let alerts: Vec<&str> = rules.lines().filter_map(|line| line.trim().strip_prefix("- alert: ")).collect();
    assert!(alerts.len() > 10);
    for alert in alerts {
        assert!(runbook.contains(&format!("| {alert} |")), "{alert} is not explained");
    }
}

#[test]
fn the_settings_are_those_of_the_program() {
    let runbook = read("RUNBOOK.md");
    let begin = "<!-- settings: written by Config::markdown(), checked by a test -->\n";
    let shown = runbook.split_once(begin).and_then(|(_, rest)| rest.split_once("<!-- end of settings -->"));
    let table = Config::markdown();
    assert_eq!(shown.map(|(table, _)| table.trim()), Some(table.trim()), "expected this table:\n{table}");
}
