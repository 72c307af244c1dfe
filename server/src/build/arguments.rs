//! The command line of `build`.

use super::plan::colour_codec;
use super::{BuildError, DirectionsWanted, Screen, Settings, Sharpness, build_world};
use clap::Args;
use foresight_index::catalogue::Location;
use foresight_index::format::glb_compressed::Packing;
use foresight_index::format::orthoview::ColourCodec;
use foresight_index::geometry::GeometrySettings;
use std::io::Write as _;
use std::path::PathBuf;

/// Options of `build`.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "The world can be served by any web server and used at once: foresight-sim replay --world WORLD, foresight-server serve \
--world WORLD. A build that was interrupted goes on when the same command is given again; one with other inputs or settings starts anew. \
What was published stays in use until the new version is whole, and its files until the next build.\n\n\
Examples:\n  foresight-server build --input tiles/tileset.json --out world/\n  \
foresight-server build --input tiles/ --out world/ --leaf 64 --pixels 256 --directions oop,pop,nop,opp,onp\n  \
foresight-server build --input tiles/ --out world/ --radius 120 --screen 2560 --colour jpeg:85 --baked-lighting\n  \
foresight-server build --input tiles/ --out world/ --no-geometry --threads 4 --json"
)]
pub struct BuildArgs {
    /// What to build from: a tileset or its folder, a mesh, a city model, a generated world; several make one world
    #[arg(long, required = true, value_name = "INPUT", num_args = 1..)]
    input: Vec<String>,
    /// Folder of the world: new, empty, or a world that gets a new version
    #[arg(long, value_name = "WORLD")]
    out: PathBuf,
    /// What to call it; the folder's name if not given
    #[arg(long)]
    name: Option<String>,
    /// Side of a leaf, metres; if not given the power of two at which a leaf holds about 8,000 triangles
    #[arg(long, value_name = "METRES", value_parser = positive)]
    leaf: Option<f64>,
    /// Pixels along a leaf: q
    #[arg(long, value_name = "Q", default_value_t = 256.0, value_parser = positive, conflicts_with = "radius")]
    pixels: f64,
    /// Make orthoviews as sharp as the screen from this distance on, metres: q = (s / cos θ) · p / (2 r tan(fov / 2))
    #[arg(long, value_name = "METRES", value_parser = positive)]
    radius: Option<f64>,
    /// p, pixels across the screen that a radius is meant for
    #[arg(long, value_name = "PIXELS", default_value_t = 1920.0, value_parser = positive)]
    screen: f64,
    /// Its field of view across, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 91.5, value_parser = field)]
    fov: f64,
    /// θ, the angle at which surfaces are seen at worst, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 36.3, value_parser = angle)]
    angle: f64,
    /// Directions of the orthoviews: auto (at most nine, chosen for the world), a number (at most that many), or names such as
    /// oop,pop,nnp: n, o and p stand for −1, 0 and 1 along x, y and z, from the world to the eye
    #[arg(long, default_value = "auto", value_name = "WHICH")]
    directions: DirectionsWanted,
    /// Codec of the colours: webp:QUALITY, jpeg:QUALITY, or without loss webp or png
    #[arg(long, default_value = "webp:85", value_name = "CODEC", value_parser = colour_codec)]
    colour: ColourCodec,
    /// Light and shadow are in the colours: leave out the normals
    #[arg(long)]
    baked_lighting: bool,
    /// Orthoviews only
    #[arg(long)]
    no_geometry: bool,
    /// How geometry is packed: compressed (readers need KHR_mesh_quantization and EXT_meshopt_compression), quantised (the
    /// former), or floats (every reader of glTF 2.0)
    #[arg(long, default_value = "compressed", value_name = "HOW", value_parser = packing, conflicts_with = "no_geometry")]
    geometry: Packing,
    /// Keep triangles that lie far away from everything else
    #[arg(long)]
    keep_strays: bool,
    /// Put the catalogue into this database (postgres://…) instead of a SQLite file in the folder
    #[arg(long, value_name = "URL")]
    database: Option<String>,
    /// Forget an interrupted build
    #[arg(long)]
    fresh: bool,
    /// Threads; as many as there are cores if not given
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Write what was built as one JSON document
    #[arg(long)]
    json: bool,
    /// Say nothing on standard error but errors
    #[arg(long)]
    quiet: bool,
}

fn packing(text: &str) -> Result<Packing, String> {
    match text {
        "compressed" => Ok(Packing::Compressed),
        "quantised" => Ok(Packing::Quantised),
        "floats" => Ok(Packing::Floats),
        _ => Err("expected compressed, quantised or floats".to_owned()),
    }
}

fn within(text: &str, from: f64, to: f64) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| *value > from && *value < to);
    value.ok_or_else(|| format!("expected a number between {from} and {to}"))
}

fn positive(text: &str) -> Result<f64, String> {
    within(text, 0.0, 1e12)
}

fn field(text: &str) -> Result<f64, String> {
    within(text, 1.0, 179.0)
}

fn angle(text: &str) -> Result<f64, String> {
    within(text, 0.0, 89.0)
}

/// Builds a world and says what was made.
///
/// # Errors
/// Those of [`build_world`].
pub fn run(arguments: &BuildArgs) -> anyhow::Result<()> {
    let BuildArgs { pixels, radius, screen, fov, angle, .. } = *arguments;
    let settings = Settings {
        inputs: arguments.input.clone(),
        out: arguments.out.clone(),
        name: arguments.name.clone(),
        leaf: arguments.leaf,
        sharpness: radius.map_or(Sharpness::Pixels(pixels), Sharpness::Radius),
        screen: Screen { width: screen, field: fov, angle },
        directions: arguments.directions.clone(),
        colour: arguments.colour,
        baked_lighting: arguments.baked_lighting,
        geometry: (!arguments.no_geometry)
            .then_some(GeometrySettings { packing: arguments.geometry, ..GeometrySettings::default() }),
        keep_strays: arguments.keep_strays,
        database: arguments.database.as_deref().map(str::parse::<Location>).transpose()?,
        fresh: arguments.fresh,
        quiet: arguments.quiet,
    };
    let threads = rayon::ThreadPoolBuilder::new().num_threads(arguments.threads.map_or(0, usize::from)).build()?;
    let outcome = threads.install(|| build_world(&settings)).map_err(|error: BuildError| anyhow::Error::from(error))?;
    let mut out = std::io::stdout().lock();
    if arguments.json {
        serde_json::to_writer_pretty(&mut out, &outcome)?;
        writeln!(out)?;
    } else {
        out.write_all(outcome.describe().as_bytes())?;
    }
    Ok(())
}
