//! Systematic resampling: one draw for all.
//!
//! The points lie at equal distances on the running sum of the weights, as the teeth of a comb: which particle a tooth falls on can
//! be told for any part of the new set by itself, given the sums before each chunk of the old one.

use super::Resampler;
use agv_core::compute::{CHUNK, Stream};
use rand::RngExt;

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

impl Resampler for Systematic {
    fn resample(&self, weights: &[f64], stream: &mut Stream, ancestors: &mut [u32]) {
        let offset = stream.random::<f64>();
        let weights = possible(weights);
        let total = weights.chunks(CHUNK).fold(0.0, |total, chunk| total + sum(chunk));
        let comb = Comb::new(ancestors.len(), total, offset);
        let (mut before, mut part) = (0.0, comb.part(0, ancestors));
        for (first, chunk) in (0_u32..).step_by(CHUNK).zip(weights.chunks(CHUNK)) {
            part.take(first, before, chunk);
            before += sum(chunk);
        }
        part.filled();
    }

    fn first_of_equally_spaced(&self, stream: &mut Stream) -> Option<f64> {
        Some(stream.random())
    }
}

/// The weights up to the last one above zero: what rounding leaves at the end is that one's.
pub(in crate::particle) fn possible(weights: &[f64]) -> &[f64] {
    weights.iter().rposition(|&weight| weight > 0.0).map_or(&[], |last| &weights[..=last])
}

/// Equally spaced points on the running sum of weights.
#[derive(Debug, Clone, Copy)]
pub(in crate::particle) struct Comb {
    /// Points per weight.
    scale: f64,
    offset: f64,
}

impl Comb {
    /// So many points on a whole weight, the first at a share `offset` of their distance.
    pub(in crate::particle) fn new(count: usize, total: f64, offset: f64) -> Self {
        Self { scale: count as f64 / total, offset }
    }

    /// Number of points below a running sum.
    #[inline]
    pub(in crate::particle) fn below(&self, sum: f64) -> u32 {
        ceiling(sum * self.scale - self.offset)
    }

    /// The points from number `first` on, for which `ancestors` has room.
    pub(in crate::particle) fn part(self, first: u32, ancestors: &mut [u32]) -> Part<'_> {
        ancestors.fill(0);
        Part { comb: self, first, ancestors }
    }
}

/// The particles that some of the points fall on.
pub(in crate::particle) struct Part<'a> {
    comb: Comb,
    first: u32,
    ancestors: &'a mut [u32],
}

impl<'a> Part<'a> {
    /// Takes a chunk of particles in, the first of which has number `index`, with the sum of all weights `before`; the chunks are
    /// to come in order, none of them left out that a point of this part falls on.
    ///
    /// Particle j spans the points from its start (the end of its predecessor) up to its own end. It writes its index at its
    /// start, or at the start of this part if that comes later; if it spans none, its successor overwrites it. What is not
    /// written is a gap.
    pub(in crate::particle) fn take(&mut self, index: u32, before: f64, weights: &[f64]) {
        let Self { comb, first, ancestors } = self;
        let (mut total, mut start) = (0.0, comb.below(before));
        for (index, weights) in (index..).step_by(BLOCK).zip(weights.chunks(BLOCK)) {
            if start >= *first + ancestors.len() as u32 {
                break;
            }
            let mut sums = [0.0; BLOCK];
            total = running_sums(total, weights, &mut sums);
            // All before this part: there is a later particle at its begin, since no more than one point lies beyond the whole weight.
            if comb.below(before + total) < *first {
                start = comb.below(before + total);
                continue;
            }
            let ends = sums.map(|sum| comb.below(before + sum));
            for (index, &end) in (index..).zip(&ends[..weights.len()]) {
                if let Some(ancestor) = ancestors.get_mut(start.saturating_sub(*first) as usize) {
                    *ancestor = index;
                }
                start = end;
            }
        }
    }

    /// The particles that all points of the part fall on: gaps copy the entry before.
    pub(in crate::particle) fn filled(self) -> &'a [u32] {
        running_maxima(self.ancestors);
        self.ancestors
    }
}

/// Particles whose ends are computed together.
const BLOCK: usize = 64;

/// The sum, as [`running_sums`] has it to the bit.
pub(in crate::particle) fn sum(values: &[f64]) -> f64 {
    let (fours, rest) = values.as_chunks::<4>();
    let sum = fours.iter().fold(0.0, |sum, &[a, b, c, d]| sum + ((a + b) + (c + d)));
    rest.iter().fold(sum, |sum, value| sum + value)
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
