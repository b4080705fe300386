//! Multinomial resampling: independent draws.

use super::{Resampler, inverse::assign};
use agv_core::compute::Stream;
use rand_distr::{Distribution, Exp1};

/// Multinomial resampling: every new particle is an independent draw from the old ones (Gordon, Salmond and Smith 1993).
///
/// The number of copies of a particle of weight `w` has the variance `n w (1 - w)`, the most of all resamplers here: for
/// comparisons, and where independence is what a proof needs. O(n): the draws come sorted, as sums of exponential spacings
/// (Rényi 1953):
///
/// ```text
/// u_(k) = 1 - exp(-Σ_{j <= k} E_j / (n - j + 1))          E_j ~ Exp(1)
/// ```
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_filters::particle::{Multinomial, Resampler};
///
/// let mut ancestors = [0; 6];
/// Multinomial.resample(&[0.5, 0.0, 0.5], &mut Seed(1).stream(0, 0), &mut ancestors);
/// assert!(ancestors.is_sorted() && !ancestors.contains(&1));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Multinomial;

impl Resampler for Multinomial {
    fn resample(&self, weights: &[f64], stream: &mut Stream, ancestors: &mut [u32]) {
        let total: f64 = weights.iter().sum();
        let mut points = SortedUniforms::new(ancestors.len());
        assign(weights, ancestors, || total * points.next(stream));
    }
}

/// Independent uniform numbers in [0, 1), drawn in increasing order without being kept.
pub(super) struct SortedUniforms {
    left: f64,
    sum: f64,
}

impl SortedUniforms {
    pub(super) fn new(count: usize) -> Self {
        Self { left: count as f64, sum: 0.0 }
    }

    /// The next of them; to be asked no more often than there are.
    pub(super) fn next(&mut self, stream: &mut Stream) -> f64 {
        let spacing: f64 = Exp1.sample(stream);
        self.sum += spacing / self.left;
        self.left = (self.left - 1.0).max(1.0);
        -(-self.sum).exp_m1()
    }
}
