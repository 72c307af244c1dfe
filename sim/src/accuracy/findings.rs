//! Which rows their reader must know of: proofs that fail, methods that lie, bounds that are loose.

use super::outcome::{Accuracy, ErrorRow, Finding, Verdict};
use std::collections::BTreeMap;

/// A proven bound wider than this, relative as its errors are, is loose.
pub const LOOSE: f64 = 0.1;
/// A replay's bound of which less than this is reachable is loose.
pub const REACHABLE: f64 = 0.85;

/// The row over all scenes.
const ALL: &str = "all";
/// Scenes named in one finding.
const NAMED: usize = 4;

/// A finding a method and setting and verdict, with the scenes where it is worst; what is violated first.
pub fn findings(outcome: &Accuracy) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (part, rows) in [("integral", &outcome.integral), ("worst case", &outcome.worst_case)] {
        findings.extend(of_errors(part, rows));
    }
    for row in outcome.choice.iter().filter(|r| r.case == ALL && r.certified && r.max_regret > r.tolerance) {
        let text = format!(
            "choice: {} at tolerance {:.0e}: a regret of {:.1e} is above what is proven",
            row.method, row.tolerance, row.max_regret
        );
        findings.push(Finding { verdict: Verdict::Violated, text });
    }
    findings.extend(of_upper_bounds(outcome));
    findings.sort_by_key(|f| f.verdict);
    findings
}

fn of_errors(part: &str, rows: &[ErrorRow]) -> Vec<Finding> {
    type Key<'a> = (Verdict, &'a str, &'a str, &'a str);
    let mut found: BTreeMap<Key, Vec<&ErrorRow>> = BTreeMap::new();
    for row in rows.iter().filter(|r| r.case != ALL) {
        let reading = row.reading.as_deref().unwrap_or_default();
        let mut add = |verdict| found.entry((verdict, reading, &row.method, &row.setting)).or_default().push(row);
        if row.bound_violations > 0 {
            add(if row.certified { Verdict::Violated } else { Verdict::Lies });
        }
        if row.certified && row.gap.is_some_and(|gap| gap > LOOSE) {
            add(Verdict::Loose);
        }
    }
    let sentence = |((verdict, reading, method, setting), mut rows): (Key, Vec<&ErrorRow>)| {
        let share = |r: &ErrorRow| match verdict {
            Verdict::Loose => r.gap.unwrap_or(0.0),
            _ => r.bound_violations as f64 / r.candidates.max(1) as f64,
        };
        rows.sort_by(|a, b| share(b).total_cmp(&share(a)).then(a.case.cmp(&b.case)));
        let scenes: Vec<String> = rows
            .iter()
            .take(NAMED)
            .map(|r| match verdict {
                Verdict::Loose => format!("{} (mean width {})", r.case, scientific(share(r))),
                _ => {
                    let error = scientific(r.max_relative_error);
                    format!("{} ({} of {}, error up to {error})", r.case, r.bound_violations, r.candidates)
                }
            })
            .collect();
        let more = if rows.len() > NAMED { format!(" and {} more", rows.len() - NAMED) } else { String::new() };
        let reading = if reading.is_empty() { String::new() } else { format!("{reading}, ") };
        let text = format!("{part}: {reading}{method} {setting}: {}{more}", scenes.join(", "));
        Finding { verdict, text }
    };
    found.into_iter().map(sentence).collect()
}

fn scientific(value: f64) -> String {
    if value == f64::INFINITY { "∞".to_owned() } else { format!("{value:.1e}") }
}

fn of_upper_bounds(outcome: &Accuracy) -> Vec<Finding> {
    let mut strata: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    let mut findings = Vec::new();
    for row in &outcome.upper_bound {
        // Sums in another order differ by rounding.
        if row.exact > row.bound * (1.0 + 1e-12) {
            let text = format!("upper bound: {}: {} is reached, {} is the bound", row.case, row.exact, row.bound);
            findings.push(Finding { verdict: Verdict::Violated, text });
        }
        strata.entry(&row.stratum).or_default().push(if row.bound > 0.0 { row.exact / row.bound } else { 1.0 });
    }
    for (stratum, shares) in strata {
        let loose = shares.iter().filter(|share| **share < REACHABLE).count();
        if loose > 0 {
            let least = shares.iter().copied().fold(1.0, f64::min);
            let text = format!(
                "upper bound: {stratum}: {loose} of {} instances reach less than {REACHABLE} of it, the least {least:.2}",
                shares.len()
            );
            findings.push(Finding { verdict: Verdict::Loose, text });
        }
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::super::outcome::{Kind, UpperBoundRow};
    use super::*;

    fn row(case: &str, certified: bool, violations: u64, gap: f64) -> ErrorRow {
        ErrorRow {
            case: case.to_owned(),
            kind: Kind::Stiff,
            reading: None,
            method: "m".to_owned(),
            setting: "s=1".to_owned(),
            certified,
            default: false,
            candidates: 10,
            evaluations: 1.0,
            ns_per_candidate: 1.0,
            max_relative_error: 0.5,
            p999_relative_error: 0.5,
            median_relative_error: 0.0,
            bound_violations: violations,
            gap: Some(gap),
            max_gap: Some(gap),
        }
    }

    #[test]
    fn each_verdict_names_its_rows() {
        let outcome = Accuracy {
            integral: vec![row("spin", false, 3, 1.0), row("calm", false, 0, 0.0), row("all", false, 3, 1.0)],
            worst_case: vec![row("wide", true, 0, 0.2), row("broken", true, 1, 0.0)],
            upper_bound: vec![UpperBoundRow { case: "1".into(), stratum: "scarce".into(), bound: 1.0, exact: 0.5 }],
            ..Accuracy::default()
        };
        let findings = findings(&outcome);
        let texts: Vec<(Verdict, &str)> = findings.iter().map(|f| (f.verdict, f.text.as_str())).collect();
        assert_eq!(texts[0].0, Verdict::Violated);
        assert!(texts[0].1.contains("broken"), "{texts:?}");
        assert!(texts[1].0 == Verdict::Lies && texts[1].1.contains("spin (3 of 10") && !texts[1].1.contains("calm"));
        assert!(texts.iter().any(|t| t.0 == Verdict::Loose && t.1.contains("wide")));
        assert!(texts.iter().any(|t| t.0 == Verdict::Loose && t.1.contains("scarce: 1 of 1")));
        assert_eq!(texts.len(), 4);
    }
}
