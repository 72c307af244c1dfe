//! A target frame time held by the resolution bias while a city is entered (\[NVE\] §4.5 and 4.6).

use crate::flights::Scene;
use crate::street::{Frames, everything, upright, walk};
use foresight_tests::stored::plot::{Curve, Plot, Scale};
use foresight_tests::stored::table::Table;
use foresight_tests::stored::{Fault, Findings};
use foresight_viewer::draw::choose::ChooseSettings;
use foresight_viewer::draw::controller::{Controller, ControllerSettings};
use glam::DVec3;
use serde_json::json;

/// Frames before the city is entered, of which the first warm up.
const OUTSIDE: usize = 20;

/// Frames after it that do not count.
const SETTLING: usize = 60;

/// A quantile by nearest rank.
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil().max(1.0) as usize;
    sorted.get(rank - 1).copied().unwrap_or(f64::NAN)
}

/// Walks into the city, once for each target: a share of what frames take without a controller.
pub(crate) fn findings(scene: &Scene, small: bool) -> Result<Findings, Fault> {
    // Frames that count, and their size.
    let (frames, viewport) = if small { (5, [160, 120]) } else { (90, [320, 240]) };
    let mut findings = Findings::default();
    let mut drawn = Frames::new(scene)?;
    let resident = everything(scene);
    // From far outside, then in the street; the step between is the hardest that there is.
    let mut views: Vec<_> =
        (0..OUTSIDE).map(|frame| upright(DVec3::new(-3000.0 + frame as f64, 0.0, 60.0), 0.0, viewport)).collect();
    views.extend(walk(SETTLING + frames, 0.5, 0.3, viewport));
    let mut fly = |mut controller: Option<Controller>| -> Result<Vec<[f64; 2]>, Fault> {
        let mut times = Vec::new();
        for view in &views {
            let bias = controller.as_ref().map_or(1.0, Controller::bias);
            let settings = ChooseSettings { bias, ..ChooseSettings::default() };
            let seconds = drawn.choose(view, &resident, &settings)? + drawn.draw(view)?.seconds;
            times.push([1e3 * seconds, bias]);
            if let Some(controller) = &mut controller {
                controller.observe(seconds);
            }
        }
        Ok(times)
    };
    let late = |times: &[[f64; 2]]| times[OUTSIDE + SETTLING..].iter().map(|row| row[0]).collect::<Vec<_>>();
    let free = fly(None)?;
    let [outside, inside] = [&free[OUTSIDE / 2..OUTSIDE], &free[OUTSIDE..]]
        .map(|part| quantile(&part.iter().map(|row| row[0]).collect::<Vec<_>>(), 0.5));
    let columns = ["target, ms", "p10", "p50", "p90", "p90 / target", "within 20 %", "bias, mean", "outside, ms"];
    let mut table = Table::new(String::new(), &columns);
    let mut row = |target: Option<f64>, times: &[[f64; 2]]| {
        let late = late(times);
        let p90 = quantile(&late, 0.9);
        let bias = times[OUTSIDE + SETTLING..].iter().map(|row| row[1]).sum::<f64>() / late.len() as f64;
        table.row([
            target.map_or(json!("none"), |target| json!(target)),
            json!(quantile(&late, 0.1)),
            json!(quantile(&late, 0.5)),
            json!(p90),
            json!(target.map(|target| p90 / target)),
            json!(target.map_or("–", |target| if (p90 / target - 1.0).abs() <= 0.2 { "yes" } else { "no" })),
            json!(bias),
            json!(outside),
        ]);
    };
    row(None, &free);
    let curve = |name: String, times: &[[f64; 2]]| Curve {
        name,
        points: times.iter().enumerate().map(|(at, row)| (at as f64, row[0])).collect(),
        dotted: false,
    };
    let mut curves = vec![curve("no controller".to_owned(), &free)];
    for share in [0.75, 0.5, 0.35] {
        let target = share * inside;
        let controller = Controller::new(ControllerSettings::new(1e-3 * target));
        let times = fly(Some(controller.map_err(|e| Fault::new("controller", e))?))?;
        eprintln!("target {target:.0} ms");
        row(Some(target), &times);
        curves.push(curve(format!("target {target:.0} ms"), &times));
    }
    table.title = format!(
        "Frame times in {} from {SETTLING} frames after it is entered, {frames} frames of {} × {}, on {}",
        scene.name,
        viewport[0],
        viewport[1],
        drawn.offscreen.adapter()
    );
    findings.tables.push(table);
    findings.plots.push(Plot {
        name: "controller".to_owned(),
        title: format!("Frame time, entering {} at frame {OUTSIDE}", scene.name),
        x: ("frame".to_owned(), Scale::Linear),
        y: ("ms".to_owned(), Scale::Linear),
        curves,
    });
    Ok(findings)
}
