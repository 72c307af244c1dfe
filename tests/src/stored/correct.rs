//! Whether the images are right: leaves against rays, parents against drawing their cell directly and against
//! supersampling.

use foresight_index::format::orthoview::{Encoding, decode, depth_error, encode};
use foresight_index::octree::Cell;
use foresight_index::orthoview::composite;
use foresight_index::orthoview::connectivity::{Thresholds, links};
use foresight_index::orthoview::raster::{self, Drawn};
use foresight_index::orthoview::texture::encoded;
use foresight_index::orthoview::{Direction, Lattice, Orthoview, Pixel};
use foresight_traces::random::SplitMix64;
use glam::I64Vec2;
use rayon::prelude::*;
use serde_json::json;

use super::ray::Rays;
use super::scene::Scene;
use super::table::Table;
use super::{Fault, Findings, picture};

/// How a leaf's image compares with rays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Truth {
    /// Pixels that either shows something in.
    pub pixels: u64,
    /// Of these, with the depth off by half a quantum at most.
    pub within: u64,
    /// Shown by one only.
    pub one_sided: u64,
}

impl Truth {
    fn add(self, other: Truth) -> Truth {
        Truth {
            pixels: self.pixels + other.pixels,
            within: self.within + other.within,
            one_sided: self.one_sided + other.one_sided,
        }
    }

    /// Share within half a quantum.
    pub fn share(&self) -> f64 {
        self.within as f64 / self.pixels.max(1) as f64
    }
}

/// Up to `count` of `cells`, by lot.
fn some(cells: Vec<Cell>, count: usize, seed: u64) -> Vec<Cell> {
    let mut random = SplitMix64::new(seed);
    let mut lots: Vec<(u64, Cell)> = cells.into_iter().map(|c| (random.bits(), c)).collect();
    lots.sort_unstable();
    lots.into_iter().take(count).map(|(_, c)| c).collect()
}

/// A leaf's image as its file keeps it, against four rays through each of its pixels, the nearest hit of which is the
/// pixel's depth.
///
/// # Errors
/// A content that cannot be read, an image that cannot be kept.
pub fn leaf(scene: &Scene, cell: Cell, directions: &[Direction]) -> Result<Truth, Fault> {
    let holding = scene.holding(cell)?;
    let holds = scene.octree.holds(cell, 1e-6 * scene.pitch);
    let rays = Rays::new(&holding, holds);
    let mut total = Truth::default();
    for &direction in directions {
        let lattice = scene.lattice(direction);
        let drawn = raster::leaf(&scene.octree, cell, &lattice, holding.meshes(), &mut Drawn::default());
        let empty = || Orthoview::empty(&lattice, &scene.octree.bounds(cell), 0);
        let kept = match &drawn {
            Some(view) => stored(view, &lattice)?,
            None => empty(),
        };
        let whole = drawn.unwrap_or_else(empty);
        let quantum = depth_error(whole.range);
        let compared: Truth = (0..whole.rect.area())
            .into_par_iter()
            .map(|index| {
                let at = whole.rect.at(index);
                let truth = nearest(&rays, &lattice, at, whole.near);
                let shown = kept.get(at);
                match (truth, shown.is_some()) {
                    (None, false) => Truth::default(),
                    (Some(depth), true) => {
                        // What sticks out of the cell at the grid's border is kept at the nearest step.
                        let depth = depth.clamp(0.0, whole.range);
                        let within = (depth - f64::from(shown.depth)).abs() <= quantum * (1.0 + 1e-3);
                        Truth { pixels: 1, within: u64::from(within), one_sided: 0 }
                    }
                    _ => Truth { pixels: 1, within: 0, one_sided: 1 },
                }
            })
            .reduce(Truth::default, Truth::add);
        total = total.add(compared);
    }
    Ok(total)
}

/// Depth of the nearest hit of a pixel's four rays, from `near` on.
fn nearest(rays: &Rays<'_>, lattice: &Lattice, at: I64Vec2, near: f64) -> Option<f64> {
    // Far enough out to be before everything, near enough to keep digits.
    let back = 4.0e3;
    let along = -lattice.direction.towards_eye();
    let hits = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)].into_iter().filter_map(|(x, y)| {
        let from = lattice.unproject((at.as_dvec2() + glam::DVec2::new(x, y)).extend(near - back));
        Some(rays.cast(from, along)? - back)
    });
    hits.min_by(f64::total_cmp)
}

