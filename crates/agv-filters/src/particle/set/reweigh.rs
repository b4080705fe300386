//! Weights after an observation.
//!
//! The loops over a chunk are compiled for the instruction set that is found at run time; their sums run in fixed lanes, so
//! that the bits do not depend on it.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::{ParticleSet, ParticleState, chunk_of};
use crate::particle::{WeightSummary, exp::exp};
use agv_core::compute::{CHUNK, Par};
use pulp::{Arch, Simd, WithSimd};

/// Sums that run side by side.
const LANES: usize = 8;

impl<X: ParticleState> ParticleSet<X> {
    /// Multiplies each weight by the exponential of its log-likelihood, and normalises.
    ///
    /// None, with the weights as they were, if the slice has another length than the set, if a log-likelihood is NaN
    /// or +∞, or if every particle is impossible (−∞).
    pub fn reweigh(&mut self, log_likelihoods: &[f64], par: Par) -> Option<WeightSummary> {
        self.reweigh_on(log_likelihoods, par, Arch::new())
    }

    fn reweigh_on(&mut self, log_likelihoods: &[f64], par: Par, arch: Arch) -> Option<WeightSummary> {
        let count = self.count;
        let old = &self.log_weights[..count];
        if log_likelihoods.len() != count {
            return None;
        }
        let chunks = count.div_ceil(CHUNK);
        let peak_of = |chunk| arch.dispatch(Peak(chunk_of(old, chunk), chunk_of(log_likelihoods, chunk)));
        let peak = par.map_reduce(chunks, peak_of, f64::max)?;
        if !peak.is_finite() {
            return None;
        }
        let data = (&mut self.log_weights[..count], &mut self.weights[..count], log_likelihoods);
        par.for_each_chunk(
            data,
            CHUNK,
            |_, (log_weights, weights, log_likelihoods): (&mut [f64], &mut [f64], &[f64])| {
                arch.dispatch(Weigh { log_weights, weights, log_likelihoods, peak });
            },
        );
        let (weights, log_weights) = (&self.weights[..count], &self.log_weights[..count]);
        let sums_of = |chunk| arch.dispatch(Sums(chunk_of(weights, chunk), chunk_of(log_weights, chunk)));
        let sums = par.map_reduce(chunks, sums_of, |a, b| std::array::from_fn(|i| a[i] + b[i]))?;
        let [sum, squares, logs] = sums;
        let (scale, shift) = (1.0 / sum, sum.ln());
        let data = (&mut self.log_weights[..count], &mut self.weights[..count]);
        par.for_each_chunk(data, CHUNK, |_, (log_weights, weights): (&mut [f64], &mut [f64])| {
            for (log_weight, weight) in log_weights.iter_mut().zip(weights) {
                *log_weight -= shift;
                *weight *= scale;
            }
        });
        Some(WeightSummary {
            effective_sample_size: sum * sum / squares,
            // -Σ (w / sum) ln (w / sum)
            entropy: (shift - logs * scale).max(0.0),
            max_weight: scale,
            log_evidence: peak + shift,
        })
    }
}

/// The greatest sum of an old logarithm and a new one; +∞ if one is not a number, which must not hide behind the
/// comparison of a maximum.
struct Peak<'a>(&'a [f64], &'a [f64]);

impl WithSimd for Peak<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> f64 {
        let greater = |peak: f64, sum: f64| {
            if sum <= peak {
                peak
            } else if sum > peak {
                sum
            } else {
                f64::INFINITY
            }
        };
        let mut peaks = [f64::NEG_INFINITY; LANES];
        let ((old, old_rest), (new, new_rest)) = (self.0.as_chunks::<LANES>(), self.1.as_chunks::<LANES>());
        for (old, new) in old.iter().zip(new) {
            for lane in 0..LANES {
                peaks[lane] = greater(peaks[lane], old[lane] + new[lane]);
            }
        }
        for ((peak, old), new) in peaks.iter_mut().zip(old_rest).zip(new_rest) {
            *peak = greater(*peak, old + new);
        }
        peaks.into_iter().fold(f64::NEG_INFINITY, f64::max)
    }
}

/// Takes the log-likelihoods in, with the greatest sum as the unit.
struct Weigh<'a> {
    log_weights: &'a mut [f64],
    weights: &'a mut [f64],
    log_likelihoods: &'a [f64],
    peak: f64,
}

