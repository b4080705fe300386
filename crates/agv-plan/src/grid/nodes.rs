//! What a search knows of its nodes: the cheapest way to each that was reached so far.

/// Cost of the way to a node, and how the node was reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Known<L> {
    /// Cost of the way to the node.
    pub cost: u32,
    /// How it was reached (see [`SearchSpace::Link`](super::SearchSpace::Link)).
    pub link: L,
}

/// A memory from nodes to what is known of them, emptied with every search.
pub trait NodeStore<L: Copy>: Default {
    /// Forgets all nodes; from now on they are numbered below `len`.
    fn begin(&mut self, len: usize);

    /// What is known of a node, if it was reached.
    fn get(&self, node: u32) -> Option<Known<L>>;

    /// Sets what is known of a node and says whether it has one of the numbers; otherwise nothing changes.
    fn set(&mut self, node: u32, known: Known<L>) -> bool;

    /// As [`set`](Self::set), but only if the node was not reached, or at greater cost; says whether it did.
    fn improve(&mut self, node: u32, known: Known<L>) -> bool;
}

/// A record per node of the space: the store for grids, an array look-up per access.
///
/// Records are stamped with the number of the search, so that to begin anew costs nothing. Nothing is allocated once it has
/// seen the largest space.
#[derive(Debug, Clone)]
pub struct DenseNodes<L> {
    records: Vec<Record<L>>,
    len: usize,
    generation: u16,
}

/// Valid if its generation is the search's.
#[derive(Debug, Clone, Copy, Default)]
struct Record<L> {
    cost: u32,
    generation: u16,
    link: L,
}

impl<L> Default for DenseNodes<L> {
    fn default() -> Self {
        Self { records: Vec::new(), len: 0, generation: 0 }
    }
}

impl<L: Copy + Default> NodeStore<L> for DenseNodes<L> {
    fn begin(&mut self, len: usize) {
        if self.records.len() < len {
            self.records.resize(len, Record::default());
        }
        self.len = len;
        self.generation = self.generation.wrapping_add(1);
        if self.generation == 0 {
            // Once in 65 535 searches the stamps start anew.
            self.records.fill(Record::default());
            self.generation = 1;
        }
    }

    #[inline]
    fn get(&self, node: u32) -> Option<Known<L>> {
        let record = self.records.get(node as usize).filter(|r| r.generation == self.generation)?;
        Some(Known { cost: record.cost, link: record.link })
    }

    #[inline]
    fn set(&mut self, node: u32, known: Known<L>) -> bool {
        let generation = self.generation;
        let slot = self.records.get_mut(node as usize).filter(|_| (node as usize) < self.len);
        slot.is_some_and(|slot| {
            *slot = Record { cost: known.cost, generation, link: known.link };
            true
        })
    }

    #[inline]
    fn improve(&mut self, node: u32, known: Known<L>) -> bool {
        let generation = self.generation;
        // The records may outnumber this space's nodes, if an earlier one was larger; its own steps stay within it.
        let Some(slot) = self.records.get_mut(node as usize) else { return false };
        if slot.generation == generation && slot.cost <= known.cost {
            return false;
        }
        *slot = Record { cost: known.cost, generation, link: known.link };
        true
    }
}

/// A record per node that was reached: for spaces of which a search sees little, as a lattice of (x, y, heading) or a graph
/// without a bound.
///
/// A hash table with linear probing and a fixed hash: nothing depends on the order of its entries. Memory doubles when it is
/// two thirds full and is kept. Several times slower per access than [`DenseNodes`].
#[derive(Debug, Clone)]
pub struct SparseNodes<L> {
    /// A power of two of them, or none.
    slots: Vec<SparseSlot<L>>,
    reached: usize,
    len: usize,
    generation: u32,
}

/// Taken if its generation is the search's.
#[derive(Debug, Clone, Copy, Default)]
struct SparseSlot<L> {
    node: u32,
    cost: u32,
    generation: u32,
    link: L,
}

impl<L> Default for SparseNodes<L> {
    fn default() -> Self {
        Self { slots: Vec::new(), reached: 0, len: 0, generation: 0 }
    }
}

