//! Runs the real viewers in a headless browser over the tilesets, camera paths and links of the simulator, and compares
//! what they ask for, and in which order, with the policies that stand for them.
//!
//! Both sides get the same: a tileset written from the simulator's own tree, so that its boxes and errors are those that
//! the policy sees; the camera at 60 Hz; a link shared as [`foresight_traces::link::SharedLink`] shares it, here in real
//! time on this machine's loopback; the same budget. What differs is what is measured: the viewer's own rules against
//! their port. The time that this machine takes to parse and draw enters as well: hence several runs, whose agreement
//! with each other is the most that can be asked of a port.
//!
//! What is known to differ:
//! - 3d-tiles-renderer prepares at most 250 tiles a frame, so that in a large tileset the first frames see only a part of the
//!   first view; it sends a frame after it has chosen; a response's header reaches its queue up to a frame later than
//!   here. Tiles of equal error and distance go in the order of a sort that is not the tree's.
//! - cesium gives many tiles the same priority, and a binary heap's layout decides between them.
//! - Where memory is short, the simulator's budget cannot be overdrawn, and requests take their memory when they are made;
//!   both viewers count what is loaded.

pub(crate) mod browser;
mod case;
mod models;
mod order;
mod page;
mod server;

use std::fmt;
use std::sync::Arc;

use foresight_scheduler::lod_tree::RepId;
use serde::Serialize;

pub use browser::{Browser, BrowserError, packages_folder};
pub use case::{Case, CaseError, cases};
pub use models::Loaded;
pub use order::{kendall, spearman};

/// A real viewer.
#[derive(Clone, Copy, Debug)]
pub struct Viewer {
    /// Its name in the package registry, that of the policy, and that of its page.
    pub name: &'static str,
    /// The page that runs it.
    page: &'static str,
    /// The policy that stands for it, with the options that a case asks for.
    policy: fn(&Case) -> String,
    /// Fewest requests under way at once that its page can hold it to.
    least_streams: usize,
}

/// The viewers that there are pages for.
pub const VIEWERS: [Viewer; 2] = [
    Viewer {
        name: "3d-tiles-renderer",
        page: include_str!("../../fidelity/3d-tiles-renderer.html"),
        policy: |case| format!("3d-tiles-renderer:parallel={}", case.streams),
        least_streams: 1,
    },
    // Its own limit of 18 a server is below what HTTP/2 carries.
    Viewer {
        name: "cesium",
        page: include_str!("../../fidelity/cesium.html"),
        policy: |_| "cesium".to_owned(),
        least_streams: 18,
    },
];

impl Viewer {
    /// Whether its page can play the case.
    pub fn plays(&self, case: &Case) -> bool {
        case.streams >= self.least_streams
    }
}

/// A request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Asked {
    /// Seconds from the first frame.
    pub at_s: f64,
    /// For what.
    pub rep: RepId,
}

/// What one run of a real viewer yielded.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// Requests in order.
    pub requests: Vec<Asked>,
    /// Frames that the viewer was shown.
    pub frames: u64,
    /// How long that took.
    pub seconds: f64,
    /// The longest time between two frames, seconds.
    pub longest_frame_s: f64,
    /// Requests whose connection the browser closed before their last byte.
    pub cancelled: u64,
    /// Bytes that crossed the link.
    pub bytes: u64,
}

/// How two orders of first requests agree.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Agreement {
    /// What both asked for over what either did.
    pub share_in_common: f64,
    /// Kendall's τ-b of the places of what both asked for.
    pub kendall: f64,
    /// Spearman's ρ of the same.
    pub spearman: f64,
}

/// What one side did at a place of its order.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ask {
    /// The tile's content.
    pub tile: String,
    /// Seconds from the first frame.
    pub at_s: f64,
    /// Tiles above it.
    pub depth: usize,
    /// Its error on the screen then, pixels; `null` with the camera inside its box.
    pub error_px: Option<f64>,
    /// Distance of its box then, metres.
    pub distance_m: f64,
    /// The place at which the other side asked for it.
    pub others_place: Option<usize>,
}

/// The first place at which two orders differ.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Divergence {
    /// Counted from 0.
    pub place: usize,
    /// What the viewer asked for.
    pub real: Option<Ask>,
    /// What the policy asked for.
    pub ours: Option<Ask>,
}