fn stored(view: &Orthoview, lattice: &Lattice) -> Result<Orthoview, Fault> {
    let links = links(view, lattice, &Thresholds::default());
    let fault = |e: &dyn std::fmt::Display| Fault::new("an orthoview", e);
    let file = encode(view, &links, lattice.direction, Encoding::default()).map_err(|e| fault(&e))?;
    let bytes = file.ok_or_else(|| Fault::new("an orthoview", "nothing in it"))?;
    Ok(decode(&bytes).map_err(|e| fault(&e))?.view)
}

/// How two images of the same pixels compare.
#[derive(Clone, Copy, Debug, Default)]
pub struct Likeness {
    squares: f64,
    both: u64,
    either: u64,
    depths: f64,
}

impl Likeness {
    /// Of all pixels; `side` is theirs, metres.
    pub fn of(a: &[Pixel], b: &[Pixel], side: f64) -> Likeness {
        let mut likeness = Likeness::default();
        for (a, b) in a.iter().zip(b) {
            likeness.either += u64::from(a.is_some() || b.is_some());
            if a.is_some() && b.is_some() {
                likeness.both += 1;
                let off = |c: usize| f64::from(encoded(a.colour[c])) - f64::from(encoded(b.colour[c]));
                likeness.squares += (0..3).map(|c| off(c) * off(c)).sum::<f64>() / 3.0;
                likeness.depths += f64::from((a.depth - b.depth).abs()) / side;
            }
        }
        likeness
    }

    /// Adds another's pixels.
    pub fn add(&mut self, other: Likeness) {
        self.squares += other.squares;
        self.both += other.both;
        self.either += other.either;
        self.depths += other.depths;
    }

    /// Peak signal-to-noise ratio of the sRGB bytes of what both show, dB; at most 99.
    pub fn psnr(&self) -> f64 {
        let mean = self.squares / self.both.max(1) as f64;
        if mean > 0.0 { (10.0 * libm::log10(255.0 * 255.0 / mean)).min(99.0) } else { 99.0 }
    }

    /// Share of what either shows that both do.
    pub fn shared(&self) -> f64 {
        self.both as f64 / self.either.max(1) as f64
    }

    /// Mean difference of depths in sides of a pixel.
    pub fn depth_sides(&self) -> f64 {
        self.depths / self.both.max(1) as f64
    }
}

/// What a cell looks like by as many samples as its leaves have: nearest depth, and colours averaged over all samples of a
/// pixel that hit something, as a screen would.
fn supersampled(scene: &Scene, cell: Cell, lattice: &Lattice, holding: &super::scene::Holding) -> Orthoview {
    let mut view = Orthoview::empty(lattice, &scene.octree.bounds(cell), cell.level);
    let steps = cell.level + 1;
    let mut fine = view.clone();
    for _ in 0..steps {
        fine.rect = fine.rect.beneath();
    }
    fine.pixels = vec![Pixel::EMPTY; fine.rect.area()];
    let side = 0.5 * lattice.pitch;
    raster::draw(&scene.octree, cell, lattice, side, holding.meshes(), &mut fine, &mut Drawn::default());
    let factor = 1usize << steps;
    let (width, wide) = (view.rect.width(), fine.rect.width());
    for (index, pixel) in view.pixels.iter_mut().enumerate() {
        let corner = (index / width * wide + index % width) * factor;
        let (mut colour, mut count) = ([0.0f32; 3], 0.0f32);
        for row in 0..factor {
            for sample in fine.pixels[corner + row * wide..][..factor].iter().filter(|p| p.is_some()) {
                count += 1.0;
                (0..3).for_each(|c| colour[c] += sample.colour[c]);
                if sample.depth < pixel.depth {
                    *pixel = *sample;
                }
            }
        }
        if count > 0.0 {
            pixel.colour = colour.map(|c| c / count);
        }
    }
    view
}

/// What to measure.
pub struct Plan {
    /// Leaves that rays are cast into.
    pub leaves: usize,
    /// Cells of each level above.
    pub parents: usize,
    /// Highest level of these.
    pub level_max: u32,
    /// From where.
    pub directions: Vec<Direction>,
    /// By lot.
    pub seed: u64,
}

