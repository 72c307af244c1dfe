//! What holds for splats and triangles alike: boxes that are left out, samples, light, distance from the origin.

use crate::scene::{Plate, gpu, list, looking, mesh, orthoview, ray, renderer};
use foresight_index::orthoview::direction::nine;
use foresight_scheduler::lod_tree::{Aabb, RepId};
use foresight_scheduler::view::View;
use foresight_viewer::gpu::{Background, Light, RenderSettings, Renderer};
use foresight_viewer::scene::content::Content;
use glam::{DQuat, DVec3};

/// A plate, it as splats and as triangles, and a camera before it.
fn plate(at: DVec3) -> (Plate, [Content; 2], View) {
    let turn = DQuat::from_rotation_x(0.4) * DQuat::from_rotation_y(0.2);
    let plate = Plate { centre: at, axes: [turn * DVec3::X, turn * DVec3::Y], half: 5.0 };
    let splats = orthoview(&plate, nine()[0], at, 16.0, 256);
    let view = looking(at + DVec3::new(3.0, -6.0, 12.0), at, [160, 120]);
    (plate, [Content::Splats(splats), Content::Mesh(mesh(&plate))], view)
}

#[test]
fn what_lies_in_a_hidden_box_is_left_out_and_nothing_else() {
    let Some(gpu) = gpu() else { return };
    let mut renderer = renderer(&gpu);
    let (plate, contents, view) = plate(DVec3::new(1.0, 2.0, 3.0));
    let boxes = [
        Aabb { min: plate.centre + DVec3::new(0.5, -9.0, -9.0), max: plate.centre + DVec3::new(9.0, 1.0, 9.0) },
        Aabb { min: plate.centre + DVec3::new(-4.0, 1.5, -9.0), max: plate.centre + DVec3::new(-2.0, 9.0, 9.0) },
    ];
    for content in &contents {
        renderer.upload(RepId(0), content).expect("a content");
        let mut drawn = list([0]);
        let (whole, _) = renderer.picture(&view, &drawn).expect("a picture");
        drawn.items[0].hidden = boxes.to_vec();
        let (cut, _) = renderer.picture(&view, &drawn).expect("a picture");
        let (mut gone, mut kept) = (0, 0);
        for index in 0..whole.distance.len() {
            let along = ray(&view, index as u32 % 160, index as u32 / 160);
            let Some(distance) = plate.hit(view.position, along, 0.2) else { continue };
            let at = view.position + distance * along;
            let within =
                |margin: f64| boxes.iter().any(|b| at.cmpgt(b.min + margin).all() && at.cmplt(b.max - margin).all());
            // 5 cm: what the depth of a splat is off by.
            if within(0.05) {
                assert!(cut.distance[index].is_infinite());
                gone += 1;
            } else if !within(-0.05) {
                assert_eq!(cut.distance[index], whole.distance[index]);
                kept += 1;
            }
        }
        assert!(gone > 1000 && kept > 1000, "{gone} {kept}");
    }
}

#[test]
fn a_planet_away_the_picture_is_the_same() {
    let Some(gpu) = gpu() else { return };
    let mut renderer = renderer(&gpu);
    let mut pictures = Vec::new();
    for at in [DVec3::ZERO, DVec3::new(6.4e6, -3.2e6, 1.6e6)] {
        let (_, contents, view) = plate(at);
        renderer.upload(RepId(0), &contents[0]).expect("splats");
        renderer.upload(RepId(1), &contents[1]).expect("triangles");
        for reps in [[0u32], [1]] {
            pictures.push(renderer.picture(&view, &list(reps)).expect("a picture").0);
        }
    }
    for (near, far) in [(&pictures[0], &pictures[2]), (&pictures[1], &pictures[3])] {
        let differ = near.rgba.iter().zip(&far.rgba).filter(|(a, b)| a.abs_diff(**b) > 1).count();
        assert!(differ * 1000 <= near.rgba.len(), "{differ} of {}", near.rgba.len());
    }
}

