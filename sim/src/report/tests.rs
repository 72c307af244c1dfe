//! The report of made-up comparisons: what it must contain, and what it must never.

use quick_xml::Reader;
use quick_xml::events::Event;

use super::*;
use crate::outcome::{
    Arrival, DecisionNanos, Inputs, Interval, Intervals, Limits, PolicyOutcome, PolicySeries, Pressure, SCHEMA_VERSION,
    Series, ShadowPrices, UpperBound,
};

const NAMES: [&str; 5] = ["foresight", "foresight,alpha=1", "screen-space-error", "distance", "lru-random"];
const FRAMES: usize = 3600;

/// Two minutes of flight over a city, the link starved and gone from 50 s to 58 s, nothing in view from 80 s to 86 s.
fn synthetic() -> Comparison {
    let frame_s: Vec<f64> = (0..FRAMES).map(|k| k as f64 / 30.0).collect();
    let seen = |t: f64| !(80.0..86.0).contains(&t);
    let capacity: Vec<f64> =
        (0..120).map(|s| if (50..58).contains(&s) { 0.0 } else { 6e5 + 4e5 * libm::sin(f64::from(s) / 9.0) }).collect();
    let path_xy: Vec<[f64; 2]> =
        frame_s.iter().map(|t| [18.0 * t, 300.0 * libm::sin(t / 19.0) + 120.0 * libm::sin(t / 7.0)]).collect();
    let mut comparison = Comparison {
        schema_version: SCHEMA_VERSION,
        inputs: Inputs {
            world: "built-in city".to_owned(),
            world_hash: "9f2c".repeat(16),
            representations: 21_845,
            path: "built-in flight".to_owned(),
            path_hash: "11ab".repeat(16),
            link: "built-in link".to_owned(),
            link_hash: "c0de".repeat(16),
            place: "centre, height 2 m".to_owned(),
            duration_s: 120.0,
            memory_bytes: 64 << 20,
            alpha: 0.7,
            worst_case: "union".to_owned(),
            refinement: "partial".to_owned(),
            warm: false,
            announce_s: None,
            head: None,
            seed: 1,
            starts_s: vec![0.0, 31.5, 77.25],
            viewport: [1280, 720],
            fov_y_deg: 60.0,
        },
        pressure: Pressure { lambda: 1.84, rho: 2.71, mu: 1.31, largest_need_bytes: 51_200_000 },
        nonempty_share: 0.95,
        upper_bound: UpperBound {
            mean_quality: Some(0.951),
            method: "per frame, within the bytes deliverable".to_owned(),
            by_frame: Some(0.951),
            over_time: Some(0.957),
        },
        shadow_prices: Some(ShadowPrices {
            interval_s: 1.0,
            per_mbit_s: (0..120).map(|s| 1e-4 / f64::from(s + 1)).collect(),
            per_mib: vec![2e-6; 120],
            per_mbit_s_throughout: 5.4e-4,
            per_mib_throughout: 2.4e-4,
            per_percent_of_link: 1.5e-4,
            per_percent_of_memory: 1.2e-4,
        }),
        limits: Some(Limits::new(0.9, 0.92, 0.93, 0.951)),
        policies: Vec::new(),
        warnings: vec!["5.0 % of the frames have nothing in view".to_owned()],
        series: Series {
            bound: frame_s.iter().map(|t| seen(*t).then(|| 1.0 - 0.9 * libm::exp(-t) - 0.02)).collect(),
            second_s: (0..120).map(f64::from).collect(),
            capacity_bytes: capacity.clone(),
            path_xy,
            frame_s: frame_s.clone(),
            policies: Vec::new(),
        },
    };
    for (rank, name) in NAMES.into_iter().enumerate() {
        let (outcome, series) = policy(rank as f64, name, &frame_s, &capacity, seen);
        comparison.policies.push(outcome);
        comparison.series.policies.push(series);
    }
    comparison
}

