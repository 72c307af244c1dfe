//! The descent: from the root to what suffices, and back up with what is shown and what is not.

use super::own::{Limits, Own, Sight, own};
use super::{ChooseCounts, ChooseSettings};
use crate::draw::list::{ALL_TILES, HIDDEN_MAX, Item};
use foresight_scheduler::benefit::element::{Errors, NOTHING, least};
use foresight_scheduler::benefit::frustum::{Frustum, Side};
use foresight_scheduler::lod_tree::{Aabb, LodTree, NodeId, RepId};
use foresight_scheduler::view::View;
use glam::DVec3;
use std::collections::BTreeSet;
use std::ops::Range;

/// How much of a node is shown by it and what is beneath.
enum Cover {
    /// The view does not show it.
    Unseen,
    /// All of it.
    Full,
    /// All of it, but what is above shows more of its sides: both are to be drawn.
    Over,
    /// Some pieces.
    Part(Pieces),
    /// None of it.
    Nothing,
}

/// A node in part.
#[derive(Default)]
struct Pieces {
    drawn: Vec<Piece>,
    /// Drawn over what is above.
    over: Vec<Aabb>,
    undrawn: Vec<Aabb>,
}

/// What is above a node.
#[derive(Clone, Copy)]
struct Above<'a> {
    /// What it would show the node with.
    errors: &'a Errors,
    /// Whether triangles are part of it, which cannot be drawn beneath splats.
    has_mesh: bool,
}

/// Least quality that is worth drawing a place twice.
const TWICE: f64 = 0.02;

/// How far what is drawn beneath finer splats falls back, in sides of its own samples: beyond what coarser samples lie
/// beside what they show.
const BEHIND: f64 = 2.0;

/// A box that is shown, and by which items.
struct Piece {
    bounds: Aabb,
    items: Range<usize>,
}

/// One choice.
pub(super) struct Chooser<'a> {
    tree: &'a LodTree,
    /// Side of a pixel of the root's orthoviews, metres, if levels have sides.
    root_sample: Option<f64>,
    resident: &'a BTreeSet<RepId>,
    settings: &'a ChooseSettings,
    frustum: Frustum,
    /// What the frame before has drawn, and whose that was; both ascending, for nodes own their representations in order.
    before: Vec<RepId>,
    nodes_before: Vec<NodeId>,
    pub(super) items: Vec<Item>,
    pub(super) counts: ChooseCounts,
}

