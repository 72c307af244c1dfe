//! The certified choice as the policy uses it: a search per sampling, room made by stale losses, a certificate.
//!
//! A new sampling is searched in the background, a bounded number of evaluations an observation, while choices are still
//! made by the one before; it takes over as soon as its best is certain, or when the next sampling is due.

use super::closure::{coarsest, coarsest_facing, needed_by};
use super::context::{Choice, Choose, Context, Discarded, Lookahead, first_pointless, predicted_share};
use super::settings::Discards;
use crate::benefit::coverage::Refinement;
use crate::benefit::cut::{Cut, Region};
use crate::benefit::element::ELEMENTS;
use crate::lod_tree::RepId;
use crate::select::certified::{
    Ask, Certificate, Link, Objective, ObjectiveSettings, Ranked, Residents, Search, Standing, Stop,
};
use crate::select::horizon::Worst;
use crate::state::{ClientState, Status};
use crate::units::Time;
use crate::view::View;
use std::collections::BTreeMap;

/// Evaluations that one choice has in any case.
const EVALUATIONS_MIN: u64 = 20;
/// Times the evaluations that an observation makes ahead of need, for these and the choices that cannot wait together: what was
/// found out ahead mostly suffices, and where it does not, a choice far from the best costs more than the time.
const URGENT: u64 = 4;
/// Times the same that one choice makes of them: an answer is not waited for longer, and the next goes on.
const AT_ONCE: (u64, u64) = (3, 2);
/// Candidates whose discards are worked out for one decision; the rest are worse even without any loss.
const SWAPS_WEIGHED: usize = 12;
/// Views of a new sampling that one observation scales; it is searched once all are.
const SCALED_AT_ONCE: usize = 8;
/// Losses are watched from when less than this share of memory is free.
const WATCHED_BELOW: f64 = 0.125;

/// The time ahead as it was sampled once, and what has been found out about it.
#[derive(Default)]
struct Prospect {
    objective: Objective,
    search: Search,
    /// Whether the search knows the objective and the plan.
    restarted: bool,
    /// When it was sampled, and what was outstanding then.
    sampled: Time,
    queued_bytes: u64,
    /// The nearest predicted view of each camera, with the camera's share.
    nearest: Vec<(f64, View)>,
}

/// The certified choice.
#[derive(Default)]
pub(super) struct CertifiedChoice {
    /// The planned set, up to date unless `stale`.
    standing: Option<Standing>,
    stale: bool,
    /// By which choices are made.
    present: Prospect,
    /// The latest sampling, if it has not taken over yet; otherwise kept for its memory.
    coming: Prospect,
    is_coming: bool,
    /// Whether this observation's share of the work ahead of need is done.
    prepared: bool,
    residents: Residents,
    /// The cuts of the nearest predicted views, with their shares, once they are needed.
    seen: Vec<(f64, Cut)>,
    /// Gain and cost of what was requested since the objective was sampled.
    taken: (f64, f64),
    /// Evaluations made by the present search before the latest observation.
    evaluations_before: u64,
    /// Evaluations made ahead of need since the latest observation.
    evaluations_ahead: u64,
    certificate: Option<Certificate>,
}

impl CertifiedChoice {
    /// Reads the planned set where it has changed without this policy.
    fn read(&mut self, state: &ClientState) -> Standing {
        let tree = state.tree;
        let planned = state.planned();
        let Some(mut standing) = self.standing.take() else {
            self.residents.clear();
            planned.iter().for_each(|rep| self.residents.added(rep));
            return Standing::new(tree, planned.clone());
        };
        if core::mem::take(&mut self.stale) {
            let gone: Vec<RepId> = standing.plan().iter().filter(|&r| !planned.contains(r)).collect();
            for rep in gone {
                standing.remove(tree, rep);
                self.residents.removed(rep);
            }
            let come: Vec<RepId> = planned.iter().filter(|&r| !standing.plan().contains(r)).collect();
            for rep in come {
                standing.insert(tree, rep);
                self.residents.added(rep);
            }
            (self.present.restarted, self.coming.restarted) = (false, false);
        }
        standing
    }

