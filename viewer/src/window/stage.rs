//! From bodies that are given to contents on the GPU, and what becomes of each told back.

use crate::clock::Clock;
use crate::exchange::{Body, Exchange, Fate, Told};
use crate::gpu::Renderer;
use crate::scene::compress::Compression;
use crate::scene::content::Content;
use crate::scene::loader::{Loader, LoaderSettings};
use crate::scene::resident::{Resident, ResidentSettings, Uploads, Used};
use crate::scene::source::Source;
use foresight_index::world::World;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::view::View;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// From one ranking of what waits to the next, nanoseconds.
const RANKING_NS: u64 = 500_000_000;

/// The renderer as a taker of contents; without one nothing is taken.
struct Taker<'a>(Option<&'a mut Renderer>);

impl Uploads for Taker<'_> {
    fn upload(&mut self, rep: RepId, content: &Content) -> Result<u64, String> {
        match &mut self.0 {
            Some(renderer) => renderer.upload(rep, content).map_err(|error| error.to_string()),
            None => Err("there is no graphics device".to_owned()),
        }
    }

    fn remove(&mut self, rep: RepId) {
        if let Some(renderer) = &mut self.0 {
            renderer.remove(rep);
        }
    }
}

/// What is given, by representation.
#[derive(Clone, Copy, Debug)]
struct Item {
    number: u64,
    is_local: bool,
    /// When it was first seen, ns.
    shown_ns: Option<u64>,
}

/// What was given and is not taken back.
pub(super) struct Stage<'a> {
    world: &'a World,
    resident: Resident,
    items: BTreeMap<RepId, Item>,
    drawable: BTreeSet<RepId>,
    memory: u64,
    compression: Compression,
    /// At hand, but beyond the memory: contents take more of it than the world says. Asked for again where there is room.
    deferred: BTreeSet<RepId>,
    ranked_ns: u64,
    /// Since the start.
    pub(super) shown: u64,
    pub(super) broken: u64,
    /// The latest that could not be shown.
    pub(super) fault: Option<String>,
}

