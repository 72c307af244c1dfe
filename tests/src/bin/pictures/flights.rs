//! Flights through worlds, as the viewer draws them.

use clap::Parser;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::policy::specification::PolicySpec;
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_scheduler::units::Time;
use foresight_tests::stored::Fault;
use foresight_traces::arguments::{self, PathArgs};
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{Flight, TICKS_PER_SECOND};
use foresight_traces::link::LinkTrace;
use foresight_viewer::draw::choose::{ChooseSettings, choose};
use foresight_viewer::draw::list::DrawList;
use foresight_viewer::gpu::{GpuSettings, Light, Picture, RenderSettings};
use foresight_viewer::headless::{Against, Headless, Shown, Summary, fly};
use foresight_viewer::offscreen::Offscreen;
use foresight_viewer::scene::source::Source;
use std::collections::BTreeSet;

/// Round trip of the made links.
const RTT: Time = Time(40_000_000);

#[derive(Parser)]
struct Words {
    #[command(flatten)]
    path: PathArgs,
}

/// A flight in its world, opened.
pub(crate) struct Scene {
    /// World and path in a few words.
    pub(crate) name: String,
    pub(crate) world: foresight_index::world::World,
    pub(crate) source: Source,
    pub(crate) flight: Flight,
    /// Whether the sun shines: light and shadow are not in the colours.
    pub(crate) is_lit: bool,
}

/// A policy on a link, to be flown.
#[derive(Clone, Copy)]
pub(crate) struct Run<'a> {
    pub(crate) policy: &'a str,
    pub(crate) link: &'a LinkTrace,
    /// Bytes.
    pub(crate) memory: u64,
    pub(crate) against: Against,
    pub(crate) choose: ChooseSettings,
    /// Pictures a second; divides 60.
    pub(crate) rate: u64,
    /// Everything is resident.
    pub(crate) everything: bool,
}

impl Scene {
    /// `world` is what a command line names, `path` is as `--path` has it, the built-in flight if
    /// empty, and `words` are its options, such as `--place`.
    pub(crate) fn open(name: String, world: &str, path: &str, words: &str, size: [u32; 2]) -> Result<Scene, Fault> {
        let (world, source) = Source::open(world).map_err(|error| Fault::new(&name, error))?;
        if let Some(why) = source.refusal() {
            return Err(Fault::new(&name, why));
        }
        let args = Words::try_parse_from(std::iter::once("path").chain(words.split_whitespace()));
        let args = args.map_err(|error| Fault::new(&name, error))?.path;
        let path = arguments::open_path(Some(path).filter(|path| !path.is_empty()), &args)
            .map_err(|error| Fault::new(&name, format!("{error:#}")))?;
        let mut flight = arguments::place(&path, &world, false, &args)
            .map_err(|error| Fault::new(&name, format!("{error:#}")))?
            .flight;
        flight.views.iter_mut().for_each(|view| view.viewport = size);
        Ok(Scene { name, world, source, flight, is_lit: false })
    }

    /// Adapter and renderer for it.
    pub(crate) fn offscreen(&self) -> Result<Offscreen<'_>, Fault> {
        let light = if self.is_lit { Offscreen::sun(&self.world) } else { Light::Unlit };
        let settings = RenderSettings { light, ..Offscreen::settings(&self.world, &self.source) };
        Offscreen::new(&self.world, &self.source, &GpuSettings::default(), settings).map_err(|e| Fault::new("GPU", e))
    }

    /// A constant link whose bytes over the flight are those of all that would be drawn if everything were resident, divided
    /// by `rho`: 1 is matched, above 2 is starved.
    pub(crate) fn link(&self, rho: f64) -> Result<LinkTrace, Fault> {
        let tree = &self.world.tree;
        let every: BTreeSet<RepId> = (0..tree.representations() as u32).map(RepId).collect();
        let mut needed = BTreeSet::new();
        let mut list = DrawList::default();
        for view in self.flight.views.iter().step_by(TICKS_PER_SECOND as usize / 2) {
            choose(&self.world, &every, view, &ChooseSettings::default(), &mut list);
            needed.extend(list.items.iter().map(|item| item.rep));
        }
        let needed: u64 = needed.iter().map(|&rep| tree.wire_bytes(rep)).sum();
        let bits = (8.0 * needed as f64 / (rho * self.flight.duration().secs())).clamp(1e4, 1e10);
        let name = format!("{:.2} Mbit/s", bits / 1e6);
        LinkTrace::constant(&name, bits as u64, RTT).map_err(|error| Fault::new(&self.name, error))
    }

    /// Flies; `each` is shown every picture. References are kept in `references` from one flight to the next.
    pub(crate) fn fly(
        &self,
        run: &Run,
        offscreen: &mut Offscreen,
        references: &mut Vec<Picture>,
        mut each: impl FnMut(&Shown),
    ) -> Result<Summary, Fault> {
        let mut policies = PolicySpec::parse_list(run.policy, 0.7, None).map_err(|e| Fault::new(run.policy, e))?;
        policies.iter_mut().for_each(|policy| policy.settings.reach.up = self.world.up);
        let policy = policies.first().ok_or_else(|| Fault::new(run.policy, "no policy; expected one"))?;
        let headless = Headless {
            world: &self.world,
            flight: &self.flight,
            link: run.link,
            policy,
            scheduler: SchedulerSettings::with_budget(run.memory),
            client: ClientSettings::default(),
            everything: run.everything,
            against: run.against,
            choose: run.choose,
            environment: None,
            ticks_per_picture: TICKS_PER_SECOND / run.rate,
        };
        let flown = fly(&headless, offscreen, Some(references), &mut |shown| {
            each(shown);
            Ok(())
        });
        flown.map_err(|error| Fault::new(format!("{}, {}", self.name, run.policy), error))
    }
}
