//! Subtrees into pages of bounded size, from the leaves up.
//!
//! What does not fit with its parent becomes a page of its own, the largest child first (Kundu and Misra, "A linear tree
//! partitioning algorithm", 1977). Pages depend on the subtree alone, and not on the order of building.

use super::page::{Child, Node, PAGE_MAX, PageReference, encode, hash};
use crate::octree::{Cell, Octree};

/// Moves children of `node` into pages of their own until it fits into one. `write` takes a page's cell and bytes.
///
/// # Errors
/// Those of `write`.
pub fn pack<E>(
    node: &mut Node,
    octree: &Octree,
    elements: u8,
    write: &mut impl FnMut(Cell, &[u8]) -> Result<(), E>,
) -> Result<(), E> {
    const HEADER: usize = 32;
    let mut size = HEADER + node.size();
    while size > PAGE_MAX {
        let inline = node.children.iter_mut().filter(|child| matches!(child, Child::Node(_)));
        // Of equals the last, so that the choice is one.
        let Some(largest) = inline.max_by_key(|child| child.size()) else { break };
        size -= largest.size();
        *largest = page_of(largest, octree, elements, write)?;
        size += largest.size();
    }
    Ok(())
}

/// A page for a subtree, as its parent names it. What is a page stays one.
///
/// # Errors
/// Those of `write`.
pub fn page_of<E>(
    child: &Child,
    octree: &Octree,
    elements: u8,
    write: &mut impl FnMut(Cell, &[u8]) -> Result<(), E>,
) -> Result<Child, E> {
    let Child::Node(node) = child else { return Ok(child.clone()) };
    let bytes = encode(node, octree, elements);
    write(node.cell, &bytes)?;
    let reference = PageReference { hash: hash(&bytes), bytes: bytes.len() as u32, summary: node.summary() };
    Ok(Child::Page(node.cell, reference))
}
