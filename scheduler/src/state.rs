//! What the scheduler knows about its client: memory, requests, and what the link costs.

use crate::benefit::coverage::{Coverage, Refinement};
use crate::lod_tree::{LodTree, NodeId, RepId};
use crate::sparse::IdMap;
use crate::transfer::TransferEstimate;
use crate::units::Time;
use crate::view::View;
use std::collections::BTreeMap;

/// Where a representation is on its way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Status {
    /// On the server only.
    #[default]
    Absent,
    /// Requested; its bytes are coming or will.
    InFlight,
    /// All bytes are here; it is being decoded or uploaded.
    Arrived,
    /// Can be shown.
    Resident,
    /// Can still be shown, and goes when the request that needs its memory has arrived.
    Doomed,
}

/// A request on its way.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// What was asked for.
    pub rep: RepId,
    /// When.
    pub requested: Time,
    /// When the first byte came.
    pub responded: Option<Time>,
    /// What to discard when the last byte has come.
    pub discard_on_arrival: Vec<RepId>,
    /// Bytes of memory set aside for it.
    reserved: u64,
}

/// The client as the scheduler sees it. Policies read it; only the [`crate::scheduler::Scheduler`] changes it.
#[derive(Clone, Debug)]
pub struct ClientState<'a> {
    /// The world.
    pub tree: &'a LodTree,
    /// Bytes that resident, arriving and requested representations may take together.
    pub budget: u64,
    /// Of what is not absent.
    status: IdMap<Status>,
    resident: Coverage,
    planned: Coverage,
    requests: Vec<Request>,
    /// How many planned or doomed representations need one first, where any does.
    dependents: IdMap<u32>,
    used: u64,
    /// Bytes of the requests in flight that have been received.
    received_in_flight: u64,
    /// Link estimates.
    pub link: TransferEstimate,
    /// The latest view; of several cameras, that of the largest weight.
    pub view: Option<View>,
    /// Shares and latest views of all cameras; the shares sum to 1.
    pub(crate) cameras: Vec<(f64, View)>,
}

impl<'a> ClientState<'a> {
    /// A client with nothing resident.
    pub fn new(tree: &'a LodTree, budget: u64, refinement: Refinement, link: TransferEstimate) -> ClientState<'a> {
        let empty = Coverage::new(tree, refinement);
        ClientState {
            tree,
            budget,
            status: IdMap::default(),
            resident: empty.clone(),
            planned: empty,
            requests: Vec::new(),
            dependents: IdMap::default(),
            used: 0,
            received_in_flight: 0,
            link,
            view: None,
            cameras: Vec::new(),
        }
    }

    /// Where `rep` is.
    pub fn status(&self, rep: RepId) -> Status {
        self.status.get(&rep.0).copied().unwrap_or_default()
    }

    /// Shares and latest views of all cameras, in the order given; the shares sum to 1. Empty before the first view.
    pub fn cameras(&self) -> &[(f64, View)] {
        &self.cameras
    }

    /// Everything that can be shown and is not doomed, in order of id.
    pub fn residents(&self) -> impl Iterator<Item = RepId> + '_ {
        self.resident.iter().filter(|&r| self.status(r) == Status::Resident)
    }

    /// What can be shown now, doomed ones included.
    pub fn resident(&self) -> &Coverage {
        &self.resident
    }

    /// What will be resident when every request has ended and every planned discard is done.
    pub fn planned(&self) -> &Coverage {
        &self.planned
    }

    /// Requests whose last byte has not come, oldest first.
    pub fn requests(&self) -> &[Request] {
        &self.requests
    }

    /// Bytes in use: decoded residents, and for every request or arrival its wire bytes and what is reserved.
    pub fn used_bytes(&self) -> u64 {
        self.used
    }

    /// Bytes in use beyond the budget, after it has shrunk.
    pub fn excess_bytes(&self) -> u64 {
        self.used.saturating_sub(self.budget)
    }

    /// Bytes left of the budget.
    pub fn free_bytes(&self) -> u64 {
        self.budget.saturating_sub(self.used)
    }

