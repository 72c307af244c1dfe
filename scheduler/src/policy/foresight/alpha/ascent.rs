//! α as the multiplier of W/Σw ≥ Q_min, by dual ascent.
//!
//! The Lagrangian of maximising the predicted benefit under the constraint is, up to a factor, α·benefit + (1−α)·W with the
//! multiplier μ = (1−α)/α (\[ZK\] eq. 6). λ = 1 − α = μ/(1+μ) moves along the dual's subgradient,
//!
//! ```text
//! λ ← min(1, max(0, λ + s·(Q_min − W/Σw)·Δt))
//! ```
//!
//! which is the ascent in μ with the step s·(1+μ)². W(α) is a step function: W itself jumps around Q_min and never
//! settles. What converges is its mean over time: while λ is not at an end of [0, 1], s·∫(Q_min − W/Σw) dt is the change
//! of λ, so that the mean over T seconds is off Q_min by at most 1/(s·T), whatever the steps are. At λ = 0 the
//! constraint costs nothing; where W/Σw stays below Q_min at λ = 1, nothing can meet it. That lower end is in fact a little
//! above 0 ([`super::ALPHA_MAX`]).
//!
//! At the start, when nothing is resident, no α is feasible (\[ZK\] §3), and the worst case must not be paid for what only
//! time brings: λ stays until W/Σw first reaches Q_min, or for one memory of the running means.

use super::{ALPHA_MAX, AlphaReport, Constraint};

/// s, per second: a quality that is 0.1 off moves α by 0.05 in a second.
const STEP: f64 = 0.5;
/// α this near to an end of its range is at it.
const AT_END: f64 = 1e-9;

/// Multiplier and running means.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ascent {
    target: Option<f64>,
    alpha: f64,
    /// Seconds seen, those without anything in view left out.
    seconds: f64,
    /// Σ of the seconds' weights exp(−age/memory), and with α, α² and W/Σw as factors.
    weight: f64,
    alpha_sum: f64,
    square_sum: f64,
    quality_sum: f64,
    /// Seconds for which α has been 0 without a break.
    at_zero_s: f64,
    /// Whether W/Σw has reached the target, or had its time to.
    has_begun: bool,
}

/// Running means.
#[derive(Clone, Copy, Debug)]
pub(super) struct Settled {
    pub(super) alpha: f64,
    pub(super) oscillation: f64,
    pub(super) quality: Option<f64>,
}

impl Ascent {
    /// Towards `target`, from `alpha` on; without a target only the means are kept. A target that is no number is 1.
    pub(super) fn new(target: Option<f64>, alpha: f64) -> Ascent {
        let target = target.map(|q| if q.is_nan() { 1.0 } else { q.clamp(0.0, 1.0) });
        let (seconds, weight, alpha_sum, square_sum, quality_sum, at_zero_s) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        Ascent { target, alpha, seconds, weight, alpha_sum, square_sum, quality_sum, at_zero_s, has_begun: false }
    }

    /// W/Σw has been `quality` for `seconds` in which `alpha` was used. Without a quality no time passes.
    pub(super) fn update(&mut self, alpha: f64, quality: Option<f64>, seconds: f64) {
        let Some(quality) = quality.filter(|q| q.is_finite()) else { return };
        if !(seconds > 0.0 && seconds.is_finite()) {
            return;
        }
        let quality = quality.clamp(0.0, 1.0);
        let kept = libm::exp(-seconds / AlphaReport::MEMORY_S);
        self.seconds += seconds;
        self.weight = kept * self.weight + seconds;
        self.alpha_sum = kept * self.alpha_sum + seconds * alpha;
        self.square_sum = kept * self.square_sum + seconds * alpha * alpha;
        self.quality_sum = kept * self.quality_sum + seconds * quality;
        self.at_zero_s = if alpha <= AT_END { self.at_zero_s + seconds } else { 0.0 };
        if let Some(target) = self.target {
            self.has_begun |= quality >= target || self.seconds >= AlphaReport::MEMORY_S;
            if self.has_begun {
                self.alpha = (self.alpha - STEP * (target - quality) * seconds).clamp(0.0, ALPHA_MAX);
            }
        }
    }

    pub(super) fn alpha(&self) -> f64 {
        self.alpha
    }

    pub(super) fn target(&self) -> Option<f64> {
        self.target
    }

    /// The running means; `None` before any time has passed with something in view.
    pub(super) fn settled(&self) -> Option<Settled> {
        (self.weight > 0.0).then(|| {
            let alpha = self.alpha_sum / self.weight;
            let variance = (self.square_sum / self.weight - alpha * alpha).max(0.0);
            Settled { alpha, oscillation: variance.sqrt(), quality: Some(self.quality_sum / self.weight) }
        })
    }

