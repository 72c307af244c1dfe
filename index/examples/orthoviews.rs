//! Scratch: builds the orthoviews of a tileset and prints figures.
use foresight_index::format::orthoview::{ColourCodec, Encoding, encode};
use foresight_index::import::tiles3d::surface::{FinestContents, Surfaces};
use foresight_index::octree::{Cell, Octree};
use foresight_index::orthoview::build::{LeafContent, Workshop, build};
use foresight_index::orthoview::connectivity::{Thresholds, links};
use foresight_index::orthoview::direction::nine;
use foresight_index::orthoview::{Direction, Lattice, Orthoview};
use foresight_scheduler::lod_tree::Aabb;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

struct Shop {
    octree: Octree,
    contents: FinestContents,
    of_leaf: BTreeMap<[u64; 3], Vec<usize>>,
    occupied: BTreeSet<Cell>,
    cache: BTreeMap<usize, Surfaces>,
    bytes: BTreeMap<String, u64>,
    per_level: BTreeMap<u32, (u64, u64)>,
    pitch: f64,
    out: std::path::PathBuf,
}

impl Workshop for Shop {
    type Error = String;
    fn is_occupied(&self, cell: Cell) -> bool {
        self.occupied.contains(&cell)
    }
    fn with_content(&mut self, cell: Cell, draw: &mut dyn FnMut(&LeafContent<'_>)) -> Result<(), String> {
        let ids = &self.of_leaf[&cell.place];
        self.cache.retain(|id, _| ids.contains(id));
        let missing: Vec<_> = ids.iter().copied().filter(|id| !self.cache.contains_key(id)).collect();
        let loaded: Vec<_> = missing.par_iter().map(|&id| (id, self.contents.load(id).expect("loads"))).collect();
        self.cache.extend(loaded);
        let meshes = ids
            .iter()
            .map(|id| {
                let s = &self.cache[id];
                (&s.triangles[..], &s.materials as &(dyn foresight_index::orthoview::raster::Surface + Sync))
            })
            .collect();
        draw(&LeafContent { meshes });
        Ok(())
    }
    fn keep(&mut self, cell: Cell, images: &[(Direction, &Orthoview)]) -> Result<(), String> {
        let (origin, pitch) = (self.octree.origin(), self.pitch);
        let files: Vec<_> = images
            .par_iter()
            .map(|(d, view)| {
                let lattice = Lattice { direction: *d, origin, pitch };
                let links = links(view, &lattice, &Thresholds::default());
                let enc = |colour, normals| {
                    encode(view, &links, *d, Encoding { colour, normals }).unwrap().map_or(0, |f| f.len() as u64)
                };
                let plain = encode(view, &links, *d, Encoding { colour: ColourCodec::WebpLossless, normals: true })
                    .unwrap()
                    .unwrap_or_default();
                (
                    d.name(),
                    plain,
                    [
                        ("png", enc(ColourCodec::Png, false)),
                        ("webp", enc(ColourCodec::WebpLossless, false)),
                        ("jpeg90", enc(ColourCodec::Jpeg(90), false)),
                        ("jpeg50", enc(ColourCodec::Jpeg(50), false)),
                        ("webp+normals", enc(ColourCodec::WebpLossless, true)),
                    ],
                )
            })
            .collect();
        for (name, plain, sizes) in files {
            for (k, b) in sizes {
                *self.bytes.entry(k.to_owned()).or_default() += b;
            }
            let e = self.per_level.entry(cell.level).or_default();
            e.0 += 1;
            e.1 += plain.len() as u64;
            let dir = self.out.join(format!("{}/{}_{}_{}", cell.level, cell.place[0], cell.place[1], cell.place[2]));
            std::fs::create_dir_all(&dir).unwrap();
            std::fs::write(dir.join(format!("{name}.fsov")), plain).unwrap();
        }
        if cell.level + 1 >= self.octree.root().level {
            for (d, view) in images {
                let (w, h) = (view.rect.width() as u32, view.rect.height() as u32);
                let mut rgb = Vec::new();
                for y in (0..h).rev() {
                    for x in 0..w {
                        let p = view.pixels[(y * w + x) as usize];
                        rgb.extend(p.colour.map(foresight_index::orthoview::texture::encoded));
                    }
                }
                image::save_buffer(
                    self.out.join(format!(
                        "L{}_{}_{}_{}_{}.png",
                        cell.level,
                        cell.place[0],
                        cell.place[1],
                        cell.place[2],
                        d.name()
                    )),
                    &rgb,
                    w,
                    h,
                    image::ColorType::Rgb8,
                )
                .unwrap();
            }
        }
        Ok(())
    }
}

fn main() {
    let args: Vec<String> = std::env::args().collect();
    let (side, q): (f64, f64) = (args[3].parse().unwrap(), args[4].parse().unwrap());
    let contents = FinestContents::open(std::path::Path::new(&args[1])).unwrap();
    let boxes: Vec<(Aabb, usize)> = (0..contents.len())
        .into_par_iter()
        .map(|i| {
            let s = contents.load(i).unwrap();
            (s.bounds(), s.triangles.len())
        })
        .collect();
    let bounds = boxes.iter().fold(Aabb::EMPTY, |b, (x, _)| b.union(*x));
    let triangles: usize = boxes.iter().map(|b| b.1).sum();
    let octree = Octree::over(bounds, side).unwrap();
    let mut of_leaf: BTreeMap<[u64; 3], Vec<usize>> = BTreeMap::new();
    let mut occupied = BTreeSet::new();
    for (i, (b, _)) in boxes.iter().enumerate() {
        let [x, y, z] = octree.leaves(b);
        for x in x[0]..=x[1] {
            for y in y[0]..=y[1] {
                for z in z[0]..=z[1] {
                    of_leaf.entry([x, y, z]).or_default().push(i);
                    let mut c = Some(Cell { level: 0, place: [x, y, z] });
                    while let Some(cell) = c {
                        occupied.insert(cell);
                        c = octree.parent(cell);
                    }
                }
            }
        }
    }
    println!(
        "{} contents, {triangles} triangles, bounds {:?}, splits {:?}, {} leaves",
        contents.len(),
        bounds,
        octree.splits(),
        of_leaf.len()
    );
    let pitch = side / q;
    let mut shop = Shop {
        octree,
        contents,
        of_leaf,
        occupied,
        cache: BTreeMap::new(),
        bytes: BTreeMap::new(),
        per_level: BTreeMap::new(),
        pitch,
        out: args[2].clone().into(),
    };
    std::fs::create_dir_all(&shop.out).unwrap();
    let made = build(&octree, &nine(), pitch, &mut shop).unwrap();
    println!("{made:?}\n{:?}\n{:?}", shop.bytes, shop.per_level);
}
