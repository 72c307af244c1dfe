//! Environment maps on the GPU: what is far is drawn from six depth images at each of four points around the viewpoint
//! instead of from its own contents (\[DRVW\] §6). Which maps there are, which are drawn and what is far is said in
//! [`crate::draw::environment`].
//!
//! A face is drawn by the renderer itself, as any picture is, from what [`choose_in`] chooses there: orthoviews and triangles
//! that reach out of the map's cube, lit, one sample a pixel. Its near plane is the cube's face, so its six faces show what
//! is outside of the cube and nothing else. It is kept as a list of points of 8 bytes: pixel, colour, and the 16-bit reciprocal
//! of the distance, whose steps are steps of parallax; what is farther than 65,535 D is put there. A list is drawn as an
//! orthoview is, tile by tile, culled by view and by occlusion; but it has no pixels that show nothing.
//!
//! Faces are made one at a time, in steps between frames: at most [`EnvironmentSettings::points_per_frame`] points into the
//! face; its counts, for which nobody waits, a frame or two later; then the list. \[DRVW\] composed on threads of the CPU, because
//! the GPU was at its limit and the work came all at once. Here contents are on the GPU only, and the budget is what
//! keeps frames short.
//!
//! What is far is left out of the list only if it was resident when each face of the four maps was chosen: then
//! [`choose_in`] shows its place in all of them. So what comes later is drawn by itself until the maps are made anew, and what
//! has gone is still seen in them. Another light or shape of splats makes all maps worthless at once. Memory is what the
//! caller has left: maps of the cell before go first, then all, and everything is drawn by itself.
//!
//! A map leaves out what the base of its cell shows as well, and keeps that base alive in the cells that follow: there may then
//! be a base of before among what is drawn. A base that is made anew is taken to show the same surfaces.

mod blocks;
mod maker;

use super::device::GpuError;
use super::renderer::Renderer;
use super::settings::{Light, SplatShape};
use super::splats::Splats;
use crate::draw::choose::{ChooseSettings, choose_in};
use crate::draw::environment::{Cell, EnvironmentSettings, Vertex, face_side, missing};
use crate::draw::list::{DrawList, Item};
use foresight_scheduler::lod_tree::{Aabb, LodTree, RepId};
use foresight_scheduler::view::View;
use glam::DVec3;
use maker::{Codes, Maker, Making, Step, cube, face_view, scratch_bytes};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Faces that are looked at in a frame for whether what they show has changed.
const CHECKS_PER_FRAME: usize = 2;

/// Memory that was short has to grow to this share of what was asked for before it is tried again.
const RETRY: f64 = 1.25;

/// What a frame has for environment maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Share {
    /// Bytes for all of them.
    pub bytes: u64,
    /// Frames' worth of points; more than one where a picture stands for several frames.
    pub frames: u64,
    /// Whether the GPU is waited for, so that equal frames are equal whatever its speed.
    pub waits: bool,
}

/// How it stands after a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EnvironmentCounts {
    /// Items of the list that maps show in their place.
    pub left_out: usize,
    /// Maps that are drawn: four and bases of before, or none while they are made.
    pub maps_drawn: usize,
    /// Faces that are there.
    pub faces: usize,
    /// Faces made in this frame.
    pub faces_made: u64,
    /// Maps completed since the beginning.
    pub maps_made: u64,
    /// Points and triangles drawn into faces in this frame.
    pub points_in: u64,
    /// On the GPU.
    pub bytes: u64,
    /// Why everything is drawn by itself, where that is not for want of time.
    pub refused: Option<String>,
}

/// A face that is there.
#[derive(Debug)]
struct Face {
    /// Of its quarters that show anything.
    numbers: Vec<u32>,
    bytes: u64,
    /// Whose map shows what it leaves out.
    base: Option<Vertex>,
    list: Vec<Item>,
    /// What is resident and was, or would be chosen likewise.
    residents: Arc<BTreeSet<RepId>>,
}

/// A map, whole or not.
#[derive(Debug, Default)]
struct Map {
    faces: [Option<Face>; 6],
    /// For those that leave out what it shows, of a base.
    codes: Option<Codes>,
}