fn policy(
    rank: f64,
    name: &str,
    frame_s: &[f64],
    capacity: &[f64],
    seen: impl Fn(f64) -> bool,
) -> (PolicyOutcome, PolicySeries) {
    let at = |t: f64| {
        let start = libm::exp(-t / (2.0 + 3.0 * rank));
        let dips = (0.04 + 0.05 * rank) * (1.0 + libm::sin(t * (1.0 + 0.3 * rank)) * libm::sin(t / 5.0 + rank));
        let outage = if (50.0..66.0).contains(&t) { 0.12 * (1.0 + 0.4 * rank) } else { 0.0 };
        (1.0 - 0.95 * start - dips - outage).clamp(0.0, 1.0)
    };
    let quality: Vec<Option<f64>> = frame_s.iter().map(|t| seen(*t).then(|| at(*t))).collect();
    let shown: Vec<f64> = quality.iter().flatten().copied().collect();
    let mean = shown.iter().sum::<f64>() / shown.len() as f64;
    let used: Vec<f64> =
        capacity.iter().enumerate().map(|(s, c)| c * if s as f64 > 95.0 - 8.0 * rank { 0.35 } else { 0.97 }).collect();
    let fetched: f64 = used.iter().sum();
    let filled = |t: f64| (0.1 + t / (20.0 + 9.0 * rank)).min(0.985 - 0.02 * libm::sin(t * 3.0).abs());
    let around = |value: f64, half: f64| Some(Interval { lower: value - half, upper: value + half });
    let outcome = PolicyOutcome {
        mean_deficit_by_start: Vec::new(),
        alpha: None,
        name: name.to_owned(),
        mean_quality: Some(mean),
        mean_deficit: Some(1.0 - mean),
        p05_quality: Some(mean - 0.21),
        seconds_below_0_9: 31.0 + 14.0 * rank,
        seconds_to_0_9: (rank < 4.0).then_some(4.2 + 3.0 * rank),
        share_within_16px: Some(0.71 - 0.06 * rank),
        bytes_fetched: fetched,
        bytes_wasted: fetched * (0.04 + 0.06 * rank),
        bytes_cancelled: fetched * 0.015 * rank,
        failures: 0.0,
        evictions: 212.0 * rank,
        decisions: 900.0,
        decision_ns: DecisionNanos { p50: 41_300, p99: 388_000, max: 2_100_000 },
        regret: None,
        interval: Some(Intervals {
            mean_quality: around(mean, 0.012),
            mean_deficit: around(mean, 0.012),
            ..Intervals::default()
        }),
    };
    let memory_bytes = frame_s.iter().map(|t| (filled(*t) * f64::from(64 << 20)) as u64).collect();
    (outcome, PolicySeries { name: name.to_owned(), quality, memory_bytes, used_bytes: used, arrivals: arrivals(rank) })
}

/// A quadtree of 2560 m around the path, finer near it, fetched as the camera comes by.
fn arrivals(rank: f64) -> Vec<Arrival> {
    let mut arrivals = Vec::new();
    for depth in 0..7u32 {
        let cells = 1i32 << depth;
        let half = 1280.0 / f64::from(cells);
        for i in 0..cells {
            for j in 0..cells {
                let centre = [f64::from(2 * i + 1) * half - 200.0, f64::from(2 * j + 1) * half - 1280.0];
                let t = (centre[0] / 18.0).clamp(0.0, 119.0);
                let route = 300.0 * libm::sin(t / 19.0) + 120.0 * libm::sin(t / 7.0);
                let reach = (2.5 + 0.5 * rank) * half + 40.0;
                if (centre[1] - route).abs() < reach && centre[0] < 2200.0 {
                    arrivals.push(Arrival {
                        at_s: (t - 8.0 + 2.0 * f64::from(depth) + rank).clamp(0.0, 119.0),
                        centre,
                        half: [half, half],
                        depth,
                    });
                }
            }
        }
    }
    arrivals
}

fn empty() -> Comparison {
    Comparison {
        schema_version: SCHEMA_VERSION,
        inputs: Inputs::default(),
        pressure: Pressure::default(),
        nonempty_share: 0.0,
        upper_bound: UpperBound::default(),
        shadow_prices: None,
        limits: None,
        policies: Vec::new(),
        warnings: Vec::new(),
        series: Series::default(),
    }
}

/// Elements of HTML that have no end tag.
const VOID: [&str; 2] = ["meta", "input"];

/// Every element is closed in order, every SVG number is finite, nothing is loaded.
fn check(page: &str) {
    let mut reader = Reader::from_str(page);
    reader.config_mut().check_end_names = false;
    let mut open: Vec<String> = Vec::new();
    loop {
        match reader.read_event().unwrap_or_else(|e| panic!("{e} at byte {}", reader.error_position())) {
            Event::Start(tag) => {
                let name = tag.name().as_ref().to_owned();
                for attribute in tag.html_attributes() {
                    let attribute = attribute.unwrap();
                    check_attribute(attribute.key.as_ref(), &attribute.value);
                }
                if !VOID.contains(&name.as_str()) {
                    open.push(name);
                }
            }
            Event::End(tag) => assert_eq!(open.pop().as_deref(), Some(tag.name().as_ref())),
            Event::Eof => break,
            _ => {}
        }
    }
    assert!(open.is_empty(), "never closed: {open:?}");
    for forbidden in ["NaN", "inf\"", "inf ", "http://", "https://", "<script", "<link", "<img", "@import", "undefined"]
    {
        assert!(!page.contains(forbidden), "{forbidden} in the page");
    }
    assert!(page.len() < 3_000_000, "{} bytes", page.len());
}

