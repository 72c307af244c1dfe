//! How far an orthoview is off, by element: by the side of its pixels, and by what stands behind something else in it.
//!
//! A cell's surface is sampled where any of its images sees it. An image from u claims to show what faces it by more than
//! [`SHOWN_MIN`] (the scheduler's elements), but of a street seen from the side it shows the first façades alone. Where the
//! nearest sample of the image that faces alike lies Δ from one of the surface there is a hole of at least 2Δ, and the error there is
//! e = [`SAMPLE_ERROR`]·√(side² + 4Δ²). One number has to stand for all samples of an element: the error g whose accuracy
//! 1/(1 + (g/E)²) is the mean of the samples' 1/(1 + (e/E)²), by area, where a pixel of the image is one pixel on the screen, so that
//! E = e₀·side. It is kept as a factor of [`SAMPLE_ERROR`]·side, stretched by how oblique the element is ([`Shown`]).
//!
//! By element, because roofs hide nothing and are much of a city: one number for all promised façades that nobody saw.

use super::image::{Frame, Lattice, Orthoview};
use super::{Direction, SAMPLE_ERROR};
use foresight_scheduler::benefit::accuracy::HALF_ACCURACY_PX;
use foresight_scheduler::benefit::element::{self, ELEMENTS, HIDDEN, SHOWN_MIN, Shown};
use glam::{DVec2, DVec3, I64Vec2};
use rayon::prelude::*;

/// Samples taken of an image, about.
const SAMPLES: usize = 2048;

/// Sides within which a sample is the same surface: half of what a pixel covers of one that is seen at [`SHOWN_MIN`].
const SAME: f64 = 2.0;

/// Least cosine between the normals of samples of one surface: a roof does not show its walls.
const ALIKE: f64 = 0.5;

/// Pixels at which a hidden sample looks for the nearest that is shown, in eight directions.
const REACHES: [i64; 7] = [1, 2, 4, 8, 16, 32, 64];

/// An image and where it is.
struct Looked<'a> {
    image: &'a Orthoview,
    frame: Frame,
    towards_eye: DVec3,
    /// Cosine of each element's normal with the direction; it claims to show what is above [`SHOWN_MIN`].
    cosines: [f64; ELEMENTS],
    /// Side of a pixel in those of the lattice, and in metres.
    scale: f64,
    side: f64,
}

impl<'a> Looked<'a> {
    fn new(direction: Direction, image: &'a Orthoview, origin: DVec3, pitch: f64) -> Looked<'a> {
        let lattice = Lattice { direction, origin, pitch };
        let towards_eye = direction.towards_eye();
        let cosines = element::normals().map(|normal| normal.dot(towards_eye));
        let scale = (1u64 << image.level) as f64;
        Looked { image, frame: lattice.frame(), towards_eye, cosines, scale, side: pitch * scale }
    }

    /// Where the middle of a pixel lies, and its normal; `None` if it is empty.
    fn sample(&self, at: I64Vec2) -> Option<(DVec3, DVec3)> {
        let pixel = self.image.get(at);
        let middle: DVec2 = (at.as_dvec2() + 0.5) * self.scale;
        let depth = self.image.near + f64::from(pixel.depth);
        pixel.is_some().then(|| {
            let normal = DVec3::from_array(pixel.normal.map(f64::from));
            (self.frame.unproject(middle.extend(depth)), normal)
        })
    }

    /// Metres from a point of a surface to the nearest sample of one alike that is found, 0 if it is the same.
    #[expect(clippy::cast_possible_truncation, reason = "a point of the cell, whose pixels have numbers")]
    fn distance(&self, point: DVec3, normal: DVec3) -> f64 {
        let on_image = self.frame.project(point) / self.scale;
        let at = I64Vec2::new(on_image.x.floor() as i64, on_image.y.floor() as i64);
        let to = |at: I64Vec2| match self.sample(at) {
            Some((there, facing)) if facing.dot(normal) >= ALIKE => there.distance(point),
            _ => f64::INFINITY,
        };
        let mut nearest = to(at);
        for reach in REACHES {
            if nearest <= SAME * self.side {
                return 0.0;
            }
            // No sample farther aside can be nearer.
            if (reach - 1) as f64 * self.side > nearest {
                break;
            }
            for (x, y) in [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)] {
                nearest = nearest.min(to(at + reach * I64Vec2::new(x, y)));
            }
        }
        if nearest <= SAME * self.side { 0.0 } else { nearest }
    }
}

