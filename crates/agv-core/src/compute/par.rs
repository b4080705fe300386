//! Parallelism as a value, in two shapes: for each chunk, and an ordered reduction over chunks.
//!
//! Both cut their work in halves down to fixed chunks, and both combine in the order of that tree. The tree depends on
//! the number of entries alone, so the bits of a result are the same for any number of threads, and without the
//! `rayon` feature. (Measured: rayon's own `sum` gave three bit patterns in twenty runs.)

use super::Split;
use std::num::NonZeroUsize;

/// How many threads a loop may use.
///
/// The threads are those of the rayon pool that the call runs in; this crate starts none. Without the `rayon` feature
/// every loop runs on the calling thread, with the same bits out.
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
    /// On at most this many threads of the surrounding rayon pool.
    Threads(NonZeroUsize),
}

impl Par {
    /// At most `count` threads; zero and one are [`Par::Seq`].
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

    /// Calls `body(index, chunk)` for consecutive chunks of `chunk_len` entries (the last may be shorter).
    ///
    /// A `chunk_len` of zero reads as one. Allocates nothing on [`Par::Seq`] or inside a rayon pool.
    pub fn for_each_chunk<S: Split>(self, data: S, chunk_len: usize, body: impl Fn(usize, S) + Sync) {
        let chunk_len = chunk_len.max(1);
        let chunks = data.len().div_ceil(chunk_len);
        if chunks > 0 {
            for_each_span(data, 0, chunks, chunk_len, self.count(), &body);
        }
    }

    /// Maps the indices `0..count` and combines the results in a tree of fixed shape; `None` if `count` is zero.
    ///
    /// `combine(a, b)` always gets neighbouring parts in order, so it need be neither commutative nor associative.
    pub fn map_reduce<A: Send>(
        self,
        count: usize,
        map: impl Fn(usize) -> A + Sync,
        combine: impl Fn(A, A) -> A + Sync,
    ) -> Option<A> {
        (count > 0).then(|| reduce_span(0, count, self.count(), &map, &combine))
    }
}

fn for_each_span<S: Split>(
    data: S,
    first: usize,
    chunks: usize,
    chunk_len: usize,
    threads: usize,
    body: &(impl Fn(usize, S) + Sync),
) {
    if chunks == 1 {
        return body(first, data);
    }
    let half = chunks / 2;
    let (left, right) = data.split_at(half * chunk_len);
    let (left_threads, right_threads) = (threads / 2, threads - threads / 2);
    join(
        threads,
        || for_each_span(left, first, half, chunk_len, left_threads.max(1), body),
        || for_each_span(right, first + half, chunks - half, chunk_len, right_threads, body),
    );
}

fn reduce_span<A: Send>(
    first: usize,
    count: usize,
    threads: usize,
    map: &(impl Fn(usize) -> A + Sync),
    combine: &(impl Fn(A, A) -> A + Sync),
) -> A {
    if count == 1 {
        return map(first);
    }
    let half = count / 2;
    let (left_threads, right_threads) = (threads / 2, threads - threads / 2);
    let (left, right) = join(
        threads,
        || reduce_span(first, half, left_threads.max(1), map, combine),
        || reduce_span(first + half, count - half, right_threads, map, combine),
    );
    combine(left, right)
}

#[cfg(feature = "rayon")]
fn join<A: Send, B: Send>(threads: usize, a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B + Send) -> (A, B) {
    if threads > 1 { rayon::join(a, b) } else { (a(), b()) }
}

#[cfg(not(feature = "rayon"))]
fn join<A, B>(_threads: usize, a: impl FnOnce() -> A, b: impl FnOnce() -> B) -> (A, B) {
    (a(), b())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

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

        /// Floating-point sums have the same bits for any number of threads.
        #[test]
        fn reductions_do_not_depend_on_threads(values in prop::collection::vec(-1e6..1e6_f64, 0..600)) {
            let sum = |threads| Par::threads(threads).map_reduce(values.len(), |i| values[i], |a, b| a + b);
            let reference = sum(1).map(f64::to_bits);
            for threads in [2, 3, 4, 64] {
                prop_assert_eq!(sum(threads).map(f64::to_bits), reference);
            }
        }

        /// The parts are combined in order, so that a combine that does not commute is served.
        #[test]
        fn combines_in_order(len in 1_usize..300, threads in 1_usize..9) {
            let joined = Par::threads(threads).map_reduce(len, |i| vec![i], |mut a, b| { a.extend(b); a });
            prop_assert_eq!(joined, Some((0..len).collect::<Vec<_>>()));
        }
    }
}
