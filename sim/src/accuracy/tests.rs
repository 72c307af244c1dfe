use super::choice::Choices;
use super::findings::findings;
use super::integral::Integrals;
use super::outcome::{Accuracy, Kind, SCHEMA_VERSION, Verdict};
use super::proof::Proofs;
use super::situation::{Source, capture};
use super::worst_case::WorstCases;
use super::{Draws, grouping, hard, scale, scene};
use foresight_index::generate::city::{CityParams, city};
use foresight_index::world::World;
use foresight_scheduler::policy::foresight::{Foresight, ForesightSettings};
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_traces::flight::Flight;
use foresight_traces::link;
use foresight_traces::path;
use serde_json::Value;

fn small_city() -> World {
    city(&CityParams { blocks_x: 4, blocks_y: 4, ..CityParams::default() }).expect("parameters in range")
}

fn flight() -> Flight {
    let path = path::turn::turn(6.0, 6.0).expect("a path");
    Flight::sample(6.0, |t| {
        let (position, orientation) = path.at(t);
        View { position: position + 2.0 * path.up(), orientation, fov_y: 1.0, viewport: [1280, 720] }
    })
}

/// Everything but decisions as the world grows, over two situations and every kind of hard scene.
fn measured(world: &World) -> Accuracy {
    let (flight, link, settings) = (flight(), link::built_in(), ForesightSettings::default());
    let source = Source { name: "city", tree: &world.tree, flight: &flight, link: &link, memory: 16 << 20 };
    let situations = capture(&source, &settings, 2).expect("a replay");
    assert_eq!(situations.len(), 2);
    let mut random = Draws::new(7);
    let (mut integrals, mut worst, mut choices) =
        (Integrals::default(), WorstCases::default(), Choices::new(&settings));
    for situation in &situations {
        let scene = scene::real("city", source.tree, situation, &settings, 20, &mut random);
        assert_eq!(scene.candidates.len(), 20);
        integrals.measure(&scene).expect("legal candidates");
        worst.measure("city", source.tree, situation, &settings, 100, &mut random).expect("a legal situation");
        choices.measure("city", source.tree, situation, &settings, 2);
    }
    for scene in hard::scenes(240, 7) {
        integrals.measure(&scene.expect("a legal scene")).expect("legal candidates");
    }
    let grouped = grouping::measure(source.tree, &situations, &settings, 10, 7);
    let mut outcome = Accuracy {
        schema_version: SCHEMA_VERSION,
        integral: [integrals.rows(), grouping::over_all(&[grouped])].concat(),
        splitting: integrals.splitting(),
        worst_case: worst.rows(),
        choice: choices.rows(),
        ..Accuracy::default()
    };
    outcome.findings = findings(&outcome);
    outcome
}

/// Without what depends on the machine.
fn without_nanos(value: &mut Value) {
    match value {
        Value::Object(fields) => {
            fields.retain(|name, _| {
                !matches!(name.as_str(), "ns_per_candidate" | "ns_per_decision" | "decision_ns" | "action_ns")
            });
            fields.values_mut().for_each(without_nanos);
        }
        Value::Array(items) => items.iter_mut().for_each(without_nanos),
        _ => {}
    }
}

#[test]
fn a_small_run_repeats_proves_what_it_says_and_names_what_lies() {
    let world = small_city();
    let outcome = measured(&world);
    let rows = || outcome.integral.iter().chain(&outcome.worst_case);

    // Proven bounds hold, and there are some.
    let proven: Vec<_> = rows().filter(|r| r.certified).collect();
    assert!(proven.iter().any(|r| r.method == "enclosure" && r.kind == Kind::Extreme));
    assert!(proven.iter().any(|r| r.method == "branch-and-bound"));
    for row in proven {
        assert_eq!(row.bound_violations, 0, "{row:?}");
    }
    assert!(outcome.findings.iter().all(|f| f.verdict != Verdict::Violated), "{:?}", outcome.findings);

    // Four nodes over a whole leg cannot see an event that lasts a nanosecond, and say nothing of it.
    let lies = outcome.findings.iter().filter(|f| f.verdict == Verdict::Lies);
    let named = lies.filter(|f| f.text.contains("integral: gauss-legendre nodes=4 panels=1:")).count();
    assert_eq!(named, 1, "{:?}", outcome.findings);

    // Finer is better, and splitting at events pays.
    let p999 = |method: &str, setting: &str| {
        let found = outcome.integral.iter().find(|r| {
            (r.case.as_str(), r.kind, r.method.as_str(), r.setting.as_str()) == ("all", Kind::Real, method, setting)
        });
        found.map(|r| r.p999_relative_error).expect(setting)
    };
    assert!(p999("trapezoid", "intervals=2048") < p999("trapezoid", "intervals=2"));
    assert!(p999("gauss-legendre, split", "nodes=8 panels=4") < 1e-3);
    assert!(outcome.splitting.as_ref().is_some_and(|s| s.ratio > 1.0), "{:?}", outcome.splitting);

    // What is asked for exactly is found exactly.
    let exact = outcome.choice.iter().find(|r| r.case == "all" && r.method == "certified" && r.tolerance == 0.0);
    assert!(exact.is_some_and(|r| r.decisions > 0 && r.wrong_choices == 0), "{exact:?}");
    for row in outcome.choice.iter().filter(|r| r.certified) {
        assert!(row.max_regret <= row.tolerance, "{row:?}");
    }

    let document = |outcome: &Accuracy| {
        let mut value = serde_json::to_value(outcome).expect("a document");
        without_nanos(&mut value);
        value
    };
    assert_eq!(document(&outcome), document(&measured(&world)));
}

#[test]
fn enclosures_alone_hold_and_repeat() {
    let checked = || {
        let mut proofs = Proofs::default();
        for scene in hard::scenes(96, 3) {
            proofs.measure(&scene.expect("a legal scene"), &|_| ()).expect("legal candidates");
        }
        let rows = proofs.rows();
        (proofs.counts, rows.iter().map(|r| (r.case.clone(), r.max_gap, r.bound_violations)).collect::<Vec<_>>())
    };
    let (counts, rows) = checked();
    assert_eq!((counts.candidates, counts.legs, counts.violated), (96, 96, 0));
    assert!(counts.legs_within >= 24, "{counts:?}");
    assert_eq!((counts, rows), checked());
}

#[test]
fn decisions_are_timed_in_each_situation() {
    let world = small_city();
    let link = foresight_traces::link::LinkTrace::constant("constant", 8_000_000, Time(40_000_000)).expect("a link");
    for motion in scale::Motion::ALL {
        let policy = Box::new(Foresight::new("foresight", ForesightSettings::default()));
        let row = scale::decisions(&world.tree, motion, &link, 12, policy).expect("legal events");
        assert_eq!((row.decisions, row.situation), (12, motion.name()));
        assert!(row.decision_ns.p50 > 0 && row.decision_ns.p99 >= row.decision_ns.p50);
        assert!(row.bytes_per_representation > 0.0 && row.bytes_per_representation <= 100.0);
    }
}
