//! What came out, in sentences.

use super::metric::pressure_word;
use super::number::{fixed, optional, printable, significant};
use crate::outcome::{Comparison, PolicyOutcome, relative_deficit};
use foresight_scheduler::policy::specification::knows_the_future;

/// Longest name in a sentence, characters.
const NAME_LIMIT: usize = 60;

fn name(policy: &PolicyOutcome) -> String {
    printable(&policy.name, NAME_LIMIT)
}

/// The policies that have a mean quality, best first; ties in the order given. Those that know what no client can are
/// left out, unless there are no others.
fn ranking(comparison: &Comparison) -> Vec<(&PolicyOutcome, f64)> {
    let known = |p: &PolicyOutcome| p.mean_quality.filter(|q| q.is_finite());
    let mut ranking: Vec<(&PolicyOutcome, f64)> =
        comparison.policies.iter().filter_map(|p| Some((p, known(p)?))).collect();
    ranking.sort_by(|a, b| b.1.total_cmp(&a.1));
    if ranking.iter().any(|(p, _)| !knows_the_future(&p.name)) {
        ranking.retain(|(p, _)| !knows_the_future(&p.name));
    }
    ranking
}

/// What knowing the future would add to the best of the others.
fn against_clairvoyance(findings: &mut Vec<String>, comparison: &Comparison, best: &PolicyOutcome) {
    let clairvoyant = comparison.policies.iter().find(|p| knows_the_future(&p.name) && !knows_the_future(&best.name));
    if let Some((clairvoyant, Some(theirs), Some(own))) = clairvoyant.map(|p| (p, p.mean_deficit, best.mean_deficit)) {
        findings.push(format!(
            "{}, which knows the path that the camera will take, has a mean deficit of {}: {} times that of {}, which is what \
             prediction could still gain.",
            name(clairvoyant),
            fixed(theirs, 4),
            fixed(relative_deficit(theirs, own), 2),
            name(best),
        ));
    }
}

/// The first sentence: who is ahead, or why nobody is.
pub(super) fn verdict(comparison: &Comparison) -> String {
    let ranking = ranking(comparison);
    let Some(((best, quality), others)) = ranking.split_first().map(|(b, o)| (*b, o)) else {
        return if comparison.policies.is_empty() {
            "No policy was replayed.".to_owned()
        } else {
            "Nothing was ever in view, so there is no quality to compare.".to_owned()
        };
    };
    let shown = fixed(quality, 3);
    let level: Vec<String> = others.iter().filter(|(_, q)| fixed(*q, 3) == shown).map(|(p, _)| name(p)).collect();
    match level.as_slice() {
        [] if others.is_empty() => format!("{} reaches a mean quality of {shown}.", name(best)),
        [] => format!("{} comes out ahead with a mean quality of {shown}.", name(best)),
        _ if level.len() == others.len() => {
            format!("All {} policies reach the same mean quality, {shown}.", ranking.len())
        }
        [one] => format!("{} and {one} are level at a mean quality of {shown}.", name(best)),
        [one, two] => format!("{}, {one} and {two} are level at a mean quality of {shown}.", name(best)),
        _ => format!("{} and {} others are level at a mean quality of {shown}.", name(best), level.len()),
    }
}

/// The sentences after the verdict: against the others, against the bound, and whether the link made a difference.
pub(super) fn findings(comparison: &Comparison) -> Vec<String> {
    let ranking = ranking(comparison);
    let mut findings = Vec::new();
    if let [(best, quality), others @ ..] = ranking.as_slice() {
        against_others(&mut findings, best, *quality, others);
        against_clairvoyance(&mut findings, comparison, best);
        against_bound(&mut findings, comparison, best, *quality);
    }
    findings.extend(super::alpha::sentences(comparison));
    let rho = comparison.pressure.rho;
    match pressure_word(rho) {
        "starved" => findings.push(format!(
            "The link was starved (ρ = {}): it could deliver about {} % of what the path needs, so it matters what comes first.",
            significant(rho),
            fixed(100.0 / rho, 0),
        )),
        "matched" => findings.push(format!(
            "The link was matched to the path (ρ = {}): it could deliver about as much as the path needs.",
            significant(rho),
        )),
        "ample" => findings.push(format!(
            "The link was ample (ρ = {}): it could deliver far more than the path needs, so policies differ little.",
            significant(rho),
        )),
        _ => {}
    }
    findings
}

fn against_others(findings: &mut Vec<String>, best: &PolicyOutcome, quality: f64, others: &[(&PolicyOutcome, f64)]) {
    let (Some((next, next_quality)), Some((last, last_quality))) = (others.first(), others.last()) else { return };
    let mut sentence = format!(
        "The next is {} with {} ({} less)",
        name(next),
        fixed(*next_quality, 3),
        fixed(quality - next_quality, 3)
    );
    if others.len() > 1 {
        sentence.push_str(&format!(
            ", the last {} with {} ({} less)",
            name(last),
            fixed(*last_quality, 3),
            fixed(quality - last_quality, 3),
        ));
    }
    sentence.push('.');
    findings.push(sentence);
    if let (Some(own), Some(theirs)) = (best.mean_deficit, next.mean_deficit) {
        let mut sentence = format!(
            "What {} lacks to perfect quality, a mean deficit of {}, is {} times that of {}",
            name(best),
            fixed(own, 4),
            fixed(relative_deficit(own, theirs), 2),
            name(next),
        );
        if let Some(theirs) = last.mean_deficit.filter(|_| others.len() > 1) {
            sentence.push_str(&format!(
                " and {} times that of {}",
                fixed(relative_deficit(own, theirs), 2),
                name(last)
            ));
        }
        sentence.push('.');
        findings.push(sentence);
    }
    let interval = |p: &PolicyOutcome| p.interval.and_then(|i| i.mean_quality);
    if let (Some(own), Some(theirs)) = (interval(best), interval(next)) {
        let overlap = own.lower <= theirs.upper && theirs.lower <= own.upper;
        let word = if overlap { "overlap" } else { "do not overlap" };
        findings.push(format!("The 95 % intervals of these first two {word}."));
    }
}

fn against_bound(findings: &mut Vec<String>, comparison: &Comparison, best: &PolicyOutcome, quality: f64) {
    match comparison.upper_bound.mean_quality.filter(|b| b.is_finite()) {
        Some(bound) if quality > bound + 1e-9 => findings.push(format!(
            "{} exceeds the upper bound of {}: one of the two figures is wrong.",
            name(best),
            fixed(bound, 3),
        )),
        Some(bound) => findings.push(format!(
            "It is proven that no policy could exceed {}: at most {} is left to gain on {}.",
            optional(Some(bound), 3),
            fixed((bound - quality).max(0.0), 3),
            name(best),
        )),
        None => findings.push("No upper bound was proven for this replay.".to_owned()),
    }
}
