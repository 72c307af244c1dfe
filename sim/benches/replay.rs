//! Replays of the first ten seconds of the built-in flight through the built-in city, and what a comparison adds.

use criterion::{BenchmarkId, Criterion};
use foresight_index::world::built_in_city;
use foresight_scheduler::benefit::cut::CutSettings;
use foresight_scheduler::policy::specification::{PolicySpec, names};
use foresight_scheduler::scheduler::SchedulerSettings;
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_sim::bound::{CheapestBeneath, FrameBound, Limits};
use foresight_sim::future;
use foresight_sim::replay::{Stage, replay};
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::Flight;
use foresight_traces::link;
use foresight_traces::path::built_in;
use std::error::Error;
use std::hint::black_box;
use std::time::Duration;

const SECONDS: f64 = 10.0;
const BUDGET: u64 = 64 << 20;

fn main() -> Result<(), Box<dyn Error>> {
    let mut c = Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(5))
        .configure_from_args();
    let tree = built_in_city().tree;
    let path = built_in();
    let flight = Flight::sample(SECONDS, |t| {
        let (position, orientation) = path.at(t);
        View { position, orientation, fov_y: 60f64.to_radians(), viewport: [1920, 1080] }
    });
    let link = link::built_in();
    let judging = CutSettings::default();
    let cuts = flight.cuts(&tree, &judging);
    let stage = Stage {
        tree: &tree,
        flight: &flight,
        cuts: &cuts,
        link: &link,
        link_start: Time::ZERO,
        client: ClientSettings::default(),
        scheduler: SchedulerSettings::with_budget(BUDGET),
        preloaded: &[],
    };
    let mut group = c.benchmark_group("replay of ten seconds");
    for name in names() {
        let spec = PolicySpec::parse_list(name, 0.7, None)?.remove(0);
        // Once outside the measurement, so that a failure is not measured but told.
        replay(stage, future::build(&spec, &tree, &flight, &link, Time::ZERO))?;
        group.bench_function(BenchmarkId::from_parameter(name), |b| {
            b.iter(|| replay(black_box(stage), future::build(&spec, &tree, &flight, &link, Time::ZERO)));
        });
    }
    group.finish();
    c.bench_function("cuts of ten seconds", |b| b.iter(|| flight.cuts(black_box(&tree), &judging)));
    let cheapest = CheapestBeneath::new(&tree);
    c.bench_function("bound of a frame", |b| {
        b.iter(|| {
            let problem = FrameBound::new(&tree, &cheapest, black_box(&cuts[cuts.len() / 2]));
            problem.map(|mut p| p.bound(Limits { wire: 3e6, memory: BUDGET as f64 }))
        });
    });
    c.final_summary();
    Ok(())
}
