//! The scheduler in this program, in real time: what a simulated client does on a virtual clock, at the ticks of the real one.

use crate::clock::Clock;
use crate::exchange::{Body, Exchange, Fate, Fetching, Link, Status};
use foresight_index::world::World;
use foresight_replay::simulation::{Conditions, ReplayError, Simulation};
use foresight_scheduler::benefit::cut::{Cut, CutSettings, Region};
use foresight_scheduler::lod_tree::RepId;
use foresight_scheduler::policy::specification::PolicySpec;
use foresight_scheduler::scheduler::{Reason, SchedulerSettings};
use foresight_scheduler::units::Time;
use foresight_scheduler::view::View;
use foresight_traces::client::ClientSettings;
use foresight_traces::flight::{TICKS_PER_SECOND, tick_time};
use foresight_traces::link::LinkTrace;
use std::collections::BTreeMap;
use std::time::Duration;

/// Ticks from one status to the next.
const TICKS_PER_STATUS: u64 = 12;

/// Who decides, on what.
pub(super) struct Local<'a> {
    pub(super) world: &'a World,
    pub(super) policy: &'a PolicySpec,
    pub(super) link: &'a LinkTrace,
    pub(super) scheduler: SchedulerSettings,
}

struct Driver<'a> {
    local: &'a Local<'a>,
    simulation: Simulation<'a>,
    /// Why each that is on its way was chosen.
    reasons: BTreeMap<RepId, Option<Reason>>,
    cut: Cut,
    failed: u64,
    failure: Option<String>,
}

/// Decides until the exchange is left. A tick that has passed before it could be played is left out.
pub(super) fn drive(local: &Local<'_>, exchange: &Exchange, clock: Clock) -> Result<(), ReplayError> {
    let tree = &local.world.tree;
    let conditions = Conditions {
        tree,
        link: local.link,
        link_start: Time::ZERO,
        // Decoding and uploading take the time that they take.
        client: ClientSettings::unlimited(),
        scheduler: local.scheduler,
        preloaded: &[],
    };
    let simulation = Simulation::new(conditions, local.policy.build(tree))?;
    let mut driver =
        Driver { local, simulation, reasons: BTreeMap::new(), cut: Cut::default(), failed: 0, failure: None };
    let zero_ns = clock.now_ns();
    let mut tick = 0;
    while !exchange.is_left() {
        let passed_ns = clock.now_ns().saturating_sub(zero_ns);
        let due_ns = tick_time(tick).0;
        if passed_ns < due_ns {
            std::thread::sleep(Duration::from_nanos(due_ns - passed_ns));
            continue;
        }
        if let Some(view) = exchange.view() {
            driver.tick(&view, tick_time(tick), exchange)?;
            if tick.is_multiple_of(TICKS_PER_STATUS) {
                exchange.set_status(driver.status(&view));
            }
        }
        let passed = u128::from(clock.now_ns().saturating_sub(zero_ns)) * u128::from(TICKS_PER_SECOND) / 1_000_000_000;
        // A status is due at every twelfth tick, also where ticks are left out.
        let next = (tick + 1).max(u64::try_from(passed).unwrap_or(u64::MAX));
        tick = next.min((tick + 1).next_multiple_of(TICKS_PER_STATUS));
    }
    Ok(())
}

impl Driver<'_> {
    fn tick(&mut self, view: &View, now: Time, exchange: &Exchange) -> Result<(), ReplayError> {
        self.simulation.advance(now)?;
        let done = self.simulation.decide(view, now)?;
        // What was completed and let go within a tick was completed first.
        for rep in &done.completed {
            exchange.give(rep.0, Body::Local);
        }
        for rep in &done.discarded {
            exchange.take_back(rep.0);
        }
        let requested = done.requested.clone();
        // The policy tells its reason for the last one; those before it in the same tick had much the same.
        let reason = self.simulation.scheduler().reason();
        self.reasons.extend(requested.into_iter().map(|rep| (rep, reason)));
        for told in exchange.hear() {
            match told.fate {
                Fate::Shown => {}
                Fate::Broken(reason) => {
                    self.failed += 1;
                    self.failure = Some(reason);
                }
                Fate::Lost => exchange.give(told.rep, Body::Local),
            }
        }
        Ok(())
    }

    fn status(&mut self, view: &View) -> Status {
        let tree = &self.local.world.tree;
        self.cut.make(tree, view, Region::Frustum, &CutSettings { centre_falloff: 0.0, ..CutSettings::default() });
        let quality = self.simulation.judge(&self.cut).mean();
        let on_the_way: BTreeMap<RepId, u64> = self.simulation.in_flight().collect();
        self.reasons.retain(|rep, _| on_the_way.contains_key(rep));
        let fetching = on_the_way.iter().map(|(&rep, &received)| Fetching {
            rep: rep.0,
            bytes: tree.wire_bytes(rep),
            received,
            why: match self.reasons.get(&rep) {
                Some(Some(reason)) if reason.predicted_share >= 0.5 => {
                    format!("on the path, {:.0} % of its gain", 100.0 * reason.predicted_share)
                }
                Some(Some(reason)) => {
                    format!("in case of a surprise, {:.0} % of its gain", 100.0 * (1.0 - reason.predicted_share))
                }
                _ => "by the policy's own rules".to_owned(),
            },
        });
        let fetching = fetching.collect();
        let scheduler = self.simulation.scheduler();
        let link = &scheduler.state().link;
        let estimate = Some((link.rate(), link.latency_s()));
        Status {
            link: Link::InProcess,
            policy: self.local.policy.label.clone(),
            quality,
            estimate,
            received: self.simulation.delivered_bytes(),
            memory: self.simulation.used_bytes(),
            budget: self.local.scheduler.budget,
            fetching,
            waiting: scheduler.waiting_because().map(|because| because.to_string()),
            failed: self.failed,
            failure: self.failure.clone(),
        }
    }
}
