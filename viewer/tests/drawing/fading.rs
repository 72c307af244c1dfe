//! The frame before fades into the next by elapsed time.

use crate::scene::{Plate, gpu, list, looking, orthoview, renderer};
use foresight_index::orthoview::Direction;
use foresight_scheduler::lod_tree::RepId;
use foresight_viewer::gpu::{FadeSettings, Picture, Renderer, Reprojection};
use foresight_viewer::scene::content::Content;
use glam::DVec3;

const SIZE: [u32; 2] = [160, 120];

/// Two plates at the same place, red and green, and a third, blue, a metre nearer.
fn plates(renderer: &mut Renderer) {
    let direction = Direction::from_signs([0, -1, 0]).expect("canonical");
    for (rep, colour, y) in [(0, [200, 0, 0], 0.0), (1, [0, 200, 0], 0.0), (2, [0, 0, 200], -1.0)] {
        let plate = Plate { centre: DVec3::new(0.0, y, 0.0), axes: [DVec3::X, DVec3::Z], half: 4.0 };
        let mut image = orthoview(&plate, direction, DVec3::ZERO, 10.0, 64);
        for pixel in image.colours.chunks_exact_mut(4) {
            pixel[..3].copy_from_slice(&colour);
        }
        renderer.upload(RepId(rep), &Content::Splats(image)).expect("an orthoview");
    }
}

fn middle(picture: &Picture) -> [u8; 3] {
    let at = 4 * (60 * 160 + 80);
    [picture.rgba[at], picture.rgba[at + 1], picture.rgba[at + 2]]
}

#[test]
fn a_swap_fades_and_what_is_elsewhere_does_not() {
    let Some(gpu) = gpu() else {
        return;
    };
    let mut renderer = renderer(&gpu);
    plates(&mut renderer);
    let settings = FadeSettings { time_s: 0.1, ..FadeSettings::default() };
    let mut fade = Reprojection::new(&renderer, settings);
    let view = looking(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, SIZE);
    let first = fade.picture(&mut renderer, &view, &list([0]), 0.0).expect("a picture").0;
    assert_eq!(first, renderer.picture(&view, &list([0])).expect("a picture").0);
    // Blended in linear light: 1 − a of the green, with a = 1/e after τ.
    let linear = |code: f64| libm::pow((code / 255.0 + 0.055) / 1.055, 2.4);
    let coded = |light: f64| 255.0 * (1.055 * libm::pow(light, 1.0 / 2.4) - 0.055);
    let mut kept = 1.0;
    for _ in 0..3 {
        let after = middle(&fade.picture(&mut renderer, &view, &list([1]), 0.1).expect("a picture").0);
        kept *= libm::exp(-1.0);
        for (code, share) in [(after[0], kept), (after[1], 1.0 - kept)] {
            assert!((f64::from(code) - coded(share * linear(200.0))).abs() < 2.0, "{after:?} {share}");
        }
    }
    for _ in 0..12 {
        fade.picture(&mut renderer, &view, &list([1]), 0.1).expect("a picture");
    }
    assert_eq!(middle(&fade.picture(&mut renderer, &view, &list([1]), 0.1).expect("a picture").0), [0, 200, 0]);
    // A tenth nearer is another surface, and there is nothing to fade from.
    let nearer = fade.picture(&mut renderer, &view, &list([2]), 0.01).expect("a picture").0;
    assert_eq!(middle(&nearer), [0, 0, 200]);
    // After a long time, or none that is known, or when told so, nothing is left.
    for (elapsed, forget) in [(1e9, false), (f64::NAN, false), (-1.0, false), (0.0, true)] {
        fade.picture(&mut renderer, &view, &list([0]), 1e9).expect("a picture");
        if forget {
            fade.forget();
        }
        let picture = fade.picture(&mut renderer, &view, &list([1]), elapsed).expect("a picture").0;
        assert_eq!(middle(&picture), [0, 200, 0], "{elapsed}");
    }
}

#[test]
fn a_camera_that_moves_finds_what_it_saw_and_shows_what_it_uncovers() {
    let Some(gpu) = gpu() else {
        return;
    };
    let mut renderer = renderer(&gpu);
    plates(&mut renderer);
    let mut fade = Reprojection::new(&renderer, FadeSettings { time_s: 1e6, ..FadeSettings::default() });
    let mut last = None;
    // Half round the plate, which stays red: only what swaps may show, and nothing does.
    for step in 0..12 {
        let angle = 0.05 * f64::from(step);
        let from = DVec3::new(10.0 * libm::sin(angle), -10.0 * libm::cos(angle), 1.0);
        let view = looking(from, DVec3::ZERO, SIZE);
        let faded = fade.picture(&mut renderer, &view, &list([0]), 0.1).expect("a picture").0;
        let plain = renderer.picture(&view, &list([0])).expect("a picture").0;
        assert_eq!(faded.distance, plain.distance);
        // Away from the border, where pixels are of one surface, nothing differs however long the camera has moved.
        for at in 0..plain.distance.len() {
            let pixel = |picture: &Picture| [0, 1, 2].map(|i| picture.rgba[4 * at + i]);
            let same = pixel(&plain).iter().zip(pixel(&faded)).all(|(a, b)| a.abs_diff(b) <= 2);
            assert!(same || plain.is_sky(at), "step {step}, pixel {at}: {:?} {:?}", pixel(&plain), pixel(&faded));
        }
        last = Some(faded);
    }
    assert_eq!(last.map(|picture| middle(&picture)), Some([200, 0, 0]));
    // Another size, and no fading at all.
    let view = looking(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, [80, 60]);
    for time_s in [1e6, 0.0, f64::NAN] {
        fade.settings.time_s = time_s;
        let faded = fade.picture(&mut renderer, &view, &list([1]), 0.1).expect("a picture").0;
        assert_eq!(faded, renderer.picture(&view, &list([1])).expect("a picture").0);
    }
}
