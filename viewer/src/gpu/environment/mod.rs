//! Environment maps on the GPU: what is far is drawn from six depth images at each of four points around the viewpoint
//! instead of from its own contents (\[DRVW\] §6). Which maps there are, which are drawn and what is far is said in
//! [`crate::draw::environment`].
//!
//! A face is drawn by the renderer itself, as any picture is, from what [`choose_in`] chooses there: orthoviews and triangles
//! that reach out of the map's cube, lit, one sample a pixel. Its near plane is the cube's face, so its six faces show what
//! is outside of the cube and nothing else. It is kept as colours and 16-bit reciprocals of distances, cut to what it
//! shows, and drawn as an orthoview is: tile by tile, culled by view and by occlusion.
//!
//! Faces are made one at a time, in steps between frames: at most [`EnvironmentSettings::points_per_frame`] points into the
//! face; its counts, for which nobody waits, a frame or two later; then the cut. \[DRVW\] composed on threads of the CPU, because
//! the GPU was at its limit and the work came all at once. Here contents are on the GPU only, and the budget is what
//! keeps frames short.
//!
//! What is far is left out of the list only if it was resident when each face of the four maps was chosen: then
//! [`choose_in`] shows its place in all of them. So what comes later is drawn by itself until the maps are made anew, and what
//! has gone is still seen in them. Another light or shape of splats makes all maps worthless at once. Memory is what the
//! caller has left: maps of the cell before go first, then all, and everything is drawn by itself.

mod maker;

use super::device::GpuError;
use super::renderer::Renderer;
use super::settings::{Light, SplatShape};
use crate::draw::choose::{ChooseSettings, choose_in};
use crate::draw::environment::{Cell, EnvironmentSettings, Vertex, face_side, missing};
use crate::draw::list::{DrawList, Item};
use foresight_scheduler::lod_tree::{Aabb, LodTree, RepId};
use foresight_scheduler::view::View;
use maker::{Maker, Making, Step, cube, face_view, scratch_bytes};
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
    /// Maps that are drawn: four, or none while they are made.
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
    /// Of its splats, if it shows anything.
    number: Option<u32>,
    bytes: u64,
    list: Vec<Item>,
    /// What is resident and was, or would be chosen likewise.
    residents: Arc<BTreeSet<RepId>>,
}

type Faces = [Option<Face>; 6];

/// The environment maps of a renderer. With its device they are lost, and made again with the next.
#[derive(Debug)]
pub struct Environment {
    settings: EnvironmentSettings,
    maker: Option<Maker>,
    maps: BTreeMap<Vertex, Faces>,
    making: Option<Making>,
    /// Whose maps are made.
    cell: Option<Cell>,
    /// Whose maps are all there.
    shown: Option<Cell>,
    look: Option<(SplatShape, Light)>,
    residents: Arc<BTreeSet<RepId>>,
    next_number: u32,
    counts: EnvironmentCounts,
    /// Bytes that there have to be before it is tried again.
    retry_bytes: u64,
}

