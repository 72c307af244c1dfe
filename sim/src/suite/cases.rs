//! The cases: data only.

use super::{Case, Due};

/// Every case, in the order in which they run.
pub const CASES: &[Case] = &[Case {
    name: "turn",
    why: "Half a turn within a second, twice.",
    shows: "What the worst case buys when the prediction fails; on an ample link it buys little.",
    due: Due::Open,
    replays: &[
        "--path turn --link constant:40Mbit,40ms --memory mu:0.5",
        "--path turn --link constant:4Mbit,40ms --memory mu:0.5",
    ],
}];
