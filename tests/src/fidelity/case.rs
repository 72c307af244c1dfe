//! What is replayed on both sides.

use std::path::{Path, PathBuf};

use foresight_index::world::{self, World};
use foresight_scheduler::benefit::coverage::Refinement;
use foresight_scheduler::benefit::frustum::Frustum;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::policy::specification::PolicySpec;
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_sim::future;
use foresight_sim::replay::{ReplayError, Stage, replay};
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{Flight, TICKS_PER_SECOND};
use foresight_traces::link::{self, LinkTrace};
use foresight_traces::path::{self, CameraPath, Placement, place::Site};
use glam::DVec3;

use super::{Ask, Asked};
use crate::input;

/// The viewport that errors on the screen refer to.
const VIEWPORT: [u32; 2] = [1920, 1080];
/// Vertical field of view, degrees.
const FOV_Y_DEG: f64 = 60.0;

/// Concurrent streams that a server should allow at least (RFC 9113, 6.5.2).
const HTTP_2: usize = 100;
/// Connections to a host that Chromium opens over HTTP/1.1.
const HTTP_1: usize = 6;

/// What is replayed.
pub struct Case {
    /// What to call it.
    pub name: String,
    /// The world.
    pub world: World,
    /// Where the contents' files are; `None` where contents are made up.
    folder: Option<PathBuf>,
    /// The camera.
    pub flight: Flight,
    /// The link.
    pub link: LinkTrace,
    /// Memory, bytes.
    pub budget: u64,
    /// What the browser's connection carries at once: 6 over HTTP/1.1, 100 over HTTP/2 as recommended.
    pub streams: usize,
    client: ClientSettings,
}

