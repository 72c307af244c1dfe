//! One frame after the other: input, camera, contents, what to draw, picture, overlay.

use super::judge::judge;
use super::player::Player;
use super::screen::{Painted, Presented, Screen};
use super::stage::Stage;
use super::{Outcome, WindowError, WindowSettings};
use crate::controls::bindings::{Action, Pressed};
use crate::controls::capture::{self, CaptureError};
use crate::controls::recorder::Recorder;
use crate::controls::rig::{Input, Mode, Rig};
use crate::draw::choose::{ChooseCounts, ChooseSettings, choose};
use crate::draw::controller::{Controller, ControllerSettings};
use crate::draw::environment::EnvironmentSettings;
use crate::draw::list::DrawList;
use crate::exchange::{Exchange, Link};
use crate::gpu::{FrameCounts, GpuError, RenderSettings, Share, Surroundings};
use crate::overlay::colours::{self, FalseColour};
use crate::overlay::{Facts, Look, show};
use crate::statistics::Histogram;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::view::View;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;
use winit::window::Window;

/// Frames whose times are shown.
const FRAMES: usize = 120;
/// How long a notice stays.
const NOTICE_NS: u64 = 8_000_000_000;
/// Notices at a time.
const NOTICES: usize = 4;
/// From one judgement of what is shown to the next.
const JUDGING_NS: u64 = 500_000_000;
/// What the bandwidth is averaged over.
const RATE_NS: u64 = 1_000_000_000;
/// Target of a frame where none is given, seconds.
const FRAME_S: f64 = 1.0 / 30.0;
/// Files that an outcome names.
const FILES_MAX: usize = 100;
/// Version of the document that is printed at the end.
const SCHEMA_VERSION: u32 = 1;

/// Everything but the window and the device.
pub(super) struct Flyer<'a> {
    settings: &'a WindowSettings,
    pub(super) pressed: Pressed,
    pub(super) player: Player,
    rig: Rig,
    fov_y: f64,
    view: View,
    look: Look,
    stage: Stage<'a>,
    list: DrawList,
    controller: Option<Controller>,
    recorder: Option<Recorder>,
    wants_picture: bool,
    facts: Facts,
    /// Text, and until when it stays.
    notices: VecDeque<(String, u64)>,
    limited: Option<String>,
    worth: BTreeMap<RepId, f64>,
    /// Environment maps made since they were last switched on, or the device opened.
    maps_made: u64,
    judged_ns: u64,
    /// Bytes received by then.
    rated: (u64, u64),
    opened_ns: u64,
    last_ns: Option<u64>,
    frame_times: Histogram,
    was_away: bool,
    is_over: bool,
    outcome: Outcome,
}

