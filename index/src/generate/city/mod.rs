//! A made-up city: streets on a jittered grid, blocks of buildings that rise towards the centre, parks with trees.
//! z is up and the ground lies at 0; the middle of the city is the origin.
//!
//! The tree is an LOD-R-tree: districts in a quadtree, each with simplified geometry whose error doubles from level to
//! level; then blocks; then buildings with three levels of detail, the finest of which refines the middle one.

#[cfg(feature = "textures")]
mod facade;
#[cfg(feature = "textures")]
pub mod geometry;
#[cfg(feature = "textures")]
mod model;
mod orthoviews;
#[cfg(all(feature = "orthoviews", feature = "textures"))]
mod surfaces;

use foresight_scheduler::lod_tree::{Aabb, LodTreeBuilder, LodTreeError, RepId, Representation};
use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

#[cfg(all(feature = "orthoviews", feature = "textures"))]
pub use surfaces::CitySurfaces;

use super::document::{GenerateError, Key, ParamError, Params, length, put, range};
use super::random::Random;
use crate::ground::Ground;
use crate::uris::UriTableBuilder;
use crate::world::{World, WorldKind};

/// Most blocks of a city.
pub const MAX_BLOCKS: u64 = 1 << 19;

/// What a city is made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CityParams {
    /// Blocks from west to east, at least 1.
    pub blocks_x: u32,
    /// Blocks from south to north, at least 1.
    pub blocks_y: u32,
    /// Names the city among those of its size.
    pub seed: u64,
    /// From street to street, metres, 40 to 1000.
    pub pitch: f64,
    /// Width of the streets, metres, 0 to a third of the pitch.
    pub street: f64,
    /// Height that the tallest towers approach, metres, 20 to 1000.
    pub tower_height: f64,
    /// Share of the blocks that are parks, 0 to 1.
    pub park_share: f64,
    /// Pixels along a cell's orthoviews, 16 to 4096: districts and blocks then own one from each of nine directions instead
    /// of coarse geometry. 0 for none.
    #[serde(skip_serializing_if = "is_zero")]
    pub orthoviews: u32,
}

fn is_zero(pixels: &u32) -> bool {
    *pixels == 0
}

impl Default for CityParams {
    /// About 2 km × 2 km.
    fn default() -> CityParams {
        CityParams {
            blocks_x: 20,
            blocks_y: 20,
            seed: 1,
            pitch: 100.0,
            street: 14.0,
            tower_height: 160.0,
            park_share: 0.07,
            orthoviews: 0,
        }
    }
}

impl Params for CityParams {
    const FORMAT: &'static str = "foresight-city";
    const SCHEMA_VERSION: u32 = 1;
    const FILE_NAME: &'static str = "city.json";
    const KEYS: &'static [Key<CityParams>] = &[
        Key {
            name: "blocks",
            expected: "blocks along each side",
            set: |params, text| {
                let blocks = text.parse().ok()?;
                (params.blocks_x, params.blocks_y) = (blocks, blocks);
                Some(())
            },
        },
        Key { name: "seed", expected: "a whole number", set: |params, text| put(&mut params.seed, text.parse().ok()) },
        Key {
            name: "pitch",
            expected: "a length such as 100m",
            set: |params, text| put(&mut params.pitch, length(text)),
        },
        Key {
            name: "street",
            expected: "a length such as 14m",
            set: |params, text| put(&mut params.street, length(text)),
        },
        Key {
            name: "tower-height",
            expected: "a length such as 160m",
            set: |params, text| put(&mut params.tower_height, length(text)),
        },
        Key {
            name: "park-share",
            expected: "a number from 0 to 1",
            set: |params, text| put(&mut params.park_share, text.parse().ok()),
        },
        Key {
            name: "orthoviews",
            expected: "pixels along a cell, 16 to 4096, or 0 for none",
            set: |params, text| put(&mut params.orthoviews, text.parse().ok()),
        },
    ];

    fn check(&self) -> Result<(), ParamError> {
        range("blocks_x", f64::from(self.blocks_x), 1.0, 65_536.0)?;
        range("blocks_y", f64::from(self.blocks_y), 1.0, 65_536.0)?;
        let blocks = u64::from(self.blocks_x) * u64::from(self.blocks_y);
        range("blocks_x times blocks_y", blocks as f64, 1.0, MAX_BLOCKS as f64)?;
        range("pitch", self.pitch, 40.0, 1000.0)?;
        range("street", self.street, 0.0, self.pitch / 3.0)?;
        range("tower_height", self.tower_height, 20.0, 1000.0)?;
        range("park_share", self.park_share, 0.0, 1.0)?;
        if self.orthoviews == 0 { Ok(()) } else { range("orthoviews", f64::from(self.orthoviews), 16.0, 4096.0) }
    }

    fn build(&self) -> Result<World, GenerateError> {
        city(self)
    }
}

