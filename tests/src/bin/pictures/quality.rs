//! Whether the quality that the scheduler predicts is the one that is seen: Q of a frame beside its measured similarity.
//!
//! Each flight is streamed over a starved link. Of every frame the parts of the view with their weights w and errors on the
//! screen e are kept, so that Q = Σ w a(e) / Σ w can be had for any accuracy a(e) = 1/(1 + (e/e₀)ᵖ) over the same residents.

use crate::flights::{Run, Scene};
use crate::rank::spearman;
use foresight_scheduler::benefit::accuracy::HALF_ACCURACY_PX;
use foresight_scheduler::benefit::quality::evaluate;
use foresight_tests::stored::plot::{Curve, Plot, Scale};
use foresight_tests::stored::table::Table;
use foresight_tests::stored::{Fault, Findings};
use foresight_viewer::draw::choose::ChooseSettings;
use foresight_viewer::headless::Against;
use serde_json::{Value, json};

/// Frames count whose Q lies between these.
const RANGE: (f64, f64) = (0.2, 0.98);

/// Ranges of Q over which similarities are told.
const BINS: [(f64, f64); 7] =
    [(0.0, 0.2), (0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 0.9), (0.9, 0.98), (0.98, 1.0 + f64::EPSILON)];

/// e₀ that are tried, pixels.
const HALVES: [f64; 9] = [8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0, 192.0];

/// p that are tried.
const POWERS: [f64; 2] = [1.0, 2.0];

/// A frame: its similarity, and (w, e) of each part of the view; e is infinite where nothing is resident.
struct Frame {
    t_s: f64,
    quality: f64,
    ssim: f64,
    parts: Vec<(f64, f64)>,
}

impl Frame {
    fn quality_with(&self, half: f64, power: f64) -> f64 {
        let accuracy = |e: f64| if e.is_finite() { 1.0 / (1.0 + libm::pow(e / half, power)) } else { 0.0 };
        let total: f64 = self.parts.iter().map(|p| p.0).sum();
        self.parts.iter().map(|&(w, e)| w * accuracy(e)).sum::<f64>() / total
    }
}

struct Flown {
    name: String,
    /// Whether e₀ may be chosen by it; else it only says how good the choice is.
    calibrates: bool,
    link: String,
    frames: Vec<Frame>,
}

impl Flown {
    /// The same frames whatever the model: a larger e₀ would leave those of the start alone in the range.
    fn pairs(&self, quality: impl Fn(&Frame) -> f64) -> Vec<(f64, f64)> {
        let counts = |frame: &&Frame| (RANGE.0..=RANGE.1).contains(&frame.quality);
        self.frames.iter().filter(counts).map(|frame| (quality(frame), frame.ssim)).collect()
    }

    fn with(&self, half: f64, power: f64) -> Option<f64> {
        spearman(&self.pairs(|frame| frame.quality_with(half, power)))
    }
}

/// How it is measured.
pub(crate) struct Plan<'a> {
    /// Starvation of the link.
    pub(crate) rho: f64,
    /// Pictures a second.
    pub(crate) rate: u64,
    pub(crate) memory: u64,
    pub(crate) against: Against,
    pub(crate) policy: &'a str,
}

