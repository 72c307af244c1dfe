//! Worlds, views, links and settings at the ends of what is allowed: whole replays by every policy.

use foresight_scheduler::benefit::accuracy::HALF_ACCURACY_PX;
use foresight_scheduler::benefit::coverage::Refinement;
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, Representation};
use foresight_scheduler::policy::specification::{PolicySpec, names, rival};
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_sim::bound::{CheapestBeneath, FrameBound, Limits};
use foresight_sim::future;
use foresight_sim::replay::{Run, Stage, replay};
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{Flight, TICKS_PER_FRAME, tick_time};
use foresight_traces::link::LinkTrace;
use glam::{DQuat, DVec3};

const RTT: Time = Time(20_000_000);

/// A coarse root over leaves with two representations each; errors fall from the root's.
fn world(boxes: &[(DVec3, DVec3)], root_error: f32) -> LodTree {
    let rep = |wire_bytes, error| Representation {
        wire_bytes,
        decoded_bytes: 2 * wire_bytes,
        error,
        prerequisite: None,
        direction: None,
    };
    let mut builder = LodTreeBuilder::default();
    builder.open().unwrap();
    builder.add(rep(500, root_error)).unwrap();
    for &(centre, half) in boxes {
        builder.open().unwrap();
        let coarse = builder.add(rep(1000, root_error / 4.0)).unwrap();
        builder.add(Representation { prerequisite: Some(coarse), ..rep(4000, root_error / 16.0) }).unwrap();
        builder.close(Some(Aabb { min: centre - half, max: centre + half }), 1.0).unwrap();
    }
    builder.close(None, 1.0).unwrap();
    builder.finish().unwrap()
}

fn view(position: DVec3, fov_y: f64) -> View {
    View { position, orientation: DQuat::IDENTITY, fov_y, viewport: [1600, 900] }
}

/// A walk to the right and ahead, turning.
fn walk(start: View, speed: f64) -> Flight {
    Flight::sample(2.0, |t| View {
        position: start.position + DVec3::new(1.0, 0.0, -1.0) * (speed * t),
        orientation: DQuat::from_rotation_y(0.2 * t),
        ..start
    })
}

/// Replays every policy, with `options` for those that have them, under both refinements; checks each frame against its
/// bound, and answers the runs.
fn replay_all(tree: &LodTree, flight: &Flight, link: &LinkTrace, budget: u64, options: &str) -> Vec<(String, Run)> {
    let cuts = flight.cuts(tree, &CutSettings::default());
    let cheapest = CheapestBeneath::new(tree);
    let mut runs = Vec::new();
    for refinement in [Refinement::Partial, Refinement::Atomic] {
        for name in names() {
            let text = format!("{name}{}", if rival(name).is_none() { options } else { "" });
            let spec = PolicySpec::parse_list(&text, 0.7, None).unwrap().remove(0);
            let scheduler = SchedulerSettings { refinement, ..SchedulerSettings::with_budget(budget) };
            let stage = Stage {
                tree,
                flight,
                cuts: &cuts,
                link,
                link_start: Time::ZERO,
                client: ClientSettings::default(),
                scheduler,
                preloaded: &[],
            };
            let run = replay(stage, future::build(&spec, tree, flight, link, Time::ZERO)).unwrap();
            for (frame, quality) in run.frames.iter().enumerate() {
                assert!(quality.benefit.is_finite() && quality.weight.is_finite(), "{text}: {quality:?}");
                assert!(run.memory[frame] <= budget, "{text}");
                let Some(mean) = quality.mean() else { continue };
                let at = tick_time(frame as u64 * TICKS_PER_FRAME);
                let limits = Limits { wire: link.bytes_deliverable(Time::ZERO, at) as f64, memory: budget as f64 };
                let bound = FrameBound::new(tree, &cheapest, &cuts[frame]).unwrap().bound(limits);
                assert!(mean <= bound + 1e-9, "{text}, frame {frame}: {mean} > {bound}");
            }
            runs.push((format!("{text} {refinement:?}"), run));
        }
    }
    runs
}

fn fast() -> LinkTrace {
    LinkTrace::constant("fast", 8_000_000, RTT).unwrap()
}

fn last_quality(run: &Run) -> Option<f64> {
    run.frames.last().and_then(|q| q.mean())
}

/// Four boxes around the view's axis, `d` metres ahead, with half sides of `half`.
fn ahead(d: f64, half: f64) -> Vec<(DVec3, DVec3)> {
    [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]
        .into_iter()
        .map(|(x, y)| (DVec3::new(2.0 * half * x, 2.0 * half * y, -d), DVec3::splat(half)))
        .collect()
}

/// 6.4·10⁶ m from the origin two boxes of which one is a millimetre nearer: their distances tell them apart.
#[test]
fn a_planet_to_the_millimetre() {
    let eye = DVec3::new(3.7e6, -3.7e6, 3.7e6);
    assert!(eye.length() > 6.4e6);
    let half = DVec3::new(0.1, 0.1, 0.05);
    let (near, far) = (0.5, 0.501);
    let boxes = [(-0.2, near), (0.2, far)].map(|(x, d)| (eye + DVec3::new(x, 0.0, -(d + half.z)), half));
    let tree = world(&boxes, 0.01);
    let start = view(eye, 1.0);
    let mut cut = Cut::default();
    cut.make(&tree, &start, Region::Frustum, &CutSettings { opening: 0.0, ..CutSettings::default() });
    assert_eq!(cut.patches.len(), 2);
    for (patch, d) in cut.patches.iter().zip([near, far]) {
        // Each box begins 0.1 m beside the axis.
        let distance = start.pixels_per_radian() / (HALF_ACCURACY_PX * patch.sharpness.sqrt());
        assert!((distance - libm::hypot(d, 0.1)).abs() < 1e-7, "{distance}");
    }
    assert!(cut.patches[0].weight > cut.patches[1].weight);
    for (name, run) in replay_all(&tree, &Flight { views: vec![start; 60] }, &fast(), 1 << 20, "") {
        assert!(last_quality(&run).unwrap() > 0.9, "{name}: {:?}", last_quality(&run));
    }
}

