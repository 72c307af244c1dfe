//! What the real server and the real client make of faults: a dead link, spoiled contents, clients and servers that vanish,
//! sockets that break, clocks that jump, databases that fail.
//!
//! Each flight is judged by the client's own log of events. Figures are printed; run with `--nocapture` to see them.

mod faults {
    pub(super) mod clocks;
    pub(super) mod contents;
    pub(super) mod database;
    pub(super) mod link;
    pub(super) mod vanished;
}

use std::path::Path;

use foresight_tests::sidecar::case::{Case, Live};
use foresight_tests::sidecar::flown;

/// Deficit above the undisturbed run's that counts as level with it.
const LEVEL: f64 = 0.01;

/// Ends a flight's account of what must always hold: no request for what could be shown. That memory stayed within its budget
/// the client's exit status has said.
fn is_sound(live: &Live) {
    let again = live.flown.requested_while_resident();
    assert!(again.is_empty(), "requested while they could be shown: {again:?}");
    assert!(live.figure("memory_max") <= live.figure("memory_budget"));
    let errors = live.summary["errors"].as_array().expect("a list of errors");
    assert!(errors.is_empty(), "the server found wrong: {errors:?}");
}

/// Wire bytes of what had arrived by `at_s`.
fn arrived_bytes(case: &Case, live: &Live, at_s: f64) -> u64 {
    let until = (at_s * 1e9) as u64;
    let arrived = live.flown.lines.iter().filter(|line| line.event == "arrived" && line.t_ns <= until);
    arrived.map(|line| case.wire_bytes(line.rep)).sum()
}

/// Seconds within which the deficit has to return, twice the time that the missed bytes need at `rate` bytes/s, and those in
/// which it does; printed.
fn recovery(
    name: &str,
    case: &Case,
    (undisturbed, disturbed): (&Live, &Live),
    over_s: f64,
    rate: f64,
) -> (f64, Option<f64>) {
    let missed = arrived_bytes(case, undisturbed, over_s).saturating_sub(arrived_bytes(case, disturbed, over_s));
    let allowed = 2.0 * missed as f64 / rate;
    let returned = flown::returned_after_s(&disturbed.deficits, &undisturbed.deficits, over_s, LEVEL);
    println!(
        "{name}: {:.2} MB missed when it was over, which need {:.1} s; deficit level after {} of {allowed:.1} s; mean deficit {:.4}, undisturbed {:.4}",
        missed as f64 / 1e6,
        allowed / 2.0,
        returned.map_or("more than the rest".to_owned(), |s| format!("{s:.1} s")),
        disturbed.deficit(),
        undisturbed.deficit()
    );
    (allowed, returned)
}

/// A world of real files in `folder`, made by the simulator: models in space, which begin with `glTF`.
fn files(folder: &Path) -> String {
    let arguments = ["generate", "asteroids", "--count", "400", "--triangles", "2000", "--spacing", "100m", "--radius"];
    let arguments: Vec<&str> = arguments.into_iter().chain(["20m", "--out", "belt"]).collect();
    let made = foresight_tests::program::sim(folder, &arguments, std::time::Duration::from_secs(120));
    assert_eq!(made.code, Some(0), "{}", made.stderr);
    folder.join("belt").display().to_string()
}
