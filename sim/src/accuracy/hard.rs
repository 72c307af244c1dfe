//! Scenes made to be hard: where the integrand changes fast, and at the ends of what numbers can hold.

use super::outcome::Kind;
use super::scene::Scene;
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::integral::{AddedBenefit, IntegralError, Leg, Target};
use foresight_scheduler::view::View;
use foresight_traces::random::SplitMix64;
use glam::{DQuat, DVec3};
use std::f64::consts::{PI, TAU};

/// A kind of scene.
struct Generator {
    name: &'static str,
    kind: Kind,
    make: fn(&mut SplitMix64) -> Result<AddedBenefit, IntegralError>,
}

const fn stiff(name: &'static str, make: fn(&mut SplitMix64) -> Result<AddedBenefit, IntegralError>) -> Generator {
    Generator { name, kind: Kind::Stiff, make }
}

const fn extreme(name: &'static str, make: fn(&mut SplitMix64) -> Result<AddedBenefit, IntegralError>) -> Generator {
    Generator { name, kind: Kind::Extreme, make }
}

/// Every kind of scene.
const GENERATORS: [Generator; 24] = [
    stiff("skim-1cm", |r| skim(r, 1e-2)),
    stiff("skim-1um", |r| skim(r, 1e-6)),
    stiff("spin-50", |r| base(r).turning(50.0).leaf(r, 1.0)),
    stiff("events-1ns", |r| base(r).turning(1.0).leaf(r, 5e-10)),
    stiff("grazing", grazing),
    stiff("through-a-box", through),
    stiff("speed-1e4", |r| base(r).at_speed(1e4, r).leaf(r, 10.0)),
    stiff("group-on-the-path", group_on_the_path),
    stiff("narrow-view", |r| base(r).seeing(1e-4).turning(1e-3).leaf(r, 1.0)),
    stiff("wide-view", |r| base(r).seeing(3.1).turning(1.0).leaf(r, 1.0)),
    stiff("horizon-1e5-s", |r| base(r).lasting(1e5).turning(1e-3).leaf(r, 1.0)),
    stiff("attenuated-1e3", |r| base(r).attenuated(1e3).turning(1.0).leaf(r, 1.0)),
    stiff("spring-10-khz", |r| base(r).lasting(1e-4).turning(6e4).leaf(r, 1.0)),
    stiff("centre-weighted", |r| base(r).centre_weighted(100.0).turning(2.0).leaf(r, 1.0)),
    extreme("1nm-beside-1e7m", |r| {
        let size = if r.uniform() < 0.5 { 1e-9 } else { 1e7 };
        base(r).leaf(r, size)
    }),
    extreme("origin-6.4e6", |r| base(r).far_out(6.4e6).at_speed(10.0, r).leaf(r, 1.0)),
    extreme("origin-1.5e11", |r| base(r).far_out(1.5e11).at_speed(10.0, r).leaf(r, 1.0)),
    extreme("speed-0", |r| base(r).at_speed(0.0, r).leaf(r, 1.0)),
    extreme("speed-1e-6", |r| base(r).at_speed(1e-6, r).leaf(r, 1.0)),
    extreme("horizon-1e-9-s", |r| base(r).lasting(1e-9).leaf(r, 1.0)),
    extreme("errors-one-ulp-apart", |r| {
        let benefit = base(r).turning(0.3).leaf(r, 1.0)?;
        Ok(AddedBenefit { before: benefit.after.next_up(), ..benefit })
    }),
    extreme("no-volume", |r| {
        let made = base(r).turning(0.3);
        let mut half = DVec3::splat(0.5);
        // Along one, two or all axes.
        for axis in 0..=(r.uniform() * 3.0) as usize {
            half[axis] = 0.0;
        }
        let centre = made.somewhere(r);
        made.showing(r, Target::leaf(centre, half, 1.0)?)
    }),
    extreme("importance", |r| {
        let iota = [0.0, 5e-324, 1e-300, 1e280][(r.uniform() * 4.0) as usize];
        let made = base(r).turning(0.3);
        let centre = made.somewhere(r);
        made.showing(r, Target::leaf(centre, DVec3::splat(1.0), iota)?)
    }),
    extreme("errors-0-to-1e30", |r| {
        let benefit = base(r).turning(0.3).leaf(r, 1.0)?;
        let after = [0.0, 1e-30, 1e-3, 1e30][(r.uniform() * 4.0) as usize];
        Ok(AddedBenefit { after, before: if r.uniform() < 0.5 { f64::INFINITY } else { 1e31 }, ..benefit })
    }),
];

