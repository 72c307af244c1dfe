//! Links as they come, and as they must not.

use foresight_scheduler::units::Time;
use proptest::prelude::*;

use super::parse::{ASSUMED_RTT, from_bytes, from_specification};
use super::{LinkTrace, built_in};
use crate::recorded::data;

const MS: u64 = 1_000_000;
const S: u64 = 1_000_000_000;

fn parse(text: &str) -> Result<LinkTrace, String> {
    from_bytes("t", text.as_bytes()).map_err(|error| error.to_string())
}

fn bytes(link: &LinkTrace, from: u64, to: u64) -> u64 {
    link.bytes_deliverable(Time(from), Time(to))
}

#[test]
fn rates_hold_until_the_next_line() {
    let link = parse("\u{feff}# seconds, Mbit/s\r\n10.5 8\r\n\r\n11.5\t4\n  13.5   0.8 \n").unwrap();
    assert_eq!(link.period(), Time(5 * S));
    assert_eq!(bytes(&link, 0, S), 1_000_000);
    assert_eq!(bytes(&link, S, 3 * S), 1_000_000);
    // The last rate holds for the median step (of 1 and 2 s the upper), then the trace repeats.
    assert_eq!(bytes(&link, 3 * S, 5 * S), 200_000);
    assert_eq!(bytes(&link, 4 * S, 6 * S), 1_100_000);
    assert_eq!(link.rtt_at(Time::ZERO), ASSUMED_RTT);
    assert!(link.notes().iter().any(|note| note.contains("50 ms assumed")), "{:?}", link.notes());
    assert!(link.notes().iter().any(|note| note.contains("shifted to 0")));
}

#[test]
fn repeated_and_regressing_times_are_dropped_and_reported() {
    let link = parse("0 8\n1 8\n1 99\n0.5 99\n2 8\n").unwrap();
    assert_eq!(bytes(&link, 0, 3 * S), 3_000_000);
    assert!(link.notes().iter().any(|note| note.starts_with("2 lines dropped")));
    assert!(parse("3 8\n2 8\n1 8\n0 8\n").unwrap_err().contains("3 of 4 times"));
}

#[test]
fn mahimahi_is_recognised_by_its_single_column() {
    let link = parse("0\n1\n1\n4\n").unwrap();
    assert_eq!(link.period(), Time(4 * MS));
    assert_eq!(bytes(&link, 0, 4 * MS), 6000);
    assert!(parse("12\n16\n14\n").unwrap_err().contains("line 3: 14 after 16: not a supported link format"));
    assert!(parse("0\n0\n").unwrap_err().contains("expected a trace that lasts"));
    assert!(parse("18446744073709551615\n").unwrap_err().contains("at most"));
    assert!(parse("1\n2.5\n").unwrap_err().contains("line 2: `2.5` is not a supported link format"));
}

#[test]
fn what_is_no_link_is_refused_with_the_reason() {
    assert!(LinkTrace::from_opportunities("t", &[5, 0], ASSUMED_RTT).is_err());
    assert!(parse("").unwrap_err().contains("is empty"));
    assert!(parse("# nothing\n\n").unwrap_err().contains("is empty"));
    assert!(parse("0 5\n1 -3\n").unwrap_err().contains("line 2: a rate of -3 Mbit/s"));
    assert!(parse("0 NaN\n").unwrap_err().contains("line 1: a rate of NaN"));
    assert!(parse("0 1e300\n").unwrap_err().contains("at most"));
    assert!(parse("0 1\n1e300 1\n").unwrap_err().contains("at most"));
    assert!(parse("0 1\ninf 1\n").unwrap_err().contains("at most"));
    assert!(parse("0 1\n1 x\n").unwrap_err().contains("line 2: `1 x`; expected two numbers"));
    assert!(parse("0 1 2\n").unwrap_err().contains("not a supported link format"));
    assert!(parse("Timestamp,Longitude\n1,2\n").unwrap_err().contains("not a supported link format"));
    assert!(parse("Timestamp DL\n1 2\n").unwrap_err().contains("not a supported link format"));
    let none = parse("0 0\n1 0\n2 0\n").unwrap_err();
    assert_eq!(none, "t: the link delivers no byte in its 3 seconds; expected some capacity");
}