#[test]
fn four_samples_soften_edges_by_what_is_covered() {
    let Some(gpu) = gpu() else { return };
    let mut renderer = renderer(&gpu);
    let (plate, contents, view) = plate(DVec3::ZERO);
    // In linear light white over black: the mean is the covered share of the pixels.
    renderer.settings().background = Background::Plain([0; 3]);
    let share = |rgba: &[u8]| {
        let light = rgba.as_chunks::<4>().0.iter().map(|p| foresight_index::orthoview::texture::linear(p[0]));
        light.map(f64::from).sum::<f64>()
    };
    // Of 16 × 16 rays a pixel.
    let fine = View { viewport: view.viewport.map(|side| 16 * side), ..view };
    let mut hits = 0u32;
    for row in 0..fine.viewport[1] {
        for column in 0..fine.viewport[0] {
            hits += u32::from(plate.hit(fine.position, ray(&fine, column, row), 0.0).is_some());
        }
    }
    let covered = f64::from(hits) / 256.0;
    renderer.upload(RepId(0), &contents[0]).expect("splats");
    renderer.upload(RepId(1), &contents[1]).expect("triangles");
    let mut softened = |rep, samples| {
        renderer.settings().samples = samples;
        let (picture, _) = renderer.picture(&view, &list([rep])).expect("a picture");
        let full = picture.rgba.as_chunks::<4>().0.iter().map(|p| p[0]).max().expect("pixels");
        let between = picture.rgba.as_chunks::<4>().0.iter().filter(|p| p[0] > 0 && p[0] < full).count();
        (between, picture)
    };
    let (between, picture) = softened(1, 1);
    assert_eq!(between, 0);
    assert!((share(&picture.rgba) / covered - 1.0).abs() < 0.02);
    let (between, picture) = softened(1, 4);
    assert!(between > 100, "{between}");
    assert!((share(&picture.rgba) / covered - 1.0).abs() < 0.005, "{} {covered}", share(&picture.rgba));
    // The distance of an edge is that of what covers any of it.
    assert!(picture.rgba.as_chunks::<4>().0.iter().zip(&picture.distance).all(|(p, d)| (p[0] > 0) == d.is_finite()));
    let (hard, _) = softened(0, 1);
    let (soft, _) = softened(0, 4);
    assert!(hard == 0 && soft > 100, "{hard} {soft}");
}

#[test]
fn light_tint_and_the_targets_format_do_what_they_say() {
    let Some(gpu) = gpu() else { return };
    let mut renderer = renderer(&gpu);
    let (plate, contents, view) = plate(DVec3::ZERO);
    for (rep, content) in (0..).zip(&contents) {
        renderer.upload(RepId(rep), content).expect("a content");
    }
    let middle = |picture: &foresight_viewer::gpu::Picture| {
        let at = 4 * (60 * 160 + 80);
        [picture.rgba[at], picture.rgba[at + 1], picture.rgba[at + 2]]
    };
    let sun = DVec3::new(0.3, -0.5, 0.8).normalize();
    let ambient = 0.25;
    let own = [[200, 100, 50], [255; 3]];
    for rep in 0..2u32 {
        renderer.settings().light = Light::Unlit;
        let unlit = renderer.picture(&view, &list([rep])).expect("a picture").0;
        assert_eq!(middle(&unlit), own[rep as usize]);
        renderer.settings().light = Light::Sun { towards: sun, ambient };
        let lit = renderer.picture(&view, &list([rep])).expect("a picture").0;
        let factor = f64::from(ambient) + (1.0 - f64::from(ambient)) * plate.normal().dot(sun).max(0.0);
        for (found, own) in middle(&lit).into_iter().zip(own[rep as usize]) {
            let light = factor as f32 * foresight_index::orthoview::texture::linear(own);
            let expected = foresight_index::orthoview::texture::encoded(light);
            assert!(found.abs_diff(expected) <= 2, "{found} for {expected}");
        }
        renderer.settings().light = Light::Unlit;
        let mut tinted = list([rep]);
        tinted.items[0].false_colour = Some([0, 255, 0]);
        let [red, green, blue] = middle(&renderer.picture(&view, &tinted).expect("a picture").0);
        assert!(red == 0 && blue == 0 && green > 100, "{red} {green} {blue}");
    }
    let settings = RenderSettings { background: Background::default(), ..RenderSettings::default() };
    let mut pictures = [wgpu::TextureFormat::Rgba8UnormSrgb, wgpu::TextureFormat::Rgba8Unorm].map(|format| {
        let mut renderer = Renderer::new(&gpu, settings, format);
        renderer.upload(RepId(0), &contents[0]).expect("splats");
        let level = looking(plate.centre + DVec3::new(0.0, -30.0, 4.0), plate.centre + 4.0 * DVec3::Z, [160, 120]);
        renderer.picture(&level, &list([0])).expect("a picture").0.rgba
    });
    let differ = pictures[0].iter().zip(&pictures[1]).filter(|(a, b)| a.abs_diff(**b) > 1).count();
    assert_eq!(differ, 0);
    // The sky has a gradient.
    let column: Vec<_> = pictures[0].as_chunks_mut::<4>().0.iter().step_by(160).map(|p| p[2]).collect();
    assert!(column.iter().any(|&blue| blue != column[0]));
}