    /// The latest sampling is the one by which choices are made from now on.
    fn take_over(&mut self) {
        self.is_coming = false;
        self.residents.sampled();
        self.seen.clear();
        self.taken = (0.0, 0.0);
        self.evaluations_before = self.present.search.evaluations();
    }

    /// Runs `decide` with what a choice is asked over.
    fn with_ask<T>(&mut self, cx: &Context, decide: impl FnOnce(&mut Self, &Ask, &mut Standing) -> T) -> T {
        let mut standing = self.read(cx.state);
        let cx = &Context { sampled: self.present.sampled, queued_bytes: self.present.queued_bytes, ..*cx };
        let objective = core::mem::take(&mut self.present.objective);
        let rate = cx.state.link.rate();
        let arrival = |bytes: u64| cx.arrival(bytes);
        let known = cx.oracle.is_some() || !cx.settings.gains_from_arrival;
        let ask = Ask {
            tree: cx.state.tree,
            objective: &objective,
            link: Link {
                seconds_per_byte: 1.0 / rate,
                request_cost_s: cx.settings.request_cost_s,
                first_byte_s: cx.arrival(0),
                arrival_per_byte_s: if known { 0.0 } else { 1.0 / rate },
                arrival: cx.oracle.is_some().then_some(&arrival as &dyn Fn(u64) -> f64),
            },
            allowed: &|rep| cx.may_fetch(rep),
        };
        let answer = decide(self, &ask, &mut standing);
        self.present.objective = objective;
        self.standing = Some(standing);
        answer
    }

    fn restart(&mut self, ask: &Ask, standing: &Standing) {
        if !self.present.restarted {
            self.present.search.restart(ask.tree, standing);
            self.present.restarted = true;
        }
    }

    /// The best closure with the discards that it needs; the standing is as before.
    fn choose_with(&mut self, cx: &Context, ask: &Ask, standing: &mut Standing) -> Option<Choice> {
        self.restart(ask, standing);
        let state = cx.state;
        let (evaluations, opened) = (self.present.search.evaluations(), self.present.search.nodes_opened());
        let urgent = URGENT.saturating_mul(cx.settings.evaluations).saturating_sub(self.evaluations_ahead);
        let left = self.evaluations_before.saturating_add(urgent).saturating_sub(evaluations);
        // While nothing is held there is nothing to show: the first choice may take its time.
        let at_once = if self.residents.is_empty() {
            u64::MAX
        } else {
            (cx.settings.evaluations.saturating_mul(AT_ONCE.0) / AT_ONCE.1).max(EVALUATIONS_MIN)
        };
        let evaluations_max = evaluations.saturating_add(left.clamp(EVALUATIONS_MIN, at_once));
        let mut least_loss = f64::INFINITY;
        let mut best: Option<(Choice, f64)> = None;
        let mut passed_over = Vec::new();
        for weighed in 0..=SWAPS_WEIGHED {
            let floor = best.as_ref().map_or(0.0, |(b, _)| b.ratio);
            let stop = Stop { tolerance: cx.settings.tolerance, floor, evaluations_max };
            let Some(ranked) = self.present.search.next(ask, standing, stop) else { break };
            let need: u64 = ranked.members.iter().map(|&m| state.request_bytes(m)).sum();
            let free = state.free_bytes();
            let (discards, loss) = if need <= free {
                (Vec::new(), 0.0)
            } else if weighed == SWAPS_WEIGHED || weighed > 0 && self.present.search.evaluations() >= evaluations_max {
                passed_over.push(ranked);
                break;
            } else {
                // What the room costs, if it costs what it cost the others: not worth working out if that is too much.
                let guess = (ranked.gain - least_loss * (need - free) as f64) / ranked.cost;
                if best.is_some() && guess < floor {
                    passed_over.push(ranked);
                    continue;
                }
                match self.swap(cx, ask, standing, &ranked, need - free) {
                    Some(swap) => swap,
                    // It cannot gain before the next sampling; discards since then only make it worse.
                    None => continue,
                }
            };
            if need > free {
                least_loss = least_loss.min(loss / (need - free) as f64);
            }
            let net = (ranked.gain - loss) / ranked.cost;
            passed_over.push(ranked.clone());
            if net > floor {
                let Ranked { rep, members, gain, cost, .. } = ranked;
                best = Some((Choice { ratio: net, gain, rep, members, discards, predicted_share: 0.0 }, cost));
                if loss == 0.0 {
                    break;
                }
            }
        }
        for ranked in passed_over.iter().filter(|r| best.as_ref().is_none_or(|(b, _)| b.rep != r.rep)) {
            self.present.search.give_back(ranked);
        }
        let upper = self.present.search.upper();
        let ratio = best.as_ref().map_or(0.0, |(b, _)| b.ratio);
        if let Some((choice, cost)) = &best {
            self.taken.0 += choice.ratio * cost;
            self.taken.1 += cost;
        }
        if let Some((choice, _)) = &mut best {
            let worst = self.present.search.gain_of_worst_case(ask, standing, &choice.members);
            choice.predicted_share = predicted_share(choice.gain, worst);
        }
        let (gained, spent) = self.taken;
        let left = upper * spent;
        self.certificate = Some(Certificate {
            evaluations: self.present.search.evaluations() - evaluations,
            nodes_opened: self.present.search.nodes_opened() - opened,
            plan_gap: if left > 0.0 && left.is_finite() { left / (gained + left) } else { 0.0 },
            cut_short: self.present.search.evaluations() >= evaluations_max,
            ..Certificate::of(ratio, upper)
        });
        best.map(|(choice, _)| choice)
    }

