//! What an added benefit costs by each method, for the four kinds of target: a group or a leaf, inside the view as a whole
//! or across its border. A camera walks and turns for half a second; 64 targets are taken in turn, so a figure is
//! nanoseconds per target ÷ 64.

use criterion::{BenchmarkId, Criterion, Throughput};
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::integral::{AddedBenefit, IntegralError, Leg, Method, Node, Sampler, Target, gain, integrate};
use foresight_scheduler::view::View;
use glam::{DQuat, DVec3};
use std::hint::black_box;
use std::time::Duration;

const TARGETS: u32 = 64;

fn leg() -> Result<Leg, IntegralError> {
    let start = View { position: DVec3::ZERO, orientation: DQuat::IDENTITY, fov_y: 1.0, viewport: [1920, 1080] };
    Leg::new(&start, DVec3::new(0.4, 0.0, -1.4), DVec3::new(0.0, 0.3, 0.0), 0.5, 1.0)
}

/// Targets `far` metres ahead, `aside` metres to the right of that.
fn targets(is_leaf: bool, aside: f64) -> Result<Vec<Target>, IntegralError> {
    (0..TARGETS)
        .map(|i| {
            let far = 40.0 + f64::from(i);
            let (centre, half) = (DVec3::new(aside * far, 0.13 * far, -far), DVec3::new(3.0, 5.0, 2.0));
            match is_leaf {
                true => Target::leaf(centre, half, 1.0),
                false => Target::group(centre, half, DVec3::new(60.0, 30.0, 50.0)),
            }
        })
        .collect()
}

fn benches(criterion: &mut Criterion) -> Result<(), IntegralError> {
    let (leg, cut) = (leg()?, CutSettings::default());
    let sampler = Sampler::new(&leg, &cut, 0.0)?;
    for (kind, is_leaf, aside) in [
        ("group inside", false, 0.1),
        ("group across", false, 0.92),
        ("leaf inside", true, 0.1),
        ("leaf across", true, 0.92),
    ] {
        let targets = targets(is_leaf, aside)?;
        let mut nodes: Vec<Node> = Vec::new();
        let evaluations: u32 = targets.iter().map(|target| sampler.sample(target, &mut nodes)).sum();
        println!("{kind}: {} nodes, {evaluations} evaluations of {TARGETS} targets", nodes.len());
        let mut group = criterion.benchmark_group(kind);
        group.throughput(Throughput::Elements(u64::from(TARGETS)));
        group.bench_function("sample", |b| {
            b.iter(|| {
                nodes.clear();
                targets.iter().map(|target| sampler.sample(black_box(target), &mut nodes)).sum::<u32>()
            });
        });
        group.bench_function("gain of the nodes", |b| b.iter(|| gain(black_box(&nodes), 0.1, 0.5)));
        let methods = [
            ("trapezoid, 512", Method::Trapezoid { intervals: 512, split: false }),
            ("gauss-legendre, 4×128", Method::GaussLegendre { nodes: 4, panels: 128, split: false }),
            ("gauss-legendre, split, 8", Method::GaussLegendre { nodes: 8, panels: 1, split: true }),
            ("gauss-kronrod, 1e-3", Method::GaussKronrod { tolerance: 1e-3, evaluations_max: 1000 }),
            ("closed form", Method::ClosedForm),
            ("sampled", Method::Sampled),
            ("enclosure, 1e-3", Method::Enclosure { tolerance: 1e-3, floor: 1e-9, evaluations_max: 1000 }),
            ("enclosure, 1e-6", Method::Enclosure { tolerance: 1e-6, floor: 1e-9, evaluations_max: 1000 }),
        ];
        for (name, method) in methods {
            let benefits: Vec<AddedBenefit> = targets
                .iter()
                .map(|&target| AddedBenefit {
                    leg,
                    target,
                    after: 0.1,
                    before: 0.5,
                    arrival_s: 0.5,
                    cut,
                    attenuation: 0.0,
                })
                .collect();
            if integrate(&benefits[0], &method).is_err() {
                continue;
            }
            group.bench_with_input(BenchmarkId::from_parameter(name), &benefits, |b, benefits| {
                b.iter(|| {
                    benefits
                        .iter()
                        .filter_map(|benefit| integrate(benefit, &method).ok())
                        .map(|o| o.value())
                        .sum::<f64>()
                });
            });
        }
        group.finish();
    }
    Ok(())
}

fn main() -> Result<(), IntegralError> {
    let mut criterion = Criterion::default()
        .sample_size(20)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_millis(600))
        .configure_from_args();
    benches(&mut criterion)?;
    criterion.final_summary();
    Ok(())
}
