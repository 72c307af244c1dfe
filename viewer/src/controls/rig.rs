//! The camera on its rig: position, heading and pitch, never roll, moved by what is pressed.
//!
//! Speeds follow what is pressed with a lag of τ = [`LAG_S`]: v ← u + (v − u)·e^(−dt/τ), and the position is the exact integral
//! of that, so that it does not matter into how many frames a time is cut, as long as the pressed speed u stays.

use super::surroundings::Surroundings;
use foresight_scheduler::view::View;
use foresight_traces::path::across;
use glam::{DMat3, DQuat, DVec3};

/// Lag of the speed behind what is pressed, seconds.
pub const LAG_S: f64 = 0.12;
/// Flying, metres a second per metre to the nearest thing.
pub const FLYING_RATE: f64 = 0.8;
/// Walking, metres a second.
pub const WALKING: f64 = 1.6;
/// Factor of the speed with the key for fast.
pub const FAST: f64 = 5.0;
/// Height of the eyes above the ground when walking, metres.
pub const EYES: f64 = 1.7;
/// Turning with the keyboard, radians a second.
pub const TURNING: f64 = 1.2;
/// Steepest pitch, radians: 89°.
const PITCH_MAX: f64 = 89.0 / 180.0 * core::f64::consts::PI;
/// Factor of the distance, or of the flying speed, per step of the wheel.
const ZOOM: f64 = 1.15;
/// Bounds of the factor that the wheel puts on speeds.
const PACE: [f64; 2] = [0.01, 100.0];
/// Longest time that is moved in one step, seconds: who was asleep does not wake up elsewhere.
const STEP_MAX_S: f64 = 0.25;
/// How far from the world's middle the camera may go, in diagonals of the world.
const FAR: f64 = 20.0;
/// Nearest that an orbit comes, metres.
const ORBIT_MIN: f64 = 0.1;

/// How the camera moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Freely, faster the farther things are.
    Fly,
    /// On the ground.
    Walk,
    /// Around a place.
    Orbit,
}

/// What is pressed and moved.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Input {
    /// −1 to 1: back to forward.
    pub forward: f64,
    /// −1 to 1: left to right.
    pub right: f64,
    /// −1 to 1: down to up.
    pub up: f64,
    /// −1 to 1: turning to the left and to the right by keys.
    pub turn: f64,
    /// −1 to 1: looking down and up by keys.
    pub tilt: f64,
    /// Radians to the right and upwards by the pointer, since the step before.
    pub dragged: [f64; 2],
    /// Steps of the wheel since the step before, towards the screen.
    pub wheel: f64,
    /// Whether to hurry.
    pub fast: bool,
}

/// The camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rig {
    mode: Mode,
    position: DVec3,
    /// From the first level axis counter-clockwise, and upwards; radians.
    yaw: f64,
    pitch: f64,
    /// Metres a second.
    velocity: DVec3,
    /// Factor on speeds.
    pace: f64,
    /// What is orbited.
    pivot: DVec3,
    /// Whether walking was asked for where there is no ground.
    groundless: bool,
}

fn direction(up: DVec3, yaw: f64, pitch: f64) -> DVec3 {
    let (first, second) = across(up);
    (first * libm::cos(yaw) + second * libm::sin(yaw)) * libm::cos(pitch) + up * libm::sin(pitch)
}

fn angles(up: DVec3, along: DVec3) -> (f64, f64) {
    let (first, second) = across(up);
    let (x, y) = (along.dot(first), along.dot(second));
    let pitch = libm::atan2(along.dot(up), libm::hypot(x, y));
    (if libm::hypot(x, y) > 1e-12 { libm::atan2(y, x) } else { 0.0 }, pitch.clamp(-PITCH_MAX, PITCH_MAX))
}

/// A finite number within ±1.
fn unit(value: f64) -> f64 {
    if value.is_finite() { value.clamp(-1.0, 1.0) } else { 0.0 }
}

fn finite(value: f64) -> f64 {
    if value.is_finite() { value.clamp(-100.0, 100.0) } else { 0.0 }
}

impl Rig {
    /// At a view; its roll is lost.
    pub fn at(view: &View, mode: Mode, around: &impl Surroundings) -> Rig {
        let (yaw, pitch) = angles(around.up(), view.forward());
        let mut rig = Rig {
            mode: Mode::Fly,
            position: view.position,
            yaw,
            pitch,
            velocity: DVec3::ZERO,
            pace: 1.0,
            pivot: view.position,
            groundless: false,
        };
        rig.set_mode(mode, around);
        rig
    }

    /// Where all of a world is seen: from 30° above its middle, as far away as its diagonal is long.
    pub fn overview(around: &impl Surroundings) -> Rig {
        let (bounds, up) = (around.bounds(), around.up());
        let centre = bounds.centre();
        let diagonal = (bounds.max - bounds.min).length().max(1.0);
        let (first, second) = across(up);
        let away = (-first * 0.6 - second * 0.8) * libm::cos(core::f64::consts::FRAC_PI_6) + up * 0.5;
        let (yaw, pitch) = angles(up, -away);
        Rig {
            mode: Mode::Fly,
            position: centre + away * (0.8 * diagonal),
            yaw,
            pitch,
            velocity: DVec3::ZERO,
            pace: 1.0,
            pivot: centre,
            groundless: false,
        }
    }

    /// How it moves.
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Metres a second.
    pub fn speed(&self) -> f64 {
        self.velocity.length()
    }

    /// Whether walking was asked for where there is no ground, and is flying.
    pub fn is_groundless(&self) -> bool {
        self.groundless
    }

    /// What is orbited.
    pub fn pivot(&self) -> DVec3 {
        self.pivot
    }

