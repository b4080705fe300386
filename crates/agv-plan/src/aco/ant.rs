//! An ant's way: step by step to a neighbour it has not been to, drawn by weight.

use super::{ground::Ground, sight::TURNS};
use agv_core::compute::Stream;
use rand::Rng;

/// What an ant does in a dead end, where it has been to all neighbours. The paper does not say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum DeadEnd {
    /// It goes back, step by step, until a neighbour is left that it has not been to; what it goes back over is not part of
    /// its way. If there is a way to the goal, every ant finds one.
    #[default]
    Retreat,
    /// It dies, and leaves no pheromone.
    Die,
}

/// What all ants of an iteration share.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rules<'a> {
    /// Open neighbours of every cell.
    pub(super) masks: &'a [u8],
    /// How a cell's number changes by each step.
    pub(super) strides: &'a [u32; 8],
    /// Weight of every step by its pheromone, `[cell][step]`.
    pub(super) trail: &'a [[f32; 8]],
    /// Columns of the map.
    pub(super) width: usize,
    /// Weight of a step by what is seen, `[cell that it leads to][turn]`, with a row and a cell more before the first one
    /// and after the last; none where the trail has it all.
    pub(super) sight: &'a [[f32; TURNS]],
    /// How often the best step is taken.
    pub(super) greed: f32,
    pub(super) dead_end: DeadEnd,
    pub(super) start: u32,
    pub(super) goal: u32,
}

/// One ant and its way.
#[derive(Debug, Clone, Default)]
pub(super) struct Ant {
    /// Steps from the start, as bits of a mask.
    pub(super) steps: Vec<u8>,
    /// Length of its way, in cells, if it arrived.
    pub(super) length: Option<f64>,
    /// Steps that it took, those back included.
    pub(super) taken: u64,
}

/// Length of steps, in cells: from counts, so that equal ways have equal bits.
pub(super) fn length_of(steps: &[u8]) -> f64 {
    let diagonal = steps.iter().filter(|&&step| step >= 4).count();
    (steps.len() - diagonal) as f64 + diagonal as f64 * std::f64::consts::SQRT_2
}

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

/// Number of places where the direction changes along steps.
pub(super) fn turns_of(steps: &[u8]) -> usize {
    steps.windows(2).filter(|pair| pair[0] != pair[1]).count()
}

impl Rules<'_> {
    /// Sends an ant on its way.
    pub(super) fn walk(&self, ant: &mut Ant, ground: &mut Ground, stream: &mut Stream) {
        if self.sight.is_empty() {
            self.walk_with::<false>(ant, ground, stream);
        } else {
            self.walk_with::<true>(ant, ground, stream);
        }
    }

    fn walk_with<const SEES: bool>(&self, ant: &mut Ant, ground: &mut Ground, stream: &mut Stream) {
        ground.restore(self.masks);
        ant.steps.clear();
        ant.taken = 0;
        let mut node = self.start;
        let mut last = 8;
        ground.tread(node);
        while node != self.goal {
            let open = ground.open(node);
            if open == 0 {
                if self.dead_end == DeadEnd::Die {
                    break;
                }
                let Some(step) = ant.steps.pop() else { break };
                node = node.wrapping_sub(self.strides[usize::from(step & 7)]);
                last = ant.steps.last().map_or(8, |&step| usize::from(step));
            } else {
                let step = self.choose::<SEES>(node, last, open, stream);
                ant.steps.push(step as u8);
                node = node.wrapping_add(self.strides[step]);
                ground.tread(node);
                last = step;
            }
            ant.taken += 1;
        }
        ant.length = (node == self.goal).then(|| length_of(&ant.steps));
    }

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

    /// A step among the open ones, of which there is one at least.
    #[inline]
    fn choose<const SEES: bool>(&self, node: u32, last: usize, open: u8, stream: &mut Stream) -> usize {
        let first = open.trailing_zeros() as usize & 7;
        if open.is_power_of_two() {
            return first;
        }
        let Some(row) = self.trail.get(node as usize) else { return first };
        // Closed steps weigh nothing.
        let mut weights = [0.0_f32; 8];
        for ((weight, trail), kept) in weights.iter_mut().zip(row).zip(&LANES[open as usize]) {
            *weight = trail * kept;
        }
        if SEES {
            let Some(seen) = self.seen(node, last) else { return first };
            for (weight, seen) in weights.iter_mut().zip(seen) {
                *weight *= seen;
            }
        }
        let draw = stream.next_u64();
        // 24 bits each: what single precision holds.
        let (fate, spin) = ((draw >> 40) as f32 * SCALE, (draw & 0xff_ffff) as f32 * SCALE);
        if fate < self.greed {
            return best_of(&weights);
        }
        let sums = running_sums(&weights);
        let drawn = sums[7] * spin;
        let passed: u32 = sums.iter().map(|&sum| u32::from(sum <= drawn)).sum();
        // Rounding may pass the last one.
        if passed < 8 { passed as usize } else { best_of(&weights) }
    }
}

const SCALE: f32 = 1.0 / (1 << 24) as f32;

/// The first step of greatest weight, without a branch: which it is cannot be foretold.
#[inline]
fn best_of(w: &[f32; 8]) -> usize {
    let greatest = w[0].max(w[1]).max(w[2].max(w[3])).max(w[4].max(w[5]).max(w[6].max(w[7])));
    let equal = w.iter().enumerate().fold(0_u32, |bits, (step, &weight)| bits | u32::from(weight == greatest) << step);
    equal.trailing_zeros() as usize & 7
}

/// Sums up to each weight, in three rounds of additions that do not wait for one another.
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
    use agv_core::compute::Seed;

    /// Steps are drawn in proportion to their weights, or the best is taken.
    #[test]
    fn steps_are_chosen_by_weight_and_greed() {
        const DRAWS: usize = 100_000;
        let trail = [[1.0, 2.0, 3.0, 4.0, 9.0, 0.0, 0.0, 0.0]];
        for (greed, expected) in
            [(0.0, [0.1, 0.2, 0.3, 0.4]), (0.5, [0.05, 0.1, 0.15, 0.7]), (1.0, [0.0, 0.0, 0.0, 1.0])]
        {
            let rules = Rules {
                masks: &[0xf],
                strides: &[0; 8],
                trail: &trail,
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
            assert!(counts[4..].iter().all(|&count| count == 0.0));
            let chi_square: f64 = (0..4)
                .filter(|&step| expected[step] > 0.0)
                .map(|step| (counts[step] - expected[step] * DRAWS as f64).powi(2) / (expected[step] * DRAWS as f64))
                .sum();
            // 99.9 % of three degrees of freedom.
            assert!(chi_square < 16.27, "{greed}: {counts:?}");
        }
    }
}
