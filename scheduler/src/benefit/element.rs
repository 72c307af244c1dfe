//! The few orientations that surfaces are sorted into, which of them an orthoview shows, and which of them an eye sees
//! (\[HIBR\] §4.1).
//!
//! An element s stands for all of a leaf's surface whose outer normal is nearest to n_s: the six faces of a cube and its
//! eight corners, at most 36.3° off. An orthoview taken from the unit direction u (from the node towards the eye) shows s
//! if n_s·u > [`SHOWN_MIN`], at the error g_r / (n_s·u): a pixel of side g covers that much of an oblique surface. What
//! stands behind something else in it is off by more: where a world tells so, the error is g_r times a [`Shown`] of its own.
//!
//! A view weighs the elements of a node by its surface S_s ([`LodTree::surface`]) times how high the eye is above it,
//! m_s = max(0, h_s − n_s·c + reach): c is the middle of the node's box from the eye, h_s = Σ |n_s|·half, so that what
//! some point of the box could show counts, and reach what the eye may move. Their shares sum to 1; a node none of whose
//! surface faces the eye weighs nothing. Measures depend on the view only, so that
//!
//! ```text
//! q = Σ_s share_s · max { a_r : r ∈ R shows s }
//! ```
//!
//! stays monotone and submodular in R.

use super::accuracy::accuracy;
use crate::lod_tree::{LodTree, NodeId, RepId};
use glam::DVec3;
use std::sync::LazyLock;

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

/// 1/(n_s·u) by the direction's code; ∞ where it does not show s.
static STRETCH: LazyLock<[[f32; ELEMENTS]; 27]> = LazyLock::new(|| {
    core::array::from_fn(|code| {
        let u = towards_eye(code as u8);
        NORMALS.map(|n| {
            let cosine = n.dot(u);
            if cosine > SHOWN_MIN { (1.0 / cosine.min(1.0)) as f32 } else { f32::INFINITY }
        })
    })
});

/// How much larger than g_r the error is with which a representation shows each element: code k stands for 2^(k/16), and
/// [`HIDDEN`] for an element that it does not show.
pub type Shown = [u8; ELEMENTS];

/// The code of what is not shown.
pub const HIDDEN: u8 = u8::MAX;

/// Codes to a doubling.
const CODES: f64 = 16.0;

/// 2^(k/16); ∞ for [`HIDDEN`].
static SCALES: LazyLock<[f32; 256]> = LazyLock::new(|| {
    core::array::from_fn(|code| {
        if code == usize::from(HIDDEN) { f32::INFINITY } else { libm::exp2(code as f64 / CODES) as f32 }
    })
});

/// The code of a factor ≥ 1, rounded upwards; [`HIDDEN`] for what is beyond all others or no number.
pub fn shown_code(factor: f64) -> u8 {
    // What a conversion there and back has added is no reason to take the next.
    let code = libm::ceil(CODES * libm::log2(factor.max(1.0)) - 1e-6);
    if code < f64::from(HIDDEN) && !factor.is_nan() { code.max(0.0) as u8 } else { HIDDEN }
}

/// What an orthoview from a direction's code shows if nothing in it hides anything; `None` for a mesh, which shows all.
pub fn unhidden(direction: Option<u8>) -> Shown {
    direction.map_or([0; ELEMENTS], |code| STRETCH[usize::from(code)].map(|by| shown_code(f64::from(by))))
}

/// An error by element, metres; ∞ for what is not shown.
pub type Errors = [f32; ELEMENTS];

/// Nothing is shown.
pub const NOTHING: Errors = [f32::INFINITY; ELEMENTS];

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

/// With which error a representation shows each element.
pub fn errors(tree: &LodTree, rep: RepId) -> Errors {
    let error = tree.error(rep) as f32;
    if let Some(shown) = tree.shown(rep) {
        // No error at all times not shown would be no number.
        return shown.map(|code| if code == HIDDEN { f32::INFINITY } else { error * SCALES[usize::from(code)] });
    }
    match tree.direction(rep) {
        None => [error; ELEMENTS],
        Some(code) => STRETCH[usize::from(code)].map(|by| if by < f32::INFINITY { error * by } else { by }),
    }
}

/// The lesser error of each element.
pub fn least(a: &Errors, b: &Errors) -> Errors {
    core::array::from_fn(|s| a[s].min(b[s]))
}

/// Whether `errors` shows some element better than `others`.
pub fn improves(errors: &Errors, others: &Errors) -> bool {
    errors.iter().zip(others).any(|(error, other)| error < other)
}

/// m_s, metres, for a box with its middle at `centre` from an eye that may move by `reach`.
#[inline]
pub fn facing(centre: DVec3, half: DVec3, reach: f64) -> [f64; ELEMENTS] {
    let (near, far) = (half - centre + reach, half + centre + reach);
    let (x, y, z) = (CORNER * centre.x, CORNER * centre.y, CORNER * centre.z);
    let h = CORNER * half.element_sum() + reach;
    // In the order of the normals.
    let mut heights = [
        far.x,
        near.x,
        far.y,
        near.y,
        far.z,
        near.z,
        h + x + y + z,
        h + x + y - z,
        h + x - y + z,
        h + x - y - z,
        h - x + y + z,
        h - x + y - z,
        h - x - y + z,
        h - x - y - z,
    ];
    for height in &mut heights {
        *height = height.max(0.0);
    }
    heights
}

