//! A walk into the built city, and frames of it as a window would draw them.

use crate::flights::Scene;
use crate::worlds;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::view::View;
use foresight_sim::stopwatch::Stopwatch;
use foresight_tests::stored::Fault;
use foresight_viewer::draw::choose::{ChooseSettings, choose};
use foresight_viewer::draw::list::DrawList;
use foresight_viewer::gpu::Picture;
use foresight_viewer::offscreen::Offscreen;
use glam::{DQuat, DVec3};
use std::collections::BTreeSet;
use std::path::Path;

/// The built city, to be walked through.
pub(crate) fn open(folder: &Path, small: bool) -> Result<Scene, Fault> {
    let recipes = worlds::recipes(small);
    let city = recipes.iter().find(|recipe| recipe.name.starts_with("city"));
    let city = city.ok_or_else(|| Fault::new("worlds", "no city among them"))?;
    let world = city.build(folder)?.display().to_string();
    let name = format!("{}, street", city.name);
    Scene::open(name, &world, "steady:duration=1", "--place centre,height=25", [64, 64])
}

/// Upright, `yaw` radians from east to north.
pub(crate) fn upright(position: DVec3, yaw: f64, viewport: [u32; 2]) -> View {
    let level = DQuat::from_rotation_z(yaw - core::f64::consts::FRAC_PI_2);
    let orientation = level * DQuat::from_rotation_x(core::f64::consts::FRAC_PI_2);
    View { position, orientation, fov_y: 1.0, viewport }
}

/// Along the street through the middle from west to east, 4 m above the ground, looking to and fro by `sway` radians.
pub(crate) fn walk(frames: usize, step: f64, sway: f64, viewport: [u32; 2]) -> Vec<View> {
    let view = |frame: usize| {
        let at = DVec3::new(-170.0 + step * frame as f64, STREET_Y, 4.0);
        upright(at, sway * libm::sin(0.05 * frame as f64), viewport)
    };
    (0..frames).map(view).collect()
}

/// Where the middle street of the city of four blocks lies, metres.
const STREET_Y: f64 = 0.0;

/// Everything that there is.
pub(crate) fn everything(scene: &Scene) -> BTreeSet<RepId> {
    (0..scene.world.tree.representations() as u32).map(RepId).collect()
}

/// Draws frame after frame: the list of one is what the next goes on from.
pub(crate) struct Frames<'a> {
    scene: &'a Scene,
    pub(crate) offscreen: Offscreen<'a>,
    pub(crate) list: DrawList,
}

/// A frame's picture and how long it took, choice included, loading not.
pub(crate) struct Timed {
    pub(crate) picture: Picture,
    pub(crate) seconds: f64,
}

impl<'a> Frames<'a> {
    pub(crate) fn new(scene: &'a Scene) -> Result<Frames<'a>, Fault> {
        Ok(Frames { scene, offscreen: scene.offscreen()?, list: DrawList::default() })
    }

    /// Chooses and loads; seconds for the choice.
    pub(crate) fn choose(
        &mut self,
        view: &View,
        resident: &BTreeSet<RepId>,
        settings: &ChooseSettings,
    ) -> Result<f64, Fault> {
        let start = Stopwatch::start();
        choose(&self.scene.world, resident, view, settings, &mut self.list);
        let chosen = start.nanos();
        self.offscreen.load(self.list.items.iter().map(|item| item.rep)).map_err(|e| Fault::new("GPU", e))?;
        Ok(chosen as f64 * 1e-9)
    }

    /// Draws the list.
    pub(crate) fn draw(&mut self, view: &View) -> Result<Timed, Fault> {
        let start = Stopwatch::start();
        let drawn = self.offscreen.renderer().picture(view, &self.list);
        let seconds = start.nanos() as f64 * 1e-9;
        let (picture, _) = drawn.map_err(|e| Fault::new("GPU", e))?;
        Ok(Timed { picture, seconds })
    }

    /// Samples of the list's orthoviews.
    pub(crate) fn points(&mut self) -> u64 {
        let renderer = self.offscreen.renderer();
        let of = |points: &[u32; 16]| points.iter().map(|&points| u64::from(points)).sum::<u64>();
        self.list.items.iter().filter_map(|item| renderer.tile_points(item.rep)).map(of).sum()
    }
}
