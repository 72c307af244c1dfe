//! What goes when the memory budget shrinks under a policy that makes no room by itself.
//!
//! What is on its way goes first, the newest first: no byte of it shows anything yet. Then what can be shown, finest
//! first (least geometric error, then the highest id), so that something coarse stays. What something else needs goes
//! after that.

use crate::lod_tree::RepId;
use crate::scheduler::Action;
use crate::state::{ClientState, Status};

/// Residents in the order in which they go, last first; read anew when it runs out.
#[derive(Clone, Debug, Default)]
pub(crate) struct Excess {
    residents: Vec<RepId>,
}

impl Excess {
    /// The next to go; `None` where all that is left is being decoded, or needed by what is.
    pub(crate) fn next(&mut self, state: &ClientState) -> Option<Action> {
        if let Some(request) = state.requests().iter().rev().find(|r| !state.is_needed(r.rep)) {
            return Some(Action::Cancel(request.rep));
        }
        let may_go = |rep: RepId| state.status(rep) == Status::Resident && !state.is_needed(rep);
        let next = |residents: &mut Vec<RepId>| {
            while let Some(rep) = residents.pop() {
                if may_go(rep) {
                    return Some(Action::Discard(rep));
                }
            }
            None
        };
        next(&mut self.residents).or_else(|| {
            self.residents.extend(state.residents().filter(|&rep| may_go(rep)));
            let error = |rep: RepId| state.tree.error(rep);
            self.residents.sort_unstable_by(|&a, &b| error(b).total_cmp(&error(a)).then(a.cmp(&b)));
            next(&mut self.residents)
        })
    }
}
