//! `build`: from meshes to a stored world.

mod arguments;
mod leaf;
mod outcome;
mod plan;
mod progress;
mod source;
mod workshop;

pub use arguments::{BuildArgs, run};
pub use outcome::Outcome;
pub use plan::{DirectionsWanted, PIXELS, Screen, Sharpness};

use foresight_index::catalogue::{Catalogue, CatalogueError, Location};
use foresight_index::format::orthoview::{ColourCodec, OrthoviewError};
use foresight_index::geometry::{GeometryError, GeometrySettings};
use foresight_index::import::tiles3d::ContentError;
use foresight_index::octree::OctreeError;
use foresight_index::orthoview::build;
use foresight_index::stored::document::{self, Content, Document, Input, LeftOut, OctreeParts, Orthoviews, Previous};
use foresight_index::stored::publish::Workplace;
use foresight_index::stored::{Pages, StoredError, address, open_document};
use foresight_index::surface::spool::{Repairs, Spool, SpoolError, SpoolSettings, Statistics};
use foresight_index::surface::{SurfaceError, SurfaceSource as _};
use plan::{Plan, round};
use progress::{Progress, span};
use source::Sources;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use workshop::Shop;

/// What is to be built, and how.
#[derive(Clone, Debug)]
pub struct Settings {
    /// What to build from, as named on the command line.
    pub inputs: Vec<String>,
    /// Folder of the world.
    pub out: PathBuf,
    /// What to call it; the folder's name if not given.
    pub name: Option<String>,
    /// Side of a leaf, metres; found from the density of triangles if not given.
    pub leaf: Option<f64>,
    /// How sharp orthoviews are.
    pub sharpness: Sharpness,
    /// The screen that a radius is meant for.
    pub screen: Screen,
    /// Directions of the orthoviews.
    pub directions: DirectionsWanted,
    /// Codec of the colours.
    pub colour: ColourCodec,
    /// Whether light and shadow are in the colours, so that no normals are needed.
    pub baked_lighting: bool,
    /// How the leaves' geometry is made; `None` for none.
    pub geometry: Option<GeometrySettings>,
    /// Whether triangles far away from everything else are kept.
    pub keep_strays: bool,
    /// Where the catalogue goes; a SQLite file in the folder if not given.
    pub database: Option<Location>,
    /// Whether an interrupted build is forgotten.
    pub fresh: bool,
    /// Whether nothing is said on standard error.
    pub quiet: bool,
}

