//! What cannot be drawn says so.

use crate::scene::{Plate, gpu, list, looking, mesh, orthoview, renderer};
use foresight_index::orthoview::direction::nine;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::view::View;
use foresight_viewer::gpu::{Gpu, GpuError, GpuSettings};
use foresight_viewer::scene::content::{Content, Texels, TextureImage};
use glam::{DQuat, DVec3};
use std::sync::Arc;

fn plate() -> Plate {
    Plate { centre: DVec3::ZERO, axes: [DVec3::X, DVec3::Y], half: 2.0 }
}

fn view() -> View {
    looking(DVec3::new(0.0, 0.0, 9.0), DVec3::ZERO, [32, 24])
}

#[test]
fn without_an_adapter_the_error_says_what_to_install() {
    let error =
        Gpu::open(&GpuSettings { backends: wgpu::Backends::empty(), software: true }).expect_err("no interface");
    let text = error.to_string();
    assert!(matches!(error, GpuError::NoAdapter { .. }), "{text}");
    assert!(text.contains("no interface, in software") && text.contains("mesa-vulkan-drivers"), "{text}");
}

#[test]
fn pictures_of_no_pixels_or_too_many_are_refused() {
    let Some(gpu) = gpu() else { return };
    let mut renderer = renderer(&gpu);
    let most = gpu.device.limits().max_texture_dimension_2d;
    for size in [[0, 0], [0, 480], [640, 0], [most + 1, 8], [most, most], [u32::MAX; 2]] {
        let refused = renderer.picture(&View { viewport: size, ..view() }, &list([]));
        assert!(matches!(refused, Err(GpuError::Size(..))), "{size:?}: {refused:?}");
    }
    // As wide as it goes, and nothing else is wrong afterwards.
    let (picture, _) = renderer.picture(&View { viewport: [most, 1], ..view() }, &list([])).expect("a line");
    assert_eq!(picture.distance.len(), most as usize);
    renderer.settings().samples = 4;
    assert!(renderer.picture(&view(), &list([])).is_ok());
    let crooked = View { orientation: DQuat::from_xyzw(0.0, 0.0, 0.0, 2.0), ..view() };
    assert!(matches!(renderer.picture(&crooked, &list([])), Err(GpuError::View(_))));
}

#[test]
fn contents_too_large_or_at_odds_with_themselves_are_refused() {
    let Some(gpu) = gpu() else { return };
    let mut renderer = renderer(&gpu);
    let good = orthoview(&plate(), nine()[0], DVec3::ZERO, 8.0, 16);
    let mut wide = good.clone();
    wide.size = [gpu.device.limits().max_texture_dimension_2d + 1, 1];
    let mut cut = good.clone();
    cut.shapes.pop();
    let mut few_normals = good.clone();
    few_normals.normals.truncate(7);
    let mut beyond = mesh(&plate());
    beyond.indices[3] = 4;
    let mut no_part = mesh(&plate());
    no_part.parts[0].indices = 0..9;
    let mut no_texture = mesh(&plate());
    no_texture.parts[0].texture = Some(0);
    let mut cut_texture = mesh(&plate());
    cut_texture.textures.push(Arc::new(TextureImage { size: [4, 4], texels: vec![0; 63], kept: Texels::Plain }));
    let contents = [
        Content::Splats(wide),
        Content::Splats(cut),
        Content::Splats(few_normals),
        Content::Mesh(beyond),
        Content::Mesh(no_part),
        Content::Mesh(no_texture),
        Content::Mesh(cut_texture),
    ];
    for (rep, content) in (0..).zip(&contents) {
        let refused = renderer.upload(RepId(rep), content);
        assert!(matches!(refused, Err(GpuError::TooLarge { .. } | GpuError::Content { .. })), "{rep}: {refused:?}");
        assert!(!renderer.contains(RepId(rep)) && renderer.gpu_bytes() == 0);
    }
    // What is refused leaves nothing of what was there before; the rest goes on.
    let bytes = renderer.upload(RepId(0), &Content::Splats(good)).expect("an orthoview");
    assert_eq!((bytes, renderer.gpu_bytes()), (16 * 16 * 8, 16 * 16 * 8));
    renderer.upload(RepId(1), &Content::Empty).expect("nothing");
    let (_, counts) = renderer.picture(&view(), &list([0, 1, 2])).expect("a picture");
    assert!(counts.points > 0 && counts.draws > 0 && renderer.contains(RepId(1)));
    renderer.remove(RepId(0));
    assert!(!renderer.contains(RepId(0)) && renderer.gpu_bytes() == 0);
}

#[test]
fn a_lost_device_is_told_and_a_new_one_draws_again() {
    let Some(lost) = gpu() else { return };
    let mut gone = renderer(&lost);
    let content = Content::Splats(orthoview(&plate(), nine()[0], DVec3::ZERO, 8.0, 16));
    gone.upload(RepId(0), &content).expect("an orthoview");
    assert_eq!(lost.lost(), None);
    lost.device.destroy();
    // The loss is told with the next work that is handed over, at the latest.
    let refused = gone.picture(&view(), &list([0]));
    assert!(matches!(refused, Err(GpuError::Lost(_))), "{refused:?}");
    assert!(lost.lost().is_some());
    assert!(matches!(gone.upload(RepId(1), &content), Err(GpuError::Lost(_))));
    let Some(gpu) = gpu() else { return };
    let mut again = renderer(&gpu);
    again.upload(RepId(0), &content).expect("an orthoview");
    assert!(again.picture(&view(), &list([0])).expect("a picture").1.points > 0);
}
