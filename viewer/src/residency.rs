//! What the client holds, and how much memory that takes. No socket and no clock.
//!
//! Memory is counted by what is there: wire bytes from a request until it is shown, decoded bytes from its last byte on.
//! The server plans within the same budget; where client and server disagree for a moment (messages cross, a session was
//! lost), the client's own account decides, and nothing is taken in that does not fit. Decoding is modelled, or done by others
//! who say when.

use crate::events::{Happening, What};
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::units::Time;
use foresight_traces::client::{ClientSettings, Pipeline};
use foresight_wire::message::Fetch;
use std::collections::{BTreeMap, BTreeSet};

/// Requests under way at most; a server that asks for more is refused.
pub const REQUESTS_MAX: usize = 4096;

/// What becomes of a `fetch`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Admission {
    /// Request it.
    Start,
    /// It was on its way or there already, from a session that was lost.
    Adopted,
    /// It is reported as failed: it does not fit, or is there already.
    Refused,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    InFlight,
    Arrived,
    Resident,
}

#[derive(Clone, Debug)]
struct Held {
    stage: Stage,
    responded: bool,
    /// Whether the server counts on it. What it does not know is kept for a while, in case that it asks for it again.
    known: bool,
    /// Whether the session before the latest `greet` counted on it.
    was_known: bool,
    wire_bytes: u64,
    decoded_bytes: u64,
    after: Option<u32>,
    discard_on_arrival: Vec<u32>,
}

#[derive(Debug)]
enum Decoding {
    Modelled(Pipeline),
    /// What others have decoded and uploaded, and cannot be shown yet.
    Told(BTreeSet<u32>),
}

/// What the client holds.
#[derive(Debug)]
pub struct Residency {
    budget: u64,
    held: BTreeMap<u32, Held>,
    in_flight: usize,
    used: u64,
    used_max: u64,
    decoding: Decoding,
    /// Whether anything was ever decoded after something else.
    has_prerequisites: bool,
    happened: Vec<Happening>,
    /// Whose requests are to be aborted.
    aborted: Vec<u32>,
}

impl Residency {
    /// Nothing, in `budget` bytes; decoding and uploading are modelled.
    pub fn new(budget: u64, client: ClientSettings) -> Residency {
        Residency::with(budget, Decoding::Modelled(Pipeline::new(client)))
    }

    /// Nothing, in `budget` bytes; [`Residency::uploaded`] is told what is decoded and uploaded.
    pub fn drawn(budget: u64) -> Residency {
        Residency::with(budget, Decoding::Told(BTreeSet::new()))
    }

    fn with(budget: u64, decoding: Decoding) -> Residency {
        Residency {
            budget,
            held: BTreeMap::new(),
            in_flight: 0,
            used: 0,
            used_max: 0,
            decoding,
            has_prerequisites: false,
            happened: Vec::new(),
            aborted: Vec::new(),
        }
    }

    /// Bytes in use.
    pub fn used_bytes(&self) -> u64 {
        self.used
    }

    /// The most that ever was in use, bytes.
    pub fn used_bytes_max(&self) -> u64 {
        self.used_max
    }

