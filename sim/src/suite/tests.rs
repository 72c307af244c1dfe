use super::*;
use crate::outcome::PolicyOutcome;
use std::collections::BTreeSet;

/// A comparison with these deficits a start, by policy.
fn comparison(policies: &[(&str, &[f64])]) -> Comparison {
    let policy = |&(name, deficits): &(&str, &[f64])| PolicyOutcome {
        name: name.to_owned(),
        mean_deficit: Some(deficits.iter().sum::<f64>() / deficits.len() as f64),
        mean_deficit_by_start: deficits.iter().copied().map(Some).collect(),
        ..PolicyOutcome::default()
    };
    Comparison { policies: policies.iter().map(policy).collect(), ..Comparison::default() }
}

fn case(due: Due, comparisons: Vec<Comparison>) -> CaseOutcome {
    let case = Case { name: "made", why: "", shows: "", due, replays: &[] };
    let replays =
        comparisons.into_iter().map(|comparison| ReplayOutcome { command: Vec::new(), regime: "matched", comparison });
    CaseOutcome::new(&case, replays.collect())
}

#[test]
fn half_the_deficit_in_every_start() {
    let outcome = case(Due::Open, vec![comparison(&[("foresight", &[0.1, 0.2, 0.05]), ("other", &[0.2, 0.4, 0.1])])]);
    let standing = &outcome.standings[0];
    assert!((standing.relative_deficit - 0.5).abs() < 1e-12);
    let interval = standing.interval.unwrap();
    assert!((interval.lower - 0.5).abs() < 1e-9 && (interval.upper - 0.5).abs() < 1e-9);
    assert_eq!((standing.verdict, standing.ahead, standing.values), (Verdict::Ahead, 1, 3));
}

#[test]
fn a_spread_around_one_is_a_tie() {
    // Logarithms of ±ln 2: mean 0.
    let outcome = case(Due::Tie, vec![comparison(&[("foresight", &[0.1, 0.2]), ("other", &[0.2, 0.1])])]);
    assert_eq!(outcome.standings[0].verdict, Verdict::Tie);
    assert!((outcome.standings[0].relative_deficit - 1.0).abs() < 1e-12);
    assert_eq!(outcome.not_as_due().count(), 0);
}

#[test]
fn differences_of_nothing_are_ties_and_the_floor_counts() {
    let tiny = case(Due::Tie, vec![comparison(&[("foresight", &[1e-5, 1e-5]), ("other", &[9e-4, 9e-4])])]);
    assert_eq!((tiny.standings[0].verdict, tiny.standings[0].relative_deficit), (Verdict::Tie, 1.0));
    let behind = case(Due::Tie, vec![comparison(&[("foresight", &[0.04, 0.04]), ("other", &[0.02, 0.02])])]);
    assert_eq!(behind.standings[0].verdict, Verdict::Behind);
    assert_eq!(behind.not_as_due().count(), 1);
    assert!((behind.standings[0].difference - 0.02).abs() < 1e-12);
}

#[test]
fn cases_weigh_the_same_and_ties_due_are_left_out() {
    let four = comparison(&[("foresight", &[0.1, 0.1]), ("other", &[0.4, 0.4])]);
    let cases = [
        case(Due::Open, vec![four.clone(), four.clone(), four]),
        case(Due::Open, vec![comparison(&[("foresight", &[0.2, 0.2]), ("other", &[0.2, 0.2])])]),
        case(Due::Tie, vec![comparison(&[("foresight", &[0.2, 0.2]), ("other", &[0.1, 0.1])])]),
    ];
    let all = standings(&cases);
    assert_eq!(all.len(), 1);
    assert!((all[0].relative_deficit - 0.5).abs() < 1e-12, "√(¼ · 1)");
    assert_eq!((all[0].ahead, all[0].level, all[0].behind, all[0].values), (1, 1, 0, 2));
    // Student's t with one degree of freedom, 12.7062, on ln ¼ and 0: half width 12.7062 · |ln ¼| / 2.
    let half = 12.706_204_736 * libm::log(4.0) / 2.0;
    let interval = all[0].interval.unwrap();
    assert!((libm::log(interval.upper) - (libm::log(0.5) + half)).abs() < 1e-6);
}

#[test]
fn policies_without_a_deficit_are_left_out() {
    let mut nothing = comparison(&[("foresight", &[0.1]), ("other", &[0.1])]);
    nothing.policies[1].mean_deficit_by_start = vec![None];
    assert!(case(Due::Open, vec![nothing]).standings.is_empty());
    assert!(case(Due::Open, vec![comparison(&[("other", &[0.1])])]).standings.is_empty());
    assert!(standings(&[]).is_empty());
}

#[test]
fn cases_have_names_of_their_own_and_say_why_they_are_there() {
    let names: BTreeSet<&str> = CASES.iter().map(|c| c.name).collect();
    assert_eq!(names.len(), CASES.len());
    for case in CASES {
        assert!(!case.why.is_empty() && !case.shows.is_empty() && !case.replays.is_empty(), "{}", case.name);
    }
    let commands = Case { replays: &["--world {data}/a --path steady"], ..CASES[0] }.commands(Path::new("/d d"));
    assert_eq!(commands, [["replay", "--world", "/d d/a", "--path", "steady"]]);
}