/// A viewer and its policy over a case.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// The viewer.
    pub viewer: &'static str,
    /// The case.
    pub case: String,
    /// Requests of the viewer in each run.
    pub requests_real: Vec<usize>,
    /// Requests of the policy.
    pub requests_ours: usize,
    /// Different representations asked for, in each run.
    pub asked_real: Vec<usize>,
    /// The same of the policy.
    pub asked_ours: usize,
    /// Cancelled requests in each run.
    pub cancelled_real: Vec<u64>,
    /// Cancelled requests of the policy.
    pub cancelled_ours: u64,
    /// Frames per second that the viewer was shown, in each run.
    pub frames_per_second: Vec<f64>,
    /// The longest time between two frames in each run, seconds.
    pub longest_frame_s: Vec<f64>,
    /// The policy against the viewer, mean over the runs.
    pub ours: Agreement,
    /// The viewer against itself, mean over the pairs of runs: the ceiling. `null` of one run.
    pub ceiling: Option<Agreement>,
    /// Median over what both asked for of |seconds of the policy's first request − the first run's|.
    pub median_shift_s: f64,
    /// Where the policy and the first run part.
    pub first_divergence: Option<Divergence>,
    /// First requests of the viewer's first run, in order.
    #[serde(skip)]
    pub order_real: Vec<Ask>,
    /// First requests of the policy, in order.
    #[serde(skip)]
    pub order_ours: Vec<Ask>,
}

