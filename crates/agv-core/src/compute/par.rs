//! Parallelism as a value, in two shapes: for each chunk, and an ordered reduction over chunks.
//!
//! Chunks are fixed by the number of entries, and a reduction combines them in a tree that halves their number: both
//! know nothing of threads, so the bits of a result are the same for any number of them, and without the `rayon`
//! feature. (Measured: rayon's own `sum` gave three bit patterns in twenty runs.)

use super::Split;
use std::num::NonZeroUsize;

/// How many threads a loop may use.
///
/// The threads are those of the rayon pool that the call runs in. A call from outside of any pool runs in rayon's
/// global one, which rayon starts when it is first used; [`Par::Seq`] touches neither. Without the `rayon` feature every
/// loop runs on the calling thread, with the same bits out.
///
/// ```
/// use agv_core::compute::Par;
///
/// let mut squares: Vec<f64> = (0..10_000).map(f64::from).collect();
/// Par::threads(2).for_each_chunk(squares.as_mut_slice(), 256, |_, chunk| chunk.iter_mut().for_each(|v| *v *= *v));
///
/// let sum = |par: Par| par.map_reduce(40, |c| squares[c * 250..(c + 1) * 250].iter().sum::<f64>(), |a, b| a + b);
/// assert_eq!(sum(Par::Seq), sum(Par::threads(2)));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Par {
    /// On the calling thread.
    #[default]
    Seq,
    /// Cut for this many threads of the surrounding rayon pool; a hard limit is the size of the pool.
    Threads(NonZeroUsize),
}

impl Par {
    /// Work cut for `count` threads; zero and one are [`Par::Seq`].
    pub const fn threads(count: usize) -> Self {
        match NonZeroUsize::new(count) {
            Some(threads) if count > 1 => Self::Threads(threads),
            _ => Self::Seq,
        }
    }

    /// The number of threads, at least one.
    pub const fn count(self) -> usize {
        match self {
            Self::Seq => 1,
            Self::Threads(threads) => threads.get(),
        }
    }

    /// Into how many parts a loop is cut.
    const fn shares(self) -> usize {
        match self {
            Self::Seq => 1,
            Self::Threads(threads) => threads.get().saturating_mul(SHARES),
        }
    }

    /// Calls `body(index, chunk)` for consecutive chunks of `chunk_len` entries (the last may be shorter).
    ///
    /// Every thread gets sixteen even shares of the chunks (fewer if there are not as many), so that one that wakes up late, or is
    /// interrupted, leaves work to the others. A pool that is larger than asked for may lend more of its threads. A `chunk_len`
    /// of zero reads as one. Allocates nothing itself; rayon's queues may grow, and a call from outside of a pool passes
    /// through one that does from time to time.
    pub fn for_each_chunk<S: Split>(self, data: S, chunk_len: usize, body: impl Fn(usize, S) + Sync) {
        let chunk_len = chunk_len.max(1);
        let chunks = data.len().div_ceil(chunk_len);
        if chunks > 0 {
            for_each_span(data, 0, chunks, chunk_len, self.shares().min(chunks), &body);
        }
    }

    /// Maps the indices `0..count` and combines the results in a tree of fixed shape; `None` if `count` is zero.
    ///
    /// `combine(a, b)` always gets neighbouring parts in order, so it need be neither commutative nor associative.
    ///
    /// The tree is cut into sixteen to thirty-two pieces a thread, for the pool to spread; allocates as
    /// [`for_each_chunk`](Self::for_each_chunk) does.
    pub fn map_reduce<A: Send>(
        self,
        count: usize,
        map: impl Fn(usize) -> A + Sync,
        combine: impl Fn(A, A) -> A + Sync,
    ) -> Option<A> {
        (count > 0).then(|| reduce_span(0, count, pieces(self.count().min(count)), &map, &combine))
    }