    /// Wire bytes requested and not received yet.
    pub fn outstanding_bytes(&self) -> u64 {
        let asked: u64 = self.requests.iter().map(|r| self.tree.wire_bytes(r.rep)).sum();
        asked.saturating_sub(self.received_in_flight)
    }

    /// Bytes that a request for `rep` takes while it is on its way: its wire form and its decoded form.
    pub fn request_bytes(&self, rep: RepId) -> u64 {
        self.tree.wire_bytes(rep) + self.tree.decoded_bytes(rep)
    }

    /// Whether a planned or doomed representation needs `rep` first: then it cannot be discarded.
    pub fn is_needed(&self, rep: RepId) -> bool {
        self.dependents.contains_key(&rep.0)
    }

    /// Whether everything that `rep` needs first is planned.
    pub fn has_prerequisite(&self, rep: RepId) -> bool {
        self.tree.prerequisite(rep).is_none_or(|p| self.planned.contains(p))
    }

    fn plan(&mut self, rep: RepId) {
        if let Some(p) = self.tree.prerequisite(rep) {
            *self.dependents.entry(p.0).or_default() += 1;
        }
        self.planned.insert(self.tree, rep);
    }

    fn unplan(&mut self, rep: RepId) {
        self.release_prerequisite(rep);
        self.planned.remove(self.tree, rep);
    }

    fn release_prerequisite(&mut self, rep: RepId) {
        if let Some(p) = self.tree.prerequisite(rep)
            && let Some(dependents) = self.dependents.get_mut(&p.0)
        {
            *dependents -= 1;
            if *dependents == 0 {
                self.dependents.remove(&p.0);
            }
        }
    }

    pub(crate) fn request(&mut self, rep: RepId, discard_on_arrival: Vec<RepId>, now: Time) {
        let handed_over: u64 = discard_on_arrival.iter().map(|&d| self.tree.decoded_bytes(d)).sum();
        let reserved = self.tree.wire_bytes(rep) + self.tree.decoded_bytes(rep).saturating_sub(handed_over);
        for &doomed in &discard_on_arrival {
            self.status.insert(doomed.0, Status::Doomed);
            // It can be shown until it goes, and is spared if the request ends early: what it needs has to stay.
            self.planned.remove(self.tree, doomed);
        }
        self.used += reserved;
        self.status.insert(rep.0, Status::InFlight);
        self.plan(rep);
        self.requests.push(Request { rep, requested: now, responded: None, discard_on_arrival, reserved });
    }

    pub(crate) fn responded(&mut self, rep: RepId, now: Time) -> bool {
        let Some(request) = self.requests.iter_mut().find(|r| r.rep == rep) else { return false };
        if request.responded.is_none() {
            request.responded = Some(now);
            let requested = request.requested;
            self.link.responded(requested, now);
        }
        true
    }

    /// `in_flight` bytes of the requests on their way are here; `total` have come since the start.
    pub(crate) fn received(&mut self, in_flight: u64, total: u64, now: Time) {
        self.received_in_flight = in_flight;
        self.link.received(total, now);
    }

    /// Takes the request out; `None` if there is none for `rep`.
    pub(crate) fn end_request(&mut self, rep: RepId, now: Time) -> Option<Request> {
        let place = self.requests.iter().position(|r| r.rep == rep)?;
        let request = self.requests.remove(place);
        if request.responded.is_some() {
            self.link.ended(now);
        }
        Some(request)
    }

    /// All bytes are here: what was to go now goes, and the decoded form's memory is set aside whole.
    pub(crate) fn arrive(&mut self, request: &Request) {
        for &doomed in &request.discard_on_arrival {
            self.used -= self.tree.decoded_bytes(doomed);
            self.status.remove(&doomed.0);
            self.resident.remove(self.tree, doomed);
            self.release_prerequisite(doomed);
        }
        self.used = self.used - request.reserved + self.request_bytes(request.rep);
        self.status.insert(request.rep.0, Status::Arrived);
    }

