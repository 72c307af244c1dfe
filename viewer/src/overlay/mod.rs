//! What is written over the picture, and what can be set there. Everything in it has a key of its own
//! ([`crate::controls::bindings`]), and the tabulator key goes from one to the next.

pub mod colours;
mod panels;

use crate::controls::rig::Mode;
use crate::exchange::Status;
use crate::gpu::{EnvironmentCounts, FrameCounts, Light, SplatShape};
use crate::scene::resident::Used;
use colours::FalseColour;
use glam::DVec3;
use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

pub use panels::show;

/// What can be set while flying.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    /// Whether the panels are seen.
    pub panels: bool,
    /// Whether the keys are listed.
    pub keys: bool,
    /// What contents are tinted by.
    pub false_colour: FalseColour,
    /// What samples of orthoviews are drawn as.
    pub shape: SplatShape,
    /// Whether surfaces are lit.
    pub lit: bool,
    /// Where the sun is: degrees around up, and above the horizon.
    pub sun: [f64; 2],
    /// Share of the light that comes from everywhere.
    pub ambient: f32,
    /// Whether a pixel has four samples.
    pub smooth: bool,
    /// Whether less is drawn where a frame takes too long.
    pub holds_time: bool,
    /// Whether what is far comes from environment maps.
    pub maps: bool,
}

impl Default for Look {
    fn default() -> Look {
        Look {
            panels: true,
            keys: false,
            false_colour: FalseColour::Off,
            shape: SplatShape::default(),
            lit: false,
            sun: [40.0, 45.0],
            ambient: 0.35,
            smooth: false,
            holds_time: true,
            maps: false,
        }
    }
}

impl Look {
    /// The light, where `up` is up.
    pub fn light(&self, up: DVec3) -> Light {
        if !self.lit {
            return Light::Unlit;
        }
        let across = up.any_orthonormal_vector();
        let [around, above] = self.sun.map(f64::to_radians);
        let level = across * libm::cos(around) + up.cross(across) * libm::sin(around);
        Light::Sun { towards: level * libm::cos(above) + up * libm::sin(above), ambient: self.ambient }
    }

    /// The next shape of splats.
    pub fn next_shape(&mut self) {
        let place = SplatShape::ALL.iter().position(|&shape| shape == self.shape).unwrap_or(0);
        self.shape = SplatShape::ALL[(place + 1) % SplatShape::ALL.len()];
    }

    /// The sun 15° further around.
    pub fn turn_sun(&mut self) {
        self.lit = true;
        self.sun[0] = (self.sun[0] + 15.0) % 360.0;
    }

    /// The sun 15° higher, from the zenith to the horizon.
    pub fn raise_sun(&mut self) {
        self.lit = true;
        self.sun[1] = if self.sun[1] + 15.0 > 90.0 { 0.0 } else { self.sun[1] + 15.0 };
    }
}

/// What the panels tell.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// Who decides, and what comes.
    pub status: Status,
    /// Seconds from one frame to the next, the latest last.
    pub frames_s: VecDeque<f32>,
    /// Drawn in the latest frame.
    pub counts: FrameCounts,
    /// Environment maps in the latest frame, if they are wanted.
    pub maps: Option<EnvironmentCounts>,
    /// Representations in the latest frame, and what of them stands in for others.
    pub items: usize,
    /// Stand-ins among them.
    pub substitutes: u32,
    /// What is drawn is so many times as coarse as asked for.
    pub bias: f64,
    /// Quality of what is on the GPU.
    pub shown_quality: Option<f64>,
    /// Bytes received a second, of late.
    pub rate: f64,
    /// Memory by what it is for.
    pub used: Used,
    /// Contents that wait to be decoded or uploaded.
    pub pending: usize,
    /// How the camera moves.
    pub mode: Option<Mode>,
    /// Metres a second.
    pub speed: f64,
    /// Metres.
    pub position: DVec3,
    /// Of the path: seconds into it, and its length, if one plays.
    pub playing: Option<(f64, f64)>,
    /// Seconds recorded, if a path is recorded.
    pub recording: Option<f64>,
    /// Whose the content on the screen is.
    pub credits: BTreeSet<Arc<str>>,
    /// What draws.
    pub adapter: String,
    /// What is to be known at once.
    pub notices: Vec<String>,
    /// The addresses of what is on its way, in the order of [`Status::fetching`].
    pub addresses: Vec<String>,
}
