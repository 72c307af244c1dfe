use super::*;
use crate::scene::content::{SplatImage, Texels};
use crate::scene::loader::LoaderSettings;
use crate::scene::source::Source;
use foresight_index::orthoview::Direction;
use foresight_index::world::World;
use foresight_scheduler::lod_tree::Aabb;
use glam::DVec3;
use proptest::prelude::*;
use std::sync::OnceLock;

/// Keeps account of what a GPU would hold.
#[derive(Default)]
struct Held {
    bytes: BTreeMap<RepId, u64>,
    order: Vec<RepId>,
    broken: Option<RepId>,
}

impl Uploads for Held {
    fn upload(&mut self, rep: RepId, content: &Content) -> Result<u64, String> {
        assert!(!self.bytes.contains_key(&rep), "uploaded twice");
        if self.broken == Some(rep) {
            return Err("the device is lost".to_owned());
        }
        // A little more than it takes outside, as alignment does.
        let bytes = content.bytes() + 256;
        self.bytes.insert(rep, bytes);
        self.order.push(rep);
        Ok(bytes)
    }

    fn remove(&mut self, rep: RepId) {
        assert!(self.bytes.remove(&rep).is_some(), "removed without being there");
    }
}

fn city() -> (Arc<World>, Arc<Source>) {
    static CITY: OnceLock<(Arc<World>, Arc<Source>)> = OnceLock::new();
    let made = CITY.get_or_init(|| {
        let (world, source) = Source::open("city:blocks=1").expect("a city");
        (Arc::new(world), Arc::new(source))
    });
    made.clone()
}

fn resident(budget: u64, upload_bytes: u64) -> (Arc<World>, Resident) {
    let (world, source) = city();
    let loader = Loader::new(world.clone(), source, LoaderSettings::within(budget)).expect("threads");
    (world, Resident::new(loader, ResidentSettings { upload_bytes, ..ResidentSettings::with_budget(budget) }))
}

/// A content by itself, of 8 bytes a pixel.
fn splats(side: u32) -> Decoded {
    let pixels = (side * side) as usize;
    let content = Content::Splats(SplatImage {
        direction: Direction::from_signs([0, 0, 1]).expect("canonical"),
        origin: DVec3::ZERO,
        right: DVec3::X,
        up: DVec3::Y,
        towards_eye: DVec3::Z,
        pixel: 1.0,
        range: 1.0,
        size: [side; 2],
        colours: vec![255; 4 * pixels],
        shapes: vec![0; pixels],
        normals: vec![0; 2 * pixels],
        colours_kept: Texels::Plain,
        normals_kept: Texels::Plain,
        bounds: Aabb { min: DVec3::ZERO, max: DVec3::ONE },
    });
    Decoded { content, credit: Some("somebody".into()), left_out: Vec::new() }
}

fn loaded(rep: u32, side: u32) -> Loaded {
    Loaded { rep: RepId(rep), bytes: Some(Bytes::from(vec![7; 40])), result: Ok(splats(side)) }
}

#[test]
fn a_whole_world_becomes_resident_and_goes_again() {
    let (world, mut resident) = resident(1 << 30, 1 << 20);
    let mut held = Held::default();
    let count = world.tree.representations() as u32;
    let frame = resident.everything((0..count).map(RepId), &mut held);
    assert!(frame.failed.is_empty(), "{:?}", frame.failed);
    assert_eq!((frame.shown.len(), held.bytes.len()), (count as usize, count as usize));
    assert_eq!(resident.used().gpu, held.bytes.values().sum::<u64>());
    assert_eq!((resident.used().decoded, resident.pending()), (0, 0));
    for rep in (0..count).map(RepId) {
        resident.discard(rep, &mut held);
    }
    assert!(held.bytes.is_empty() && resident.used().gpu == 0);
    // Bytes that came are of use again.
    assert!(resident.cached(RepId(0)).is_some());
}

