//! Pictures of a world with a given set resident. Contents are decoded and uploaded when a picture first needs them, which
//! on a virtual clock is the same as having had them.

use crate::draw::choose::{ChooseSettings, choose};
use crate::draw::environment::EnvironmentSettings;
use crate::draw::list::DrawList;
use crate::gpu::{Environment, EnvironmentCounts, FrameCounts, Gpu, GpuError, GpuSettings, Light, Picture};
use crate::gpu::{RenderSettings, Renderer, Share, Surroundings};
use crate::scene::compress::Compression;
use crate::scene::content::Content;
use crate::scene::decode::decode;
use crate::scene::source::Source;
use foresight_index::world::World;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::view::View;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Of pictures: four bytes a pixel, red first.
pub const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;

/// Beyond so many bytes on the GPU what the last picture did not need goes.
const GPU_BYTES_MAX: u64 = 2 << 30;

/// Decoded at a time.
const BATCH: usize = 16;

/// Draws a world off screen.
pub struct Offscreen<'a> {
    world: &'a World,
    source: &'a Source,
    renderer: Renderer,
    environment: Option<Environment>,
    adapter: String,
    compression: Compression,
    /// What cannot be shown, and why.
    broken: BTreeMap<RepId, String>,
}

impl<'a> Offscreen<'a> {
    /// Opens an adapter.
    ///
    /// # Errors
    /// None that would do.
    pub fn new(
        world: &'a World,
        source: &'a Source,
        gpu: &GpuSettings,
        settings: RenderSettings,
    ) -> Result<Offscreen<'a>, GpuError> {
        let gpu = Gpu::open(gpu)?;
        let renderer = Renderer::new(&gpu, settings, FORMAT);
        let (adapter, compression) = (gpu.name(), Compression::None);
        Ok(Offscreen { world, source, renderer, environment: None, adapter, compression, broken: BTreeMap::new() })
    }

    /// The default settings with the sky of this world and four samples a pixel: what is finer than a pixel would make even
    /// equal scenes unlike.
    pub fn settings(world: &World, source: &Source) -> RenderSettings {
        let background = source.sky(world).background(world.up);
        RenderSettings { background, samples: 4, ..RenderSettings::default() }
    }

    /// A sun that stands high over this world, to one side.
    pub fn sun(world: &World) -> Light {
        let (across, along) = world.up.any_orthonormal_pair();
        let towards = (world.up + 0.6 * across + 0.35 * along).normalize_or(world.up);
        Light::Sun { towards, ambient: 0.35 }
    }

    /// Contents that are decoded from now on are compressed so, as far as the adapter has textures of blocks.
    pub fn set_compression(&mut self, compression: Compression) {
        self.compression = self.renderer.compression(compression);
    }

    /// The adapter's name.
    pub fn adapter(&self) -> &str {
        &self.adapter
    }

    /// How things are drawn, to be changed for the pictures to come.
    pub fn render_settings(&mut self) -> &mut RenderSettings {
        self.renderer.settings()
    }

    /// What could not be decoded or uploaded so far, and why. Others were drawn in its place.
    pub fn broken(&self) -> &BTreeMap<RepId, String> {
        &self.broken
    }

    /// Draws what is chosen of `resident`, anew: nothing is held over from the picture before.
    ///
    /// # Errors
    /// A device that is lost, a picture that it does not take.
    pub fn picture(
        &mut self,
        view: &View,
        resident: &BTreeSet<RepId>,
        settings: &ChooseSettings,
    ) -> Result<(Picture, FrameCounts), GpuError> {
        let mut usable;
        let mut resident = resident;
        loop {
            if !self.broken.is_empty() {
                usable = resident.clone();
                usable.retain(|rep| !self.broken.contains_key(rep));
                resident = &usable;
            }
            let mut list = DrawList::default();
            choose(self.world, resident, view, settings, &mut list);
            let needed: BTreeSet<RepId> = list.items.iter().map(|item| item.rep).collect();
            let missing: Vec<RepId> = needed.iter().copied().filter(|&rep| !self.renderer.contains(rep)).collect();
            let before = self.broken.len();
            for batch in missing.chunks(BATCH) {
                self.take(batch)?;
            }
            // What is broken is missing in the list: another takes its place. At most as often as there are representations.
            if self.broken.len() == before {
                self.make_room(&needed);
                return self.renderer.picture(view, &list);
            }
        }
    }

    /// Environment maps for [`Offscreen::picture_with_maps`], or none any more.
    pub fn set_environment(&mut self, settings: Option<EnvironmentSettings>) {
        if let Some(environment) = &mut self.environment {
            environment.clear(&mut self.renderer);
        }
        self.environment = settings.map(Environment::new);
    }

    /// As [`Offscreen::picture`], what is far from environment maps, which are made from what is resident as far as `share`
    /// goes. All of it is uploaded.
    ///
    /// # Errors
    /// As [`Offscreen::picture`].
    pub fn picture_with_maps(
        &mut self,
        view: &View,
        resident: &BTreeSet<RepId>,
        settings: &ChooseSettings,
        share: Share,
    ) -> Result<(Picture, FrameCounts, EnvironmentCounts), GpuError> {
        self.load(resident.iter().copied())?;
        let mut usable = resident.clone();
        usable.retain(|rep| !self.broken.contains_key(rep));
        let mut list = DrawList::default();
        choose(self.world, &usable, view, settings, &mut list);
        let Some(environment) = &mut self.environment else {
            let (picture, counts) = self.renderer.picture(view, &list)?;
            return Ok((picture, counts, EnvironmentCounts::default()));
        };
        let around = Surroundings {
            tree: &self.world.tree,
            root_sample: self.world.root_sample,
            resident: &usable,
            choose: settings,
        };
        let list = environment.prepare(&mut self.renderer, around, view, &list, share)?;
        let (picture, counts) = self.renderer.picture(view, &list)?;
        Ok((picture, counts, environment.counts().clone()))
    }

    /// What draws, for frames of another kind than [`Offscreen::picture`].
    pub fn renderer(&mut self) -> &mut Renderer {
        &mut self.renderer
    }

    /// Decodes and uploads what of `reps` is not there yet.
    ///
    /// # Errors
    /// A device that is lost.
    pub fn load(&mut self, reps: impl IntoIterator<Item = RepId>) -> Result<(), GpuError> {
        let known = |rep: &RepId| self.renderer.contains(*rep) || self.broken.contains_key(rep);
        let missing: Vec<RepId> = reps.into_iter().filter(|rep| !known(rep)).collect();
        missing.chunks(BATCH).try_for_each(|batch| self.take(batch))
    }

    fn take(&mut self, batch: &[RepId]) -> Result<(), GpuError> {
        let (world, source, compression) = (self.world, self.source, self.compression);
        let content = |rep| {
            let bytes = source.bytes(world, rep).map_err(|error| error.to_string())?;
            let decoded = decode(world, source, rep, &bytes).map_err(|error| error.to_string())?;
            Ok(decoded.content.compressed(compression))
        };
        let contents: Vec<(RepId, Result<Content, String>)> =
            batch.par_iter().map(|&rep| (rep, content(rep))).collect();
        for (rep, content) in contents {
            let uploaded = match content {
                Ok(content) => self.renderer.upload(rep, &content),
                Err(reason) => {
                    self.broken.insert(rep, reason);
                    continue;
                }
            };
            match uploaded {
                Ok(_) => {}
                Err(lost @ GpuError::Lost(_)) => return Err(lost),
                Err(error) => {
                    self.broken.insert(rep, format!("{}: {error}", self.world.uri(rep)));
                }
            }
        }
        Ok(())
    }

    fn make_room(&mut self, needed: &BTreeSet<RepId>) {
        if self.renderer.gpu_bytes() > GPU_BYTES_MAX {
            let reps = (0..self.world.tree.representations() as u32).map(RepId);
            for rep in reps.filter(|rep| !needed.contains(rep)) {
                self.renderer.remove(rep);
            }
        }
    }
}
