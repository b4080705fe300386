//! Open lists for integer keys.

use std::{cmp::Reverse, collections::BinaryHeap};

/// An entry of an open list: a node and the cost it had when it was queued.
///
/// Entries are not updated in place; one whose cost is no longer its node's is stale and is skipped when it comes up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Entry {
    /// Node of the search space.
    pub node: u32,
    /// Cost of the way to it.
    pub cost: u32,
}

/// A priority queue of [`Entry`]s. A [`BucketQueue`] relies on keys that do not fall: none is pushed below the last one
/// popped. Best-first search with a consistent heuristic keeps that promise.
pub trait OpenList: Default {
    /// Empties the list for a search whose keys lie at most `window` above the last key popped, of about `capacity`
    /// entries. Memory is kept.
    fn reset(&mut self, window: u32, capacity: usize);

    /// Adds an entry.
    fn push(&mut self, key: u32, entry: Entry);

    /// Removes an entry with the least key; of equal keys, the one that leads deepest or came last.
    fn pop(&mut self) -> Option<(u32, Entry)>;

    /// Least key that is waiting.
    fn least_key(&self) -> Option<u32>;
}

const NONE: u32 = u32::MAX;

/// A bucket per key modulo a power of two: push and pop take constant time (Dial 1969).
///
/// Buckets are linked lists through one pool of slots, last in first out; two levels of bits find the next bucket that
/// holds something. Keys beyond the window wait in a binary heap. A key below the last one popped is moved up to it, so
/// that a heuristic that breaks its promise costs optimality and nothing worse.
#[derive(Debug, Clone, Default)]
pub struct BucketQueue {
    slots: Vec<Slot>,
    heads: Vec<u32>,
    /// A bit per bucket that holds something.
    occupied: Vec<u64>,
    /// A bit per word of `occupied` that is not zero.
    summary: Vec<u64>,
    free: u32,
    /// Least key that may come up next.
    cursor: u32,
    /// Whether a key was popped: the window begins at the first of them.
    started: bool,
    /// Entries whose keys lay beyond the window when they came.
    beyond: HeapQueue,
}

#[derive(Debug, Clone, Copy)]
struct Slot {
    entry: Entry,
    next: u32,
}

impl BucketQueue {
    /// Widest window of keys that have buckets.
    pub const MAX_WINDOW: u32 = (1 << 20) - 1;

    /// First bucket at or after `bucket`, going round, that holds something.
    #[inline]
    fn next_occupied(&self, bucket: usize) -> Option<usize> {
        let word = bucket / 64;
        let rest = self.occupied[word] & (u64::MAX << (bucket % 64));
        if rest != 0 {
            return Some(word * 64 + rest.trailing_zeros() as usize);
        }
        let next = self.next_word(word + 1).or_else(|| self.next_word(0))?;
        Some(next * 64 + self.occupied[next].trailing_zeros() as usize)
    }

    /// First word of `occupied` from `word` on that is not zero.
    #[inline]
    fn next_word(&self, word: usize) -> Option<usize> {
        let first = word / 64;
        let mut mask = u64::MAX << (word % 64);
        for (index, bits) in self.summary.iter().enumerate().skip(first) {
            if bits & mask != 0 {
                return Some(index * 64 + (bits & mask).trailing_zeros() as usize);
            }
            mask = u64::MAX;
        }
        None
    }
}

impl OpenList for BucketQueue {
    fn reset(&mut self, window: u32, capacity: usize) {
        let buckets = (window.min(Self::MAX_WINDOW) as usize + 1).next_power_of_two().max(64);
        if self.heads.len() == buckets {
            // Whatever an earlier search left: only its buckets need a wipe.
            for (word, bits) in self.occupied.iter_mut().enumerate() {
                while *bits != 0 {
                    self.heads[word * 64 + bits.trailing_zeros() as usize] = NONE;
                    *bits &= *bits - 1;
                }
            }
            self.summary.fill(0);
        } else {
            self.heads = vec![NONE; buckets];
            self.occupied = vec![0; buckets / 64];
            self.summary = vec![0; buckets.div_ceil(64 * 64)];
        }
        self.slots.clear();
        self.slots.reserve(capacity);
        self.free = NONE;
        self.cursor = 0;
        self.started = false;
        self.beyond.reset(0, 0);
    }

    #[inline]
    fn push(&mut self, key: u32, entry: Entry) {
        if !self.started {
            // Where a search begins its keys may lie anywhere: the least of them is known when it is asked for.
            return self.beyond.push(key, entry);
        }
        let buckets = self.heads.len();
        let ahead = key.saturating_sub(self.cursor) as usize;
        if ahead >= buckets {
            return self.beyond.push(key, entry);
        }
        let bucket = (self.cursor as usize).wrapping_add(ahead) & (buckets - 1);
        let slot = Slot { entry, next: self.heads[bucket] };
        let index = self.free;
        if let Some(reused) = self.slots.get_mut(index as usize) {
            self.free = reused.next;
            *reused = slot;
            self.heads[bucket] = index;
        } else {
            self.heads[bucket] = self.slots.len() as u32;
            self.slots.push(slot);
        }
        self.occupied[bucket / 64] |= 1 << (bucket % 64);
        self.summary[bucket / 4096] |= 1 << (bucket / 64 % 64);
    }

