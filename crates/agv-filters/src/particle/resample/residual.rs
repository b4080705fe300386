//! Residual resampling: whole copies first, draws for the rest.

use super::{Resampler, multinomial::SortedUniforms};
use agv_core::compute::Stream;

/// Residual resampling: a particle of weight `w` gets `⌊n w⌋` copies, and the new particles that are left over are
/// independent draws from what is left of the weights (Liu and Chen 1998).
///
/// Its variance is never above that of [`Multinomial`](super::Multinomial). O(n); draws only for the rest.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_filters::particle::{Residual, Resampler};
///
/// let mut ancestors = [0; 5];
/// Residual.resample(&[0.4, 0.0, 0.6], &mut Seed(1).stream(0, 0), &mut ancestors);
/// assert_eq!(ancestors, [0, 0, 2, 2, 2]);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Residual;

/// Copies that are due for certain, and the share of one more. What misses a whole number by rounding is one: three times a
/// third must not leave a particle to chance.
fn whole_and_rest(expected: f64) -> (usize, f64) {
    let whole = (expected + 1e-9).floor();
    (whole as usize, (expected - whole).max(0.0))
}

impl Resampler for Residual {
    fn resample(&self, weights: &[f64], stream: &mut Stream, ancestors: &mut [u32]) {
        let Some(last) = weights.iter().rposition(|&weight| weight > 0.0) else { return ancestors.fill(0) };
        let scale = ancestors.len() as f64 / weights.iter().sum::<f64>();
        let (certain, rest) = weights.iter().fold((0, 0.0), |(certain, rest), weight| {
            let (whole, part) = whole_and_rest(weight * scale);
            (certain + whole, rest + part)
        });
        let mut to_draw = ancestors.len().saturating_sub(certain);
        let mut points = SortedUniforms::new(to_draw);
        let mut point = if to_draw > 0 { points.next(stream) * rest } else { f64::INFINITY };
        let (mut slots, mut end) = (ancestors.iter_mut(), 0.0);
        for (index, weight) in weights.iter().enumerate().take(last + 1) {
            let (whole, part) = whole_and_rest(weight * scale);
            end += part;
            slots.by_ref().take(whole).for_each(|slot| *slot = index as u32);
            while to_draw > 0 && (point < end || index == last) {
                slots.by_ref().take(1).for_each(|slot| *slot = index as u32);
                to_draw -= 1;
                point = if to_draw > 0 { points.next(stream) * rest } else { f64::INFINITY };
            }
        }
    }
}