impl Map {
    fn is_whole(&self) -> bool {
        self.faces.iter().all(Option::is_some)
    }

    fn faces(&self) -> impl Iterator<Item = &Face> {
        self.faces.iter().flatten()
    }

    fn bytes(&self) -> u64 {
        self.faces().map(|face| face.bytes).sum::<u64>() + self.codes.as_ref().map_or(0, |codes| codes.bytes)
    }
}

/// The environment maps of a renderer. With its device they are lost, and made again with the next.
#[derive(Debug)]
pub struct Environment {
    settings: EnvironmentSettings,
    maker: Option<Maker>,
    maps: BTreeMap<Vertex, Map>,
    making: Option<Making>,
    /// Whose maps are made.
    cell: Option<Cell>,
    /// Whose maps were all there last: they serve until those of the other are.
    shown: Option<Cell>,
    look: Option<(SplatShape, Light)>,
    residents: Arc<BTreeSet<RepId>>,
    next_number: u32,
    counts: EnvironmentCounts,
    /// Bytes that there have to be before faces of so many pixels a side, or more, are tried again.
    retry: (u32, u64),
}

/// What maps are made of.
#[derive(Clone, Copy)]
pub struct Surroundings<'a> {
    /// The world's.
    pub tree: &'a LodTree,
    /// Its [`foresight_index::world::World::root_sample`].
    pub root_sample: Option<f64>,
    /// What the renderer has.
    pub resident: &'a BTreeSet<RepId>,
    /// What is drawn of it; the bias is the maps' own.
    pub choose: &'a ChooseSettings,
}

impl Environment {
    /// None yet.
    pub fn new(settings: EnvironmentSettings) -> Environment {
        Environment {
            settings,
            maker: None,
            maps: BTreeMap::new(),
            making: None,
            cell: None,
            shown: None,
            look: None,
            residents: Arc::default(),
            next_number: 0,
            counts: EnvironmentCounts::default(),
            retry: (0, 0),
        }
    }

    /// How they are made.
    pub fn settings(&self) -> &EnvironmentSettings {
        &self.settings
    }

    /// How it stands after the latest frame.
    pub fn counts(&self) -> &EnvironmentCounts {
        &self.counts
    }

    /// Bytes on the GPU, those for making among them.
    pub fn bytes(&self) -> u64 {
        self.maps.values().map(Map::bytes).sum::<u64>() + self.maker.as_ref().map_or(0, Maker::bytes)
    }

    /// Lets everything go.
    pub fn clear(&mut self, renderer: &mut Renderer) {
        self.forget(renderer, |_| false);
        self.maker = None;
        (self.cell, self.counts.bytes) = (None, 0);
    }

    /// Makes what there is time for, and gives the list that is to be drawn in place of `list`.
    ///
    /// # Errors
    /// A lost device.
    pub fn prepare(
        &mut self,
        renderer: &mut Renderer,
        around: Surroundings<'_>,
        view: &View,
        list: &DrawList,
        share: Share,
    ) -> Result<DrawList, GpuError> {
        renderer.faults.check("before environment maps")?;
        self.counts = EnvironmentCounts { maps_made: self.counts.maps_made, ..EnvironmentCounts::default() };
        self.counts.refused = self.refusal(renderer, view, list, share);
        let drawn = if self.counts.refused.is_some() {
            self.clear(renderer);
            None
        } else {
            self.make(renderer, around, view, share)?;
            self.far(around.tree, view, list)
        };
        self.counts.faces = self.maps.values().flat_map(Map::faces).count();
        self.counts.bytes = self.bytes();
        Ok(drawn.unwrap_or_else(|| list.clone()))
    }