    #[inline]
    fn pop(&mut self) -> Option<(u32, Entry)> {
        let buckets = self.heads.len();
        let from = self.cursor as usize & buckets.wrapping_sub(1);
        if buckets == 0 {
            return self.beyond.pop();
        }
        let bucket = if self.heads[from] == NONE { self.next_occupied(from) } else { Some(from) };
        let ahead = bucket.map(|bucket| (bucket.wrapping_sub(from) & (buckets - 1)) as u32);
        if let Some(key) = self.beyond.least_key()
            && ahead.is_none_or(|ahead| key <= self.cursor + ahead)
        {
            // No bucket holds a lesser key, so all of them stay within the window of this one.
            self.cursor = key;
            self.started = true;
            return self.beyond.pop();
        }
        let bucket = bucket?;
        self.cursor += ahead?;
        let index = self.heads[bucket];
        let Slot { entry, next } = self.slots[index as usize];
        self.heads[bucket] = next;
        self.slots[index as usize].next = self.free;
        self.free = index;
        if next == NONE {
            self.occupied[bucket / 64] &= !(1 << (bucket % 64));
            if self.occupied[bucket / 64] == 0 {
                self.summary[bucket / 4096] &= !(1 << (bucket / 64 % 64));
            }
        }
        Some((self.cursor, entry))
    }

    #[inline]
    fn least_key(&self) -> Option<u32> {
        let buckets = self.heads.len();
        let from = self.cursor as usize & buckets.wrapping_sub(1);
        let bucket = if buckets == 0 { None } else { self.next_occupied(from) };
        let within = bucket.map(|bucket| self.cursor + (bucket.wrapping_sub(from) & (buckets - 1)) as u32);
        within.into_iter().chain(self.beyond.least_key()).min()
    }
}

/// The standard library's binary heap: for keys without a bound on their window, or that fall.
///
/// Several times slower than [`BucketQueue`], of logarithmic time per operation. Of equal keys the one of greatest cost
/// comes first, which lies nearest the goal.
#[derive(Debug, Clone, Default)]
pub struct HeapQueue {
    heap: BinaryHeap<(Reverse<u32>, u32, u32)>,
}

impl OpenList for HeapQueue {
    fn reset(&mut self, _window: u32, capacity: usize) {
        self.heap.clear();
        self.heap.reserve(capacity);
    }

    #[inline]
    fn push(&mut self, key: u32, entry: Entry) {
        self.heap.push((Reverse(key), entry.cost, entry.node));
    }

    #[inline]
    fn pop(&mut self) -> Option<(u32, Entry)> {
        self.heap.pop().map(|(Reverse(key), cost, node)| (key, Entry { node, cost }))
    }

    #[inline]
    fn least_key(&self) -> Option<u32> {
        self.heap.peek().map(|(Reverse(key), ..)| *key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Any sequence of pushes, inside the window and beyond it, and pops gives the keys in the order that sorting gives, and every
        /// entry comes back once; a reset in between leaves nothing behind.
        #[test]
        fn both_queues_pop_keys_in_order(
            steps in proptest::collection::vec((any::<bool>(), 0_u32..5000), 1..300),
            first in 0_u32..1_000_000,
            window in 64_u32..6000,
        ) {
            let (mut buckets, mut heap) = (BucketQueue::default(), HeapQueue::default());
            for round in 0..2 {
                buckets.reset(window, 0);
                heap.reset(window, 0);
                let (mut open, mut last): (Vec<u32>, u32) = (Vec::new(), first);
                for (node, (push, ahead)) in (0_u32..).zip(steps.iter().copied().chain([(false, 0); 40])) {
                    if push || node == 0 {
                        let key = if node == 0 { first } else { last + ahead };
                        buckets.push(key, Entry { node, cost: key });
                        heap.push(key, Entry { node, cost: key });
                        open.push(key);
                    } else {
                        open.sort_unstable();
                        let least = (!open.is_empty()).then(|| open.remove(0));
                        prop_assert_eq!((buckets.least_key(), heap.least_key()), (least, least));
                        let (a, b) = (buckets.pop(), heap.pop());
                        prop_assert_eq!(a.map(|(key, _)| key), least);
                        prop_assert_eq!(b.map(|(key, _)| key), least);
                        // The cost tells that the entry is the one that was pushed with this key.
                        prop_assert_eq!(a.map(|(_, entry)| entry.cost), least);
                        last = least.unwrap_or(last);
                        if round == 0 && node > 100 {
                            break;
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn the_first_keys_may_come_in_any_order() {
        let (mut queue, keys) = (BucketQueue::default(), [5000, 70, 1_000_000, 3, 71]);
        queue.reset(100, 4);
        for key in keys {
            queue.push(key, Entry { node: key, cost: 0 });
        }
        let mut popped = std::iter::from_fn(|| queue.pop().map(|(key, entry)| (key, entry.node)));
        assert!([3, 70, 71, 5000, 1_000_000].into_iter().all(|key| popped.next() == Some((key, key))));
    }

    #[test]
    fn keys_below_the_last_one_come_next() {
        let mut queue = BucketQueue::default();
        queue.reset(63, 4);
        queue.push(100, Entry { node: 0, cost: 0 });
        assert_eq!(queue.pop().map(|(key, _)| key), Some(100));
        queue.push(10, Entry { node: 1, cost: 0 });
        queue.push(u32::MAX, Entry { node: 2, cost: 0 });
        assert_eq!(queue.pop().map(|(key, e)| (key, e.node)), Some((100, 1)));
        assert_eq!(queue.pop().map(|(key, e)| (key, e.node)), Some((u32::MAX, 2)));
        assert_eq!(queue.pop(), None);
    }
}
