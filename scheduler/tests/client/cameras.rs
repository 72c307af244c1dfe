//! Several cameras that share link and memory.

use super::*;
use foresight_scheduler::policy::foresight::ChoiceMethod;
use foresight_scheduler::policy::specification::PolicySpec;
use foresight_scheduler::scheduler::{CAMERAS_MAX, SchedulerError};

/// Twelve objects, each farther than the one before, before a camera at each of the places.
fn groups(cameras: &[DVec3]) -> LodTree {
    let places: Vec<DVec3> = cameras
        .iter()
        .flat_map(|&c| {
            (0..12).map(move |i| {
                c + DVec3::new(3.0 * f64::from(i % 4) - 4.5, f64::from(i / 4) * 3.0 - 3.0, -20.0 - 0.4 * f64::from(i))
            })
        })
        .collect();
    leaves(&places, &[(4000, 1.0), (40_000, 0.02)])
}

const APART: [DVec3; 2] = [DVec3::ZERO, DVec3::new(5000.0, 0.0, 0.0)];

/// A flight that turns, by one camera given in both ways: the same decisions at the same times.
#[test]
fn one_camera_is_one_camera() {
    let tree = groups(&APART);
    for spec in PolicySpec::parse_list("all,foresight:choice=sampled", 0.7, None).unwrap() {
        if foresight_scheduler::policy::specification::knows_the_future(&spec.label) {
            continue;
        }
        let run = |weight: Option<f64>| {
            let policy = spec.build(&tree);
            let mut client = Client::new(&tree, 400_000, policy);
            client.ticks(240, |scheduler, now| {
                let turn = DQuat::from_rotation_y(0.4 * now.secs());
                let view = View { orientation: turn, ..at(DVec3::new(2.0 * now.secs(), 0.0, 0.0)) };
                match weight {
                    None => scheduler.observe(&view, now).unwrap(),
                    Some(weight) => scheduler.observe_cameras(&[(weight, view)], now).unwrap(),
                }
            });
            client.log
        };
        let alone = run(None);
        assert!(!alone.is_empty());
        assert_eq!(alone, run(Some(1.0)), "{}", spec.label);
        assert_eq!(alone, run(Some(1e-9)), "{}", spec.label);
    }
}

/// How many of the first twelve fine representations are of each of the two groups, by cameras of these weights.
fn served(weights: [f64; 2], choice: ChoiceMethod) -> [usize; 2] {
    let tree = groups(&APART);
    let mut client = Client::new(&tree, 1 << 30, foresight(|s| s.choice = choice));
    client.bytes_per_tick = 5000;
    client.ticks(120, |scheduler, now| {
        let cameras = [(weights[0], at(APART[0])), (weights[1], at(APART[1]))];
        scheduler.observe_cameras(&cameras, now).unwrap();
    });
    let fine = client.fetched().into_iter().filter(|rep| rep % 2 == 1).take(12);
    fine.fold([0; 2], |mut of, rep| {
        of[usize::from(rep >= 24)] += 1;
        of
    })
}

#[test]
fn each_camera_is_served_in_proportion() {
    for choice in [ChoiceMethod::Certified, ChoiceMethod::Sampled] {
        let [a, b] = served([1.0, 1.0], choice);
        assert!(a + b == 12 && a.abs_diff(b) <= 1, "{choice:?}: {a} and {b}");
        // Pair by pair the objects are alike: those of the heavier camera come first.
        let [a, b] = served([3.0, 1.0], choice);
        assert!(a >= 10, "{choice:?}: {a} and {b}");
        let [b, a] = served([1e-3, 3e-3], choice);
        assert!(a >= 10, "{choice:?}: {a} and {b}");
    }
}

/// In the long run both have everything, and each had something coarse before either had anything fine.
#[test]
fn both_cameras_are_covered_first() {
    let tree = groups(&APART);
    for choice in [ChoiceMethod::Certified, ChoiceMethod::Sampled] {
        let mut client = Client::new(&tree, 1 << 30, foresight(|s| s.choice = choice));
        client.ticks(400, |scheduler, now| {
            scheduler.observe_cameras(&APART.map(|place| (0.5, at(place))), now).unwrap();
        });
        let fetched = client.fetched();
        assert_eq!(fetched.len(), 48, "{choice:?}");
        assert!(fetched[..24].iter().all(|rep| rep % 2 == 0), "{choice:?}: {fetched:?}");
    }
}

/// Cameras come and go; rivals follow the heaviest.
#[test]
fn cameras_come_and_go() {
    let tree = groups(&APART);
    for name in ["foresight", "foresight:worst=minimum", "added-benefit", "3d-tiles-renderer"] {
        let spec = PolicySpec::parse_list(name, 0.7, None).unwrap().remove(0);
        let mut client = Client::new(&tree, 600_000, spec.build(&tree));
        for count in [1, 3, 2, CAMERAS_MAX, 1] {
            client.ticks(40, |scheduler, now| {
                let camera = |i: usize| (1.0 + i as f64, at(APART[i % 2] + DVec3::X * now.secs()));
                let cameras: Vec<_> = (0..count).map(camera).collect();
                scheduler.observe_cameras(&cameras, now).unwrap();
                assert_eq!(scheduler.state().view, Some(cameras[count - 1].1));
            });
        }
        assert!(!client.log.is_empty(), "{name}");
    }
}

#[test]
fn what_has_no_meaning_is_refused() {
    let tree = groups(&APART[..1]);
    let mut client = Client::new(&tree, 1 << 20, foresight(|_| {}));
    let view = at(DVec3::ZERO);
    let scheduler = &mut client.scheduler;
    for weight in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-300, 1e300] {
        let refused = scheduler.observe_cameras(&[(1.0, view), (weight, view)], Time(5));
        assert!(matches!(refused, Err(SchedulerError::CameraWeight { index: 1, .. })), "{weight}: {refused:?}");
        assert!(scheduler.observe_cameras(&[(weight, view)], Time(5)).is_err());
    }
    let astray = at(DVec3::splat(f64::NAN));
    assert!(matches!(scheduler.observe_cameras(&[(1.0, view), (1.0, astray)], Time(5)), Err(SchedulerError::View(_))));
    assert_eq!(scheduler.observe_cameras(&[], Time(5)), Err(SchedulerError::Cameras(0)));
    let many = vec![(1.0, view); 1_000_000];
    assert_eq!(scheduler.observe_cameras(&many, Time(5)), Err(SchedulerError::Cameras(1_000_000)));
    // Nothing of it was taken in.
    assert!(scheduler.state().view.is_none() && scheduler.state().cameras().is_empty());
    assert!(scheduler.observe_cameras(&[(1e9, view), (1e-9, view)], Time::ZERO).is_ok());
    client.obey();
}
