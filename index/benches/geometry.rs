//! Geometry of a leaf: all its levels, measured and encoded, from a hilly square of triangles; and what the parts cost that
//! depend on the packing.

use std::sync::Arc;

use criterion::{BenchmarkId, Criterion, Throughput};
use foresight_index::format::glb_compressed::Packing;
use foresight_index::geometry::{GeometrySettings, levels};
use foresight_index::octree::{Cell, Octree};
use foresight_index::orthoview::raster::Triangle;
use foresight_index::orthoview::texture::{Material, Materials, Texture};
use foresight_scheduler::lod_tree::Aabb;
use glam::{DVec2, DVec3};
use std::hint::black_box;

const SIDE: f64 = 64.0;

/// 2 n² triangles over the leaf, textured once over.
fn hills(n: u32) -> Vec<Triangle> {
    let at = |i: u32, j: u32| {
        let (x, y) = (SIDE * f64::from(i) / f64::from(n), SIDE * f64::from(j) / f64::from(n));
        let fine = 0.02 * libm::sin(x * 9.1) * libm::sin(y * 7.3);
        DVec3::new(x, y, 20.0 + 6.0 * libm::sin(x * 0.11) * libm::cos(y * 0.13) + 0.5 * libm::sin(x + 0.7 * y) + fine)
    };
    let uv = |i: u32, j: u32| DVec2::new(f64::from(i), f64::from(j)) / f64::from(n);
    let mut triangles = Vec::new();
    for (i, j) in (0..n).flat_map(|j| (0..n).map(move |i| (i, j))) {
        for corners in [[(i, j), (i + 1, j), (i + 1, j + 1)], [(i, j), (i + 1, j + 1), (i, j + 1)]] {
            let (corners, uv) = (corners.map(|(i, j)| at(i, j)), corners.map(|(i, j)| uv(i, j)));
            triangles.push(Triangle { corners, uv, ..Triangle::default() });
        }
    }
    triangles
}

fn materials(side: u32) -> Materials {
    let texels = (0..side * side).map(|i| [(i % side % 256) as u8, (i / side % 256) as u8, (i * 31 % 64) as u8, 255]);
    let texture = Texture::new(side as usize, side as usize, texels.collect());
    let material = Material { texture: Some(0), ..Material::default() };
    Materials { materials: vec![material], textures: vec![Some(Arc::new(texture))] }
}

fn main() {
    let mut criterion = Criterion::default().sample_size(10).configure_from_args();
    let octree = Octree::over(Aabb { min: DVec3::ZERO, max: DVec3::splat(SIDE) }, SIDE).expect("a box");
    let cell = Cell { level: 0, place: [0; 3] };
    let plain = Materials::default();
    let mut group = criterion.benchmark_group("levels");
    for n in [32, 100, 223] {
        let content = hills(n);
        group.throughput(Throughput::Elements(content.len() as u64));
        let settings = GeometrySettings::default();
        group.bench_function(BenchmarkId::new("untextured", content.len()), |bencher| {
            bencher.iter(|| black_box(levels(&[(&content, &plain)], &octree, cell, &settings).expect("geometry")));
        });
    }
    let content = hills(100);
    group.throughput(Throughput::Elements(content.len() as u64));
    for side in [256, 1024] {
        let textured = materials(side);
        let settings = GeometrySettings::default();
        group.bench_function(BenchmarkId::new("textured", side), |bencher| {
            bencher.iter(|| black_box(levels(&[(&content, &textured)], &octree, cell, &settings).expect("geometry")));
        });
    }
    for packing in [Packing::Floats, Packing::Quantised, Packing::Compressed] {
        let settings = GeometrySettings { coarsest: 0.0, packing, ..GeometrySettings::default() };
        group.bench_function(BenchmarkId::new("finest alone", format!("{packing:?}")), |bencher| {
            bencher.iter(|| black_box(levels(&[(&content, &plain)], &octree, cell, &settings).expect("geometry")));
        });
    }
    group.finish();
    criterion.final_summary();
}
