//! Tiny replays whose best policy can be found by going through all, to check the bound against.
//!
//! A root shows everything coarsely; two or three groups beneath it have a coarse representation each and one or two
//! leaves with a fine one: 5 to 10 representations of 1 to 4 packets of 1500 B, decoded to 3 to 5 times that. The camera
//! passes by for 4 s, turning a little. The link delivers at most one packet between two frames, and in all about
//! [`Stratum::supply`] × the bytes of the world, with an outage; memory holds [`Stratum::memory`] × its decoded bytes.
//! Nothing has a prerequisite, and a group never is one target.

use super::whole::{self, Terms};
use foresight_scheduler::benefit::cut::{Cut, CutSettings};
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, LodTreeError, Representation};
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_traces::flight::{Flight, TICKS_PER_FRAME, tick_time};
use foresight_traces::link::{LinkTrace, OPPORTUNITY_BYTES};
use foresight_traces::random::SplitMix64;
use glam::{DQuat, DVec3};

/// Frames of an instance.
pub const FRAMES: usize = 120;

/// How much of what the world holds can be had.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stratum {
    /// Everything comes within half the replay, and fits.
    Ample,
    /// About all of it comes by the end, and three quarters fit.
    Matched,
    /// Two fifths come, and half of it fits.
    Scarce,
}

impl Stratum {
    /// All of them.
    pub const ALL: [Stratum; 3] = [Stratum::Ample, Stratum::Matched, Stratum::Scarce];

    /// As it is called in tables.
    pub fn name(self) -> &'static str {
        match self {
            Stratum::Ample => "ample",
            Stratum::Matched => "matched",
            Stratum::Scarce => "scarce",
        }
    }

    /// Bytes that the link delivers ÷ wire bytes of the world.
    pub fn supply(self) -> f64 {
        match self {
            Stratum::Ample => 2.0,
            Stratum::Matched => 1.0,
            Stratum::Scarce => 0.4,
        }
    }

    /// Memory ÷ decoded bytes of the world.
    pub fn memory(self) -> f64 {
        match self {
            Stratum::Ample => 1.0,
            Stratum::Matched => 0.75,
            Stratum::Scarce => 0.5,
        }
    }
}

/// A replay that is tiny.
#[derive(Clone, Debug)]
pub struct Instance {
    /// The world.
    pub tree: LodTree,
    /// What the frames see.
    pub cuts: Vec<Cut>,
    /// The link; it starts at 0.
    pub link: LinkTrace,
    /// Memory, decoded bytes.
    pub budget: u64,
}

/// The instance of a seed.
pub fn tiny(seed: u64, stratum: Stratum) -> Instance {
    made(seed, stratum, world)
}

/// The instance of a seed in a world of orthoviews: two of the root and two of each of two groups, of different directions,
/// and a mesh of each leaf.
pub fn tiny_with_directions(seed: u64, stratum: Stratum) -> Instance {
    made(seed, stratum, world_with_directions)
}

fn made(seed: u64, stratum: Stratum, world: impl Fn(&mut SplitMix64) -> Result<LodTree, LodTreeError>) -> Instance {
    let mut random = SplitMix64::new(seed ^ (stratum as u64) << 56);
    loop {
        // A draw that is no world or no link, or sees nothing, is drawn again.
        let Ok(tree) = world(&mut random) else { continue };
        let reps = 0..tree.representations() as u32;
        let (wire, decoded) = reps
            .map(foresight_scheduler::lod_tree::RepId)
            .fold((0, 0), |(wire, decoded), rep| (wire + tree.wire_bytes(rep), decoded + tree.decoded_bytes(rep)));
        let packets = libm::round(stratum.supply() * wire as f64 / OPPORTUNITY_BYTES as f64) as usize;
        let Ok(link) = link(&mut random, packets) else { continue };
        let settings = CutSettings { opening: 0.0, ..CutSettings::default() };
        let cuts = flight(&mut random).cuts(&tree, &settings);
        if cuts.iter().all(|cut| cut.total_weight <= 0.0) {
            continue;
        }
        let budget = libm::round(stratum.memory() * decoded as f64) as u64;
        return Instance { tree, cuts, link, budget };
    }
}

/// The proven bound of the mean quality.
pub fn bound(instance: &Instance) -> f64 {
    let Instance { tree, cuts, link, budget } = instance;
    let terms = Terms { tree, cuts, link, at_start: 0, budget: *budget };
    whole::bounds(&terms, &[Time::ZERO]).first().and_then(whole::Bound::mean_quality).unwrap_or(0.0)
}

fn between(random: &mut SplitMix64, low: f64, high: f64) -> f64 {
    low + (high - low) * random.uniform()
}

fn representation(random: &mut SplitMix64, packets: [u32; 2], error: [f64; 2]) -> Representation {
    let count = packets[0] + (random.uniform() * f64::from(packets[1] - packets[0] + 1)) as u32;
    let wire_bytes = count.min(packets[1]) * OPPORTUNITY_BYTES as u32;
    let decoded_bytes = (f64::from(wire_bytes) * between(random, 3.0, 5.0)) as u32;
    let error = between(random, error[0], error[1]) as f32;
    Representation { wire_bytes, decoded_bytes, error, prerequisite: None, direction: None }
}

