//! Weights after an observation.

use super::{ParticleSet, ParticleState, chunk_of};
use crate::particle::WeightSummary;
use agv_core::compute::{CHUNK, Par};

impl<X: ParticleState> ParticleSet<X> {
    /// Multiplies each weight by the exponential of its log-likelihood, and normalises.
    ///
    /// None, with the weights as they were, if the slice has another length than the set, if a log-likelihood is NaN
    /// or +∞, or if every particle is impossible (−∞).
    pub fn reweigh(&mut self, log_likelihoods: &[f64], par: Par) -> Option<WeightSummary> {
        let count = self.count;
        let old = &self.log_weights[..count];
        if log_likelihoods.len() != count {
            return None;
        }
        // NaN must not hide behind the comparison of a maximum: it turns the chunk's peak into +∞, which is refused.
        let peak = par.map_reduce(
            count.div_ceil(CHUNK),
            |chunk| {
                let (old, new) = (chunk_of(old, chunk), chunk_of(log_likelihoods, chunk));
                old.iter().zip(new).fold(f64::NEG_INFINITY, |peak, (&a, &b)| {
                    let sum = a + b;
                    if sum <= peak {
                        peak
                    } else if sum > peak {
                        sum
                    } else {
                        f64::INFINITY
                    }
                })
            },
            f64::max,
        )?;
        if !peak.is_finite() {
            return None;
        }
        let data = (&mut self.log_weights[..count], &mut self.weights[..count], log_likelihoods);
        par.for_each_chunk(
            data,
            CHUNK,
            |_, (log_weights, weights, log_likelihoods): (&mut [f64], &mut [f64], &[f64])| {
                for ((log_weight, weight), &log_likelihood) in log_weights.iter_mut().zip(weights).zip(log_likelihoods)
                {
                    *log_weight = *log_weight + log_likelihood - peak;
                    *weight = log_weight.exp();
                }
            },
        );
        let (weights, log_weights) = (&self.weights[..count], &self.log_weights[..count]);
        let sums = par.map_reduce(
            count.div_ceil(CHUNK),
            |chunk| {
                let pairs = chunk_of(weights, chunk).iter().zip(chunk_of(log_weights, chunk));
                pairs.fold([0.0; 3], |[sum, squares, logs], (&w, &log_w)| {
                    // Nothing times -∞ is nothing.
                    [sum + w, squares + w * w, logs + if w > 0.0 { w * log_w } else { 0.0 }]
                })
            },
            |a, b| [a[0] + b[0], a[1] + b[1], a[2] + b[2]],
        )?;
        let [sum, squares, logs] = sums;
        let (scale, shift) = (1.0 / sum, sum.ln());
        self.weights[..count].iter_mut().for_each(|weight| *weight *= scale);
        self.log_weights[..count].iter_mut().for_each(|log_weight| *log_weight -= shift);
        Some(WeightSummary {
            effective_sample_size: sum * sum / squares,
            // -Σ (w / sum) ln (w / sum)
            entropy: (shift - logs * scale).max(0.0),
            max_weight: scale,
            log_evidence: peak + shift,
        })
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
}