    /// The request failed or was cancelled: its memory is free again, and what it had doomed stays.
    pub(crate) fn abandon(&mut self, request: &Request) {
        self.used -= request.reserved;
        self.status.remove(&request.rep.0);
        self.unplan(request.rep);
        for &spared in &request.discard_on_arrival {
            self.status.insert(spared.0, Status::Resident);
            self.planned.insert(self.tree, spared);
        }
    }

    pub(crate) fn complete(&mut self, rep: RepId) {
        self.used -= self.tree.wire_bytes(rep);
        self.status.insert(rep.0, Status::Resident);
        self.resident.insert(self.tree, rep);
    }

    /// An arrived representation could not be decoded.
    pub(crate) fn drop_arrived(&mut self, rep: RepId) {
        self.used -= self.request_bytes(rep);
        self.status.remove(&rep.0);
        self.unplan(rep);
    }

    /// A doomed representation is gone before its time: the request that was to hand its memory over needs that much
    /// itself.
    pub(crate) fn drop_doomed(&mut self, rep: RepId) {
        let tree = self.tree;
        let Some(request) = self.requests.iter_mut().find(|r| r.discard_on_arrival.contains(&rep)) else { return };
        request.discard_on_arrival.retain(|&doomed| doomed != rep);
        let handed_over: u64 = request.discard_on_arrival.iter().map(|&d| tree.decoded_bytes(d)).sum();
        let reserved = tree.wire_bytes(request.rep) + tree.decoded_bytes(request.rep).saturating_sub(handed_over);
        // Never more than what is freed.
        self.used = self.used - request.reserved + reserved - tree.decoded_bytes(rep);
        request.reserved = reserved;
        self.status.remove(&rep.0);
        self.resident.remove(tree, rep);
        self.release_prerequisite(rep);
    }

    /// Puts a representation there from the start (`--warm`).
    pub(crate) fn place(&mut self, rep: RepId) {
        self.used += self.tree.decoded_bytes(rep);
        self.status.insert(rep.0, Status::Resident);
        self.resident.insert(self.tree, rep);
        self.plan(rep);
    }

    pub(crate) fn discard(&mut self, rep: RepId) {
        self.used -= self.tree.decoded_bytes(rep);
        self.status.remove(&rep.0);
        self.resident.remove(self.tree, rep);
        self.unplan(rep);
    }

    /// Bytes that the state occupies, the world not counted.
    pub fn heap_bytes(&self) -> usize {
        let waiting: usize = self.requests.iter().map(|r| r.discard_on_arrival.capacity()).sum();
        self.status.allocation_size()
            + self.dependents.allocation_size()
            + self.resident.heap_bytes()
            + self.planned.heap_bytes()
            + self.requests.capacity() * size_of::<Request>()
            + waiting * size_of::<RepId>()
            + self.cameras.capacity() * size_of::<(f64, View)>()
            + self.link.heap_bytes()
    }

    /// A copy of the planned set that a policy may alter to weigh its choices.
    pub fn hypothetical(&self) -> Coverage {
        self.planned.clone()
    }
}

/// Bytes that the smallest closure takes while it is on its way: something that can be shown, with what it needs first,
/// and under `Atomic` with its sibling group. `None` in a world without representations.
pub fn smallest_closure(tree: &LodTree, refinement: Refinement) -> Option<u64> {
    let bytes = |rep: RepId| tree.wire_bytes(rep) + tree.decoded_bytes(rep);
    let reps = (0..tree.representations() as u32).map(RepId);
    // What needs another takes more than that one alone.
    let alone = reps.filter(|&rep| tree.prerequisite(rep).is_none());
    if refinement == Refinement::Partial {
        return alone.map(bytes).min();
    }
    // By content parent, the least of each member, summed. Prerequisites among the members are counted once or not at
    // all: a lower bound.
    let mut groups: BTreeMap<Option<NodeId>, u64> = BTreeMap::new();
    for node in (0..tree.nodes() as u32).map(NodeId) {
        if let Some(least) = tree.own(node).map(bytes).min() {
            *groups.entry(tree.content_parent(node)).or_default() += least;
        }
    }
    groups.into_values().min()
}
