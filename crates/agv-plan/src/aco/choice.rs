//! An ant's next step: drawn by weight among the open ones.

use super::{ant::Rules, sight::TURNS};
use agv_core::compute::Stream;
use rand::Rng;

/// Eighths of a full turn of each step, counter-clockwise from +x.
const EIGHTHS: [i8; 8] = [0, 2, 4, 6, 1, 3, 5, 7];

/// Change of direction, in eighths of a full turn, from the step that led here (8: none) to the next.
const CHANGES: [[u8; 8]; 9] = {
    let mut table = [[0; 8]; 9];
    let mut from = 0;
    while from < 8 {
        let mut to = 0;
        while to < 8 {
            let apart = (EIGHTHS[from] - EIGHTHS[to]).unsigned_abs();
            let least = if apart > 4 { 8 - apart } else { apart };
            // Back on its heel only where a way begins anew; it counts as the sharpest turn.
            table[from][to] = if least == 4 { TURNS as u8 - 1 } else { least };
            to += 1;
        }
        from += 1;
    }
    table
};

impl Rules<'_> {
    /// Weights of the eight steps by what is seen; of closed steps anything finite.
    #[inline]
    fn seen(&self, node: u32, last: usize) -> Option<[f32; 8]> {
        let rows = |first: usize| self.sight.get(first..first + 3);
        let below = node as usize;
        let [b, m, a] = [rows(below)?, rows(below + self.width)?, rows(below + 2 * self.width)?];
        let changes = CHANGES.get(last)?;
        let cells = [&m[2], &a[1], &m[0], &b[1], &a[2], &a[0], &b[0], &b[2]];
        let mut weights = [0.0; 8];
        for ((weight, cell), change) in weights.iter_mut().zip(cells).zip(changes) {
            *weight = cell[usize::from(*change) % TURNS];
        }
        Some(weights)
    }

    /// A step among the open ones, of which there is one at least: drawn by weight, or the one of greatest weight.
    #[inline]
    pub(super) fn choose<const SEES: bool>(&self, node: u32, last: usize, open: u8, stream: &mut Stream) -> usize {
        let first = open.trailing_zeros() as usize & 7;
        if open.is_power_of_two() {
            return first;
        }
        let Some(row) = self.trail.get(node as usize) else { return first };
        // Closed steps weigh nothing.
        let kept = &LANES[usize::from(open)];
        let mut weights: [f32; 8] = std::array::from_fn(|step| row[step] * kept[step]);
        if SEES {
            let Some(seen) = self.seen(node, last) else { return first };
            weights = std::array::from_fn(|step| weights[step] * seen[step]);
        }
        let draw = stream.next_u64();
        // 24 bits each: what single precision holds.
        let (fate, spin) = ((draw >> 40) as f32 * SCALE, (draw & 0xff_ffff) as f32 * SCALE);
        if fate < self.greed {
            return best_of(&weights, spin);
        }
        let sums = running_sums(&weights);
        // Less than the whole even when rounded, as `spin` is less than one; so a step is left, and a closed one adds nothing
        // to the sum that was passed before it.
        let drawn = sums[7] * spin;
        let passed: u32 = sums.iter().map(|&sum| u32::from(sum <= drawn)).sum();
        passed as usize & 7
    }
}

const SCALE: f32 = 1.0 / (1 << 24) as f32;

/// A step of greatest weight; of several, which on a grid are no rare thing, each as often as the others.
#[inline]
fn best_of(w: &[f32; 8], spin: f32) -> usize {
    let larger = |a: f32, b: f32| if a > b { a } else { b };
    let [a, b, c, d] = [larger(w[0], w[4]), larger(w[1], w[5]), larger(w[2], w[6]), larger(w[3], w[7])];
    let greatest = larger(larger(a, c), larger(b, d));
    let mut equal =
        w.iter().enumerate().fold(0_u32, |bits, (step, &weight)| bits | u32::from(weight == greatest) << step);
    if !equal.is_power_of_two() {
        for _ in 0..(equal.count_ones() as f32 * spin) as u32 {
            equal &= equal.wrapping_sub(1);
        }
    }
    equal.trailing_zeros() as usize & 7
}

/// Sums up to each weight, in three rounds of additions that do not wait for one another. They never fall, and stay the same
/// over a weight of zero, rounding or not.
#[inline]
fn running_sums(w: &[f32; 8]) -> [f32; 8] {
    let pairs = [w[0], w[0] + w[1], w[2], w[2] + w[3], w[4], w[4] + w[5], w[6], w[6] + w[7]];
    let low = [pairs[0], pairs[1], pairs[1] + pairs[2], pairs[1] + pairs[3]];
    let high = [pairs[4], pairs[5], pairs[5] + pairs[6], pairs[5] + pairs[7]];
    let half = low[3];
    [low[0], low[1], low[2], half, half + high[0], half + high[1], half + high[2], half + high[3]]
}

/// One for every bit of a mask that is set, zero for the others.
static LANES: [[f32; 8]; 256] = {
    let mut table = [[0.0; 8]; 256];
    let mut mask = 0;
    while mask < 256 {
        let mut bit = 0;
        while bit < 8 {
            if mask >> bit & 1 == 1 {
                table[mask][bit] = 1.0;
            }
            bit += 1;
        }
        mask += 1;
    }
    table
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::aco::DeadEnd;
    use agv_core::compute::Seed;

    /// Steps are drawn in proportion to their weights, or the best is taken; of several best ones each as often as the others.
    #[test]
    fn steps_are_chosen_by_weight_and_greed() {
        const DRAWS: usize = 100_000;
        let (uneven, even) = ([1.0, 2.0, 3.0, 4.0, 9.0, 0.0, 0.0, 0.0], [2.0, 1.0, 2.0, 2.0, 9.0, 0.0, 0.0, 0.0]);
        let third = 1.0 / 3.0;
        for (row, greed, expected) in [
            (uneven, 0.0, [0.1, 0.2, 0.3, 0.4]),
            (uneven, 0.5, [0.05, 0.1, 0.15, 0.7]),
            (uneven, 1.0, [0.0, 0.0, 0.0, 1.0]),
            (even, 1.0, [third, 0.0, third, third]),
        ] {
            let rules = Rules {
                masks: &[0xf],
                strides: &[0; 8],
                trail: &[row],
                width: 1,
                sight: &[],
                greed,
                dead_end: DeadEnd::Retreat,
                start: 0,
                goal: 1,
            };
            let mut stream = Seed(4).stream(0, 0);
            let mut counts = [0.0; 8];
            // The fifth, which weighs most, is closed.
            (0..DRAWS).for_each(|_| counts[rules.choose::<false>(0, 8, 0b1111, &mut stream)] += 1.0);
            let is_expected = |step: usize| step < 4 && expected[step] > 0.0;
            assert!((0..8).all(|step| is_expected(step) || counts[step] == 0.0), "{greed}: {counts:?}");
            let chi_square: f64 = (0..4)
                .filter(|&step| is_expected(step))
                .map(|step| (counts[step] - expected[step] * DRAWS as f64).powi(2) / (expected[step] * DRAWS as f64))
                .sum();
            // 99.9 % of three degrees of freedom.
            assert!(chi_square < 16.27, "{greed}: {counts:?}");
        }
    }
}
