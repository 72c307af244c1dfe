//! Where each representation is fetched from: one address per representation, stored so that a million instanced
//! tiles share their strings.

use std::borrow::Cow;
use std::collections::BTreeMap;

use foresight_scheduler::lod_tree::RepId;

/// One address per representation, in the order of their ids: a shared prefix (a folder) and a shared tail (a file).
/// 8 bytes per representation besides the distinct strings.
#[derive(Clone, Debug, Default)]
pub struct UriTable {
    arena: String,
    ends: Vec<usize>,
    of: Vec<(u32, u32)>,
}

impl UriTable {
    /// The address of a representation, relative to the world's folder. Empty for an id that the table does not hold.
    pub fn get(&self, rep: RepId) -> Cow<'_, str> {
        let Some(&(prefix, tail)) = self.of.get(rep.index()) else {
            return Cow::Borrowed("");
        };
        match (self.text(prefix), self.text(tail)) {
            ("", tail) => Cow::Borrowed(tail),
            (prefix, tail) => Cow::Owned([prefix, tail].concat()),
        }
    }

    /// Number of addresses.
    pub fn len(&self) -> usize {
        self.of.len()
    }

    /// True without any address.
    pub fn is_empty(&self) -> bool {
        self.of.is_empty()
    }

    /// Bytes that the arrays occupy.
    pub fn heap_bytes(&self) -> usize {
        self.arena.len() + self.ends.len() * size_of::<usize>() + self.of.len() * 8
    }

    /// Prefix and tail of each address in turn, for hashing without joining them.
    pub(crate) fn parts(&self) -> impl Iterator<Item = (&str, &str)> {
        self.of.iter().map(|&(prefix, tail)| (self.text(prefix), self.text(tail)))
    }

    fn text(&self, id: u32) -> &str {
        let index = id as usize;
        let start = if index == 0 { 0 } else { self.ends[index - 1] };
        &self.arena[start..self.ends[index]]
    }
}

/// Fills a [`UriTable`], keeping each distinct string once.
#[derive(Debug, Default)]
pub struct UriTableBuilder {
    table: UriTable,
    known: BTreeMap<String, u32>,
}

impl UriTableBuilder {
    /// The id of a string, stored at its first appearance.
    pub fn intern(&mut self, text: &str) -> u32 {
        if let Some(&id) = self.known.get(text) {
            return id;
        }
        let id = self.table.ends.len() as u32;
        self.table.arena.push_str(text);
        self.table.ends.push(self.table.arena.len());
        self.known.insert(text.to_owned(), id);
        id
    }

    /// Gives the next representation its address: two ids that [`UriTableBuilder::intern`] of this builder returned.
    pub fn push(&mut self, prefix: u32, tail: u32) {
        self.table.of.push((prefix, tail));
    }

    /// The finished table.
    pub fn finish(self) -> UriTable {
        self.table
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strings_are_shared_and_joined() {
        let mut builder = UriTableBuilder::default();
        let (none, cell, file) = (builder.intern(""), builder.intern("cells/0_1/"), builder.intern("a.glb"));
        builder.push(none, file);
        builder.push(cell, file);
        assert_eq!(builder.intern("a.glb"), file);
        let table = builder.finish();
        assert_eq!((table.get(RepId(0)), table.get(RepId(1))), ("a.glb".into(), "cells/0_1/a.glb".into()));
        assert_eq!(table.get(RepId(2)), "");
        assert_eq!(table.arena.len(), "cells/0_1/a.glb".len());
    }
}
