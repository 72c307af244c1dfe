//! SABRE lists, G-NetTrack logs, delays, round trips that vary, and the figures that `inspect` prints.

use foresight_scheduler::units::Time;
use proptest::prelude::*;

use super::parse::{from_bytes, from_specification};
use super::{LinkStatistics, LinkTrace, RatePiece, RttPiece, SharedLink, delay, sabre};

const MS: u64 = 1_000_000;
const S: u64 = 1_000_000_000;

fn parse(text: &str) -> Result<LinkTrace, String> {
    from_bytes("t", text.as_bytes()).map_err(|error| error.to_string())
}

fn bytes(link: &LinkTrace, from: u64, to: u64) -> u64 {
    link.bytes_deliverable(Time(from), Time(to))
}

#[test]
fn a_sabre_list_gives_rates_and_round_trips() {
    let link = parse(
        "\u{feff} [{\"duration_ms\": 500, \"bandwidth_kbps\": 8000, \"latency_ms\": 20},
        {\"duration_ms\": 0, \"bandwidth_kbps\": 1, \"latency_ms\": 999},
        {\"latency_ms\": 80.5, \"duration_ms\": 1500, \"bandwidth_kbps\": 0.4, \"note\": [1]}]",
    )
    .unwrap();
    assert_eq!(link.period(), Time(2 * S));
    assert_eq!((bytes(&link, 0, S / 2), bytes(&link, S / 2, 2 * S)), (500_000, 75));
    assert_eq!(link.rtt_range(), (Time(20 * MS), Time(80_500_000)));
    let at = |ms: u64| link.rtt_at(Time(ms * MS)).0 / MS;
    assert_eq!([at(0), at(499), at(500), at(1999), at(2000), at(4700)], [20, 20, 80, 80, 20, 80]);
    assert_eq!(link.notes(), ["1 periods of no duration dropped"]);
    // The same latency throughout is a constant one.
    let constant = parse(
        r#"[{"duration_ms":1e3,"bandwidth_kbps":8,"latency_ms":9},{"duration_ms":1000,"bandwidth_kbps":16,"latency_ms":9}]"#,
    );
    let piece = |s: u64, bits_per_second| RatePiece { from: Time(s * S), bits_per_second };
    let same = LinkTrace::from_rates("t", vec![piece(0, 8000), piece(1, 16_000)], Time(2 * S), Time(9 * MS)).unwrap();
    assert_eq!(constant.unwrap().hash(), same.hash());

    for (bad, message) in [
        ("[", "line 1 column 1; expected a SABRE list"),
        ("[]", "no rates"),
        ("[[]]", "expected a SABRE list"),
        (r#"[{"duration_ms":1,"bandwidth_kbps":8}]"#, "missing field `latency_ms`"),
        (r#"[{"duration_ms":1,"bandwidth_kbps":8,"latency_ms":-1}]"#, "[0].latency_ms is -1; expected 0 to"),
        (r#"[{"duration_ms":1,"bandwidth_kbps":1e99,"latency_ms":1}]"#, "[0].bandwidth_kbps"),
        (
            r#"[{"duration_ms":9e11,"bandwidth_kbps":1,"latency_ms":1},{"duration_ms":9e11,"bandwidth_kbps":1,"latency_ms":1}]"#,
            "[1] ends at",
        ),
        (r#"[{"duration_ms":5,"bandwidth_kbps":0,"latency_ms":1}]"#, "delivers no byte"),
    ] {
        let error = parse(bad).unwrap_err();
        assert!(error.contains(message), "{bad}: {error}");
    }
    assert!(sabre::is_sabre(b" [") && !sabre::is_sabre(b"{") && !sabre::is_sabre(b""));
}

const LOG: &str = "Timestamp,Longitude,DL_bitrate,State,PINGAVG\n";

fn log(rows: &[&str]) -> Result<LinkTrace, String> {
    parse(&(LOG.to_owned() + &rows.join("\n")))
}

#[test]
fn a_g_nettrack_log_gives_a_rate_a_second() {
    let link = log(&[
        "2020.02.29_23.59.58,-8.3,8000,D,-",
        "2020.02.29_23.59.58,-8.3,16000,D,-",
        "2020.02.29_23.59.59,-8.3,800,I,60.0",
        "2020.03.01_00.00.03,-8.3,0,D,80.0",
        "2020.03.01_00.00.02,-8.3,7,D,-",
        "2020.03.01_00.00.04,-8.3,-,D,-",
        "2020.03.01_00.00.05,-8.3,80,D,-",
    ])
    .unwrap();
    assert_eq!(link.period(), Time(8 * S));
    let seconds: Vec<u64> = (0..8).map(|s| bytes(&link, s * S, (s + 1) * S)).collect();
    assert_eq!(seconds, [1_500_000, 100_000, 100_000, 100_000, 100_000, 0, 0, 10_000]);
    let at = |s: u64| link.rtt_at(Time(s * S)).0 / MS;
    assert_eq!([at(0), at(1), at(4), at(5), at(7), at(8)], [60, 60, 60, 80, 80, 60]);
    let notes = link.notes().join("\n");
    for note in [
        "PINGAVG of 2 rows",
        "1 rows share",
        "4 seconds without",
        "at most 3 in",
        "1 rows dropped that are",
        "1 rows without",
        "1 rows in state I",
    ] {
        assert!(notes.contains(note), "{note} in {notes}");
    }
    let link = log(&["2020.02.29_23.59.58,-8.3,8000,D,-"]).unwrap();
    assert_eq!((link.period(), link.rtt_at(Time::ZERO)), (Time(S), super::parse::ASSUMED_RTT));
    assert!(link.notes().iter().any(|note| note.contains("assumed")));
    // Pings before the first rate: the last of them holds there.
    let link =
        log(&["2020.01.01_00.00.00,0,-,D,5", "2020.01.01_00.00.01,0,-,D,6", "2020.01.01_00.00.09,0,8,D,-"]).unwrap();
    assert_eq!((link.period(), link.rtt_range()), (Time(S), (Time(6 * MS), Time(6 * MS))));

    for (bad, message) in [
        ("2020.02.29,0,5,D,-", "line 2: a time of `2020.02.29`"),
        ("2020.02.29_23.59.58,0,x,D,-", "line 2: a DL_bitrate of `x`"),
        ("2020.02.29_23.59.58,0,-5,D,-", "a DL_bitrate of `-5`"),
        ("2020.02.29_23.59.58,0,NaN,D,-", "a DL_bitrate of `NaN`"),
        ("2020.02.29_23.59.58", "no row with a DL_bitrate"),
        ("2020.02.29_23.59.58,0,0,D,-", "delivers no byte"),
        ("1970.01.01_00.00.00,0,5,D,-\n9999.01.01_00.00.00,0,5,D,-", "line 3: 253"),
    ] {
        let error = log(&[bad]).unwrap_err();
        assert!(error.contains(message), "{bad}: {error}");
    }
    let backwards = ["05", "04", "03", "02"].map(|s| format!("2020.01.01_00.00.{s},0,5,D,-")).join("\n");
    assert!(log(&[&backwards]).unwrap_err().contains("expected rows in order of time"));
}

#[test]
fn delays_beside_a_trace_are_its_round_trips() {
    let delays = delay::parse("d", b"# ms\n10\n10\n\n25.5\n").unwrap();
    let piece = |from_ms: u64, rtt_us: u64| RttPiece { from: Time(from_ms * MS), rtt: Time(rtt_us * 1000) };
    assert_eq!(delays.pieces, [piece(0, 20_000), piece(10, 20_000), piece(20, 51_000)]);
    assert_eq!(delays.period, Time(30 * MS));
    for (bad, message) in
        [("", "no delay"), ("1\nx", "line 2: `x`"), ("-1", "`-1`"), ("NaN", "`NaN`"), ("1e12", "`1e12`")]
    {
        let error = delay::parse("d", bad.as_bytes()).unwrap_err().to_string();
        assert!(error.contains(message), "{bad}: {error}");
    }

    let directory = tempfile::tempdir().unwrap();
    let file = |name: &str, content: &str| {
        let path = directory.path().join(name);
        std::fs::write(&path, content).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let (trace, beside) = (file("a.down", "1\n2\n40\n"), file("a.delay", "10\n20\n"));
    let (alone, other) = (file("b.down", "1\n2\n40\n"), file("c.txt", "7\n9\n8\n"));
    let link = from_specification(&trace).unwrap();
    assert_eq!(link.rtt_range(), (Time(20 * MS), Time(40 * MS)));
    assert_eq!(link.notes(), [format!("round trips: twice the one-way delays in {beside}")]);
    // It repeats at its own end, 20 ms, and the trace at 40 ms; a start shifts both.
    let rtts = |link: &LinkTrace| [0, 9, 10, 19, 20, 55].map(|ms| link.rtt_at(Time(ms * MS)).0 / MS);
    assert_eq!(rtts(&link), [20, 20, 40, 40, 20, 40]);
    assert_eq!(rtts(&link.shifted(Time(10 * MS))), [40, 40, 20, 20, 40, 20]);
    assert_eq!(rtts(&link.scaled(2.0).unwrap()), rtts(&link));
    assert_eq!(from_specification(&format!("{trace},rtt=5")).unwrap().rtt_range(), (Time(5 * MS), Time(5 * MS)));
    assert!(from_specification(&alone).unwrap().notes()[0].contains("50 ms assumed"));
    let with = |spec: String| from_specification(&spec).unwrap();
    assert_eq!(with(format!("{alone},delay={other},loss=0.25")).rtt_range(), (Time(14 * MS), Time(18 * MS)));
    assert_eq!(with(format!("{alone},delay={other},loss=0.25")).loss(), 0.25);
    assert_eq!(with(format!("constant:5Mbit,delay={other}")).rtt_at(Time(10 * MS)), Time(18 * MS));
    assert_ne!(with(format!("{alone},loss=0.25")).hash(), with(alone.clone()).hash());
    assert_eq!(with(format!("{alone},loss=0")).hash(), with(alone).hash());
}

#[test]
fn a_later_request_may_come_first() {
    // 100 ms at first, 10 ms from 50 ms on; 8 Mbit/s are a byte a microsecond.
    let pieces =
        [RttPiece { from: Time::ZERO, rtt: Time(100 * MS) }, RttPiece { from: Time(50 * MS), rtt: Time(10 * MS) }];
    let link = LinkTrace::constant("t", 8_000_000, Time::ZERO).unwrap().with_varying_rtt(&pieces, Time(S)).unwrap();
    let mut shared = SharedLink::new(&link, Time::ZERO);
    let mut ended = Vec::new();
    shared.start(1, 10_000, Time::ZERO);
    shared.start(2, 10_000, Time(60 * MS));
    shared.start(3, 10_000, Time(95 * MS));
    shared.advance(Time(S), &mut ended);
    // 2 from 70 to 80 ms; 1 alone from 100 ms, with 3 from 105 ms: 5 ms left, then half each.
    assert_eq!(ended, [(2, Time(80 * MS)), (1, Time(115 * MS)), (3, Time(120 * MS))]);
    // Cancelled before it joins, asked for again, and joined once.
    shared.start(4, 10_000, Time(S));
    assert_eq!(shared.cancel(4, Time(S + MS)), 0);
    assert!(shared.start(4, 10_000, Time(S + 60 * MS)));
    ended.clear();
    shared.advance(Time(2 * S), &mut ended);
    assert_eq!(ended, [(4, Time(S + 80 * MS))]);
}

#[test]
fn statistics_of_a_link() {
    let piece = |s: u64, bits_per_second| RatePiece { from: Time(s * S), bits_per_second };
    let pieces = vec![piece(0, 0), piece(1, 8000), piece(5, 80), piece(6, 16_000), piece(9, 0)];
    let link = LinkTrace::from_rates("t", pieces, Time(10 * S), Time::ZERO).unwrap();
    let statistics = LinkStatistics::new(&link);
    // By the second, bytes/s: 0, 0, 10, 1000 × 4, 2000 × 3.
    assert_eq!(statistics.percentiles, [0.0, 10.0, 1000.0, 2000.0, 2000.0]);
    assert_eq!((statistics.near_zero_share, statistics.longest_near_zero), (0.3, Time(2 * S)));
    assert_eq!(statistics.longest_outage, Time(2 * S));
    let link = LinkTrace::from_opportunities("t", &[0, 100, 700, 2500], Time::ZERO).unwrap();
    let statistics = LinkStatistics::new(&link);
    assert_eq!(statistics.longest_outage, Time(1800 * MS));
    // 2 in the first second, none in the second, 2 in half a second.
    assert_eq!(statistics.percentiles, [0.0, 0.0, 3000.0, 6000.0, 6000.0]);
    let constant = LinkTrace::constant("t", 1, Time::ZERO).unwrap();
    assert_eq!(LinkStatistics::new(&constant).longest_outage, Time::ZERO);
    let endless = LinkTrace::from_rates("t", vec![piece(0, 8_000_000)], Time(S * 999_999_999), Time::ZERO).unwrap();
    assert!(LinkStatistics::new(&endless).percentiles.iter().all(|rate| (rate - 1e6).abs() < 1.0));
}

#[test]
fn round_trips_out_of_order_are_refused() {
    let link = LinkTrace::constant("t", 8, Time::ZERO).unwrap();
    let piece = |from: u64| RttPiece { from: Time(from), rtt: Time(from) };
    for (pieces, period) in [
        (vec![], 5),
        (vec![piece(1)], 5),
        (vec![piece(0), piece(3), piece(3)], 5),
        (vec![piece(0), piece(5)], 5),
        (vec![piece(0)], 0),
        (vec![RttPiece { from: Time::ZERO, rtt: Time::NEVER }], 5),
    ] {
        assert!(link.with_varying_rtt(&pieces, Time(period)).is_err(), "{pieces:?}");
    }
    assert!(link.with_loss(-0.1, 1).is_err() && link.with_loss(f64::NAN, 1).is_err());
}

proptest! {
    #[test]
    fn no_bytes_make_them_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = delay::parse("t", &bytes);
        let _ = from_bytes("t", &[b"[", &bytes[..]].concat());
        let _ = from_bytes("t", &[LOG.as_bytes(), &bytes].concat());
    }

    #[test]
    fn nor_do_near_misses(
        rows in prop::collection::vec("(2020|1970|9999)\\.0[12]\\.[0-3][0-9]_0[01]\\.[0-5][0-9]\\.[0-5][0-9],0,[0-9.-]{1,5},[DI],[0-9.-]{1,3}", 1..8),
        periods in prop::collection::vec((0.0..5.0f64, -1.0..9e3f64, 0.0..300.0f64), 1..8),
    ) {
        let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
        let list: Vec<String> = periods.iter().map(|(d, b, l)| {
            format!("{{\"duration_ms\":{d},\"bandwidth_kbps\":{b},\"latency_ms\":{l}}}")
        }).collect();
        for link in [log(&rows), parse(&format!("[{}]", list.join(",")))].into_iter().flatten() {
            prop_assert!(link.mean_rate() > 0.0 && link.mean_rate().is_finite());
            let (least, greatest) = link.rtt_range();
            let at = link.rtt_at(Time(123_456_789));
            prop_assert!(least <= at && at <= greatest);
            let statistics = LinkStatistics::new(&link);
            prop_assert!(statistics.percentiles.is_sorted() && statistics.longest_outage <= link.period());
        }
    }
}
