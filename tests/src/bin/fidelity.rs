//! Prints how the simulator's policies agree with the viewers that they stand for.

use std::sync::Arc;

use clap::Parser;
use foresight_tests::fidelity::{Browser, Case, VIEWERS, cases, compare, packages_folder};

/// Compares what real viewers ask for, and in which order, with the policies of the same names
///
/// Runs each viewer in headless Chromium, in real time, over the cases; needs chromium, nodejs and npm. Cases that need
/// recorded data are left out where FORESIGHT_DATA, or ../shared/data beside the workspace, is absent.
#[derive(Parser)]
struct Arguments {
    /// Only this viewer
    #[arg(long, value_parser = VIEWERS.map(|viewer| viewer.name))]
    viewer: Option<String>,
    /// Only the cases whose name contains this
    #[arg(long, value_name = "TEXT", default_value = "")]
    case: String,
    /// Runs of each viewer
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=100))]
    runs: u32,
    /// Also print both orders of first requests, the viewer's of its first run
    #[arg(long, conflicts_with = "json")]
    orders: bool,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments = Arguments::parse();
    let browser = Browser::install(&packages_folder()?)?;
    let data = foresight_tests::data_folder();
    let cases: Vec<Arc<Case>> = cases(data.as_deref())?.into_iter().map(Arc::new).collect();
    let mut outcomes = Vec::new();
    for viewer in VIEWERS.iter().filter(|viewer| arguments.viewer.as_deref().is_none_or(|name| name == viewer.name)) {
        for case in cases.iter().filter(|case| viewer.plays(case) && case.name.contains(&arguments.case)) {
            let outcome = compare(&browser, viewer, case, arguments.runs as usize)?;
            if !arguments.json {
                println!("{outcome}");
                if arguments.orders {
                    for (side, order) in [("real", &outcome.order_real), ("policy", &outcome.order_ours)] {
                        for (place, ask) in order.iter().enumerate() {
                            println!("{side:6} {place:5} {ask}");
                        }
                    }
                }
            }
            outcomes.push(outcome);
        }
    }
    if arguments.json {
        println!("{}", serde_json::json!({ "schema_version": 1, "outcomes": outcomes }));
    }
    Ok(())
}
