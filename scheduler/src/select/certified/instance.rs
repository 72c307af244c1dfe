//! One choice by itself, certified and exhaustive: what the comparison of methods and the tests call.

use super::Certificate;
use super::objective::Objective;
use super::search::{Ask, Link, Search, Stop};
use super::standing::Standing;
use crate::lod_tree::{LodTree, RepId};

/// A choice to be made: what is planned, the objective, and the link.
pub struct Instance<'a> {
    /// The world.
    pub tree: &'a LodTree,
    /// What is resident or on its way.
    pub standing: Standing,
    /// The time ahead.
    pub objective: Objective,
    /// The link.
    pub link: Link<'a>,
}

/// What was chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Winner {
    /// The representation, for which missing prerequisites would be fetched first; `None`: wait, nothing gains.
    pub rep: Option<RepId>,
    /// Its gain per second of link; 0 without one.
    pub ratio: f64,
    /// What is proven, and what it took.
    pub certificate: Certificate,
}

/// The winner by branch and bound, whose ratio is at least 1 − `tolerance` of the best.
pub fn certified_winner(instance: &mut Instance, tolerance: f64) -> Winner {
    let Instance { tree, standing, objective, link } = instance;
    let ask = Ask { tree, objective, link: *link, allowed: &|_| true };
    let mut search = Search::default();
    search.restart(tree, standing);
    let stop = Stop { tolerance, floor: 0.0, evaluations_max: u64::MAX };
    let ranked = search.next(&ask, standing, stop);
    let ratio = ranked.as_ref().map_or(0.0, |r| r.ratio);
    let certificate = Certificate {
        evaluations: search.evaluations(),
        nodes_opened: search.nodes_opened(),
        ..Certificate::of(ratio, search.upper())
    };
    Winner { rep: ranked.map(|r| r.rep), ratio, certificate }
}

/// The winner by evaluating every candidate with the same estimator; the least id among equals.
pub fn exhaustive_winner(instance: &mut Instance) -> Winner {
    let Instance { tree, standing, objective, link } = instance;
    let ask = Ask { tree, objective, link: *link, allowed: &|_| true };
    let mut search = Search::default();
    let (mut rep, mut ratio) = (None, 0.0);
    for candidate in (0..tree.representations() as u32).map(RepId) {
        if let Some(ranked) = search.exact(&ask, standing, candidate)
            && ranked.ratio > ratio
        {
            (rep, ratio) = (Some(candidate), ranked.ratio);
        }
    }
    let certificate = Certificate { evaluations: search.evaluations(), ..Certificate::of(ratio, ratio) };
    Winner { rep, ratio, certificate }
}
