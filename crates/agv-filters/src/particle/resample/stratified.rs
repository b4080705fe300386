//! Stratified resampling: one draw per stratum.

use super::{Resampler, inverse::assign};
use agv_core::compute::Stream;
use rand::RngExt;

/// Stratified resampling: the new particle `i` is drawn from the `i`-th of `n` equal parts of the cumulative weight
/// (Kitagawa 1996).
///
/// Its variance is never above that of [`Multinomial`](super::Multinomial), and unlike [`Systematic`](super::Systematic)
/// resampling it is known to converge for any order of the particles (Douc, Cappé and Moulines 2005); a particle gets
/// `⌊n w⌋ - 1` to `⌈n w⌉ + 1` copies. O(n), one draw per particle.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_filters::particle::{Resampler, Stratified};
///
/// let mut ancestors = [0; 4];
/// Stratified.resample(&[0.5, 0.0, 0.25, 0.25], &mut Seed(1).stream(0, 0), &mut ancestors);
/// assert_eq!(ancestors, [0, 0, 2, 3]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Stratified;

impl Resampler for Stratified {
    fn resample(&self, weights: &[f64], stream: &mut Stream, ancestors: &mut [u32]) {
        let width = weights.iter().sum::<f64>() / ancestors.len().max(1) as f64;
        let mut stratum = 0.0;
        assign(weights, ancestors, || {
            let point = (stratum + stream.random::<f64>()) * width;
            stratum += 1.0;
            point
        });
    }
}
