//! Time as the scheduler and the simulator count it.

use core::ops::{Add, AddAssign, Sub};

/// A point in time or a span of it, in integer nanoseconds since the start of the session.
///
/// Integers make two machines agree on the order of events; decisions convert to seconds where they need a rate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Time(pub u64);

impl Time {
    /// The start of the session.
    pub const ZERO: Time = Time(0);
    /// Later than every event.
    pub const NEVER: Time = Time(u64::MAX);

    /// From seconds, rounded up to the nanosecond; negative and NaN become zero, what is too large becomes [`Time::NEVER`].
    pub fn from_secs(secs: f64) -> Time {
        // The cast saturates, which is what the documentation promises.
        Time(libm::ceil(secs * 1e9) as u64)
    }

    /// In seconds.
    pub fn secs(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// The span from `earlier` to `self`, zero if it is not earlier.
    pub fn since(self, earlier: Time) -> Time {
        Time(self.0.saturating_sub(earlier.0))
    }
}

impl Add for Time {
    type Output = Time;
    fn add(self, rhs: Time) -> Time {
        Time(self.0.saturating_add(rhs.0))
    }
}

impl AddAssign for Time {
    fn add_assign(&mut self, rhs: Time) {
        *self = *self + rhs;
    }
}

impl Sub for Time {
    type Output = Time;
    fn sub(self, rhs: Time) -> Time {
        self.since(rhs)
    }
}