#[test]
fn a_budget_of_a_mebibyte_holds_and_says_what_is_missing() {
    let (world, mut resident) = resident(1 << 20, 1 << 20);
    let mut held = Held::default();
    let count = world.tree.representations() as u32;
    let frame = resident.everything((0..count).map(RepId), &mut held);
    assert!(!frame.shown.is_empty() && !frame.failed.is_empty());
    assert_eq!(frame.shown.len() + frame.failed.len(), count as usize, "each is shown or told");
    assert!(
        frame.failed.iter().all(|(_, why)| why.contains("the memory budget is 1048576 bytes")),
        "{:?}",
        frame.failed[0]
    );
    assert!(resident.used().total() <= 1 << 20 && resident.used().gpu == held.bytes.values().sum::<u64>());
}

#[test]
fn a_frame_uploads_the_most_wanted_within_its_bytes() {
    // 16 × 16 pixels are 2048 bytes: two of them a frame.
    let (_, mut resident) = resident(1 << 20, 4096);
    let mut held = Held { broken: Some(RepId(3)), ..Held::default() };
    for rep in 0..6 {
        resident.ranks.insert(RepId(rep), f64::from(rep));
    }
    let mut frame = Frame::default();
    resident.take((0..6).map(|rep| loaded(rep, 16)).collect(), &mut frame);
    resident.rank(RepId(0), 9.0);
    let frame = resident.frame(&mut held);
    assert_eq!(frame.shown, [RepId(0), RepId(5)]);
    let frame = resident.frame(&mut held);
    assert_eq!((frame.shown, frame.failed.len()), (vec![RepId(4)], 1), "what fails costs its bytes too");
    assert_eq!(resident.credits([RepId(0), RepId(4)]).len(), 1);
    resident.discard(RepId(1), &mut held);
    let frame = resident.frame(&mut held);
    assert_eq!((frame.shown, resident.pending()), (vec![RepId(2)], 0));
    // What is larger than a frame's bytes goes alone.
    resident.ranks.insert(RepId(9), 0.0);
    resident.take(vec![loaded(9, 100)], &mut Frame::default());
    assert_eq!(resident.frame(&mut held).shown, [RepId(9)]);
}

#[derive(Clone, Debug)]
enum Step {
    Came { rep: u32, side: u32, rank: f64 },
    Discard(u32),
    Frame,
    Budget(u64),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        4 => (0..12u32, 1..80u32, -2.0..2.0f64).prop_map(|(rep, side, rank)| Step::Came { rep, side, rank }),
        2 => (0..12u32).prop_map(Step::Discard),
        3 => Just(Step::Frame),
        1 => (1000..300_000u64).prop_map(Step::Budget),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn memory_is_accounted_for_whatever_happens(steps in prop::collection::vec(step(), 1..60), budget in 1000..300_000u64) {
        let (_, mut resident) = resident(budget, 10_000);
        let mut held = Held::default();
        let mut budget = budget;
        for step in steps {
            match step {
                Step::Came { rep, side, rank } if !resident.is_shown(RepId(rep)) && !resident.is_pending(RepId(rep)) => {
                    resident.ranks.insert(RepId(rep), rank);
                    resident.take(vec![loaded(rep, side)], &mut Frame::default());
                }
                Step::Came { rep, rank, .. } => resident.rank(RepId(rep), rank),
                Step::Discard(rep) => resident.discard(RepId(rep), &mut held),
                Step::Frame => {
                    let frame = resident.frame(&mut held);
                    prop_assert!(frame.shown.iter().all(|rep| resident.is_shown(*rep)));
                    prop_assert!(frame.failed.iter().all(|(rep, _)| !resident.is_shown(*rep)));
                }
                Step::Budget(new) => {
                    budget = new;
                    resident.set_settings(ResidentSettings { upload_bytes: 10_000, ..ResidentSettings::with_budget(new) });
                }
            }
            let used = resident.used();
            prop_assert_eq!(used.gpu, held.bytes.values().sum::<u64>());
            prop_assert_eq!(used.wire, resident.wire.values().map(|(bytes, _)| bytes.len() as u64).sum::<u64>());
            prop_assert_eq!(used.decoded, resident.waiting.values().map(|waiting| waiting.bytes).sum::<u64>());
            // A smaller budget does not take from the GPU by itself; all else has gone then.
            prop_assert!(used.total() <= budget || used.wire + used.decoded == 0, "{used:?} of {budget}");
            prop_assert_eq!(resident.pending(), resident.waiting.len());
        }
    }
}
