//! What a sample is drawn as (\[HIBR\] Figure 8): a tree beside a wall from one orthoview, turned ever more against it, and
//! built worlds, each against triangles.

use crate::flights::Scene;
use crate::tree;
use foresight_index::orthoview::Direction;
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::view::View;
use foresight_tests::stored::table::Table;
use foresight_tests::stored::{Fault, Findings};
use foresight_viewer::draw::choose::ChooseSettings;
use foresight_viewer::draw::list::{ALL_TILES, DrawList, Item};
use foresight_viewer::gpu::{Gpu, GpuSettings, Picture, RenderSettings, Renderer, SplatShape};
use foresight_viewer::headless::png;
use foresight_viewer::measure::{Likeness, compare};
use foresight_viewer::offscreen::FORMAT;
use foresight_viewer::scene::content::Content;
use glam::{DMat3, DQuat, DVec3};
use serde_json::json;
use std::collections::BTreeSet;

/// Degrees between the view and the one orthoview; the last is the figure's.
const ANGLES: [f64; 3] = [20.0, 45.0, 70.0];

/// Pixels a side of the tree's cell by rows of the picture: it stays within it.
fn pixels(size: [u32; 2]) -> u32 {
    (size[1] * 14 / 15).max(16)
}

/// A camera on a circle around the tree, `degrees` from the orthoview's direction, where a sample is about a pixel wide.
pub(crate) fn view(degrees: f64, size: [u32; 2]) -> View {
    let (sine, cosine) = (libm::sin(degrees.to_radians()), libm::cos(degrees.to_radians()));
    // To the left: the wall recedes into the picture.
    let back = DVec3::new(-sine, -cosine, 0.12).normalize();
    let right = DVec3::Z.cross(back).normalize();
    let orientation = DQuat::from_mat3(&DMat3::from_cols(right, back.cross(right), back)).normalize();
    let fov_y = 50f64.to_radians();
    let pixel = tree::SIDE / f64::from(pixels(size));
    let away = pixel * f64::from(size[1]) / (2.0 * libm::tan(0.5 * fov_y));
    View { position: tree::MIDDLE + away * back, orientation, fov_y, viewport: size }
}

/// All of the representations with these numbers.
pub(crate) fn list(reps: impl IntoIterator<Item = u32>) -> DrawList {
    let item = |rep| Item { rep: RepId(rep), hidden: Vec::new(), behind: 0.0, tiles: ALL_TILES, false_colour: None };
    DrawList { items: reps.into_iter().map(item).collect(), ..DrawList::default() }
}

const COLUMNS: [&str; 6] = ["scene", "shape", "SSIM", "PSNR, dB", "holes, %", "pictures"];

fn row(table: &mut Table, scene: &str, shape: SplatShape, all: &[Likeness]) {
    let mean = |figure: fn(&Likeness) -> f64| all.iter().map(figure).sum::<f64>() / all.len().max(1) as f64;
    table.row([
        json!(scene),
        json!(shape.name()),
        json!(mean(|likeness| likeness.ssim)),
        json!(mean(|likeness| likeness.psnr_db)),
        json!(100.0 * mean(|likeness| likeness.holes)),
        json!(all.len()),
    ]);
}

fn likeness(what: &str, picture: &Picture, reference: &Picture) -> Result<Option<Likeness>, Fault> {
    compare(picture, reference).map_err(|error| Fault::new(what, error))
}

