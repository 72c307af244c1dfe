//! The few orientations that surfaces are sorted into, and which of them an orthoview shows (\[HIBR\] §4.1).
//!
//! An element s stands for all of a leaf's surface whose outer normal is nearest to n_s: the six faces of a cube and its
//! eight corners, at most 36.3° off. An orthoview taken from the unit direction u (from the node towards the eye) shows s
//! if n_s·u > [`SHOWN_MIN`], at the error g_r / (n_s·u): a pixel of side g covers that much of an oblique surface.

use glam::DVec3;

/// How many elements there are.
pub const ELEMENTS: usize = 14;

/// Least cosine between an element's normal and the direction of an orthoview that shows it (72.5°).
pub const SHOWN_MIN: f64 = 0.3;

const CORNER: f64 = 0.577_350_269_189_625_8;

const NORMALS: [DVec3; ELEMENTS] = [
    DVec3::NEG_X,
    DVec3::X,
    DVec3::NEG_Y,
    DVec3::Y,
    DVec3::NEG_Z,
    DVec3::Z,
    DVec3::new(-CORNER, -CORNER, -CORNER),
    DVec3::new(-CORNER, -CORNER, CORNER),
    DVec3::new(-CORNER, CORNER, -CORNER),
    DVec3::new(-CORNER, CORNER, CORNER),
    DVec3::new(CORNER, -CORNER, -CORNER),
    DVec3::new(CORNER, -CORNER, CORNER),
    DVec3::new(CORNER, CORNER, -CORNER),
    DVec3::new(CORNER, CORNER, CORNER),
];

/// The outer unit normals n_s: −x, +x, −y, +y, −z, +z, then the corners by the signs of x, y, z.
pub fn normals() -> [DVec3; ELEMENTS] {
    NORMALS
}

/// The element whose normal is nearest to `normal`, of any length; the first of equals, and 0 for what has no direction.
pub fn nearest(normal: DVec3) -> usize {
    let mut best = (f64::NEG_INFINITY, 0);
    for (s, n) in NORMALS.iter().enumerate() {
        let along = n.dot(normal);
        if along > best.0 {
            best = (along, s);
        }
    }
    best.1
}

/// Unit vector from the node towards the eye for a direction's code `9·(x+1) + 3·(y+1) + (z+1)`; zero for 13.
pub fn towards_eye(code: u8) -> DVec3 {
    let sign = |digit: u8| f64::from(digit) - 1.0;
    DVec3::new(sign(code / 9), sign(code / 3 % 3), sign(code % 3)).normalize_or_zero()
}