/// Flies every scene; those named in `calibrating` choose e₀.
pub(crate) fn findings(scenes: &[(Scene, bool)], plan: &Plan) -> Result<Findings, Fault> {
    let mut flown = Vec::new();
    let mut adapter = String::new();
    for (scene, calibrates) in scenes {
        let mut offscreen = scene.offscreen()?;
        adapter = offscreen.adapter().to_owned();
        flown.push(fly(scene, *calibrates, plan, &mut offscreen)?);
        eprintln!("{}", scene.name);
    }
    let title = format!(
        "Spearman's ρ between Q and SSIM over the frames with {} ≤ Q ≤ {}; {} at ρ = {}, on {adapter}",
        RANGE.0, RANGE.1, plan.policy, plan.rho
    );
    let mut by_flight =
        Table::new(title, &["flight", "link", "frames", "in range", "Q", "SSIM", "ρ", "best e₀, px", "p", "ρ there"]);
    for flight in &flown {
        let pairs = flight.pairs(|frame| frame.quality);
        let mean = |of: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / pairs.len() as f64;
        let best = best(&[flight]);
        by_flight.row([
            json!(flight.name),
            json!(flight.link),
            json!(flight.frames.len()),
            json!(pairs.len()),
            json!(mean(&|p| p.0)),
            json!(mean(&|p| p.1)),
            json!(spearman(&pairs)),
            json!(best.map(|b| b.0)),
            json!(best.map(|b| b.1)),
            json!(best.map(|b| b.2)),
        ]);
    }
    let mut by_model = Table::new(
        "Mean of ρ over the flights by a(e) = 1/(1 + (e/e₀)ᵖ)",
        &["e₀, px", "p", "calibrating", "validating", "least of all"],
    );
    let (calibrating, validating): (Vec<&Flown>, Vec<&Flown>) = flown.iter().partition(|flight| flight.calibrates);
    for power in POWERS {
        for half in HALVES {
            let all: Vec<&Flown> = flown.iter().collect();
            by_model.row([
                json!(half),
                json!(power),
                value(mean(&calibrating, half, power)),
                value(mean(&validating, half, power)),
                value(all.iter().filter_map(|f| f.with(half, power)).reduce(f64::min)),
            ]);
        }
    }
    let mut by_quality = Table::new("SSIM by Q over all flights", &["Q from", "to", "frames", "SSIM", "least", "most"]);
    for (from, to) in BINS {
        let frames = flown.iter().flat_map(|flight| &flight.frames);
        let seen: Vec<f64> = frames.filter(|f| (from..to).contains(&f.quality)).map(|f| f.ssim).collect();
        by_quality.row([
            json!(from),
            json!(to),
            json!(seen.len()),
            json!((!seen.is_empty()).then(|| seen.iter().sum::<f64>() / seen.len() as f64)),
            json!(seen.iter().copied().reduce(f64::min)),
            json!(seen.iter().copied().reduce(f64::max)),
        ]);
    }
    let mut remarks = Vec::new();
    if let Some((half, power, rho)) = best(&calibrating) {
        let default = (mean(&calibrating, HALF_ACCURACY_PX, 2.0), mean(&validating, HALF_ACCURACY_PX, 2.0));
        remarks.push(format!(
            "calibrated: e₀ = {half} px, p = {power}: mean ρ {rho:.3}, and {} on the flights that did not choose it; e₀ = {HALF_ACCURACY_PX} px, p = 2: {} and {}",
            text(mean(&validating, half, power)),
            text(default.0),
            text(default.1),
        ));
    }
    let mut curves: Vec<Curve> = flown.iter().map(curve).collect();
    curves.truncate(8);
    let scatter = Plot {
        name: "quality".to_owned(),
        title: "SSIM by the scheduler's Q".to_owned(),
        x: ("Q".to_owned(), Scale::Linear),
        y: ("SSIM".to_owned(), Scale::Linear),
        curves,
    };
    let over_time = flown.iter().map(|flight| Plot {
        name: format!("quality-{}", flight.name.replace(|c: char| !c.is_ascii_alphanumeric(), "-")),
        title: format!("{}, {}", flight.name, flight.link),
        x: ("seconds".to_owned(), Scale::Linear),
        y: ("Q and SSIM".to_owned(), Scale::Linear),
        curves: vec![
            Curve {
                name: "Q".to_owned(),
                points: flight.frames.iter().map(|f| (f.t_s, f.quality)).collect(),
                dotted: false,
            },
            Curve {
                name: "SSIM".to_owned(),
                points: flight.frames.iter().map(|f| (f.t_s, f.ssim)).collect(),
                dotted: true,
            },
        ],
    });
    let plots = std::iter::once(scatter).chain(over_time).collect();
    Ok(Findings { tables: vec![by_flight, by_quality, by_model], remarks, plots, pictures: Vec::new() })
}

fn curve(flight: &Flown) -> Curve {
    let mut points = flight.pairs(|frame| frame.quality);
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    Curve { name: flight.name.clone(), points, dotted: true }
}

fn fly(
    scene: &Scene,
    calibrates: bool,
    plan: &Plan,
    offscreen: &mut foresight_viewer::offscreen::Offscreen,
) -> Result<Flown, Fault> {
    let link = scene.link(plan.rho)?;
    let run = Run {
        policy: plan.policy,
        link: &link,
        memory: plan.memory,
        against: plan.against,
        choose: ChooseSettings::default(),
        rate: plan.rate,
        everything: false,
    };
    let mut frames = Vec::new();
    scene.fly(&run, offscreen, &mut Vec::new(), |shown| {
        let (Some(quality), Some(ssim)) = (shown.row.quality, shown.row.ssim) else { return };
        let mut parts = Vec::new();
        evaluate(&scene.world.tree, shown.cut, shown.simulation.resident(), |part| {
            let pixels = f64::from(part.error) * part.sharpness.sqrt() * HALF_ACCURACY_PX;
            parts.push((part.weight, if part.owner.is_some() { pixels } else { f64::INFINITY }));
        });
        frames.push(Frame { t_s: shown.row.t_s, quality, ssim, parts });
    })?;
    Ok(Flown { name: scene.name.clone(), calibrates, link: link.name().to_owned(), frames })
}

fn mean(flights: &[&Flown], half: f64, power: f64) -> Option<f64> {
    let all: Vec<f64> = flights.iter().filter_map(|flight| flight.with(half, power)).collect();
    (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
}

/// e₀, p and the mean of ρ.
fn best(flights: &[&Flown]) -> Option<(f64, f64, f64)> {
    let models = POWERS.iter().flat_map(|&power| HALVES.iter().map(move |&half| (half, power)));
    let tried = models.filter_map(|(half, power)| Some((half, power, mean(flights, half, power)?)));
    tried.max_by(|a, b| a.2.total_cmp(&b.2))
}

fn value(number: Option<f64>) -> Value {
    number.map_or(Value::Null, |number| json!(number))
}

fn text(number: Option<f64>) -> String {
    number.map_or_else(|| "none".to_owned(), |number| format!("{number:.3}"))
}