/// Σ S_s·m_s, m³.
pub fn projected(surface: &[f64; ELEMENTS], facing: &[f64; ELEMENTS]) -> f64 {
    let mut sum = 0.0;
    for s in 0..ELEMENTS {
        sum += surface[s] * facing[s];
    }
    sum
}

/// Whether some of a node's surface faces the eye.
pub fn faces(tree: &LodTree, node: NodeId, centre: DVec3, half: DVec3, reach: f64) -> bool {
    projected(&tree.surface(node), &facing(centre, half, reach)) > 0.0
}

/// Share of each element in the weight of a node; they sum to 1, or to 0 where nothing faces the eye.
pub fn shares(tree: &LodTree, node: NodeId, centre: DVec3, half: DVec3, reach: f64) -> [f64; ELEMENTS] {
    let surface = tree.surface(node);
    let mut shares = facing(centre, half, reach);
    let whole = projected(&surface, &shares);
    let scale = if whole > 0.0 { 1.0 / whole } else { 0.0 };
    for s in 0..ELEMENTS {
        shares[s] *= surface[s] * scale;
    }
    shares
}

/// Σ share_s·a(error_s).
pub fn mean_accuracy(shares: &[f64; ELEMENTS], errors: &Errors, sharpness: f64) -> f64 {
    let of =
        |(share, error): (&f64, &f32)| if *share > 0.0 { share * accuracy(f64::from(*error), sharpness) } else { 0.0 };
    shares.iter().zip(errors).map(of).sum()
}

/// Σ share_s·(1 − a(error_s)): 0 too where nothing faces the eye.
pub fn mean_deficit(shares: &[f64; ELEMENTS], errors: &Errors, sharpness: f64) -> f64 {
    let of = |(share, error): (&f64, &f32)| share * (1.0 - accuracy(f64::from(*error), sharpness));
    shares.iter().zip(errors).map(of).sum()
}

/// Σ share_s·(a(error_s) − a(other_s)) over the elements that it shows better.
pub fn mean_gain(shares: &[f64; ELEMENTS], errors: &Errors, others: &Errors, sharpness: f64) -> f64 {
    let mut sum = 0.0;
    for s in 0..ELEMENTS {
        if shares[s] > 0.0 && errors[s] < others[s] {
            sum += shares[s] * (accuracy(f64::from(errors[s]), sharpness) - accuracy(f64::from(others[s]), sharpness));
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_normal_is_its_own_element_and_no_surface_is_far_from_one() {
        assert!(NORMALS.iter().enumerate().all(|(s, &n)| nearest(3.0 * n) == s && (n.length() - 1.0).abs() < 1e-15));
        let golden = core::f64::consts::PI * (3.0 - 5f64.sqrt());
        let farthest = (0..20_000).map(|i| {
            let z = 1.0 - (2.0 * f64::from(i) + 1.0) / 20_000.0;
            let (radius, angle) = ((1.0 - z * z).sqrt(), golden * f64::from(i));
            let n = DVec3::new(radius * libm::cos(angle), radius * libm::sin(angle), z);
            NORMALS[nearest(n)].dot(n)
        });
        assert!(libm::acos(farthest.fold(1.0, f64::min)).to_degrees() < 36.3);
    }

    #[test]
    fn codes_are_rounded_upwards_and_come_back() {
        for code in 0..HIDDEN {
            assert_eq!(shown_code(f64::from(SCALES[usize::from(code)])), code);
        }
        for factor in [1.0, 1.0001, 1.7, 3.0, 2047.3] {
            let scale = f64::from(SCALES[usize::from(shown_code(factor))]);
            assert!((factor * (1.0 - 1e-6)..=factor * 1.0443).contains(&scale), "{factor}: {scale}");
        }
        assert_eq!([0.0, -1.0, 1e9, f64::INFINITY, f64::NAN].map(shown_code), [0, 0, HIDDEN, HIDDEN, HIDDEN]);
        assert_eq!(unhidden(None), [0; ELEMENTS]);
        assert_eq!(unhidden(Some(14))[..6], [HIDDEN, HIDDEN, HIDDEN, HIDDEN, HIDDEN, 0]);
    }

    #[test]
    fn an_orthoview_shows_what_faces_it_and_less_well_what_is_oblique() {
        // From above: the top as it is, the four upper corners at √3 times the error, no side and nothing that faces down.
        let top = STRETCH[14];
        let expected = |s: usize| match s {
            5 => 1.0,
            7 | 9 | 11 | 13 => 3f64.sqrt() as f32,
            _ => f32::INFINITY,
        };
        assert!((0..ELEMENTS).all(|s| top[s] == expected(s) || (top[s] - expected(s)).abs() < 1e-6), "{top:?}");
        // From an upper corner: itself, its three faces, its three neighbours.
        assert_eq!(STRETCH[26].iter().filter(|s| s.is_finite()).count(), 7);
    }
}