impl<'a> Chooser<'a> {
    pub(super) fn new(
        tree: &'a LodTree,
        root_sample: Option<f64>,
        resident: &'a BTreeSet<RepId>,
        view: &View,
        settings: &'a ChooseSettings,
        mut before: Vec<RepId>,
        items: Vec<Item>,
    ) -> Chooser<'a> {
        before.retain(|rep| rep.index() < tree.representations());
        let nodes_before = before.iter().map(|&rep| tree.node_of(rep)).collect();
        let frustum = Frustum::new(view);
        let counts = ChooseCounts::default();
        Chooser { tree, root_sample, resident, settings, frustum, before, nodes_before, items, counts }
    }

    pub(super) fn run(&mut self) {
        self.visit(self.tree.root(), self.root_sample, false, None);
        let substitutes = self.items.iter().map(|item| item.hidden.len()).sum::<usize>();
        self.counts.hidden = u32::try_from(substitutes).unwrap_or(u32::MAX);
        for item in &self.items {
            match self.tree.direction(item.rep) {
                Some(_) => self.counts.orthoviews += 1,
                None => self.counts.meshes += 1,
            }
        }
    }

    /// As deep as the tree, which is at most [`foresight_scheduler::lod_tree::DEPTH_MAX`]. `inside` is whether the view is
    /// known to show all of the node; `above` is what the nodes above would show it with; `sample` is the side of its
    /// orthoviews' pixels.
    fn visit(&mut self, node: NodeId, sample: Option<f64>, mut inside: bool, above: Option<Above<'_>>) -> Cover {
        self.counts.visited = self.counts.visited.saturating_add(1);
        let centre = self.tree.centre(node) - self.frustum.eye;
        let half = self.tree.half(node);
        if !inside {
            match self.frustum.side(centre, half) {
                Side::Outside => {
                    self.counts.culled = self.counts.culled.saturating_add(1);
                    return Cover::Unseen;
                }
                Side::Inside => inside = true,
                Side::Straddles(_) => {}
            }
        }
        let mut beneath = self.tree.beneath(node);
        let Some(first) = beneath.next() else {
            return Cover::Nothing;
        };
        let last = beneath.next_back().unwrap_or(first);
        if self.resident.range(first..=last).next().is_none() {
            return Cover::Nothing;
        }
        let sight = Sight::new(self.tree, node, centre, half, self.frustum.pixels_per_radian);
        let mine = own(self.tree, self.resident, node, &sight, &self.limits(node, sample));
        let mut lacks = false;
        let mine = mine.filter(|mine| {
            let Some(above) = above else { return true };
            let [own, before, both] =
                [&mine.errors, above.errors, &least(&mine.errors, above.errors)].map(|errors| sight.quality(errors));
            lacks = !mine.suffices && !above.has_mesh && both > own + TWICE;
            own >= before || lacks && both > before + TWICE
        });
        let mut pieces = Pieces::default();
        let start = self.items.len();
        match &mine {
            Some(mine) if mine.suffices => {}
            _ => {
                let (mut errors, mut has_mesh) = (NOTHING, false);
                if let Some(mine) = &mine {
                    errors = mine.errors;
                    has_mesh = mine.reps.iter().any(|&rep| self.tree.direction(rep).is_none());
                }
                if let Some(above) = above.filter(|_| mine.is_none() || lacks) {
                    errors = least(&errors, above.errors);
                    has_mesh |= above.has_mesh;
                }
                let all = (mine.is_some() || above.is_some()).then_some(Above { errors: &errors, has_mesh });
                match self.children(node, sample.map(|side| 0.5 * side), inside, all, &mut pieces) {
                    Cover::Nothing => {}
                    cover => return cover,
                }
            }
        }
        match mine {
            Some(mine) => {
                self.draw(mine, sample, pieces, start);
                if lacks { Cover::Over } else { Cover::Full }
            }
            None if pieces.drawn.is_empty() && pieces.over.is_empty() => Cover::Nothing,
            None => Cover::Part(pieces),
        }
    }

    /// Visits the children and collects what they show; `Nothing` if the node itself has to show something.
    fn children(
        &mut self,
        node: NodeId,
        sample: Option<f64>,
        inside: bool,
        above: Option<Above<'_>>,
        pieces: &mut Pieces,
    ) -> Cover {
        if self.tree.is_leaf(node) {
            return Cover::Nothing;
        }
        let tree = self.tree;
        let mut seen = false;
        for child in tree.children(node) {
            let start = self.items.len();
            let cover = self.visit(child, sample, inside, above);
            seen |= !matches!(cover, Cover::Unseen);
            match cover {
                Cover::Unseen => {}
                Cover::Full => {
                    let items = start..self.items.len();
                    pieces.drawn.push(Piece { bounds: tree.bounds(child), items });
                }
                Cover::Over => pieces.over.push(tree.bounds(child)),
                Cover::Part(part) => {
                    pieces.drawn.extend(part.drawn);
                    pieces.over.extend(part.over);
                    pieces.undrawn.extend(part.undrawn);
                }
                Cover::Nothing => pieces.undrawn.push(tree.bounds(child)),
            }
        }
        match (seen, pieces.undrawn.is_empty() && pieces.over.is_empty()) {
            (false, _) => Cover::Unseen,
            (true, true) => Cover::Full,
            (true, false) => Cover::Nothing,
        }
    }

    fn limits(&self, node: NodeId, sample: Option<f64>) -> Limits<'_> {
        let first = self.nodes_before.partition_point(|&before| before <= node);
        let end = self.tree.subtree_end(node);
        let was_finer = self.nodes_before.get(first).is_some_and(|&before| before < end);
        let margin = if was_finer { 1.0 / (1.0 + self.settings.swap_margin.clamp(0.0, 10.0)) } else { 1.0 };
        let scale = margin * if self.settings.bias > 0.0 { self.settings.bias } else { 1.0 };
        Limits {
            settings: self.settings,
            sample,
            sample_px: self.settings.pixels_per_sample * scale,
            error_px: self.settings.error_px * scale,
            before: &self.before,
        }
    }

    /// Draws a node, without those of the pieces that can be told from the rest of it by their boxes.
    fn draw(&mut self, mine: Own, sample: Option<f64>, mut pieces: Pieces, start: usize) {
        if !pieces.drawn.is_empty() {
            self.separate(&mut pieces, start);
        }
        let off = |&rep: &RepId| sample.filter(|_| self.tree.direction(rep).is_some()).unwrap_or(self.tree.error(rep));
        let off = mine.reps.iter().map(off).fold(0.0, f64::max);
        let behind = if pieces.over.is_empty() { 0.0 } else { BEHIND * off };
        let mut others = pieces.undrawn;
        others.extend(pieces.over);
        let hidden: Vec<Aabb> = pieces.drawn.iter().map(|piece| widened(piece.bounds, off, &others)).collect();
        self.counts.substitutes += u32::from(!mine.suffices);
        for rep in mine.reps {
            self.items.push(Item { rep, hidden: hidden.clone(), behind, tiles: ALL_TILES, false_colour: None });
        }
    }

    /// Keeps of the pieces the nearest [`HIDDEN_MAX`] that reach into nothing undrawn, and takes the items of the others back.
    /// What reaches into something that is drawn over the node is drawn over it too.
    fn separate(&mut self, pieces: &mut Pieces, start: usize) {
        let eye = self.frustum.eye;
        let distance = |bounds: &Aabb| (bounds.min - eye).max(eye - bounds.max).max(DVec3::ZERO).length_squared();
        // Stable, and the order of the items does not matter.
        pieces.drawn.sort_by(|a, b| distance(&a.bounds).total_cmp(&distance(&b.bounds)));
        let mut dropped: Vec<Piece> = pieces.drawn.split_off(HIDDEN_MAX.min(pieces.drawn.len()));
        pieces.undrawn.extend(dropped.iter().map(|piece| piece.bounds));
        loop {
            let meets = |piece: &Piece| pieces.undrawn.iter().any(|undrawn| overlap(&piece.bounds, undrawn));
            let Some(place) = pieces.drawn.iter().position(meets) else {
                break;
            };
            let piece = pieces.drawn.swap_remove(place);
            pieces.undrawn.push(piece.bounds);
            dropped.push(piece);
        }
        loop {
            let meets = |piece: &Piece| pieces.over.iter().any(|over| overlap(&piece.bounds, over));
            let Some(place) = pieces.drawn.iter().position(meets) else {
                break;
            };
            pieces.over.push(pieces.drawn.swap_remove(place).bounds);
        }
        if dropped.is_empty() {
            return;
        }
        let tail = self.items.split_off(start);
        let kept = (start..).zip(tail).filter(|(at, _)| !dropped.iter().any(|piece| piece.items.contains(at)));
        self.items.extend(kept.map(|(_, item)| item));
    }
}

