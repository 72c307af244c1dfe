//! Runs made up: any values that a run can have.

use foresight_index::runs::{Figure, Input, PolicyResult, Pressure, Run};
use proptest::prelude::*;

/// Any text without NUL, which neither database stores: emoji, combining marks, quotes and line ends included.
fn text() -> impl Strategy<Value = String> {
    let characters = any::<char>().prop_filter("NUL", |c| *c != '\0');
    prop_oneof![
        proptest::collection::vec(characters, 0..12).prop_map(String::from_iter),
        Just("'; DROP TABLE runs; --".to_owned()),
        Just("Zürich 🚁 e\u{301}\r\n\t\"$1\"".to_owned()),
    ]
}

/// Finite numbers of every size, zeros of both signs and whole numbers.
fn number() -> impl Strategy<Value = f64> {
    use proptest::num::f64;
    prop_oneof![
        f64::NORMAL | f64::SUBNORMAL | f64::ZERO,
        (-9_007_199_254_740_993_i64..9_007_199_254_740_993).prop_map(|n| n as f64)
    ]
}

fn input() -> impl Strategy<Value = Input> {
    (text(), text()).prop_map(|(name, hash)| Input { name, hash })
}

fn count() -> impl Strategy<Value = u64> {
    0..=i64::MAX as u64
}

fn figure() -> impl Strategy<Value = Figure> {
    let end = || proptest::option::of(number());
    (end(), end(), end()).prop_map(|(value, lower, upper)| Figure { value, lower, upper })
}

fn result() -> impl Strategy<Value = PolicyResult> {
    let figures = proptest::array::uniform10(figure());
    let nanos = proptest::array::uniform3(count());
    (text(), figures, proptest::option::of(number()), nanos)
        .prop_map(|(policy, figures, decisions, decision_ns)| PolicyResult { policy, figures, decisions, decision_ns })
}

fn pressure() -> impl Strategy<Value = Pressure> {
    let share = || proptest::option::of(number());
    (share(), share(), share(), count()).prop_map(|(lambda, rho, mu, largest_need_bytes)| Pressure {
        lambda,
        rho,
        mu,
        largest_need_bytes,
    })
}

/// Any run, with its document.
pub(crate) fn run() -> impl Strategy<Value = (Run, String)> {
    let texts = proptest::array::uniform6(text());
    let maybe = (proptest::option::of(text()), proptest::option::of(text()));
    let lists = (proptest::collection::vec(text(), 0..5), proptest::collection::vec(result(), 0..4));
    let numbers = (any::<i64>(), any::<u64>(), number(), proptest::option::of(count()));
    let shares = (proptest::option::of(number()), proptest::option::of(number()), pressure());
    let inputs = [input(), input(), input()];
    (texts, maybe, lists, numbers, shares, inputs, text()).prop_map(
        |(texts, maybe, lists, numbers, shares, inputs, document)| {
            let [program_version, build, settings, inputs_hash, result_hash, bound_method] = texts;
            let [world, path, link] = inputs;
            let run = Run {
                started_at_ms: numbers.0,
                program_version,
                build,
                suite_case: maybe.0,
                folder: maybe.1,
                arguments: lists.0,
                world,
                path,
                link,
                settings,
                seed: numbers.1,
                inputs_hash,
                result_hash,
                wall_s: numbers.2,
                peak_memory_bytes: numbers.3,
                nonempty_share: shares.0,
                pressure: shares.2,
                bound_quality: shares.1,
                bound_method,
                results: lists.1,
            };
            (run, document)
        },
    )
}

/// A run whose results and document can be told from its number, of about the size of a real one.
pub(crate) fn numbered(number: u64) -> (Run, String) {
    let result = |place: u64| PolicyResult {
        policy: format!("policy-{place}"),
        figures: [Figure { value: Some(number as f64), lower: None, upper: Some(place as f64) }; 10],
        decisions: Some(number as f64),
        decision_ns: [number, place, number + place],
    };
    let run = Run { seed: number, results: (0..12).map(result).collect(), ..Run::default() };
    (run, format!("[{}{number}]", "0,".repeat(6000)))
}
