//! What a client says, turned into what the scheduler takes, or refused with the value and what was expected.

use super::SessionLimits;
use crate::message::{Camera, Hello, LinkGuess, VERSION, Views};
use foresight_scheduler::benefit::coverage;
use foresight_scheduler::transfer::check_guesses;
use foresight_scheduler::view::{View, ViewError};
use glam::{DQuat, DVec3};

/// A quaternion this far from unit length is normalised; the scheduler takes 10⁻⁶.
const QUATERNION_TOLERANCE: f64 = 1e-2;
/// Least and largest weight of a camera.
const WEIGHTS: core::ops::RangeInclusive<f64> = 1e-6..=1e6;

impl Camera {
    /// As the scheduler takes it. A quaternion within 10⁻² of unit length is normalised; one within 10⁻⁶ stays as it is, to
    /// the bit.
    ///
    /// # Errors
    /// What has no finite meaning.
    pub fn view(&self) -> Result<View, ViewError> {
        let mut orientation = DQuat::from_array(self.orientation);
        let off = (orientation.length() - 1.0).abs();
        if off > 1e-6 && off <= QUATERNION_TOLERANCE {
            orientation = orientation.normalize();
        }
        let position = DVec3::from_array(self.position);
        let view = View { position, orientation, fov_y: self.fov_y, viewport: self.viewport };
        view.check()?;
        Ok(view)
    }
}

/// Weights with their views.
pub(super) fn views(views: &Views, limits: &SessionLimits) -> Result<Vec<(f64, View)>, String> {
    let count = views.cameras.len();
    if count == 0 || count > limits.cameras_max {
        return Err(format!("the view has {count} cameras; expected 1 to {}", limits.cameras_max));
    }
    let mut made = Vec::with_capacity(count);
    for (index, camera) in views.cameras.iter().enumerate() {
        let weight = camera.weight;
        if !WEIGHTS.contains(&weight) {
            let (least, most) = (WEIGHTS.start(), WEIGHTS.end());
            return Err(format!("camera {index}: the weight is {weight}; expected {least} to {most}"));
        }
        made.push((weight, camera.view().map_err(|error| format!("camera {index}: {error}"))?));
    }
    Ok(made)
}

pub(super) fn link(guess: &LinkGuess) -> Result<(), String> {
    check_guesses(guess.rate, guess.latency_s).map_err(|error| format!("link: {error}"))
}

pub(super) fn memory(bytes: u64, limits: &SessionLimits) -> Result<(), String> {
    let most = limits.memory_bytes_max;
    if bytes == 0 || bytes > most {
        return Err(format!("memory_bytes is {bytes}; expected 1 to {most}"));
    }
    Ok(())
}

/// Version apart, everything that can be said of a `hello` without looking into the world.
pub(super) fn hello(hello: &Hello, limits: &SessionLimits) -> Result<(), String> {
    memory(hello.memory_bytes, limits)?;
    let count = hello.resident.len();
    if count > limits.residents_max {
        return Err(format!("resident names {count} representations; expected at most {}", limits.residents_max));
    }
    for (field, text) in [("client", &hello.client), ("resume", &hello.resume)] {
        let length = text.as_ref().map_or(0, String::len);
        if length > limits.text_bytes_max {
            return Err(format!("{field} has {length} bytes; expected at most {}", limits.text_bytes_max));
        }
    }
    hello.link.as_ref().map_or(Ok(()), link)
}

pub(super) fn version(hello: &Hello) -> Result<(), String> {
    if hello.version == VERSION {
        return Ok(());
    }
    Err(format!("the client speaks version {} of the messages; expected {VERSION}", hello.version))
}

impl From<crate::message::Refinement> for coverage::Refinement {
    fn from(refinement: crate::message::Refinement) -> coverage::Refinement {
        match refinement {
            crate::message::Refinement::Partial => coverage::Refinement::Partial,
            crate::message::Refinement::Atomic => coverage::Refinement::Atomic,
        }
    }
}
