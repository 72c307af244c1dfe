use super::*;
use proptest::prelude::*;

fn fetch(rep: u32, wire_bytes: u64, decoded_bytes: u64) -> Fetch {
    Fetch {
        rep,
        uri: String::new(),
        wire_bytes,
        decoded_bytes,
        urgency: 3,
        deadline_ns: 0,
        predicted_share: None,
        after: None,
        discard_on_arrival: Vec::new(),
    }
}

fn said(residency: &mut Residency) -> Vec<(u32, What)> {
    residency.take_happened().into_iter().filter(|h| h.told).map(|h| (h.rep, h.what)).collect()
}

#[test]
fn a_swap_on_arrival_fits_a_budget_that_holds_one() {
    let mut residency = Residency::new(130, ClientSettings::unlimited());
    assert_eq!(residency.fetch(&fetch(1, 30, 100), 0), Admission::Start);
    residency.responded(1, 5);
    residency.arrived(1, 10);
    residency.show(20);
    assert_eq!((residency.used_bytes(), residency.resident().collect::<Vec<_>>()), (100, vec![1]));
    let swap = Fetch { discard_on_arrival: vec![1], ..fetch(2, 30, 100) };
    assert_eq!(residency.fetch(&swap, 30), Admission::Start);
    assert_eq!(residency.fetch(&fetch(3, 10, 10), 30), Admission::Refused);
    residency.arrived(2, 40);
    residency.show(50);
    assert_eq!((residency.used_bytes(), residency.resident().collect::<Vec<_>>()), (100, vec![2]));
    assert_eq!(residency.used_bytes_max(), 130);
}

#[test]
fn what_needs_the_failed_is_failed_too() {
    let mut residency = Residency::new(1000, ClientSettings::unlimited());
    residency.fetch(&fetch(1, 10, 10), 0);
    residency.fetch(&Fetch { after: Some(1), ..fetch(2, 10, 10) }, 0);
    residency.fetch(&Fetch { after: Some(2), ..fetch(3, 10, 10) }, 0);
    residency.fetch(&fetch(4, 10, 10), 0);
    residency.arrived(3, 1);
    residency.take_happened();
    residency.fail(1, 2, "404".to_owned());
    let failed: Vec<u32> = said(&mut residency).into_iter().map(|(rep, _)| rep).collect();
    assert_eq!(failed, [1, 2, 3]);
    assert_eq!((residency.used_bytes(), residency.take_aborted()), (10, vec![1, 2]));
}

#[test]
fn what_a_lost_session_had_begun_is_taken_over_and_not_fetched_again() {
    let mut residency = Residency::new(1000, ClientSettings::unlimited());
    for rep in 1..=3 {
        residency.fetch(&fetch(rep, 10, 10), 0);
    }
    residency.arrived(1, 1);
    residency.show(10);
    residency.responded(2, 12);
    residency.take_happened();
    assert_eq!(residency.greet(), [1]);
    residency.arrived(2, 13);
    residency.show(20);
    assert_eq!(said(&mut residency), []);
    assert_eq!(residency.fetch(&fetch(2, 10, 10), 24), Admission::Adopted);
    assert_eq!(said(&mut residency), [(2, What::Responded), (2, What::Arrived), (2, What::Completed)]);
    residency.drop_strangers(25);
    assert_eq!((residency.take_aborted(), residency.used_bytes()), (vec![3], 20));
}

#[test]
fn what_a_session_had_begun_counts_when_it_goes_on() {
    let mut residency = Residency::new(1000, ClientSettings::unlimited());
    for rep in 1..=4 {
        residency.fetch(&fetch(rep, 10, 10), 0);
        if rep < 4 {
            residency.responded(rep, 1);
        }
    }
    residency.take_happened();
    assert_eq!(residency.greet(), [0u32; 0]);
    residency.arrived(1, 2);
    residency.show(10);
    residency.arrived(2, 11);
    residency.take_happened();
    residency.resumed(12);
    assert_eq!(said(&mut residency), [(1, What::Completed), (2, What::Arrived), (3, What::Responded)]);
    // Of the fourth nothing has come: the server takes it as over, and may ask anew.
    residency.drop_strangers(13);
    assert_eq!(residency.take_aborted(), [4]);
}

#[derive(Clone, Debug)]
enum Step {
    Fetch(u32, u64, u64, Option<u32>, Vec<u32>),
    Cancel(u32),
    Discard(u32),
    Responded(u32),
    Arrived(u32),
    Fail(u32),
    Show,
    Greet,
    Resumed,
    Drop,
}

fn step() -> impl Strategy<Value = Step> {
    let rep = 0..12u32;
    prop_oneof![
        3 => (rep.clone(), 0..60u64, 0..80u64, prop::option::of(0..12u32), prop::collection::vec(0..12u32, 0..3))
            .prop_map(|(r, w, d, after, x)| Step::Fetch(r, w, d, after.filter(|a| *a < r), x)),
        1 => rep.clone().prop_map(Step::Cancel),
        1 => rep.clone().prop_map(Step::Discard),
        1 => rep.clone().prop_map(Step::Responded),
        3 => rep.clone().prop_map(Step::Arrived),
        1 => rep.prop_map(Step::Fail),
        2 => Just(Step::Show),
        1 => Just(Step::Greet),
        1 => Just(Step::Resumed),
        1 => Just(Step::Drop),
    ]
}

proptest! {
    // Whatever the server says and in whatever order: the account is the sum of what is held, and within the budget.
    #[test]
    fn memory_never_exceeds_the_budget(steps in prop::collection::vec(step(), 0..80), budget in 0..300u64) {
        let mut residency = Residency::new(budget, ClientSettings::default());
        for (i, step) in steps.into_iter().enumerate() {
            let at = i as u64 * 20_000_000;
            match step {
                Step::Fetch(rep, wire, decoded, after, discard_on_arrival) => {
                    residency.fetch(&Fetch { after, discard_on_arrival, ..fetch(rep, wire, decoded) }, at);
                }
                Step::Cancel(rep) => residency.cancel(rep, at),
                Step::Discard(rep) => residency.discard(rep, at),
                Step::Responded(rep) => residency.responded(rep, at),
                Step::Arrived(rep) => residency.arrived(rep, at),
                Step::Fail(rep) => residency.fail(rep, at, String::new()),
                Step::Show => residency.show(at),
                Step::Greet => { residency.greet(); }
                Step::Resumed => residency.resumed(at),
                Step::Drop => residency.drop_strangers(at),
            }
            let held: u64 = residency.held.values().map(|held| match held.stage {
                Stage::InFlight => held.wire_bytes,
                Stage::Arrived => held.wire_bytes + held.decoded_bytes,
                Stage::Resident => held.decoded_bytes,
            }).sum();
            prop_assert_eq!(residency.used, held);
            prop_assert_eq!(residency.in_flight, residency.held.values().filter(|h| h.stage == Stage::InFlight).count());
            prop_assert!(residency.used_max <= budget);
        }
    }
}
