//! Links without cost and without end, budgets below and above everything.

use crate::session::{Client, at, cube, flat, nine};
use foresight_scheduler::benefit::coverage::Refinement;
use foresight_scheduler::lod_tree::{LodTreeBuilder, RepId};
use foresight_scheduler::policy::foresight::{Foresight, ForesightSettings};
use foresight_scheduler::scheduler::{Scheduler, SchedulerSettings, Waiting};
use foresight_scheduler::state::smallest_closure;
use foresight_scheduler::transfer::TransferEstimate;
use foresight_scheduler::units::Time;
use glam::DVec3;

fn guessing(rate: f64, latency: f64) -> Client {
    let mut client = Client::default();
    client.scheduler.rate_guess = rate;
    client.scheduler.latency_guess_s = latency;
    client
}

/// c of almost 0: everything can be had at once, the nearest first.
#[test]
fn a_link_that_costs_nothing() {
    let tree = nine(DVec3::ZERO);
    let mut client = guessing(1e18, 0.0);
    client.link = (1e18, 0.0);
    let log = client.stand(&tree, 64);
    assert!((0..7).all(|i| log.resident.contains(&(2 * i + 1))), "{log:?}");
}

/// c of 10¹² s/B: the rate is held at a byte per second, and one request waits.
#[test]
fn a_link_of_a_trillion_seconds_a_byte() {
    let estimate = TransferEstimate::checked(1e-12, 0.0).unwrap();
    assert_eq!(estimate.rate(), 1.0);
    let mut client = guessing(1e-12, 0.0);
    client.link = (1e-12, 0.0);
    let log = client.stand(&nine(DVec3::ZERO), 320);
    assert!(log.resident.is_empty() && !log.fetched.is_empty() && log.fetched.len() <= 18, "{log:?}");
    assert_eq!(log.waiting, Some(Waiting::Transfers));
}

#[test]
fn a_latency_of_a_million_seconds() {
    let mut client = guessing(1e6, 1e6);
    client.link = (1e6, 1e6);
    let log = client.stand(&nine(DVec3::ZERO), 320);
    assert!(!log.fetched.is_empty() && log.resident.is_empty(), "{log:?}");
    let mut once = log.fetched.clone();
    once.dedup();
    assert_eq!(once, log.fetched);
}

#[test]
fn a_latency_of_nothing() {
    let mut client = guessing(1e6, 0.0);
    client.link = (1e6, 0.0);
    let log = client.stand(&nine(DVec3::ZERO), 320);
    assert!((0..7).all(|i| log.resident.contains(&(2 * i + 1))), "{log:?}");
}

#[test]
fn a_budget_below_everything_waits_and_says_why() {
    let tree = nine(DVec3::ZERO);
    let mut client = Client::default();
    for budget in [0, 1, 9_999] {
        client.scheduler.budget = budget;
        let log = client.stand(&tree, 32);
        assert!(log.fetched.is_empty(), "{log:?}");
        // 2000 bytes on the wire and 8000 decoded.
        assert_eq!(log.waiting, Some(Waiting::Budget { budget, least: Some(10_000) }));
    }
    let why = Waiting::Budget { budget: 9_999, least: Some(10_000) }.to_string();
    assert_eq!(why, "the memory budget is 9999 bytes; expected at least 10000, the smallest usable closure");
    client.scheduler.budget = 10_000;
    assert_eq!(client.stand(&tree, 32).fetched[0], 0);
}

#[test]
fn a_budget_of_two_to_the_sixty_third() {
    let mut client = Client::default();
    let tree = nine(DVec3::ZERO);
    let (plenty, mut beyond) = (client.stand(&tree, 320), Client::default());
    client.scheduler.budget = 1 << 63;
    beyond.scheduler.budget = u64::MAX;
    assert_eq!(client.stand(&tree, 320), plenty);
    assert_eq!(beyond.stand(&tree, 320), plenty);
}

/// Under `atomic` the least that can be shown is the cheapest whole group.
#[test]
fn the_smallest_closure_of_a_group_is_all_of_it() {
    let object = |z: f64, bytes: &'static [(u32, f32)]| (cube(DVec3::NEG_Z * z, 1.0), bytes);
    let tree = flat(&[object(10.0, &[(100, 1.0), (50, 2.0)]), object(20.0, &[(200, 1.0)])]);
    assert_eq!(smallest_closure(&tree, Refinement::Partial), Some(250));
    assert_eq!(smallest_closure(&tree, Refinement::Atomic), Some(250 + 1000));
    let mut empty = LodTreeBuilder::default();
    empty.open().unwrap();
    empty.close(Some(cube(DVec3::ZERO, 1.0)), 1.0).unwrap();
    assert_eq!(smallest_closure(&empty.finish().unwrap(), Refinement::Atomic), None);
}

#[test]
fn each_wait_has_its_reason() {
    let tree = nine(DVec3::ZERO);
    let policy = Box::new(Foresight::new("foresight", ForesightSettings::default()));
    let mut scheduler = Scheduler::new(&tree, SchedulerSettings::with_budget(1 << 30), policy);
    assert_eq!(scheduler.waiting_because(), None);
    scheduler.next(Time::ZERO).unwrap();
    assert_eq!(scheduler.waiting_because(), Some(Waiting::NoView));
    scheduler.observe(&at(DVec3::ZERO), Time::ZERO).unwrap();
    scheduler.next(Time::ZERO).unwrap();
    assert_eq!(scheduler.waiting_because(), None);
    let log = Client::with(|s| s.alpha = 1.0).stand(&tree, 640);
    assert_eq!(log.waiting, Some(Waiting::NothingGains));
    let mut empty = LodTreeBuilder::default();
    empty.open().unwrap();
    empty.close(Some(cube(DVec3::NEG_Z * 9.0, 1.0)), 1.0).unwrap();
    let log = Client::default().stand(&empty.finish().unwrap(), 8);
    assert_eq!(log.waiting, Some(Waiting::Budget { budget: 1 << 40, least: None }));
}

/// What a full memory holds is never more than the budget, and the session's own memory follows what is resident.
#[test]
fn a_session_takes_memory_for_what_is_resident() {
    let tree = nine(DVec3::ZERO);
    let policy = Box::new(Foresight::new("foresight", ForesightSettings::default()));
    let mut scheduler = Scheduler::new(&tree, SchedulerSettings::with_budget(1 << 30), policy);
    let before = scheduler.heap_bytes();
    (0..18).for_each(|r| scheduler.preload(RepId(r)).unwrap());
    let after = scheduler.heap_bytes();
    assert!(before < 500 && after > before && after < 8_000, "{before} {after}");
}
