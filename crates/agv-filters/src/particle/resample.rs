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
        let (count, offset) = (ancestors.len(), stream.random::<f64>());
        ancestors.fill(0);
        let Some(last) = weights.iter().rposition(|&weight| weight > 0.0) else { return };
        let weights = &weights[..=last];
        let scale = count as f64 / sum(weights);
        // Particle j spans the new particles from its start (the end of its predecessor) up to its own end. It writes its index
        // at its start; if it spans none, its successor overwrites it. Entries not written copy the one before. What
        // rounding leaves at the end is the last one's.
        let (mut total, mut start) = (0.0, 0);
        for (first, weights) in (0_u32..).step_by(BLOCK).zip(weights.chunks(BLOCK)) {
            let mut ends = [0.0; BLOCK];
            total = running_sums(total, weights, &mut ends);
            let ends = ends.map(|end| ceiling(end * scale - offset));
            for (index, &end) in (first..).zip(&ends[..weights.len()]) {
                if let Some(ancestor) = ancestors.get_mut(start as usize) {
                    *ancestor = index;
                }
                start = end;
            }
        }
        running_maxima(ancestors);
    }
}

/// Particles whose ends are computed together.
const BLOCK: usize = 64;

/// The sum, in eight lanes.
fn sum(values: &[f64]) -> f64 {
    let (eights, rest) = values.as_chunks::<8>();
    let mut lanes = [0.0; 8];
    for eight in eights {
        lanes.iter_mut().zip(eight).for_each(|(lane, value)| *lane += value);
    }
    lanes.iter().chain(rest).fold(0.0, |sum, value| sum + value)
}

/// Writes the sums up to and with each value, which never fall from one to the next; returns the last.
fn running_sums(mut sum: f64, values: &[f64], sums: &mut [f64; BLOCK]) -> f64 {
    // Four at a time, so that only every fourth addition waits for the one before.
    let (fours, rest) = values.as_chunks::<4>();
    let (sums_of_fours, _) = sums.as_chunks_mut::<4>();
    for (&[a, b, c, d], sums) in fours.iter().zip(sums_of_fours) {
        let ab = a + b;
        *sums = [sum + a, sum + ab, sum + (ab + c), sum + (ab + (c + d))];
        sum = sums[3];
    }
    for (value, out) in rest.iter().zip(&mut sums[fours.len() * 4..]) {
        sum += value;
        *out = sum;
    }
    sum
}

/// Replaces each number by the greatest up to it.
fn running_maxima(values: &mut [u32]) {
    // Four at a time, as above.
    let (fours, rest) = values.as_chunks_mut::<4>();
    let mut greatest = 0;
    for four in fours {
        let [a, b, c, d] = *four;
        let (ab, cd) = (a.max(b), c.max(d));
        *four = [greatest.max(a), greatest.max(ab), greatest.max(ab.max(c)), greatest.max(ab.max(cd))];
        greatest = four[3];
    }
    for value in rest {
        greatest = greatest.max(*value);
        *value = greatest;
    }
}

/// The least whole number that is not below a value in (-1, 2³¹).
#[inline]
fn ceiling(value: f64) -> u32 {
    /// Adding it leaves the nearest whole number in the low bits of the sum; plain `ceil` is a call on old processors.
    const ROUNDER: f64 = 6_755_399_441_055_744.0;
    let shifted = value + ROUNDER;
    let nearest = shifted - ROUNDER;
    (shifted.to_bits() as u32).wrapping_add(u32::from(value > nearest))
}