impl<'a> Flyer<'a> {
    pub(super) fn new(settings: &'a WindowSettings) -> Result<Flyer<'a>, WindowError> {
        let world = &*settings.world;
        let path = settings.path.clone().unwrap_or_default();
        let mut rig = match path.first() {
            Some(first) => Rig::at(first, settings.mode, world),
            None => Rig::overview(world),
        };
        if path.is_empty() {
            rig.set_mode(settings.mode, world);
        }
        let view = rig.view(world, settings.fov_y, settings.size.map(|side| side.max(1)));
        let now_ns = settings.clock.now_ns();
        let frame_s = settings.frame_s.unwrap_or(FRAME_S);
        Ok(Flyer {
            settings,
            pressed: Pressed::default(),
            player: Player::new(path),
            rig,
            fov_y: settings.fov_y,
            view,
            look: Look {
                holds_time: settings.frame_s.is_some(),
                maps: settings.environment.is_some(),
                ..Look::default()
            },
            stage: Stage::new(&settings.world, &settings.source, settings.contents_memory, settings.compression)?,
            list: DrawList::default(),
            controller: Controller::new(ControllerSettings::new(frame_s)).ok(),
            recorder: None,
            wants_picture: false,
            facts: Facts::default(),
            notices: VecDeque::new(),
            limited: None,
            worth: BTreeMap::new(),
            maps_made: 0,
            judged_ns: 0,
            rated: (now_ns, 0),
            opened_ns: now_ns,
            last_ns: None,
            frame_times: Histogram::default(),
            was_away: false,
            is_over: false,
            outcome: Outcome {
                schema_version: SCHEMA_VERSION,
                world: world.name.clone(),
                memory_budget: settings.memory,
                ..Outcome::default()
            },
        })
    }

    /// How things are drawn now.
    pub(super) fn render_settings(&self) -> RenderSettings {
        let up = self.settings.world.up;
        let background = self.settings.sky.background(up);
        let samples = if self.look.smooth { 4 } else { 1 };
        let (shape, light) = (self.look.shape, self.look.light(up));
        RenderSettings { shape, light, samples, background, ..RenderSettings::default() }
    }

    pub(super) fn adapter(&mut self, name: String) {
        self.facts.adapter.clone_from(&name);
        self.outcome.adapter = name;
    }

    /// What of the window is not drawn.
    pub(super) fn limited(&mut self, limited: Option<String>) {
        if let Some(limited) = limited.as_ref().filter(|_| limited != self.limited) {
            eprintln!("{limited}");
        }
        self.limited = limited;
    }

    /// Tells something for a while, on the screen and on standard error.
    pub(super) fn notice(&mut self, text: String) {
        let until_ns = self.settings.clock.now_ns() + NOTICE_NS;
        if let Some((_, until)) = self.notices.iter_mut().find(|(known, _)| *known == text) {
            *until = until_ns;
            return;
        }
        eprintln!("{text}");
        self.notices.push_back((text, until_ns));
        if self.notices.len() > NOTICES {
            self.notices.pop_front();
        }
    }

    /// Whether the window is to be closed.
    pub(super) fn is_over(&self) -> bool {
        self.is_over
    }

    pub(super) fn device_lost(&mut self, exchange: &Exchange, why: &str) {
        self.outcome.devices_lost += 1;
        self.notice(format!("The graphics device was lost ({why}); everything is made anew"));
        self.stage.device_lost(exchange, &self.view);
        self.list = DrawList::default();
        self.last_ns = None;
    }

    /// A key that does something at once.
    pub(super) fn press(&mut self, action: Action) {
        let world = &*self.settings.world;
        match action {
            Action::Fly => self.rig.set_mode(Mode::Fly, world),
            Action::Orbit => self.rig.set_mode(Mode::Orbit, world),
            Action::Walk => {
                self.rig.set_mode(Mode::Walk, world);
                if self.rig.is_groundless() {
                    self.notice("This world has no ground to walk on: flying".to_owned());
                }
            }
            Action::Overview => {
                let mode = self.rig.mode();
                self.rig = Rig::overview(world);
                if mode == Mode::Orbit {
                    self.rig.set_mode(mode, world);
                }
            }
            Action::Quicker => self.pressed.wheel(1.0),
            Action::Slower => self.pressed.wheel(-1.0),
            Action::Play => self.player.toggle(),
            Action::Record => self.record(),
            Action::Screenshot => self.wants_picture = true,
            Action::Overlay => self.look.panels = !self.look.panels,
            Action::Keys => self.look.keys = !self.look.keys,
            Action::FalseColour => self.look.false_colour = self.look.false_colour.next(),
            Action::Shape => self.look.next_shape(),
            Action::Light => self.look.lit = !self.look.lit,
            Action::LightAround => self.look.turn_sun(),
            Action::LightHigher => self.look.raise_sun(),
            Action::Samples => self.look.smooth = !self.look.smooth,
            Action::Maps => self.look.maps = !self.look.maps,
            Action::HoldTime => self.look.holds_time = !self.look.holds_time,
            _ => {}
        }
        let moves = [Action::Fly, Action::Walk, Action::Orbit, Action::Overview];
        if moves.contains(&action) {
            self.player.stop();
        }
    }

    /// Begins a recording, or ends it.
    fn record(&mut self) {
        let now_ns = self.settings.clock.now_ns();
        match self.recorder.take() {
            None => match Recorder::begin(&self.settings.captures, self.settings.world.up, now_ns) {
                Ok(recorder) => self.recorder = Some(recorder),
                Err(error) => self.notice(format!("No path is recorded: {error}")),
            },
            Some(recorder) => match recorder.finish() {
                Ok(Some(file)) => {
                    self.notice(format!("Recorded: --path {} --place world", file.display()));
                    self.wrote(file);
                }
                Ok(None) => {}
                Err(error) => self.notice(format!("The recording is not whole: {error}")),
            },
        }
    }

    fn wrote(&mut self, file: PathBuf) {
        if self.outcome.files.len() < FILES_MAX {
            self.outcome.files.push(file);
        }
    }

    /// Moves the camera by `dt` seconds.
    fn fly(&mut self, dt: f64, size: [u32; 2]) {
        let world = &*self.settings.world;
        let input = self.pressed.take();
        if input != Input::default() {
            self.player.stop();
        }
        match self.player.step(dt) {
            Some((view, is_last)) => {
                self.view = View { viewport: size, ..view };
                self.fov_y = view.fov_y;
                if is_last {
                    self.is_over = self.settings.closes;
                }
                // Where the path is left the camera goes on from there.
                let mode = self.rig.mode();
                self.rig = Rig::at(&view, if mode == Mode::Walk { Mode::Fly } else { mode }, world);
            }
            None => {
                self.rig.step(&input, dt, world);
                self.view = self.rig.view(world, self.fov_y, size);
            }
        }
    }

    /// Draws a frame; false if nobody sees it.
    pub(super) fn frame(
        &mut self,
        screen: &mut Screen,
        egui: &mut egui_winit::State,
        window: &Window,
        exchange: &Exchange,
    ) -> Result<bool, GpuError> {
        let now_ns = self.settings.clock.now_ns();
        let dt = self.last_ns.replace(now_ns).map(|last| now_ns.saturating_sub(last) as f64 * 1e-9);
        let size = screen.size();
        if !size.contains(&0) {
            self.fly(dt.unwrap_or(0.0), size);
            exchange.look(self.view);
        }
        if let Some(recorder) = &mut self.recorder {
            match recorder.push(&self.view, now_ns) {
                Ok(true) => {}
                Ok(false) => self.record(),
                Err(error) => {
                    self.recorder = None;
                    self.notice(format!("The recording has ended: {error}"));
                }
            }
        }
        *screen.renderer.settings() = self.render_settings();
        self.stage.turn(exchange, &mut screen.renderer, &self.view, self.settings.clock);
        self.tell(exchange, now_ns);
        if size.contains(&0) {
            self.last_ns = None;
            return screen.lost().map_or(Ok(false), |why| Err(GpuError::Lost(why)));
        }
        let chosen = self.choose(dt, now_ns);
        self.facts.substitutes = chosen.substitutes;
        self.facts.items = self.list.items.len();
        let drawn = self.far(screen)?;
        let painted = self.paint(egui, window);
        let presented = screen.draw(&self.view, &drawn, dt, painted)?;
        if std::mem::take(&mut self.wants_picture) {
            self.picture(screen, &drawn)?;
        }
        let Presented::Shown(counts) = presented else { return Ok(false) };
        self.count(counts, dt);
        Ok(true)
    }

    /// Puts environment maps in place of what is far, where they are wanted.
    fn far(&mut self, screen: &mut Screen) -> Result<DrawList, GpuError> {
        let tree = &self.settings.world.tree;
        let settings = self.look.maps.then(|| {
            let given = self.settings.environment;
            given.unwrap_or_else(|| EnvironmentSettings::for_world(&tree.bounds(tree.root())))
        });
        let used = self.stage.used().total();
        let bytes = self.settings.memory.saturating_sub(used);
        let share = Share { bytes, frames: 1, waits: false };
        let choose = ChooseSettings::default();
        let root_sample = self.settings.world.root_sample;
        let around = Surroundings { tree, root_sample, resident: self.stage.drawable(), choose: &choose };
        let (drawn, maps) = screen.far(settings, around, &self.view, &self.list, share)?;
        let bytes = maps.as_ref().map_or(0, |maps| maps.bytes);
        self.outcome.memory_max = self.outcome.memory_max.max(used + bytes);
        self.outcome.maps_made += maps.as_ref().map_or(0, |maps| maps.maps_made).saturating_sub(self.maps_made);
        self.maps_made = maps.as_ref().map_or(0, |maps| maps.maps_made);
        self.facts.maps = maps;
        Ok(drawn)
    }

    fn count(&mut self, counts: FrameCounts, dt: Option<f64>) {
        self.facts.counts = counts;
        self.outcome.frames += 1;
        if let Some(dt) = dt {
            self.frame_times.add((dt * 1e9) as u64);
            self.facts.frames_s.push_back(dt as f32);
            if self.facts.frames_s.len() > FRAMES {
                self.facts.frames_s.pop_front();
            }
        }
    }

    fn choose(&mut self, dt: Option<f64>, now_ns: u64) -> ChooseCounts {
        let bias = match &mut self.controller {
            Some(controller) if self.look.holds_time => dt.map_or(controller.bias(), |dt| controller.observe(dt)),
            _ => ChooseSettings::default().bias,
        };
        self.facts.bias = bias;
        let settings = ChooseSettings { bias, ..ChooseSettings::default() };
        let world = &*self.settings.world;
        let chosen = choose(world, self.stage.drawable(), &self.view, &settings, &mut self.list);
        let tree = &world.tree;
        for item in &mut self.list.items {
            item.false_colour = match self.look.false_colour {
                FalseColour::Off => None,
                FalseColour::Level => Some(colours::of_level(tree.ancestors(tree.node_of(item.rep)).count() - 1)),
                FalseColour::Age => {
                    let age_ns = self.stage.age_ns(item.rep, now_ns).unwrap_or(0);
                    Some(colours::of_age(age_ns as f64 * 1e-9))
                }
                FalseColour::Benefit => Some(colours::of_benefit(self.worth.get(&item.rep).copied().unwrap_or(0.0))),
            };
        }
        chosen
    }

    /// Gathers what the overlay tells.
    fn tell(&mut self, exchange: &Exchange, now_ns: u64) {
        let world = &*self.settings.world;
        let facts = &mut self.facts;
        facts.status = exchange.status();
        facts.addresses = facts.status.fetching.iter().map(|one| world.uri(RepId(one.rep)).into_owned()).collect();
        let (then_ns, then_bytes) = self.rated;
        if now_ns.saturating_sub(then_ns) >= RATE_NS {
            let received = facts.status.received;
            facts.rate = received.saturating_sub(then_bytes) as f64 / (now_ns.saturating_sub(then_ns) as f64 * 1e-9);
            self.rated = (now_ns, received);
        }
        if now_ns.saturating_sub(self.judged_ns) >= JUDGING_NS {
            self.judged_ns = now_ns;
            (facts.shown_quality, self.worth) = judge(world, self.stage.drawable(), &self.view);
        }
        facts.used = self.stage.used();
        facts.pending = self.stage.pending();
        facts.mode = Some(self.rig.mode());
        facts.speed = self.rig.speed();
        facts.position = self.view.position;
        facts.playing = self.player.plays().then(|| self.player.progress());
        facts.recording = self.recorder.as_ref().map(Recorder::seconds);
        let mut credits: BTreeSet<Arc<str>> = self.stage.credits(self.list.items.iter().map(|item| item.rep));
        if !self.list.items.is_empty() {
            credits.extend(self.settings.source.credit().map(Arc::from));
        }
        facts.credits = credits;
        self.notices.retain(|(_, until)| *until > now_ns);
        facts.notices = self.limited.iter().chain(self.notices.iter().map(|(text, _)| text)).cloned().collect();
        if self.stage.drawable().is_empty() && facts.status.fetching.is_empty() {
            let because = facts.status.waiting.as_ref().map(|because| format!("Nothing can be shown yet: {because}"));
            facts.notices.extend(because);
        }
        if let Some(fault) = &self.stage.fault {
            let text = format!("{} contents cannot be shown; the latest: {fault}", self.stage.broken);
            facts.notices.push(text);
        }
        facts.notices.extend(facts.maps.as_ref().and_then(|maps| maps.refused.clone()));
        let deferred = self.stage.deferred();
        if deferred > 0 {
            facts.notices.push(format!("Memory is full: {deferred} contents that are here wait for room"));
        }
        let is_away = matches!(facts.status.link, Link::Away { .. });
        if is_away && !self.was_away {
            self.outcome.server_away += 1;
            eprintln!("the server is away; connecting again");
        } else if !is_away && self.was_away {
            eprintln!("the server is back");
        }
        self.was_away = is_away;
    }

    fn paint(&mut self, egui: &mut egui_winit::State, window: &Window) -> Painted {
        let input = egui.take_egui_input(window);
        let context = egui.egui_ctx().clone();
        let (facts, look) = (&self.facts, &mut self.look);
        let output = context.run_ui(input, |ui| show(ui.ctx(), facts, look));
        egui.handle_platform_output(window, output.platform_output);
        let shapes = context.tessellate(output.shapes, output.pixels_per_point);
        Painted { textures: output.textures_delta, shapes, pixels_per_point: output.pixels_per_point }
    }

    /// Writes the picture as it is, without what is painted over it.
    fn picture(&mut self, screen: &mut Screen, list: &DrawList) -> Result<(), GpuError> {
        let picture = match screen.picture(&self.view, list) {
            Ok(picture) => picture,
            Err(lost @ GpuError::Lost(_)) => return Err(lost),
            Err(error) => {
                self.notice(format!("No screenshot: {error}"));
                return Ok(());
            }
        };
        let written: Result<PathBuf, CaptureError> =
            capture::screenshot(&self.settings.captures, picture.size, &picture.rgba);
        match written {
            Ok(file) => {
                self.notice(format!("Screenshot: {}", file.display()));
                self.wrote(file);
            }
            Err(error) => self.notice(format!("No screenshot: {error}")),
        }
        Ok(())
    }

    /// What came of it.
    pub(super) fn finish(mut self, exchange: &Exchange) -> Outcome {
        if self.recorder.is_some() {
            self.record();
        }
        let status = exchange.status();
        let frame_ms = self.frame_times.percentiles().p50;
        Outcome {
            policy: status.policy,
            seconds: self.settings.clock.now_ns().saturating_sub(self.opened_ns) as f64 * 1e-9,
            frame_ms,
            shown: self.stage.shown,
            broken: self.stage.broken,
            bytes_received: status.received,
            memory_max: self.stage.used_max().max(self.outcome.memory_max),
            ..self.outcome
        }
    }
}
