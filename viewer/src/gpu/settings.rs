//! How things are drawn; all of it can be changed between two frames.

use glam::DVec3;

/// What a sample of an orthoview is drawn as (\[HIBR\] Figure 8, b to f).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SplatShape {
    /// A circle within the pixel: diameter 1 pixel. (b)
    Circular,
    /// A circle around the pixel, diameter √2 pixels, whose area is scaled by cos θ₂/cos θ₁, the angles between the
    /// normal and the ray to the camera, and between the normal and the orthoview. (c)
    Warped,
    /// A disc in the tangent plane that covers the pixel's square in the orthoview. (d)
    Elliptical,
    /// Connected samples are elliptical, disconnected ones circles around the pixel; links as in
    /// [`HybridNoSphericality`](SplatShape::HybridNoSphericality) are tested again by the GPU. (e)
    HybridNoSphericality,
    /// Connected samples are elliptical, disconnected ones circles around the pixel, as the file's links have it. (f)
    #[default]
    Hybrid,
}

impl SplatShape {
    /// All, in the figure's order.
    pub const ALL: [SplatShape; 5] = [
        SplatShape::Circular,
        SplatShape::Warped,
        SplatShape::Elliptical,
        SplatShape::HybridNoSphericality,
        SplatShape::Hybrid,
    ];

    /// Its name in tables and arguments.
    pub fn name(self) -> &'static str {
        match self {
            SplatShape::Circular => "circular",
            SplatShape::Warped => "warped",
            SplatShape::Elliptical => "elliptical",
            SplatShape::HybridNoSphericality => "hybrid-no-sphericality",
            SplatShape::Hybrid => "hybrid",
        }
    }
}

/// How surfaces are lit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Light {
    /// Colours as they are in the content.
    #[default]
    Unlit,
    /// Colour × (ambient + (1 − ambient)·max(0, n·s)), in linear light.
    Sun {
        /// Unit vector towards the sun, world space.
        towards: DVec3,
        /// Share of the light that comes from everywhere, 0 to 1.
        ambient: f32,
    },
}

/// What is seen where nothing is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Background {
    /// One colour, sRGB.
    Plain([u8; 3]),
    /// From the ground's colour below the horizon over the horizon's to the zenith's; sRGB.
    Sky {
        /// Upwards in the world.
        up: DVec3,
        /// Straight up.
        zenith: [u8; 3],
        /// At the horizon.
        horizon: [u8; 3],
        /// Straight down.
        ground: [u8; 3],
    },
}

impl Default for Background {
    fn default() -> Background {
        Sky::default().background(DVec3::Z)
    }
}

/// What is behind a world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sky {
    /// A bright sky over a horizon, and the ground's colour below.
    #[default]
    Horizon,
    /// Nearly black all round: worlds without ground have no horizon.
    Space,
}

impl Sky {
    /// Its colours in a world where `up` is upwards.
    pub fn background(self, up: DVec3) -> Background {
        match self {
            Sky::Horizon => {
                Background::Sky { up, zenith: [88, 132, 190], horizon: [206, 220, 232], ground: [120, 116, 110] }
            }
            Sky::Space => Background::Plain([11, 13, 20]),
        }
    }
}

/// How things are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings {
    /// Of orthoviews' samples.
    pub shape: SplatShape,
    /// On everything.
    pub light: Light,
    /// Behind everything.
    pub background: Background,
    /// Samples a pixel: 4, or 1; what is neither becomes the next lower of the two.
    pub samples: u32,
    /// What is nearer to the camera's plane than this is not drawn, metres; more than 0.
    pub near: f64,
    /// Whether tiles of orthoviews that are hidden by others are left out, where the adapter can tell. It changes no picture.
    pub occlusion: bool,
}

impl Default for RenderSettings {
    fn default() -> RenderSettings {
        RenderSettings {
            shape: SplatShape::default(),
            light: Light::default(),
            background: Background::default(),
            samples: 1,
            near: 0.1,
            occlusion: true,
        }
    }
}

/// Linear light of an sRGB colour.
pub(crate) fn linear(colour: [u8; 3]) -> [f32; 3] {
    colour.map(foresight_index::orthoview::texture::linear)
}
