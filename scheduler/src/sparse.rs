//! Maps and sets by id that take memory for what is in them only: a session stands beside a world that is far larger.
//!
//! Ids are hashed by one multiplication. The order of the tables reaches no caller: what is iterated is sorted.

use crate::lod_tree::RepId;
use rustc_hash::FxBuildHasher;

/// A table by the number of a node or representation.
pub(crate) type IdMap<V> = hashbrown::HashMap<u32, V, FxBuildHasher>;

/// A set of representations, kept in words of 32 neighbouring ids: what is resident lies together.
#[derive(Clone, Debug, Default)]
pub(crate) struct RepSet {
    words: IdMap<u32>,
}

impl RepSet {
    /// Whether `rep` is a member.
    pub(crate) fn contains(&self, rep: RepId) -> bool {
        self.words.get(&(rep.0 / 32)).is_some_and(|bits| bits >> (rep.0 % 32) & 1 != 0)
    }

    /// Adds `rep`; false if it was there.
    pub(crate) fn insert(&mut self, rep: RepId) -> bool {
        let (bits, bit) = (self.words.entry(rep.0 / 32).or_default(), 1 << (rep.0 % 32));
        let fresh = *bits & bit == 0;
        *bits |= bit;
        fresh
    }

    /// Takes `rep` out; false if it was not there.
    pub(crate) fn remove(&mut self, rep: RepId) -> bool {
        let (word, bit) = (rep.0 / 32, 1 << (rep.0 % 32));
        let Some(bits) = self.words.get_mut(&word).filter(|bits| **bits & bit != 0) else { return false };
        *bits &= !bit;
        if *bits == 0 {
            self.words.remove(&word);
        }
        true
    }

    /// The members in order of id, after sorting the words.
    pub(crate) fn iter(&self) -> impl Iterator<Item = RepId> + use<> {
        let mut words: Vec<(u32, u32)> = self.words.iter().map(|(&word, &bits)| (word, bits)).collect();
        words.sort_unstable();
        words.into_iter().flat_map(|(word, bits)| {
            let bits = core::iter::successors(Some(bits), |b| Some(b & (b - 1)).filter(|b| *b != 0));
            bits.map(move |b| RepId(word * 32 + b.trailing_zeros()))
        })
    }

    /// Bytes that the set occupies.
    pub(crate) fn heap_bytes(&self) -> usize {
        self.words.allocation_size()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn members_come_in_order_and_go() {
        let mut set = RepSet::default();
        let ids = [70, 3, 0, 31, 32, u32::MAX - 2, 64];
        assert!(ids.iter().all(|&id| set.insert(RepId(id))) && !set.insert(RepId(31)));
        let ordered = [0, 3, 31, 32, 64, 70, u32::MAX - 2].map(RepId);
        assert!(set.iter().eq(ordered));
        assert!(set.contains(RepId(32)) && !set.contains(RepId(33)) && !set.contains(RepId(5000)));
        assert!(!set.remove(RepId(33)) && ids.iter().all(|&id| set.remove(RepId(id))));
        assert_eq!((set.iter().count(), set.words.len()), (0, 0));
    }
}
