//! The replay's upper bound against the exact optimum, on instances small enough to go through all policies.

use super::outcome::UpperBoundRow;
use crate::bound::exact::{ExactError, exact};
use crate::bound::tiny::{Stratum, bound, tiny};
use rayon::prelude::*;

/// `count` instances of each stratum, by seeds from `seed` on; in parallel, in order.
///
/// # Errors
/// An instance is not of the kind that can be gone through.
pub fn rows(count: u64, seed: u64) -> Result<Vec<UpperBoundRow>, ExactError> {
    let instances: Vec<(Stratum, u64)> =
        Stratum::ALL.into_iter().flat_map(|stratum| (0..count).map(move |i| (stratum, seed.wrapping_add(i)))).collect();
    let row = |&(stratum, seed): &(Stratum, u64)| {
        let instance = tiny(seed, stratum);
        Ok(UpperBoundRow {
            case: format!("seed={seed}"),
            stratum: stratum.name().to_owned(),
            bound: bound(&instance),
            exact: exact(&instance)?,
        })
    };
    instances.par_iter().map(row).collect()
}
