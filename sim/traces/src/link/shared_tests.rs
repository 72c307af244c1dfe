//! What the shared link must answer: closed forms, conservation, independence of how it is advanced.

use foresight_scheduler::units::Time;
use proptest::prelude::*;

use super::{LinkTrace, NANO_BITS_PER_BYTE, RatePiece, SharedLink};

const MS: u64 = 1_000_000;
const S: u64 = 1_000_000_000;

fn constant(bits_per_second: u64, rtt: u64) -> LinkTrace {
    LinkTrace::constant("test", bits_per_second, Time(rtt)).unwrap()
}

fn steps(rates: &[(u64, u64)], period: u64) -> LinkTrace {
    let pieces = rates.iter().map(|&(from, bits_per_second)| RatePiece { from: Time(from), bits_per_second }).collect();
    LinkTrace::from_rates("test", pieces, Time(period), Time(10 * MS)).unwrap()
}

/// Every completion, advancing from event to event.
fn run(link: &mut SharedLink) -> Vec<(u64, Time)> {
    let mut out = Vec::new();
    while let Some(at) = link.next_event() {
        link.advance(at, &mut out);
    }
    out
}

#[test]
fn one_transfer_takes_a_round_trip_and_its_bytes() {
    for (rate, bytes) in [(5_000_000, 1_000_000), (3, 1), (7_000_001, 12_345), (100_000_000_000, 4 << 30)] {
        let mut link = SharedLink::new(&constant(rate, 40 * MS), Time::ZERO);
        assert!(link.start(9, bytes, Time(S)));
        let expected = S + 40 * MS + (u128::from(bytes) * NANO_BITS_PER_BYTE).div_ceil(u128::from(rate)) as u64;
        assert_eq!(run(&mut link), [(9, Time(expected))]);
        assert_eq!(link.delivered(9), bytes);
        assert_eq!(link.total_work(), u128::from(bytes) * NANO_BITS_PER_BYTE);
        assert_eq!(link.next_event(), None);
    }
}

#[test]
fn simultaneous_transfers_end_when_processor_sharing_says() {
    let sizes = [700u64, 3, 1500, 700, 1_000_003, 42, 0];
    for rate in [8_000_000u64, 1_234_567, 1] {
        let mut link = SharedLink::new(&constant(rate, 25 * MS), Time::ZERO);
        for (id, &bytes) in sizes.iter().enumerate() {
            assert!(link.start(id as u64, bytes, Time::ZERO));
        }
        let mut ascending: Vec<(u64, u64)> = sizes.iter().enumerate().map(|(id, &bytes)| (bytes, id as u64)).collect();
        ascending.sort_unstable();
        let n = sizes.len();
        let mut expected = Vec::new();
        let mut sum = 0u128;
        for (k, &(bytes, id)) in ascending.iter().enumerate() {
            sum += u128::from(bytes);
            let work = (sum + (n - k - 1) as u128 * u128::from(bytes)) * NANO_BITS_PER_BYTE;
            expected.push((id, Time(25 * MS + work.div_ceil(u128::from(rate)) as u64)));
        }
        assert_eq!(run(&mut link), expected, "rate {rate}");
    }
}

#[test]
fn steps_and_outages_delay_as_they_should() {
    // 1 Mbit/s for 1 s, an hour of nothing, 2 Mbit/s for 1 s.
    let hour = 3600 * S;
    let trace = steps(&[(0, 1_000_000), (S, 0), (S + hour, 2_000_000)], 2 * S + hour);
    let mut link = SharedLink::new(&trace, Time::ZERO);
    // 990 ms of the first second remain: 123,750 bytes; 126,250 bytes at 2 Mbit/s are 505 ms.
    link.start(1, 250_000, Time::ZERO);
    assert_eq!(run(&mut link), [(1, Time(S + hour + 505 * MS))]);
    // Exactly what the first second carries ends with it, not after the outage.
    let mut link = SharedLink::new(&trace, Time::ZERO);
    link.start(1, 123_750, Time::ZERO);
    assert_eq!(run(&mut link), [(1, Time(S))]);
    // One begun during the outage waits it out; one of no bytes does not.
    let mut link = SharedLink::new(&trace, Time(2 * S));
    link.start(1, 250_000, Time::ZERO);
    link.start(2, 0, Time::ZERO);
    assert_eq!(run(&mut link), [(2, Time(10 * MS)), (1, Time(hour - S + S))]);
}

#[test]
fn a_later_transfer_takes_its_half_from_then_on() {
    // 8 Mbit/s are 1000 bytes a millisecond.
    let mut link = SharedLink::new(&constant(8_000_000, 0), Time::ZERO);
    link.start(1, 10_000, Time::ZERO);
    let mut out = Vec::new();
    link.advance(Time(4 * MS), &mut out);
    assert_eq!(link.delivered(1), 4000);
    link.start(2, 1000, Time(4 * MS));
    // 2 ends after 2 ms at half the rate, with 1 at 5000 of its 10,000 bytes.
    assert_eq!(run(&mut link), [(2, Time(6 * MS)), (1, Time(11 * MS))]);
    assert!(out.is_empty());
}