    /// Why nothing can be made now.
    fn refusal(&self, renderer: &Renderer, view: &View, list: &DrawList, share: Share) -> Option<String> {
        if let Err(error) = self.settings.check() {
            return Some(format!("no environment maps: {error}"));
        }
        if !renderer.can_compute {
            return Some("no environment maps: the adapter has no compute shaders".to_owned());
        }
        if list.items.iter().any(|item| item.false_colour.is_some()) {
            return Some("no environment maps: false colours change while maps stay".to_owned());
        }
        if view.check().is_err() || Cell::around(view.position, self.settings.side).is_none() {
            return Some(
                "no environment maps: the viewpoint is too far from the origin for cells of this side".to_owned(),
            );
        }
        let side = face_side(view.pixels_per_radian());
        let least = scratch_bytes(side).max(if side >= self.retry.0 { self.retry.1 } else { 0 });
        (share.bytes < least).then(|| short_of_memory(share.bytes, least))
    }

    /// Lets all maps go but those at vertices that are kept, and their bases.
    fn forget(&mut self, renderer: &mut Renderer, keeps: impl Fn(&Vertex) -> bool) {
        let of_faces = self.maps.iter().filter(|(vertex, _)| keeps(vertex)).flat_map(|(_, map)| map.faces());
        let mut bases: BTreeSet<Vertex> = of_faces.filter_map(|face| face.base).collect();
        let making = self.making.iter().filter(|making| keeps(&making.vertex));
        bases.extend(making.filter_map(|making| Some(making.base.as_ref()?.0)));
        let keeps = |vertex: &Vertex| keeps(vertex) || bases.contains(vertex);
        self.maps.retain(|vertex, map| {
            let kept = keeps(vertex);
            if !kept {
                for number in map.faces().flat_map(|face| &face.numbers) {
                    renderer.faces.remove(number);
                }
            }
            kept
        });
        if self.making.as_ref().is_some_and(|making| !keeps(&making.vertex)) {
            self.making = None;
        }
    }

    fn are_whole(&self, vertices: &[Vertex]) -> bool {
        vertices.iter().all(|vertex| self.maps.get(vertex).is_some_and(Map::is_whole))
    }

    fn make(
        &mut self,
        renderer: &mut Renderer,
        around: Surroundings<'_>,
        view: &View,
        share: Share,
    ) -> Result<(), GpuError> {
        let look = (renderer.settings().shape, renderer.settings().light);
        if self.look.replace(look).is_some_and(|before| before != look) {
            self.forget(renderer, |_| false);
        }
        let side = face_side(view.pixels_per_radian());
        // A picture that has shrunk a little keeps its maps.
        if self.maker.as_ref().is_none_or(|maker| maker.side < side || maker.side > 2 * side) {
            self.clear(renderer);
            let bias = 0.5 * f64::from(side) / view.pixels_per_radian();
            self.maker = Some(Maker::new(renderer, side, bias.max(1.0))?);
        }
        if *self.residents != *around.resident {
            self.residents = Arc::new(around.resident.clone());
        }
        let at = view.position;
        self.cell = Cell::follow(self.cell, at, self.settings.side);
        let Some(cell) = self.cell else { return Ok(()) };
        self.shown = self.shown.filter(|shown| *shown == cell || shown.still_serves(at, self.settings.side));
        let kept = BTreeSet::from_iter(cell.vertices().into_iter().chain(self.shown.iter().flat_map(|c| c.vertices())));
        self.forget(renderer, |vertex| kept.contains(vertex));

        let mut left = self.settings.points_per_frame.saturating_mul(share.frames);
        let mut checks = CHECKS_PER_FRAME.saturating_mul(usize::try_from(share.frames).unwrap_or(usize::MAX));
        while left > 0 {
            if self.making.is_none() {
                self.making = self.next(renderer, &around, cell, at, &mut checks);
            }
            let (Some(maker), Some(making)) = (&self.maker, &mut self.making) else { break };
            // What has gone since the list was chosen cannot be drawn any more.
            if !Arc::ptr_eq(&making.residents, &self.residents)
                && making.list.iter().any(|item| !renderer.contains(item.rep))
            {
                self.making = None;
                continue;
            }
            if share.waits {
                let waited = renderer.device.poll(wgpu::PollType::wait_indefinitely());
                waited.map_err(|error| GpuError::Refused { what: "environment maps", reason: error.to_string() })?;
            } else {
                drop(renderer.device.poll(wgpu::PollType::Poll));
            }
            match maker.step(renderer, &self.settings, making, left) {
                Step::Drawn(points) => {
                    self.counts.points_in += points;
                    left = left.saturating_sub(points.max(1));
                }
                Step::Waits => break,
                Step::Failed => self.making = None,
                Step::Done(quarters, bytes) => {
                    self.finish(renderer, quarters, bytes);
                    self.fit(renderer, cell, share.bytes);
                }
            }
            renderer.faults.check("environment maps")?;
        }
        let kept = cell.vertices();
        if self.shown != Some(cell) && self.are_whole(&kept) {
            self.shown = Some(cell);
            self.forget(renderer, |vertex| kept.contains(vertex));
        }
        self.fit(renderer, cell, share.bytes);
        Ok(())
    }