/// Builds a city. The same parameters give the same world on every machine.
pub fn city(params: &CityParams) -> Result<World, GenerateError> {
    Ok(laid_out(params)?.0)
}

/// A city with what stands in each of its leaves, in the leaves' order.
fn laid_out(params: &CityParams) -> Result<(World, Vec<Standing>), GenerateError> {
    params.check()?;
    let (builder, uris) = (LodTreeBuilder::default(), UriTableBuilder::default());
    let mut city = City { params, builder, uris, standing: Vec::new() };
    city.district([0, params.blocks_x, 0, params.blocks_y])?;
    let world = World {
        name: "city".to_owned(),
        kind: WorldKind::City,
        tree: city.builder.finish()?,
        uris: city.uris.finish(),
        up: DVec3::Z,
        ground: Ground::Flat(0.0),
        georeference: None,
        root_sample: None,
        notes: Vec::new(),
    };
    Ok((world, city.standing))
}

/// What stands in a leaf.
#[derive(Clone, Copy, Debug)]
enum Standing {
    Ground(Rectangle),
    Tree { at: DVec2, radius: f64, height: f64 },
    Building { footprint: Rectangle, height: f64 },
}

impl Standing {
    fn bounds(self) -> Aabb {
        match self {
            Standing::Ground(whole) => whole.raised(-0.2, 0.0),
            Standing::Tree { at, radius, height } => {
                Rectangle { min: at - radius, max: at + radius }.raised(0.0, height)
            }
            Standing::Building { footprint, height } => footprint.raised(0.0, height),
        }
    }
}

/// A rectangle on the ground, metres.
#[derive(Clone, Copy, Debug)]
struct Rectangle {
    min: DVec2,
    max: DVec2,
}

impl Rectangle {
    fn size(self) -> DVec2 {
        self.max - self.min
    }

    fn inset(self, by: f64) -> Rectangle {
        Rectangle { min: self.min + by, max: self.max - by }
    }

    fn raised(self, low: f64, high: f64) -> Aabb {
        Aabb { min: self.min.extend(low), max: self.max.extend(high) }
    }
}

/// Wire bytes, decoded bytes per wire byte, and error of a level of detail.
struct Level {
    wire: f64,
    unfolds: f64,
    error: f64,
}

/// Error of a block's coarse representation, metres; that of the district of 2ʰ × 2ʰ blocks is 2ʰ times as large.
const BLOCK_ERROR: f64 = 2.0;
/// Buildings are not split below this length, metres.
const LOT: f64 = 34.0;

/// Streams of random numbers.
const STREETS_X: u64 = 1;
const STREETS_Y: u64 = 2;
const BLOCK: u64 = 3;
const DISTRICT: u64 = 4;

struct City<'a> {
    params: &'a CityParams,
    builder: LodTreeBuilder,
    uris: UriTableBuilder,
    standing: Vec<Standing>,
}

