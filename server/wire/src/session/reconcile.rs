//! What the client holds against what the session believes it holds.

use super::{Answers, Session, check_hello, fatal};
use crate::message::{Error, ErrorCode, Hello, ServerMessage};
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::state::Status;
use std::collections::BTreeSet;

impl Session<'_> {
    /// Goes on after a break of the connection, with what the client says that it holds and can show. The first answer is
    /// the welcome. Requests and arrivals of which the client does not speak in its next frame, by repeating `responded`
    /// or `arrived`, are over then. A `hello` that cannot go on with this session is answered by a fatal error, and changes
    /// nothing.
    pub fn resume(&mut self, received_ns: u64, hello: &Hello) -> Vec<ServerMessage> {
        let mut answers = self.begin(received_ns);
        if let Err(error) = self.may_resume(hello) {
            return vec![ServerMessage::Error(error)];
        }
        if hello.memory_bytes != self.scheduler.state().budget {
            self.scheduler.set_budget(hello.memory_bytes);
        }
        if let Some(policy) = hello.policy.as_ref().filter(|policy| **policy != self.policy) {
            self.change_policy(policy, &mut answers);
        }
        self.mode = hello.mode;
        self.let_go.forget_doomed();
        self.say_anew();
        answers.push_first(self.welcome(true));

        let now = self.clock.now();
        let held: BTreeSet<u32> = hello.resident.iter().copied().collect();
        let state = self.scheduler.state();
        // What was decoded or arrived during the break.
        let under_way: Vec<RepId> = state.planned().iter().filter(|r| held.contains(&r.0)).collect();
        for rep in under_way {
            match self.scheduler.state().status(rep) {
                Status::InFlight => {
                    self.arrived(rep, now, &mut answers);
                    self.completed(rep, now, &mut answers);
                }
                Status::Arrived => self.completed(rep, now, &mut answers),
                Status::Absent | Status::Resident | Status::Doomed => {}
            }
        }
        let gone: Vec<RepId> = self.scheduler.state().resident().iter().filter(|r| !held.contains(&r.0)).collect();
        // What needs another has the higher id.
        for rep in gone.into_iter().rev() {
            self.dropped(rep, now, &mut answers);
            self.give_up_what_needs(rep, now, &mut answers);
        }
        self.hold(&hello.resident, &mut answers);
        self.resuming = Some(BTreeSet::new());
        self.finished = false;
        answers.finish()
    }

    fn may_resume(&self, hello: &Hello) -> Result<(), Error> {
        check_hello(&self.world, &self.limits, hello)?;
        if hello.refinement != self.refinement {
            let message = format!("refinement is {:?}; expected {:?}, as before", hello.refinement, self.refinement);
            return Err(fatal(ErrorCode::Value, message));
        }
        Ok(())
    }

    /// Takes what the client holds into account; what does not fit, or lacks what it needs, is to go.
    pub(super) fn hold(&mut self, resident: &[u32], answers: &mut Answers) {
        let count = self.world.tree.representations();
        // What is needed first has the lower id.
        let reps: BTreeSet<u32> = resident.iter().copied().collect();
        for rep in reps.into_iter().map(RepId) {
            if rep.index() >= count {
                let message = format!("representation {} is said to be resident; the world has {count}", rep.0);
                answers.error(ErrorCode::Event, message);
                continue;
            }
            let state = self.scheduler.state();
            if state.status(rep) != Status::Absent {
                continue;
            }
            let is_placed = state.has_prerequisite(rep) && self.scheduler.preload(rep).is_ok();
            if !is_placed && !self.fetches_by_itself() {
                self.let_go.insert(rep, self.clock.latest(), Vec::new());
                answers.push(ServerMessage::Discard { rep: rep.0 });
            }
        }
    }
}
