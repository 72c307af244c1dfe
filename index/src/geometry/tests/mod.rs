//! What leaves' geometry is made of, on content whose answer is known.

mod cut;
mod hostile;
mod measured;
mod read;

use super::*;
use crate::orthoview::raster::Triangle;
use crate::orthoview::texture::{Material, Texture};
use glam::DVec2;

/// A grid of leaves of side 8 m, two along x.
fn octree() -> Octree {
    Octree::over(Aabb { min: DVec3::new(100.0, 50.0, -4.0), max: DVec3::new(116.0, 58.0, 4.0) }, 8.0).expect("a box")
}

fn cell(x: u64) -> Cell {
    Cell { level: 0, place: [x, 0, 0] }
}

fn triangle(corners: [DVec3; 3]) -> Triangle {
    Triangle { corners, uv: [DVec2::ZERO; 3], material: 0, tint: Triangle::WHITE, two_sided: false }
}

/// A hilly square over both leaves and a little beyond, `cells` along x, textured once over.
fn hills(cells: u32, height: f64) -> Vec<Triangle> {
    let step = 17.0 / f64::from(cells);
    let at = |i: u32, j: u32| {
        let (x, y) = (99.5 + f64::from(i) * step, 49.5 + f64::from(j) * step);
        DVec3::new(x, y, height * (libm::sin(0.9 * x) * libm::cos(1.1 * y) + 0.3 * libm::sin(3.1 * x + 2.0 * y)))
    };
    let uv = |i: u32, j: u32| DVec2::new(f64::from(i), f64::from(j)) / f64::from(cells);
    let mut triangles = Vec::new();
    for j in 0..cells * 9 / 17 {
        for i in 0..cells {
            for [a, b, c] in [[(0, 0), (1, 0), (1, 1)], [(0, 0), (1, 1), (0, 1)]] {
                let corner = |(x, y): (u32, u32)| at(i + x, j + y);
                let shown = |(x, y): (u32, u32)| uv(i + x, j + y);
                let (corners, uv) = ([corner(a), corner(b), corner(c)], [shown(a), shown(b), shown(c)]);
                triangles.push(Triangle { corners, uv, material: 0, tint: Triangle::WHITE, two_sided: false });
            }
        }
    }
    triangles
}

/// A texture whose texels differ, over the hills: 3.4 cm a texel.
fn painted() -> Materials {
    let texels = (0..500 * 500_u32).map(|i| [(i % 251) as u8, (i / 977) as u8, (i * 31 % 256) as u8, 255]).collect();
    let material = Material { texture: Some(0), ..Material::default() };
    Materials { materials: vec![material], textures: vec![Some(std::sync::Arc::new(Texture::new(500, 500, texels)))] }
}

fn made(content: &[Triangle], materials: &Materials, place: u64) -> Vec<GeometryLevel> {
    levels(&[(content, materials)], &octree(), cell(place), &GeometrySettings::default()).expect("geometry")
}

/// JSON and binary chunk of a GLB.
fn chunks(glb: &[u8]) -> (serde_json::Value, &[u8]) {
    let length = u32::from_le_bytes(glb[12..16].try_into().expect("four bytes")) as usize;
    (serde_json::from_slice(&glb[20..20 + length]).expect("JSON"), &glb[20 + length + 8..])
}

/// Vertices of a compressed level in the world, by primitive, and its triangles.
fn decoded(glb: &[u8]) -> Vec<(Vec<DVec3>, Vec<[u32; 3]>)> {
    let (json, binary) = chunks(glb);
    let number = |value: &serde_json::Value| value.as_u64().unwrap_or(0) as usize;
    let packed = |view: usize| {
        let extension = &json["bufferViews"][view]["extensions"]["EXT_meshopt_compression"];
        let start = number(&extension["byteOffset"]);
        (&binary[start..start + number(&extension["byteLength"])], number(&extension["count"]))
    };
    let vector =
        |value: &serde_json::Value| DVec3::from_array(std::array::from_fn(|i| value[i].as_f64().unwrap_or_default()));
    let mut offset = DVec3::ZERO;
    let mut scale = 1.0;
    for node in json["nodes"].as_array().expect("nodes") {
        offset += vector(&node["translation"]);
        scale = node["scale"][0].as_f64().unwrap_or(scale);
    }
    let primitives = json["meshes"][0]["primitives"].as_array().expect("primitives");
    primitives
        .iter()
        .map(|primitive| {
            let accessor = |at: &serde_json::Value| json["accessors"][number(at)].clone();
            let positions = accessor(&primitive["attributes"]["POSITION"]);
            let (bytes, count) = packed(number(&positions["bufferView"]));
            let vertices = meshopt::decode_vertex_buffer::<[u16; 4]>(bytes, count).expect("vertices");
            let first = number(&positions["byteOffset"]) / 8;
            let vertices = vertices[first..first + number(&positions["count"])].iter().map(|&[x, y, z, _]| {
                let at = offset + DVec3::from_array([x, y, z].map(f64::from)) * scale;
                DVec3::new(at.x, -at.z, at.y)
            });
            let indices = accessor(&primitive["indices"]);
            let (bytes, count) = packed(number(&indices["bufferView"]));
            let all = meshopt::decode_index_buffer::<u32>(bytes, count).expect("indices");
            let width = if indices["componentType"] == 5123 { 2 } else { 4 };
            let first = number(&indices["byteOffset"]) / width;
            let shown = &all[first..first + number(&indices["count"])];
            (vertices.collect(), shown.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect())
        })
        .collect()
}

/// A level's triangles in the world.
fn triangles(glb: &[u8]) -> Vec<[DVec3; 3]> {
    let parts = decoded(glb);
    parts.iter().flat_map(|(at, triangles)| triangles.iter().map(|t| t.map(|v| at[v as usize]))).collect()
}
