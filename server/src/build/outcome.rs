//! What a build made, for people and as a document.

use super::plan::{Plan, round};
use super::{Began, Settings};
use foresight_index::orthoview::build::Made;
use foresight_index::stored::document::{Content, Directions, Document, LeftOut};
use serde::Serialize;

/// What [`Outcome::schema_version`] says.
const SCHEMA_VERSION: u32 = 1;

/// What a build made.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// Version of this document.
    pub schema_version: u32,
    /// Folder of the world.
    pub world: String,
    /// Its identity: equal for equal content.
    pub identity: String,
    /// The identity of the version before, if there is one.
    pub previous: Option<String>,
    /// Whether an interrupted build went on.
    pub resumed: bool,
    /// Leaves that it had made.
    pub leaves_restored: u64,
    /// Files of older versions that were removed.
    pub files_removed: u64,
    /// Side of a leaf, metres.
    pub leaf_side: f64,
    /// Doublings along each axis.
    pub splits: [u32; 3],
    /// Side of a leaf's pixel, metres.
    pub pixel: f64,
    /// Directions by name.
    pub directions: Vec<String>,
    /// How well they see the surface.
    pub sight: Directions,
    /// What is in the world.
    pub content: Content,
    /// What was left out.
    pub left_out: Vec<LeftOut>,
    /// What was repaired or is missing.
    pub notes: Vec<String>,
    /// Triangles looked at, over all directions and leaves of this run.
    pub triangles_drawn: u64,
    /// Most bytes of images in memory at a time.
    pub peak_image_bytes: u64,
    /// Seconds that this run took.
    pub seconds: f64,
}

/// What a run met with.
#[derive(Clone, Copy, Debug)]
pub(super) struct Circumstances {
    pub(super) began: Began,
    pub(super) restored: u64,
    pub(super) swept: u64,
    pub(super) seconds: f64,
}

impl Outcome {
    pub(super) fn new(
        settings: &Settings,
        document: &Document,
        made: &Made,
        plan: &Plan,
        run: Circumstances,
    ) -> Outcome {
        Outcome {
            schema_version: SCHEMA_VERSION,
            world: settings.out.display().to_string(),
            identity: document.identity.clone(),
            previous: document.previous.as_ref().map(|previous| previous.identity.clone()),
            resumed: run.began == Began::Resumed,
            leaves_restored: run.restored,
            files_removed: run.swept,
            leaf_side: plan.octree.leaf_side(),
            splits: plan.octree.splits(),
            pixel: plan.pixel,
            directions: document.orthoviews.directions.clone(),
            sight: document.directions,
            content: document.content,
            left_out: document.left_out.clone(),
            notes: document.notes.clone(),
            triangles_drawn: made.drawn.triangles,
            peak_image_bytes: made.peak_bytes as u64,
            seconds: round(run.seconds),
        }
    }

    /// For people.
    pub fn describe(&self) -> String {
        let Content { cells, leaves, orthoviews, orthoview_bytes, geometries, geometry_bytes, .. } = self.content;
        let megabytes = |bytes: u64| bytes as f64 / 1e6;
        let mut lines = vec![
            format!("{}: {cells} cells, {leaves} of them leaves", self.world),
            format!("  {orthoviews} orthoviews, {:.2} MB", megabytes(orthoview_bytes)),
            format!("  {geometries} geometries, {:.2} MB", megabytes(geometry_bytes)),
            format!("  identity {}", self.identity),
        ];
        for LeftOut { what, because, figure, unit } in &self.left_out {
            lines.push(format!("  left out: {what}: {because} ({figure} {unit})"));
        }
        lines.extend(self.notes.iter().map(|note| format!("  mind: {note}")));
        lines.join("\n") + "\n"
    }
}