    /// Discards for a closure and their joint loss, or `None` if the swap does not gain. The standing is as before.
    fn swap(
        &mut self,
        cx: &Context,
        ask: &Ask,
        standing: &mut Standing,
        ranked: &Ranked,
        bytes: u64,
    ) -> Option<(Vec<RepId>, f64)> {
        let (state, tree, members) = (cx.state, ask.tree, &ranked.members);
        if members.iter().map(|&m| state.request_bytes(m)).sum::<u64>() > state.budget {
            return None;
        }
        for &member in members {
            standing.insert(tree, member);
        }
        let planned = cx.settings.discards == Discards::Planned;
        let may_go = |rep: RepId| {
            state.status(rep) == Status::Resident && !state.is_needed(rep) && !needed_by(state, rep, members)
        };
        let mut replaced = Vec::new();
        if planned {
            // A new representation takes over from the nearest owner above it: that one's loss falls.
            for &member in members {
                let others = |n| tree.own(n).filter(|r| standing.plan().contains(*r) && !members.contains(r));
                if let Some(owner) = tree.ancestors(tree.node_of(member)).find(|&n| others(n).next().is_some()) {
                    replaced.extend(others(owner));
                }
            }
            replaced.sort_unstable();
            replaced.dedup();
        }
        let limit = if planned { ranked.gain / (1.0 + cx.settings.hysteresis) } else { f64::INFINITY };
        let wire: u64 = members.iter().map(|&m| tree.wire_bytes(m)).sum();
        let offset = ask.link.arrival_of(wire);
        let (search, residents) = (&mut self.present.search, &mut self.residents);
        let chosen =
            residents.choose(ask, search, standing, &replaced, bytes, offset, limit, planned, &may_go, members);
        for &member in members.iter().rev() {
            standing.remove(tree, member);
        }
        let swap = chosen.filter(|s| !planned || ranked.gain > (1.0 + cx.settings.hysteresis) * s.loss)?;
        Some((swap.reps, swap.loss))
    }
}

