//! A target frame time held by the resolution bias while a city is entered (\[NVE\] §4.5 and 4.6).

use crate::flights::Scene;
use crate::street::{Frames, everything, upright, walk};
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::view::View;
use foresight_tests::stored::plot::{Curve, Plot, Scale};
use foresight_tests::stored::table::Table;
use foresight_tests::stored::{Fault, Findings};
use foresight_viewer::draw::choose::ChooseSettings;
use foresight_viewer::draw::controller::{Controller, ControllerSettings};
use glam::DVec3;
use serde_json::json;
use std::collections::BTreeSet;

/// Frames before the city is entered, of which the first half warms up.
const OUTSIDE: usize = 12;

/// Frames after it that do not count.
const SETTLING: usize = 60;

/// Without a controller, and for the floor, every so manieth frame of the walk is drawn.
const STRIDE: usize = 5;

/// Of the time that a frame takes without a controller.
const TARGETS: [f64; 2] = [0.7, 0.45];

/// Frames from one line of progress to the next.
const PROGRESS: usize = 25;

/// A frame's time, milliseconds, and its bias.
type Time = [f64; 2];

/// A quantile by nearest rank.
fn quantile(times: &[Time], share: f64) -> f64 {
    let mut sorted: Vec<f64> = times.iter().map(|[ms, _]| *ms).collect();
    sorted.sort_by(f64::total_cmp);
    let rank = (share * sorted.len() as f64).ceil().max(1.0) as usize;
    sorted.get(rank - 1).copied().unwrap_or(f64::NAN)
}

/// What decides on the bias.
enum Bias {
    Fixed(f64),
    Controlled(Controller),
}

/// Frames drawn one after the other.
struct Flyer<'a> {
    drawn: Frames<'a>,
    resident: BTreeSet<RepId>,
}

impl Flyer<'_> {
    fn fly<'v>(
        &mut self,
        name: &str,
        views: impl Iterator<Item = &'v View>,
        mut bias: Bias,
    ) -> Result<Vec<Time>, Fault> {
        let mut times = Vec::new();
        for view in views {
            let now = match &bias {
                Bias::Fixed(bias) => *bias,
                Bias::Controlled(controller) => controller.bias(),
            };
            let settings = ChooseSettings { bias: now, ..ChooseSettings::default() };
            let seconds = self.drawn.choose(view, &self.resident, &settings)? + self.drawn.draw(view)?.seconds;
            times.push([1e3 * seconds, now]);
            if let Bias::Controlled(controller) = &mut bias {
                controller.observe(seconds);
            }
            if times.len().is_multiple_of(PROGRESS) {
                eprintln!("{name}, frame {}: {:.0} ms, bias {now:.2}", times.len(), 1e3 * seconds);
            }
        }
        Ok(times)
    }
}

/// Walks into the city, once for each target: a share of what frames take without a controller.
pub(crate) fn findings(scene: &Scene, small: bool, viewport: [u32; 2]) -> Result<Findings, Fault> {
    let counted = if small { 5 } else { 40 };
    let mut flyer = Flyer { drawn: Frames::new(scene)?, resident: everything(scene) };
    // From far outside, then in the street; the step between is the hardest that there is.
    let far = |frame: usize| upright(DVec3::new(-3000.0 + frame as f64, 0.0, 60.0), 0.0, viewport);
    let outside: Vec<View> = (0..OUTSIDE).map(far).collect();
    let street = walk(SETTLING + counted, 0.5, 0.3, viewport);
    let before = flyer.fly("outside", outside.iter(), Bias::Fixed(1.0))?;
    let outside_ms = quantile(&before[OUTSIDE / 2..], 0.5);
    let free = flyer.fly("no controller", street.iter().step_by(STRIDE), Bias::Fixed(1.0))?;
    let settings = ControllerSettings::new(1.0);
    let late = || street[SETTLING..].iter().step_by(STRIDE);
    // The first makes what is coarse known.
    let coarse = flyer.fly("coarsest", late().take(1).chain(late()), Bias::Fixed(settings.bias_max))?;
    let floor_ms = quantile(&coarse[1..], 0.5);
    let same = flyer.fly("the same", std::iter::repeat_n(&street[SETTLING], 12), Bias::Fixed(1.0))?;
    let noise = quantile(&same[2..], 0.9) / quantile(&same[2..], 0.5);
    let free_ms = quantile(&free, 0.5);
    let columns = ["target, ms", "p10", "p50", "p90", "p90 / target", "within 20 %", "bias, mean"];
    let mut table = Table::new(String::new(), &columns);
    let mut row = |target: Option<f64>, times: &[Time]| {
        let p90 = quantile(times, 0.9);
        let held = match target {
            None => "–",
            Some(target) if target < floor_ms => "below the floor",
            Some(target) if (p90 / target - 1.0).abs() <= 0.2 => "yes",
            Some(_) => "no",
        };
        let bias = times.iter().map(|[_, bias]| *bias).sum::<f64>() / times.len().max(1) as f64;
        table.row([
            target.map_or(json!("none"), |target| json!(target)),
            json!(quantile(times, 0.1)),
            json!(quantile(times, 0.5)),
            json!(p90),
            json!(target.map(|target| p90 / target)),
            json!(held),
            json!(bias),
        ]);
    };
    row(None, &free[SETTLING / STRIDE..]);
    let mut curves = Vec::new();
    for share in TARGETS {
        let target = share * free_ms;
        let name = format!("target {target:.0} ms");
        let controller = Controller::new(ControllerSettings::new(1e-3 * target));
        let controller = controller.map_err(|error| Fault::new("controller", error))?;
        let times = flyer.fly(&name, outside.iter().chain(&street), Bias::Controlled(controller))?;
        row(Some(target), &times[OUTSIDE + SETTLING..]);
        let points = times.iter().enumerate().map(|(at, [ms, _])| (at as f64, *ms)).collect();
        curves.push(Curve { name, points, dotted: false });
    }
    table.title = format!(
        "Frame times in {} from {SETTLING} frames after it is entered, {counted} frames of {} × {}, on {}",
        scene.name,
        viewport[0],
        viewport[1],
        flyer.drawn.offscreen.adapter()
    );
    let mut findings = Findings { tables: vec![table], ..Findings::default() };
    findings.remarks.push(format!(
        "Outside a frame takes {outside_ms:.0} ms; inside {free_ms:.0} ms without a controller, {floor_ms:.0} ms with the coarsest \
         bias, {}, which is the floor.",
        settings.bias_max
    ));
    findings.remarks.push(format!("Frames of the same picture: p90 / p50 is {noise:.2}; that much is the machine's."));
    findings.plots.push(Plot {
        name: "controller".to_owned(),
        title: format!("Frame time, entering {} at frame {OUTSIDE}", scene.name),
        x: ("frame".to_owned(), Scale::Linear),
        y: ("ms".to_owned(), Scale::Linear),
        curves,
    });
    Ok(findings)
}
