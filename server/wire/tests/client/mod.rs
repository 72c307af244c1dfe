//! A client over an invented network: every response comes after 40 ms, one byte after the other at a fixed rate.

use foresight_index::generate::city::{CityParams, city};
use foresight_index::world::World;
use foresight_scheduler::lod_tree::{Aabb, LodTree, LodTreeBuilder, RepId, Representation};
use foresight_wire::message::{
    Camera, ClientMessage, Event, Hello, Mode, Progress, Refinement, ServerMessage, VERSION, Views,
};
use foresight_wire::session::SessionWorld;
use glam::DVec3;
use std::collections::{BTreeMap, BTreeSet};

pub(crate) const TICK_NS: u64 = 16_666_667;
const LATENCY_NS: u64 = 40_000_000;

pub(crate) fn small_city() -> World {
    let params = CityParams { blocks_x: 6, blocks_y: 6, seed: 3, ..CityParams::default() };
    city(&params).expect("a small city")
}

/// Nodes in a row along x, ten metres apart, each with three levels of which the second needs the first and the third
/// the second.
pub(crate) fn rows(nodes: u32) -> LodTree {
    let mut builder = LodTreeBuilder::default();
    builder.open().expect("a root");
    for x in 0..nodes {
        builder.open().expect("a node");
        let mut prerequisite = None;
        for (wire_bytes, error) in [(500, 1.0), (2000, 0.1), (9000, 0.01)] {
            let decoded_bytes = 3 * wire_bytes;
            let rep = Representation { wire_bytes, decoded_bytes, error, prerequisite, direction: None };
            prerequisite = Some(builder.add(rep).expect("a level"));
        }
        let min = DVec3::new(f64::from(x) * 10.0 - 150.0, 1.0, 16.0);
        builder.close(Some(Aabb { min, max: min + 8.0 }), 1.0).expect("a node");
    }
    builder.close(None, 1.0).expect("a root");
    builder.finish().expect("a world")
}

pub(crate) fn session_world<'a>(tree: &'a LodTree, uri: &'a (dyn Fn(RepId) -> String + Sync)) -> SessionWorld<'a> {
    SessionWorld { name: "city", identity: "0", base: "/worlds/city/0/", tree, uri, up: DVec3::Z }
}

pub(crate) fn hello(memory_bytes: u64) -> Hello {
    Hello {
        version: VERSION,
        world: "city".to_owned(),
        memory_bytes,
        refinement: Refinement::Partial,
        policy: None,
        mode: Mode::Drive,
        resume: None,
        resident: Vec::new(),
        client: None,
        link: None,
    }
}

/// A street view that drives along x, metres.
pub(crate) fn view_at(t_ns: u64, x: f64) -> ClientMessage {
    // Camera looking along +x with +z up.
    let orientation = [0.5, -0.5, -0.5, 0.5];
    let camera =
        Camera { position: [x - 200.0, 5.0, 20.0], orientation, fov_y: 1.0, viewport: [1280, 720], weight: 1.0 };
    ClientMessage::View(Views { t_ns, cameras: vec![camera] })
}

/// What a client holds and waits for.
#[derive(Clone, Debug, Default)]
pub(crate) struct Client {
    /// Bytes per second.
    rate: f64,
    /// When the link is free, ns.
    free_at: u64,
    /// By the time of the last byte: first byte and what frees on arrival.
    under_way: BTreeMap<(u64, u32), (u64, Vec<u32>)>,
    responded: BTreeSet<u32>,
    pub(crate) resident: BTreeSet<u32>,
    total: u64,
}

impl Client {
    pub(crate) fn new(rate: f64) -> Client {
        Client { rate, ..Client::default() }
    }

    pub(crate) fn obey(&mut self, answers: &[ServerMessage], now: u64) {
        for answer in answers {
            match answer {
                ServerMessage::Fetch(fetch) => {
                    let begins = self.free_at.max(now + LATENCY_NS);
                    self.free_at = begins + (fetch.wire_bytes as f64 / self.rate * 1e9) as u64;
                    self.under_way.insert((self.free_at, fetch.rep), (begins, fetch.discard_on_arrival.clone()));
                }
                ServerMessage::Cancel { rep } => {
                    self.under_way.retain(|(_, under_way), _| under_way != rep);
                    self.responded.remove(rep);
                    self.resident.remove(rep);
                }
                ServerMessage::Discard { rep } => {
                    self.resident.remove(rep);
                }
                _ => {}
            }
        }
    }

    /// What has happened since; decoding takes no time.
    pub(crate) fn events(&mut self, tree: &LodTree, now: u64) -> Vec<ClientMessage> {
        let mut events = Vec::new();
        for (&(_, rep), &(begins, _)) in &self.under_way {
            if begins <= now && self.responded.insert(rep) {
                events.push(ClientMessage::Responded(Event { t_ns: begins, rep }));
            }
        }
        while let Some(first) = self.under_way.first_entry().filter(|first| first.key().0 <= now) {
            let ((at, rep), (_, frees)) = first.remove_entry();
            self.total += tree.wire_bytes(RepId(rep));
            self.responded.remove(&rep);
            events.push(ClientMessage::Arrived(Event { t_ns: at, rep }));
            frees.iter().for_each(|freed| {
                self.resident.remove(freed);
            });
            self.resident.insert(rep);
            events.push(ClientMessage::Completed(Event { t_ns: at, rep }));
        }
        events.push(ClientMessage::Progress(Progress { t_ns: now, total_bytes: self.total, in_flight_bytes: 0 }));
        events
    }

    pub(crate) fn held_bytes(&self, tree: &LodTree) -> u64 {
        self.resident.iter().map(|&rep| tree.decoded_bytes(RepId(rep))).sum()
    }
}