    /// What can be shown.
    pub fn resident(&self) -> impl Iterator<Item = u32> + '_ {
        self.held.iter().filter(|(_, held)| held.stage == Stage::Resident).map(|(&rep, _)| rep)
    }

    /// What has happened since the last call, in order.
    pub fn take_happened(&mut self) -> Vec<Happening> {
        core::mem::take(&mut self.happened)
    }

    /// Whose requests are to be aborted since the last call.
    pub fn take_aborted(&mut self) -> Vec<u32> {
        core::mem::take(&mut self.aborted)
    }

    fn note(&mut self, at_ns: u64, rep: u32, what: What, told: bool) {
        self.happened.push(Happening { at_ns, rep, what, told });
    }

    fn take_memory(&mut self, bytes: u64) {
        self.used = self.used.saturating_add(bytes);
        self.used_max = self.used_max.max(self.used);
    }

    /// What a `hello` says is resident. The server counts on that and on nothing else from now on.
    pub fn greet(&mut self) -> Vec<u32> {
        for held in self.held.values_mut() {
            held.was_known = held.known;
            held.known = held.stage == Stage::Resident;
        }
        self.resident().collect()
    }

    /// The session that was greeted goes on: what it had requested and has begun to come is spoken of again, and counts.
    pub fn resumed(&mut self, at_ns: u64) {
        for (&rep, held) in &mut self.held {
            let what = match held.stage {
                Stage::InFlight if held.responded => What::Responded,
                Stage::Arrived => What::Arrived,
                Stage::Resident => What::Completed,
                Stage::InFlight => continue,
            };
            if held.was_known && !held.known {
                held.known = true;
                self.happened.push(Happening { at_ns, rep, what, told: true });
            }
        }
    }

    /// Frees what the server does not know.
    pub fn drop_strangers(&mut self, at_ns: u64) {
        let strangers: Vec<u32> = self.held.iter().filter(|(_, held)| !held.known).map(|(&rep, _)| rep).collect();
        for rep in strangers {
            self.let_go(rep);
            self.note(at_ns, rep, What::Dropped, false);
        }
    }

    /// Makes room for `bytes` at the cost of what the server does not know. False if that is not enough.
    fn make_room(&mut self, bytes: u64, at_ns: u64, for_rep: u32) -> bool {
        while self.used.saturating_add(bytes) > self.budget {
            let stranger = self.held.iter().find(|&(&rep, held)| !held.known && rep != for_rep);
            let Some((&rep, _)) = stranger else { return false };
            self.let_go(rep);
            self.note(at_ns, rep, What::Dropped, false);
        }
        true
    }

    /// The server wants something requested.
    pub fn fetch(&mut self, fetch: &Fetch, at_ns: u64) -> Admission {
        let rep = fetch.rep;
        self.has_prerequisites |= fetch.after.is_some();
        if let Some(held) = self.held.get_mut(&rep) {
            if held.known {
                self.note(at_ns, rep, What::Failed { reason: "it was requested already".to_owned() }, true);
                return Admission::Refused;
            }
            held.known = true;
            held.after = fetch.after;
            held.discard_on_arrival.clone_from(&fetch.discard_on_arrival);
            let (stage, responded) = (held.stage, held.responded);
            if responded {
                self.note(at_ns, rep, What::Responded, true);
            }
            if stage != Stage::InFlight {
                self.note(at_ns, rep, What::Arrived, true);
                self.discard_for(rep, at_ns);
            }
            if stage == Stage::Resident {
                self.note(at_ns, rep, What::Completed, true);
            }
            return Admission::Adopted;
        }
        let reason = if self.in_flight >= REQUESTS_MAX {
            format!("{REQUESTS_MAX} requests are under way, and no more are made")
        } else if !self.make_room(fetch.wire_bytes, at_ns, rep) {
            format!("{} bytes do not fit: {} of {} are in use", fetch.wire_bytes, self.used, self.budget)
        } else {
            self.take_memory(fetch.wire_bytes);
            self.in_flight += 1;
            let held = Held {
                stage: Stage::InFlight,
                responded: false,
                known: true,
                was_known: false,
                wire_bytes: fetch.wire_bytes,
                decoded_bytes: fetch.decoded_bytes,
                after: fetch.after,
                discard_on_arrival: fetch.discard_on_arrival.clone(),
            };
            self.held.insert(rep, held);
            self.note(at_ns, rep, What::Requested, true);
            return Admission::Start;
        };
        self.note(at_ns, rep, What::Failed { reason }, true);
        Admission::Refused
    }

    /// Frees what is held of `rep`, wherever it is.
    fn let_go(&mut self, rep: u32) -> bool {
        let Some(held) = self.held.remove(&rep) else { return false };
        self.used -= match held.stage {
            Stage::InFlight => {
                self.in_flight -= 1;
                self.aborted.push(rep);
                held.wire_bytes
            }
            Stage::Arrived => {
                match &mut self.decoding {
                    Decoding::Modelled(pipeline) => {
                        pipeline.give_up(RepId(rep));
                    }
                    Decoding::Told(uploaded) => {
                        uploaded.remove(&rep);
                    }
                }
                held.wire_bytes + held.decoded_bytes
            }
            Stage::Resident => held.decoded_bytes,
        };
        true
    }

    /// The server wants a request aborted: also one whose last byte came while it said so.
    pub fn cancel(&mut self, rep: u32, at_ns: u64) {
        if self.let_go(rep) {
            self.note(at_ns, rep, What::Cancelled, false);
        }
    }

    /// The server wants it freed.
    pub fn discard(&mut self, rep: u32, at_ns: u64) {
        if self.let_go(rep) {
            self.note(at_ns, rep, What::Discarded, false);
        }
    }

    fn discard_for(&mut self, rep: u32, at_ns: u64) {
        let doomed = self.held.get_mut(&rep).map(|held| core::mem::take(&mut held.discard_on_arrival));
        for doomed in doomed.unwrap_or_default() {
            if doomed != rep {
                self.discard(doomed, at_ns);
            }
        }
    }

    /// The first byte came.
    pub fn responded(&mut self, rep: u32, at_ns: u64) {
        let Some(held) = self.held.get_mut(&rep).filter(|held| held.stage == Stage::InFlight) else { return };
        held.responded = true;
        let known = held.known;
        self.note(at_ns, rep, What::Responded, known);
    }

    /// The last byte came: what waited for that goes, and it is decoded.
    pub fn arrived(&mut self, rep: u32, at_ns: u64) {
        let Some(held) = self.held.get(&rep).filter(|held| held.stage == Stage::InFlight) else { return };
        let (decoded_bytes, after) = (held.decoded_bytes, held.after);
        self.discard_for(rep, at_ns);
        let reason = if after.is_some_and(|after| !self.held.contains_key(&after)) {
            "what it needs first is not here".to_owned()
        } else if !self.make_room(decoded_bytes, at_ns, rep) {
            format!("{decoded_bytes} bytes do not fit: {} of {} are in use", self.used, self.budget)
        } else {
            self.take_memory(decoded_bytes);
            self.in_flight -= 1;
            let Some(held) = self.held.get_mut(&rep) else { return };
            held.stage = Stage::Arrived;
            let known = held.known;
            if let Decoding::Modelled(pipeline) = &mut self.decoding {
                pipeline.arrived(RepId(rep), decoded_bytes, Time(at_ns));
            }
            self.note(at_ns, rep, What::Arrived, known);
            return;
        };
        self.fail(rep, at_ns, reason);
    }

    /// It could not be fetched: what needs it and is on its way or waits to be shown is given up too.
    pub fn fail(&mut self, rep: u32, at_ns: u64, reason: String) {
        let Some(known) = self.held.get(&rep).map(|held| held.known) else { return };
        self.let_go(rep);
        self.note(at_ns, rep, What::Failed { reason }, known);
        let mut lost = BTreeSet::from([rep]);
        // What is needed first has the lower number: one pass in order finds all that hangs on it.
        let under_way: Vec<u32> =
            self.held.iter().filter(|(_, held)| held.stage != Stage::Resident).map(|(&rep, _)| rep).collect();
        for rep in under_way {
            let Some(held) = self.held.get(&rep) else { continue };
            let Some(after) = held.after.filter(|after| lost.contains(after)) else { continue };
            let known = held.known;
            lost.insert(rep);
            self.let_go(rep);
            self.note(at_ns, rep, What::Failed { reason: format!("it needs {after}, which failed") }, known);
        }
    }

    /// Whether it has arrived and cannot be shown yet.
    pub fn is_arrived(&self, rep: u32) -> bool {
        self.held.get(&rep).is_some_and(|held| held.stage == Stage::Arrived)
    }

    /// It is decoded and uploaded, by others: [`Residency::show`] lets it be seen.
    pub fn uploaded(&mut self, rep: u32) {
        if self.is_arrived(rep)
            && let Decoding::Told(uploaded) = &mut self.decoding
        {
            uploaded.insert(rep);
        }
    }

    /// It is lost, with the device that had it; the server is told.
    pub fn lose(&mut self, rep: u32, at_ns: u64) {
        let Some(known) = self.held.get(&rep).map(|held| held.known) else { return };
        self.let_go(rep);
        self.note(at_ns, rep, What::Dropped, known);
    }

    /// Uploads what is decoded, once a tick.
    pub fn show(&mut self, now_ns: u64) {
        loop {
            let mut completed = Vec::new();
            let held = &self.held;
            let ready = |rep: RepId| {
                let after = held.get(&rep.0).and_then(|held| held.after);
                after.is_none_or(|after| held.get(&after).is_some_and(|held| held.stage == Stage::Resident))
            };
            match &mut self.decoding {
                Decoding::Modelled(pipeline) => pipeline.upload(Time(now_ns), ready, |rep| completed.push(rep.0)),
                Decoding::Told(uploaded) => {
                    completed.extend(uploaded.iter().copied().filter(|&rep| ready(RepId(rep))));
                    completed.iter().for_each(|rep| {
                        uploaded.remove(rep);
                    });
                }
            }
            for &rep in &completed {
                let Some(held) = self.held.get_mut(&rep) else { continue };
                held.stage = Stage::Resident;
                self.used -= held.wire_bytes;
                let known = held.known;
                self.note(now_ns, rep, What::Completed, known);
            }
            if completed.is_empty() || !self.has_prerequisites {
                return;
            }
        }
    }
}

#[cfg(test)]
#[path = "residency_tests.rs"]
mod tests;