    /// How the constraint stands: nothing is said before one memory of the running means has passed.
    pub(super) fn constraint(&self) -> Option<Constraint> {
        let target = self.target?;
        let Some(settled) = self.settled().filter(|_| self.seconds >= AlphaReport::MEMORY_S) else {
            return Some(Constraint::Converging);
        };
        let excess = settled.quality.unwrap_or(0.0) - target;
        Some(if excess.abs() <= AlphaReport::TOLERANCE {
            Constraint::Met
        } else if excess > 0.0 && self.alpha >= ALPHA_MAX - AT_END {
            Constraint::Slack
        } else if excess < 0.0 && self.at_zero_s >= AlphaReport::MEMORY_S {
            Constraint::Infeasible
        } else {
            Constraint::Converging
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Quarter seconds of an ascent over a W(α) that jumps.
    fn run(target: f64, seconds: f64, quality: impl Fn(f64) -> f64) -> Ascent {
        let mut ascent = Ascent::new(Some(target), 0.7);
        for _ in 0..(4.0 * seconds) as usize {
            ascent.update(ascent.alpha(), Some(quality(ascent.alpha())), 0.25);
        }
        ascent
    }

    /// W jumps from 0.8 to 0.3 at α = 0.45: no α gives 0.6, but 0.8 for three fifths of the time does.
    #[test]
    fn the_running_mean_converges_where_w_jumps_over_the_target() {
        let ascent = run(0.6, 120.0, |alpha| if alpha <= 0.45 { 0.8 } else { 0.3 });
        let settled = ascent.settled().unwrap();
        assert!((settled.quality.unwrap() - 0.6).abs() <= AlphaReport::TOLERANCE, "{settled:?}");
        assert!((settled.alpha - 0.45).abs() < 0.05 && settled.oscillation < 0.1, "{settled:?}");
        assert_eq!(ascent.constraint(), Some(Constraint::Met));
    }

    /// The bound that the head of this file states, over many staircases.
    #[test]
    fn the_mean_is_off_by_at_most_one_over_step_and_time() {
        for (steps, target) in [(2.0, 0.5), (3.0, 0.41), (7.0, 0.77), (50.0, 0.13)] {
            let quality = |alpha: f64| libm::floor((1.0 - alpha) * steps) / steps;
            let mut ascent = Ascent::new(Some(target), 0.5);
            ascent.has_begun = true;
            let (mut sum, mut seconds) = (0.0, 0.0);
            while seconds < 400.0 {
                let q = quality(ascent.alpha());
                ascent.update(ascent.alpha(), Some(q), 0.25);
                (sum, seconds) = (sum + 0.25 * q, seconds + 0.25);
            }
            assert!((sum / seconds - target).abs() <= 1.0 / (STEP * seconds), "{steps} {target}");
        }
    }

    #[test]
    fn what_cannot_be_reached_is_infeasible_and_what_costs_nothing_is_slack() {
        let poor = run(0.6, 120.0, |alpha| if alpha <= 0.5 { 0.5 } else { 0.2 });
        assert_eq!((poor.alpha(), poor.constraint()), (0.0, Some(Constraint::Infeasible)));
        let rich = run(0.6, 90.0, |alpha| 0.9 - 0.1 * alpha);
        assert_eq!((rich.alpha(), rich.constraint()), (ALPHA_MAX, Some(Constraint::Slack)));
        let early = run(0.6, 10.0, |_| 0.0);
        assert_eq!((early.alpha(), early.constraint()), (0.7, Some(Constraint::Converging)));
        // A link that recovers is believed again.
        let mut later = poor;
        for _ in 0..1000 {
            later.update(later.alpha(), Some(if later.alpha() <= 0.5 { 0.7 } else { 0.5 }), 0.25);
        }
        assert_eq!(later.constraint(), Some(Constraint::Met));
    }

    proptest! {
        /// Whatever it is told, α is in [0, 1] and every mean finite.
        #[test]
        fn alpha_stays_in_its_range(
            target in any::<f64>(),
            told in prop::collection::vec((prop::option::of(any::<f64>()), any::<f64>()), 0..40),
        ) {
            let mut ascent = Ascent::new(Some(target), 0.7);
            for (quality, seconds) in told {
                ascent.update(ascent.alpha(), quality, seconds.min(1.0));
                prop_assert!((0.0..=1.0).contains(&ascent.alpha()));
                if let Some(settled) = ascent.settled() {
                    prop_assert!(settled.alpha.is_finite() && settled.oscillation.is_finite());
                    prop_assert!(settled.quality.is_some_and(|q| (-1e-9..=1.0 + 1e-9).contains(&q)));
                }
            }
        }
    }
}
