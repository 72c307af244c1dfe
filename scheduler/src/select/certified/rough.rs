//! Bounds that cost little: the eyes of an interval of time are taken as one box of positions, and the frustum is that of
//! what lies above. Most of what a search meets never has to be looked at more closely.

use super::bound::{Mask, SLACK, Target, bit};
use super::objective::{Objective, Term};
use glam::DVec3;

/// The terms of one interval of time whose pixels are alike, and the box of their eyes; a reachable region is by itself.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// The first of its terms.
    first: usize,
    least: DVec3,
    greatest: DVec3,
    sharpness: f64,
    /// Of the least distance that counts.
    near_squared: f64,
}

impl Objective {
    /// Finds the places of the terms.
    pub(super) fn find_places(&mut self) {
        self.places.clear();
        self.place_of.clear();
        for (i, term) in self.terms.iter().enumerate() {
            let eye = term.eye.frustum.eye;
            let is_like = |place: &Place| is_like(&self.terms[place.first], term);
            let found = self.places.iter().position(is_like);
            let which = found.unwrap_or(self.places.len());
            match found {
                Some(which) => {
                    let place = &mut self.places[which];
                    (place.least, place.greatest) = (place.least.min(eye), place.greatest.max(eye));
                }
                None => {
                    let near = term.eye.shown_distance(0.0);
                    let (sharpness, near_squared) = (term.sharpness, near * near);
                    self.places.push(Place { first: i, least: eye, greatest: eye, sharpness, near_squared });
                }
            }
            self.place_of.push(which);
        }
    }

    /// Sums the shares of the terms of `mask` by place.
    pub(super) fn place_weights(&self, weights: &[f64], mask: Mask, out: &mut Vec<f64>) {
        out.clear();
        out.resize(self.places.len(), 0.0);
        for (i, (&which, weight)) in self.place_of.iter().zip(weights).enumerate() {
            if mask & bit(i) != 0 {
                out[which] += weight;
            }
        }
    }

    /// At least what [`Objective::bound`] says of the box for terms whose shares, summed by place, are `weights`.
    pub(super) fn rough_bound(&self, weights: &[f64], centre: DVec3, half: DVec3, target: &Target) -> f64 {
        let mut sum = 0.0;
        for (place, &weight) in self.places.iter().zip(weights) {
            if weight <= 0.0 {
                continue;
            }
            let eye = &self.terms[place.first].eye;
            // From the nearest of the eyes to the nearest point of the box, and from the farthest to the farthest.
            let (before, behind) = (centre - place.greatest, centre - place.least);
            let delta = (before - half).max(-behind - half).max(DVec3::ZERO);
            let squared = delta.length_squared();
            let is_reachable = eye.is_reachable();
            if squared <= 0.0 || !is_reachable && squared < place.near_squared {
                return f64::INFINITY;
            }
            let by_squared = 1.0 / squared;
            let distance = squared.sqrt();
            let most = before.abs().max(behind.abs()) + half;
            let cosines = (most * (distance * by_squared)).min(DVec3::ONE);
            let added = if is_reachable {
                let shown_from = eye.shown_distance(distance);
                target.added_up_to(place.sharpness / (shown_from * shown_from))
            } else {
                target.added_at(place.sharpness * by_squared)
            };
            sum += weight * by_squared * target.density().dot(cosines) * added;
        }
        if sum.is_nan() { f64::INFINITY } else { sum * SLACK }
    }
}

/// Whether two terms can share a place: what is shown from a distance is then a function of the distance alone.
fn is_like(a: &Term, b: &Term) -> bool {
    a.span == b.span && a.sharpness == b.sharpness && !a.eye.is_reachable() && !b.eye.is_reachable()
}