#[test]
fn specifications() {
    let link = from_specification("constant:5Mbit,40ms").unwrap();
    assert_eq!((link.mean_rate(), link.rtt_at(Time::ZERO)), (625_000.0, Time(40 * MS)));
    assert!(link.notes().is_empty());
    let link = from_specification("constant:1.5Gbit/s,0.25s,scale=0.5,rtt=7").unwrap();
    assert_eq!((link.mean_rate(), link.rtt_at(Time::ZERO)), (93_750_000.0, Time(7 * MS)));
    assert_eq!(from_specification("constant:64kbps,1500us").unwrap().rtt_at(Time::ZERO), Time(1_500_000));

    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("a,b.txt");
    std::fs::write(&file, "0 8\n1 16\n").unwrap();
    let file = file.to_str().unwrap();
    let link = from_specification(&format!("{file},scale=2,start=0.5,rtt=80ms")).unwrap();
    assert_eq!(link.rtt_at(Time::ZERO), Time(80 * MS));
    assert!(link.notes().is_empty(), "{:?}", link.notes());
    assert_eq!(bytes(&link, 0, S), 1_000_000 + 2_000_000);
    assert!(link.name().ends_with("a,b.txt,scale=2,start=0.5,rtt=80ms"));
    // Beyond the period the start wraps around.
    let wrapped = from_specification(&format!("{file},start=2.5")).unwrap();
    assert_eq!(wrapped.offset(), Time(S / 2));
    assert_eq!(wrapped.notes().len(), 1);

    for (spec, expected) in [
        ("constant:5Mbit", "no round trip"),
        ("constant:5,40ms", "rate `5`"),
        ("constant:-5Mbit,40ms", "rate `-5Mbit`"),
        ("constant:0Mbit,40ms", "rate `0Mbit`"),
        ("constant:5Mbit,40", "round trip `40`"),
        ("constant:9e99Gbit,40ms", "expected at most"),
        ("constant:5Mbit,40ms,scale=0", "scale `0`"),
        ("constant:5Mbit,40ms,scale=nan", "scale `nan`"),
        ("constant:5Mbit,40ms,start=-1", "start `-1`"),
        ("constant:5Mbit,40ms,rtt=1e99", "rtt `1e99`"),
        ("constant:5Mbit,40ms,speed=3", "unknown option `speed`"),
        ("constant:5Mbit,40ms,loss=1.5", "loss `1.5`"),
        ("constant:5Mbit,40ms,loss=NaN", "loss `NaN`"),
        ("constant:5Mbit,rtt=3,delay=x", "both rtt and delay"),
        ("constant:5Mbit,delay=no/such/delays", "no/such/delays"),
        ("constant:5Mbit,40ms,rtt=3,rtt=4", "given twice"),
        ("no/such/file", "no/such/file"),
    ] {
        let error = from_specification(spec).unwrap_err().to_string();
        assert!(error.contains(expected), "{spec}: {error}");
    }
}

#[test]
fn scaling_and_shifting() {
    let link = parse("0\n1\n2\n2\n").unwrap();
    let half = link.scaled(0.5).unwrap();
    assert_eq!(bytes(&half, 0, 2 * MS), 3000);
    assert_eq!(bytes(&half, 0, MS), 750);
    let shifted = link.shifted(Time(MS));
    assert_eq!(bytes(&shifted, 0, MS), 4500);
    assert_eq!(bytes(&shifted, MS, 2 * MS), 1500);
    assert_ne!(link.hash(), shifted.hash());
    assert_ne!(link.hash(), half.hash());
    assert_eq!(link.hash(), link.shifted(Time(4 * MS)).hash());
    assert!(link.scaled(1e-30).is_err());
    assert!(link.scaled(1e30).is_err());
    assert!(parse("0 1\n").unwrap().scaled(f64::INFINITY).is_err());
}

#[test]
fn the_built_in_link_is_what_it_says() {
    let link = built_in();
    assert!((link.mean_rate() - 187_500.0).abs() < 100.0);
    assert_eq!((link.period(), link.rtt_at(Time::ZERO)), (Time(120 * S), Time(60 * MS)));
    let seconds: Vec<u64> = (0..120).map(|s| bytes(&link, s * S, (s + 1) * S)).collect();
    assert_eq!(seconds.iter().filter(|&&b| b < 18_750).count(), 13, "{seconds:?}");
    assert!(*seconds.iter().max().unwrap() < 1_000_000);
    assert_eq!(link.hash(), built_in().hash());
    assert_eq!(&link.hash().to_hex()[..16], "26b5e0486592c45a");
}

#[test]
fn recorded_links_load() {
    let Some(folder) = data("network") else { return };
    let (mut loaded, mut refused) = (0, 0);
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap().to_owned();
        if name.ends_with(".source.txt") {
            continue;
        }
        let link = from_specification(path.to_str().unwrap());
        if !name.ends_with(".delay") {
            let link = link.unwrap_or_else(|error| panic!("{error}"));
            loaded += 1;
            let (mean, period) = (link.mean_rate() * 8e-6, link.period().secs());
            println!("{name}: {mean:.3} Mbit/s, {period} s, {:?}, {:?}", link.rtt_range(), link.notes());
            if name.starts_with("irish5g") {
                let notes = link.notes().join("\n");
                assert!(notes.contains("rows share their second") && notes.contains("PINGAVG"), "{notes}");
                assert!(!notes.contains("assumed"), "{notes}");
            }
            if name.starts_with("starlink") {
                assert_eq!(link.rtt_range(), (Time(16 * MS), Time(86 * MS)));
                assert_eq!((link.rtt_at(Time::ZERO), link.rtt_at(Time(30 * MS))), (Time(24 * MS), Time(32 * MS)));
            }
            if name.ends_with(".down") {
                let text = std::fs::read_to_string(&path).unwrap();
                let count = text.split_ascii_whitespace().count() as u64;
                assert_eq!(link.bytes_deliverable(Time::ZERO, link.period()), 1500 * count);
            }
        } else {
            let error = link.unwrap_err().to_string();
            assert!(error.contains("not a supported link format"), "{error}");
            refused += 1;
        }
    }
    assert!(loaded >= 12 && refused == 1, "{loaded} loaded, {refused} refused");
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let _ = from_bytes("t", &bytes);
    }

    #[test]
    fn nor_do_near_misses(text in "[0-9. \n\\-e#xNaif]{0,80}") {
        if let Ok(link) = from_bytes("t", text.as_bytes()) {
            prop_assert!(link.mean_rate() > 0.0 && link.mean_rate().is_finite());
            let _ = link.bytes_deliverable(Time(5), Time::NEVER);
            let _ = link.scaled(1e-9);
        }
    }
}
