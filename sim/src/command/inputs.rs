//! Worlds, paths and links as named on the command line.

use anyhow::{Context, bail};
use clap::Args;
use foresight_index::world::{self, World};
use foresight_scheduler::view::View;
use foresight_sim::flight::Flight;
use foresight_sim::link::{self, LinkTrace};
use foresight_sim::path::{self, Axis, CameraAxes, CameraPath, Placement, QuatOrder, parse::Options, place::Site};
use std::path::Path;

/// How a path is read and put into the world; shared by `replay` and `inspect`.
#[derive(Clone, Debug, Args)]
pub(crate) struct PathArgs {
    /// The camera's forward and up axes in the recording, such as -y/+z; found from the motion if not given
    #[arg(long, value_name = "FORWARD/UP", allow_hyphen_values = true)]
    camera_axes: Option<CameraAxes>,
    /// Order of the quaternions' components: xyzw or wxyz; found from the motion if not given
    #[arg(long, value_name = "ORDER")]
    quat_order: Option<QuatOrder>,
    /// Up of the frame that the recording's positions are in, such as +z
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    path_up: Option<Axis>,
    /// Where the path goes: geo, or centre,height=2,yaw=0,scale=1 (its middle that many metres above the ground under
    /// the world's centre, turned by degrees, scaled). The built-in path stands in the built-in world as it is
    #[arg(long, value_name = "PLACE")]
    place: Option<Placement>,
    /// Vertical field of view, degrees
    #[arg(long, default_value_t = 60.0, value_name = "DEGREES")]
    fov: f64,
    /// Viewport, pixels
    #[arg(long, default_value = "1920x1080", value_name = "WxH", value_parser = viewport)]
    viewport: [u32; 2],
    /// Begin this many seconds into the path
    #[arg(long, default_value_t = 0.0, value_name = "SECONDS")]
    from: f64,
    /// Replay this many seconds; to the end of the path if not given
    #[arg(long, value_name = "SECONDS")]
    duration: Option<f64>,
    /// Replay no more than this many seconds of what --duration says
    #[arg(long, value_name = "SECONDS")]
    at_most: Option<f64>,
    /// Begin again when the path ends before the duration
    #[arg(long = "loop", requires = "duration")]
    looped: bool,
}

impl Default for PathArgs {
    fn default() -> PathArgs {
        PathArgs {
            camera_axes: None,
            quat_order: None,
            path_up: None,
            place: None,
            fov: 60.0,
            viewport: [1920, 1080],
            from: 0.0,
            duration: None,
            at_most: None,
            looped: false,
        }
    }
}

fn viewport(text: &str) -> Result<[u32; 2], String> {
    let side = |s: &str| s.parse::<u32>().ok().filter(|n| (1..=65_536).contains(n));
    match text.split_once('x').map(|(w, h)| (side(w), side(h))) {
        Some((Some(w), Some(h))) => Ok([w, h]),
        _ => Err(format!("`{text}`; expected WIDTHxHEIGHT in pixels, such as 1920x1080")),
    }
}

/// A world with the name under which it was asked for.
pub(crate) fn open_world(name: Option<&str>) -> anyhow::Result<(String, World)> {
    match name {
        None => Ok(("built-in city".to_owned(), world::built_in_city())),
        Some(name) => Ok((name.to_owned(), world::open(Path::new(name))?)),
    }
}

/// The built-in link, or what `spec` says.
pub(crate) fn open_link(spec: Option<&str>) -> anyhow::Result<LinkTrace> {
    Ok(match spec {
        None => link::built_in(),
        Some(spec) => link::parse::from_specification(spec)?,
    })
}

/// The built-in flight, `steady` or `turn` with `:speed=M/S,duration=S`, or a file.
pub(crate) fn open_path(name: Option<&str>, args: &PathArgs) -> anyhow::Result<CameraPath> {
    let Some(name) = name else { return Ok(path::built_in()) };
    let kind = name.split(':').next().unwrap_or_default();
    if !matches!(kind, "steady" | "turn") || Path::new(name).exists() {
        let options = Options { camera_axes: args.camera_axes, quat_order: args.quat_order, up: args.path_up };
        return Ok(path::parse::from_file(Path::new(name), &options)?);
    }
    let (mut speed, mut duration) = (5.0, 60.0);
    for option in name.split_once(':').map_or("", |(_, rest)| rest).split(',').filter(|o| !o.is_empty()) {
        let expected = || format!("path `{name}`: `{option}`; expected speed=METRES_PER_SECOND or duration=SECONDS");
        let (key, value) = option.split_once('=').with_context(expected)?;
        let value: f64 = value.parse().ok().filter(|v: &f64| v.is_finite()).with_context(expected)?;
        match key {
            "speed" => speed = value,
            "duration" => duration = value,
            _ => bail!(expected()),
        }
    }
    Ok(if kind == "steady" { path::turn::steady(speed, duration)? } else { path::turn::turn(speed, duration)? })
}

/// A path in its world, sampled.
pub(crate) struct Placed {
    /// The views.
    pub(crate) flight: Flight,
    /// How the path was put there.
    pub(crate) place: String,
}

/// Puts the path into the world and samples it. `as_is` leaves it where it is unless a placement is given.
pub(crate) fn place(path: &CameraPath, world: &World, as_is: bool, args: &PathArgs) -> anyhow::Result<Placed> {
    if !(args.fov > 0.0 && args.fov < 180.0) {
        bail!("--fov {}; expected degrees between 0 and 180", args.fov);
    }
    let placed;
    let (path, place) = if as_is && args.place.is_none() {
        (path, "as it is".to_owned())
    } else {
        let placement = args.place.unwrap_or_default();
        let bounds = world.tree.bounds(world.tree.root());
        let centre = bounds.centre();
        let ground_height =
            world.ground_height(centre).with_context(|| format!("world {}: no ground under its centre", world.name))?;
        let site = Site { centre, up: world.up, ground_height };
        placed = path::place::place(path, &placement, &site)?;
        (&placed, placement.to_string())
    };
    let length = path.duration();
    if !(args.from >= 0.0 && args.from < length) {
        bail!("--from {}; expected seconds from 0 to less than the path's {length:.3}", args.from);
    }
    let left = length - args.from;
    let duration = args.duration.unwrap_or(left);
    let duration = args.at_most.map_or(duration, |most| duration.min(most));
    if !(duration > 0.0 && duration <= 86_400.0) {
        bail!(
            "a duration of {duration} s; expected more than 0 and at most 86400 seconds (choose with --from and --duration)"
        );
    }
    if duration > left + 1e-9 && !args.looped {
        bail!("--duration {duration}; the path has {left:.3} s from there: expected at most that, or --loop");
    }
    let looped;
    let source = if args.looped {
        looped = path.looped();
        &looped
    } else {
        path
    };
    let flight = Flight::sample(duration, |t| {
        let (position, orientation) = source.at(args.from + t);
        View { position, orientation, fov_y: args.fov.to_radians(), viewport: args.viewport }
    });
    Ok(Placed { flight, place })
}

/// Notes of a world for the reader, the same kind of note folded after a few.
pub(crate) fn world_notes(world: &World, at_most: usize) -> Vec<String> {
    let mut notes: Vec<String> = world.notes.iter().take(at_most).map(ToString::to_string).collect();
    if world.notes.len() > at_most {
        notes.push(format!("… and {} more notes on this world; `inspect` lists them", world.notes.len() - at_most));
    }
    notes
}
