//! A frame's problem by element, in a world with directions.

use super::frame::{Item, Limits};
use foresight_scheduler::benefit::accuracy::accuracy;
use foresight_scheduler::benefit::cut::{Cut, Patch};
use foresight_scheduler::benefit::element::{self, ELEMENTS, Errors};
use foresight_scheduler::lod_tree::{LodTree, NodeId, RepId};

/// Least bytes per square metre of what lies strictly beneath each node: of each element that is shown, and of all that
/// are shown together.
#[derive(Clone, Debug)]
pub(super) struct CheapestElements {
    each: Vec<Errors>,
    together: Vec<f32>,
}

impl CheapestElements {
    /// One pass over the tree.
    pub(super) fn new(tree: &LodTree, bytes: impl Fn(&LodTree, RepId) -> u64) -> CheapestElements {
        let (each, together) = (vec![element::NOTHING; tree.nodes()], vec![f32::INFINITY; tree.nodes()]);
        let mut cheapest = CheapestElements { each, together };
        for node in (1..tree.nodes() as u32).rev().map(NodeId) {
            let Some(parent) = tree.parent(node) else { continue };
            let surface = tree.surface(node);
            let (mut each, mut together) = (cheapest.each[node.index()], cheapest.together[node.index()]);
            // Rounded down, so that single precision cannot raise a cost; a vanishing area is shown by something else.
            let per_area = |bytes: u64, area: f64| {
                ((bytes as f64 / area.max(f64::MIN_POSITIVE)).min(f64::from(f32::MAX)) as f32).next_down()
            };
            for rep in tree.own(node) {
                let (bytes, errors) = (bytes(tree, rep), element::errors(tree, rep));
                let mut area = 0.0;
                for s in (0..ELEMENTS).filter(|&s| errors[s] < f32::INFINITY) {
                    each[s] = each[s].min(per_area(bytes, surface[s]));
                    area += surface[s];
                }
                together = together.min(per_area(bytes, area));
            }
            let above = &mut cheapest.each[parent.index()];
            *above = element::least(above, &each);
            cheapest.together[parent.index()] = cheapest.together[parent.index()].min(together);
        }
        cheapest
    }

    /// Least bytes that show everything beneath `node`: what costs M bytes shows at most the share M ÷ (β_s·S_s) of any
    /// element s, so at most M over the least of these.
    pub(super) fn whole(&self, tree: &LodTree, node: NodeId) -> f64 {
        let surface = tree.surface(node);
        let shown =
            (0..ELEMENTS).filter(|&s| surface[s] > 0.0).map(|s| f64::from(self.each[node.index()][s]) * surface[s]);
        let least = shown.fold(f64::INFINITY, f64::min);
        // Areas are sums in single precision.
        if least.is_finite() { (least * (1.0 - 1e-6)).max(0.0) } else { least }
    }
}

/// How the weight of a patch is divided among the surfaces beneath it, per square metre.
pub(super) struct ElementDensity([f64; ELEMENTS]);

impl ElementDensity {
    /// `weight` is the patch's.
    pub(super) fn new(tree: &LodTree, cut: &Cut, patch: &Patch, weight: f64) -> ElementDensity {
        let facing = element::facing(tree.centre(patch.node) - cut.eye, tree.half(patch.node), cut.reach);
        let whole = element::projected(&tree.surface(patch.node), &facing);
        ElementDensity(facing.map(|m| if whole > 0.0 { weight * m / whole } else { 0.0 }))
    }

    /// Of one square metre.
    pub(super) fn of(&self, element: usize) -> f64 {
        self.0[element]
    }

    /// A node at or beneath the patch that is not opened further.
    pub(super) fn sight(&self, tree: &LodTree, node: NodeId, cheapest: &[CheapestElements; 2]) -> Sight {
        let surface = tree.surface(node);
        let weights = core::array::from_fn(|s| surface[s] * self.0[s]);
        // Whatever costs M bytes has at most M/β square metres of all elements together.
        let beneath = cheapest.each_ref().map(|cheapest| {
            let per_area = f64::from(cheapest.together[node.index()]);
            self.0.map(
                |density| if tree.is_leaf(node) { f64::INFINITY } else { per_area / density.max(f64::MIN_POSITIVE) },
            )
        });
        Sight { weights, beneath }
    }
}

/// What is seen of an item, by element.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sight {
    weights: [f64; ELEMENTS],
    /// Least wire and decoded bytes per unit of weight at which something beneath improves it.
    beneath: [[f64; ELEMENTS]; 2],
}