/// Σ area, and Σ area·accuracy, by image and element.
type Sums = Vec<[[f64; 2]; ELEMENTS]>;

/// How well each of a cell's images shows each element, beside [`SAMPLE_ERROR`] sides of its pixels; the images' lattices have
/// their coordinates from `origin` in leaf pixels of `pitch` metres. An element of which nothing is seen hides nothing.
pub fn shown(images: &[(Direction, &Orthoview)], origin: DVec3, pitch: f64) -> Vec<Shown> {
    let looked: Vec<Looked<'_>> = images.iter().map(|&(d, image)| Looked::new(d, image, origin, pitch)).collect();
    // Collected in order: sums of floating point do not depend on the threads.
    let of_each: Vec<Sums> = looked.par_iter().map(|seen| sums(seen, &looked)).collect();
    let of = |at: usize, own: &Looked<'_>, s: usize| {
        if own.cosines[s] <= SHOWN_MIN {
            return HIDDEN;
        }
        let [area, accurate] = of_each.iter().fold([0.0; 2], |[a, b], sums| [a + sums[at][s][0], b + sums[at][s][1]]);
        let factor = (1.0 / OWN) * (area / accurate - 1.0).max(0.0).sqrt();
        let factor = if factor.is_finite() { factor.max(1.0) } else { 1.0 };
        element::shown_code(factor / own.cosines[s])
    };
    looked.iter().enumerate().map(|(at, own)| core::array::from_fn(|s| of(at, own, s))).collect()
}

/// [`SAMPLE_ERROR`]·side in E.
const OWN: f64 = SAMPLE_ERROR / HALF_ACCURACY_PX;