    /// Moves otherwise from now on. Walking begins on the ground below; from outside of the world's box, at the nearest place in
    /// it. An orbit goes around the first thing straight ahead, else around the world's middle.
    pub fn set_mode(&mut self, mode: Mode, around: &impl Surroundings) {
        self.mode = mode;
        self.velocity = DVec3::ZERO;
        self.groundless = mode == Mode::Walk && around.ground(self.position).is_none();
        if mode == Mode::Walk && !self.groundless {
            let bounds = around.bounds();
            self.position = self.position.clamp(bounds.min, bounds.max);
            self.stand(around);
        }
        if mode == Mode::Orbit {
            let along = direction(around.up(), self.yaw, self.pitch);
            let ahead = around.ahead(self.position, along).map(|distance| distance.max(around.nearest(self.position)));
            match ahead {
                Some(distance) => self.pivot = self.position + along * distance.max(ORBIT_MIN),
                None => {
                    self.pivot = around.bounds().centre();
                    let (yaw, pitch) = angles(around.up(), self.pivot - self.position);
                    let distance = self.position.distance(self.pivot).max(ORBIT_MIN);
                    (self.yaw, self.pitch) = (yaw, pitch);
                    self.position = self.pivot - direction(around.up(), yaw, pitch) * distance;
                }
            }
        }
    }

    /// The view from here.
    pub fn view(&self, around: &impl Surroundings, fov_y: f64, viewport: [u32; 2]) -> View {
        let up = around.up();
        let forward = direction(up, self.yaw, self.pitch);
        let right = forward.cross(up).normalize();
        let orientation = DQuat::from_mat3(&DMat3::from_cols(right, right.cross(forward), -forward)).normalize();
        View { position: self.position, orientation, fov_y, viewport }
    }

    /// Moves for `dt` seconds.
    pub fn step(&mut self, input: &Input, dt: f64, around: &impl Surroundings) {
        let dt = if dt.is_finite() { dt.clamp(0.0, STEP_MAX_S) } else { 0.0 };
        let turned = finite(input.dragged[0]) + unit(input.turn) * TURNING * dt;
        let tilted = finite(input.dragged[1]) + unit(input.tilt) * TURNING * dt;
        let circle = core::f64::consts::TAU;
        self.yaw = libm::remainder(self.yaw - turned, circle);
        self.pitch = (self.pitch + tilted).clamp(-PITCH_MAX, PITCH_MAX);
        let hurry = if input.fast { FAST } else { 1.0 };
        match self.mode {
            Mode::Orbit => self.orbit(input, dt, hurry, around),
            Mode::Fly | Mode::Walk => {
                let zoom = libm::exp(finite(input.wheel) * libm::log(ZOOM));
                self.pace = (self.pace * zoom).clamp(PACE[0], PACE[1]);
                let up = around.up();
                let walks = self.mode == Mode::Walk && !self.groundless;
                let pitch = if walks { 0.0 } else { self.pitch };
                let forward = direction(up, self.yaw, pitch);
                let right = forward.cross(up).normalize();
                let wish = forward * unit(input.forward) + right * unit(input.right);
                let wish = if walks { wish } else { wish + up * unit(input.up) };
                let speed = if walks { WALKING } else { FLYING_RATE * around.nearest(self.position) };
                self.glide(wish.clamp_length_max(1.0) * (speed * self.pace * hurry), dt);
                if walks {
                    self.stand(around);
                }
            }
        }
        self.stay_near(around);
    }

    /// Follows a wished velocity with the lag.
    fn glide(&mut self, wish: DVec3, dt: f64) {
        let kept = libm::exp(-dt / LAG_S);
        let over = self.velocity - wish;
        self.position += wish * dt + over * (LAG_S * (1.0 - kept));
        self.velocity = wish + over * kept;
        // A ten-thousandth of a walk is standing still.
        if wish == DVec3::ZERO && self.velocity.length() < 1e-4 * WALKING {
            self.velocity = DVec3::ZERO;
        }
    }

    fn orbit(&mut self, input: &Input, dt: f64, hurry: f64, around: &impl Surroundings) {
        let up = around.up();
        let before = self.position.distance(self.pivot).max(ORBIT_MIN);
        let closer = finite(input.wheel) * libm::log(ZOOM) + unit(input.forward) * hurry * dt;
        let farthest = FAR * diagonal(around);
        let distance = (before * libm::exp(-closer)).clamp(ORBIT_MIN, farthest.max(ORBIT_MIN));
        // The camera goes to the right, so the world turns to the left, and it looks at the pivot as before.
        self.yaw = libm::remainder(self.yaw + unit(input.right) * hurry * dt, core::f64::consts::TAU);
        self.pitch = (self.pitch - unit(input.up) * hurry * dt).clamp(-PITCH_MAX, PITCH_MAX);
        self.position = self.pivot - direction(up, self.yaw, self.pitch) * distance;
        self.velocity = DVec3::ZERO;
    }

    /// Puts the eyes above the ground.
    fn stand(&mut self, around: &impl Surroundings) {
        if let Some(ground) = around.ground(self.position) {
            let up = around.up();
            self.position += up * (ground + EYES - self.position.dot(up));
        }
    }

    fn stay_near(&mut self, around: &impl Surroundings) {
        let centre = around.bounds().centre();
        let farthest = FAR * diagonal(around);
        self.position = centre + (self.position - centre).clamp_length_max(farthest);
    }
}

fn diagonal(around: &impl Surroundings) -> f64 {
    let bounds = around.bounds();
    (bounds.max - bounds.min).length().max(1.0)
}

#[cfg(test)]
#[path = "rig_tests.rs"]
mod tests;
