//! Leaves part what they share.

use super::super::clip::{Region, Whole};
use super::*;
use proptest::prelude::*;
use std::collections::BTreeSet;

fn bits(at: DVec3) -> [u64; 3] {
    at.to_array().map(f64::to_bits)
}

fn area(polygon: &[DVec3]) -> f64 {
    (1..polygon.len().saturating_sub(1))
        .map(|i| 0.5 * (polygon[i] - polygon[0]).cross(polygon[i + 1] - polygon[0]).length())
        .sum()
}

proptest! {
    #[test]
    fn pieces_in_all_leaves_are_the_triangle_and_borders_agree_to_the_bit(
        corners in prop::array::uniform3(prop::array::uniform3(-1.0..25.0f64)), far in 0.0..1e6f64,
    ) {
        let shift = DVec3::new(far, -far, 0.5 * far);
        let octree = Octree::over(Aabb { min: shift, max: shift + 24.0 }, 6.0).expect("a box");
        // Within the grid, where every point has a leaf.
        let corners = corners.map(|c| shift + DVec3::from_array(c).clamp(DVec3::ZERO, DVec3::splat(24.0)));
        let uv = [DVec2::ZERO, DVec2::X, DVec2::Y];
        let mut sum = 0.0;
        let mut faces: std::collections::BTreeMap<(usize, u64), Vec<BTreeSet<[u64; 3]>>> = Default::default();
        for place in (0..64u64).map(|i| [i % 4, i / 4 % 4, i / 16]) {
            let region = Region::of(&octree, Cell { level: 0, place });
            let mut polygon = Vec::new();
            region.clip(&Whole { corners, uv, tint: [DVec3::ONE; 3] }, &mut polygon);
            let at: Vec<DVec3> = polygon.iter().map(|c| c.at).collect();
            sum += area(&at);
            for (axis, &along) in place.iter().enumerate() {
                for (face, value) in [(along, region.bounds.min[axis]), (along + 1, region.bounds.max[axis])] {
                    let there: BTreeSet<_> = at.iter().filter(|p| p[axis] == value).map(|&p| bits(p)).collect();
                    if (1..4).contains(&face) && there.len() > 1 {
                        faces.entry((axis, face)).or_default().push(there);
                    }
                }
            }
        }
        let whole = area(&corners);
        prop_assert!((sum - whole).abs() <= 1e-9 * (1.0 + whole) * (1.0 + far * 1e-5), "{sum} for {whole}");
        // On a face that leaves share, each point of one side's cut is one of the other's.
        for (face, cuts) in faces {
            let mut times = std::collections::BTreeMap::new();
            for point in cuts.iter().flatten() {
                *times.entry(*point).or_insert(0) += 1;
            }
            prop_assert!(times.values().all(|&n| n >= 2), "{face:?}: {cuts:?}");
        }
    }
}

#[test]
fn what_lies_in_a_shared_face_belongs_to_one_leaf() {
    let octree = octree();
    let wall = |x: f64| [DVec3::new(x, 51.0, 0.0), DVec3::new(x, 57.0, 0.0), DVec3::new(x, 52.0, 3.0)];
    let shown = |x: f64, place: u64| {
        let mut polygon = Vec::new();
        Region::of(&octree, cell(place))
            .clip(&Whole { corners: wall(x), uv: [DVec2::ZERO; 3], tint: [DVec3::ONE; 3] }, &mut polygon);
        polygon.len()
    };
    assert_eq!((shown(108.0, 0), shown(108.0, 1)), (0, 3));
    // Where the grid ends, there is nobody else.
    assert_eq!((shown(116.0, 1), shown(100.0, 0)), (3, 3));
    assert_eq!(shown(116.0_f64.next_up(), 1), 3);
}

/// Whether a point lies in the face between the two leaves.
fn between(at: DVec3) -> bool {
    (at.x - 108.0).abs() < 1e-9
}

#[test]
fn no_level_leaves_a_crack_to_any_of_its_neighbour() {
    let content = hills(140, 1.0);
    let sides = [0, 1].map(|place| made(&content, &painted(), place));
    assert!(sides.iter().all(|levels| levels.len() >= 3), "{:?}", sides.each_ref().map(Vec::len));
    let key = |at: DVec3| [(at.y * 1e7).round() as i64, (at.z * 1e7).round() as i64];
    // The ends of the surface in the face: sides of an odd number of triangles.
    let edges = |level: &GeometryLevel| -> BTreeSet<[[i64; 2]; 2]> {
        let mut odd = BTreeSet::new();
        for [a, b, c] in triangles(&level.glb) {
            for side in [[a, b], [b, c], [c, a]].into_iter().filter(|[a, b]| between(*a) && between(*b)) {
                let mut ends = side.map(key);
                ends.sort_unstable();
                if !odd.remove(&ends) {
                    odd.insert(ends);
                }
            }
        }
        odd
    };
    let line = edges(&sides[0][0]);
    assert!(line.len() >= 60, "{}", line.len());
    for level in sides.iter().flatten() {
        assert_eq!(edges(level), line, "a level of {} triangles", level.triangles);
    }
}
