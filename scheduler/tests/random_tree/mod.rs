//! Random trees and views, drawn from a tape of numbers: shrinking the tape shrinks the world.

use foresight_scheduler::benefit::element::ELEMENTS;
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, RepId, Representation};
use foresight_scheduler::view::View;
use glam::{DQuat, DVec3};

/// Choices still to be made. An exhausted tape chooses 0, the simplest, for ever.
pub(crate) struct Tape {
    choices: Vec<u16>,
    next: usize,
}

impl Tape {
    pub(crate) fn new(choices: Vec<u16>) -> Tape {
        Tape { choices, next: 0 }
    }

    fn take(&mut self) -> u16 {
        self.next += 1;
        self.choices.get(self.next - 1).copied().unwrap_or(0)
    }

    /// One of 0 to `n` − 1.
    pub(crate) fn below(&mut self, n: usize) -> usize {
        usize::from(self.take()) % n
    }

    /// In [0, 1].
    pub(crate) fn unit(&mut self) -> f64 {
        f64::from(self.take()) / f64::from(u16::MAX)
    }

    /// In [−`limit`, `limit`] for each coordinate; 0 is chosen first.
    pub(crate) fn point(&mut self, limit: f64) -> DVec3 {
        let mut one = || limit * (2.0 * libm::fmod(self.unit() + 0.5, 1.0) - 1.0);
        DVec3::new(one(), one(), one())
    }

    /// A world of at most 4 levels and `reps_max` representations, at least one of them at a leaf: sizes and errors fall
    /// downwards mostly; boxes overlap, and some have no thickness; some nodes own nothing. In one of three, most
    /// representations show one direction only, and most leaves tell their surface.
    pub(crate) fn tree(&mut self, reps_max: usize) -> LodTree {
        let directions = self.below(3) == 1;
        let levels = self.below(4);
        let mut builder = LodTreeBuilder::default();
        let mut made = Made { reps: Vec::new(), reps_max, plain: self.below(4) == 0, directions };
        self.node(&mut builder, levels, levels, &mut made);
        builder.finish().expect("what was drawn is a tree")
    }

    fn node(&mut self, builder: &mut LodTreeBuilder, levels: usize, left: usize, made: &mut Made) {
        builder.open().expect("one root");
        let owns = if left == 0 { [1, 2, 3, 0][self.below(4)] } else { [1, 0, 2, 3][self.below(4)] };
        // The last of the budget is kept for a leaf.
        let room = made.reps_max.saturating_sub(made.reps.len() + usize::from(left > 0));
        let owns = if made.reps.is_empty() && left == 0 { owns.max(1) } else { owns };
        let depth = (levels - left) as i32;
        let mut before = None;
        for i in 0..owns.min(room) {
            let error = match self.below(16) {
                15 => 0.0,
                14 => 100.0 * self.unit(),
                _ => 30.0 * libm::exp2(f64::from(-2 * depth - i as i32)) * (0.5 + self.unit()),
            };
            let wire_bytes = 1 + libm::exp(13.0 * self.unit()) as u32;
            let decoded_bytes = wire_bytes.saturating_mul(self.below(8) as u32);
            let prerequisite = match self.below(if made.plain { 1 } else { 4 }) {
                1 | 2 => before,
                3 if !made.reps.is_empty() => Some(made.reps[self.below(made.reps.len())]),
                _ => None,
            };
            let error = error as f32;
            let direction = match self.below(if made.directions { 4 } else { 1 }) {
                0 => None,
                _ => Some([14, 22, 4, 16, 10, 26, 20, 8, 2, 12, 0, 17][self.below(12)]),
            };
            let rep = Representation { wire_bytes, decoded_bytes, error, prerequisite, direction };
            let id = builder.add(rep).expect("what was drawn is a representation");
            before = Some(id);
            made.reps.push(id);
        }
        if left > 0 {
            for _ in 0..=self.below(3) {
                self.node(builder, levels, left - 1, made);
            }
            builder.close(None, 1.0).expect("its children have bounds");
            return;
        }
        let middle = self.point(100.0);
        let half = match self.below(8) {
            7 => DVec3::ZERO,
            6 => DVec3::new(10.0 * self.unit(), 0.0, 10.0 * self.unit()),
            5 => DVec3::new(0.0, 30.0 * self.unit(), 0.0),
            _ => DVec3::new(0.1, 0.1, 0.1) + 15.0 * DVec3::new(self.unit(), self.unit(), self.unit()),
        };
        if made.directions && self.below(4) > 0 {
            let mut shares = [0.0f32; ELEMENTS];
            for _ in 0..1 + self.below(5) {
                shares[self.below(ELEMENTS)] += 0.1 + self.unit() as f32;
            }
            builder.surface(shares).expect("shares are positive");
        }
        let importance = [1.0, 1.0, 0.3, 0.0][if made.plain { 0 } else { self.below(4) }];
        builder.close(Some(Aabb { min: middle - half, max: middle + half }), importance).expect("the box is finite");
    }

    /// A view among the boxes or beside them; every other one looks at their middle, more or less.
    pub(crate) fn view(&mut self) -> View {
        let position = self.point(150.0);
        let (yaw, pitch) = match self.below(2) {
            0 => (libm::atan2(position.x, position.z) + self.unit() - 0.5, -libm::atan2(position.y, 100.0)),
            _ => (6.3 * self.unit(), 1.5 * self.unit() - 0.75),
        };
        View {
            position,
            orientation: (DQuat::from_rotation_y(yaw) * DQuat::from_rotation_x(pitch)).normalize(),
            fov_y: 0.3 + 2.2 * self.unit(),
            viewport: [[1920, 1080], [600, 600], [300, 900]][self.below(3)],
        }
    }
}

struct Made {
    reps: Vec<RepId>,
    reps_max: usize,
    /// No prerequisites and no importance.
    plain: bool,
    /// Orthoviews.
    directions: bool,
}
