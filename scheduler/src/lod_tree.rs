//! The LOD tree: the one shape that every kind of world takes.
//!
//! A node has a bounding box, its children lie inside it, and it can own representations, each of which shows
//! everything beneath the node. The arrays are flat and in preorder: the subtree of a node is one interval of ids,
//! so whatever is kept per node can be summed, searched and refreshed by slices.

use crate::benefit::element::{ELEMENTS, Shown};
use crate::view::POSITION_MAX;
use glam::{DVec3, Vec3};

/// A node of the tree, by its place in preorder; the root is 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(pub u32);

/// A representation, by its place in the order of its node, then of its insertion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RepId(pub u32);

impl NodeId {
    /// As an index into an array with one element per node.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

impl RepId {
    /// As an index into an array with one element per representation.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// An axis-aligned box in world space, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Least corner.
    pub min: DVec3,
    /// Greatest corner.
    pub max: DVec3,
}

impl Aabb {
    /// The empty box: the neutral element of [`Aabb::union`].
    pub const EMPTY: Aabb = Aabb { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    /// The least box around both.
    pub fn union(self, other: Aabb) -> Aabb {
        Aabb { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// True when no point lies inside.
    pub fn is_empty(self) -> bool {
        self.min.x > self.max.x || self.min.y > self.max.y || self.min.z > self.max.z
    }

    /// The middle.
    pub fn centre(self) -> DVec3 {
        0.5 * (self.min + self.max)
    }
}

/// What a representation costs and how well it shows its node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Representation {
    /// Bytes on the wire, M_r; at least 1.
    pub wire_bytes: u32,
    /// Bytes in memory once decoded, m_r, textures with their mips.
    pub decoded_bytes: u32,
    /// Geometric error g_r in metres; finite, not negative.
    pub error: f32,
    /// The representation that must be there first, if any. It has to be inserted earlier.
    pub prerequisite: Option<RepId>,
    /// For an orthoview, from which of the 26 canonical directions it looks at the node: `9·(x+1) + 3·(y+1) + (z+1)`
    /// for the direction (x, y, z) of −1, 0 and 1 from the node towards the eye. `None` shows every side.
    pub direction: Option<u8>,
}

const NO_REP: u32 = u32::MAX;
const NO_DIRECTION: u8 = u8::MAX;

/// What is read together of a node: decisions look at few nodes, far apart in memory.
#[derive(Clone, Copy, Debug)]
struct Node {
    centre: DVec3,
    half: Vec3,
    area: [f32; 3],
    /// Bounds for the representations strictly beneath, as the upper halves of f32s rounded the safe way: area per wire byte
    /// by axis, least error, least wire bytes.
    beneath: [u16; 5],
    parent: u32,
    subtree_end: u32,
    first_rep: u32,
}

/// What is read together of a representation.
#[derive(Clone, Copy, Debug)]
struct Rep {
    node: u32,
    wire: u32,
    decoded: u32,
    error: f32,
}

/// A world as the scheduler sees it. At most 2³²−2 nodes and as many representations; 88 to 97 bytes for a node with
/// one representation. With directions 56 bytes a node more, and 32 a representation where a node has nine; 14 more where the
/// world tells what its orthoviews hide.
#[derive(Clone, Debug, Default)]
pub struct LodTree {
    /// In preorder, and one more whose `first_rep` ends the last.
    nodes: Vec<Node>,
    importance: Vec<f32>,
    reps: Vec<Rep>,
    rep_prerequisite: Vec<u32>,
    rep_direction: Vec<u8>,
    /// Empty unless some orthoview told what it shows.
    rep_shown: Vec<Shown>,
    errors_fall: bool,
    /// Per node, m² by element, summed over the leaves beneath; empty unless the tree has directions and some leaf told
    /// its surface.
    surface: Vec<[f32; ELEMENTS]>,
}

/// Bounds for every representation strictly beneath a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beneath {
    /// At least S_{n(r)} / M_r by axis, m² per wire byte.
    pub density: [f32; 3],
    /// At most the least error, metres; ∞ if there is none.
    pub least_error: f32,
    /// At most the least wire bytes; ∞ if there is none.
    pub least_wire: f32,
}

impl Beneath {
    /// Of no representation.
    pub const NONE: Beneath = Beneath { density: [0.0; 3], least_error: f32::INFINITY, least_wire: f32::INFINITY };

