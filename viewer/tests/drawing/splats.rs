//! Splats against closed forms.

use crate::scene::{Plate, gpu, list, looking, orthoview, renderer};
use foresight_index::orthoview::direction::nine;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::view::View;
use foresight_viewer::scene::content::Content;
use glam::DVec3;

/// The ray through the middle of a pixel, 1 long along the view.
fn ray(view: &View, column: u32, row: u32) -> DVec3 {
    let [width, height] = view.viewport.map(f64::from);
    let half = libm::tan(0.5 * view.fov_y);
    let x = (2.0 * (f64::from(column) + 0.5) / width - 1.0) * half * width / height;
    let y = (1.0 - 2.0 * (f64::from(row) + 0.5) / height) * half;
    view.orientation * DVec3::new(x, y, -1.0)
}

#[test]
fn a_plate_covers_its_pixels_without_holes_from_many_sides() {
    let Some(gpu) = gpu() else { return };
    let mut renderer = renderer(&gpu);
    let mut checked = 0;
    for (k, direction) in nine().into_iter().enumerate() {
        // Tilted by 0°, 30° and 55° against the image's plane, about an axis within it.
        for tilt in [0.0, 30.0, 55.0f64] {
            let [right, up] = direction.image_axes();
            let about = (right + 0.37 * k as f64 * up).normalize();
            let turn = glam::DQuat::from_axis_angle(about, tilt.to_radians());
            let plate = Plate { centre: DVec3::new(50.0, 20.0, 30.0), axes: [turn * right, turn * up], half: 5.0 };
            let image = orthoview(&plate, direction, plate.centre, 16.0, 128);
            let pixel = image.pixel;
            renderer.upload(RepId(0), &Content::Splats(image)).expect("an orthoview");
            for (angle, around) in [(0.0, 0.0), (25.0, 1.0), (25.0, 4.0), (50.0, 2.0), (65.0, 5.5f64)] {
                let side = plate.normal().any_orthonormal_vector();
                let side = glam::DQuat::from_axis_angle(plate.normal(), around) * side;
                let away = glam::DQuat::from_axis_angle(side, f64::to_radians(angle)) * plate.normal();
                let view = looking(plate.centre + 40.0 * away, plate.centre, [160, 120]);
                let (picture, counts) = renderer.picture(&view, &list([0])).expect("a picture");
                assert!(counts.points > 500 && counts.draws == 1);
                for index in 0..picture.distance.len() {
                    let (column, row) = (index as u32 % 160, index as u32 / 160);
                    let along = ray(&view, column, row);
                    let found = picture.distance[index];
                    // A pixel of the orthoview inside of the border there are no holes, and one outside of it nothing,
                    // both measured in the plate, where the tilt makes pixels longer.
                    let margin = 1.5 * pixel / libm::cos(tilt.to_radians());
                    if let Some(distance) = plate.hit(view.position, along, margin) {
                        let context =
                            format!("{} tilted {tilt}°, seen at {angle}°, pixel {column}, {row}", direction.name());
                        assert!(found.is_finite(), "a hole: {context}");
                        assert!((f64::from(found) - distance).abs() < 0.1, "{found} m for {distance}: {context}");
                        assert_eq!(picture.rgba[4 * index..4 * index + 4], [200, 100, 50, 255]);
                        checked += 1;
                    } else if plate.hit(view.position, along, -margin).is_none() {
                        assert!(found.is_infinite(), "beyond the plate");
                        assert_eq!(picture.rgba[4 * index..4 * index + 4], [0, 0, 255, 255]);
                    }
                }
            }
        }
    }
    assert!(checked > 50_000, "{checked}");
}
