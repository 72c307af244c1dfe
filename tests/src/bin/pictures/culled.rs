//! Points in memory, in orthoviews that the view meets, in their tiles that it meets, and after occlusion culling, along
//! paths (\[HIBR\] Figure 10); and what culling by occlusion gains.

use crate::flights::Scene;
use crate::street::{self, Frames, everything};
use crate::worlds;
use foresight_scheduler::view::View;
use foresight_tests::stored::plot::{Curve, Plot, Scale};
use foresight_tests::stored::table::Table;
use foresight_tests::stored::{Fault, Findings};
use foresight_viewer::draw::choose::ChooseSettings;
use foresight_viewer::headless::png;
use glam::DQuat;
use serde_json::json;
use std::collections::BTreeSet;
use std::path::Path;

/// Six square views all round with as many pixels to a radian: what a client keeps for turning.
fn all_round(view: &View) -> Vec<View> {
    let side = (2.0 * view.pixels_per_radian()).max(1.0) as u32;
    let turns = [
        DQuat::IDENTITY,
        DQuat::from_rotation_y(core::f64::consts::FRAC_PI_2),
        DQuat::from_rotation_y(core::f64::consts::PI),
        DQuat::from_rotation_y(-core::f64::consts::FRAC_PI_2),
        DQuat::from_rotation_x(core::f64::consts::FRAC_PI_2),
        DQuat::from_rotation_x(-core::f64::consts::FRAC_PI_2),
    ];
    let fov_y = core::f64::consts::FRAC_PI_2;
    turns.map(|turn| View { orientation: view.orientation * turn, fov_y, viewport: [side; 2], ..*view }).to_vec()
}

/// Means of what was found along a path.
#[derive(Default)]
struct Along {
    /// In memory, in view, in tiles in view, drawn.
    points: Vec<[f64; 4]>,
    /// Milliseconds without and with culling by occlusion.
    ms: Vec<[f64; 2]>,
    /// Pixels that differ.
    differ: usize,
}

impl Along {
    fn mean<const N: usize>(values: &[[f64; N]], which: usize) -> f64 {
        values.iter().map(|row| row[which]).sum::<f64>() / values.len().max(1) as f64
    }
}

/// Paths through the built worlds, each as the views that are looked at, and the scene that it leads through.
pub(crate) fn flights(folder: &Path, small: bool) -> Result<Vec<(Scene, Vec<View>)>, Fault> {
    let (count, size) = if small { (2, [160, 120]) } else { (16, [640, 480]) };
    let mut flown = vec![(street::open(folder, small)?, street::walk(count, 340.0 / count as f64, 0.8, size))];
    for recipe in worlds::recipes(small) {
        let height = if recipe.name.starts_with("terrain") { 80 } else { 15 };
        let world = recipe.build(folder)?.display().to_string();
        let words = format!("--place centre,height={height},yaw=30");
        let name = format!("{}, flight", recipe.name);
        let scene = Scene::open(name, &world, "turn:speed=8,duration=24", &words, size)?;
        let step = (scene.flight.views.len() / count).max(1);
        let views = scene.flight.views.iter().step_by(step).copied().collect();
        flown.push((scene, views));
    }
    Ok(flown)
}

/// Flies each path of views, everything resident.
pub(crate) fn findings(scenes: &[(Scene, Vec<View>)]) -> Result<Findings, Fault> {
    let mut findings = Findings::default();
    let columns = [
        "path",
        "pictures",
        "points in memory",
        "in view",
        "tiles in view",
        "drawn",
        "drawn, most",
        "drawn, %",
        "ms",
        "ms, culled",
        "gain",
        "pixels that differ",
    ];
    let mut table = Table::new("", &columns);
    for (scene, views) in scenes {
        let mut frames = Frames::new(scene)?;
        table.title = format!("Points of orthoviews along paths, thousands, on {}", frames.offscreen.adapter());
        let resident = everything(scene);
        let settings = ChooseSettings::default();
        let mut along = Along::default();
        for view in views {
            let mut reps = BTreeSet::new();
            let list = std::mem::take(&mut frames.list);
            for side in all_round(view) {
                frames.choose(&side, &resident, &settings)?;
                reps.extend(frames.list.items.drain(..).map(|item| item.rep));
            }
            let renderer = frames.offscreen.renderer();
            let of = |points: &[u32; 16]| points.iter().map(|&n| f64::from(n)).sum::<f64>();
            let memory: f64 = reps.iter().filter_map(|&rep| renderer.tile_points(rep)).map(of).sum();
            frames.list = list;
            frames.choose(view, &resident, &settings)?;
            let in_view = frames.points() as f64;
            let mut took = [f64::INFINITY; 2];
            let mut pictures = Vec::new();
            // In turn, and the better of two: other work on the machine disturbs both alike.
            for _ in 0..2 {
                for (which, occlusion) in [(0, false), (1, true)] {
                    frames.offscreen.render_settings().occlusion = occlusion;
                    if occlusion {
                        // Asked for anew, it has to learn what is seen before it can tell what is not.
                        frames.draw(view)?;
                        frames.draw(view)?;
                    }
                    let timed = frames.draw(view)?;
                    took[which] = took[which].min(1e3 * timed.seconds);
                    pictures.push(timed.picture);
                }
            }
            let counts = frames.offscreen.renderer().occlusion().unwrap_or_default();
            along.differ += (0..pictures[0].distance.len())
                .filter(|&at| pictures[0].rgba[4 * at..4 * at + 4] != pictures[1].rgba[4 * at..4 * at + 4])
                .count();
            along.points.push([memory, in_view, counts.points as f64, counts.points_drawn as f64].map(|n| n / 1e3));
            along.ms.push(took);
            if along.points.len() == 1 + views.len() / 2 {
                let name = format!("culled-{}.png", scene.name.replace(|c: char| !c.is_ascii_alphanumeric(), "-"));
                findings.pictures.push((name, png(&pictures[1]).map_err(|e| Fault::new(&scene.name, e))?));
            }
        }
        eprintln!("{}", scene.name);
        add(&mut table, &mut findings, scene, &along);
    }
    findings.tables.push(table);
    Ok(findings)
}

fn add(table: &mut Table, findings: &mut Findings, scene: &Scene, along: &Along) {
    let points: [f64; 4] = [0, 1, 2, 3].map(|which| Along::mean(&along.points, which));
    let [whole, culled] = [0, 1].map(|which| Along::mean(&along.ms, which));
    let most = along.points.iter().map(|row| row[3]).fold(0.0, f64::max);
    table.row([
        json!(scene.name),
        json!(along.points.len()),
        json!(points[0]),
        json!(points[1]),
        json!(points[2]),
        json!(points[3]),
        json!(most),
        json!((points[2] > 0.0).then(|| 100.0 * points[3] / points[2])),
        json!(whole),
        json!(culled),
        json!((culled > 0.0).then(|| whole / culled)),
        json!(along.differ),
    ]);
    let curve = |name: &str, which: usize| Curve {
        name: name.to_owned(),
        points: along.points.iter().enumerate().map(|(at, row)| (at as f64, row[which])).collect(),
        dotted: false,
    };
    findings.plots.push(Plot {
        name: format!("culled-{}", scene.name.replace(|c: char| !c.is_ascii_alphanumeric(), "-")),
        title: format!("Points of orthoviews: {}", scene.name),
        x: ("picture".to_owned(), Scale::Linear),
        y: ("thousands of points".to_owned(), Scale::Linear),
        curves: vec![curve("in memory", 0), curve("in view", 1), curve("tiles in view", 2), curve("drawn", 3)],
    });
}
