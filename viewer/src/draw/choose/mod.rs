//! What to draw: near things as geometry, beyond them the coarsest cells whose resolution suffices, each from a few
//! directions (\[HIBR\] §4.2), and what is there instead as long as the right one is missing.
//!
//! A sample of side g at distance d covers g·p/d pixels, p = viewport height / (2 tan(fov/2)): \[HIBR\]'s q with cos θ = 1.
//! The side is that of the octree's level; an orthoview's error is more where it does not show what stands behind. A node suffices if that is at most [`ChooseSettings::pixels_per_sample`] × [`ChooseSettings::bias`] at the nearest point
//! of its content box. Geometry within r is what is left: where a leaf's orthoviews no longer suffice, its triangles do,
//! unless [`ChooseSettings::geometry_radius`] says otherwise.
//!
//! What is missing is substituted. Of what is resident at a node and above it, that is drawn which shows the node best by
//! the objective's own measure, Σ_s share_s·a_s. Where some children of a node are shown by themselves and others are not,
//! the node is drawn too, without what lies in the boxes of the former: no place that something resident shows is left
//! empty. A child whose box reaches into that of one that is not there waits for it. Where a child is finer but has not all of the
//! sides that are shown from above, both are drawn, the coarser a little farther back: the objective counts the best of each
//! side, whichever level has it.
//!
//! A swap is put off as long as nobody could see it (\[HIBR\] §5.3): what is drawn stays for [`ChooseSettings::swap_margin`]
//! beyond the point where it could be coarser, and for [`ChooseSettings::turn_margin`] beyond the one where another
//! direction is nearer. The frame before is the list that comes in.

mod cover;
mod own;
#[cfg(test)]
mod tests;

use super::list::DrawList;
use cover::Chooser;
use foresight_index::world::World;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::view::View;
use std::collections::BTreeSet;

/// How fine to draw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChooseSettings {
    /// Within how many metres triangles are drawn rather than orthoviews, ∞ for everywhere; `None` for as far as the finest
    /// orthoviews do not suffice.
    pub geometry_radius: Option<f64>,
    /// From how many directions a cell is drawn, 1 to 26. More close holes and cost as much as they add (\[HIBR\] Figure 5).
    pub directions: usize,
    /// Most pixels that a sample of an orthoview may cover, > 0.
    pub pixels_per_sample: f64,
    /// Most pixels by which triangles may be off, ≥ 0; 0 for the finest there are.
    pub error_px: f64,
    /// Both limits are multiplied by it, ≥ 1/16: above 1 less is drawn, and less well (\[HIBR\] §4.2).
    pub bias: f64,
    /// What has been refined is coarsened once the coarser is 1 + margin times as fine as it has to be. 0 to 10.
    pub swap_margin: f64,
    /// By how much the cosine of another direction has to exceed that of one that is drawn, to take its place. 0 to 1.
    pub turn_margin: f64,
}

impl Default for ChooseSettings {
    fn default() -> ChooseSettings {
        ChooseSettings {
            geometry_radius: None,
            directions: 3,
            pixels_per_sample: 1.0,
            error_px: 1.0,
            bias: 1.0,
            swap_margin: 0.15,
            turn_margin: 0.03,
        }
    }
}

/// A setting out of range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{field} is {value}; expected {expected}")]
pub struct ChooseSettingsError {
    /// Which.
    pub field: &'static str,
    /// As given.
    pub value: f64,
    /// What it may be.
    pub expected: &'static str,
}

impl ChooseSettings {
    /// Everything as triangles as fine as there are: what pictures are compared with.
    pub fn reference() -> ChooseSettings {
        ChooseSettings { geometry_radius: Some(f64::INFINITY), error_px: 0.0, ..ChooseSettings::default() }
    }

    /// Refuses what makes no sense. [`choose`] takes anything, and shows something.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn check(&self) -> Result<(), ChooseSettingsError> {
        let radius = self.geometry_radius.unwrap_or(0.0);
        let fields = [
            ("geometry_radius", radius, radius >= 0.0, "metres >= 0"),
            ("directions", self.directions as f64, (1..=26).contains(&self.directions), "1 to 26"),
            ("pixels_per_sample", self.pixels_per_sample, positive(self.pixels_per_sample), "a finite number > 0"),
            ("error_px", self.error_px, self.error_px == 0.0 || positive(self.error_px), "a finite number >= 0"),
            ("bias", self.bias, self.bias >= 0.0625 && self.bias.is_finite(), "a finite number >= 1/16"),
            ("swap_margin", self.swap_margin, (0.0..=10.0).contains(&self.swap_margin), "0 to 10"),
            ("turn_margin", self.turn_margin, (0.0..=1.0).contains(&self.turn_margin), "0 to 1"),
        ];
        let wrong = fields.into_iter().find(|&(_, _, holds, _)| !holds);
        wrong.map_or(Ok(()), |(field, value, _, expected)| Err(ChooseSettingsError { field, value, expected }))
    }
}

fn positive(value: f64) -> bool {
    value > 0.0 && value.is_finite()
}

/// What was chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ChooseCounts {
    /// Nodes looked at.
    pub visited: u32,
    /// Nodes left out with everything beneath, because the view does not show them.
    pub culled: u32,
    /// Orthoviews drawn.
    pub orthoviews: u32,
    /// Other representations drawn.
    pub meshes: u32,
    /// Nodes drawn although a finer one, or one from more directions, is wanted.
    pub substitutes: u32,
    /// Boxes left out of substitutes, because something beneath them is drawn.
    pub hidden: u32,
}

/// Chooses what to draw of `resident`, what the GPU has. `list` comes in as the frame before and goes out as this one;
/// empty, or of another world, it holds nothing back. A view that [`View::check`] refuses shows nothing.
pub fn choose(
    world: &World,
    resident: &BTreeSet<RepId>,
    view: &View,
    settings: &ChooseSettings,
    list: &mut DrawList,
) -> ChooseCounts {
    choose_in(&world.tree, world.root_sample, resident, view, settings, list)
}

/// As [`choose`], of a tree.
pub fn choose_in(
    tree: &foresight_scheduler::lod_tree::LodTree,
    root_sample: Option<f64>,
    resident: &BTreeSet<RepId>,
    view: &View,
    settings: &ChooseSettings,
    list: &mut DrawList,
) -> ChooseCounts {
    if view.check().is_err() {
        list.items.clear();
        return ChooseCounts::default();
    }
    let mut before: Vec<RepId> = list.items.drain(..).map(|item| item.rep).collect();
    before.sort_unstable();
    let items = std::mem::take(&mut list.items);
    let mut chooser = Chooser::new(tree, root_sample, resident, view, settings, before, items);
    chooser.run();
    list.items = chooser.items;
    chooser.counts
}