/// The problem by element: items and options are those of the frame.
pub(super) struct Lanes {
    /// By item; only of what is seen.
    sights: Vec<Option<Sight>>,
    /// Errors of the options of each item.
    errors: Vec<Errors>,
    /// What part of each own representation's price an element pays, in the order of items, with the first of each item.
    shares: Vec<[f64; ELEMENTS]>,
    first_share: Vec<usize>,
    /// Elements of which something is seen.
    seen: Vec<usize>,
}

impl Lanes {
    pub(super) fn new(tree: &LodTree, items: &[Item], sights: Vec<(usize, Sight)>) -> Lanes {
        let mut by_item: Vec<Option<Sight>> = vec![None; items.len()];
        let mut beneath = vec![[0.0; ELEMENTS]; items.len()];
        for (item, sight) in sights {
            by_item[item] = Some(sight);
            beneath[item] = sight.weights;
        }
        for place in (0..items.len()).rev() {
            let parent = items[place].parent;
            if parent != place {
                let of_child = beneath[place];
                beneath[parent].iter_mut().zip(of_child).for_each(|(sum, weight)| *sum += weight);
            }
        }
        let mut lanes = Lanes {
            sights: by_item,
            errors: Vec::new(),
            shares: Vec::new(),
            first_share: Vec::new(),
            seen: Vec::new(),
        };
        for (place, item) in items.iter().enumerate() {
            if item.parent == place {
                lanes.errors.push(element::NOTHING);
            } else {
                let from = items[item.parent].first;
                lanes.errors.extend_from_within(from..from + item.inherited);
            }
            lanes.first_share.push(lanes.shares.len());
            for rep in tree.own(item.node) {
                let errors = element::errors(tree, rep);
                let mut share: [f64; ELEMENTS] =
                    core::array::from_fn(|s| if errors[s] < f32::INFINITY { beneath[place][s] } else { 0.0 });
                let whole: f64 = share.iter().sum();
                share.iter_mut().for_each(|share| *share = if whole > 0.0 { *share / whole } else { 0.0 });
                lanes.errors.push(errors);
                lanes.shares.push(share);
            }
        }
        let all = |s: &usize| lanes.sights.iter().flatten().any(|sight| sight.weights[*s] > 0.0);
        lanes.seen = (0..ELEMENTS).filter(all).collect();
        lanes
    }

    /// Σ over the elements of max_R [ Q_R − λ·cost(R) ] over what each fits the limits.
    pub(super) fn relaxed(
        &self,
        tree: &LodTree,
        items: &[Item],
        values: &mut Vec<f64>,
        lambda: f64,
        wire: bool,
        limits: Limits,
    ) -> f64 {
        self.seen.iter().map(|&s| self.relaxed_element(s, tree, items, values, lambda, wire, limits)).sum()
    }

    #[expect(clippy::too_many_arguments, reason = "one element of the sum above")]
    fn relaxed_element(
        &self,
        s: usize,
        tree: &LodTree,
        items: &[Item],
        values: &mut Vec<f64>,
        lambda: f64,
        wire: bool,
        limits: Limits,
    ) -> f64 {
        values.clear();
        values.resize(self.errors.len(), 0.0);
        let mut root = 0.0;
        for place in (0..items.len()).rev() {
            let item = items[place];
            let own = tree.own(item.node);
            let errors = &self.errors[item.first..item.first + item.inherited + own.len()];
            if let Some(sight) = self.sights[place].as_ref().filter(|sight| sight.weights[s] > 0.0) {
                let per_weight = sight.beneath[if wire { 0 } else { 1 }][s];
                let perfect = if per_weight.is_finite() { 1.0 - lambda * per_weight } else { 0.0 };
                for (option, errors) in errors.iter().enumerate() {
                    let shown = accuracy(f64::from(errors[s]), item.sharpness);
                    values[item.first + option] += sight.weights[s] * shown.max(perfect);
                }
            }
            // Buy one of the own, or go on with what comes from above.
            for option in 0..item.inherited {
                let mut best = values[item.first + option];
                for (i, rep) in own.clone().enumerate() {
                    let (bytes, decoded) = (tree.wire_bytes(rep) as f64, tree.decoded_bytes(rep) as f64);
                    let fits = bytes <= limits.wire && decoded <= limits.memory;
                    if fits && errors[item.inherited + i][s] < errors[option][s] {
                        let price = self.shares[self.first_share[place] + i][s] * if wire { bytes } else { decoded };
                        best = best.max(values[item.first + item.inherited + i] - lambda * price);
                    }
                }
                if item.parent == place {
                    root = best;
                } else {
                    values[items[item.parent].first + option] += best;
                }
            }
        }
        root
    }
}