fn world(random: &mut SplitMix64) -> Result<LodTree, LodTreeError> {
    let mut builder = LodTreeBuilder::default();
    builder.open()?;
    builder.add(representation(random, [1, 1], [1.5, 2.5]))?;
    let groups = 2 + (random.uniform() * 2.0) as u32;
    for group in 0..groups.min(3) {
        let at =
            DVec3::new(between(random, -8.0, 8.0) + 18.0 * f64::from(group) - 18.0, 0.0, between(random, -30.0, -10.0));
        builder.open()?;
        builder.add(representation(random, [1, 2], [0.5, 1.0]))?;
        for leaf in 0..1 + (random.uniform() * 2.0) as u32 {
            builder.open()?;
            builder.add(representation(random, [2, 4], [0.05, 0.3]))?;
            let min = at + DVec3::new(between(random, 4.0, 6.0) * f64::from(leaf), 0.0, 0.0);
            let size = DVec3::new(between(random, 2.0, 4.0), between(random, 3.0, 9.0), between(random, 2.0, 4.0));
            builder.close(Some(Aabb { min, max: min + size }), 1.0)?;
        }
        builder.close(None, 1.0)?;
    }
    builder.close(None, 1.0)?;
    builder.finish()
}

fn world_with_directions(random: &mut SplitMix64) -> Result<LodTree, LodTreeError> {
    // From the front, the sides, above and the upper corners towards the camera, y up.
    const FACING: [u8; 6] = [14, 22, 4, 16, 26, 8];
    let mut builder = LodTreeBuilder::default();
    let two = |builder: &mut LodTreeBuilder, random: &mut SplitMix64, packets, error| -> Result<(), LodTreeError> {
        let first = (random.uniform() * 6.0) as usize;
        let second = (first + 1 + (random.uniform() * 5.0) as usize) % 6;
        for which in [first.min(5), second] {
            let direction = Some(FACING[which]);
            builder.add(Representation { direction, ..representation(random, packets, error) })?;
        }
        Ok(())
    };
    builder.open()?;
    two(&mut builder, random, [1, 1], [1.5, 2.5])?;
    for group in 0..2 {
        let x = between(random, -8.0, 8.0) + 18.0 * f64::from(group) - 9.0;
        let at = DVec3::new(x, 0.0, between(random, -30.0, -10.0));
        builder.open()?;
        two(&mut builder, random, [1, 2], [0.3, 0.8])?;
        for leaf in 0..1 + (random.uniform() * 2.0) as u32 {
            builder.open()?;
            builder.add(representation(random, [2, 4], [0.05, 0.3]))?;
            let min = at + DVec3::new(between(random, 4.0, 6.0) * f64::from(leaf), 0.0, 0.0);
            let size = DVec3::new(between(random, 2.0, 4.0), between(random, 3.0, 9.0), between(random, 2.0, 4.0));
            builder.close(Some(Aabb { min, max: min + size }), 1.0)?;
        }
        builder.close(None, 1.0)?;
    }
    builder.close(None, 1.0)?;
    builder.finish()
}

fn flight(random: &mut SplitMix64) -> Flight {
    let from = DVec3::new(between(random, -25.0, 25.0), 2.0, 0.0);
    let velocity = DVec3::new(between(random, -8.0, 8.0), 0.0, between(random, -3.0, 1.0));
    let (yaw, turning) = (between(random, -0.3, 0.3), between(random, -0.25, 0.25));
    let seconds = tick_time(FRAMES as u64 * TICKS_PER_FRAME).secs();
    Flight::sample(seconds, |at| View {
        position: from + velocity * at,
        orientation: DQuat::from_rotation_y(yaw + turning * at).normalize(),
        fov_y: 1.0,
        viewport: [1920, 1080],
    })
}

/// Packets at most one between two frames, spread evenly but for chance and an outage.
fn link(random: &mut SplitMix64, packets: usize) -> Result<LinkTrace, foresight_traces::link::LinkError> {
    let outage = (random.uniform() * 80.0) as usize;
    let gaps: Vec<usize> = (0..FRAMES).filter(|gap| !(outage..outage + 15).contains(gap)).collect();
    let mut instants = Vec::new();
    let (mut left, mut due) = (gaps.len(), packets.min(gaps.len()));
    for gap in gaps {
        if random.uniform() * (left as f64) < due as f64 {
            // In the middle between two frames, milliseconds.
            instants.push(gap as u64 * 100 / 3 + 16);
            due -= 1;
        }
        left -= 1;
    }
    // After the last frame, so that the trace is as long as the replay.
    instants.push(FRAMES as u64 * 100 / 3 + 100);
    LinkTrace::from_opportunities("packets", &instants, Time::ZERO)
}