/// The tables of a scene.
///
/// # Errors
/// As [`leaf`].
pub fn findings(scene: &Scene, plan: &Plan) -> Result<Findings, Fault> {
    let mut findings = Findings::default();
    let name = &scene.name;
    let title = format!("{name}: leaves as stored against ray-cast ground truth");
    let mut table = Table::new(
        title,
        &["leaf", "pixels", "within half a quantum, %", "shown by one only, %", "half a quantum, mm"],
    );
    let mut total = Truth::default();
    for cell in some(scene.leaves(), plan.leaves, plan.seed) {
        let truth = leaf(scene, cell, &plan.directions)?;
        total = total.add(truth);
        let range = Orthoview::empty(&scene.lattice(plan.directions[0]), &scene.octree.bounds(cell), 0).range;
        table.row([
            json!(format!("{:?}", cell.place)),
            json!(truth.pixels),
            json!(100.0 * truth.share()),
            json!(100.0 * truth.one_sided as f64 / truth.pixels.max(1) as f64),
            json!(1e3 * depth_error(range)),
        ]);
    }
    table.row([
        json!("all"),
        json!(total.pixels),
        json!(100.0 * total.share()),
        json!(100.0 * total.one_sided as f64 / total.pixels.max(1) as f64),
        json!(null),
    ]);
    findings.tables.push(table);
    let (table, pictures) = parents(scene, plan)?;
    findings.tables.push(table);
    findings.pictures = pictures;
    Ok(findings)
}

/// Parents by level: composited against drawn directly with 2× antialiasing, and both against supersampling.
type Pictures = Vec<(String, Vec<u8>)>;

fn parents(scene: &Scene, plan: &Plan) -> Result<(Table, Pictures), Fault> {
    let title =
        format!("{}: parents composited up the tree, drawn directly (2 × 2 samples), and supersampled", scene.name);
    let mut table = Table::new(
        title,
        &[
            "level",
            "cells",
            "composited : direct, dB",
            "composited : supersampled, dB",
            "direct : supersampled, dB",
            "shown by both, %",
            "depth apart, pixels",
        ],
    );
    let mut pictures = Vec::new();
    for level in 1..=scene.octree.root().level.min(plan.level_max) {
        let cells = some(scene.cells(level), plan.parents, plan.seed ^ u64::from(level));
        let mut sums = [Likeness::default(); 3];
        for (number, &cell) in cells.iter().enumerate() {
            let holding = scene.holding(cell)?;
            let of: Vec<_> = plan
                .directions
                .par_iter()
                .map(|&direction| {
                    let lattice = scene.lattice(direction);
                    let direct = raster::leaf(&scene.octree, cell, &lattice, holding.meshes(), &mut Drawn::default());
                    let direct =
                        direct.unwrap_or_else(|| Orthoview::empty(&lattice, &scene.octree.bounds(cell), level));
                    let composited = composited(scene, cell, &lattice, &holding);
                    let many = supersampled(scene, cell, &lattice, &holding);
                    let side = lattice.pitch * f64::from(1u32 << level);
                    let like = |a: &Orthoview, b: &Orthoview| Likeness::of(&a.pixels, &b.pixels, side);
                    let figures = [like(&composited, &direct), like(&composited, &many), like(&direct, &many)];
                    (figures, [composited, direct, many])
                })
                .collect();
            for (figures, images) in &of {
                sums.iter_mut().zip(figures).for_each(|(sum, figure)| sum.add(*figure));
                if number == 0 && pictures.len() < 3 * level as usize {
                    for (kind, image) in ["composited", "direct", "supersampled"].into_iter().zip(images) {
                        pictures.push((format!("level-{level}-{kind}.png"), picture::colours(image)));
                    }
                }
            }
        }
        table.row([
            json!(level),
            json!(cells.len()),
            json!(sums[0].psnr()),
            json!(sums[1].psnr()),
            json!(sums[2].psnr()),
            json!(100.0 * sums[0].shared()),
            json!(sums[0].depth_sides()),
        ]);
    }
    Ok((table, pictures))
}

/// A cell's image, composited from its leaves. Recursion goes down the tree.
fn composited(scene: &Scene, cell: Cell, lattice: &Lattice, holding: &super::scene::Holding) -> Orthoview {
    let bounds = scene.octree.bounds(cell);
    let mut view = Orthoview::empty(lattice, &bounds, cell.level);
    if cell.level == 0 {
        return raster::leaf(&scene.octree, cell, lattice, holding.meshes(), &mut Drawn::default()).unwrap_or(view);
    }
    let mut double = composite::doubled(&view);
    for child in scene.octree.children(cell) {
        composite::overlay(&mut double, &composited(scene, child, lattice, holding));
    }
    composite::halved(&double, &mut view, lattice.pitch * (1u64 << cell.level) as f64);
    view
}