/// `count` candidates in all, in scenes of candidates that resemble each other; one scene is held at a time.
///
/// # Errors
/// A generator makes something illegal.
pub fn scenes(count: usize, seed: u64) -> impl Iterator<Item = Result<Scene, IntegralError>> {
    let each = count.div_ceil(GENERATORS.len());
    GENERATORS.iter().enumerate().map(move |(i, generator)| {
        let mut random = SplitMix64::new(seed.wrapping_add((i as u64 + 1) << 40));
        let made = (0..each).map(|_| (generator.make)(&mut random).map(|benefit| vec![benefit]));
        let candidates = made.collect::<Result<_, _>>()?;
        Ok(Scene { case: generator.name.to_owned(), kind: generator.kind, candidates })
    })
}

/// A camera and what is asked of it; changed step by step.
#[derive(Clone, Copy)]
struct Made {
    view: View,
    velocity: DVec3,
    rotation: DVec3,
    seconds: f64,
    cut: CutSettings,
    attenuation: f64,
}

/// At the origin, level, 60° high, walking for a second.
fn base(random: &mut SplitMix64) -> Made {
    let yaw = random.uniform() * TAU;
    let orientation = DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(0.4 * (random.uniform() - 0.5));
    let view = View { position: DVec3::ZERO, orientation, fov_y: PI / 3.0, viewport: [1920, 1080] };
    let velocity = orientation * DVec3::new(0.2, 0.0, -1.4);
    let cut = CutSettings::default();
    Made { view, velocity, rotation: DVec3::ZERO, seconds: 1.0, cut, attenuation: 0.0 }
}

impl Made {
    /// rad/s about an axis that is nearly upright.
    fn turning(self, rate: f64) -> Made {
        Made { rotation: DVec3::new(0.05, 1.0, 0.02).normalize() * rate, ..self }
    }

    fn at_speed(self, speed: f64, random: &mut SplitMix64) -> Made {
        Made { velocity: direction(random) * speed, ..self }
    }

    fn seeing(self, fov_y: f64) -> Made {
        Made { view: View { fov_y, ..self.view }, ..self }
    }

    fn lasting(self, seconds: f64) -> Made {
        Made { seconds, ..self }
    }

    fn attenuated(self, attenuation: f64) -> Made {
        Made { attenuation, ..self }
    }

    fn centre_weighted(self, centre_falloff: f64) -> Made {
        Made { cut: CutSettings { centre_falloff, ..self.cut }, ..self }
    }

    fn far_out(self, metres: f64) -> Made {
        Made { view: View { position: DVec3::new(0.6, 0.0, 0.8) * metres, ..self.view }, ..self }
    }

    /// Up to 20 m away, mostly in front.
    fn somewhere(&self, random: &mut SplitMix64) -> DVec3 {
        let spread = direction(random) * 8.0;
        self.view.position + self.view.forward() * (10.0 * random.uniform() + 3.0) + spread
    }

    /// A leaf of about `size` metres; a large one is farther away.
    fn leaf(self, random: &mut SplitMix64, size: f64) -> Result<AddedBenefit, IntegralError> {
        let sides = DVec3::new(0.2 + random.uniform(), 0.2 + random.uniform(), 0.2 + random.uniform());
        let away = (self.somewhere(random) - self.view.position) * size.max(1.0);
        self.showing(random, Target::leaf(self.view.position + away, 0.5 * size * sides, 1.0)?)
    }