impl<'a> Stage<'a> {
    /// Nothing yet, in `memory` bytes; contents compressed as far as the adapter has textures of blocks.
    pub(super) fn new(
        world: &'a Arc<World>,
        source: &Arc<Source>,
        memory: u64,
        compression: Compression,
    ) -> std::io::Result<Stage<'a>> {
        let loader = Loader::new(world.clone(), source.clone(), LoaderSettings::default())?;
        Ok(Stage {
            world,
            resident: Resident::new(loader, ResidentSettings::with_budget(memory)),
            items: BTreeMap::new(),
            drawable: BTreeSet::new(),
            memory,
            compression,
            deferred: BTreeSet::new(),
            ranked_ns: 0,
            shown: 0,
            broken: 0,
            fault: None,
        })
    }

    /// How much a representation is wanted: the angle under which its node is seen.
    fn rank(&self, rep: RepId, view: &View) -> f64 {
        let tree = &self.world.tree;
        let node = tree.node_of(rep);
        let size = tree.half(node).length();
        size / (tree.centre(node) - view.position).length().max(size).max(1e-3)
    }

    /// What a frame does: forgets, takes, decodes, uploads, and tells.
    pub(super) fn turn(&mut self, exchange: &Exchange, renderer: &mut Renderer, view: &View, clock: Clock) {
        let now_ns = clock.now_ns();
        self.resident.set_compression(renderer.compression(self.compression));
        let mut taker = Taker(Some(renderer));
        let (gone, given) = exchange.take();
        for rep in gone.into_iter().map(RepId) {
            self.resident.discard(rep, &mut taker);
            self.items.remove(&rep);
            self.drawable.remove(&rep);
            self.deferred.remove(&rep);
        }
        for given in given {
            let rep = RepId(given.rep);
            let rank = self.rank(rep, view);
            let is_local = given.body == Body::Local;
            self.items.insert(rep, Item { number: given.number, is_local, shown_ns: None });
            let refused = match given.body {
                Body::Bytes(bytes) => self.resident.received(rep, bytes, rank),
                Body::Local => self.resident.ask(rep, rank),
            };
            if let Some((rep, why)) = refused {
                self.fail(rep, why, exchange);
            }
        }
        if now_ns.saturating_sub(self.ranked_ns) > RANKING_NS {
            self.ranked_ns = now_ns;
            let waiting: Vec<RepId> =
                self.items.iter().filter(|(_, i)| i.shown_ns.is_none()).map(|(&r, _)| r).collect();
            for rep in waiting {
                self.resident.rank(rep, self.rank(rep, view));
            }
            self.retry(exchange, view);
        }
        let frame = self.resident.frame(&mut taker);
        for rep in frame.shown {
            if let Some(item) = self.items.get_mut(&rep) {
                item.shown_ns = Some(now_ns);
                exchange.tell(Told { rep: rep.0, number: item.number, fate: Fate::Shown });
            }
            self.drawable.insert(rep);
            self.shown += 1;
        }
        for (rep, why) in frame.failed {
            self.fail(rep, why, exchange);
        }
    }

    /// Whether there is surely memory for a content: four times what the world says that it takes.
    fn has_room(&self, rep: RepId) -> bool {
        let most = self.world.tree.decoded_bytes(rep).saturating_mul(4);
        self.resident.used().total().saturating_add(most) <= self.memory
    }

    /// Asks again for the most wanted of what found no room, if there is some.
    fn retry(&mut self, exchange: &Exchange, view: &View) {
        let best = self.deferred.iter().map(|&rep| (self.rank(rep, view), rep)).max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((rank, rep)) = best.filter(|&(_, rep)| self.has_room(rep)) else { return };
        self.deferred.remove(&rep);
        if let Some((rep, why)) = self.resident.ask(rep, rank) {
            self.fail(rep, why, exchange);
        }
    }

    fn fail(&mut self, rep: RepId, why: String, exchange: &Exchange) {
        if self.items.get(&rep).is_some_and(|item| item.is_local) && !self.has_room(rep) {
            self.deferred.insert(rep);
            return;
        }
        self.broken += 1;
        self.fault = Some(why.clone());
        if let Some(item) = self.items.remove(&rep) {
            exchange.tell(Told { rep: rep.0, number: item.number, fate: Fate::Broken(why) });
        }
    }

    /// The device is gone, and what it had with it: what is at hand is decoded anew, of the rest whoever fetches is told.
    pub(super) fn device_lost(&mut self, exchange: &Exchange, view: &View) {
        let lost = std::mem::take(&mut self.drawable);
        for rep in lost {
            self.resident.discard(rep, &mut Taker(None));
            let Some(item) = self.items.get(&rep).copied() else { continue };
            if item.is_local || self.resident.cached(rep).is_some() {
                let rank = self.rank(rep, view);
                let refused = self.resident.ask(rep, rank);
                if let Some(item) = self.items.get_mut(&rep) {
                    item.shown_ns = None;
                }
                if let Some((rep, why)) = refused {
                    self.fail(rep, why, exchange);
                }
            } else {
                self.items.remove(&rep);
                exchange.tell(Told { rep: rep.0, number: item.number, fate: Fate::Lost });
            }
        }
    }

    /// What can be drawn.
    pub(super) fn drawable(&self) -> &BTreeSet<RepId> {
        &self.drawable
    }

    /// Nanoseconds since it was first seen.
    pub(super) fn age_ns(&self, rep: RepId, now_ns: u64) -> Option<u64> {
        Some(now_ns.saturating_sub(self.items.get(&rep)?.shown_ns?))
    }

    /// Whose all of `reps` are, each said once.
    pub(super) fn credits(&self, reps: impl IntoIterator<Item = RepId>) -> BTreeSet<Arc<str>> {
        self.resident.credits(reps)
    }

    /// Memory by what it is for, bytes.
    pub(super) fn used(&self) -> Used {
        self.resident.used()
    }

    /// Most memory there ever was, bytes.
    pub(super) fn used_max(&self) -> u64 {
        self.resident.used_max()
    }

    /// Contents that wait for memory.
    pub(super) fn deferred(&self) -> usize {
        self.deferred.len()
    }

    /// Contents that wait to be decoded or uploaded.
    pub(super) fn pending(&self) -> usize {
        self.resident.pending()
    }
}
