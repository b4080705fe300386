//! From a row per column to a way: what a sparrow's position means.

use crate::grid::GridSpace;
use agv_core::grid::Cell;

/// The columns between start and goal and the cells in them from which the goal can be reached without turning back.
///
/// Columns are counted from the start's (0) to the goal's, along the axis on which the two lie farther apart; rows along the
/// other one.
#[derive(Debug, Clone, Default)]
pub(super) struct Corridor {
    /// Whether columns are counted along y.
    turned: bool,
    start: Cell,
    goal: Cell,
    columns: usize,
    rows: usize,
    /// `[column][row]`.
    good: Vec<bool>,
}

impl Corridor {
    /// Looks at a query; whether there is a way.
    pub(super) fn prepare(&mut self, space: &GridSpace, start: u32, goal: u32) -> bool {
        (self.start, self.goal) = (space.cell(start), space.cell(goal));
        let (dx, dy) = (self.start.x.abs_diff(self.goal.x), self.start.y.abs_diff(self.goal.y));
        self.turned = dy > dx;
        let size = space.layout().map_or((0, 0), |layout| (layout.width(), layout.height()));
        self.columns = dx.max(dy) as usize + 1;
        self.rows = if self.turned { size.0 } else { size.1 };
        self.good.clear();
        self.good.resize(self.columns * self.rows, false);
        for column in (0..self.columns).rev() {
            // A run of open cells is good if the goal, or a good cell of the next column, lies beside it.
            let mut row = 0;
            while row < self.rows {
                let is_open = |row: usize| space.is_passable(self.node(space, column, row));
                let end = (row..self.rows).find(|&r| !is_open(r)).unwrap_or(self.rows);
                let leads = |r: usize| {
                    if column + 1 == self.columns { r == self.row_of(self.goal) } else { self.is_good(column + 1, r) }
                };
                if (row..end).any(leads) {
                    self.good[column * self.rows + row..column * self.rows + end].fill(true);
                }
                row = end + 1;
            }
        }
        self.is_good(0, self.row_of(self.start))
    }

    /// Columns that a position has a row for: all but the last, whose row is the goal's.
    pub(super) fn dimension(&self) -> usize {
        self.columns.saturating_sub(1)
    }

    /// Rows of the map.
    pub(super) fn rows(&self) -> f64 {
        self.rows as f64
    }

    /// Row of the straight line from start to goal in a column.
    fn straight(&self, column: usize) -> f64 {
        let (from, to) = (self.row_of(self.start) as f64, self.row_of(self.goal) as f64);
        from + (to - from) * column as f64 / self.dimension().max(1) as f64
    }

    /// The cells of the way that a position means, from start to goal.
    pub(super) fn way_into(&self, space: &GridSpace, position: &[f64], cells: &mut Vec<u32>) {
        cells.clear();
        let mut row = self.row_of(self.start);
        cells.push(self.node(space, 0, row));
        for (column, offset) in position.iter().enumerate().take(self.dimension()) {
            let wanted = self.straight(column) + offset;
            let leads = |r: usize| self.is_good(column, r) && self.is_good(column + 1, r);
            let off = |r: usize| (r as f64 - wanted).abs();
            // Both ways along the run of good cells.
            let up = (row..self.rows).take_while(|&r| self.is_good(column, r));
            let down = (0..row).rev().take_while(|&r| self.is_good(column, r));
            let exit = up.chain(down).filter(|&r| leads(r)).min_by(|&a, &b| off(a).total_cmp(&off(b)));
            let Some(exit) = exit else { return };
            self.run_into(space, column, row, exit, cells);
            row = exit;
            cells.push(self.node(space, column + 1, row));
        }
        self.run_into(space, self.dimension(), row, self.row_of(self.goal), cells);
    }

    /// The cells of a column behind `from`, up to and with `to`.
    fn run_into(&self, space: &GridSpace, column: usize, from: usize, to: usize, cells: &mut Vec<u32>) {
        if from < to {
            cells.extend((from + 1..=to).map(|row| self.node(space, column, row)));
        } else {
            cells.extend((to..from).rev().map(|row| self.node(space, column, row)));
        }
    }

    fn is_good(&self, column: usize, row: usize) -> bool {
        row < self.rows && self.good.get(column * self.rows + row).copied().unwrap_or(false)
    }

    fn row_of(&self, cell: Cell) -> usize {
        (if self.turned { cell.x } else { cell.y }) as usize
    }

    /// Node of a column and row; what is not in the map has none that is passable.
    fn node(&self, space: &GridSpace, column: usize, row: usize) -> u32 {
        let along = |from: i32, to: i32| from + (to - from).signum() * column as i32;
        let cell = if self.turned {
            Cell::new(row as i32, along(self.start.y, self.goal.y))
        } else {
            Cell::new(along(self.start.x, self.goal.x), row as i32)
        };
        space.node(cell).unwrap_or(u32::MAX)
    }
}

/// Leaves only the cells of a way that straight lines cannot do without, and returns its length, in cells: key nodes, as
/// [`KeyNodes`](crate::smooth::KeyNodes) has them, under the corner rule of the space.
pub(super) fn straighten(space: &GridSpace, cells: &[u32], way: &mut Vec<u32>) -> f64 {
    way.clear();
    let mut anchor = 0;
    way.extend(cells.first());
    while anchor + 1 < cells.len() {
        let seen = cells.iter().enumerate().skip(anchor + 2);
        let next = seen.take_while(|(_, node)| space.is_line_open(cells[anchor], **node)).last();
        anchor = next.map_or(anchor + 1, |(index, _)| index);
        way.push(cells[anchor]);
    }
    space.path_cost(way)
}