fn check_attribute(key: &str, value: &str) {
    assert!(!key.starts_with("on") && !["src", "xlink:href"].contains(&key), "{key}={value}");
    match key {
        "href" => assert!(value.starts_with('#'), "{value}"),
        "d" => {
            let numbers = value.split(|c: char| c.is_ascii_alphabetic() || c == ' ').filter(|n| !n.is_empty());
            numbers.for_each(|n| assert!(n.parse::<f64>().is_ok_and(f64::is_finite), "{n} in a path"));
        }
        "x" | "y" | "width" | "height" if !value.starts_with("device") => {
            let number = value.trim_end_matches('%').parse::<f64>();
            assert!(number.is_ok_and(|n| n.is_finite() && n >= 0.0), "{key}={value}");
        }
        _ => {}
    }
}

#[test]
fn the_page_of_a_full_comparison_is_sound_and_says_what_came_out() {
    let comparison = synthetic();
    let page = html_with_command(&comparison, "foresight-sim replay --policy all --starts 3");
    check(&page);
    assert_eq!(page, html_with_command(&comparison.clone(), "foresight-sim replay --policy all --starts 3"));
    for expected in ["foresight comes out ahead", "starved", "upper bound", "replay --policy all", "id=\"warnings\""] {
        assert!(page.contains(expected), "{expected} is missing");
    }
    assert!(page.find("id=\"figures\"") < page.find("id=\"quality\""));
    assert!(page.find("id=\"map\"") < page.find("id=\"replay\""));
}

#[test]
fn empty_comparisons_have_a_page_and_a_table() {
    let mut no_frames = synthetic();
    no_frames.series = Series::default();
    let mut no_policies = synthetic();
    no_policies.policies.clear();
    no_policies.series.policies.clear();
    for comparison in [empty(), no_frames, no_policies] {
        check(&html(&comparison));
        assert!(table(&comparison, 80).contains("upper bound"));
    }
    assert!(html(&empty()).contains("No policy was replayed."));
}

#[test]
fn one_start_one_frame_and_nothing_in_view() {
    let mut comparison = synthetic();
    comparison.inputs.starts_s.truncate(1);
    comparison.inputs.duration_s = 0.0;
    comparison.nonempty_share = 0.0;
    comparison.series.frame_s.truncate(1);
    comparison.series.path_xy.truncate(1);
    comparison.series.second_s.truncate(1);
    check(&html(&comparison));
    for (policy, series) in comparison.policies.iter_mut().zip(&mut comparison.series.policies) {
        (policy.mean_quality, policy.mean_deficit, policy.p05_quality) = (None, None, None);
        policy.share_within_16px = None;
        policy.interval = None;
        series.quality = vec![None];
        series.arrivals.clear();
    }
    comparison.upper_bound.mean_quality = None;
    comparison.series.bound = vec![None];
    let page = html(&comparison);
    check(&page);
    assert!(page.contains("Nothing was ever in view"));
}

#[test]
fn hostile_names_stay_text() {
    let mut comparison = synthetic();
    let hostile = "<script>alert(1)</script>\"' onload=x &amp; \u{1b}[31m\u{202e}";
    comparison.policies[0].name = hostile.to_owned();
    comparison.series.policies[0].name = hostile.to_owned();
    comparison.inputs.world = hostile.repeat(50);
    comparison.inputs.link_hash = hostile.to_owned();
    comparison.warnings.push(format!("]]>--></style>{hostile}"));
    let page = html_with_command(&comparison, hostile);
    check(&page);
    assert!(page.contains("&lt;script&gt;"));
    let text = table(&comparison, 120);
    assert!(!text.contains('\u{1b}') && !text.contains('\u{202e}'));
}