/// What the samples of one image say of all.
fn sums(seen: &Looked<'_>, all: &[Looked<'_>]) -> Sums {
    let mut sums = vec![[[0.0; 2]; ELEMENTS]; all.len()];
    let rect = &seen.image.rect;
    let mut step = 1;
    while rect.area() > SAMPLES * step * step {
        step += 1;
    }
    // Nothing is farther from anything in the cell.
    let diagonal = libm::hypot(seen.image.range, seen.side * libm::hypot(rect.width() as f64, rect.height() as f64));
    let mut distances = vec![0.0; all.len()];
    for y in (rect.min.y..rect.max.y).step_by(step) {
        for x in (rect.min.x..rect.max.x).step_by(step) {
            let Some((point, normal)) = seen.sample(I64Vec2::new(x, y)) else { continue };
            let oblique = normal.dot(seen.towards_eye);
            if oblique <= SHOWN_MIN {
                // Others see it better, and a pixel stands for too much of it.
                continue;
            }
            let element = element::nearest(normal);
            let mut seen_by = 0.0;
            for (distance, other) in distances.iter_mut().zip(all) {
                *distance = other.distance(point, normal).min(diagonal);
                let sees = *distance == 0.0 && normal.dot(other.towards_eye) > SHOWN_MIN;
                seen_by += f64::from(u8::from(sees));
            }
            // Each image that sees a place brings samples of it; together they count once.
            let area = seen.side * seen.side / (oblique * f64::max(seen_by, 1.0));
            for ((sum, &distance), other) in sums.iter_mut().zip(&distances).zip(all) {
                if other.cosines[element] > SHOWN_MIN {
                    let off = OWN * 2.0 * distance / other.side;
                    let sum = &mut sum[element];
                    sum[0] += area;
                    sum[1] += area / (1.0 + OWN * OWN + off * off);
                }
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::super::image::Pixel;
    use super::*;
    use foresight_scheduler::lod_tree::Aabb;

    const ORIGIN: DVec3 = DVec3::new(6.4e6, -80.0, 3.0);
    const PITCH: f64 = 0.5;

    fn direction(signs: [i32; 3]) -> Direction {
        Direction::from_signs(signs).expect("a direction")
    }

    /// A cell of 32 m seen from `signs`: the nearest of the points along each pixel's ray.
    fn drawn(signs: [i32; 3], ray: impl Fn(DVec3) -> Option<(f64, DVec3)>) -> Orthoview {
        let lattice = Lattice { direction: direction(signs), origin: ORIGIN, pitch: PITCH };
        let bounds = Aabb { min: ORIGIN, max: ORIGIN + 32.0 };
        let mut image = Orthoview::empty(&lattice, &bounds, 0);
        for index in 0..image.pixels.len() {
            let at = (image.rect.at(index).as_dvec2() + 0.5).extend(image.near);
            if let Some((depth, normal)) = ray(lattice.unproject(at) - ORIGIN) {
                let normal = normal.to_array().map(|v| v as f32);
                image.pixels[index] = Pixel { depth: depth as f32, colour: [0.5; 3], normal };
            }
        }
        image
    }

    /// The floor of the cell from above.
    fn floor() -> Orthoview {
        drawn([0, 0, 1], |from| (from.x > 0.0 && from.y > 0.0).then_some((32.0, DVec3::Z)))
    }

    #[test]
    fn what_hides_nothing_is_off_by_its_pixels() {
        let above = floor();
        let top = direction([0, 0, 1]);
        let found = shown(&[(top, &above)], ORIGIN, PITCH);
        assert_eq!(found, [element::unhidden(Some(top.code()))]);
    }

    /// Two walls across x, at 4 m and at 24 m, both facing −x. From −x only the first is seen. A view from the corner above
    /// sees both, for they are low.
    #[test]
    fn a_wall_behind_a_wall_is_off_by_what_lies_between_them() {
        let low = 4.0;
        let side = drawn([-1, 0, 0], |from| (from.z < low && from.z > 0.0).then_some((4.0, DVec3::NEG_X)));
        let out = direction([-1, 0, 1]).towards_eye();
        let corner = drawn([-1, 0, 1], |from| {
            let walls = [4.0, 24.0].map(|x| (from.x - x) / out.x);
            let hit = walls.into_iter().find(|t| (0.0..low).contains(&(from - out * *t).z));
            hit.map(|depth| (depth, DVec3::NEG_X))
        });
        let directions = [direction([-1, 0, 0]), direction([-1, 0, 1])];
        let [first, second] = shown(&[(directions[0], &side), (directions[1], &corner)], ORIGIN, PITCH)[..] else {
            panic!("two")
        };
        assert_eq!(second, element::unhidden(Some(directions[1].code())));
        // Half of the surface is 20 m behind the other half; what faces elsewhere is not there, and so is not hidden.
        let accuracy = |factor: f64| 1.0 / (1.0 + OWN * OWN * factor * factor);
        let mean = 0.5 * (accuracy(1.0) + accuracy(libm::hypot(PITCH, 40.0) / PITCH));
        let factor = libm::exp2(f64::from(first[0]) / 16.0);
        assert!((accuracy(factor) - mean).abs() < 0.03, "{factor}: {} {mean}", accuracy(factor));
        assert_eq!(first[1..], element::unhidden(Some(directions[0].code()))[1..]);
    }

    #[test]
    fn images_of_nothing_have_the_error_of_their_pixels() {
        let empty = drawn([1, 0, 0], |_| None);
        let above = floor();
        let directions = [direction([1, 0, 0]), direction([0, 0, 1])];
        let found = shown(&[(directions[0], &empty), (directions[1], &above)], ORIGIN, PITCH);
        assert_eq!(found, directions.map(|direction| element::unhidden(Some(direction.code()))));
        assert!(shown(&[], ORIGIN, PITCH).is_empty());
    }
}