    /// For both.
    pub fn union(self, other: Beneath) -> Beneath {
        Beneath {
            density: [0, 1, 2].map(|i| self.density[i].max(other.density[i])),
            least_error: self.least_error.min(other.least_error),
            least_wire: self.least_wire.min(other.least_wire),
        }
    }

    /// For one representation of a node with these face areas.
    pub fn of(face_areas: [f32; 3], wire_bytes: u32, error: f32) -> Beneath {
        let per_byte = |area: f32| narrow_up(f64::from(area) / f64::from(wire_bytes));
        Beneath {
            density: face_areas.map(per_byte),
            least_error: error,
            least_wire: narrow_down(f64::from(wire_bytes)),
        }
    }

    fn pack(self) -> [u16; 5] {
        let up = |v: f32| (v.to_bits().saturating_add(0xFFFF) >> 16) as u16;
        let down = |v: f32| (v.to_bits() >> 16) as u16;
        let [x, y, z] = self.density.map(up);
        [x, y, z, down(self.least_error), down(self.least_wire)]
    }

    fn unpack(packed: [u16; 5]) -> Beneath {
        let [x, y, z, error, wire] = packed.map(|half| f32::from_bits(u32::from(half) << 16));
        Beneath { density: [x, y, z], least_error: error, least_wire: wire }
    }
}

/// Deepest tree accepted. An octree that halves the Earth down to a millimetre has 34 levels.
pub const DEPTH_MAX: usize = 1000;

/// Why a tree cannot be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LodTreeError {
    /// There is not a single node.
    #[error("the world has no node; expected at least one with content")]
    Empty,
    /// A node has neither children nor content bounds.
    #[error("node {0} has neither children nor content bounds")]
    LeafWithoutBounds(u32),
    /// A box has a corner that is NaN or infinite, or is inside out.
    #[error("node {node} has the bounds {min} to {max}; expected corners in order, within ±1e30 m")]
    Bounds {
        /// The node.
        node: u32,
        /// Least corner as given.
        min: DVec3,
        /// Greatest corner as given.
        max: DVec3,
    },
    /// Geometric error that is not a number ≥ 0.
    #[error("representation {rep} has the geometric error {error} m; expected a finite number ≥ 0")]
    GeometricError {
        /// The representation.
        rep: u32,
        /// As given.
        error: f32,
    },
    /// A representation that costs nothing to fetch.
    #[error("representation {0} has 0 bytes on the wire; expected at least 1")]
    NoBytes(u32),
    /// A prerequisite that was not inserted earlier.
    #[error("representation {rep} needs {prerequisite}, which was not inserted before it")]
    Prerequisite {
        /// The representation.
        rep: u32,
        /// The one it names.
        prerequisite: u32,
    },
    /// A direction code above 26 or the centre, 13.
    #[error("representation {rep} has the direction code {code}; expected 0 to 26 without 13")]
    Direction {
        /// The representation.
        rep: u32,
        /// As given.
        code: u8,
    },
    /// Importance that is not a finite number ≥ 0.
    #[error("node {node} has the importance {importance}; expected a finite number ≥ 0")]
    Importance {
        /// The node.
        node: u32,
        /// As given.
        importance: f32,
    },
    /// Shares of a surface that are not finite numbers ≥ 0, or all 0.
    #[error("node {node} has {share} as a share of its surface; expected finite numbers ≥ 0, not all of them 0")]
    Surface {
        /// The node.
        node: u32,
        /// The share that is wrong.
        share: f32,
    },
    /// A tree deeper than [`DEPTH_MAX`].
    #[error(
        "the tree is more than {DEPTH_MAX} levels deep; expected at most that, because decisions walk from leaf to root"
    )]
    TooDeep,
    /// More nodes or representations than 32-bit ids can name.
    #[error("more than 2^32 - 2 {0}")]
    TooMany(&'static str),
    /// `close` was called more often than `open`, or less, or a second root was opened.
    #[error("nodes are not nested: {0}")]
    Nesting(&'static str),
}

/// Builds a [`LodTree`] in preorder: `open` a node, add its representations, open and close its children, `close` it.
///
/// ```
/// use foresight_scheduler::lod_tree::{Aabb, LodTreeBuilder, Representation};
/// use glam::DVec3;
/// let mut builder = LodTreeBuilder::default();
/// builder.open()?;
/// builder.add(Representation { wire_bytes: 1000, decoded_bytes: 4000, error: 2.0, prerequisite: None, direction: None })?;
/// for x in [0.0, 10.0] {
///     builder.open()?;
///     builder.add(Representation { wire_bytes: 5000, decoded_bytes: 20000, error: 0.1, prerequisite: None, direction: None })?;
///     builder.close(Some(Aabb { min: DVec3::new(x, 0.0, 0.0), max: DVec3::new(x + 8.0, 5.0, 8.0) }), 1.0)?;
/// }
/// builder.close(None, 1.0)?;
/// let tree = builder.finish()?;
/// assert_eq!((tree.nodes(), tree.representations()), (3, 3));
/// # Ok::<(), foresight_scheduler::lod_tree::LodTreeError>(())
/// ```
#[derive(Debug, Default)]
pub struct LodTreeBuilder {
    tree: LodTree,
    open: Vec<u32>,
    boxes: Vec<Aabb>,
    areas: Vec<[f64; 3]>,
    beneath: Vec<Beneath>,
    /// μ of the leaf that is open, and its node.
    shares: Option<(u32, [f32; ELEMENTS])>,
    /// Leaves with μ, ascending.
    surfaces: Vec<(u32, [f32; ELEMENTS])>,
    /// Orthoviews that told what they show, ascending.
    shown: Vec<(u32, Shown)>,
    any_importance: bool,
    any_prerequisite: bool,
    any_direction: bool,
}

impl LodTreeBuilder {
    /// Opens a node as the next child of the node that is open now, or as the root.
    pub fn open(&mut self) -> Result<NodeId, LodTreeError> {
        let id = self.tree.nodes.len();
        if id >= (u32::MAX - 1) as usize {
            return Err(LodTreeError::TooMany("nodes"));
        }
        let parent = match self.open.last() {
            Some(&parent) => parent,
            None if id == 0 => u32::MAX,
            None => return Err(LodTreeError::Nesting("a second root was opened")),
        };
        if self.open.len() >= DEPTH_MAX {
            return Err(LodTreeError::TooDeep);
        }
        self.tree.nodes.push(Node {
            centre: DVec3::ZERO,
            half: Vec3::ZERO,
            area: [0.0; 3],
            beneath: [0; 5],
            parent,
            subtree_end: 0,
            first_rep: self.tree.reps.len() as u32,
        });
        self.tree.importance.push(1.0);
        self.open.push(id as u32);
        self.boxes.push(Aabb::EMPTY);
        self.areas.push([0.0; 3]);
        self.beneath.push(Beneath::NONE);
        Ok(NodeId(id as u32))
    }

    /// Adds a representation to the node opened last. Must come before the node's children are opened.
    pub fn add(&mut self, rep: Representation) -> Result<RepId, LodTreeError> {
        let id = self.tree.reps.len();
        if id >= (u32::MAX - 1) as usize {
            return Err(LodTreeError::TooMany("representations"));
        }
        let id = id as u32;
        let node = *self.open.last().ok_or(LodTreeError::Nesting("a representation outside every node"))?;
        if node as usize + 1 != self.tree.nodes.len() {
            return Err(LodTreeError::Nesting("a representation was added after its node's children"));
        }
        if !(rep.error.is_finite() && rep.error >= 0.0) {
            return Err(LodTreeError::GeometricError { rep: id, error: rep.error });
        }
        if rep.wire_bytes == 0 {
            return Err(LodTreeError::NoBytes(id));
        }
        if let Some(RepId(prerequisite)) = rep.prerequisite {
            if prerequisite >= id {
                return Err(LodTreeError::Prerequisite { rep: id, prerequisite });
            }
            self.any_prerequisite = true;
        }
        if let Some(code) = rep.direction {
            if code > 26 || code == 13 {
                return Err(LodTreeError::Direction { rep: id, code });
            }
            self.any_direction = true;
        }
        let Representation { wire_bytes: wire, decoded_bytes: decoded, error, .. } = rep;
        self.tree.reps.push(Rep { node, wire, decoded, error });
        self.tree.rep_prerequisite.push(rep.prerequisite.map_or(NO_REP, |r| r.0));
        self.tree.rep_direction.push(rep.direction.unwrap_or(NO_DIRECTION));
        Ok(RepId(id))
    }

    /// Closes the node opened last. `content` bounds what the node itself shows: required for a leaf, and for an inner
    /// node only widened into its box (its weight is that of its leaves). `importance` ι ≥ 0 counts for leaves.
    pub fn close(&mut self, content: Option<Aabb>, importance: f32) -> Result<(), LodTreeError> {
        let node = self.open.pop().ok_or(LodTreeError::Nesting("close without open"))?;
        let mut bounds = self.boxes.pop().unwrap_or(Aabb::EMPTY);
        let mut areas = self.areas.pop().unwrap_or([0.0; 3]);
        let beneath = self.beneath.pop().unwrap_or(Beneath::NONE);
        let index = node as usize;
        let end = self.tree.nodes.len() as u32;
        let is_leaf = end == node + 1;
        if is_leaf && content.is_none() {
            return Err(LodTreeError::LeafWithoutBounds(node));
        }
        if !(importance.is_finite() && importance >= 0.0) {
            return Err(LodTreeError::Importance { node, importance });
        }
        if let Some(own) = content {
            if own.is_empty() || !is_within_reach(own.min) || !is_within_reach(own.max) {
                return Err(LodTreeError::Bounds { node, min: own.min, max: own.max });
            }
            bounds = bounds.union(own);
        }
        let centre = bounds.centre();
        // Measured from the rounded middle, so that no corner is lost when it lies far from the origin.
        let half = (bounds.max - centre).max(centre - bounds.min);
        let half = Vec3::new(narrow_up(half.x), narrow_up(half.y), narrow_up(half.z));
        if !centre.is_finite() || !half.is_finite() {
            return Err(LodTreeError::Bounds { node, min: bounds.min, max: bounds.max });
        }
        if is_leaf {
            let side = half.as_dvec3() * 2.0;
            let iota = f64::from(importance);
            areas = [iota * side.y * side.z, iota * side.x * side.z, iota * side.x * side.y];
            self.tree.importance[index] = importance;
            self.any_importance |= importance != 1.0;
            self.surfaces.extend(self.shares.take().filter(|(of, _)| *of == node));
        }
        let area = areas.map(|a| a as f32);
        let closed = &mut self.tree.nodes[index];
        (closed.subtree_end, closed.centre, closed.half, closed.area) = (end, centre, half, area);
        closed.beneath = beneath.pack();
        if !area.iter().all(|a| a.is_finite()) {
            return Err(LodTreeError::Bounds { node, min: bounds.min, max: bounds.max });
        }
        if let Some(above) = self.beneath.last_mut() {
            let first = self.tree.nodes[index].first_rep as usize;
            // Of a leaf, the own representations are the last that were added.
            let end = self.tree.nodes.get(index + 1).map_or(self.tree.reps.len(), |next| next.first_rep as usize);
            for rep in &self.tree.reps[first..end] {
                *above = above.union(Beneath::of(area, rep.wire, rep.error));
            }
            *above = above.union(beneath);
        }
        if let (Some(parent_box), Some(parent_areas)) = (self.boxes.last_mut(), self.areas.last_mut()) {
            *parent_box = parent_box.union(bounds);
            for (sum, area) in parent_areas.iter_mut().zip(areas) {
                *sum += area;
            }
        }
        Ok(())
    }

    /// The finished tree. Arrays that the world does not need (importance, prerequisites, directions) are dropped.
    pub fn finish(mut self) -> Result<LodTree, LodTreeError> {
        if !self.open.is_empty() {
            return Err(LodTreeError::Nesting("a node was left open"));
        }
        if self.tree.nodes.is_empty() {
            return Err(LodTreeError::Empty);
        }
        let first_rep = self.tree.reps.len() as u32;
        self.tree.nodes.extend(self.tree.nodes.last().map(|last| Node { first_rep, ..*last }));
        // With directions, what is above may show a side that what is beneath does not.
        self.tree.errors_fall = !self.any_direction && self.tree.find_errors_fall();
        if !self.any_importance {
            self.tree.importance = Vec::new();
        }
        if !self.any_prerequisite {
            self.tree.rep_prerequisite = Vec::new();
        }
        if self.any_direction {
            if !self.surfaces.is_empty() {
                self.tree.surface = self.tree.sum_surfaces(&self.surfaces);
            }
            if !self.shown.is_empty() {
                self.tree.rep_shown = self.tree.spread_shown(&self.shown);
            }
        } else {
            self.tree.rep_direction = Vec::new();
        }
        Ok(self.tree)
    }
}

/// Whether a corner is finite and as near as a view can be.
fn is_within_reach(corner: DVec3) -> bool {
    corner.is_finite() && corner.abs().max_element() <= POSITION_MAX
}

/// The one place where world sizes are narrowed to f32: upwards, so that a box never shrinks.
#[expect(clippy::cast_possible_truncation, reason = "the narrowing itself; what it loses is given back by next_up")]
fn narrow_up(value: f64) -> f32 {
    let narrow = value as f32;
    if f64::from(narrow) < value { narrow.next_up() } else { narrow }
}

/// The other way, for what must not grow.
#[expect(clippy::cast_possible_truncation, reason = "the narrowing itself; what it adds is taken off by next_down")]
fn narrow_down(value: f64) -> f32 {
    let narrow = value as f32;
    if f64::from(narrow) > value { narrow.next_down() } else { narrow }
}

impl LodTree {
    /// Number of nodes.
    pub fn nodes(&self) -> usize {
        self.nodes.len().saturating_sub(1)
    }

    /// Number of representations.
    pub fn representations(&self) -> usize {
        self.reps.len()
    }

    /// The root.
    pub fn root(&self) -> NodeId {
        NodeId(0)
    }

    /// The node above, `None` for the root.
    pub fn parent(&self, node: NodeId) -> Option<NodeId> {
        let parent = self.nodes[node.index()].parent;
        (parent != u32::MAX).then_some(NodeId(parent))
    }

    /// One past the last node of the subtree: the subtree is `node.0..subtree_end(node).0`.
    pub fn subtree_end(&self, node: NodeId) -> NodeId {
        NodeId(self.nodes[node.index()].subtree_end)
    }

    /// True if `node` is `ancestor` or lies beneath it.
    pub fn is_beneath(&self, node: NodeId, ancestor: NodeId) -> bool {
        node >= ancestor && node < self.subtree_end(ancestor)
    }

    /// True for a node without children: the things that are seen.
    pub fn is_leaf(&self, node: NodeId) -> bool {
        self.nodes[node.index()].subtree_end == node.0 + 1
    }

    /// The children in order.
    pub fn children(&self, node: NodeId) -> impl Iterator<Item = NodeId> + '_ {
        let end = self.subtree_end(node).0;
        let mut next = node.0 + 1;
        core::iter::from_fn(move || {
            (next < end).then(|| {
                let child = NodeId(next);
                next = self.nodes[child.index()].subtree_end;
                child
            })
        })
    }

    /// The node and everything above it, from the node up to the root.
    pub fn ancestors(&self, node: NodeId) -> impl Iterator<Item = NodeId> + '_ {
        core::iter::successors(Some(node), |&n| self.parent(n))
    }

    /// Middle of the node's content box, metres.
    pub fn centre(&self, node: NodeId) -> DVec3 {
        self.nodes[node.index()].centre
    }

    /// Half the sides of the node's content box, metres.
    pub fn half(&self, node: NodeId) -> DVec3 {
        self.nodes[node.index()].half.as_dvec3()
    }

    /// The node's content box.
    pub fn bounds(&self, node: NodeId) -> Aabb {
        let (centre, half) = (self.centre(node), self.half(node));
        Aabb { min: centre - half, max: centre + half }
    }

    /// S_n by axis: Σ over the leaves beneath of ι × the area (m²) of the content box's face across x, y and z.
    /// The area of the leaves projected along the unit vector u is |u.x|·S.x + |u.y|·S.y + |u.z|·S.z.
    pub fn face_areas(&self, node: NodeId) -> DVec3 {
        let [x, y, z] = self.nodes[node.index()].area;
        DVec3::new(f64::from(x), f64::from(y), f64::from(z))
    }

    /// Bounds for every representation strictly beneath.
    pub fn beneath_bounds(&self, node: NodeId) -> Beneath {
        Beneath::unpack(self.nodes[node.index()].beneath)
    }

    /// The same for one representation.
    pub fn own_bounds(&self, rep: RepId) -> Beneath {
        let Rep { node, wire, error, .. } = self.reps[rep.index()];
        Beneath::of(self.nodes[node as usize].area, wire, error)
    }

    /// ι of a leaf.
    pub fn importance(&self, node: NodeId) -> f64 {
        self.importance.get(node.index()).map_or(1.0, |&i| f64::from(i))
    }

    /// The representations that the node owns.
    pub fn own(&self, node: NodeId) -> impl DoubleEndedIterator<Item = RepId> + ExactSizeIterator + Clone + use<> {
        (self.nodes[node.index()].first_rep..self.nodes[node.index() + 1].first_rep).map(RepId)
    }

    /// The representations owned by the node and everything beneath it: one interval of ids.
    pub fn beneath(&self, node: NodeId) -> impl DoubleEndedIterator<Item = RepId> + ExactSizeIterator + use<> {
        let Node { first_rep, subtree_end, .. } = self.nodes[node.index()];
        (first_rep..self.nodes[subtree_end as usize].first_rep).map(RepId)
    }

    /// n(r), the node that owns the representation.
    pub fn node_of(&self, rep: RepId) -> NodeId {
        NodeId(self.reps[rep.index()].node)
    }

    /// M_r.
    pub fn wire_bytes(&self, rep: RepId) -> u64 {
        u64::from(self.reps[rep.index()].wire)
    }

    /// m_r.
    pub fn decoded_bytes(&self, rep: RepId) -> u64 {
        u64::from(self.reps[rep.index()].decoded)
    }

    /// g_r, metres.
    pub fn error(&self, rep: RepId) -> f64 {
        f64::from(self.reps[rep.index()].error)
    }

    /// What must be resident before `rep` is of use.
    pub fn prerequisite(&self, rep: RepId) -> Option<RepId> {
        self.rep_prerequisite.get(rep.index()).filter(|&&r| r != NO_REP).map(|&r| RepId(r))
    }

    /// u_r: the direction from which an orthoview looks at its node, as its code ([`Representation::direction`]).
    pub fn direction(&self, rep: RepId) -> Option<u8> {
        self.rep_direction.get(rep.index()).copied().filter(|&d| d != NO_DIRECTION)
    }

    /// True if no representation has a larger error than one at a node above it, and none shows a direction only: then
    /// the nearest node above that shows anything shows it best.
    pub fn errors_fall(&self) -> bool {
        self.errors_fall
    }

    fn find_errors_fall(&self) -> bool {
        // Least error of the node's own representations and those above it, in preorder.
        let mut least = vec![f32::INFINITY; self.nodes()];
        (0..self.nodes()).all(|node| {
            let above = match self.nodes[node].parent {
                u32::MAX => f32::INFINITY,
                parent => least[parent as usize],
            };
            let own = self.nodes[node].first_rep as usize..self.nodes[node + 1].first_rep as usize;
            let own = self.reps[own].iter().map(|rep| rep.error);
            least[node] = own.clone().fold(above, f32::min);
            own.into_iter().all(|error| error <= above)
        })
    }

    /// True if some representation needs another first.
    pub fn has_prerequisites(&self) -> bool {
        !self.rep_prerequisite.is_empty()
    }

    /// True if some representation shows one direction only.
    pub fn has_directions(&self) -> bool {
        !self.rep_direction.is_empty()
    }

    /// The nearest node above `node` that owns a representation: the one whose content `node` and its sibling group
    /// replace under `atomic` refinement.
    pub fn content_parent(&self, node: NodeId) -> Option<NodeId> {
        self.ancestors(node).skip(1).find(|&n| self.own(n).len() > 0)
    }

    /// The sibling group beneath `parent` (`None`: at the top): the nearest nodes below it that own representations.
    /// Under `atomic` refinement they appear together or not at all.
    pub fn sibling_group(&self, parent: Option<NodeId>) -> Vec<NodeId> {
        let (mut next, end) = match parent {
            Some(node) => (node.0 + 1, self.subtree_end(node).0),
            None => (0, self.nodes() as u32),
        };
        let mut group = Vec::new();
        while next < end {
            let node = NodeId(next);
            if self.own(node).len() > 0 {
                group.push(node);
                next = self.nodes[node.index()].subtree_end;
            } else {
                next += 1;
            }
        }
        group
    }

    /// Bytes that the arrays occupy.
    pub fn heap_bytes(&self) -> usize {
        self.nodes() * size_of::<Node>()
            + self.importance.len() * 4
            + self.representations() * size_of::<Rep>()
            + self.rep_prerequisite.len() * 4
            + self.rep_direction.len()
            + self.rep_shown.len() * ELEMENTS
            + self.surface.len() * 4 * ELEMENTS
    }
}

mod surface;
#[cfg(test)]
mod tests;