#[test]
fn numbers_that_are_none_are_not_drawn() {
    let mut comparison = synthetic();
    for (k, bad) in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308, -1e308].into_iter().enumerate() {
        let series = &mut comparison.series;
        series.frame_s[10 * k + 3] = bad;
        series.path_xy[7 * k] = [bad, 1.0];
        series.second_s[k] = bad;
        series.capacity_bytes[k + 9] = bad;
        series.policies[k].quality[50] = Some(bad);
        series.policies[k].used_bytes[4] = bad;
        series.policies[k].arrivals[3].at_s = bad;
        series.policies[k].arrivals[4].centre[1] = bad;
        series.policies[k].arrivals[5].half[0] = bad;
        comparison.policies[k].mean_quality = Some(bad);
        comparison.policies[k].bytes_fetched = bad;
        comparison.policies[k].bytes_wasted = bad;
    }
    comparison.pressure = Pressure { lambda: f64::NAN, rho: f64::INFINITY, mu: f64::NAN, largest_need_bytes: u64::MAX };
    comparison.inputs.duration_s = f64::INFINITY;
    comparison.inputs.memory_bytes = u64::MAX;
    comparison.nonempty_share = f64::NAN;
    comparison.upper_bound.mean_quality = Some(f64::NAN);
    check(&html(&comparison));
    let text = table(&comparison, 200);
    assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
}

#[test]
fn the_table_fits_its_width_and_repeats_the_names() {
    let comparison = synthetic();
    let wide = table(&comparison, 200);
    assert_eq!(wide.matches("lru-random").count(), 1);
    let narrow = table(&comparison, 80);
    assert!(narrow.matches("lru-random").count() > 1);
    let rows = narrow.lines().take_while(|l| !l.starts_with("bound  "));
    assert!(rows.clone().all(|l| l.chars().count() <= 80), "{narrow}");
    assert!(rows.clone().any(|l| l.starts_with("lru-random") && l.contains('–')), "what was never reached is a dash");
    assert!(table(&comparison, 0).contains("mean Q"));
    for expected in ["starved", "ρ 2.71", "upper bound", "0.951", "warning: 5.0 %", "±0.012"] {
        assert!(wide.contains(expected), "{expected} is missing in\n{wide}");
    }
}

#[test]
fn deficits_stand_relative_to_the_first_foresight() {
    let mut comparison = synthetic();
    for (policy, deficit) in comparison.policies.iter_mut().zip([0.0, 0.05, 0.2, 0.3, 0.0005]) {
        policy.mean_deficit = Some(deficit);
    }
    let page = html(&comparison);
    for relative in ["1.00", "50.00", "200.00", "300.00"] {
        assert!(page.contains(&format!(">{relative}<")), "{relative} is missing");
    }
    comparison.policies.drain(..2);
    let text = table(&comparison, 200);
    assert!(text.lines().any(|l| l.starts_with("distance") && l.contains(" –")), "{text}");
}

#[test]
fn files_are_written_whole_and_leave_nothing_beside() {
    let dir = tempfile::tempdir().unwrap();
    let inner = dir.path().join("a/b");
    let comparison = synthetic();
    let report = write(&comparison, &inner).unwrap();
    assert_eq!(std::fs::read_to_string(&report).unwrap(), html(&comparison));
    write_with_command(&comparison, &inner, "foresight-sim").unwrap();
    let json: serde_json::Value =
        serde_json::from_slice(&std::fs::read(inner.join("comparison.json")).unwrap()).unwrap();
    assert_eq!(json["policies"][4]["seconds_to_0_9"], serde_json::Value::Null);
    let mut names: Vec<_> = std::fs::read_dir(&inner).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["comparison.json", "report.html"]);
    let file = dir.path().join("file");
    std::fs::write(&file, "").unwrap();
    assert!(write(&comparison, &file).unwrap_err().to_string().contains("file"));
}

#[test]
fn a_dozen_policies_with_many_arrivals_stay_small() {
    let mut comparison = synthetic();
    let (outcome, mut series) = (comparison.policies[4].clone(), comparison.series.policies[4].clone());
    for k in 0..10_000u32 {
        let centre = [f64::from(k % 100) * 21.7, f64::from(k / 100) * 13.9 - 600.0];
        series.arrivals.push(Arrival { at_s: f64::from(k * 7919 % 1200) / 10.0, centre, half: [9.3, 5.1], depth: 9 });
    }
    for k in 5..12 {
        let name = format!("policy {k}");
        comparison.policies.push(PolicyOutcome { name: name.clone(), ..outcome.clone() });
        comparison.series.policies.push(PolicySeries { name, ..series.clone() });
    }
    let page = html(&comparison);
    check(&page);
    assert!(page.contains("3000 of them drawn"));
}

#[test]
fn the_style_sheet_knows_every_class() {
    let style = include_str!("style.css");
    let used = html(&synthetic());
    for class in (0..8).map(|k| format!(".c{k}{{")).chain((1..5).map(|k| format!(".d{k}{{"))) {
        assert!(style.contains(&class), "{class}");
    }
    for shade in 0..16 {
        assert!(style.contains(&format!(".v{shade}{{")));
    }
    assert!(!used.contains("class=\"v16\"") && used.contains("class=\"v15\""));
}
