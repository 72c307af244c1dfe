//! Cells, vertices, and what is far.

use super::*;
use proptest::prelude::*;

fn new_maps(from: DVec3, to: DVec3) -> usize {
    let before = Cell::around(from, 10.0).expect("a cell");
    let after = Cell::follow(Some(before), to, 10.0).expect("a cell");
    missing(after, &before.vertices().into_iter().collect(), to, 10.0).len()
}

#[test]
fn four_maps_are_new_beyond_a_face_six_beyond_an_edge_seven_beyond_a_corner() {
    let from = DVec3::splat(5.0);
    let beyond = |x: f64, y: f64, z: f64| new_maps(from, from + DVec3::new(x, y, z));
    assert_eq!(beyond(0.0, 4.0, -3.0), 0);
    assert_eq!([beyond(10.0, 0.0, 0.0), beyond(0.0, -10.0, 0.0), beyond(0.0, 0.0, 10.0)], [4; 3]);
    assert_eq!([beyond(10.0, 10.0, 0.0), beyond(0.0, -10.0, 10.0)], [6; 2]);
    assert_eq!(beyond(-10.0, 10.0, -10.0), 7);
    assert_eq!(beyond(30.0, 0.0, 0.0), 8);
}

#[test]
fn standing_on_a_border_changes_nothing_and_walking_through_it_changes_once() {
    let mut cell = Cell::around(DVec3::new(9.9, 0.0, 0.0), 10.0);
    let mut changes = 0;
    for step in 0..1000 {
        let x = 10.0 + 0.9 * libm::sin(f64::from(step));
        let next = Cell::follow(cell, DVec3::new(x, 0.2 * x - 2.0, 0.0), 10.0);
        changes += usize::from(next != cell);
        cell = next;
    }
    assert_eq!(changes, 0);
    for step in 0..400 {
        let next = Cell::follow(cell, DVec3::new(9.0 + 0.01 * f64::from(step), 0.0, 0.0), 10.0);
        changes += usize::from(next != cell);
        cell = next;
    }
    assert_eq!((changes, cell), (1, Some(Cell([1, 0, 0]))));
}

#[test]
fn there_is_a_grid_on_a_planet_and_none_where_neighbours_are_one() {
    let planet = DVec3::new(6.4e6, -6.4e6, 6.4e6);
    for side in [1e-3, 1.0, 1e9] {
        let cell = Cell::around(planet, side).expect("a cell");
        assert!(cell.holds(planet, side, 1e-6), "{side}");
        let far = place(cell.vertices()[7], side) - place(cell.0, side);
        assert!((far - side).abs().max_element() < 1e-8 * side.max(1.0), "{side}: {far}");
    }
    assert_eq!(Cell::around(DVec3::splat(1e20), 1.0), None);
    assert_eq!(Cell::around(DVec3::splat(f64::NAN), 1.0), None);
    assert_eq!(Cell::around(DVec3::X, 0.0).map(|cell| cell.0[0]), None);
}

#[test]
fn settings_are_checked_and_made_for_any_world() {
    let bounds = |half: f64| Aabb { min: DVec3::splat(-half), max: DVec3::splat(half) };
    assert_eq!(EnvironmentSettings::for_world(&bounds(600.0)).distance(), 150.0);
    for half in [0.0, 1e-30, 1e30, f64::INFINITY, f64::NAN] {
        EnvironmentSettings::for_world(&bounds(half)).check().expect("settings");
    }
    EnvironmentSettings::for_world(&Aabb::EMPTY).check().expect("settings");
    for side in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e10] {
        let error = EnvironmentSettings::with_side(side).check().expect_err("a side");
        assert_eq!(error.to_string(), format!("side is {side}; expected 0.001 to 1e9 metres"));
    }
    assert_eq!([0.0, 110.0, 415.7, 512.0, 513.0, 1e9].map(face_side), [64, 256, 1024, 1024, 1536, 2048]);
    assert_eq!(face_side(f64::NAN), 2048);
}

proptest! {
    /// The viewpoint is a convex combination of the four, with the gaps between its sorted coordinates as weights.
    #[test]
    fn the_tetrahedron_holds_the_viewpoint(point in prop::array::uniform3(-1e4..1e4f64), side in 0.01..1e3f64) {
        let point = DVec3::from_array(point);
        let cell = Cell::around(point, side).expect("a cell");
        let vertices = cell.tetrahedron(point, side);
        prop_assert!(vertices.iter().all(|vertex| cell.vertices().contains(vertex)));
        prop_assert_eq!(vertices[0], cell.base());
        prop_assert!(cell.base().iter().all(|step| step % 2 == 0));
        let mut within = (point / side - place(cell.base(), 1.0)).abs().to_array();
        within.sort_by(|a, b| b.total_cmp(a));
        let weights = [1.0 - within[0], within[0] - within[1], within[1] - within[2], within[2]];
        prop_assert!(weights.iter().all(|&weight| weight >= -1e-9));
        let sum: DVec3 = vertices.iter().zip(weights).map(|(&vertex, weight)| place(vertex, side) * weight).sum();
        prop_assert!((sum - point).length() < 1e-6 * (1.0 + point.length()), "{sum} {point}");
    }

    /// What is far for a cell is outside the cube of each of its eight maps.
    #[test]
    fn what_is_far_is_in_all_eight_maps(
        point in prop::array::uniform3(-100.0..100.0f64),
        min in prop::array::uniform3(-300.0..300.0f64),
        size in prop::array::uniform3(0.0..200.0f64),
        side in 0.1..50.0f64,
        multiple in 2.0..10.0f64,
    ) {
        let min = DVec3::from_array(min);
        let bounds = Aabb { min, max: min + DVec3::from_array(size) };
        let cell = Cell::around(DVec3::from_array(point), side).expect("a cell");
        let is_in = |vertex: Vertex| {
            let cube = (place(vertex, side) - multiple * side, place(vertex, side) + multiple * side);
            bounds.min.cmpgt(cube.1).any() || bounds.max.cmplt(cube.0).any()
        };
        if cell.is_far(&bounds, side, multiple * side) {
            prop_assert!(cell.vertices().into_iter().all(is_in));
        } else {
            // One that is not has something near in one of them, or reaches around a corner.
            let grown = Aabb { min: place(cell.0, side) - multiple * side, max: place(cell.0, side) + (1.0 + multiple) * side };
            prop_assert!(bounds.min.cmple(grown.max).all() && bounds.max.cmpge(grown.min).all());
        }
    }
}
