//! Worlds, paths and links as named on the command line.

use crate::flight::Flight;
use crate::link::{self, LinkTrace};
use crate::path::{self, Axis, CameraAxes, CameraPath, Look, Placement, QuatOrder};
use crate::path::{head::Head, look, parse::Options, recording::Sample};
use anyhow::{Context, bail};
use clap::Args;
use foresight_index::specification::{self, Progress};
use foresight_index::world::{self, World};
use foresight_scheduler::view::View;
use std::io::IsTerminal;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// How a path is read and put into the world; shared by `replay` and `inspect`.
#[derive(Clone, Debug, Args)]
pub struct PathArgs {
    /// The camera's forward and up axes in the recording, such as -y/+z; found from the motion if not given
    #[arg(long, value_name = "FORWARD/UP", allow_hyphen_values = true)]
    camera_axes: Option<CameraAxes>,
    /// Order of the quaternions' components: xyzw or wxyz; found from the motion if not given
    #[arg(long, value_name = "ORDER")]
    quat_order: Option<QuatOrder>,
    /// Up of the frame that the recording's positions are in, such as +z
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    path_up: Option<Axis>,
    /// The projected system that the recording's positions are in, such as EPSG:32632: puts the path on the Earth
    #[arg(long, value_name = "EPSG:CODE", value_parser = epsg)]
    path_crs: Option<u32>,
    /// The aircraft to take from ADS-B JSON, by its ICAO 24-bit address; the one with most positions if not given
    #[arg(long, value_name = "ADDRESS")]
    icao24: Option<String>,
    /// Where the camera looks: motion, down, target=X,Y,Z (metres in the world), geo=LATITUDE,LONGITUDE,HEIGHT, or
    /// other=ICAO24 (another aircraft of the same file); as recorded, else along the motion, if not given
    #[arg(long, value_name = "WHERE")]
    look: Option<Look>,
    /// A recorded head that rides on the path: its turns about its mean heading, its translations in metres. Without
    /// scale= its positions are taken as metres; EyeNavGS needs that of its scene, such as 0.64
    #[arg(long, value_name = "FILE[,scale=S]")]
    head: Option<String>,
    /// Where the path goes: geo (by coordinates; geo,height=M lifts it until its lowest pose is that high above the
    /// ground), or centre,height=2,yaw=0,scale=1 (its middle that many metres above the ground under the world's centre,
    /// turned by degrees, scaled), world (its coordinates are the world's own). If not given: geo where both have coordinates and meet, else centre; the built-in
    /// path stands in the built-in world as it is
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
            path_crs: None,
            icao24: None,
            look: None,
            head: None,
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

impl PathArgs {
    /// The head's specification, if one rides.
    pub fn head(&self) -> Option<&str> {
        self.head.as_deref()
    }

    /// Pixels of the picture.
    pub fn viewport(&self) -> [u32; 2] {
        self.viewport
    }

    /// Vertical field of view, radians.
    ///
    /// # Errors
    /// What is no angle between 0° and 180°.
    pub fn fov_y(&self) -> anyhow::Result<f64> {
        if !(self.fov > 0.0 && self.fov < 180.0) {
            bail!("--fov {}; expected degrees between 0 and 180", self.fov);
        }
        Ok(self.fov.to_radians())
    }