/// What maps are made of.
#[derive(Clone, Copy)]
pub struct Surroundings<'a> {
    /// The world's.
    pub tree: &'a LodTree,
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
            retry_bytes: 0,
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
        let faces = self.maps.values().flatten().flatten().map(|face| face.bytes).sum::<u64>();
        faces + self.maker.as_ref().map_or(0, Maker::bytes)
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
        self.counts.faces = self.maps.values().flatten().flatten().count();
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
        let least = scratch_bytes(face_side(view.pixels_per_radian())).max(self.retry_bytes);
        (share.bytes < least).then(|| {
            format!(
                "no environment maps: {:.1} MB of memory are left for them; expected at least {:.1} MB",
                share.bytes as f64 / 1e6,
                least as f64 / 1e6
            )
        })
    }

    /// Lets all maps go but those at vertices that are kept.
    fn forget(&mut self, renderer: &mut Renderer, keeps: impl Fn(&Vertex) -> bool) {
        self.maps.retain(|vertex, faces| {
            let kept = keeps(vertex);
            if !kept {
                for number in faces.iter().flatten().filter_map(|face| face.number) {
                    renderer.faces.remove(&number);
                }
            }
            kept
        });
        if self.making.as_ref().is_some_and(|making| !keeps(&making.vertex)) {
            self.making = None;
        }
        if self.shown.is_some_and(|cell| !self.is_complete(cell)) {
            self.shown = None;
        }
    }

    fn is_complete(&self, cell: Cell) -> bool {
        let is_whole = |faces: &Faces| faces.iter().all(Option::is_some);
        cell.vertices().iter().all(|vertex| self.maps.get(vertex).is_some_and(is_whole))
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
                self.making = self.next(&around, cell, at, &mut checks);
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
                Step::Done(splats) => {
                    self.finish(renderer, splats);
                    self.fit(renderer, cell, share.bytes);
                    // Cutting is a step of its own.
                    if !share.waits {
                        break;
                    }
                }
            }
            renderer.faults.check("environment maps")?;
        }
        if self.shown != Some(cell) && self.is_complete(cell) {
            self.shown = Some(cell);
            let kept = cell.vertices();
            self.forget(renderer, |vertex| kept.contains(vertex));
        }
        self.fit(renderer, cell, share.bytes);
        Ok(())
    }

    /// Takes a face that is made.
    fn finish(&mut self, renderer: &mut Renderer, splats: Option<Box<super::splats::Splats>>) {
        let Some(Making { vertex, face, list, residents, .. }) = self.making.take() else { return };
        let bytes = splats.as_ref().map_or(0, |splats| splats.bytes);
        let number = splats.map(|splats| {
            let number = self.next_number;
            self.next_number = self.next_number.wrapping_add(1);
            renderer.faces.insert(number, *splats);
            number
        });
        let made = Face { number, bytes, list, residents };
        let faces = self.maps.entry(vertex).or_default();
        let old = faces[face].replace(made);
        self.counts.faces_made += 1;
        self.counts.maps_made += u64::from(old.is_none() && faces.iter().all(Option::is_some));
        if let Some(number) = old.and_then(|old| old.number) {
            renderer.faces.remove(&number);
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
            self.retry_bytes = (self.bytes() as f64 * RETRY) as u64;
            self.clear(renderer);
        }
    }

    /// The face to be made next: of a map that is not whole, the nearest first; else one whose contents have changed.
    fn next(&mut self, around: &Surroundings<'_>, cell: Cell, at: glam::DVec3, checks: &mut usize) -> Option<Making> {
        let whole = |faces: &Faces| faces.iter().all(Option::is_some);
        let held: BTreeSet<Vertex> = self.maps.iter().filter(|(_, faces)| whole(faces)).map(|(v, _)| *v).collect();
        if let Some(&vertex) = missing(cell, &held, at, self.settings.side).first() {
            let face = self.maps.get(&vertex).and_then(|faces| faces.iter().position(Option::is_none)).unwrap_or(0);
            let list = self.choose(around, vertex, face);
            return Some(Making::new(vertex, face, list, self.residents.clone()));
        }
        for vertex in cell.vertices() {
            for face in 0..6 {
                let Some(Some(known)) = self.maps.get(&vertex).map(|faces| &faces[face]) else { continue };
                if Arc::ptr_eq(&known.residents, &self.residents) {
                    continue;
                }
                if *checks == 0 {
                    return None;
                }
                *checks -= 1;
                let list = self.choose(around, vertex, face);
                let residents = self.residents.clone();
                let Some(Some(known)) = self.maps.get_mut(&vertex).map(|faces| &mut faces[face]) else { continue };
                if known.list == list {
                    known.residents = residents;
                } else {
                    return Some(Making::new(vertex, face, list, residents));
                }
            }
        }
        None
    }

    /// What a face shows: what is chosen in its view, without what lies in the map's cube.
    fn choose(&self, around: &Surroundings<'_>, vertex: Vertex, face: usize) -> Vec<Item> {
        let Some(maker) = &self.maker else { return Vec::new() };
        let view = face_view(vertex, face, &self.settings, maker.side);
        let settings = ChooseSettings { bias: maker.bias, ..*around.choose };
        let mut list = DrawList::default();
        choose_in(around.tree, &self.residents, &view, &settings, &mut list);
        let cube = cube(vertex, &self.settings);
        list.items.retain(|item| {
            let bounds = reach(around.tree, item.rep);
            !(bounds.min.cmpgt(cube.min).all() && bounds.max.cmplt(cube.max).all())
        });
        list.items
    }

    /// The list with faces in place of what is far; `None` while there are none.
    fn far(&mut self, tree: &LodTree, view: &View, list: &DrawList) -> Option<DrawList> {
        let shown = self.shown?;
        let EnvironmentSettings { side, .. } = self.settings;
        let distance = self.settings.distance();
        let drawn: Vec<&Face> = shown
            .tetrahedron(view.position, side)
            .iter()
            .filter_map(|vertex| self.maps.get(vertex))
            .flatten()
            .flatten()
            .collect();
        // Most faces share what was resident.
        let mut residents: Vec<&Arc<BTreeSet<RepId>>> = Vec::new();
        for face in &drawn {
            if !residents.iter().any(|known| Arc::ptr_eq(known, &face.residents)) {
                residents.push(&face.residents);
            }
        }
        let is_in_maps = |item: &Item| {
            shown.is_far(&reach(tree, item.rep), side, distance)
                && residents.iter().all(|residents| residents.contains(&item.rep))
        };
        let items: Vec<Item> = list.items.iter().filter(|item| !is_in_maps(item)).cloned().collect();
        self.counts.left_out = list.items.len() - items.len();
        self.counts.maps_drawn = 4;
        Some(DrawList { items, faces: drawn.iter().filter_map(|face| face.number).collect() })
    }
}

/// The box that a representation's samples lie in: coarse ones lie beside what they show by as much as its error.
fn reach(tree: &LodTree, rep: RepId) -> Aabb {
    let (bounds, error) = (tree.bounds(tree.node_of(rep)), tree.error(rep));
    Aabb { min: bounds.min - error, max: bounds.max + error }
}