    /// Takes a face that is made.
    fn finish(&mut self, renderer: &mut Renderer, quarters: Vec<Splats>, bytes: u64) {
        let Some(Making { vertex, face, list, residents, base, keeps, .. }) = self.making.take() else { return };
        let mut numbers = Vec::new();
        for quarter in quarters {
            renderer.faces.insert(self.next_number, quarter);
            numbers.push(self.next_number);
            self.next_number = self.next_number.wrapping_add(1);
        }
        let map = self.maps.entry(vertex).or_default();
        map.codes = map.codes.take().or(keeps);
        let old = map.faces[face].replace(Face { numbers, bytes, base: base.map(|base| base.0), list, residents });
        self.counts.faces_made += 1;
        self.counts.maps_made += u64::from(old.is_none() && map.is_whole());
        for number in old.iter().flat_map(|old| &old.numbers) {
            renderer.faces.remove(number);
        }
    }

    /// Keeps within memory.
    fn fit(&mut self, renderer: &mut Renderer, cell: Cell, bytes: u64) {
        if self.bytes() <= bytes {
            return;
        }
        let kept = cell.vertices();
        self.forget(renderer, |vertex| kept.contains(vertex));
        if self.bytes() > bytes {
            // As much as there was, and not all of it was there.
            let side = self.maker.as_ref().map_or(0, |maker| maker.side);
            self.retry = (side, (self.bytes() as f64 * RETRY) as u64);
            self.counts.refused = Some(short_of_memory(bytes, self.retry.1));
            self.clear(renderer);
        }
    }

    /// The face to be made next: of a map that is not whole, the base's first; else one whose contents have changed.
    fn next(
        &mut self,
        renderer: &Renderer,
        around: &Surroundings<'_>,
        cell: Cell,
        at: DVec3,
        checks: &mut usize,
    ) -> Option<Making> {
        let held: BTreeSet<Vertex> = self.maps.iter().filter(|(_, map)| map.is_whole()).map(|(v, _)| *v).collect();
        if let Some(&vertex) = missing(cell, &held, at, self.settings.side).first() {
            let map = self.maps.get(&vertex);
            let face = map.and_then(|map| map.faces.iter().position(Option::is_none)).unwrap_or(0);
            let list = self.choose(around, vertex, face);
            return Some(self.begin(renderer, cell, vertex, face, list));
        }
        // Bases of cells before are drawn too, while others leave out what they show.
        let mut vertices = BTreeSet::from(cell.vertices());
        vertices.extend(self.maps.values().flat_map(Map::faces).filter_map(|face| face.base));
        for vertex in vertices {
            for face in 0..6 {
                let known =
                    |map: &Map| map.faces[face].as_ref().map(|face| Arc::ptr_eq(&face.residents, &self.residents));
                if self.maps.get(&vertex).and_then(known) != Some(false) {
                    continue;
                }
                if *checks == 0 {
                    return None;
                }
                *checks -= 1;
                let list = self.choose(around, vertex, face);
                match self.maps.get_mut(&vertex).and_then(|map| map.faces[face].as_mut()) {
                    Some(known) if known.list == list => known.residents = self.residents.clone(),
                    _ => return Some(self.begin(renderer, cell, vertex, face, list)),
                }
            }
        }
        None
    }