impl Choose for CertifiedChoice {
    fn sample(&mut self, cx: &Context, ahead: &Lookahead) {
        let s = cx.settings;
        let settings = ObjectiveSettings { alpha: ahead.alpha, attenuation: s.attenuation, cut: s.cut };
        if self.is_coming {
            // It has had its time.
            self.coming.objective.scale(cx.state.tree, usize::MAX);
            core::mem::swap(&mut self.present, &mut self.coming);
            self.take_over();
        }
        self.coming.objective.cameras = ahead.cameras;
        let worst = Worst::Several(&ahead.worst);
        self.coming.objective.begin(&ahead.paths, &ahead.bounds, worst, &settings);
        self.coming.restarted = false;
        (self.coming.sampled, self.coming.queued_bytes) = (cx.sampled, cx.queued_bytes);
        let nearest = ahead.paths.iter().filter_map(|path| path.views.first().copied());
        self.coming.nearest.clear();
        self.coming.nearest.extend(cx.state.cameras().iter().map(|(share, _)| *share).zip(nearest));
        (self.is_coming, self.prepared) = (true, true);
        if ahead.anew {
            self.coming.objective.scale(cx.state.tree, usize::MAX);
            core::mem::swap(&mut self.present, &mut self.coming);
            self.take_over();
        }
    }

    fn prepare(&mut self, cx: &Context) {
        if core::mem::replace(&mut self.prepared, true) {
            return;
        }
        if (cx.state.free_bytes() as f64) < WATCHED_BELOW * cx.state.budget as f64 {
            self.with_ask(cx, |this, ask, standing| this.residents.turn(ask, standing, ask.link.first_byte_s));
        }
        if !self.is_coming || !self.coming.objective.scale(cx.state.tree, SCALED_AT_ONCE) {
            return;
        }
        core::mem::swap(&mut self.present, &mut self.coming);
        let is_certain = self.with_ask(cx, |this, ask, standing| {
            this.restart(ask, standing);
            let search = &mut this.present.search;
            let before = search.evaluations();
            let evaluations_max = search.evaluations().saturating_add(cx.settings.evaluations);
            let stop = Stop { tolerance: cx.settings.tolerance, floor: 0.0, evaluations_max };
            if let Some(best) = search.next(ask, standing, stop) {
                search.give_back(&best);
            }
            let made = search.evaluations() - before;
            this.evaluations_ahead += made;
            made < cx.settings.evaluations
        });
        if is_certain {
            self.take_over();
        } else {
            core::mem::swap(&mut self.present, &mut self.coming);
        }
    }

    fn added(&mut self, cx: &Context, rep: RepId) {
        self.residents.added(rep);
        self.with_ask(cx, |this, ask, standing| {
            if standing.insert(ask.tree, rep) {
                for prospect in [&mut this.present, &mut this.coming].into_iter().filter(|p| p.restarted) {
                    prospect.search.added(ask, rep);
                }
            }
        });
    }

    fn removed(&mut self, cx: &Context, rep: RepId) {
        self.residents.removed(rep);
        self.with_ask(cx, |this, ask, standing| {
            if standing.remove(ask.tree, rep) && this.present.restarted {
                this.present.search.removed(ask, standing, rep);
            }
        });
        if self.coming.restarted {
            core::mem::swap(&mut self.present, &mut self.coming);
            self.with_ask(cx, |this, ask, standing| this.present.search.removed(ask, standing, rep));
            core::mem::swap(&mut self.present, &mut self.coming);
        }
    }

    fn observed(&mut self) {
        self.evaluations_before = self.present.search.evaluations();
        self.evaluations_ahead = 0;
        self.prepared = false;
    }

    fn forget(&mut self) {
        self.stale = true;
    }