/// Why there is no new world.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// An input cannot be opened.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// A part of an input cannot be read.
    #[error(transparent)]
    Content(#[from] ContentError),
    /// Inputs that do not lie in the same coordinates.
    #[error("{first} and {other} lie in different coordinate systems; expected inputs of one")]
    Inputs {
        /// The first input.
        first: String,
        /// One that differs.
        other: String,
    },
    /// There is nothing to build from.
    #[error("no input has a triangle that could be seen; expected at least one")]
    Nothing,
    /// The settings do not fit.
    #[error("{0}")]
    Settings(String),
    /// The leaves do not fit the world.
    #[error(transparent)]
    Octree(#[from] OctreeError),
    /// An image cannot be written.
    #[error(transparent)]
    Orthoview(#[from] OrthoviewError),
    /// A file beyond 4 GiB.
    #[error("{file} takes 4 GiB or more; expected less: take smaller leaves or fewer pixels")]
    TooLarge {
        /// Which.
        file: String,
    },
    /// A part of an input cannot be put in order.
    #[error(transparent)]
    Spool(#[from] SpoolError),
    /// The geometry of a leaf.
    #[error(transparent)]
    Geometry(#[from] GeometryError),
    /// The world's folder.
    #[error(transparent)]
    Stored(#[from] StoredError),
    /// The catalogue.
    #[error(transparent)]
    Catalogue(#[from] CatalogueError),
}

/// How long a database may take to answer at first.
const PATIENCE: Duration = Duration::from_secs(10);

/// Builds a world and publishes it. What was published before stays until everything is there.
///
/// # Errors
/// Inputs, settings or a folder that cannot be used; what was published before is then as it was.
pub fn build_world(settings: &Settings) -> Result<Outcome, BuildError> {
    let mut progress = Progress::begin(settings.quiet);
    let sources = Sources::open(&settings.inputs)?;
    let workplace = Workplace::take(&settings.out)?;
    // Fails now, and not after hours, where what is there is damaged or of another schema.
    let published = match workplace.folder().join(address::DOCUMENT).exists() {
        true => Some(open_document(workplace.folder())?),
        false => None,
    };
    let began = resume(settings, &sources, &workplace, &mut progress)?;
    let spool = sorted(settings, &sources, &workplace, &mut progress)?;
    let survey = spool.statistics();
    let plan = Arc::new(plan::plan(settings, *spool.octree(), survey, sources.up())?);
    say_plan(settings, &sources, survey, &plan, &mut progress);
    progress.begin_part();
    let mut shop = Shop::new(plan.clone(), &spool, &workplace, &mut progress, sources.up());
    let made = build::build(&plan.octree, &plan.directions, plan.pixel, &mut shop)?;
    let (root, hash, summary) = shop.root()?.ok_or(BuildError::Nothing)?;
    let restored = shop.leaves_restored;
    let mut document = document(settings, &sources, survey, &plan, root, &summary);
    document.identity = document.identity_of(&hash);
    document.previous = match published {
        // Built again without a change: the version before is still that one.
        Some(before) if before.identity == document.identity => before.previous,
        before => before.map(|before| Previous {
            identity: before.identity,
            root: before.root,
            catalogue: before.catalogue,
            octree: before.octree,
        }),
    };
    progress.say("writing the catalogue");
    catalogue(settings, &workplace, &mut document, &plan)?;
    workplace.publish(&document)?;
    workplace.forget()?;
    let swept = workplace.sweep(&document)?;
    let seconds = progress.seconds();
    progress.say(&format!("published {} in {}", &document.identity[..16], span(seconds)));
    Ok(Outcome::new(settings, &document, &made, &plan, outcome::Circumstances { began, restored, swept, seconds }))
}

/// The inputs' triangles, sorted into leaves; as an interrupted build left them, if it got so far.
fn sorted(
    settings: &Settings,
    sources: &Sources,
    workplace: &Workplace,
    progress: &mut Progress,
) -> Result<Spool, BuildError> {
    const SIDE: &str = "leaf";
    let noted = || Some(f64::from_le_bytes(std::fs::read(workplace.noted(SIDE)).ok()?.try_into().ok()?));
    let leaf_side = match settings.leaf.or_else(noted) {
        Some(side) => side,
        None => {
            progress.say("looking at the inputs for the size of leaves");
            let side = sources.leaf_side(plan::TRIANGLES_A_LEAF)?;
            workplace.note(SIDE, &side.to_le_bytes())?;
            side
        }
    };
    let spool = SpoolSettings { leaf_side, keep_strays: settings.keep_strays, ..SpoolSettings::default() };
    let folder = workplace.noted("spool");
    if let Some(spool) = Spool::open(&folder, sources.identity()?, &spool)? {
        return Ok(spool);
    }
    let progress = Mutex::new(progress);
    Ok(Spool::fill(sources, &folder, &spool, &|done, all| {
        progress.lock().unwrap_or_else(PoisonError::into_inner).at("pieces sorted", done, all, done, "");
    })?)
}

/// Whether an interrupted build goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Began {
    /// Nothing was there.
    New,
    /// An interrupted build of the same goes on.
    Resumed,
    /// An interrupted build of something else was forgotten.
    Anew,
}

/// Compares what is to be built with what an interrupted build was about.
fn resume(
    settings: &Settings,
    sources: &Sources,
    workplace: &Workplace,
    progress: &mut Progress,
) -> Result<Began, BuildError> {
    const NOTE: &str = "inputs";
    let print = fingerprint(settings, sources);
    let began = match std::fs::read(workplace.noted(NOTE)) {
        Ok(found) if found == print.as_bytes() && !settings.fresh => {
            progress.say("resuming an interrupted build");
            return Ok(Began::Resumed);
        }
        Ok(_) if settings.fresh => Began::Anew,
        Ok(_) => {
            progress.say("an interrupted build had other inputs or settings: starting anew");
            Began::Anew
        }
        Err(_) => Began::New,
    };
    workplace.forget()?;
    workplace.note(NOTE, print.as_bytes())?;
    Ok(began)
}

/// Everything that decides what is built: inputs by content, settings, and the program's version.
fn fingerprint(settings: &Settings, sources: &Sources) -> String {
    let mut hasher = blake3::Hasher::new();
    let mut put = |text: &str| {
        hasher.update(&(text.len() as u64).to_le_bytes());
        hasher.update(text.as_bytes());
    };
    put(env!("CARGO_PKG_VERSION"));
    for (name, identity) in sources.identities() {
        put(name);
        put(&blake3::Hash::from(identity).to_hex());
    }
    let Settings { leaf, sharpness, screen, directions, colour, baked_lighting, geometry, keep_strays, .. } = settings;
    put(&format!(
        "{leaf:?} {sharpness:?} {screen:?} {directions:?} {colour:?} {baked_lighting} {geometry:?} {keep_strays}"
    ));
    hasher.finalize().to_hex().to_string()
}

fn say_plan(settings: &Settings, sources: &Sources, survey: &Statistics, plan: &Plan, progress: &mut Progress) {
    let side = plan.octree.leaf_side();
    let automatic = if settings.leaf.is_none() { " (automatic)" } else { "" };
    let extent = survey.bounds.max - survey.bounds.min;
    progress.say(&format!(
        "{} triangles in {} pieces, {:.1} × {:.1} × {:.1} m",
        survey.triangles,
        sources.pieces(),
        extent.x,
        extent.y,
        extent.z
    ));
    let pixels = side / plan.pixel;
    progress.say(&format!(
        "leaves of {side} m{automatic}, {pixels:.1} pixels along each: {:.4} m a pixel, as sharp as a screen of {} pixels over {}° \
         from {:.1} m on; {} levels above",
        plan.pixel,
        settings.screen.width,
        settings.screen.field,
        settings.screen.radius(side, pixels),
        plan.octree.root().level
    ));
    let names: Vec<_> = plan.directions.iter().map(|direction| direction.name()).collect();
    progress.say(&format!(
        "{} directions: {}; {:.2} % of the surface is not seen within {}° of straight on, {:.2} % not at all",
        names.len(),
        names.join(" "),
        100.0 * plan.sight.share_not_within,
        plan.sight.within_degrees,
        100.0 * plan.sight.share_unseen
    ));
}

fn document(
    settings: &Settings,
    sources: &Sources,
    survey: &Statistics,
    plan: &Plan,
    root: String,
    summary: &foresight_index::stored::page::Summary,
) -> Document {
    let possible: f64 = plan.octree.cells_at(0).iter().map(|&cells| cells as f64).product();
    let mut left_out = plan.left_out.clone();
    if (summary.leaves as f64) < possible {
        left_out.push(LeftOut {
            what: "empty leaves".to_owned(),
            because: "nothing that could be seen is in them".to_owned(),
            figure: round(1.0 - summary.leaves as f64 / possible),
            unit: "of the leaves".to_owned(),
        });
    }
    let mut notes = survey.left_out.clone();
    let Repairs { not_finite, degenerate, strays, non_manifold_edges } = survey.repairs;
    for (count, what) in [
        (not_finite, "triangles with corners that are not finite: left out"),
        (degenerate, "triangles without area: left out"),
        (strays, "triangles far away from everything else: left out; --keep-strays keeps them"),
        (non_manifold_edges, "edges of more than two triangles: kept"),
    ] {
        if count > 0 {
            notes.push(format!("{count} {what}"));
        }
    }
    Document {
        format: document::FORMAT.to_owned(),
        schema_version: document::SCHEMA_VERSION,
        name: settings.name.clone().unwrap_or_else(|| folder_name(&settings.out)),
        identity: String::new(),
        built_by: format!("foresight-server {}", env!("CARGO_PKG_VERSION")),
        root,
        catalogue: String::new(),
        up: sources.up().to_array(),
        epsg: document::epsg(sources.georeference()),
        octree: OctreeParts::new(&plan.octree),
        orthoviews: Orthoviews {
            pixel: plan.pixel,
            directions: plan.directions.iter().map(|direction| direction.name()).collect(),
            colour: plan::codec_name(plan.encoding.colour),
            normals: plan.encoding.normals,
        },
        directions: plan.sight,
        content: Content {
            cells: summary.nodes,
            leaves: summary.leaves,
            leaves_possible: possible,
            orthoviews: summary.orthoviews,
            orthoview_bytes: summary.orthoview_bytes,
            geometries: summary.geometries,
            geometry_bytes: summary.geometry_bytes,
            decoded_bytes: summary.decoded_bytes,
            triangles: survey.triangles,
        },
        inputs: sources
            .identities()
            .map(|(name, identity)| Input {
                name: told_name(name),
                identity: blake3::Hash::from(identity).to_hex().to_string(),
            })
            .collect(),
        left_out,
        notes,
        previous: None,
    }
}

/// The last two parts of a path: enough for people to know it by, and nothing of the machine.
fn told_name(input: &str) -> String {
    let mut parts: Vec<&str> = input.trim_end_matches('/').rsplit('/').take(2).collect();
    parts.reverse();
    parts.join("/")
}

fn folder_name(folder: &Path) -> String {
    let whole = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    whole.file_name().map_or_else(|| "world".to_owned(), |name| name.to_string_lossy().into_owned())
}

/// Writes the catalogue: into a file of its own, moved into its place when it is whole, or in one transaction of a database.
fn catalogue(
    settings: &Settings,
    workplace: &Workplace,
    document: &mut Document,
    plan: &Plan,
) -> Result<(), BuildError> {
    let pages = Pages::new(workplace.folder(), plan.octree);
    if let Some(location) = &settings.database {
        return Ok(Catalogue::publish(location, document, &pages, PATIENCE)?);
    }
    let io = |file: &Path| {
        let file = file.to_owned();
        move |source| StoredError::Io { file, source }
    };
    let beside = workplace.noted("catalogue.sqlite");
    for leftover in [beside.clone(), workplace.noted("catalogue.sqlite-journal")] {
        match std::fs::remove_file(&leftover) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(io(&leftover)(error).into()),
            _ => {}
        }
    }
    Catalogue::publish(&Location::File(beside.clone()), document, &pages, PATIENCE)?;
    document.catalogue = address::catalogue(&document.identity);
    let place = workplace.folder().join(&document.catalogue);
    std::fs::rename(&beside, &place).map_err(io(&place))?;
    Ok(())
}
