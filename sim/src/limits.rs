//! What keeps `foresight` from the upper bound: three replays tell.

use crate::outcome::{PolicyOutcome, UpperBound};
use serde::Serialize;

/// Mean qualities on the way from `foresight` to the bound, and the steps between them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Limits {
    /// Of `foresight`.
    pub foresight: f64,
    /// Of the same greedy choice when it knows path and link.
    pub clairvoyant: f64,
    /// Of that on a link without latency and failures, with a client that decodes at once and draws children beside their
    /// parent: what the bound lets cost nothing.
    pub relaxed_clairvoyant: f64,
    /// The upper bound.
    pub bound: f64,
    /// `foresight` ÷ bound.
    pub share: f64,
    /// What prediction loses: clairvoyant − foresight. Negative where greed pays for knowing.
    pub prediction: f64,
    /// What latency, decoding and the rest of a real client lose: relaxed clairvoyant − clairvoyant.
    pub client: f64,
    /// What greed loses and what the bound is too high by, together: bound − relaxed clairvoyant.
    pub greedy_and_bound: f64,
}

impl Limits {
    /// Of four mean qualities.
    pub fn new(foresight: f64, clairvoyant: f64, relaxed_clairvoyant: f64, bound: f64) -> Limits {
        Limits {
            foresight,
            clairvoyant,
            relaxed_clairvoyant,
            bound,
            share: if bound > 0.0 { foresight / bound } else { 1.0 },
            prediction: clairvoyant - foresight,
            client: relaxed_clairvoyant - clairvoyant,
            greedy_and_bound: bound - relaxed_clairvoyant,
        }
    }

    /// Of a comparison: the first policy called `foresight…` and that called `clairvoyant`; `None` where one is missing.
    pub fn of(policies: &[PolicyOutcome], relaxed_clairvoyant: Option<f64>, bound: &UpperBound) -> Option<Limits> {
        let foresight = policies.iter().find(|p| p.name.starts_with("foresight"))?.mean_quality?;
        let clairvoyant = policies.iter().find(|p| p.name == "clairvoyant")?.mean_quality?;
        Some(Limits::new(foresight, clairvoyant, relaxed_clairvoyant?, bound.mean_quality?))
    }

    /// Of several replays: the means of their qualities.
    pub fn mean(of: &[Limits]) -> Option<Limits> {
        let mean = |quality: fn(&Limits) -> f64| of.iter().map(quality).sum::<f64>() / of.len() as f64;
        (!of.is_empty()).then(|| {
            Limits::new(
                mean(|l| l.foresight),
                mean(|l| l.clairvoyant),
                mean(|l| l.relaxed_clairvoyant),
                mean(|l| l.bound),
            )
        })
    }

    /// In words.
    pub fn sentence(&self) -> String {
        format!(
            "foresight reaches {:.1} % of the bound; of the {:.4} missing, {:.4} is prediction, {:.4} latency and decoding, {:.4} \
             greed and what the bound is too high by",
            self.share * 100.0,
            self.bound - self.foresight,
            self.prediction,
            self.client,
            self.greedy_and_bound
        )
    }
}