    /// Something better than nothing, or than something coarser.
    fn showing(self, random: &mut SplitMix64, target: Target) -> Result<AddedBenefit, IntegralError> {
        let after = libm::pow(10.0, -3.0 + 3.0 * random.uniform());
        let before = if random.uniform() < 0.5 { f64::INFINITY } else { after * (1.5 + 8.0 * random.uniform()) };
        let leg = Leg::new(&self.view, self.velocity, self.rotation, 0.0, self.seconds)?;
        let arrival_s = 0.3 * random.uniform() * self.seconds;
        Ok(AddedBenefit { leg, target, after, before, arrival_s, cut: self.cut, attenuation: self.attenuation })
    }
}

fn direction(random: &mut SplitMix64) -> DVec3 {
    let z = 2.0 * random.uniform() - 1.0;
    let (sin, cos) = libm::sincos(TAU * random.uniform());
    let across = (1.0 - z * z).max(0.0).sqrt();
    DVec3::new(across * cos, across * sin, z)
}

/// Past a wall at 10 m/s, `gap` metres from it; distances count from a hundredth of the gap on.
fn skim(random: &mut SplitMix64, gap: f64) -> Result<AddedBenefit, IntegralError> {
    let made = base(random);
    let along = made.view.orientation * DVec3::NEG_Z;
    let cut = CutSettings { near: 0.01 * gap, ..made.cut };
    // Upright and aligned: the wall is an axis-aligned box beneath the path.
    let level = DVec3::new(along.x, 0.0, along.z).normalize_or(DVec3::X);
    let half = DVec3::new(1.0 + 4.0 * random.uniform(), 0.5, 1.0 + 4.0 * random.uniform());
    let centre = made.view.position + level * (3.0 + 3.0 * random.uniform()) - DVec3::Y * (half.y + gap);
    let made = Made { velocity: level * 10.0, cut, ..made };
    made.showing(random, Target::leaf(centre, half, 1.0)?)
}

/// Something that a plane of the frustum hardly touches while the path runs along that plane.
fn grazing(random: &mut SplitMix64) -> Result<AddedBenefit, IntegralError> {
    let made = base(random);
    let frustum = foresight_scheduler::benefit::frustum::Frustum::new(&made.view);
    let plane = frustum.planes[(random.uniform() * 4.0) as usize];
    let along = (made.view.forward() - plane * plane.dot(made.view.forward())).normalize_or(DVec3::X);
    let half = DVec3::splat(0.2 + random.uniform());
    // From wholly outside to a millionth inside, or out and in by a slow drift.
    let depth = libm::pow(10.0, -9.0 + 7.0 * random.uniform());
    let centre = made.view.position + along * (5.0 + 10.0 * random.uniform()) - plane * (plane.abs().dot(half) - depth);
    let drift = plane * (4.0 * depth * (random.uniform() - 0.5));
    Made { velocity: along * 1.4 + drift, ..made }.showing(random, Target::leaf(centre, half, 1.0)?)
}

/// Into a box and out of it.
fn through(random: &mut SplitMix64) -> Result<AddedBenefit, IntegralError> {
    let made = base(random);
    let ahead = made.view.orientation * DVec3::NEG_Z;
    let half = DVec3::new(0.5 + random.uniform(), 0.5 + random.uniform(), 0.5 + random.uniform());
    let centre = made.view.position + ahead * (3.0 + 2.0 * random.uniform()) + direction(random) * 0.3;
    Made { velocity: ahead * 10.0, ..made }.showing(random, Target::leaf(centre, half, 1.0)?)
}

/// A group whose middle the path meets or nearly meets: 1/d² down to the near plane.
fn group_on_the_path(random: &mut SplitMix64) -> Result<AddedBenefit, IntegralError> {
    let made = base(random);
    let ahead = made.view.orientation * DVec3::NEG_Z;
    let aside = direction(random) * libm::pow(10.0, -4.0 + 4.0 * random.uniform());
    let centre = made.view.position + ahead * (4.0 + 3.0 * random.uniform()) + aside;
    let target = Target::group(centre, DVec3::splat(0.05), DVec3::new(1.0, 2.0, 1.5) * 0.01)?;
    Made { velocity: ahead * 10.0, ..made }.showing(random, target)
}
