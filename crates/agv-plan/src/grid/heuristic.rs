//! How far it is to the goal at least, in the integers of the search.
//!
//! All heuristics here are consistent for steps that cost at least [`STRAIGHT`] and [`DIAGONAL`]: along a step they fall by
//! no more than the step costs. [`Manhattan`] is so only where there are no diagonal steps.

use super::{
    space::GridSpace,
    step::{DIAGONAL, STRAIGHT},
};
use agv_core::grid::Cell;

/// A lower bound on the cost from a node to the goal, consistent: it falls by at most the cost of a step.
pub trait Heuristic {
    /// The bound for a node.
    fn estimate(&self, node: u32) -> u32;
}

/// Nothing is known: Dijkstra's algorithm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Zero;

impl Heuristic for Zero {
    #[inline]
    fn estimate(&self, _: u32) -> u32 {
        0
    }
}

/// The nearest of several goals: the least of the bounds to each, in time proportional to their number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Nearest<'a, H>(pub &'a [H]);

impl<H: Heuristic> Heuristic for Nearest<'_, H> {
    #[inline]
    fn estimate(&self, node: u32) -> u32 {
        self.0.iter().map(|bound| bound.estimate(node)).min().unwrap_or(0)
    }
}

/// Column and row distance of a node of a grid to the goal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Offset {
    width: u32,
    /// 2^64 / width, rounded up: the high half of its product with a 32-bit index is the exact row
    /// (Lemire et al. 2019). Zero stands for 2^64, where the width is one.
    reciprocal: u64,
    goal: Cell,
}

impl Offset {
    /// Distances to `goal` in a grid of `width` columns stored row by row; a width of zero is read as one.
    pub const fn new(width: u32, goal: Cell) -> Self {
        let width = if width == 0 { 1 } else { width };
        Self { width, reciprocal: (u64::MAX / width as u64).wrapping_add(1), goal }
    }

    /// Distances to a node of a space.
    pub(super) fn to(space: &GridSpace, goal: u32) -> Self {
        Self::new(space.layout().map_or(1, |layout| layout.width() as u32), space.cell(goal))
    }

    /// Absolute column and row distance of the node.
    #[inline]
    pub const fn of(&self, node: u32) -> (u32, u32) {
        let cell = self.cell(node);
        (self.goal.x.abs_diff(cell.x), self.goal.y.abs_diff(cell.y))
    }

    /// Column and row of the node.
    #[inline]
    pub(super) const fn cell(&self, node: u32) -> Cell {
        let row = if self.reciprocal == 0 { node } else { ((self.reciprocal as u128 * node as u128) >> 64) as u32 };
        Cell::new(node.wrapping_sub(row.wrapping_mul(self.width)) as i32, row as i32)
    }
}

/// Length of the shortest 8-connected way without obstacles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Octile(pub Offset);

impl Heuristic for Octile {
    #[inline]
    fn estimate(&self, node: u32) -> u32 {
        let (dx, dy) = self.0.of(node);
        let (long, short) = if dx > dy { (dx, dy) } else { (dy, dx) };
        STRAIGHT.wrapping_mul(long).wrapping_add((DIAGONAL - STRAIGHT).wrapping_mul(short))
    }
}

/// Length of the shortest 4-connected way without obstacles. Only for 4-connected grids.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Manhattan(pub Offset);

impl Heuristic for Manhattan {
    #[inline]
    fn estimate(&self, node: u32) -> u32 {
        let (dx, dy) = self.0.of(node);
        STRAIGHT.wrapping_mul(dx.wrapping_add(dy))
    }
}

/// Straight-line distance: weaker than [`Octile`] on grids, the right one for any-angle paths.
///
/// Its scale is 1393/√2 = 984.9997 per cell, so that rounding down keeps it consistent for both kinds of step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Euclidean(pub Offset);

impl Heuristic for Euclidean {
    #[inline]
    fn estimate(&self, node: u32) -> u32 {
        let (dx, dy) = self.0.of(node);
        let squared = f64::from(dx) * f64::from(dx) + f64::from(dy) * f64::from(dy);
        (squared.sqrt() * (f64::from(DIAGONAL) * std::f64::consts::FRAC_1_SQRT_2)) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::step::Step;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn offsets_are_exact(width in 1_u32..70_000, x in 0_u32..70_000, y in 0_u32..40_000, gx in 0..500, gy in 0..500) {
            let x = x % width;
            let (gx, gy) = (gx % width as i32, gy);
            if let Some(node) = y.checked_mul(width).and_then(|v| v.checked_add(x)) {
                let offset = Offset::new(width, Cell::new(gx, gy));
                prop_assert_eq!(offset.of(node), ((x as i32).abs_diff(gx), (y as i32).abs_diff(gy)));
            }
        }

        /// The promise that the search relies on, step by step.
        #[test]
        fn heuristics_are_consistent(x in 1_u32..199, y in 1_u32..199, gx in 0..200, gy in 0..200) {
            let node = |x: i32, y: i32| (y * 200 + x) as u32;
            let offset = Offset::new(200, Cell::new(gx, gy));
            let goal = node(gx, gy);
            for step in Step::ALL {
                let (here, there) = (node(x as i32, y as i32), node(x as i32 + step.dx(), y as i32 + step.dy()));
                let cost = i64::from(if step.is_diagonal() { DIAGONAL } else { STRAIGHT });
                let fall = |h: &dyn Fn(u32) -> u32| i64::from(h(here)) - i64::from(h(there));
                prop_assert!(fall(&|n| Octile(offset).estimate(n)) <= cost);
                prop_assert!(fall(&|n| Euclidean(offset).estimate(n)) <= cost);
                if !step.is_diagonal() {
                    prop_assert!(fall(&|n| Manhattan(offset).estimate(n)) <= cost);
                }
            }
            prop_assert_eq!(Octile(offset).estimate(goal) + Euclidean(offset).estimate(goal), 0);
        }
    }
}
