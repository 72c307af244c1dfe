//! A target frame time, held by drawing more coarsely or more finely: the frame time fed back into the resolution bias
//! (\[NVE\] §4.5 and 4.6, whose controller adapts triangles and the distance at which images take over; the bias does both).
//!
//! A sample drawn twice as coarse is a quarter of the points, so frame time falls with the bias at most like bias⁻².
//! With t the median of the last three frame times and T the target,
//!
//! ```text
//! ln bias ← clamp(ln bias + k · clamp(ln(t/A), ±ln 4))      unless |ln(t/A)| ≤ 0.05,   A = 0.9·T
//! ```
//!
//! What is aimed at is a little below the target, and k is 0.2 upwards and 0.05 downwards, because a late frame is seen where an
//! early one is not: cells change their level at once, so that frame times jump to and fro around any aim.
//! The loop's gain is then at most 0.4 at a delay of two frames; it is stable below 2·sin(π/10) ≈ 0.62. The median takes no
//! notice of single slow frames, such as those of an upload. The bias has no meaning outside its range: where even the
//! coarsest takes longer than the target, or the finest less, it stays at that end and comes back at once.

/// What to hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControllerSettings {
    /// T, seconds a frame, > 0.
    pub target_s: f64,
    /// Least bias: 1 for samples of a pixel at best. More than 0.
    pub bias_min: f64,
    /// Largest bias, at least `bias_min`.
    pub bias_max: f64,
}

impl ControllerSettings {
    /// For a target in seconds: samples of 1 to 16 pixels.
    pub fn new(target_s: f64) -> ControllerSettings {
        ControllerSettings { target_s, bias_min: 1.0, bias_max: 16.0 }
    }
}

/// A controller that contradicts itself.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ControllerError {
    /// The target is no time.
    #[error("a target frame time of {0} s; expected a finite number > 0")]
    Target(f64),
    /// The range is none.
    #[error("a bias from {0} to {1}; expected finite numbers in order, more than 0")]
    Range(f64, f64),
}

/// The controller: told each frame's time, it answers the bias of the next.
#[derive(Clone, Debug)]
pub struct Controller {
    settings: ControllerSettings,
    bias: f64,
    /// The last three frame times, the latest last; none before the first frame.
    recent: Option<[f64; 3]>,
}

/// A/T.
const AIM: f64 = 0.9;
/// k, towards coarser and towards finer.
const GAINS: [f64; 2] = [0.2, 0.05];
const STEP_MAX: f64 = 2.0 * core::f64::consts::LN_2;
const DEAD_BAND: f64 = 0.05;

impl Controller {
    /// Begins at the finest.
    ///
    /// # Errors
    /// Settings that contradict themselves.
    pub fn new(settings: ControllerSettings) -> Result<Controller, ControllerError> {
        let ControllerSettings { target_s, bias_min, bias_max } = settings;
        if !(target_s > 0.0 && target_s.is_finite()) {
            return Err(ControllerError::Target(target_s));
        }
        if !(bias_min > 0.0 && bias_min <= bias_max && bias_max.is_finite()) {
            return Err(ControllerError::Range(bias_min, bias_max));
        }
        Ok(Controller { settings, bias: bias_min, recent: None })
    }

    /// The bias to draw with.
    pub fn bias(&self) -> f64 {
        self.bias
    }