#[test]
fn cancelling_charges_what_was_delivered() {
    let mut link = SharedLink::new(&constant(8_000_000, 5 * MS), Time::ZERO);
    link.start(1, 10_000, Time::ZERO);
    link.start(2, 10_000, Time::ZERO);
    assert_eq!(link.cancel(1, Time(11 * MS)), 3000);
    assert_eq!(link.cancel(1, Time(11 * MS)), 3000);
    assert_eq!(link.total_delivered(), 6000);
    assert_eq!(link.active(), 1);
    // 7000 bytes remain and have the link alone.
    assert_eq!(run(&mut link), [(2, Time(18 * MS))]);
    assert_eq!(link.total_delivered(), 13_000);
    // Before it joined nothing is charged, and it never ends.
    link.start(3, 10, Time(20 * MS));
    assert_eq!(link.cancel(3, Time(21 * MS)), 0);
    assert_eq!(link.next_event(), None);
    // A completion that cancelling ran into is still reported.
    link.start(4, 1000, Time(30 * MS));
    assert_eq!(link.cancel(4, Time(S)), 1000);
    assert_eq!(run(&mut link), [(4, Time(36 * MS))]);
    assert_eq!(link.cancel(99, Time(S)), 0);
}

#[test]
fn an_id_under_way_is_not_started_again() {
    let mut link = SharedLink::new(&constant(8_000_000, 5 * MS), Time::ZERO);
    assert!(link.start(1, 1000, Time::ZERO));
    assert!(!link.start(1, 1000, Time::ZERO));
    assert_eq!(link.cancel(1, Time::ZERO), 0);
    assert!(link.start(1, 1000, Time::ZERO));
    assert_eq!(run(&mut link), [(1, Time(6 * MS))]);
    assert!(link.start(1, 2000, Time(10 * MS)));
    assert_eq!(run(&mut link), [(1, Time(17 * MS))]);
}

#[test]
fn a_mahimahi_trace_delivers_exactly_its_opportunities() {
    let trace = LinkTrace::from_opportunities("test", &[0, 2, 2, 5, 10], Time::ZERO).unwrap();
    assert_eq!(trace.bytes_deliverable(Time::ZERO, Time(10 * MS)), 5 * 1500);
    assert_eq!(trace.bytes_deliverable(Time(2 * MS - 1), Time(2 * MS)), 3000);
    assert_eq!(trace.bytes_deliverable(Time(2 * MS), Time(5 * MS)), 1500);
    // The opportunity at 0 of the next round falls together with the last of this one.
    assert_eq!(trace.bytes_deliverable(Time(5 * MS), Time(10 * MS)), 3000);
    assert_eq!(trace.bytes_deliverable(Time(10 * MS), Time(1010 * MS)), 100 * 5 * 1500);
    assert_eq!(trace.bytes_deliverable(Time(3), Time(3)), 0);
    assert_eq!(trace.mean_rate(), 750_000.0);

    let mut link = SharedLink::new(&trace, Time::ZERO);
    link.start(1, 2000, Time::ZERO);
    link.start(2, 100, Time::ZERO);
    link.start(3, 4000, Time::ZERO);
    // At 2 ms 3000 bytes: 100 to the second, 1450 to each other. At 5 ms 550 and 950, at 10 ms the rest and 1400 are lost.
    assert_eq!(run(&mut link), [(2, Time(2 * MS)), (1, Time(5 * MS)), (3, Time(10 * MS))]);
    assert_eq!(link.total_delivered(), 6100);
    // While nothing is active, opportunities are lost.
    link.start(4, 1500, Time(11 * MS));
    assert_eq!(run(&mut link), [(4, Time(12 * MS))]);
}