impl<L: Copy + Default> SparseNodes<L> {
    /// Nodes that were reached.
    pub const fn reached(&self) -> usize {
        self.reached
    }

    /// Place of a node: where it is, or the free slot where it would be. There is always a free one; none before the first.
    #[inline]
    fn place(&self, node: u32) -> usize {
        let last = self.slots.len().wrapping_sub(1);
        // Fibonacci hashing: the high bits of a product with 2^64 / golden ratio, neighbours far apart.
        let hash = u64::from(node).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let mut place = (hash >> 32) as usize & last;
        while self.slots.get(place).is_some_and(|s| s.generation == self.generation && s.node != node) {
            place = (place + 1) & last;
        }
        place
    }

    /// Makes room for one more.
    fn grow_if_crowded(&mut self) {
        if 3 * (self.reached + 1) <= 2 * self.slots.len() {
            return;
        }
        let larger = vec![SparseSlot::default(); (2 * self.slots.len()).max(64)];
        let old = std::mem::replace(&mut self.slots, larger);
        for slot in old.into_iter().filter(|slot| slot.generation == self.generation) {
            let place = self.place(slot.node);
            self.slots[place] = slot;
        }
    }
}

impl<L: Copy + Default> NodeStore<L> for SparseNodes<L> {
    fn begin(&mut self, len: usize) {
        self.len = len;
        self.reached = 0;
        self.generation = self.generation.wrapping_add(1);
        if self.generation == 0 {
            self.slots.fill(SparseSlot::default());
            self.generation = 1;
        }
    }

    #[inline]
    fn get(&self, node: u32) -> Option<Known<L>> {
        let slot = self.slots.get(self.place(node)).filter(|s| s.generation == self.generation)?;
        Some(Known { cost: slot.cost, link: slot.link })
    }

    fn set(&mut self, node: u32, known: Known<L>) -> bool {
        if node as usize >= self.len || self.generation == 0 {
            return false;
        }
        self.grow_if_crowded();
        let place = self.place(node);
        self.reached += usize::from(self.slots[place].generation != self.generation);
        self.slots[place] = SparseSlot { node, cost: known.cost, generation: self.generation, link: known.link };
        true
    }

    #[inline]
    fn improve(&mut self, node: u32, known: Known<L>) -> bool {
        self.get(node).is_none_or(|before| known.cost < before.cost) && self.set(node, known)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        /// Both stores are maps with a rule, forgetful at each beginning.
        #[test]
        fn stores_are_maps(
            rounds in proptest::collection::vec(
                proptest::collection::vec((0_u32..400, 0_u32..50, any::<bool>()), 0..300), 1..4),
        ) {
            let (mut dense, mut sparse) = (DenseNodes::<u8>::default(), SparseNodes::<u8>::default());
            for (len, round) in [300_usize, 350, 120].into_iter().zip(rounds) {
                dense.begin(len);
                sparse.begin(len);
                let mut map: BTreeMap<u32, Known<u8>> = BTreeMap::new();
                for (number, (node, cost, force)) in round.into_iter().enumerate() {
                    let node = if force { node } else { node % len as u32 };
                    let known = Known { cost, link: number as u8 };
                    let want = (node as usize) < len && (force || map.get(&node).is_none_or(|k| cost < k.cost));
                    let got = if force {
                        (dense.set(node, known), sparse.set(node, known))
                    } else {
                        (dense.improve(node, known), sparse.improve(node, known))
                    };
                    prop_assert_eq!(got, (want, want));
                    if want {
                        map.insert(node, known);
                    }
                }
                for node in 0..450 {
                    prop_assert_eq!(dense.get(node), map.get(&node).copied());
                    prop_assert_eq!(sparse.get(node), map.get(&node).copied());
                }
                prop_assert_eq!(sparse.reached(), map.len());
            }
        }
    }

    #[test]
    fn stores_that_were_not_begun_are_empty() {
        let known = Known { cost: 1, link: 0_u8 };
        assert_eq!((DenseNodes::<u8>::default().get(0), SparseNodes::<u8>::default().get(0)), (None, None));
        assert!(!DenseNodes::default().set(0, known) && !SparseNodes::default().set(0, known));
        assert!(!SparseNodes::default().improve(0, known));
    }
}