impl WithSimd for Weigh<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let weights = self.log_weights.iter_mut().zip(self.weights);
        for ((log_weight, weight), &log_likelihood) in weights.zip(self.log_likelihoods) {
            *log_weight = *log_weight + log_likelihood - self.peak;
            *weight = exp(*log_weight);
        }
    }
}

/// Sums over `(w, w², w ln w)`, of weights and their logarithms.
struct Sums<'a>(&'a [f64], &'a [f64]);

impl WithSimd for Sums<'_> {
    type Output = [f64; 3];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [f64; 3] {
        let (mut sum, mut squares, mut logs) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        let ((weights, rest), (log_weights, log_rest)) = (self.0.as_chunks::<LANES>(), self.1.as_chunks::<LANES>());
        let mut add = |lane: usize, w: f64, log_w: f64| {
            sum[lane] += w;
            squares[lane] += w * w;
            // Nothing times -∞ is nothing.
            logs[lane] += if w > 0.0 { w * log_w } else { 0.0 };
        };
        for (w, log_w) in weights.iter().zip(log_weights) {
            for lane in 0..LANES {
                add(lane, w[lane], log_w[lane]);
            }
        }
        for (lane, (&w, &log_w)) in rest.iter().zip(log_rest).enumerate() {
            add(lane, w, log_w);
        }
        [sum, squares, logs].map(|[a, b, c, d, e, f, g, h]| ((a + b) + (c + d)) + ((e + f) + (g + h)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::geometry::Se2;

    fn line(count: usize) -> ParticleSet {
        ParticleSet::new((0..count).map(|i| Se2::new(i as f64, 0.0, 0.0)).collect()).unwrap()
    }

    #[test]
    fn likelihoods_far_below_the_smallest_number_still_order_the_particles() {
        let mut set = line(3);
        let summary = set.reweigh(&[-9000.0, -9000.0 + 2_f64.ln(), -9000.0], Par::Seq).unwrap();
        assert!((set.weights()[1] - 0.5).abs() < 1e-12);
        assert!((summary.max_weight - 0.5).abs() < 1e-12);
        assert!((summary.log_evidence - (-9000.0 + (4.0_f64 / 3.0).ln())).abs() < 1e-9);
    }

    #[test]
    fn what_cannot_be_a_likelihood_changes_nothing() {
        let mut set = line(600);
        set.reweigh(&(0..600).map(|i| f64::from(i) * 0.01).collect::<Vec<_>>(), Par::Seq).unwrap();
        let before = set.clone();
        let mut with = |index: usize, value: f64| {
            let mut values = vec![0.0; 600];
            values[index] = value;
            set.reweigh(&values, Par::Seq)
        };
        assert_eq!(with(3, f64::NAN), None);
        assert_eq!(with(599, f64::NAN), None);
        assert_eq!(with(300, f64::INFINITY), None);
        assert_eq!(set.reweigh(&vec![f64::NEG_INFINITY; 600], Par::Seq), None);
        assert_eq!(set.reweigh(&[0.0], Par::Seq), None);
        assert_eq!(set, before);
    }

    #[test]
    fn the_entropy_is_that_of_the_weights() {
        let mut set = line(3);
        let summary = set.reweigh(&[0.0, 2_f64.ln(), f64::NEG_INFINITY], Par::Seq).unwrap();
        let expected = -(1.0 / 3.0 * (1.0_f64 / 3.0).ln() + 2.0 / 3.0 * (2.0_f64 / 3.0).ln());
        assert!((summary.entropy - expected).abs() < 1e-12);
        assert!((WeightSummary::uniform(3).entropy - 3_f64.ln()).abs() < 1e-12);
    }
    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        let log_likelihoods: Vec<f64> = (0..999).map(|i| -(f64::from(i * 7919 % 999) * 0.013).powi(3)).collect();
        let mut expected = line(999);
        let summary = expected.reweigh(&log_likelihoods, Par::Seq);
        for arch in crate::particle::simd::archs() {
            let mut set = line(999);
            assert_eq!(set.reweigh_on(&log_likelihoods, Par::Seq, arch), summary, "{arch:?}");
            assert!(set == expected, "{arch:?}");
        }
        assert!((expected.weights().iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }
}
