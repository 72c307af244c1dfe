//! The added-benefit integral against its reference in double-double: the enclosure holds, on ordinary candidates and on
//! stiff and extreme ones.

use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::estimate::{Certified, Outcome};
use foresight_scheduler::integral::{AddedBenefit, Leg, Method, Target, integrate};
use foresight_scheduler::view::View;
use foresight_sim::accuracy::reference::reference;
use glam::{DQuat, DVec3};

/// Random numbers from a seed (SplitMix64).
struct SplitMix64(u64);

impl SplitMix64 {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn within(random: &mut SplitMix64, low: f64, high: f64) -> f64 {
    low + (high - low) * random.unit()
}

fn log(random: &mut SplitMix64, low: f64, high: f64) -> f64 {
    libm::exp(within(random, libm::log(low), libm::log(high)))
}

fn vector(random: &mut SplitMix64, size: f64) -> DVec3 {
    DVec3::new(within(random, -size, size), within(random, -size, size), within(random, -size, size))
}

/// A candidate such as a scheduler meets: a camera that walks, drives or flies, a box or a group somewhere ahead.
fn candidate(random: &mut SplitMix64) -> AddedBenefit {
    let orientation = DQuat::from_scaled_axis(vector(random, 2.0));
    let fov_y = within(random, 0.3, 1.6);
    let start = View { position: vector(random, 100.0), orientation, fov_y, viewport: [1920, 1080] };
    let velocity = vector(random, 1.0) * log(random, 0.01, 100.0);
    let rotation = if random.unit() < 0.4 { DVec3::ZERO } else { vector(random, 1.0) * log(random, 0.001, 3.0) };
    let from_s = within(random, 0.0, 2.0);
    let leg = Leg::new(&start, velocity, rotation, from_s, from_s + log(random, 0.01, 2.0)).unwrap();
    let size = log(random, 0.1, 30.0);
    let half = DVec3::new(random.unit(), random.unit(), random.unit()) * size;
    let far = log(random, 1.0, 100.0) * size;
    let aside = vector(random, 0.7) * far;
    let centre = start.position + orientation * DVec3::new(aside.x, aside.y, -far);
    let target = if random.unit() < 0.5 {
        Target::leaf(centre, half, log(random, 0.1, 10.0)).unwrap()
    } else {
        Target::group(centre, half, DVec3::new(random.unit(), random.unit(), random.unit()) * size * size).unwrap()
    };
    let before = if random.unit() < 0.3 { f64::INFINITY } else { log(random, 1e-3, 10.0) * size };
    let after = if random.unit() < 0.1 { 0.0 } else { before.min(10.0 * size) * within(random, 0.01, 0.9) };
    let centre_falloff = if random.unit() < 0.2 { within(random, 0.0, 4.0) } else { 0.0 };
    let attenuation = if random.unit() < 0.2 { within(random, 0.0, 2.0) } else { 0.0 };
    let cut = CutSettings { centre_falloff, ..CutSettings::default() };
    AddedBenefit { leg, target, after, before, arrival_s: from_s, cut, attenuation }
}

fn enclosed(benefit: &AddedBenefit, tolerance: f64, evaluations_max: u32) -> Certified {
    match integrate(benefit, &Method::Enclosure { tolerance, floor: 1e-12, evaluations_max }).unwrap() {
        Outcome::Certified(certified) => certified,
        Outcome::Estimate(_) => unreachable!("an enclosure is certified"),
    }
}

/// The bounds hold, up to what the reference itself may be off by.
fn holds(benefit: &AddedBenefit, certified: &Certified) -> Result<(), String> {
    let truth = reference(benefit).unwrap();
    if certified.lower - truth.error <= truth.value && truth.value <= certified.upper + truth.error {
        return Ok(());
    }
    Err(format!("{certified:?}\n{truth:?}\n{benefit:?}"))
}

#[test]
fn measure() {
    let mut random = SplitMix64(7);
    let n = 8000;
    let benefits: Vec<_> = (0..n).map(|_| candidate(&mut random)).collect();
    let truths: Vec<f64> = benefits.iter().map(|b| enclosed(b, 1e-7, 20000).value).collect();
    let best = truths.iter().copied().fold(0.0, f64::max);
    let mut methods = vec![("sampled".to_owned(), Method::Sampled)];
    for (nodes, panels) in [(8, 1u32)] {
        methods.push((format!("gl split {nodes} {panels}"), Method::GaussLegendre { nodes, panels, split: true }));
    }
    for (nodes, panels) in [(4, 64), (4, 128), (4, 256u32)] {
        methods.push((format!("gl fixed {nodes} {panels}"), Method::GaussLegendre { nodes, panels, split: false }));
    }
    for (name, method) in &methods {
        let mut rows: Vec<(f64, u32, usize)> = benefits
            .iter()
            .enumerate()
            .map(|(i, b)| {
                let o = integrate(b, method).unwrap();
                ((o.value() - truths[i]).abs() / truths[i].max(1e-4 * best), o.evaluations(), i)
            })
            .collect();
        let mut ev: Vec<u32> = rows.iter().map(|r| r.1).collect();
        ev.sort();
        rows.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mean = ev.iter().map(|&e| f64::from(e)).sum::<f64>() / n as f64;
        println!(
            "{name:14} p50 {:.1e} p99 {:.1e} p999 {:.1e} max {:.1e}; evals mean {mean:.1} p50 {} p99 {} max {}",
            rows[n / 2].0,
            rows[n * 99 / 100].0,
            rows[n * 999 / 1000].0,
            rows[n - 1].0,
            ev[n / 2],
            ev[n * 99 / 100],
            ev[n - 1]
        );
        if name == "sampled" {
            for r in rows.iter().rev().take(16) {
                let b = &benefits[r.2];
                println!(
                    "   {:.1e} ev {} form {:?} way/d {:.2} turn {:.2} half/d {:.2} falloff {}",
                    r.0,
                    r.1,
                    b.target.form(),
                    b.leg.velocity().length() * (b.to_s() - b.from_s())
                        / b.leg.relative(b.target.centre(), b.from_s()).length(),
                    b.leg.rate() * (b.to_s() - b.from_s()),
                    b.target.half().length() / b.leg.relative(b.target.centre(), b.from_s()).length(),
                    b.cut.centre_falloff
                );
            }
        }
    }
}