#[test]
fn ten_thousand_at_once_and_the_extremes_of_rate() {
    let mut link = SharedLink::new(&constant(100_000_000_000, 0), Time::ZERO);
    for id in 0..10_000 {
        link.start(id, 1000 + id % 7, Time::ZERO);
    }
    let out = run(&mut link);
    assert_eq!(out.len(), 10_000);
    let bytes: u64 = (0..10_000).map(|id| 1000 + id % 7).sum();
    assert_eq!(link.total_delivered(), bytes);
    assert_eq!(out[9_999].1, Time((u128::from(bytes) * NANO_BITS_PER_BYTE).div_ceil(100_000_000_000) as u64));
    assert!(out.is_sorted_by_key(|&(id, at)| (at, id)));

    // 4 GiB at 1 bit/s take 1089 years, more than a time holds: it never ends, and still shares fairly.
    let mut link = SharedLink::new(&constant(1, 0), Time::ZERO);
    link.start(1, 4 << 30, Time::ZERO);
    assert_eq!(link.next_event(), Some(Time::ZERO));
    link.start(2, 1, Time::ZERO);
    assert_eq!(link.next_event(), Some(Time::ZERO));
    let mut out = Vec::new();
    link.advance(Time::ZERO, &mut out);
    assert_eq!(link.next_event(), Some(Time(16 * S)));
    link.advance(Time(16 * S), &mut out);
    assert_eq!(out, [(2, Time(16 * S))]);
    assert_eq!(link.next_event(), None);
    assert_eq!(link.cancel(1, Time(24 * S)), 2);
}

#[test]
fn twenty_thousand_transfers_of_a_long_replay() {
    let trace = super::built_in();
    let mut link = SharedLink::new(&trace, Time::ZERO);
    let mut out = Vec::new();
    for id in 0..20_000u64 {
        let now = Time(id * 30 * MS);
        link.advance(now, &mut out);
        link.start(id, 15_000 + id % 1000, now);
        if id % 10 == 9 {
            link.cancel(id - 3, now);
        }
    }
    link.advance(Time::NEVER, &mut out);
    assert_eq!(link.active(), 0);
    let cancelled = (0..20_000u64).filter(|id| link.delivered(*id) < 15_000 + id % 1000).count();
    assert_eq!(out.len() + cancelled, 20_000);
}

#[derive(Clone, Debug)]
enum Call {
    Start { bytes: u64 },
    Cancel { nth: usize },
}

fn calls() -> impl Strategy<Value = Vec<(u64, Call)>> {
    let call = prop_oneof![
        4 => prop_oneof![0..5u64, 1..3000u64, 1..2_000_000u64].prop_map(|bytes| Call::Start { bytes }),
        1 => (0..20usize).prop_map(|nth| Call::Cancel { nth }),
    ];
    proptest::collection::vec((prop_oneof![Just(0), 0..50 * MS, 0..3 * S], call), 1..30)
}

fn traces() -> impl Strategy<Value = LinkTrace> {
    let rates =
        proptest::collection::vec((1..S, prop_oneof![Just(0), 1..100u64, 1..20_000_000u64]), 1..8).prop_map(|pieces| {
            let mut from = 0;
            let mut out = vec![RatePiece { from: Time::ZERO, bits_per_second: 999_983 }];
            for (length, bits_per_second) in pieces {
                from += length;
                out.push(RatePiece { from: Time(from), bits_per_second });
            }
            LinkTrace::from_rates("test", out, Time(from + S / 7), Time(13_000_003)).unwrap()
        });
    let opportunities = proptest::collection::vec(0..40u64, 1..60).prop_map(|gaps| {
        let mut ms = 1;
        let list: Vec<u64> = gaps
            .iter()
            .map(|gap| {
                ms += gap / 8;
                ms
            })
            .collect();
        LinkTrace::from_opportunities("test", &list, Time(13_000_003)).unwrap()
    });
    prop_oneof![rates, opportunities]
}

/// Carries the calls out, with extra advances in between, and answers all completions and the bytes cancelled.
fn carry_out(trace: &LinkTrace, calls: &[(u64, Call)], extra: &[u64]) -> (Vec<(u64, Time)>, Vec<u64>, SharedLink) {
    let mut link = SharedLink::new(trace, Time(S / 3));
    let (mut completions, mut cancelled) = (Vec::new(), Vec::new());
    let mut now = 0;
    for (i, (wait, call)) in calls.iter().enumerate() {
        let next = now + wait;
        for (k, fraction) in extra.iter().enumerate() {
            let step = wait / (extra.len() as u64 + 1);
            link.advance(Time((now + k as u64 * step + fraction % step.max(1)).min(next)), &mut completions);
        }
        now = next;
        match call {
            Call::Start { bytes } => {
                link.start(i as u64, *bytes, Time(now));
            }
            Call::Cancel { nth } => {
                cancelled.push(link.cancel(*nth as u64 % (i as u64 + 1), Time(now)));
            }
        }
    }
    for fraction in extra {
        now += fraction % (40 * MS);
        link.advance(Time(now), &mut completions);
    }
    link.advance(Time::NEVER, &mut completions);
    (completions, cancelled, link)
}

