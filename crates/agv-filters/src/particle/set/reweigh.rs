//! Weights after an observation.
//!
//! The loops over a chunk are compiled for the instruction set that is found at run time; their sums run in fixed lanes, so
//! that the bits do not depend on it.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::{ParticleSet, ParticleState};
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
        if log_likelihoods.len() != self.count {
            return None;
        }
        let data = (&self.log_weights[..self.count], log_likelihoods);
        let sums_of = |_, (old, new): (&[f64], &[f64])| WeightSums::of(old, new, arch);
        let sums = par.map_reduce_chunks(data, CHUNK, sums_of, WeightSums::with)?;
        self.take_in(log_likelihoods, &sums, par, arch)
    }

    /// Takes log-likelihoods in whose sums are known; the weights stay as they were if that cannot be.
    pub(in crate::particle) fn take_in(
        &mut self,
        log_likelihoods: &[f64],
        &WeightSums { peak, sum, squares, logs }: &WeightSums,
        par: Par,
        arch: Arch,
    ) -> Option<WeightSummary> {
        if !peak.is_finite() {
            return None;
        }
        let (scale, shift) = (1.0 / sum, sum.ln());
        let unit = peak + shift;
        let data = (&mut self.log_weights[..self.count], &mut self.weights[..self.count], log_likelihoods);
        par.for_each_chunk(
            data,
            CHUNK,
            |_, (log_weights, weights, log_likelihoods): (&mut [f64], &mut [f64], &[f64])| {
                arch.dispatch(Weigh { log_weights, weights, log_likelihoods, unit });
            },
        );
        Some(WeightSummary {
            effective_sample_size: sum * sum / squares,
            // -Σ (w / sum) ln (w / sum)
            entropy: (shift - logs * scale).max(0.0),
            max_weight: scale,
            log_evidence: unit,
        })
    }
}

/// Sums over what weights would be after an observation, with the greatest of them as the unit.
#[derive(Debug, Clone, Copy)]
pub(in crate::particle) struct WeightSums {
    /// Logarithm of the unit; infinite if no weight is possible, or one is not a number.
    peak: f64,
    sum: f64,
    squares: f64,
    /// `Σ w ln w`
    logs: f64,
}

impl WeightSums {
    /// Those of a chunk, of old log-weights and log-likelihoods.
    pub(in crate::particle) fn of(old: &[f64], new: &[f64], arch: Arch) -> Self {
        Self::with_weights(old, new, &mut [0.0; CHUNK], arch)
    }

    /// The same, and what the weights would be in the unit of the chunk, which has at most [`CHUNK`] particles.
    pub(super) fn with_weights(old: &[f64], new: &[f64], weights: &mut [f64; CHUNK], arch: Arch) -> Self {
        let peak = arch.dispatch(Peak(old, new));
        if !peak.is_finite() {
            weights.fill(0.0);
            return Self { peak, sum: 0.0, squares: 0.0, logs: 0.0 };
        }
        let weights = &mut weights[..old.len().min(new.len())];
        let [sum, squares, logs] = arch.dispatch(Sums { old, new, weights, peak });
        Self { peak, sum, squares, logs }
    }

    /// Those of two neighbouring parts together.
    pub(in crate::particle) fn with(self, other: Self) -> Self {
        let peak = self.peak.max(other.peak);
        let [a, b] = [self, other].map(|part| part.by(peak));
        Self { peak, sum: a.sum + b.sum, squares: a.squares + b.squares, logs: a.logs + b.logs }
    }

    /// Logarithm of the unit.
    pub(super) const fn peak(&self) -> f64 {
        self.peak
    }

    /// `(Σ w)² / Σ w²`; zero if no weight is possible.
    pub(in crate::particle) fn effective_sample_size(&self) -> f64 {
        if self.peak.is_finite() { self.sum * self.sum / self.squares } else { 0.0 }
    }

    /// What weights in this unit are to be multiplied by in another one, not below it; of impossible ones nothing is left.
    pub(super) fn factor(&self, peak: f64) -> f64 {
        let below = self.peak - peak;
        if below == 0.0 {
            1.0
        } else if below.is_finite() {
            below.exp()
        } else {
            0.0
        }
    }

