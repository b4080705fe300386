//! Systematic resampling, choice and copies in one pass over the new particles.
//!
//! What comes before a chunk of the new set is known from the sums of the old weights, one for each chunk, so that no thread waits
//! for the chunk before, and what an old chunk gives is copied while it is in the cache.

use super::{ParticleSet, ParticleState, chunk_of};
use crate::particle::resample::{Comb, possible, sum};
use agv_core::compute::{CHUNK, Par};

/// New states, where each came from, and its weight with its logarithm.
type New<'a, X> = (&'a mut [X], &'a mut [u32], (&'a mut [f64], &'a mut [f64]));

impl<X: ParticleState> ParticleSet<X> {
    /// Draws `count` new particles (at least one, at most the capacity) by equally spaced points, as
    /// [`Systematic`](crate::particle::Systematic) does to the bit.
    pub(super) fn resample_by_comb(&mut self, count: usize, offset: f64, par: Par) -> &[u32] {
        let (states, weights) = (&self.states[..self.count], possible(&self.weights[..self.count]));
        let (sums, mut total) = (&mut self.sums, 0.0);
        sums.clear();
        sums.extend(weights.chunks(CHUNK).map(|chunk| {
            let before = total;
            total += sum(chunk);
            before
        }));
        let (sums, comb) = (&sums[..], Comb::new(count, total, offset));
        let weight = (count as f64).recip();
        let log_weight = weight.ln();
        let new_weights = (&mut self.spare_weights[..count], &mut self.log_weights[..count]);
        let data = (&mut self.spare[..count], &mut self.ancestors[..count], new_weights);
        par.for_each_chunk(data, CHUNK, |chunk, (new, ancestors, (weights_of_new, logs_of_new)): New<'_, X>| {
            let first = (chunk * CHUNK) as u32;
            let end = first + ancestors.len() as u32;
            // The last chunk that begins at or before the first point, and those after it that begin before the end.
            let begin = sums.partition_point(|&before| comb.below(before) <= first).saturating_sub(1);
            let mut part = comb.part(first, ancestors);
            for (chunk, &before) in (begin..).zip(&sums[begin.min(sums.len())..]) {
                if comb.below(before) >= end {
                    break;
                }
                part.take((chunk * CHUNK) as u32, before, chunk_of(weights, chunk));
            }
            for (new, &ancestor) in new.iter_mut().zip(part.filled()) {
                *new = states[ancestor as usize];
            }
            weights_of_new.fill(weight);
            logs_of_new.fill(log_weight);
        });
        self.adopt();
        std::mem::swap(&mut self.weights, &mut self.spare_weights);
        self.count = count;
        &self.ancestors[..count]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particle::{Resampler, Systematic};
    use agv_core::{compute::Seed, geometry::Se2};
    use proptest::prelude::*;

    /// Weights of all kinds: many of them zero, a few that hold nearly all.
    fn weights(count: usize) -> impl Strategy<Value = Vec<f64>> {
        let weight = prop_oneof![Just(f64::NEG_INFINITY), -3.0..0.0_f64, -80.0..0.0_f64];
        prop::collection::vec(weight, 1..count)
    }

    proptest! {
        /// The plain draw from the whole list of weights, for any number of threads and of new particles.
        #[test]
        fn parts_are_those_of_the_whole(logs in weights(2000), count in 1_usize..1500, threads in 1_usize..5, seed in 0_u64..1000) {
            let states = (0..logs.len()).map(|i| Se2::new(i as f64, 0.0, 0.0)).collect();
            let mut set = ParticleSet::new(states).unwrap().with_capacity(1500).unwrap();
            prop_assume!(set.reweigh(&logs, Par::Seq).is_some());
            let (old, mut expected) = (set.weights().to_vec(), vec![0; count]);
            Systematic.resample(&old, &mut Seed(seed).stream(0, 0), &mut expected);
            let ancestors = set.resample(count, &Systematic, &mut Seed(seed).stream(0, 0), Par::threads(threads)).to_vec();
            prop_assert_eq!(&ancestors, &expected);
            prop_assert!(ancestors.is_sorted() && ancestors.iter().all(|&ancestor| old[ancestor as usize] > 0.0));
            prop_assert!(set.states().iter().zip(&ancestors).all(|(state, &ancestor)| state.x() == f64::from(ancestor)));
            let equal = (count as f64).recip();
            prop_assert!(set.len() == count && set.weights().iter().all(|&weight| weight == equal));
            prop_assert!(set.log_weights().iter().all(|&log| log == equal.ln()));
        }
    }

    /// A particle of weight `w` gets `⌊n w⌋` or `⌈n w⌉` copies, wherever the chunks end.
    #[test]
    fn copies_are_in_proportion_to_the_weights() {
        let logs: Vec<f64> = (0..1000).map(|i| f64::from(i % 17) * 0.3).collect();
        let mut set = ParticleSet::new(vec![Se2::default(); 1000]).unwrap();
        set.reweigh(&logs, Par::Seq).unwrap();
        let old = set.weights().to_vec();
        let mut copies = vec![0.0; 1000];
        for &ancestor in set.resample(1000, &Systematic, &mut Seed(4).stream(0, 0), Par::threads(2)) {
            copies[ancestor as usize] += 1.0;
        }
        for (weight, copies) in old.iter().zip(copies) {
            let expected = 1000.0 * weight;
            assert!((expected - copies).abs() < 1.0 + 1e-9, "{expected} {copies}");
        }
    }
}
