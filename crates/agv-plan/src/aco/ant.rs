//! An ant's way: step by step to a neighbour it has not been to.

use super::{ground::Ground, sight::TURNS};
use crate::grid::{DIAGONAL, STRAIGHT};
use agv_core::compute::Stream;

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

/// Cost of a step in the integers of the search.
#[inline]
pub(super) const fn price_of(step: u8) -> u32 {
    if step >= 4 { DIAGONAL } else { STRAIGHT }
}

/// Number of places where the direction changes along steps.
pub(super) fn turns_of(steps: &[u8]) -> usize {
    steps.windows(2).filter(|pair| pair[0] != pair[1]).count()
}

/// Ants that one thread leads abreast: while one waits for what it will choose, the other goes on.
pub(super) const ABREAST: usize = 2;

/// An ant under way.
struct Walk<'a> {
    ant: &'a mut Ant,
    ground: &'a mut Ground,
    stream: Stream,
    node: u32,
    /// The step that led here; 8 for none.
    last: usize,
}

impl Rules<'_> {
    /// Sends ants on their ways, each with a stream of its own.
    pub(super) fn walk(&self, ants: &mut [Ant], grounds: &mut [Ground; ABREAST], stream: impl Fn(usize) -> Stream) {
        if self.sight.is_empty() {
            self.walk_with::<false>(ants, grounds, stream);
        } else {
            self.walk_with::<true>(ants, grounds, stream);
        }
    }

    fn walk_with<const SEES: bool>(
        &self,
        ants: &mut [Ant],
        grounds: &mut [Ground; ABREAST],
        stream: impl Fn(usize) -> Stream,
    ) {
        let mut waiting = ants.iter_mut().enumerate();
        let mut lanes = grounds
            .each_mut()
            .map(|ground| waiting.next().map(|(index, ant)| self.set_out(ant, ground, stream(index))));
        loop {
            let mut are_home = true;
            for lane in &mut lanes {
                let Some(walk) = lane else { continue };
                are_home = false;
                if !self.step::<SEES>(walk) {
                    walk.ant.length = (walk.node == self.goal).then(|| length_of(&walk.ant.steps));
                    let next = waiting.next();
                    *lane =
                        lane.take().zip(next).map(|(walk, (index, ant))| self.set_out(ant, walk.ground, stream(index)));
                }
            }
            if are_home {
                break;
            }
        }
    }

    fn set_out<'a>(&self, ant: &'a mut Ant, ground: &'a mut Ground, stream: Stream) -> Walk<'a> {
        ground.restore(self.masks);
        ground.tread(self.start);
        ant.steps.clear();
        ant.taken = 0;
        Walk { ant, ground, stream, node: self.start, last: 8 }
    }

    /// A step, on or back; whether the ant goes on.
    #[inline]
    fn step<const SEES: bool>(&self, walk: &mut Walk<'_>) -> bool {
        let open = walk.ground.open(walk.node);
        if open == 0 {
            if self.dead_end == DeadEnd::Die {
                return false;
            }
            let Some(step) = walk.ant.steps.pop() else { return false };
            walk.ant.taken += 1;
            walk.node = walk.node.wrapping_sub(self.strides[usize::from(step & 7)]);
            walk.last = walk.ant.steps.last().map_or(8, |&step| usize::from(step));
            return true;
        }
        let step = self.choose::<SEES>(walk.node, walk.last, open, &mut walk.stream);
        walk.ant.steps.push(step as u8);
        walk.ant.taken += 1;
        walk.node = walk.node.wrapping_add(self.strides[step]);
        walk.ground.tread(walk.node);
        walk.last = step;
        walk.node != self.goal
    }
}
