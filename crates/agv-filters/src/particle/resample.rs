//! Drawing a new set in proportion to the weights.

mod inverse;
mod multinomial;
mod residual;
mod stratified;

use agv_core::compute::Stream;
use rand::RngExt;

pub use multinomial::Multinomial;
pub use residual::Residual;
pub use stratified::Stratified;

/// Chooses which particles live on.
pub trait Resampler {
    /// Fills `ancestors` with indices into `weights`, in increasing order, so that each index is expected to appear
    /// `ancestors.len()` times its weight.
    ///
    /// `weights` are normalised up to rounding; an index of weight zero never appears. The two lengths may differ:
    /// adaptive filters change the number of particles here.
    fn resample(&self, weights: &[f64], stream: &mut Stream, ancestors: &mut [u32]);
}

/// Systematic (low-variance) resampling: one draw `u` in [0, 1), and the new particle `i` is the old one whose share of
/// the cumulative weight holds `(i + u) / n` (Thrun, Burgard and Fox, *Probabilistic Robotics*, Table 4.4).
///
/// A particle of weight `w` gets `⌊n w⌋` or `⌈n w⌉` copies. O(n), without branches that depend on the weights.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_filters::particle::{Resampler, Systematic};
///
/// let mut ancestors = [0; 4];
/// Systematic.resample(&[0.5, 0.0, 0.25, 0.25], &mut Seed(1).stream(0, 0), &mut ancestors);
/// assert_eq!(ancestors, [0, 0, 2, 3]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Systematic;

impl<R: Resampler + ?Sized> Resampler for Box<R> {
    fn resample(&self, weights: &[f64], stream: &mut Stream, ancestors: &mut [u32]) {
        (**self).resample(weights, stream, ancestors);
    }
}

impl Resampler for Systematic {
    fn resample(&self, weights: &[f64], stream: &mut Stream, ancestors: &mut [u32]) {
        let (count, offset) = (ancestors.len() as f64, stream.random::<f64>());
        // The sum of the same additions as below: the last share then ends at `count` exactly.
        let total = weights.iter().fold(0.0, |sum, weight| sum + weight);
        let scale = count / total;
        ancestors.fill(0);
        // Particle j spans the new particles from `start` (the end of its predecessor) up to its own end. It writes its
        // index at `start`; if it spans none, its successor overwrites it. Entries not written copy the one before.
        let (mut start, mut cumulative) = (0, 0.0);
        for (index, weight) in weights.iter().enumerate() {
            cumulative += weight;
            let end = if cumulative >= total {
                ancestors.len()
            } else {
                (cumulative * scale - offset).ceil().max(0.0) as usize
            };
            if start < ancestors.len() && end > start {
                ancestors[start] = index as u32;
                start = end;
            }
        }
        ancestors.iter_mut().fold(0, |last, ancestor| {
            *ancestor = last.max(*ancestor);
            *ancestor
        });
    }
}
