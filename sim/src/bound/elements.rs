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

/// The problem by element: each has its own items and options, those that show something of it.
pub(super) struct Lanes(Vec<Lane>);

/// One element's problem, items in preorder.
struct Lane {
    items: Vec<LaneItem>,
    /// Errors of the options of each item: those inherited, then its own, the least first.
    errors: Vec<f32>,
    /// Own options in the order of the items.
    own: Vec<Own>,
}

#[derive(Clone, Copy)]
struct LaneItem {
    /// Place of the nearest item above; itself for the first.
    parent: usize,
    /// Options that can come from above, the first being nothing at all.
    inherited: usize,
    /// Where its options begin, and its own.
    first: usize,
    own: [usize; 2],
    /// Of what is seen; 0 for what only groups others.
    weight: f64,
    sharpness: f64,
    /// Least wire and decoded bytes per unit of weight at which something beneath improves it.
    beneath: [f64; 2],
}

/// A representation that shows the element.
#[derive(Clone, Copy)]
struct Own {
    /// Wire and decoded bytes.
    bytes: [f64; 2],
    /// What part of its price this element pays.
    share: f64,
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
        let weighs = |s: &usize| beneath.iter().any(|weights| weights[*s] > 0.0);
        Lanes((0..ELEMENTS).filter(weighs).map(|s| Lane::new(s, tree, items, &by_item, &beneath)).collect())
    }

    /// Σ over the elements of max_R [ Q_R − λ·cost(R) ] over what each fits the limits.
    pub(super) fn relaxed(&self, values: &mut Vec<f64>, lambda: f64, wire: bool, limits: Limits) -> f64 {
        self.0.iter().map(|lane| lane.relaxed(values, lambda, wire, limits)).sum()
    }
}

impl Lane {
    fn new(s: usize, tree: &LodTree, items: &[Item], sights: &[Option<Sight>], beneath: &[[f64; ELEMENTS]]) -> Lane {
        let mut lane = Lane { items: Vec::new(), errors: Vec::new(), own: Vec::new() };
        // Where each item went; what weighs nothing is left out.
        let mut places = vec![usize::MAX; items.len()];
        for (place, item) in items.iter().enumerate().filter(|(place, _)| beneath[*place][s] > 0.0) {
            places[place] = lane.items.len();
            let parent = places[item.parent];
            let first = lane.errors.len();
            let inherited = if item.parent == place {
                lane.errors.push(f32::INFINITY);
                1
            } else {
                let above = lane.items[parent];
                let count = above.inherited + above.own[1] - above.own[0];
                lane.errors.extend_from_within(above.first..above.first + count);
                count
            };
            let mut own: Vec<(f32, Own)> = Vec::new();
            for rep in tree.own(item.node) {
                let errors = element::errors(tree, rep);
                if errors[s] < f32::INFINITY {
                    let shown = (0..ELEMENTS).filter(|&s| errors[s] < f32::INFINITY).map(|s| beneath[place][s]);
                    let share = beneath[place][s] / shown.sum::<f64>();
                    let bytes = [tree.wire_bytes(rep) as f64, tree.decoded_bytes(rep) as f64];
                    own.push((errors[s], Own { bytes, share }));
                }
            }
            own.sort_by(|a, b| a.0.total_cmp(&b.0));
            let first_own = lane.own.len();
            lane.errors.extend(own.iter().map(|(error, _)| error));
            lane.own.extend(own.iter().map(|(_, own)| own));
            let sight = sights[place].as_ref();
            lane.items.push(LaneItem {
                parent: if item.parent == place { lane.items.len() } else { parent },
                inherited,
                first,
                own: [first_own, lane.own.len()],
                weight: sight.map_or(0.0, |sight| sight.weights[s]),
                sharpness: item.sharpness,
                beneath: sight.map_or([f64::INFINITY; 2], |sight| sight.beneath.map(|bytes| bytes[s])),
            });
        }
        lane
    }

    fn relaxed(&self, values: &mut Vec<f64>, lambda: f64, wire: bool, limits: Limits) -> f64 {
        values.clear();
        values.resize(self.errors.len(), 0.0);
        let which = if wire { 0 } else { 1 };
        let mut root = 0.0;
        // Best that buying one of the first own options is worth.
        let mut bought: Vec<f64> = Vec::new();
        for (place, item) in self.items.iter().enumerate().rev() {
            let own = &self.own[item.own[0]..item.own[1]];
            let errors = &self.errors[item.first..item.first + item.inherited + own.len()];
            if item.weight > 0.0 {
                let per_weight = item.beneath[which];
                let perfect = if per_weight.is_finite() { 1.0 - lambda * per_weight } else { 0.0 };
                for (option, &error) in errors.iter().enumerate() {
                    let shown = accuracy(f64::from(error), item.sharpness);
                    values[item.first + option] += item.weight * shown.max(perfect);
                }
            }
            bought.clear();
            let mut best = f64::NEG_INFINITY;
            for (i, own) in own.iter().enumerate() {
                if own.bytes[0] <= limits.wire && own.bytes[1] <= limits.memory {
                    best = best.max(values[item.first + item.inherited + i] - lambda * own.share * own.bytes[which]);
                }
                bought.push(best);
            }
            // Buy one of the own that is better, or go on with what comes from above.
            let own_errors = &errors[item.inherited..];
            for option in 0..item.inherited {
                let better = own_errors.partition_point(|&error| error < errors[option]);
                let mut best = values[item.first + option];
                if better > 0 {
                    best = best.max(bought[better - 1]);
                }
                if item.parent == place {
                    root = best;
                } else {
                    values[self.items[item.parent].first + option] += best;
                }
            }
        }
        root
    }
}
