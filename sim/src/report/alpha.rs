//! What became of α, in sentences.

use super::number::{fixed, optional, printable};
use crate::outcome::{AlphaOutcome, Comparison};

/// Longest name in a sentence, characters.
const NAME_LIMIT: usize = 60;

/// A sentence for each policy whose α is not fixed.
pub(super) fn sentences(comparison: &Comparison) -> Vec<String> {
    let sentence = |name: &str, alpha: &AlphaOutcome| {
        let name = printable(name, NAME_LIMIT);
        let mean = fixed(alpha.mean, 3);
        let worst = optional(alpha.mean_worst_quality, 3);
        let settled = format!("settled at {} ± {}", fixed(alpha.settled, 3), fixed(alpha.oscillation, 3));
        match alpha.at_least {
            None if alpha.rule == "watched" => {
                format!("{name}: α {mean}; the worst case has a mean quality of {worst}.")
            }
            None => format!("{name}: mean α {mean}, {settled}; the worst case has a mean quality of {worst}."),
            Some(least) => format!(
                "{name}: mean α {mean}, {settled}; the worst case is to have a quality of {}, and its running mean is {}: {}.",
                fixed(least, 3),
                optional(alpha.settled_worst_quality, 3),
                constraint(alpha),
            ),
        }
    };
    comparison.policies.iter().filter_map(|p| Some(sentence(&p.name, p.alpha.as_ref()?))).collect()
}

/// How the constraint stands, of all starts.
fn constraint(alpha: &AlphaOutcome) -> String {
    let all = |word: &str| alpha.constraint.iter().all(|c| *c == word);
    if all("met") {
        "met".to_owned()
    } else if all("slack") {
        "met even at the largest α".to_owned()
    } else if all("infeasible") {
        "infeasible, it is not reached even at α = 0".to_owned()
    } else if all("converging") {
        "not converged".to_owned()
    } else {
        alpha.constraint.join(", ")
    }
}
