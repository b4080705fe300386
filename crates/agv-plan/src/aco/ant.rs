//! An ant's way: step by step to a neighbour it has not been to, drawn by weight.

use super::sight::TURNS;
use agv_core::compute::Stream;
use rand::RngExt;

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
    pub(super) trail: &'a [f32],
    /// Weight of a step by what is seen, `[cell that it leads to][turn]`; none where the trail has it all.
    pub(super) sight: &'a [f32],
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
    pub(super) arrived: bool,
    /// Steps that it took, those back included.
    pub(super) taken: u64,
}

impl Ant {
    /// Length of its way, in cells: from counts, so that equal ways have equal bits.
    pub(super) fn length(&self) -> f64 {
        length_of(&self.steps)
    }
}

/// Length of steps, in cells.
pub(super) fn length_of(steps: &[u8]) -> f64 {
    let diagonal = steps.iter().filter(|&&step| step >= 4).count();
    (steps.len() - diagonal) as f64 + diagonal as f64 * std::f64::consts::SQRT_2
}

/// Which cells an ant has been to.
#[derive(Debug, Clone, Default)]
pub(super) struct Footprints {
    stamps: Vec<u32>,
    stamp: u32,
}

impl Footprints {
    /// Forgets all, in a field of so many cells.
    pub(super) fn clear(&mut self, cells: usize) {
        if self.stamps.len() != cells || self.stamp == u32::MAX {
            self.stamps.clear();
            self.stamps.resize(cells, 0);
            self.stamp = 0;
        }
        self.stamp += 1;
    }

    #[inline]
    pub(super) fn set(&mut self, node: u32) {
        if let Some(slot) = self.stamps.get_mut(node as usize) {
            *slot = self.stamp;
        }
    }

    #[inline]
    pub(super) fn contains(&self, node: u32) -> bool {
        self.stamps.get(node as usize).is_none_or(|&stamp| stamp == self.stamp)
    }
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
    pub(super) fn walk(&self, ant: &mut Ant, been: &mut Footprints, stream: &mut Stream) {
        if self.sight.is_empty() { self.walk_with::<false>(ant, been, stream) } else { self.walk_with::<true>(ant, been, stream) }
    }

    fn walk_with<const SEES: bool>(&self, ant: &mut Ant, been: &mut Footprints, stream: &mut Stream) {
        been.clear(self.masks.len());
        ant.steps.clear();
        ant.taken = 0;
        let mut node = self.start;
        been.set(node);
        let mut last = 8;
        while node != self.goal {
            match self.choose::<SEES>(node, last, been, stream) {
                Some(step) => {
                    ant.steps.push(step as u8);
                    node = node.wrapping_add(self.strides[step]);
                    been.set(node);
                    last = step;
                }
                None if self.dead_end == DeadEnd::Die => break,
                None => {
                    let Some(step) = ant.steps.pop() else { break };
                    node = node.wrapping_sub(self.strides[usize::from(step & 7)]);
                    last = ant.steps.last().map_or(8, |&step| usize::from(step));
                }
            }
            ant.taken += 1;
        }
        ant.arrived = node == self.goal;
    }

    /// The next step from a cell, if a neighbour is left.
    #[inline]
    fn choose<const SEES: bool>(&self, node: u32, last: usize, been: &Footprints, stream: &mut Stream) -> Option<usize> {
        let at = node as usize;
        let mut open = *self.masks.get(at)?;
        let weights: &[f32; 8] = self.trail.get(at * 8..)?.first_chunk()?;
        let changes = CHANGES.get(last)?;
        // Running sums of the weights, and the steps that they belong to.
        let (mut sums, mut steps, mut count) = ([0.0_f32; 8], [0_u8; 8], 0);
        let (mut sum, mut greatest, mut best) = (0.0, f32::NEG_INFINITY, 0);
        while open != 0 {
            let step = open.trailing_zeros() as usize & 7;
            open &= open - 1;
            let next = node.wrapping_add(self.strides[step]);
            if been.contains(next) {
                continue;
            }
            let mut weight = weights[step];
            if SEES {
                weight *= self.sight.get(next as usize * TURNS + usize::from(changes[step])).copied().unwrap_or(0.0);
            }
            if weight > greatest {
                (greatest, best) = (weight, step);
            }
            sum += weight;
            sums[count & 7] = sum;
            steps[count & 7] = step as u8;
            count += 1;
        }
        if count < 2 {
            return (count == 1).then_some(best);
        }
        if self.greed > 0.0 && stream.random::<f32>() < self.greed {
            return Some(best);
        }
        let drawn = sum * stream.random::<f32>();
        let index = sums.iter().take(count - 1).filter(|&&bound| bound <= drawn).count();
        steps.get(index).map(|&step| usize::from(step))
    }
}
