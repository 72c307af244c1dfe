//! The policies that stand for real viewers against those viewers, in a headless browser.

use std::sync::{Arc, Mutex, PoisonError};

use foresight_tests::fidelity::{Browser, VIEWERS, cases, compare, packages_folder};

/// Least agreement of a policy with its viewer, as a share of the viewer's agreement with itself. Measured: 0.89 and
/// more.
const FLOOR: f64 = 0.8;

/// Two browsers at once would hold each other up.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

fn policy_agrees_with(name: &str) {
    if let Err(skipped) = foresight_tests::full() {
        println!("{skipped}");
        return;
    }
    let _turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let viewer = VIEWERS.iter().find(|viewer| viewer.name == name).expect("a name of VIEWERS");
    let browser = match Browser::install(&packages_folder().expect("a folder for packages")) {
        Ok(browser) => browser,
        Err(error) => {
            assert!(std::env::var_os("CI").is_none_or(|value| value != "true"), "{error}");
            println!("skipped: {error}");
            return;
        }
    };
    // Without recorded data the generated city is left.
    let data = foresight_tests::data();
    for case in cases(data.as_deref()).expect("cases").into_iter().map(Arc::new).filter(|case| viewer.plays(case)) {
        let outcome = compare(&browser, viewer, &case, 2).unwrap_or_else(|error| panic!("{error}"));
        println!("{outcome}");
        let (ours, ceiling) = (outcome.ours, outcome.ceiling.expect("two runs"));
        assert!(outcome.asked_real.iter().all(|&asked| asked >= 50), "the viewer asked for next to nothing\n{outcome}");
        assert!(outcome.frames_per_second.iter().all(|&rate| rate > 20.0), "this machine is too busy\n{outcome}");
        assert!(ours.share_in_common >= FLOOR * ceiling.share_in_common, "other tiles\n{outcome}");
        assert!(ours.kendall >= FLOOR * ceiling.kendall, "another order\n{outcome}");
        assert!(ours.spearman >= FLOOR * ceiling.spearman, "another order\n{outcome}");
    }
}

#[test]
fn tiles_renderer_asks_as_the_real_one_does() {
    policy_agrees_with("3d-tiles-renderer");
}

#[test]
fn cesium_asks_as_the_real_one_does() {
    policy_agrees_with("cesium");
}
