//! Many sessions from one process, for load and soak.

use crate::clock::Clock;
use crate::fetch::Http;
use crate::session::{Flight, FlightError, Leave, Plan, fly};
use crate::statistics::Histogram;
use crate::summary::{CrowdSummary, Summary, Tally};
use foresight_scheduler::view::View;
use foresight_traces::flight::TICKS_PER_SECOND;
use foresight_traces::random::SplitMix64;
use std::sync::{Arc, Mutex, PoisonError};

/// How many, and how they come and go.
#[derive(Clone, Copy, Debug)]
pub struct CrowdSettings {
    /// Sessions at a time.
    pub clients: u64,
    /// How long there are clients, seconds.
    pub duration_s: f64,
    /// Mean length of a session, seconds, exponentially distributed; one leaves in four without a `bye`, and another comes
    /// in its place. `None` if all stay to the end.
    pub stay_s: Option<f64>,
    /// Seconds in the beginning whose answers are not timed.
    pub warm_up_s: f64,
    /// Seed of the places in the path and of the lengths.
    pub seed: u64,
}

/// From one client's arrival to the next in the beginning, so that they do not all knock at once.
const ARRIVAL_NS: u64 = 2_000_000;
/// How long a client that was turned away waits.
const PAUSE_NS: u64 = 1_000_000_000;

fn count(tally: &Mutex<Tally>, flown: Result<(Summary, Histogram), FlightError>) {
    let mut tally = tally.lock().unwrap_or_else(PoisonError::into_inner);
    match flown {
        Ok((summary, latencies)) => tally.add(&summary, &latencies),
        Err(error) => tally.broken(&error.to_string()),
    }
}

/// Flies them all. Clients arrive 2 ms after each other, or spread over the time between two views if that is longer.
pub async fn crowd(
    plan: &Arc<Plan>,
    views: &Arc<Vec<View>>,
    http: &Http,
    clock: Clock,
    settings: CrowdSettings,
) -> CrowdSummary {
    let tally = Arc::new(Mutex::new(Tally::default()));
    let began_ns = clock.now_ns();
    let until_ns = began_ns + (settings.duration_s * 1e9) as u64;
    let timed_from_ns = began_ns + (settings.warm_up_s * 1e9) as u64;
    let spacing_ns = plan.ticks_per_view * 1_000_000_000 / TICKS_PER_SECOND;
    let arrival_ns = ARRIVAL_NS.max(spacing_ns / settings.clients.max(1));
    let tasks: Vec<_> = (0..settings.clients)
        .map(|client| {
            let (plan, views, http, tally) = (plan.clone(), views.clone(), http.clone(), tally.clone());
            let mut random = SplitMix64::new(settings.seed.wrapping_mul(0x9e37_79b9).wrapping_add(client));
            tokio::spawn(async move {
                clock.sleep_until(began_ns + arrival_ns * client).await;
                loop {
                    let left_s = until_ns.saturating_sub(clock.now_ns()) as f64 * 1e-9;
                    let stays_s = settings.stay_s.map(|mean| -mean * libm::log(1.0 - random.uniform()));
                    let ticks = (left_s.min(stays_s.unwrap_or(left_s)) * TICKS_PER_SECOND as f64) as usize;
                    if ticks == 0 && left_s * TICKS_PER_SECOND as f64 <= 1.0 {
                        return;
                    }
                    let offset = (random.uniform() * views.len() as f64) as usize;
                    let vanishes = stays_s.is_some() && random.uniform() < 0.25;
                    let leave = if vanishes { Leave::Vanish } else { Leave::Bye };
                    let http = http.clone();
                    let (plan, views) = (&*plan, &views[..]);
                    let flight = Flight { plan, views, offset, ticks, leave, log: None, clock, timed_from_ns, http };
                    let flown = fly(flight, |_| {}).await;
                    let turned_away = flown.is_err();
                    count(&tally, flown);
                    if turned_away {
                        clock.sleep_until(clock.now_ns() + PAUSE_NS).await;
                    }
                }
            })
        })
        .collect();
    for task in tasks {
        if let Err(error) = task.await {
            tally.lock().unwrap_or_else(PoisonError::into_inner).broken(&error.to_string());
        }
    }
    let tally = core::mem::take(&mut *tally.lock().unwrap_or_else(PoisonError::into_inner));
    tally.finish(settings.clients, settings.duration_s)
}
