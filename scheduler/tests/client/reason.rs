//! Why something is fetched, and policies that take over from each other.

use super::*;
use foresight_scheduler::benefit::coverage::Refinement;
use foresight_scheduler::policy::foresight::{AlphaRule, ChoiceMethod};
use foresight_scheduler::policy::{RIVALS, RivalSettings};
use foresight_scheduler::scheduler::Reason;

fn first_reasons(tree: &LodTree, refinement: Refinement, alpha: f64, choice: ChoiceMethod) -> Vec<(u32, Reason)> {
    let policy = foresight(|s| {
        (s.alpha, s.alpha_rule, s.choice, s.cover_first) = (alpha, AlphaRule::Fixed, choice, false);
        s.grouping = 0.0;
    });
    let settings = SchedulerSettings { refinement, rate_guess: 1e6, latency_guess_s: 0.5, budget: 1 << 30 };
    let mut scheduler = Scheduler::checked(tree, settings, policy).unwrap();
    scheduler.observe(&at(DVec3::ZERO), Time(7)).unwrap();
    let mut reasons = Vec::new();
    while let Action::Fetch { rep, .. } = scheduler.next(Time(7)).unwrap() {
        reasons.push((rep.0, scheduler.reason().expect("a reason")));
    }
    reasons
}

/// With a link of 1 MB/s and 0.5 s, the k-th of equal requests is there after 0.5 s and k times its bytes. What lies
/// straight ahead of a camera that stands is in both parts of the objective: α of its gain is the prediction's, times the
/// share of the time ahead that is left at its arrival. What lies behind is the worst case's alone.
#[test]
fn a_reason_says_for_which_part_and_when() {
    let ahead = leaves(&[DVec3::new(0.0, 0.0, -20.0)], &[(10_000, 0.01)]);
    let behind = leaves(&[DVec3::new(0.0, 0.0, 20.0)], &[(10_000, 0.01)]);
    for choice in [ChoiceMethod::Certified, ChoiceMethod::Sampled] {
        for refinement in [Refinement::Partial, Refinement::Atomic] {
            for alpha in [0.0, 0.25, 0.7, 1.0] {
                let [(0, reason)] = first_reasons(&ahead, refinement, alpha, choice)[..] else { panic!("one fetch") };
                assert_eq!(reason.arrival, Time(7) + Time::from_secs(0.51));
                let left = 1.0 - 0.51 / 4.0;
                let expected = alpha * left / (alpha * left + (1.0 - alpha));
                // The mixture looks a little aside as well.
                assert!((reason.predicted_share - expected).abs() < 0.12, "{choice:?} {alpha}: {reason:?}, {expected}");
                assert_eq!(reason.predicted_share == 0.0, alpha == 0.0);
                assert_eq!(reason.predicted_share == 1.0, alpha == 1.0);
            }
        }
        assert_eq!(first_reasons(&behind, Refinement::Partial, 0.7, choice), []);
    }
    let both = leaves(&[DVec3::new(0.0, 0.0, -20.0), DVec3::new(12.0, 0.0, -20.0)], &[(10_000, 0.01)]);
    let reasons = first_reasons(&both, Refinement::Partial, 0.7, ChoiceMethod::Certified);
    let arrivals: Vec<Time> = reasons.iter().map(|(_, reason)| reason.arrival).collect();
    assert_eq!(arrivals, [0.51, 0.52].map(|s| Time(7) + Time::from_secs(s)));
    // What is outside the frustum, and could be turned to, is there for the worst case.
    assert!(reasons[0].1.predicted_share > 0.4 && reasons[1].1.predicted_share < 0.4, "{reasons:?}");
}

/// Whoever decides, the client stays as it is, and what is needed comes in the end.
#[test]
fn policies_take_over_from_each_other() {
    let places: Vec<DVec3> = (0..6).map(|i| DVec3::new(3.0 * f64::from(i) - 7.5, 0.0, -25.0)).collect();
    let tree = leaves(&places, &[(4000, 1.0), (40_000, 0.02)]);
    let mut client = Client::new(&tree, 1 << 20, foresight(|_| {}));
    let see = |s: &mut Scheduler, now: Time| s.observe(&at(DVec3::ZERO), now).unwrap();
    client.ticks(10, see);
    for rival in RIVALS {
        let (used, requests) = (client.scheduler.state().used_bytes(), client.scheduler.state().requests().to_vec());
        let settings = RivalSettings { error_target_px: 16.0, parallel: rival.parallel };
        client.scheduler.set_policy((rival.build)(&tree, &settings));
        assert_eq!(client.scheduler.state().used_bytes(), used);
        assert_eq!(client.scheduler.state().requests(), requests);
        assert_eq!(client.scheduler.reason(), None);
        // It knows where the camera is, and decides at once.
        client.obey();
        client.ticks(5, see);
        client.scheduler.set_policy(foresight(|_| {}));
        client.ticks(5, see);
    }
    client.ticks(120, see);
    assert!((0..6).all(|i| client.status(2 * i + 1) == Status::Resident), "{:?}", client.log);
}
