//! Whatever is left out of the list is shown by every map, whatever was resident when that was made.

use super::*;
use foresight_scheduler::lod_tree::{LodTreeBuilder, Representation};
use glam::DQuat;
use proptest::prelude::*;

const DEPTH: usize = 2;

/// A cube of 64 m around the origin, halved along each axis twice; a node owns triangles and an orthoview from above.
fn octree() -> LodTree {
    fn node(builder: &mut LodTreeBuilder, bounds: Aabb, left: usize) {
        builder.open().expect("one root");
        let error = ((bounds.max - bounds.min).x / 32.0) as f32;
        for direction in [None, Some(22)] {
            let rep = Representation { wire_bytes: 1, decoded_bytes: 1, error, prerequisite: None, direction };
            builder.add(rep).expect("a representation");
        }
        for child in (0..8).filter(|_| left > 0) {
            let half = 0.5 * (bounds.max - bounds.min);
            let bit = |axis: usize| f64::from(child >> axis & 1);
            let min = bounds.min + half * DVec3::new(bit(0), bit(1), bit(2));
            node(builder, Aabb { min, max: min + half }, left - 1);
        }
        builder.close(Some(bounds), 1.0).expect("a box");
    }
    let mut builder = LodTreeBuilder::default();
    node(&mut builder, Aabb { min: DVec3::splat(-32.0), max: DVec3::splat(32.0) }, DEPTH);
    builder.finish().expect("a tree")
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn every_item_is_drawn_by_itself_or_shown_by_all_maps(
        then in prop::collection::vec(0..3u8, 146),
        now in prop::collection::vec(0..3u8, 146),
        at in prop::array::uniform3(-30.0..30.0f64),
        yaw in 0.0..6.3f64,
        side in 0.5..4.0f64,
        multiple in 2.0..5.0f64,
    ) {
        let tree = octree();
        prop_assert_eq!(tree.representations(), 146);
        let of = |bits: &[u8]| -> BTreeSet<RepId> {
            (0..146u32).filter(|&rep| bits[rep as usize] > 0).map(RepId).collect()
        };
        let (then, now) = (Arc::new(of(&then)), of(&now));
        let settings = EnvironmentSettings { multiple, ..EnvironmentSettings::with_side(side) };
        let position = DVec3::from_array(at);
        let cell = Cell::around(position, side).expect("a cell");
        let view = View { position, orientation: DQuat::from_rotation_y(yaw), fov_y: 1.5, viewport: [64, 64] };
        let mut list = DrawList::default();
        choose_in(&tree, None, &now, &view, &ChooseSettings::default(), &mut list);
        let maps = cell.vertices().map(|vertex| {
            let faces = (0..6).flat_map(|face| {
                let mut list = DrawList::default();
                let view = face_view(vertex, face, &settings, 64);
                choose_in(&tree, None, &then, &view, &ChooseSettings::default(), &mut list);
                list.items
            });
            (vertex, faces.collect::<Vec<Item>>())
        });
        for item in list.items.iter().filter(|item| is_in_maps(&tree, cell, &settings, &[&then], item)) {
            let bounds = tree.bounds(tree.node_of(item.rep));
            for corner in 0..9 {
                // Not the middle itself, where boxes beneath only touch.
                let share = |axis: usize| if corner == 8 { 0.47 } else { 0.01 + 0.98 * f64::from(corner >> axis & 1) };
                let point = bounds.min + (bounds.max - bounds.min) * DVec3::new(share(0), share(1), share(2));
                for (vertex, items) in &maps {
                    let cube = cube(*vertex, &settings);
                    prop_assert!(point.cmplt(cube.min).any() || point.cmpgt(cube.max).any(), "{point} is near {vertex:?}");
                    let holds = |bounds: &Aabb| point.cmpgt(bounds.min).all() && point.cmplt(bounds.max).all();
                    let shows = |item: &Item| {
                        holds(&tree.bounds(tree.node_of(item.rep))) && !item.hidden.iter().any(holds)
                    };
                    prop_assert!(items.iter().any(shows), "{point} of {item:?} is not in the map at {vertex:?}");
                }
            }
        }
    }
}
