//! What is packed into tiles: whole objects with all their parts, and single triangles of terrain and of what is too
//! large for a tile; each with the levels of detail at which it shows.

use std::collections::BTreeMap;

use foresight_scheduler::lod_tree::Aabb;
use glam::{DVec2, DVec3};

use super::model::Model;
use super::tiles::MAX_TILE_TRIANGLES;

/// Triangles that are shown from a level on until another takes their place, in thousandths of a level. The coarsest
/// reach down to [`COARSEST`], the finest up to [`FINEST`].
#[derive(Debug)]
pub(super) struct Patch {
    pub(super) from: i32,
    pub(super) until: i32,
    pub(super) triangles: Vec<[u32; 3]>,
}

/// Below every level.
pub(super) const COARSEST: i32 = i32::MIN;
/// Above every level.
pub(super) const FINEST: i32 = i32::MAX;

/// What goes into one tile as a whole.
#[derive(Debug)]
pub(super) struct Item {
    /// Middle, on the plane.
    pub(super) anchor: DVec2,
    pub(super) bounds: Aabb,
    /// Triangles at the finest level.
    pub(super) weight: usize,
    /// Area on the plane that it may be said to fill, m²; infinite for a triangle of something larger.
    pub(super) footprint: f64,
    /// Diameter of the whole object, metres.
    pub(super) whole: f64,
    pub(super) patches: Vec<Patch>,
}

fn bounds(vertices: &[DVec3], triangles: &[[u32; 3]]) -> Aabb {
    triangles.iter().flatten().fold(Aabb::EMPTY, |sum, &corner| {
        let at = vertices[corner as usize];
        sum.union(Aabb { min: at, max: at })
    })
}

/// The members of each whole, in the order of the objects.
fn wholes(model: &Model) -> BTreeMap<usize, Vec<usize>> {
    let mut wholes: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for at in 0..model.objects.len() {
        let whole = ancestors(model, at).last().unwrap_or(at);
        wholes.entry(whole).or_default().push(at);
    }
    wholes
}

/// What is shown at the finest level of all: objects with their triangles.
#[cfg(feature = "orthoviews")]
pub(super) fn finest(model: &Model) -> Vec<(usize, &[[u32; 3]])> {
    let mut out = Vec::new();
    for members in wholes(model).values() {
        let (levels, shown) = shown(model, members);
        for ((at, level), runs) in shown {
            if runs.last().is_some_and(|run| run.1 + 1 == levels.len()) {
                out.push((at, model.objects[at].levels[&level].as_slice()));
            }
        }
    }
    out
}

/// The items of a model, in the order of its objects.
pub(super) fn items(model: &Model) -> Vec<Item> {
    let mut items = Vec::new();
    for members in wholes(model).values() {
        let patches = patches(model, members);
        let weight = patches.iter().filter(|patch| patch.until == FINEST).map(|patch| patch.triangles.len()).sum();
        let is_terrain = members.iter().any(|&at| model.objects[at].kind == "TINRelief");
        let all = patches.iter().map(|patch| bounds(&model.vertices, &patch.triangles)).fold(Aabb::EMPTY, Aabb::union);
        let size = all.max - all.min;
        let whole = size.length();
        if is_terrain || weight > MAX_TILE_TRIANGLES {
            for Patch { from, until, triangles } in patches {
                items.extend(triangles.into_iter().map(|triangle| {
                    let bounds = bounds(&model.vertices, &[triangle]);
                    let patches = vec![Patch { from, until, triangles: vec![triangle] }];
                    let weight = usize::from(until == FINEST);
                    let anchor = bounds.centre().truncate();
                    Item { anchor, bounds, weight, footprint: f64::INFINITY, whole, patches }
                }));
            }
        } else if !patches.is_empty() {
            let anchor = all.centre().truncate();
            items.push(Item { anchor, bounds: all, weight, footprint: size.x * size.y, whole, patches });
        }
    }
    items
}

/// The objects above one, nearest first. Importing made sure that they are few and in no circle.
fn ancestors(model: &Model, at: usize) -> impl Iterator<Item = usize> + '_ {
    std::iter::successors(model.objects[at].parent, |&parent| model.objects[parent].parent)
}

/// The levels of members that are shown, each with the first and last place at which it is.
type Shown = BTreeMap<(usize, i32), Vec<(usize, usize)>>;

/// What the members of one whole show at which levels. At level L a member shows its finest geometry up to L, unless
/// a member above or beneath it has a finer one up to L; where neither it nor those have one, its coarsest.
fn shown(model: &Model, members: &[usize]) -> (Vec<i32>, Shown) {
    let mut levels: Vec<i32> = members.iter().flat_map(|&at| model.objects[at].levels.keys().copied()).collect();
    levels.sort_unstable();
    levels.dedup();
    // The levels of a member that are shown, each with the first and last place in `levels` at which it is.
    let mut shown = Shown::new();
    for (place, &level) in levels.iter().enumerate() {
        let own = |at: usize| model.objects[at].levels.range(..=level).next_back().map(|(&own, _)| own);
        let mut beneath: BTreeMap<usize, i32> = BTreeMap::new();
        for &at in members {
            if let Some(own) = own(at) {
                for above in ancestors(model, at) {
                    let finest = beneath.entry(above).or_insert(own);
                    *finest = own.max(*finest);
                }
            }
        }
        for &at in members {
            let above = ancestors(model, at).filter_map(own).max();
            let related = above.max(beneath.get(&at).copied());
            let choice = match own(at) {
                Some(own) => (related <= Some(own)).then_some(own),
                None if related.is_none() => model.objects[at].levels.keys().next().copied(),
                None => None,
            };
            let Some(choice) = choice else { continue };
            let runs = shown.entry((at, choice)).or_default();
            match runs.last_mut() {
                Some((_, last)) if *last + 1 == place => *last = place,
                _ => runs.push((place, place)),
            }
        }
    }
    (levels, shown)
}

fn patches(model: &Model, members: &[usize]) -> Vec<Patch> {
    let (levels, shown) = shown(model, members);
    let patch = |(&(at, level), runs): (&(usize, i32), &Vec<(usize, usize)>)| {
        let triangles = &model.objects[at].levels[&level];
        let interval = |&(first, last): &(usize, usize)| Patch {
            from: if first == 0 { COARSEST } else { levels[first] },
            until: levels.get(last + 1).copied().unwrap_or(FINEST),
            triangles: triangles.clone(),
        };
        runs.iter().map(interval).collect::<Vec<_>>()
    };
    shown.iter().flat_map(patch).collect()
}
