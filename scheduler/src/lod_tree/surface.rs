//! Surfaces by orientation, of leaves and summed upwards, and how well orthoviews show them.

use super::{LodTree, LodTreeBuilder, LodTreeError, NO_DIRECTION, NodeId, RepId};
use crate::benefit::element::{ELEMENTS, Shown, unhidden};

impl LodTreeBuilder {
    /// How the surface of the node opened last is spread over orientations, μ by element
    /// ([`crate::benefit::element::normals`]); made to sum to 1. It counts for a leaf, and only where the tree has
    /// directions. A leaf that does not tell has the six faces of its content box.
    pub fn surface(&mut self, shares: [f32; ELEMENTS]) -> Result<(), LodTreeError> {
        let node = *self.open.last().ok_or(LodTreeError::Nesting("a surface outside every node"))?;
        if let Some(&share) = shares.iter().find(|share| !(share.is_finite() && **share >= 0.0)) {
            return Err(LodTreeError::Surface { node, share });
        }
        let most = shares.iter().copied().fold(0.0, f32::max);
        if most == 0.0 {
            return Err(LodTreeError::Surface { node, share: 0.0 });
        }
        // Scaled first, so that the sum is finite.
        let scaled = shares.map(|share| share / most);
        let sum: f32 = scaled.iter().sum();
        self.shares = Some((node, scaled.map(|share| share / sum)));
        Ok(())
    }

    /// How well the orthoview added last shows each element, what stands behind something else counted. One that does not
    /// tell hides nothing ([`unhidden`]).
    pub fn shown(&mut self, shown: Shown) -> Result<(), LodTreeError> {
        match self.tree.rep_direction.last() {
            Some(&direction) if direction != NO_DIRECTION => {
                let rep = self.tree.reps.len() as u32 - 1;
                self.shown.pop_if(|(of, _)| *of == rep);
                self.shown.push((rep, shown));
                Ok(())
            }
            _ => Err(LodTreeError::Nesting("what an orthoview shows was told of none")),
        }
    }
}

impl LodTree {
    /// S_n by element, m²: Σ over the leaves beneath of ι × the surface of the content box × μ_s. A box's own faces where
    /// the leaf told nothing, so that Σ max(0, n_s·u) S_s is then its area projected along u.
    pub fn surface(&self, node: NodeId) -> [f64; ELEMENTS] {
        match self.surface.get(node.index()) {
            Some(areas) => {
                let mut wide = [0.0; ELEMENTS];
                for (wide, area) in wide.iter_mut().zip(areas) {
                    *wide = f64::from(*area);
                }
                wide
            }
            None => faces_of_box(self.nodes[node.index()].area),
        }
    }

    /// How well a representation shows each element; `None` if the world does not tell, so that nothing hides anything.
    pub fn shown(&self, rep: RepId) -> Option<&Shown> {
        self.rep_shown.get(rep.index())
    }

    /// What each representation shows, from the orthoviews that tell, in ascending order.
    pub(super) fn spread_shown(&self, told: &[(u32, Shown)]) -> Vec<Shown> {
        let mut told = told.iter().peekable();
        let of = |rep: u32| match told.next_if(|(of, _)| *of == rep) {
            Some((_, shown)) => *shown,
            None => unhidden(self.direction(RepId(rep))),
        };
        (0..self.representations() as u32).map(of).collect()
    }

    /// S_n by element from the leaves that tell theirs, in ascending order, and the boxes of the others.
    pub(super) fn sum_surfaces(&self, told: &[(u32, [f32; ELEMENTS])]) -> Vec<[f32; ELEMENTS]> {
        let mut sums = vec![[0.0f64; ELEMENTS]; self.nodes()];
        let mut told = told.iter().peekable();
        for (node, sum) in sums.iter_mut().enumerate() {
            if self.nodes[node].subtree_end as usize == node + 1 {
                let faces = faces_of_box(self.nodes[node].area);
                *sum = match told.next_if(|(of, _)| *of as usize == node) {
                    Some((_, shares)) => {
                        let whole: f64 = faces.iter().sum();
                        shares.map(|share| whole * f64::from(share))
                    }
                    None => faces,
                };
            }
        }
        for node in (1..self.nodes()).rev() {
            let (above, below) = sums.split_at_mut(node);
            for (sum, area) in above[self.nodes[node].parent as usize].iter_mut().zip(below[0]) {
                *sum += area;
            }
        }
        sums.into_iter().map(|areas| areas.map(|area| area as f32)).collect()
    }
}

/// The faces of a box by element, m², from the areas across each axis; no corner has any.
fn faces_of_box(areas: [f32; 3]) -> [f64; ELEMENTS] {
    let mut faces = [0.0; ELEMENTS];
    for (axis, area) in areas.into_iter().enumerate() {
        faces[2 * axis] = f64::from(area);
        faces[2 * axis + 1] = f64::from(area);
    }
    faces
}