/// Why there is no case.
#[derive(Debug, thiserror::Error)]
pub enum CaseError {
    /// No such policy.
    #[error(transparent)]
    Policy(#[from] foresight_scheduler::policy::specification::PolicySpecError),
    /// The replay failed.
    #[error("policy {policy}: {source}")]
    Replay {
        /// Which.
        policy: String,
        /// Why.
        #[source]
        source: ReplayError,
    },
    /// The world cannot be opened.
    #[error(transparent)]
    World(#[from] world::WorldError),
    /// No path.
    #[error(transparent)]
    Path(#[from] path::PathError),
    /// No link.
    #[error(transparent)]
    Link(#[from] link::LinkError),
    /// There is nothing to stand on.
    #[error("world {0}: no ground under its centre")]
    Ground(String),
}

/// What the policy did.
pub(super) struct Replayed {
    pub(super) requests: Vec<Asked>,
    pub(super) cancelled: u64,
}

/// The cases: the built-in city, and, with a folder of recorded data, Dingo Gap on Mars with recorded links.
pub fn cases(data: Option<&Path>) -> Result<Vec<Case>, CaseError> {
    let mut cases = vec![city("city, 8 Mbit/s", "constant:8Mbit,40ms", 256 << 20)?];
    if let Some(data) = data {
        let file = |name: &str| data.join("network").join(name).display().to_string();
        let norway = format!("{},rtt=80", file("norway3g_car_10.txt"));
        cases.push(city("city, 3G by car", &norway, 256 << 20)?);
        let mars =
            |name: &str, link: &str, budget: u64| mars(name, &data.join("scenes/mars_dingo_gap_3dtiles"), link, budget);
        cases.push(mars("Dingo Gap, 8 Mbit/s", "constant:8Mbit,40ms", 256 << 20)?);
        let over_http_1 = mars("Dingo Gap, 8 Mbit/s, HTTP/1.1", "constant:8Mbit,40ms", 256 << 20)?;
        cases.push(Case { streams: HTTP_1, ..over_http_1 });
        cases.push(mars("Dingo Gap, 3G by car", &norway, 256 << 20)?);
        cases.push(mars("Dingo Gap, 8 Mbit/s, 32 MiB", "constant:8Mbit,40ms", 32 << 20)?);
    }
    Ok(cases)
}

/// The first 24 s of the built-in flight over the built-in city, whose contents are made up: decoding takes no time.
fn city(name: &str, link: &str, budget: u64) -> Result<Case, CaseError> {
    let client = ClientSettings { decode_rate: 1e12, upload_bytes_per_tick: 1 << 40, ..ClientSettings::default() };
    Ok(Case {
        name: name.to_owned(),
        world: world::built_in_city(),
        folder: None,
        flight: sample(&path::built_in(), 24.0),
        link: link::parse::from_specification(link)?,
        budget,
        streams: HTTP_2,
        client,
    })
}

/// 15 m/s at 15 m above the ground of a real tileset for 12 s, half a turn within a second, and back.
fn mars(name: &str, folder: &Path, link: &str, budget: u64) -> Result<Case, CaseError> {
    let world = world::open(folder)?;
    let centre = world.tree.bounds(world.tree.root()).centre();
    let ground_height = world.ground_height(centre).ok_or_else(|| CaseError::Ground(world.name.clone()))?;
    let placement = Placement::Centre { height: 15.0, yaw: 0.0, scale: 1.0 };
    let site = Site { centre, up: world.up, ground_height };
    let placed = path::place::place(&path::turn::turn(15.0, 24.0)?, &placement, &site)?;
    Ok(Case {
        name: name.to_owned(),
        flight: sample(&placed, 24.0),
        world,
        folder: Some(folder.to_owned()),
        link: link::parse::from_specification(link)?,
        budget,
        streams: HTTP_2,
        client: ClientSettings::default(),
    })
}

fn sample(path: &CameraPath, duration_s: f64) -> Flight {
    Flight::sample(duration_s, |t| {
        let (position, orientation) = path.at(t);
        View { position, orientation, fov_y: FOV_Y_DEG.to_radians(), viewport: VIEWPORT }
    })
}

impl Case {
    /// The camera's vertical field of view, degrees.
    pub(super) fn fov_y_deg(&self) -> f64 {
        FOV_Y_DEG
    }

    /// Height of the ground under the world's centre, metres along up.
    pub(super) fn ground(&self) -> f64 {
        self.world.ground_height(self.world.tree.bounds(self.world.tree.root()).centre()).unwrap_or(0.0)
    }

    /// Replays a policy with its options.
    pub(super) fn replay(&self, policy: &str) -> Result<Replayed, CaseError> {
        let spec = PolicySpec::parse_list(policy, 0.7, None)?.swap_remove(0);
        let tree = &self.world.tree;
        let cuts = self.flight.cuts(tree, &Default::default());
        let refinement = Refinement::Atomic;
        let stage = Stage {
            tree,
            flight: &self.flight,
            cuts: &cuts,
            link: &self.link,
            link_start: Time::ZERO,
            client: self.client,
            scheduler: SchedulerSettings { refinement, ..SchedulerSettings::with_budget(self.budget) },
            preloaded: &[],
        };
        let run = replay(stage, future::build(&spec, tree, &self.flight, &self.link, Time::ZERO))
            .map_err(|source| CaseError::Replay { policy: policy.to_owned(), source })?;
        let requests = run.requests.iter().map(|r| Asked { at_s: r.at.secs(), rep: r.rep }).collect();
        Ok(Replayed { requests, cancelled: run.cancellations })
    }

    /// What a content's address gives: the file, or made-up bytes of the same number. `None` if there is none.
    pub(super) fn content(&self, rep: RepId) -> Option<Vec<u8>> {
        if rep.index() >= self.world.tree.representations() {
            return None;
        }
        match &self.folder {
            Some(folder) => std::fs::read(folder.join(&*self.world.uri(rep))).ok(),
            None => {
                let bounds = self.world.tree.bounds(self.world.tree.node_of(rep));
                let corner = |v: DVec3| v.to_array().map(|x| x as f32);
                let least = input::glb(corner(bounds.min), corner(bounds.max));
                Some(input::padded_glb(least, self.world.tree.wire_bytes(rep) as usize))
            }
        }
    }

    /// A request as a reader understands it.
    pub(super) fn describe(&self, asked: &Asked, others_place: Option<usize>) -> Ask {
        let tree = &self.world.tree;
        let node = tree.node_of(asked.rep);
        let tick = (asked.at_s * TICKS_PER_SECOND as f64) as usize;
        let view = &self.flight.views[tick.min(self.flight.views.len() - 1)];
        let away = ((tree.centre(node) - view.position).abs() - tree.half(node)).max(DVec3::ZERO).length();
        let error = tree.error(asked.rep) * Frustum::new(view).pixels_per_radian / away;
        Ask {
            tile: self.world.uri(asked.rep).into_owned(),
            at_s: asked.at_s,
            depth: tree.ancestors(node).count() - 1,
            error_px: (away > 0.0).then_some(error),
            distance_m: away,
            others_place,
        }
    }
}
