//! Connected parts: triangles that share a place on the lattice.

use std::collections::HashMap;

use glam::DVec3;

use super::lattice::{Lattice, has_area};

/// The part that a triangle belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Part {
    /// Diagonal of the box around it, metres. No more than that of a step where the lattice makes lines of all its
    /// triangles: it is no wider.
    pub(super) diameter: f64,
    /// Whether it reaches a face of the cell.
    pub(super) is_on_face: bool,
}

/// The part of each triangle, given their corners.
pub(super) fn parts(triangles: &[[[u16; 3]; 3]], lattice: &Lattice) -> Vec<Part> {
    // Looked up only, never walked through.
    let mut places: HashMap<[u16; 3], u32> = HashMap::new();
    let mut above: Vec<u32> = Vec::new();
    let numbered: Vec<u32> = triangles
        .iter()
        .map(|triangle| {
            let numbers = triangle.map(|at| {
                *places.entry(at).or_insert_with(|| {
                    above.push(above.len() as u32);
                    above.len() as u32 - 1
                })
            });
            join(&mut above, numbers[0], numbers[1]);
            join(&mut above, numbers[1], numbers[2]);
            numbers[0]
        })
        .collect();
    #[derive(Clone, Copy)]
    struct About {
        min: DVec3,
        max: DVec3,
        has_area: bool,
        is_on_face: bool,
    }
    let none = About { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY, has_area: false, is_on_face: false };
    let mut about = vec![none; above.len()];
    let roots: Vec<usize> = numbered.iter().map(|&number| root(&mut above, number) as usize).collect();
    for (triangle, &part) in triangles.iter().zip(&roots) {
        let part = &mut about[part];
        part.has_area |= has_area(*triangle);
        for &at in triangle {
            let corner = lattice.position(at);
            part.min = part.min.min(corner);
            part.max = part.max.max(corner);
            part.is_on_face |= lattice.is_on_face(at);
        }
    }
    let diagonal = f64::from(lattice.step) * 3.0_f64.sqrt();
    let part = |&index: &usize| {
        let About { min, max, has_area, is_on_face } = about[index];
        // Rounding to the lattice moved its ends by half a diagonal at most.
        let diameter = if has_area { (max - min).length() + diagonal } else { diagonal };
        Part { diameter, is_on_face }
    };
    roots.iter().map(part).collect()
}

/// The representative of a place's part: the least one.
fn root(above: &mut [u32], mut at: u32) -> u32 {
    while above[at as usize] != at {
        above[at as usize] = above[above[at as usize] as usize];
        at = above[at as usize];
    }
    at
}

fn join(above: &mut [u32], one: u32, other: u32) {
    let (one, other) = (root(above, one), root(above, other));
    above[one.max(other) as usize] = one.min(other);
}