/// Why there is no comparison.
#[derive(Debug, thiserror::Error)]
pub enum FidelityError {
    /// The case cannot be made.
    #[error(transparent)]
    Case(#[from] CaseError),
    /// The viewer could not be run.
    #[error("{viewer} over {case}: {source}")]
    Browser {
        /// Which.
        viewer: &'static str,
        /// Over what.
        case: String,
        /// Why.
        #[source]
        source: BrowserError,
    },
}

/// Runs the viewer `runs` times over the case, and the policy once.
pub fn compare(browser: &Browser, viewer: &Viewer, case: &Arc<Case>, runs: usize) -> Result<Outcome, FidelityError> {
    let ours = case.replay(&(viewer.policy)(case))?;
    let failed = |source| FidelityError::Browser { viewer: viewer.name, case: case.name.clone(), source };
    let real: Vec<Recorded> =
        (0..runs.max(1)).map(|_| browser.run(viewer, case).map_err(failed)).collect::<Result<_, _>>()?;
    Ok(outcome(viewer, case, &real, &ours.requests, ours.cancelled))
}

fn outcome(viewer: &Viewer, case: &Case, real: &[Recorded], ours: &[Asked], cancelled: u64) -> Outcome {
    let own = firsts(ours);
    let orders: Vec<Vec<Asked>> = real.iter().map(|run| firsts(&run.requests)).collect();
    let pairs = orders.iter().enumerate().flat_map(|(i, a)| orders[i + 1..].iter().map(move |b| agreement(a, b)));
    let pairs: Vec<Agreement> = pairs.collect();
    let against: Vec<Agreement> = orders.iter().map(|order| agreement(order, &own)).collect();
    let first = orders.first().map_or(&[][..], Vec::as_slice);
    Outcome {
        viewer: viewer.name,
        case: case.name.clone(),
        requests_real: real.iter().map(|run| run.requests.len()).collect(),
        requests_ours: ours.len(),
        asked_real: orders.iter().map(Vec::len).collect(),
        asked_ours: own.len(),
        cancelled_real: real.iter().map(|run| run.cancelled).collect(),
        cancelled_ours: cancelled,
        frames_per_second: real.iter().map(|run| run.frames as f64 / run.seconds).collect(),
        longest_frame_s: real.iter().map(|run| run.longest_frame_s).collect(),
        ours: mean(&against).unwrap_or(Agreement { share_in_common: 0.0, kendall: 0.0, spearman: 0.0 }),
        ceiling: mean(&pairs),
        median_shift_s: median_shift(first, &own),
        first_divergence: divergence(case, first, &own),
        order_real: describe(case, first, &own),
        order_ours: describe(case, &own, first),
    }
}

/// The first request for each representation, in order.
fn firsts(requests: &[Asked]) -> Vec<Asked> {
    let mut seen = std::collections::BTreeSet::new();
    requests.iter().copied().filter(|asked| seen.insert(asked.rep)).collect()
}

/// Places and times in `b` of what `a` asked for as well, in the order of `a`.
fn common(a: &[Asked], b: &[Asked]) -> Vec<(usize, usize, f64)> {
    let places: std::collections::BTreeMap<RepId, (usize, f64)> =
        b.iter().enumerate().map(|(place, asked)| (asked.rep, (place, asked.at_s))).collect();
    let found = a.iter().enumerate().filter_map(|(i, asked)| {
        let &(place, at_s) = places.get(&asked.rep)?;
        Some((i, place, (at_s - asked.at_s).abs()))
    });
    found.collect()
}

fn agreement(a: &[Asked], b: &[Asked]) -> Agreement {
    let both = common(a, b);
    let either = a.len() + b.len() - both.len();
    let in_a: Vec<f64> = both.iter().map(|&(place, ..)| place as f64).collect();
    let in_b: Vec<f64> = both.iter().map(|&(_, place, _)| place as f64).collect();
    Agreement {
        share_in_common: if either == 0 { 1.0 } else { both.len() as f64 / either as f64 },
        kendall: kendall(&in_a, &in_b).unwrap_or(0.0),
        spearman: spearman(&in_a, &in_b).unwrap_or(0.0),
    }
}

fn mean(all: &[Agreement]) -> Option<Agreement> {
    let over = |figure: fn(&Agreement) -> f64| all.iter().map(figure).sum::<f64>() / all.len() as f64;
    (!all.is_empty()).then(|| Agreement {
        share_in_common: over(|a| a.share_in_common),
        kendall: over(|a| a.kendall),
        spearman: over(|a| a.spearman),
    })
}

fn median_shift(real: &[Asked], ours: &[Asked]) -> f64 {
    let mut shifts: Vec<f64> = common(real, ours).iter().map(|&(.., shift)| shift).collect();
    shifts.sort_by(f64::total_cmp);
    shifts.get(shifts.len() / 2).copied().unwrap_or(0.0)
}

fn divergence(case: &Case, real: &[Asked], ours: &[Asked]) -> Option<Divergence> {
    let place = (0..real.len().max(ours.len()))
        .find(|&place| real.get(place).map(|asked| asked.rep) != ours.get(place).map(|asked| asked.rep))?;
    let ask = |own: &[Asked], other: &[Asked]| own.get(place).map(|asked| case.describe(asked, place_of(asked, other)));
    Some(Divergence { place, real: ask(real, ours), ours: ask(ours, real) })
}

fn place_of(asked: &Asked, order: &[Asked]) -> Option<usize> {
    order.iter().position(|there| there.rep == asked.rep)
}

fn describe(case: &Case, own: &[Asked], other: &[Asked]) -> Vec<Ask> {
    own.iter().map(|asked| case.describe(asked, place_of(asked, other))).collect()
}

impl fmt::Display for Ask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Ask { tile, at_s, depth, error_px, distance_m, others_place } = self;
        write!(f, "{tile} at {at_s:.3} s (depth {depth}, ")?;
        match error_px {
            Some(error) => write!(f, "{error:.1} px")?,
            None => write!(f, "camera inside")?,
        }
        write!(f, ", {distance_m:.1} m; the other's place ")?;
        match others_place {
            Some(place) => write!(f, "{place})"),
            None => write!(f, "none)"),
        }
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} over {}", self.viewer, self.case)?;
        writeln!(f, "  requests           real {:?}, policy {}", self.requests_real, self.requests_ours)?;
        writeln!(f, "  different tiles    real {:?}, policy {}", self.asked_real, self.asked_ours)?;
        writeln!(f, "  cancelled          real {:?}, policy {}", self.cancelled_real, self.cancelled_ours)?;
        let (rate, longest) = (&self.frames_per_second, &self.longest_frame_s);
        writeln!(f, "  frames per second  real {rate:.1?}, longest frame {longest:.3?} s")?;
        let line = |a: &Agreement| {
            format!("in common {:.3}, Kendall τ-b {:.3}, Spearman ρ {:.3}", a.share_in_common, a.kendall, a.spearman)
        };
        writeln!(f, "  policy to real     {}", line(&self.ours))?;
        if let Some(ceiling) = &self.ceiling {
            writeln!(f, "  real to itself     {}", line(ceiling))?;
        }
        writeln!(f, "  median shift       {:.3} s", self.median_shift_s)?;
        match &self.first_divergence {
            None => writeln!(f, "  first divergence   none"),
            Some(Divergence { place, real, ours }) => {
                let say = |ask: &Option<Ask>| ask.as_ref().map_or("nothing more".to_owned(), ToString::to_string);
                writeln!(f, "  first divergence   place {place}")?;
                writeln!(f, "    real    {}", say(real))?;
                writeln!(f, "    policy  {}", say(ours))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(reps: &[u32]) -> Vec<Asked> {
        reps.iter().enumerate().map(|(i, &rep)| Asked { at_s: i as f64, rep: RepId(rep) }).collect()
    }

    #[test]
    fn only_first_requests_count_and_only_what_both_asked_for_is_ranked() {
        let a = firsts(&asked(&[1, 2, 1, 3, 4]));
        assert_eq!(a.iter().map(|asked| asked.rep.0).collect::<Vec<_>>(), [1, 2, 3, 4]);
        // 3 before 2; 4 and 5 on one side only: 2 concordant pairs, 1 discordant; 3 of 5 in common.
        let agreement = agreement(&a, &asked(&[1, 3, 2, 5]));
        assert!((agreement.kendall - 1.0 / 3.0).abs() < 1e-12, "{agreement:?}");
        assert_eq!(agreement.share_in_common, 0.6);
    }
}