impl City<'_> {
    /// The blocks from..to along x and y. Recursion halves the longer side: at most 17 deep on each axis.
    fn district(&mut self, [x0, x1, y0, y1]: [u32; 4]) -> Result<(), LodTreeError> {
        if x1 - x0 == 1 && y1 - y0 == 1 {
            return self.block(x0, y0);
        }
        let side = (x1 - x0).max(y1 - y0);
        let height = side.next_power_of_two().trailing_zeros();
        let mut random = Random::at(self.params.seed, DISTRICT + u64::from(height), u64::from(x0), u64::from(y0));
        self.builder.open()?;
        let error = libm::ldexp(BLOCK_ERROR, height as i32);
        let level = Level { wire: random.within(20e3, 60e3), unfolds: random.within(4.0, 8.0), error };
        let cell = self.between([x0, x1, y0, y1]);
        self.cell(cell, &level, &format!("districts/{height}/"), &format!("{x0}_{y0}.glb"))?;
        let halves = |from: u32, to: u32| {
            let middle = from + (to - from).div_ceil(2);
            [(from, middle), (middle, to)].into_iter().filter(|(from, to)| from < to)
        };
        for (y0, y1) in halves(y0, y1) {
            for (x0, x1) in halves(x0, x1) {
                self.district([x0, x1, y0, y1])?;
            }
        }
        self.builder.close(None, 1.0)
    }

    /// The middle of street `index` of `count` + 1, metres. Inner streets are off the grid by up to 8 % of the pitch.
    fn street(&self, axis: u64, index: u32, count: u32) -> f64 {
        let regular = (f64::from(index) - 0.5 * f64::from(count)) * self.params.pitch;
        if index == 0 || index == count {
            return regular;
        }
        regular + Random::at(self.params.seed, axis, u64::from(index), 0).within(-0.08, 0.08) * self.params.pitch
    }

    /// The ground of the blocks from..to along x and y.
    fn between(&self, [x0, x1, y0, y1]: [u32; 4]) -> Rectangle {
        let CityParams { blocks_x, blocks_y, .. } = *self.params;
        let corner =
            |x: u32, y: u32| DVec2::new(self.street(STREETS_X, x, blocks_x), self.street(STREETS_Y, y, blocks_y));
        Rectangle { min: corner(x0, y0), max: corner(x1, y1) }
    }

    /// How near a place is to the middle of the city, 0 to 1.
    fn centrality(&self, at: DVec2) -> f64 {
        let radius = 0.2 * self.params.pitch * f64::from(self.params.blocks_x.max(self.params.blocks_y));
        libm::exp(-at.length_squared() / (radius * radius))
    }

    fn block(&mut self, x: u32, y: u32) -> Result<(), LodTreeError> {
        let CityParams { seed, street, .. } = *self.params;
        let whole = self.between([x, x + 1, y, y + 1]);
        let mut random = Random::at(seed, BLOCK, u64::from(x), u64::from(y));
        let folder = format!("blocks/{x}_{y}/");
        let is_park = random.unit() < self.params.park_share;
        let inner = whole.inset(0.5 * street);

        self.builder.open()?;
        let wire = if is_park { random.within(2e3, 5e3) } else { random.within(6e3, 14e3) };
        let coarse = Level { wire, unfolds: random.within(5.0, 9.0), error: BLOCK_ERROR };
        self.cell(whole, &coarse, &folder, "block.glb")?;
        self.ground(whole, &mut random, &folder)?;
        if is_park {
            let trees = 12 + (random.unit() * 20.0) as u32;
            for tree in 0..trees {
                self.tree(inner, tree, &mut random, &folder)?;
            }
        } else {
            for (index, lot) in lots(inner, &mut random).into_iter().enumerate() {
                // Some lots are yards.
                if index == 0 || random.unit() > 0.06 {
                    self.building(lot, index, &mut random, &folder)?;
                }
            }
        }
        self.builder.close(None, 1.0)
    }

    /// The ground of a block, with half of the streets around it.
    fn ground(&mut self, whole: Rectangle, random: &mut Random, folder: &str) -> Result<(), LodTreeError> {
        self.builder.open()?;
        let coarse = Level { wire: random.within(1.2e3, 2.5e3), unfolds: random.within(6.0, 10.0), error: 0.6 };
        self.add(&coarse, None, folder, "ground-0.glb")?;
        let fine = Level { wire: random.within(40e3, 90e3), unfolds: random.within(6.0, 10.0), error: 0.05 };
        self.add(&fine, None, folder, "ground-1.glb")?;
        self.stand(Standing::Ground(whole))
    }

    fn tree(&mut self, inner: Rectangle, index: u32, random: &mut Random, folder: &str) -> Result<(), LodTreeError> {
        let radius = random.within(1.5, 4.0);
        let height = radius * random.within(2.2, 4.0);
        let room = inner.inset(radius);
        let at = DVec2::new(random.within(room.min.x, room.max.x), random.within(room.min.y, room.max.y));
        self.builder.open()?;
        let card = Level { wire: random.within(1.0e3, 2.0e3), unfolds: random.within(6.0, 10.0), error: 0.5 };
        self.add(&card, None, folder, &format!("tree-{index}-0.glb"))?;
        let mesh = Level { wire: random.within(12e3, 30e3), unfolds: random.within(4.0, 7.0), error: 0.05 };
        self.add(&mesh, None, folder, &format!("tree-{index}-1.glb"))?;
        self.stand(Standing::Tree { at, radius, height })
    }

    fn building(
        &mut self,
        lot: Rectangle,
        index: usize,
        random: &mut Random,
        folder: &str,
    ) -> Result<(), LodTreeError> {
        let footprint = lot.inset(random.within(0.5, 2.5));
        let centre = 0.5 * (footprint.min + footprint.max);
        let centrality = self.centrality(centre);
        let draw = random.unit();
        let height = random.within(8.0, 24.0) + self.params.tower_height * centrality * draw * draw;
        // Façades of 60 m × 60 m at the lower end of each range, those of the tallest towers at its upper end.
        let facade = 2.0 * (footprint.size().x + footprint.size().y) * height;
        let detail = (facade / 20e3).min(1.0);
        let mut sized = |low: f64, high: f64| (low + (high - low) * detail) * random.within(0.85, 1.15);
        let model = Level { wire: sized(1.6e3, 2.6e3), unfolds: 9.0, error: 1.0 };
        let textured = Level { wire: sized(34e3, 70e3), unfolds: 7.0, error: 0.15 };
        let facades = Level { wire: sized(178e3, 348e3), unfolds: 5.0, error: 0.02 };
        let mut unfold = |level: Level| Level { unfolds: level.unfolds * random.within(0.85, 1.1), ..level };
        self.builder.open()?;
        self.add(&unfold(model), None, folder, &format!("building-{index}-0.glb"))?;
        let middle = self.add(&unfold(textured), None, folder, &format!("building-{index}-1.glb"))?;
        self.add(&unfold(facades), Some(middle), folder, &format!("building-{index}-2.glb"))?;
        self.stand(Standing::Building { footprint, height })
    }

    /// Closes a leaf around what stands in it.
    fn stand(&mut self, standing: Standing) -> Result<(), LodTreeError> {
        self.standing.push(standing);
        if self.params.orthoviews > 0 {
            self.builder.surface(standing.surface())?;
        }
        self.builder.close(Some(standing.bounds()), 1.0)
    }

    fn add(&mut self, level: &Level, needs: Option<RepId>, folder: &str, file: &str) -> Result<RepId, LodTreeError> {
        let (prefix, tail) = (self.uris.intern(folder), self.uris.intern(file));
        self.uris.push(prefix, tail);
        #[expect(clippy::cast_possible_truncation, reason = "a few metres, to 7 digits")]
        let error = level.error as f32;
        self.builder.add(Representation {
            wire_bytes: level.wire as u32,
            decoded_bytes: (level.wire * level.unfolds) as u32,
            error,
            prerequisite: needs,
            direction: None,
        })
    }
}