    /// Maps consecutive chunks of `chunk_len` entries (the last may be shorter), which `map(index, chunk)` may change, and combines
    /// the results as [`map_reduce`](Self::map_reduce) does; `None` if there are no entries.
    ///
    /// A loop and the sums over what it wrote in one go: threads meet once instead of twice. A `chunk_len` of zero reads as one.
    ///
    /// ```
    /// use agv_core::compute::Par;
    ///
    /// let mut values = [3.0, 1.0, 2.0];
    /// let halve = |_, chunk: &mut [f64]| chunk.iter_mut().map(|v| { *v *= 0.5; *v }).sum::<f64>();
    /// assert_eq!(Par::threads(2).map_reduce_chunks(&mut values[..], 2, halve, |a, b| a + b), Some(3.0));
    /// assert_eq!(values, [1.5, 0.5, 1.0]);
    /// ```
    pub fn map_reduce_chunks<S: Split, A: Send>(
        self,
        data: S,
        chunk_len: usize,
        map: impl Fn(usize, S) -> A + Sync,
        combine: impl Fn(A, A) -> A + Sync,
    ) -> Option<A> {
        let chunk_len = chunk_len.max(1);
        let chunks = data.len().div_ceil(chunk_len);
        let pieces = pieces(self.count().min(chunks.max(1)));
        (chunks > 0).then(|| reduce_chunks(data, 0, chunks, chunk_len, pieces, &map, &combine))
    }
}

/// Parts of a loop for each thread. (Measured on updates of particle filters on two threads of a virtual machine, where a thread that
/// sleeps wakes up after some 20 µs. With one part for each the other waits for it; with four of them 50 000 particles are 1.85
/// times as fast as on one thread, with sixteen 1.9 times: what is left at the end of a loop is shared out as well.)
const SHARES: usize = 16;

/// Chunks and shares of the left part, in proportion. No share is larger than an even one rounded up, since
/// `⌈⌈c r / t⌉ / r⌉ = ⌈c / t⌉`; and none is empty, if there are as many chunks as shares.
fn cut(chunks: usize, shares: usize) -> (usize, usize) {
    let left_shares = shares / 2;
    (chunks.saturating_mul(left_shares) / shares, left_shares)
}

/// Into how many subtrees, a power of two, a reduction is cut.
fn pieces(threads: usize) -> usize {
    // No machine has more; the bound keeps absurd counts from overflowing.
    let threads = threads.min(1 << 16);
    if threads < 2 { 1 } else { SHARES * threads.next_power_of_two() }
}

fn for_each_span<S: Split>(
    data: S,
    first: usize,
    chunks: usize,
    chunk_len: usize,
    shares: usize,
    body: &(impl Fn(usize, S) + Sync),
) {
    if shares < 2 {
        let mut rest = data;
        for index in first..first + chunks - 1 {
            let (chunk, behind) = rest.split_at(chunk_len);
            body(index, chunk);
            rest = behind;
        }
        return body(first + chunks - 1, rest);
    }
    let (left_chunks, left_shares) = cut(chunks, shares);
    let (left, right) = data.split_at(left_chunks * chunk_len);
    join(
        true,
        || for_each_span(left, first, left_chunks, chunk_len, left_shares, body),
        || for_each_span(right, first + left_chunks, chunks - left_chunks, chunk_len, shares - left_shares, body),
    );
}

fn reduce_span<A: Send>(
    first: usize,
    count: usize,
    pieces: usize,
    map: &(impl Fn(usize) -> A + Sync),
    combine: &(impl Fn(A, A) -> A + Sync),
) -> A {
    if count == 1 {
        return map(first);
    }
    let half = count / 2;
    let (left, right) = join(
        pieces > 1,
        || reduce_span(first, half, pieces / 2, map, combine),
        || reduce_span(first + half, count - half, pieces / 2, map, combine),
    );
    combine(left, right)
}

/// As [`reduce_span`], in the same tree.
fn reduce_chunks<S: Split, A: Send>(
    data: S,
    first: usize,
    chunks: usize,
    chunk_len: usize,
    pieces: usize,
    map: &(impl Fn(usize, S) -> A + Sync),
    combine: &(impl Fn(A, A) -> A + Sync),
) -> A {
    if chunks == 1 {
        return map(first, data);
    }
    let half = chunks / 2;
    let (left, right) = data.split_at(half * chunk_len);
    let (left, right) = join(
        pieces > 1,
        || reduce_chunks(left, first, half, chunk_len, pieces / 2, map, combine),
        || reduce_chunks(right, first + half, chunks - half, chunk_len, pieces / 2, map, combine),
    );
    combine(left, right)
}

#[cfg(feature = "rayon")]
fn join<A: Send, B: Send>(parallel: bool, a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B + Send) -> (A, B) {
    if parallel { rayon::join(a, b) } else { (a(), b()) }
}