    fn cover(&mut self, cx: &Context) -> Option<RepId> {
        let (state, tree) = (cx.state, cx.state.tree);
        let standing = self.read(state);
        if self.seen.is_empty() {
            self.seen.extend(self.present.nearest.iter().map(|(share, view)| {
                let mut cut = Cut::default();
                cut.make(tree, view, Region::Frustum, &cx.settings.cut);
                (*share, cut)
            }));
        }
        let mut weight = BTreeMap::<RepId, f64>::new();
        let patches = self.seen.iter().flat_map(|(share, cut)| cut.patches.iter().map(move |p| (share, cut, p)));
        for (share, cut, patch) in patches {
            let first = if tree.has_directions() {
                let (shown, shares) = (standing.plan().elements_above(tree, patch.node), cut.shares(tree, patch.node));
                let shows = (0..ELEMENTS).any(|s| shares[s] > 0.0 && shown.rep(s).is_some());
                if shows { None } else { coarsest_facing(tree, patch.node, &shares) }
            } else {
                let is_shown = standing.plan().shown_at(tree, patch.node).0.is_some();
                if is_shown { None } else { coarsest(tree, patch.node) }
            };
            if let Some(rep) = first {
                *weight.entry(rep).or_default() += share * patch.weight;
            }
        }
        self.standing = Some(standing);
        let per_byte = |(rep, weight): &(RepId, f64)| weight / tree.wire_bytes(*rep) as f64;
        let candidates = weight.into_iter().filter(|&(r, _)| cx.may_fetch(r) && state.has_prerequisite(r));
        candidates
            .filter(|&(r, _)| state.request_bytes(r) <= state.free_bytes())
            .max_by(|a, b| per_byte(a).total_cmp(&per_byte(b)).then(b.0.cmp(&a.0)))
            .map(|(rep, _)| rep)
    }

    fn pointless_request(&mut self, cx: &Context) -> Option<RepId> {
        first_pointless(cx, |_, _| true)?;
        self.with_ask(cx, |this, ask, standing| {
            this.restart(ask, standing);
            let evaluations_max = this.present.search.evaluations().saturating_add(cx.settings.evaluations);
            let best = this.present.search.next(ask, standing, Stop { tolerance: 0.1, floor: 0.0, evaluations_max });
            if let Some(best) = &best {
                this.present.search.give_back(best);
            }
            let ratio = best.map_or(0.0, |b| b.ratio);
            let offset = ask.link.first_byte_s;
            first_pointless(cx, |rep, seconds| {
                this.present.search.marginal(ask, standing, rep, offset) / seconds < 0.1 * ratio
            })
        })
    }

    fn make_room(&mut self, cx: &Context, bytes: u64) -> Discarded {
        let state = cx.state;
        let planned = cx.settings.discards == Discards::Planned;
        let may_go = |rep: RepId| state.status(rep) == Status::Resident && !state.is_needed(rep);
        self.with_ask(cx, |this, ask, standing| {
            this.restart(ask, standing);
            let (search, offset) = (&mut this.present.search, ask.link.first_byte_s);
            let gone = this.residents.make_room(ask, search, standing, bytes, offset, planned, &may_go);
            Discarded { reps: gone.reps, loss: gone.loss }
        })
    }

    fn loss(&mut self, cx: &Context, rep: RepId) -> f64 {
        self.with_ask(cx, |this, ask, standing| this.present.search.marginal(ask, standing, rep, ask.link.first_byte_s))
    }

    fn choose(&mut self, cx: &Context) -> Option<Choice> {
        debug_assert!(
            cx.state.planned().refinement() == Refinement::Partial,
            "sibling groups are for the sampled choice"
        );
        self.with_ask(cx, |this, ask, standing| this.choose_with(cx, ask, standing))
    }

    fn heap_bytes(&self) -> usize {
        let prospect = |p: &Prospect| p.objective.heap_bytes() + p.search.heap_bytes();
        self.standing.as_ref().map_or(0, Standing::heap_bytes)
            + self.residents.heap_bytes()
            + prospect(&self.present)
            + prospect(&self.coming)
            + self.seen.iter().map(|(_, cut)| cut.heap_bytes()).sum::<usize>()
    }

    fn certificate(&self) -> Option<Certificate> {
        self.certificate
    }
}