/// Splits a block across its longer side until every lot is at most a building long.
fn lots(block: Rectangle, random: &mut Random) -> Vec<Rectangle> {
    let mut waiting = vec![block];
    let mut lots = Vec::new();
    while let Some(part) = waiting.pop() {
        let size = part.size();
        if size.max_element() < LOT {
            lots.push(part);
            continue;
        }
        let cut = random.within(0.38, 0.62);
        let (mut left, mut right) = (part, part);
        if size.x >= size.y {
            left.max.x = part.min.x + cut * size.x;
            right.min.x = left.max.x;
        } else {
            left.max.y = part.min.y + cut * size.y;
            right.min.y = left.max.y;
        }
        waiting.extend([right, left]);
    }
    lots
}

#[cfg(test)]
mod tests {
    use foresight_scheduler::lod_tree::NodeId;
    use proptest::prelude::*;

    use super::*;
    use crate::generate::document;
    use crate::world::{built_in_city, open};

    #[test]
    fn the_built_in_city() {
        let world = built_in_city();
        let summary = world.summary();
        assert!(summary.representations >= 10_000, "{summary:?}");
        assert!(summary.bounds.centre().truncate().length() < 1.0, "{summary:?}");
        let size = summary.bounds.max - summary.bounds.min;
        assert!((1900.0..=2100.0).contains(&size.x) && (1900.0..=2100.0).contains(&size.y), "{summary:?}");
        assert!((60.0..=200.0).contains(&summary.bounds.max.z), "{summary:?}");
        assert_eq!(world.ground_height(DVec3::new(3.0, 4.0, 500.0)), Some(0.0));
        assert_eq!(world.hash(), built_in_city().hash());
        assert_ne!(world.hash(), city(&CityParams { seed: 2, ..CityParams::default() }).unwrap().hash());
    }

