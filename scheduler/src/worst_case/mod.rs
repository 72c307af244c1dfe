//! What is left if the prediction fails: the worst case W of the objective (ARCHITECTURE.md), in two readings.
//!
//! `union` (\[ZK\] §5): everything that some reachable view could see counts with its whole solid angle from where the
//! camera is, shown with the least accuracy that the reachable distances and angles allow; the sum is scaled to at most
//! the frustum, so that α keeps its meaning as ωε grows. [`union`] bounds it; [`union_cut`] is what decisions use.
//!
//! `minimum` (\[ZK\] eq. 3): minus the largest deficit of any reachable view. [`minimum`] bounds it, by a covering set of
//! samples and by branch and bound; [`max_min`] chooses what to fetch for it.

pub mod bounds;
mod faceted;
pub mod max_min;
pub mod minimum;
pub mod neighbourhood;
pub mod reach;
mod scaled_sum;
mod slope;
pub mod target;
mod turned;
pub mod union;
pub mod view_box;

pub use reach::{Reach, clearance};

use crate::benefit::cut::{Cut, CutSettings, Region};
use crate::lod_tree::LodTree;
use crate::view::{View, ViewError};

/// The reading of the worst case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WorstCaseKind {
    /// Everything that some reachable view could see, at the least accuracy that it could have.
    #[default]
    Union,
    /// Minus the largest deficit of any one reachable view.
    Minimum,
}

impl WorstCaseKind {
    /// Both readings with the names that reports and options use.
    pub const ALL: [(&'static str, WorstCaseKind); 2] =
        [("union", WorstCaseKind::Union), ("minimum", WorstCaseKind::Minimum)];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            WorstCaseKind::Union => "union",
            WorstCaseKind::Minimum => "minimum",
        }
    }
}

/// What a worst case cannot be computed from.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum WorstCaseError {
    /// The present view is none.
    #[error(transparent)]
    View(#[from] ViewError),
    /// A number out of its range.
    #[error("{field} is {value}; expected {expected}")]
    Value {
        /// Which.
        field: &'static str,
        /// As given.
        value: f64,
        /// Its range.
        expected: &'static str,
    },
    /// A point that is not finite or too far out.
    #[error("{field} is {value}; expected coordinates of at most 1e15 m")]
    Point {
        /// Which.
        field: &'static str,
        /// As given.
        value: glam::DVec3,
    },
    /// Two inputs that contradict each other.
    #[error("{field} is {value}: {contradiction}")]
    Contradiction {
        /// Which.
        field: &'static str,
        /// As given.
        value: f64,
        /// What it contradicts.
        contradiction: &'static str,
    },
}

/// Coordinates beyond this, metres, are refused: about a tenth of a light year.
pub const COORDINATE_MAX: f64 = 1e15;

/// Refuses a number that is NaN or outside [low, high].
pub(crate) fn within(
    field: &'static str,
    value: f64,
    low: f64,
    high: f64,
    expected: &'static str,
) -> Result<f64, WorstCaseError> {
    if (low..=high).contains(&value) { Ok(value) } else { Err(WorstCaseError::Value { field, value, expected }) }
}

/// Refuses cut settings that no weight could be computed with.
pub(crate) fn check_cut(settings: &CutSettings) -> Result<(), WorstCaseError> {
    within("opening", settings.opening, 0.0, 10.0, "an angle from 0 to 10")?;
    within("near", settings.near, f64::MIN_POSITIVE, COORDINATE_MAX, "metres, more than 0")?;
    Ok(())
}

/// Makes the cut of the reachable region around `view`; its weights are scaled like any other cut's.
pub fn union_cut(cut: &mut Cut, tree: &LodTree, view: &View, region: Region, settings: &CutSettings) {
    cut.make(tree, view, region, &CutSettings { centre_falloff: 0.0, ..*settings });
}
