//! δ, ε, ωε and α at and beyond their ends.

use crate::session::{Client, nine};
use foresight_scheduler::benefit::cut::{Cut, CutSettings};
use foresight_scheduler::predict::PredictorKind;
use foresight_scheduler::predict::motion::Speeds;
use foresight_scheduler::worst_case::{Reach, union_cut};
use glam::DVec3;

/// Whatever the span, in the end everything ahead is there in full, each once.
fn brings_all(client: &Client) {
    let log = client.stand(&nine(DVec3::ZERO), 640);
    for finest in (0..7).map(|i| 2 * i + 1) {
        assert!(log.resident.contains(&finest), "{log:?}");
    }
    let mut once = log.fetched.clone();
    once.sort_unstable();
    once.dedup();
    assert_eq!(once.len(), log.fetched.len());
}

#[test]
fn a_horizon_of_a_nanosecond() {
    brings_all(&Client::with(|s| s.horizon_s = 1e-9));
}

#[test]
fn a_horizon_of_a_hundred_thousand_seconds() {
    brings_all(&Client::with(|s| s.horizon_s = 1e5));
}

#[test]
fn reuse_of_a_nanosecond() {
    brings_all(&Client::with(|s| s.reuse_s = 1e-9));
}

/// ε of 10⁵ s: the first sampling is kept for longer than the session, and yet all comes.
#[test]
fn reuse_of_a_hundred_thousand_seconds() {
    brings_all(&Client::with(|s| s.reuse_s = 1e5));
}

/// What any turn could reveal is all there is.
#[test]
fn a_turn_of_half_a_circle_and_more_reaches_everything() {
    let tree = nine(DVec3::ZERO);
    let view = crate::session::at(DVec3::ZERO);
    let reach = Reach { angular_max: 1e9, ..Reach::default() };
    for angle in [core::f64::consts::PI, 10.0, 1e9] {
        let region = reach.region(Speeds { linear: 0.0, angular: angle }, 1.0);
        let mut cut = Cut::default();
        union_cut(&mut cut, &tree, &view, region, &CutSettings { opening: 0.0, ..CutSettings::default() });
        assert_eq!(cut.patches.len(), 9, "{angle}");
        assert!(cut.scale > 0.0 && cut.scale <= 1.0);
    }
}

fn believing(alpha: f64) -> Client {
    Client::with(|s| {
        s.alpha = alpha;
        s.tolerance = 0.0;
        // The mixture also looks aside.
        s.predictor = PredictorKind::ConstantVelocity;
    })
}

/// α = 1 asks only for what the paths show; one ulp less asks for the same first.
#[test]
fn trust_of_one_and_an_ulp_less() {
    let tree = nine(DVec3::ZERO);
    let (whole, nearly) = (believing(1.0).stand(&tree, 320), believing(1f64.next_down()).stand(&tree, 320));
    assert!(whole.fetched.iter().all(|&r| r < 14), "{whole:?}");
    assert_eq!(whole.fetched[..], nearly.fetched[..whole.fetched.len()]);
}

/// α = 0 asks for the worst case; one subnormal more asks for the same first.
#[test]
fn trust_of_zero_and_an_ulp_more() {
    let tree = nine(DVec3::ZERO);
    let (none, hardly) = (believing(0.0).stand(&tree, 320), believing(f64::from_bits(1)).stand(&tree, 320));
    assert!(!none.fetched.is_empty());
    assert_eq!(none.fetched[..], hardly.fetched[..none.fetched.len()]);
}

#[test]
fn attenuation_that_leaves_nothing_of_the_future() {
    // exp(−10¹²·u) is 0 in every interval: the paths weigh nothing, the worst case still decides.
    let log = Client::with(|s| s.attenuation = 1e12).stand(&nine(DVec3::ZERO), 320);
    assert!(!log.fetched.is_empty());
}

#[test]
fn one_sample_and_four_thousand() {
    let sampling = |samples| {
        Client::with(|s| {
            s.samples = samples;
            s.predictor = PredictorKind::ConstantVelocity;
        })
    };
    let (few, many) = (sampling(1), sampling(4096));
    let tree = nine(DVec3::ZERO);
    let (few, many) = (few.stand(&tree, 96), many.stand(&tree, 96));
    // Nothing moves: every sample sees the same.
    assert_eq!(few.fetched, many.fetched);
}
