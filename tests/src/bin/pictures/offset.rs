//! The same pictures a planet's radius away from the origin.

use crate::flights::Scene;
use crate::shapes::{list, view};
use crate::tree;
use foresight_index::orthoview::direction::nine;
use foresight_scheduler::lod_tree::{Aabb, RepId};
use foresight_scheduler::view::View;
use foresight_tests::stored::table::Table;
use foresight_tests::stored::{Fault, Findings};
use foresight_viewer::draw::choose::{ChooseSettings, choose};
use foresight_viewer::draw::list::DrawList;
use foresight_viewer::gpu::{Gpu, GpuSettings, Picture, RenderSettings, Renderer};
use foresight_viewer::offscreen::FORMAT;
use foresight_viewer::scene::content::Content;
use foresight_viewer::scene::decode::decode;
use glam::DVec3;
use serde_json::json;
use std::collections::BTreeSet;

/// Metres from the origin: 6.4·10⁶ along a line that no axis and no power of two favours.
const AWAY: DVec3 = DVec3::new(4_123_456.7, -3_456_789.1, 3_456_001.3);

fn moved_box(bounds: Aabb) -> Aabb {
    Aabb { min: bounds.min + AWAY, max: bounds.max + AWAY }
}

fn moved(content: &Content) -> Content {
    let mut content = content.clone();
    match &mut content {
        Content::Splats(image) => {
            image.origin += AWAY;
            image.bounds = moved_box(image.bounds);
        }
        Content::Mesh(mesh) => {
            mesh.origin += AWAY;
            mesh.bounds = moved_box(mesh.bounds);
        }
        Content::Empty => {}
    }
    content
}

/// The picture here and there.
fn pictures(gpu: &Gpu, contents: &[(RepId, Content)], drawn: &DrawList, view: &View) -> Result<[Picture; 2], Fault> {
    let fault = |error| Fault::new("a picture", error);
    let mut renderer = Renderer::new(gpu, RenderSettings::default(), FORMAT);
    for (rep, content) in contents {
        renderer.upload(*rep, content).map_err(fault)?;
    }
    let (here, _) = renderer.picture(view, drawn).map_err(fault)?;
    for (rep, content) in contents {
        renderer.upload(*rep, &moved(content)).map_err(fault)?;
    }
    let mut list = drawn.clone();
    for item in &mut list.items {
        item.hidden.iter_mut().for_each(|bounds| *bounds = moved_box(*bounds));
    }
    let (there, _) = renderer.picture(&View { position: view.position + AWAY, ..*view }, &list).map_err(fault)?;
    Ok([here, there])
}

fn row(table: &mut Table, scene: &str, [here, there]: &[Picture; 2]) {
    let pixels = here.distance.len().max(1) as f64;
    let apart = |(a, b): (&[u8; 4], &[u8; 4])| a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or_default();
    let pairs = || here.rgba.as_chunks::<4>().0.iter().zip(there.rgba.as_chunks::<4>().0);
    let beyond = pairs().filter(|pair| apart(*pair) > 1).count() as f64;
    let any = pairs().filter(|pair| apart(*pair) > 0).count() as f64;
    table.row([json!(scene), json!(100.0 * beyond / pixels), json!(100.0 * any / pixels)]);
}

/// The tree beside its wall, and a view of each world, splats and triangles.
pub(crate) fn findings(scenes: &[Scene], size: [u32; 2]) -> Result<Findings, Fault> {
    let gpu = Gpu::open(&GpuSettings::default()).map_err(|error| Fault::new("GPU", error))?;
    let title = format!("Pixels that differ {:.2e} m from the origin, on {}", AWAY.length(), gpu.name());
    let mut table = Table::new(title, &["scene", "by more than 1/255, %", "at all, %"]);
    let triangles = tree::tree_beside_wall();
    let mut contents = vec![(RepId(0), Content::Mesh(tree::mesh(&triangles)))];
    row(&mut table, "tree, triangles", &pictures(&gpu, &contents, &list([0]), &view(30.0, size))?);
    let images = nine().into_iter().filter_map(|direction| tree::orthoview(&triangles, direction, 256));
    contents.extend((1..).zip(images).map(|(rep, image)| (RepId(rep), Content::Splats(image))));
    let count = contents.len() as u32;
    row(&mut table, "tree, splats", &pictures(&gpu, &contents, &list(1..count), &view(30.0, size))?);
    for scene in scenes {
        let all: BTreeSet<RepId> = (0..scene.world.tree.representations() as u32).map(RepId).collect();
        let Some(view) = scene.flight.views.first() else { continue };
        let mut drawn = DrawList::default();
        choose(&scene.world, &all, view, &ChooseSettings::default(), &mut drawn);
        let mut contents = Vec::new();
        for item in &drawn.items {
            let fault = |why: String| Fault::new(&scene.name, why);
            let bytes = scene.source.bytes(&scene.world, item.rep).map_err(|error| fault(error.to_string()))?;
            let decoded = decode(&scene.world, &scene.source, item.rep, &bytes);
            contents.push((item.rep, decoded.map_err(|error| fault(error.to_string()))?.content));
        }
        row(&mut table, &scene.name, &pictures(&gpu, &contents, &drawn, view)?);
    }
    let findings = Findings { tables: vec![table], ..Findings::default() };
    Ok(findings)
}