#[cfg(not(feature = "rayon"))]
fn join<A, B>(_parallel: bool, a: impl FnOnce() -> A, b: impl FnOnce() -> B) -> (A, B) {
    (a(), b())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn reductions_are_cut_finely_enough_for_any_number_of_threads() {
        for (threads, expected) in [(1, 1), (2, 32), (3, 64), (4, 64), (5, 128), (8, 128), (usize::MAX, 1 << 20)] {
            assert_eq!(pieces(threads), expected);
        }
    }

    #[test]
    fn absurd_numbers_of_threads_are_threads() {
        let par = Par::threads(usize::MAX);
        assert_eq!(par.map_reduce(1000, |i| i, |a, b| a + b), Some(499_500));
        let mut ones = [0; 1000];
        par.for_each_chunk(&mut ones[..], 7, |_, chunk| chunk.iter_mut().for_each(|v| *v += 1));
        assert_eq!(ones, [1; 1000]);
    }

    proptest! {
        /// Each entry is visited once, by the chunk that its index says, for any number of threads.
        #[test]
        fn chunks_cover_the_data_once(len in 0_usize..3000, chunk_len in 0_usize..700, threads in 0_usize..9) {
            let mut seen = vec![usize::MAX; len];
            let offsets: Vec<usize> = (0..len).collect();
            Par::threads(threads).for_each_chunk((seen.as_mut_slice(), offsets.as_slice()), chunk_len, |index, (seen, offsets)| {
                for (slot, &offset) in seen.iter_mut().zip(offsets) {
                    *slot = index * chunk_len.max(1) + (offset - offsets[0]);
                }
            });
            prop_assert_eq!(seen, offsets);
        }

        /// The shares are as even as whole chunks allow, for three threads as for four.
        #[test]
        fn every_thread_gets_its_share(chunks in 1_usize..2000, threads in 1_usize..70) {
            fn shares(chunks: usize, threads: usize, out: &mut Vec<usize>) {
                if threads < 2 {
                    return out.push(chunks);
                }
                let (left_chunks, left_threads) = cut(chunks, threads);
                shares(left_chunks, left_threads, out);
                shares(chunks - left_chunks, threads - left_threads, out);
            }
            let (threads, mut out) = (threads.min(chunks), Vec::new());
            shares(chunks, threads, &mut out);
            prop_assert_eq!((out.len(), out.iter().sum::<usize>()), (threads, chunks));
            prop_assert!(out.iter().all(|&share| (1..=chunks.div_ceil(threads)).contains(&share)));
        }

        /// Floating-point sums have the same bits for any number of threads.
        #[test]
        fn reductions_do_not_depend_on_threads(values in prop::collection::vec(-1e6..1e6_f64, 0..600)) {
            let sum = |threads| Par::threads(threads).map_reduce(values.len(), |i| values[i], |a, b| a + b);
            let reference = sum(1).map(f64::to_bits);
            for threads in [2, 3, 4, 5, 6, 64] {
                prop_assert_eq!(sum(threads).map(f64::to_bits), reference);
            }
        }

        /// Chunks that are changed are those of the plain loop, and their results are combined in the plain reduction's tree.
        #[test]
        fn chunks_are_mapped_and_reduced_at_once(mut values in prop::collection::vec(-1e6..1e6_f64, 0..2000), chunk_len in 0_usize..300, threads in 1_usize..9) {
            let len = chunk_len.max(1);
            let chunks: Vec<f64> = values.chunks(len).map(|chunk| chunk.iter().sum()).collect();
            let expected = Par::Seq.map_reduce(chunks.len(), |i| chunks[i], |a, b| a + b);
            let negated: Vec<f64> = values.iter().map(|v| -v).collect();
            let sum = Par::threads(threads).map_reduce_chunks(values.as_mut_slice(), chunk_len, |index, chunk: &mut [f64]| {
                let sum: f64 = chunk.iter().sum();
                for value in chunk.iter_mut() {
                    *value = -*value;
                }
                assert_eq!(sum.to_bits(), chunks[index].to_bits());
                sum
            }, |a, b| a + b);
            prop_assert_eq!(sum.map(f64::to_bits), expected.map(f64::to_bits));
            prop_assert_eq!(values, negated);
        }

        /// The parts are combined in order, so that a combine that does not commute is served.
        #[test]
        fn combines_in_order(len in 1_usize..300, threads in 1_usize..9) {
            let joined = Par::threads(threads).map_reduce(len, |i| vec![i], |mut a, b| { a.extend(b); a });
            prop_assert_eq!(joined, Some((0..len).collect::<Vec<_>>()));
        }
    }
}
