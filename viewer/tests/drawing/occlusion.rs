//! Culling by occlusion leaves out much, and nothing that is seen.

use crate::scene::{Plate, gpu, list, looking, orthoview, ray, renderer};
use foresight_index::orthoview::Direction;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::view::View;
use foresight_viewer::gpu::Renderer;
use foresight_viewer::scene::content::Content;
use glam::DVec3;

const SIZE: [u32; 2] = [160, 120];

/// A wall of 40 m across the y axis, and behind it 40 plates of 3 m that face it, of different colours.
fn street(renderer: &mut Renderer) -> Vec<Plate> {
    let front = Direction::from_signs([0, -1, 0]).expect("canonical");
    let mut plates = Vec::new();
    let mut place = |rep: u32, centre: DVec3, half: f64, side: u32| {
        let plate = Plate { centre, axes: [DVec3::X, DVec3::Z], half };
        plates.push(plate);
        let mut image = orthoview(&plate, front, centre, 2.2 * half, side);
        for colour in image.colours.chunks_exact_mut(4) {
            colour[..3].copy_from_slice(&[(37 * rep % 256) as u8, (91 * rep % 256) as u8, 40]);
        }
        renderer.upload(RepId(rep), &Content::Splats(image)).expect("an orthoview");
    };
    place(0, DVec3::ZERO, 20.0, 128);
    for rep in 1..41 {
        let (column, row) = (f64::from((rep - 1) % 8) - 3.5, f64::from((rep - 1) / 8));
        place(rep, DVec3::new(6.0 * column, 20.0 + 5.0 * row, 4.0 * row - 8.0), 1.5, 32);
    }
    plates
}

fn views() -> Vec<View> {
    let middle = DVec3::new(0.0, 20.0, 0.0);
    let mut views: Vec<View> =
        (0..14).map(|step| looking(DVec3::new(7.0 * f64::from(step), -45.0, 5.0), middle, [320, 240])).collect();
    // Cuts: behind the wall, through it, far away, and back.
    for from in [
        DVec3::new(0.0, 5.0, 0.0),
        DVec3::new(1.0, -3.0, 0.5),
        DVec3::new(0.0, -4000.0, 9.0),
        DVec3::new(0.0, -45.0, 5.0),
    ] {
        views.push(looking(from, middle, [320, 240]));
    }
    views
}

#[test]
fn pictures_are_the_same_with_and_without_culling() {
    let Some(gpu) = gpu() else {
        return;
    };
    for samples in [1, 4] {
        let (mut culled, mut whole) = (renderer(&gpu), renderer(&gpu));
        culled.settings().occlusion = true;
        (culled.settings().samples, whole.settings().samples) = (samples, samples);
        let reps = street(&mut culled).len() as u32;
        street(&mut whole);
        for (step, view) in views().iter().enumerate() {
            let (expected, _) = whole.picture(view, &list(0..reps)).expect("a picture");
            let (picture, _) = culled.picture(view, &list(0..reps)).expect("a picture");
            let differ = picture.rgba.iter().zip(&expected.rgba).filter(|(a, b)| a.abs_diff(**b) > 1).count();
            assert_eq!(differ, 0, "{samples} samples, view {step}");
            assert!(picture.distance == expected.distance, "{samples} samples, view {step}");
        }
        assert_eq!(whole.occlusion(), None);
    }
}

#[test]
fn what_is_behind_the_wall_is_left_out_once_the_wall_is_known() {
    let Some(gpu) = gpu() else {
        return;
    };
    let mut renderer = renderer(&gpu);
    renderer.settings().occlusion = true;
    let plates = street(&mut renderer);
    let reps = plates.len() as u32;
    let view = looking(DVec3::new(0.0, -45.0, 0.0), DVec3::ZERO, SIZE);
    let mut frames = Vec::new();
    for _ in 0..3 {
        renderer.picture(&view, &list(0..reps)).expect("a picture");
        frames.push(renderer.occlusion().expect("its answers, for it was read back"));
    }
    // Of the first frame nothing is known before: the test finds nothing drawn, and lets all through. The second draws all
    // at once, and only then knows what that hid.
    assert!(frames[..2].iter().all(|frame| frame.points_drawn == frame.points), "{frames:?}");
    assert!(frames[2].points > 14_000 && frames[2].points_drawn < 5000 && frames[2].tiles_drawn == 16, "{frames:?}");
    // Without the wall everything is seen again, in the first frame.
    let (alone, _) = renderer.picture(&view, &list(1..reps)).expect("a picture");
    let hit = |at: usize, margin: f64| {
        let along = ray(&view, at as u32 % SIZE[0], at as u32 / SIZE[0]);
        plates[1..].iter().any(|plate| plate.hit(view.position, along, margin).is_some())
    };
    // Splats reach 0.13 m over a plate's edge and samples 0.09 m short of it, and a pixel is 0.6 to 0.8 m wide.
    let inside: Vec<usize> = (0..160 * 120).filter(|&at| hit(at, 0.2)).collect();
    assert!(inside.len() > 500 && inside.iter().all(|&at| !alone.is_sky(at)), "{}", inside.len());
    assert!((0..160 * 120).filter(|&at| !hit(at, -0.6)).all(|at| alone.is_sky(at)));
    let counts = renderer.occlusion().expect("answers");
    assert!(10 * counts.points_drawn > 9 * counts.points, "{counts:?}");
    renderer.picture(&view, &list([])).expect("an empty picture");
}