    #[test]
    fn sizes_and_errors_are_plausible() {
        let world = built_in_city();
        let tree = &world.tree;
        let mut finest = 0;
        for rep in (0..tree.representations() as u32).map(RepId) {
            let (wire, decoded) = (tree.wire_bytes(rep) as f64, tree.decoded_bytes(rep) as f64);
            assert!((3.9..=10.1).contains(&(decoded / wire)), "{}: {wire} {decoded}", world.uri(rep));
            if let Some(needed) = tree.prerequisite(rep) {
                finest += 1;
                assert_eq!(tree.node_of(needed), tree.node_of(rep));
                assert!((150e3..=405e3).contains(&wire) && (28e3..=82e3).contains(&(tree.wire_bytes(needed) as f64)));
                assert!(tree.error(rep) < tree.error(needed));
            }
        }
        assert!(finest > 3000, "{finest}");
        for node in (0..tree.nodes() as u32).map(NodeId) {
            let coarsest = tree.own(node).map(|rep| tree.error(rep)).fold(0.0, f64::max);
            if let Some(parent) = tree.parent(node) {
                let above = tree.own(parent).map(|rep| tree.error(rep)).fold(f64::INFINITY, f64::min);
                assert!(coarsest < above, "{node:?}: {coarsest} beneath {above}");
            }
        }
    }

    #[test]
    fn a_written_city_is_opened_again() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("small");
        let params = CityParams { blocks_x: 3, blocks_y: 1, seed: u64::MAX, ..CityParams::default() };
        document::write(&params, &out).unwrap();
        assert_eq!(open(&out).unwrap().hash(), city(&params).unwrap().hash());
        assert_eq!(open(&out.join(CityParams::FILE_NAME)).unwrap().hash(), city(&params).unwrap().hash());
        assert!(document::write(&params, &out).unwrap_err().to_string().contains("not empty"));
    }

    #[test]
    fn refuses_parameters_out_of_range() {
        let with = |text: &str| {
            document::parse::<CityParams>(
                format!(r#"{{"format":"foresight-city","schema_version":1,"params":{text}}}"#).as_bytes(),
            )
        };
        assert_eq!(with(r#"{"seed":7}"#), Ok(CityParams { seed: 7, ..CityParams::default() }));
        for (text, name) in [
            (r#"{"blocks_x":0}"#, "blocks_x"),
            (r#"{"blocks_x":65536,"blocks_y":65536}"#, "blocks_x times blocks_y"),
            (r#"{"street":80}"#, "street"),
            (r#"{"pitch":1e999}"#, "line 1"),
            (r#"{"hight":3}"#, "line 1"),
        ] {
            let error = with(text).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
        assert!(
            document::parse::<CityParams>(br#"{"format":"foresight-town","schema_version":1,"params":{}}"#).is_err()
        );
        assert!(
            document::parse::<CityParams>(br#"{"format":"foresight-city","schema_version":9,"params":{}}"#).is_err()
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn every_city_in_range_is_built(x in 1_u32..9, y in 1_u32..9, seed: u64, pitch in 40.0..300.0, share in 0.0..=1.0) {
            let params = CityParams { blocks_x: x, blocks_y: y, seed, pitch, street: 0.3 * pitch, park_share: share, ..CityParams::default() };
            let world = city(&params).unwrap();
            prop_assert_eq!(world.uris.len(), world.tree.representations());
            prop_assert!(world.summary().leaves >= u64::from(x * y));
        }
    }
}