proptest! {
    #[test]
    fn how_the_link_is_advanced_changes_nothing(
        trace in traces(), calls in calls(), extra in proptest::collection::vec(0..u64::MAX, 0..12)
    ) {
        let (mut once, cancelled_once, _) = carry_out(&trace, &calls, &[]);
        let (mut often, cancelled_often, _) = carry_out(&trace, &calls, &extra);
        prop_assert!(often.is_sorted_by_key(|&(_, at)| at));
        once.sort_unstable();
        often.sort_unstable();
        prop_assert_eq!(once, often);
        prop_assert_eq!(cancelled_once, cancelled_often);
    }

    #[test]
    fn every_byte_is_accounted_for(trace in traces(), calls in calls()) {
        let mut link = SharedLink::new(&trace, Time::ZERO);
        let mut now = 0;
        let mut sizes = std::collections::BTreeMap::new();
        let mut out = Vec::new();
        // While something is active every nano-bit of capacity crosses the link, but for the last instant of a busy
        // period, and for less than a nano-bit a transfer at a cancellation.
        let check = |link: &mut SharedLink, to: Time, out: &mut Vec<(u64, Time)>| {
            loop {
                let event = link.next_event().map_or(to, |at| at.min(to));
                let (busy, before, from) = (link.active() > 0, link.total_work(), link.now());
                link.advance(event, out);
                let moved = link.total_work() - before;
                let capacity = link.trace().work_until(event) - link.trace().work_until(from);
                assert!(moved <= capacity, "more moved than the link delivers");
                if busy && link.active() > 0 {
                    assert_eq!(moved, capacity);
                } else if !busy {
                    assert_eq!(moved, 0);
                }
                if event == to {
                    break;
                }
            }
        };
        for (i, (wait, call)) in calls.iter().enumerate() {
            now += wait;
            check(&mut link, Time(now), &mut out);
            match call {
                Call::Start { bytes } => {
                    link.start(i as u64, *bytes, Time(now));
                    sizes.insert(i as u64, *bytes);
                }
                Call::Cancel { nth } => {
                    let id = *nth as u64 % (i as u64 + 1);
                    let bytes = link.cancel(id, Time(now));
                    prop_assert!(bytes <= sizes.get(&id).copied().unwrap_or(0));
                }
            }
        }
        link.advance(Time::NEVER, &mut out);
        for &(id, _) in &out {
            prop_assert_eq!(link.delivered(id), sizes[&id]);
        }
        // Every transfer ends or was cancelled; rounding takes less than a byte from each cancelled one.
        let sum: u64 = sizes.keys().map(|&id| link.delivered(id)).sum();
        let total = link.total_delivered();
        prop_assert!(sum <= total && total <= sum + calls.len() as u64, "{} {}", sum, total);
    }

    #[test]
    fn completions_agree_with_a_fluid_followed_step_by_step(
        rate in 1_000_000..50_000_000u64, jobs in proptest::collection::vec((0..300 * MS, 1..400_000u64), 1..20)
    ) {
        let mut link = SharedLink::new(&constant(rate, 20 * MS), Time(77));
        let mut jobs = jobs;
        jobs.sort_unstable();
        for (id, &(at, bytes)) in jobs.iter().enumerate() {
            link.start(id as u64, bytes, Time(at));
        }
        let mut out = run(&mut link);
        out.sort_unstable();

        // Seconds and bytes in floating point: from event to event, each active job receives an equal share.
        let mut left: Vec<f64> = jobs.iter().map(|&(_, bytes)| bytes as f64).collect();
        let joins: Vec<f64> = jobs.iter().map(|&(at, _)| Time(at + 20 * MS).secs()).collect();
        let mut ends = vec![f64::NAN; jobs.len()];
        let mut now = 0.0;
        while ends.iter().any(|end| end.is_nan()) {
            let active: Vec<usize> = (0..jobs.len()).filter(|&j| joins[j] <= now && ends[j].is_nan()).collect();
            let share = rate as f64 / 8.0 / active.len().max(1) as f64;
            let next_join = joins.iter().copied().filter(|&at| at > now).fold(f64::INFINITY, f64::min);
            let next_end = active.iter().map(|&j| now + left[j] / share).fold(f64::INFINITY, f64::min);
            let next = next_join.min(next_end);
            for &j in &active {
                left[j] -= share * (next - now);
                if left[j] < 1e-6 {
                    ends[j] = next;
                }
            }
            now = next;
        }
        for (&(id, at), end) in out.iter().zip(&ends) {
            prop_assert!((at.secs() - end).abs() < 5e-9, "{}: {} {}", id, at.secs(), end);
        }
        prop_assert_eq!(out.len(), jobs.len());
    }

    #[test]
    fn time_of_work_is_the_earliest(trace in traces(), start in 0..10 * S, work in 1..10_000_000_000_000_000u128) {
        let trace = trace.shifted(Time(start));
        let work = work + trace.work_until(Time::ZERO);
        let at = trace.time_of_work(work);
        prop_assert!(trace.work_until(at) >= work);
        if at > Time::ZERO {
            prop_assert!(trace.work_until(Time(at.0 - 1)) < work);
        }
    }
}