    /// The same in another unit, not below its own.
    fn by(self, peak: f64) -> Self {
        let (below, factor) = (self.peak - peak, self.factor(peak));
        if below == 0.0 {
            return self;
        }
        let logs = if factor > 0.0 { factor * (self.logs + below * self.sum) } else { 0.0 };
        Self { peak, sum: factor * self.sum, squares: factor * factor * self.squares, logs }
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

/// Takes the log-likelihoods in, in a unit.
struct Weigh<'a> {
    log_weights: &'a mut [f64],
    weights: &'a mut [f64],
    log_likelihoods: &'a [f64],
    unit: f64,
}

impl WithSimd for Weigh<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let weights = self.log_weights.iter_mut().zip(self.weights);
        for ((log_weight, weight), &log_likelihood) in weights.zip(self.log_likelihoods) {
            *log_weight = *log_weight + log_likelihood - self.unit;
            *weight = exp(*log_weight);
        }
    }
}

/// Sums over `(w, w², w ln w)`, of `ln w = old + new - peak`.
struct Sums<'a> {
    old: &'a [f64],
    new: &'a [f64],
    /// Where the weights are written.
    weights: &'a mut [f64],
    peak: f64,
}

/// A weight of this logarithm, and `w ln w`: nothing times -∞ is nothing.
#[inline(always)]
fn with_logarithm(log: f64) -> (f64, f64) {
    let w = exp(log);
    (w, if w > 0.0 { w * log } else { 0.0 })
}

impl WithSimd for Sums<'_> {
    type Output = [f64; 3];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [f64; 3] {
        let (mut sum, mut squares, mut logs) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        let ((old, old_rest), (new, new_rest)) = (self.old.as_chunks::<LANES>(), self.new.as_chunks::<LANES>());
        let (weights, weights_rest) = self.weights.as_chunks_mut::<LANES>();
        for ((old, new), weights) in old.iter().zip(new).zip(weights) {
            let (mut ws, mut ls) = ([0.0; LANES], [0.0; LANES]);
            for lane in 0..LANES {
                (ws[lane], ls[lane]) = with_logarithm(old[lane] + new[lane] - self.peak);
            }
            for lane in 0..LANES {
                sum[lane] += ws[lane];
                squares[lane] += ws[lane] * ws[lane];
                logs[lane] += ls[lane];
            }
            *weights = ws;
        }
        for (lane, ((&old, &new), weight)) in old_rest.iter().zip(new_rest).zip(weights_rest).enumerate() {
            let (w, log) = with_logarithm(old + new - self.peak);
            (*weight, sum[lane]) = (w, sum[lane] + w);
            (squares[lane], logs[lane]) = (squares[lane] + w * w, logs[lane] + log);
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

    /// Peaks of chunks differ by more than a number can tell, and some chunks are impossible.
    #[test]
    fn chunks_of_any_likelihood_add_up() {
        let mut set = line(1024);
        let values: Vec<f64> = (0..1024)
            .map(|i| match i / 256 {
                0 => f64::NEG_INFINITY,
                1 => -2000.0,
                2 => f64::from(i % 7) * 0.1,
                _ => -30.0,
            })
            .collect();
        let summary = set.reweigh(&values, Par::Seq).unwrap();
        let plain: Vec<f64> = values.iter().map(|v| v.exp()).collect();
        let sum: f64 = plain.iter().sum();
        for (weight, plain) in set.weights().iter().zip(&plain) {
            assert!((weight - plain / sum).abs() < 1e-15, "{weight}");
        }
        let entropy: f64 = plain.iter().filter(|w| **w > 0.0).map(|w| -(w / sum) * (w / sum).ln()).sum();
        let effective = plain.iter().map(|w| w / sum * (w / sum)).sum::<f64>().recip();
        assert!((summary.entropy - entropy).abs() < 1e-12 && (summary.effective_sample_size - effective).abs() < 1e-9);
        assert!(
            (summary.log_evidence - (sum / 1024.0).ln()).abs() < 1e-12
                && (summary.max_weight - 0.6_f64.exp() / sum).abs() < 1e-15
        );
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
