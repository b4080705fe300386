//! A priority queue whose entries can be found again: for searches that mend keys and take entries back.

const NOWHERE: u32 = u32::MAX;

/// A heap of four children per parent, with the place of each node in it. Operations take logarithmic time; a node has at
/// most one entry, so that there are never more than nodes.
#[derive(Debug, Clone, Default)]
pub(super) struct IndexedHeap {
    /// Key and node.
    entries: Vec<(u64, u32)>,
    /// Where the entry of each node is.
    places: Vec<u32>,
}

impl IndexedHeap {
    const CHILDREN: usize = 4;

    /// Empties the heap; from now on nodes are numbered below `len`.
    pub(super) fn reset(&mut self, len: usize) {
        for (_, node) in self.entries.drain(..) {
            self.places[node as usize] = NOWHERE;
        }
        self.places.resize(len, NOWHERE);
    }

    /// Least key and its node.
    #[inline]
    pub(super) fn first(&self) -> Option<(u64, u32)> {
        self.entries.first().copied()
    }

    /// Gives a node a key, whether it has one or not.
    pub(super) fn set(&mut self, node: u32, key: u64) {
        let Some(&place) = self.places.get(node as usize) else { return };
        let Some(entry) = self.entries.get_mut(place as usize) else {
            self.entries.push((key, node));
            return self.rise(self.entries.len() - 1);
        };
        let before = std::mem::replace(&mut entry.0, key);
        if key < before {
            self.rise(place as usize);
        } else {
            self.sink(place as usize);
        }
    }

    /// Takes a node's entry away, if it has one.
    pub(super) fn remove(&mut self, node: u32) {
        let Some(place) = self.places.get(node as usize).map(|&p| p as usize).filter(|&p| p < self.entries.len())
        else {
            return;
        };
        let (before, _) = self.entries.swap_remove(place);
        self.places[node as usize] = NOWHERE;
        if let Some(&(key, _)) = self.entries.get(place) {
            if key < before {
                self.rise(place);
            } else {
                self.sink(place);
            }
        }
    }

    /// Moves an entry up to where its parent is no greater.
    fn rise(&mut self, mut place: usize) {
        let entry = self.entries[place];
        while place > 0 {
            let parent = (place - 1) / Self::CHILDREN;
            if self.entries[parent] <= entry {
                break;
            }
            self.put(place, self.entries[parent]);
            place = parent;
        }
        self.put(place, entry);
    }

    /// Moves an entry down to where its children are no less.
    fn sink(&mut self, mut place: usize) {
        let entry = self.entries[place];
        loop {
            let first = Self::CHILDREN * place + 1;
            let last = (first + Self::CHILDREN).min(self.entries.len());
            let Some(child) = (first..last).min_by_key(|&child| self.entries[child]) else { break };
            if self.entries[child] >= entry {
                break;
            }
            self.put(place, self.entries[child]);
            place = child;
        }
        self.put(place, entry);
    }

    #[inline]
    fn put(&mut self, place: usize, entry: (u64, u32)) {
        self.entries[place] = entry;
        self.places[entry.1 as usize] = place as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        /// Against a map from nodes to keys.
        #[test]
        fn the_first_is_the_least(steps in proptest::collection::vec((0_u32..40, 0_u64..30, 0_u8..4), 1..300)) {
            let (mut heap, mut map) = (IndexedHeap::default(), BTreeMap::new());
            heap.reset(40);
            for (node, key, what) in steps {
                match what {
                    0 => {
                        heap.remove(node);
                        map.remove(&node);
                    }
                    1 if key == 0 => {
                        heap.reset(40);
                        map.clear();
                    }
                    _ => {
                        heap.set(node, key);
                        map.insert(node, key);
                    }
                }
                let least = map.iter().map(|(&node, &key)| (key, node)).min();
                prop_assert_eq!(heap.first(), least);
            }
        }
    }

    #[test]
    fn nodes_beyond_are_ignored() {
        let mut heap = IndexedHeap::default();
        heap.set(0, 1);
        heap.remove(0);
        heap.reset(2);
        heap.set(2, 1);
        heap.remove(7);
        assert_eq!(heap.first(), None);
    }
}