    /// A face to be made; with the cell's base, but bases of any cell are whole.
    fn begin(&self, renderer: &Renderer, cell: Cell, vertex: Vertex, face: usize, list: Vec<Item>) -> Making {
        let mut making = Making::new(vertex, face, list, self.residents.clone());
        let codes = |vertex: &Vertex| self.maps.get(vertex)?.codes.clone();
        if vertex.iter().all(|step| step % 2 == 0) {
            making.keeps = codes(&vertex).or_else(|| Some(self.maker.as_ref()?.codes(renderer)));
        } else {
            making.base = codes(&cell.base()).map(|codes| (cell.base(), codes));
        }
        making
    }

    /// What a face shows: what is chosen in its view, without what lies in the map's cube.
    fn choose(&self, around: &Surroundings<'_>, vertex: Vertex, face: usize) -> Vec<Item> {
        let Some(maker) = &self.maker else { return Vec::new() };
        let view = face_view(vertex, face, &self.settings, maker.side);
        let settings = ChooseSettings { bias: maker.bias, ..*around.choose };
        let mut list = DrawList::default();
        choose_in(around.tree, around.root_sample, &self.residents, &view, &settings, &mut list);
        let cube = cube(vertex, &self.settings);
        list.items.retain(|item| {
            let bounds = reach(around.tree, item.rep);
            !(bounds.min.cmpgt(cube.min).all() && bounds.max.cmplt(cube.max).all())
        });
        list.items
    }

    /// The list with faces in place of what is far; `None` while there are none.
    fn far(&mut self, tree: &LodTree, view: &View, list: &DrawList) -> Option<DrawList> {
        let four = |cell: &Cell| cell.tetrahedron(view.position, self.settings.side);
        let cells = [self.cell, self.shown].into_iter().flatten();
        let shown = cells.into_iter().find(|cell| self.are_whole(&four(cell)))?;
        let four = four(&shown);
        let mut vertices = BTreeSet::from(four);
        let maps = four.iter().filter_map(|vertex| self.maps.get(vertex));
        vertices.extend(maps.flat_map(Map::faces).filter_map(|face| face.base));
        let drawn: Vec<&Face> =
            vertices.iter().filter_map(|vertex| self.maps.get(vertex)).flat_map(Map::faces).collect();
        // Most faces share what was resident.
        let mut residents: Vec<&Arc<BTreeSet<RepId>>> = Vec::new();
        for face in &drawn {
            if !residents.iter().any(|known| Arc::ptr_eq(known, &face.residents)) {
                residents.push(&face.residents);
            }
        }
        let items: Vec<Item> = list
            .items
            .iter()
            .filter(|item| !is_in_maps(tree, shown, &self.settings, &residents, item))
            .cloned()
            .collect();
        self.counts.left_out = list.items.len() - items.len();
        self.counts.maps_drawn = vertices.len();
        Some(DrawList { items, faces: drawn.iter().flat_map(|face| &face.numbers).copied().collect() })
    }
}

/// Whether an item is far from a cell and was resident whenever a face of its maps was chosen: then they show its place.
fn is_in_maps(
    tree: &LodTree,
    cell: Cell,
    settings: &EnvironmentSettings,
    residents: &[&Arc<BTreeSet<RepId>>],
    item: &Item,
) -> bool {
    cell.is_far(&reach(tree, item.rep), settings.side, settings.distance())
        && residents.iter().all(|residents| residents.contains(&item.rep))
}

fn short_of_memory(bytes: u64, least: u64) -> String {
    let [bytes, least] = [bytes, least].map(|bytes| bytes as f64 / 1e6);
    format!("no environment maps: {bytes:.1} MB of memory are left for them; expected at least {least:.1} MB")
}

/// The box that a representation's samples lie in: coarse ones lie beside what they show by as much as its error.
fn reach(tree: &LodTree, rep: RepId) -> Aabb {
    let (bounds, error) = (tree.bounds(tree.node_of(rep)), tree.error(rep));
    Aabb { min: bounds.min - error, max: bounds.max + error }
}

#[cfg(test)]
mod tests;