    /// Seconds of a path of this length that are asked for.
    fn duration(&self, length: f64) -> anyhow::Result<f64> {
        if !(self.from >= 0.0 && self.from < length) {
            bail!("--from {}; expected seconds from 0 to less than the path's {length:.3}", self.from);
        }
        let left = length - self.from;
        let duration = self.duration.unwrap_or(left);
        let duration = self.at_most.map_or(duration, |most| duration.min(most));
        if !(duration > 0.0 && duration <= 86_400.0) {
            bail!(
                "a duration of {duration} s; expected more than 0 and at most 86400 seconds (choose with --from and --duration)"
            );
        }
        if duration > left + 1e-9 && !self.looped {
            bail!("--duration {duration}; the path has {left:.3} s from there: expected at most that, or --loop");
        }
        Ok(duration)
    }
}

fn viewport(text: &str) -> Result<[u32; 2], String> {
    let side = |s: &str| s.parse::<u32>().ok().filter(|n| (1..=65_536).contains(n));
    match text.split_once('x').map(|(w, h)| (side(w), side(h))) {
        Some((Some(w), Some(h))) => Ok([w, h]),
        _ => Err(format!("`{text}`; expected WIDTHxHEIGHT in pixels, such as 1920x1080")),
    }
}

fn epsg(text: &str) -> Result<u32, String> {
    let code = text.get(..5).filter(|prefix| prefix.eq_ignore_ascii_case("EPSG:")).map_or(text, |_| &text[5..]);
    code.parse().map_err(|_| format!("`{text}`; expected EPSG:CODE, such as EPSG:32632"))
}

/// A world with the name under which it was asked for.
pub fn open_world(name: Option<&str>) -> anyhow::Result<(String, World)> {
    match name {
        None => Ok(("built-in city".to_owned(), world::built_in_city())),
        Some(name) => Ok((name.to_owned(), world_named(name)?)),
    }
}

/// What `name` names: a file, a folder, a generated world's parameters, or a URL. Downloads show their progress on a
/// terminal.
pub fn world_named(name: &str) -> anyhow::Result<World> {
    let shows_progress = std::io::stderr().is_terminal();
    let downloaded = Arc::new(AtomicBool::new(false));
    let begun = downloaded.clone();
    let progress: Progress = Arc::new(move |files, bytes| {
        if shows_progress {
            eprint!("\rdownloaded {files} files, {:.1} MB", bytes as f64 / 1e6);
            begun.store(true, Ordering::Relaxed);
        }
    });
    let world = specification::open(name, &progress);
    if downloaded.load(Ordering::Relaxed) {
        eprint!("\r\x1b[K");
    }
    Ok(world?)
}

/// An amount of memory: bytes, or with a unit of 1000 (`kB`, `MB`, `GB`) or 1024 (`KiB`, `MiB`, `GiB`).
///
/// # Errors
/// What is no amount from 1 to 10¹⁵ bytes.
pub fn bytes(text: &str) -> Result<u64, String> {
    let expected = || format!("`{text}`; expected bytes such as 268435456, 256MiB or 1GB");
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let unit = match &text[digits.len()..] {
        "" | "B" => 1.0,
        "kB" | "KB" => 1e3,
        "MB" => 1e6,
        "GB" => 1e9,
        "KiB" => 1024.0,
        "MiB" => 1_048_576.0,
        "GiB" => 1_073_741_824.0,
        _ => return Err(expected()),
    };
    let bytes = digits.parse::<f64>().ok().map(|n| n * unit).filter(|b| *b >= 1.0 && *b <= 1e15);
    Ok(bytes.ok_or_else(expected)? as u64)
}

/// The built-in link, or what `spec` says.
pub fn open_link(spec: Option<&str>) -> anyhow::Result<LinkTrace> {
    Ok(match spec {
        None => link::built_in(),
        Some(spec) => link::parse::from_specification(spec)?,
    })
}

/// The built-in flight, a made path with its options, or a file; with the head that rides on it.
pub fn open_path(name: Option<&str>, args: &PathArgs) -> anyhow::Result<CameraPath> {
    carry_head(open_vehicle(name, args)?, args)
}

/// Whether the path is one that is made rather than read from a file.
fn is_made(name: &str) -> bool {
    let kind = name.split(':').next().unwrap_or_default();
    MADE_PATHS.contains(&kind) && !Path::new(name).exists()
}

/// The path with the head that rides on it, if there is one.
pub fn carry_head(path: CameraPath, args: &PathArgs) -> anyhow::Result<CameraPath> {
    Ok(match (args.head(), &args.look) {
        (None, _) => path,
        (Some(_), Some(Look::Target(_))) => {
            bail!("--head and --look target: a camera that is aimed at a point of the world carries no head")
        }
        (Some(spec), _) => Head::from_specification(spec)?.ride(&path)?,
    })
}

/// Paths that are made, by name; options follow a colon.
pub const MADE_PATHS: [&str; 3] = ["steady", "turn", "teleport"];

/// A path without a head: the built-in flight, `steady` or `turn` with `:speed=M/S,duration=S`, `teleport` with
/// `every=S`, `distance=M` and `seed=N` besides, or a file.
pub fn open_vehicle(name: Option<&str>, args: &PathArgs) -> anyhow::Result<CameraPath> {
    let looking = |path: CameraPath| match &args.look {
        Some(look) => look::apply(path, look),
        None => Ok(path),
    };
    let Some(name) = name else { return Ok(looking(path::built_in())?) };
    let kind = name.split(':').next().unwrap_or_default();
    if !is_made(name) {
        let options = Options {
            camera_axes: args.camera_axes,
            quat_order: args.quat_order,
            up: args.path_up,
            crs: args.path_crs,
            icao24: args.icao24.clone(),
            look: args.look.clone(),
        };
        return Ok(path::parse::from_file(Path::new(name), &options)?);
    }
    let (mut speed, mut duration, mut every, mut distance, mut seed) = (5.0, 60.0, 10.0, 200.0, 1);
    for option in name.split_once(':').map_or("", |(_, rest)| rest).split(',').filter(|o| !o.is_empty()) {
        let jumps = if kind == "teleport" { ", every=SECONDS, distance=METRES, seed=NUMBER" } else { "" };
        let expected =
            || format!("path `{name}`: `{option}`; expected speed=METRES_PER_SECOND or duration=SECONDS{jumps}");
        let (key, value) = option.split_once('=').with_context(expected)?;
        let number = || value.parse().ok().filter(|v: &f64| v.is_finite()).with_context(expected);
        match key {
            "speed" => speed = number()?,
            "duration" => duration = number()?,
            "every" if kind == "teleport" => every = number()?,
            "distance" if kind == "teleport" => distance = number()?,
            "seed" if kind == "teleport" => seed = value.parse().ok().with_context(expected)?,
            _ => bail!(expected()),
        }
    }
    let made = match kind {
        "steady" => path::turn::steady(speed, duration)?,
        "turn" => path::turn::turn(speed, duration)?,
        _ => path::teleport::teleport(speed, duration, every, distance, seed)?,
    };
    Ok(looking(made)?)
}

/// What `generate path` records: the part of the path that is asked for, with field of view and viewport in the first line.
pub fn samples(path: &CameraPath, args: &PathArgs) -> anyhow::Result<Vec<Sample>> {
    if args.place.is_some() || args.looped {
        bail!("--place and --loop need a replay; a recording is placed and looped when it is replayed");
    }
    let (from, duration) = (args.from, args.duration(path.duration())?);
    let to = from + duration;
    let (first, last) = (path.at(from), path.at(to));
    let inside = path.poses().iter().filter(|pose| pose.time > from && pose.time < to);
    let poses = std::iter::once((0.0, first))
        .chain(inside.map(|pose| (pose.time - from, (pose.position, pose.orientation))))
        .chain(std::iter::once((duration, last)));
    let fov_y = args.fov_y()?;
    let samples = poses.enumerate().map(|(i, (t, (position, orientation)))| Sample {
        t,
        position: position.to_array(),
        orientation: orientation.to_array(),
        fov_y: (i == 0).then_some(fov_y),
        viewport: (i == 0).then_some(args.viewport),
    });
    Ok(samples.collect())
}

/// A path in its world, sampled.
pub struct Placed {
    /// The views.
    pub flight: Flight,
    /// How the path was put there.
    pub place: String,
    /// What the path's notes say, those on its placement included.
    pub notes: Vec<String>,
}

/// Puts the path into the world and samples it. `as_is` leaves it where it is unless a placement is given.
pub fn place(path: &CameraPath, world: &World, as_is: bool, args: &PathArgs) -> anyhow::Result<Placed> {
    let (mut placed, place) = if as_is && args.place.is_none() {
        (path.clone(), "as it is".to_owned())
    } else {
        let (placed, placement) = path::place::into_world(path, args.place, world)?;
        (placed, placement.to_string())
    };
    if let Some(Look::Target(target)) = args.look {
        placed = look::aim(&placed, look::Aim::Point(target));
        placed.add_note(format!("the camera is aimed: {}", Look::Target(target)));
    }
    Ok(Placed { flight: sample(&placed, args)?, place, notes: placed.notes().to_vec() })
}

/// A path that is in world space already, sampled.
///
/// # Errors
/// A field of view or a part of the path without meaning.
pub fn sample(path: &CameraPath, args: &PathArgs) -> anyhow::Result<Flight> {
    let fov_y = args.fov_y()?;
    let duration = args.duration(path.duration())?;
    let looped;
    let source = if args.looped {
        looped = path.looped();
        &looped
    } else {
        path
    };
    Ok(Flight::sample(duration, |t| {
        let (position, orientation) = source.at(args.from + t);
        View { position, orientation, fov_y, viewport: args.viewport }
    }))
}

/// Notes of a world for the reader, the same kind of note folded after a few.
pub fn world_notes(world: &World, at_most: usize) -> Vec<String> {
    let mut notes: Vec<String> = world.notes.iter().take(at_most).map(ToString::to_string).collect();
    if world.notes.len() > at_most {
        notes.push(format!("… and {} more notes on this world; `inspect` lists them", world.notes.len() - at_most));
    }
    notes
}