/// Share of a box's side by which boxes that only touch may overlap: their sides are rounded up.
const TOUCH: f64 = 1e-4;

/// Whether boxes share more than a face. A box without thickness meets what it touches.
pub(super) fn overlap(a: &Aabb, b: &Aabb) -> bool {
    let shared = a.max.min(b.max) - a.min.max(b.min);
    let side = (a.max - a.min).min(b.max - b.min).max(DVec3::ZERO);
    (0..3).all(|axis| shared[axis] >= TOUCH * side[axis])
}

/// The box made larger by `error` on all sides, for coarser samples lie beside what they show, but into none of `undrawn`.
fn widened(bounds: Aabb, error: f64, undrawn: &[Aabb]) -> Aabb {
    let mut wide = Aabb { min: bounds.min - error, max: bounds.max + error };
    for other in undrawn {
        if !(other.min.cmplt(wide.max).all() && wide.min.cmplt(other.max).all()) {
            continue;
        }
        // The face through which most room is between the two.
        let gaps = (0..3).flat_map(|axis| {
            [(axis, true, other.min[axis] - bounds.max[axis]), (axis, false, bounds.min[axis] - other.max[axis])]
        });
        let best = gaps.reduce(|best, gap| if gap.2 > best.2 { gap } else { best });
        match best {
            Some((axis, true, _)) => wide.max[axis] = wide.max[axis].min(other.min[axis]).max(bounds.min[axis]),
            Some((axis, false, _)) => wide.min[axis] = wide.min[axis].max(other.max[axis]).min(bounds.max[axis]),
            None => {}
        }
    }
    wide
}
