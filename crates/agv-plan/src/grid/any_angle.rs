//! Straight lines between cells: what any-angle search is made of.

use super::{
    space::GridSpace,
    step::{DIAGONAL, Step},
};
use agv_core::grid::Cell;
use std::cmp::Ordering;

/// The node before, on an any-angle way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Parent(u32);

impl Default for Parent {
    /// None: a start.
    fn default() -> Self {
        Self(u32::MAX)
    }
}

impl Parent {
    /// This node.
    pub const fn at(node: u32) -> Self {
        Self(node)
    }

    /// The node; none for a start.
    #[inline]
    pub fn node(self) -> Option<u32> {
        (self.0 != u32::MAX).then_some(self.0)
    }
}

impl GridSpace {
    /// Whether the straight line between the centres of two cells is open: every cell that it crosses is passable, and
    /// where it passes exactly through a corner, the corner rule allows the diagonal step there. Exact, in integers; time is
    /// in proportion to the cells crossed. Both nodes belong to the space and `a` is passable.
    pub fn is_line_open(&self, a: u32, b: u32) -> bool {
        let (from, to) = (self.cell(a), self.cell(b));
        let (dx, dy) = (to.x - from.x, to.y - from.y);
        let (columns, rows) = (i64::from(dx.abs()), i64::from(dy.abs()));
        let strides = self.strides();
        let stride = |step: Step| strides.get(step.index()).copied().unwrap_or(0);
        let (across, along) = (Step::towards(dx, 0), Step::towards(0, dy));
        let moves = [across, along, Step::towards(dx, dy)].map(|step| (step.bit(), stride(step)));
        // The line leaves a cell through its side where it meets the next column, or row, first: at (2 i + 1) / (2 columns)
        // and (2 j + 1) / (2 rows) of its length.
        let (mut column, mut row, mut node) = (0, 0, a);
        while column < columns || row < rows {
            let ((bit, stride), right, up) = match ((2 * column + 1) * rows).cmp(&((2 * row + 1) * columns)) {
                Ordering::Less => (moves[0], 1, 0),
                Ordering::Greater => (moves[1], 0, 1),
                Ordering::Equal => (moves[2], 1, 1),
            };
            if self.mask(node) & bit == 0 {
                return false;
            }
            node = node.wrapping_add(stride);
            column += right;
            row += up;
        }
        true
    }

    /// Length of the straight line between two cells, in the integers of the search: rounded up, so that no detour is
    /// shorter and [`Euclidean`](super::Euclidean) stays consistent.
    #[inline]
    pub fn line_cost(&self, a: u32, b: u32) -> u32 {
        const SCALE: f64 = DIAGONAL as f64 * std::f64::consts::FRAC_1_SQRT_2;
        // Straight and diagonal steps are whole numbers but for rounding.
        const ROUNDING: f64 = 1e-5;
        let Cell { x, y } = self.cell(a);
        let to = self.cell(b);
        let (dx, dy) = (f64::from(to.x - x), f64::from(to.y - y));
        ((dx * dx + dy * dy).sqrt() * SCALE - ROUNDING).ceil() as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{Connectivity, CornerRule, GridParams, STRAIGHT};
    use agv_core::{
        geometry::Se2,
        grid::{Costmap, Grid, GridLayout},
    };
    use proptest::prelude::*;

    /// The rules in words, by exact geometry. Lengths are doubled, so that centres are odd and corners even.
    fn open_by_geometry(free: &dyn Fn(i64, i64) -> bool, (needed, four): (usize, bool), a: Cell, b: Cell) -> bool {
        let centre = |c: Cell| (2 * i64::from(c.x) + 1, 2 * i64::from(c.y) + 1);
        let ((ax, ay), (bx, by)) = (centre(a), centre(b));
        let side = |x: i64, y: i64| ((bx - ax) * (y - ay) - (by - ay) * (x - ax)).signum();
        let within = |v: i64, p: i64, q: i64| v > p.min(q) && v < p.max(q);
        for y in -1..12 {
            for x in -1..12 {
                // Open square against closed segment: no separating axis.
                let corners = [(0, 0), (2, 0), (2, 2), (0, 2)].map(|(u, v)| side(2 * x + u, 2 * y + v));
                let apart = corners.iter().all(|&s| s >= 0) || corners.iter().all(|&s| s <= 0);
                let aside =
                    ax.max(bx) <= 2 * x || ax.min(bx) >= 2 * x + 2 || ay.max(by) <= 2 * y || ay.min(by) >= 2 * y + 2;
                if !apart && !aside && !free(x, y) {
                    return false;
                }
                // The lower left corner, if the line passes through it: it lies in two cells, and between two others.
                if side(2 * x, 2 * y) == 0 && within(2 * x, ax, bx) && within(2 * y, ay, by) {
                    let rising = (bx > ax) == (by > ay);
                    let others = if rising { [(x - 1, y), (x, y - 1)] } else { [(x - 1, y - 1), (x, y)] };
                    let sides = others.into_iter().filter(|&(u, v)| free(u, v)).count();
                    if four || sides < needed {
                        return false;
                    }
                }
            }
        }
        true
    }

    proptest! {
        #[test]
        fn open_lines_cross_what_may_be_crossed(
            costs in proptest::collection::vec(prop_oneof![5 => Just(0_u8), 1 => Just(254_u8)], 99),
            rule in 0_usize..3,
            four in any::<bool>(),
            first in 0_usize..11,
        ) {
            let layout = GridLayout::new(11, 9, 1.0, Se2::default()).unwrap();
            let corner_rule = [CornerRule::Never, CornerRule::OneFree, CornerRule::Free][rule];
            let connectivity = if four { Connectivity::Four } else { Connectivity::Eight };
            let mut space = GridSpace::new(GridParams { connectivity, corner_rule, ..Default::default() }).unwrap();
            space.update(&Costmap::from_costs(Grid::new(layout, costs).unwrap()));
            let free = |x: i64, y: i64| space.node(Cell::new(x as i32, y as i32)).is_some_and(|n| space.is_passable(n));
            for a in (0..99).skip(first).step_by(11).filter(|&a| space.is_passable(a)) {
                for b in 0..99 {
                    let want = space.is_passable(b)
                        && open_by_geometry(&free, ([2, 1, 0][rule], four), space.cell(a), space.cell(b));
                    prop_assert_eq!(space.is_line_open(a, b), want, "{:?} {:?}", space.cell(a), space.cell(b));
                }
            }
        }

        /// No detour is shorter than the line, to the integer.
        #[test]
        fn line_costs_keep_the_triangle_inequality(a in 0_u32..4000, b in 0_u32..4000, c in 0_u32..4000) {
            let mut space = GridSpace::new(GridParams::default()).unwrap();
            space.update(&Costmap::from_costs(Grid::filled(GridLayout::new(80, 50, 1.0, Se2::default()).unwrap(), 0)));
            prop_assert!(space.line_cost(a, c) <= space.line_cost(a, b) + space.line_cost(b, c));
            prop_assert_eq!(space.line_cost(0, 1), STRAIGHT);
            prop_assert_eq!(space.line_cost(0, 81), DIAGONAL);
            prop_assert_eq!(space.line_cost(80 * 30, 30), 30 * DIAGONAL);
        }
    }
}