/// The tree's table.
fn of_the_tree(size: [u32; 2], findings: &mut Findings) -> Result<(), Fault> {
    let fault = |error| Fault::new("a tree beside a wall", error);
    let gpu = Gpu::open(&GpuSettings::default()).map_err(fault)?;
    let mut renderer = Renderer::new(&gpu, RenderSettings { samples: 4, ..RenderSettings::default() }, FORMAT);
    let direction = Direction::from_signs([0, -1, 0]).ok_or_else(|| Fault::new("−y", "no direction"))?;
    let title = format!("One orthoview of {} pixels, turned away from the camera, on {}", pixels(size), gpu.name());
    let mut table = Table::new(title, &COLUMNS);
    for (name, triangles) in
        [("wall", tree::wall()), ("tree", tree::tree()), ("tree beside wall", tree::tree_beside_wall())]
    {
        let image = tree::orthoview(&triangles, direction, pixels(size)).ok_or_else(|| Fault::new(name, "not seen"))?;
        renderer.upload(RepId(0), &Content::Splats(image)).map_err(fault)?;
        renderer.upload(RepId(1), &Content::Mesh(tree::mesh(&triangles))).map_err(fault)?;
        for degrees in ANGLES {
            let view = view(degrees, size);
            let (reference, _) = renderer.picture(&view, &list([1])).map_err(fault)?;
            let scene = format!("{name}, {degrees}°");
            let mut keep = |picture: &Picture, what: &str| {
                let file = png(picture).map_err(|error| Fault::new(&scene, error))?;
                findings.pictures.push((format!("{}-{degrees}-{what}.png", name.replace(' ', "-")), file));
                Ok::<(), Fault>(())
            };
            keep(&reference, "geometry")?;
            for shape in SplatShape::ALL {
                renderer.settings().shape = shape;
                let (picture, _) = renderer.picture(&view, &list([0])).map_err(fault)?;
                let all: Vec<_> = likeness(&scene, &picture, &reference)?.into_iter().collect();
                row(&mut table, &scene, shape, &all);
                keep(&picture, shape.name())?;
            }
        }
    }
    findings.tables.push(table);
    Ok(())
}

/// Pictures a flight.
const PICTURES: usize = 4;

/// Everything resident, drawn from orthoviews alone, four pictures a flight.
fn of_worlds(scenes: &[Scene], findings: &mut Findings) -> Result<(), Fault> {
    let mut table = Table::new("", &COLUMNS);
    for scene in scenes {
        let fault = |error| Fault::new(&scene.name, error);
        let mut offscreen = scene.offscreen()?;
        offscreen.render_settings().samples = 4;
        table.title = format!("Worlds from orthoviews alone, three directions, on {}", offscreen.adapter());
        let all: BTreeSet<RepId> = (0..scene.world.tree.representations() as u32).map(RepId).collect();
        let splats = ChooseSettings { geometry_radius: Some(0.0), ..ChooseSettings::default() };
        let mut likenesses = vec![Vec::new(); SplatShape::ALL.len()];
        for k in 0..PICTURES {
            let at = k * (scene.flight.views.len() - 1) / PICTURES;
            let Some(view) = scene.flight.views.get(at) else { continue };
            let (reference, _) = offscreen.picture(view, &all, &ChooseSettings::reference()).map_err(fault)?;
            for (shape, likenesses) in SplatShape::ALL.into_iter().zip(&mut likenesses) {
                offscreen.render_settings().shape = shape;
                let (picture, _) = offscreen.picture(view, &all, &splats).map_err(fault)?;
                likenesses.extend(likeness(&scene.name, &picture, &reference)?);
                if k == 0 {
                    let name = scene.name.replace(|c: char| !c.is_ascii_alphanumeric(), "-");
                    let file = png(&picture).map_err(|error| Fault::new(&scene.name, error))?;
                    findings.pictures.push((format!("{name}-{}.png", shape.name()), file));
                }
            }
            eprintln!("{}: {} of {PICTURES}", scene.name, k + 1);
        }
        for (shape, likenesses) in SplatShape::ALL.into_iter().zip(&likenesses) {
            row(&mut table, &scene.name, shape, likenesses);
        }
    }
    findings.tables.push(table);
    Ok(())
}

/// Both tables.
pub(crate) fn findings(scenes: &[Scene], size: [u32; 2]) -> Result<Findings, Fault> {
    let mut findings = Findings::default();
    of_the_tree(size, &mut findings)?;
    of_worlds(scenes, &mut findings)?;
    Ok(findings)
}