#[test]
fn the_camera_inside_every_box_at_once() {
    let boxes: Vec<_> = (1..6).map(|i| (DVec3::ZERO, DVec3::splat(10.0 * f64::from(i)))).collect();
    let tree = world(&boxes, 0.01);
    for (name, run) in replay_all(&tree, &walk(view(DVec3::ZERO, 1.0), 1.0), &fast(), 1 << 20, "") {
        assert!(last_quality(&run).unwrap() > 0.5, "{name}");
    }
}

#[test]
fn a_telescope_of_a_microradian() {
    let tree = world(&ahead(1e6, 0.2), 0.001);
    let start = view(DVec3::ZERO, 1e-6);
    for (name, run) in replay_all(&tree, &Flight { views: vec![start; 60] }, &fast(), 1 << 20, "") {
        assert!(run.frames[0].weight > 0.0, "{name}");
        assert!(last_quality(&run).unwrap() > 0.5, "{name}");
    }
}

#[test]
fn a_view_of_179_degrees() {
    let tree = world(&ahead(20.0, 2.0), 1.0);
    let start = view(DVec3::ZERO, 179f64.to_radians());
    for (name, run) in replay_all(&tree, &walk(start, 5.0), &fast(), 1 << 20, "") {
        assert!(last_quality(&run).unwrap() > 0.9, "{name}");
    }
}

#[test]
fn errors_beyond_everything_and_of_nothing() {
    for (error, expected) in [(1e30f32, 0.0), (0.0, 1.0)] {
        let tree = world(&ahead(20.0, 2.0), error);
        for (name, run) in replay_all(&tree, &walk(view(DVec3::ZERO, 1.0), 0.0), &fast(), 1 << 20, "") {
            let last = last_quality(&run).unwrap();
            assert!((last - expected).abs() < 1e-9, "{name} with {error} m: {last}");
        }
    }
}

#[test]
fn boxes_of_a_nanometre_and_of_a_million_kilometres() {
    let mut boxes = ahead(1.0, 5e-10);
    boxes.push((DVec3::new(0.0, 0.0, -6e8), DVec3::splat(5e8)));
    let tree = world(&boxes, 1e-3);
    for (name, run) in replay_all(&tree, &walk(view(DVec3::ZERO, 1.0), 0.1), &fast(), 1 << 20, "") {
        assert!(run.frames[0].weight > 0.0 && last_quality(&run).unwrap() > 0.9, "{name}");
    }
}

#[test]
fn a_link_of_one_bit_a_second() {
    let tree = world(&ahead(20.0, 2.0), 1.0);
    let link = LinkTrace::constant("telegraph", 1, RTT).unwrap();
    for (name, run) in replay_all(&tree, &walk(view(DVec3::ZERO, 1.0), 5.0), &link, 1 << 20, "") {
        assert!(run.completions.is_empty() && run.bytes_fetched == 0, "{name}");
    }
}

/// 1500 bytes hold the root's request and nothing larger.
#[test]
fn memory_for_exactly_one_request() {
    let tree = world(&ahead(20.0, 2.0), 1.0);
    for (name, run) in replay_all(&tree, &walk(view(DVec3::ZERO, 1.0), 5.0), &fast(), 1500, "") {
        let shown: Vec<u32> = run.completions.iter().map(|c| c.rep.0).collect();
        assert_eq!(shown, [0], "{name}");
        assert_eq!(run.evictions, 0, "{name}");
    }
    for (name, run) in replay_all(&tree, &walk(view(DVec3::ZERO, 1.0), 5.0), &fast(), 1499, "") {
        assert!(run.completions.is_empty(), "{name}");
    }
}

#[test]
fn trust_of_nothing_and_of_everything() {
    let tree = world(&ahead(20.0, 2.0), 1.0);
    for options in [":alpha=0", ":alpha=1"] {
        // Slow enough for a viewer that requests nothing while a second's movement exceeds a box.
        for (name, run) in replay_all(&tree, &walk(view(DVec3::ZERO, 1.0), 2.0), &fast(), 1 << 20, options) {
            assert!(last_quality(&run).unwrap() > 0.9, "{name}: {:?}", last_quality(&run));
        }
    }
}

#[test]
fn a_horizon_of_one_sample() {
    let tree = world(&ahead(20.0, 2.0), 1.0);
    for options in [":samples=1", ":samples=1:horizon=0.01", ":samples=1:alpha=1", ":samples=1:reuse=0.001"] {
        // Slow enough for a viewer that requests nothing while a second's movement exceeds a box.
        for (name, run) in replay_all(&tree, &walk(view(DVec3::ZERO, 1.0), 2.0), &fast(), 1 << 20, options) {
            assert!(last_quality(&run).unwrap() > 0.9, "{name}: {:?}", last_quality(&run));
        }
    }
}