    /// Takes note of a frame that took `frame_s` seconds and answers the bias of the next. What is no time (NaN, infinite,
    /// 0, negative) is taken no note of.
    pub fn observe(&mut self, frame_s: f64) -> f64 {
        if !(frame_s > 0.0 && frame_s.is_finite()) {
            return self.bias;
        }
        let [_, b, c] = self.recent.unwrap_or([frame_s; 3]);
        let recent = [b, c, frame_s];
        self.recent = Some(recent);
        let median = b.min(c).max(b.max(c).min(frame_s));
        let off = libm::log(median) - libm::log(AIM * self.settings.target_s);
        if off.abs() > DEAD_BAND {
            let gain = GAINS[usize::from(off < 0.0)];
            let moved = self.bias * libm::exp(gain * off.clamp(-STEP_MAX, STEP_MAX));
            self.bias = moved.clamp(self.settings.bias_min, self.settings.bias_max);
        }
        self.bias
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A renderer whose frames take `fixed` + `load`·bias^−`power` seconds.
    fn fly(controller: &mut Controller, frames: usize, fixed: f64, load: f64, power: f64) -> Vec<f64> {
        let mut times = Vec::new();
        for _ in 0..frames {
            let time = fixed + load * libm::pow(controller.bias(), -power);
            controller.observe(time);
            times.push(time);
        }
        times
    }

    fn controller(target_s: f64) -> Controller {
        Controller::new(ControllerSettings::new(target_s)).expect("a target")
    }

    proptest! {
        #[test]
        fn sixty_frames_after_a_city_is_entered_the_target_is_held(
            target in 1e-3..1.0f64, share in 0.0..0.5f64, jump in 1.2..100.0f64, power in 0.8..2.0f64,
        ) {
            let mut controller = controller(target);
            fly(&mut controller, 30, 0.5 * target * share, 0.4 * target, power);
            prop_assert_eq!(controller.bias(), 1.0);
            let load = jump * target;
            let reachable = load * libm::pow(16.0, -power) + share * target <= target;
            let city = fly(&mut controller, 200, share * target, load, power);
            if reachable && jump + share > 1.0 {
                prop_assert!(city[60..].iter().all(|&t| (t / target - 1.0).abs() < 0.2), "{:?}", &city[..80]);
            }
            // And out of it again: as fine as before.
            fly(&mut controller, 100, 0.0, 0.3 * target, power);
            prop_assert_eq!(controller.bias(), 1.0);
        }

        #[test]
        fn no_time_leads_out_of_the_range(times in prop::collection::vec(prop::num::f64::ANY, 0..200)) {
            let mut controller = controller(0.016);
            for time in times {
                let bias = controller.observe(time);
                prop_assert!((1.0..=16.0).contains(&bias), "{bias} after {time}");
            }
        }
    }

    #[test]
    fn one_slow_frame_changes_nothing_and_a_tenfold_load_is_met_within_twenty_frames() {
        let mut controller = controller(0.02);
        fly(&mut controller, 40, 0.0, 0.08, 2.0);
        let settled = controller.bias();
        assert!((settled / (2.0 / AIM.sqrt()) - 1.0).abs() < 0.03, "{settled}");
        controller.observe(10.0);
        assert!((controller.bias() / settled - 1.0).abs() < 0.02);
        fly(&mut controller, 20, 0.0, 0.8, 2.0);
        let times = fly(&mut controller, 20, 0.0, 0.8, 2.0);
        assert!(times.iter().all(|t| (t / (AIM * 0.02) - 1.0).abs() < 0.1), "{times:?}");
    }

    #[test]
    fn what_is_no_time_counts_for_nothing_and_what_cannot_be_held_is_given_back() {
        let mut controller = controller(0.02);
        for time in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -0.0, -1.0] {
            assert_eq!(controller.observe(time), 1.0);
        }
        // Nothing helps: a hundredfold load that is the same at any bias.
        fly(&mut controller, 500, 2.0, 0.0, 2.0);
        assert_eq!(controller.bias(), 16.0);
        let back = fly(&mut controller, 60, 0.0, 0.01, 2.0);
        assert_eq!(controller.bias(), 1.0, "{back:?}");
        for (settings, message) in [
            (ControllerSettings::new(f64::NAN), "a target frame time of NaN s; expected a finite number > 0"),
            (ControllerSettings { bias_min: 2.0, bias_max: 1.0, target_s: 1.0 }, "a bias from 2 to 1; expected finite"),
        ] {
            let error = Controller::new(settings).expect_err(message).to_string();
            assert!(error.starts_with(message), "{error}");
        }
    }
}
