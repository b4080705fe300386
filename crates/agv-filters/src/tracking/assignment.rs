//! Which of few belongs to which: the assignment of least cost.
//!
//! Pairs beyond the gate are left out, what is left falls into groups that share no row or column, and each group is solved
//! by the Hungarian method with shortest augmenting paths (Jonker and Volgenant 1987, *A shortest augmenting path algorithm
//! for dense and sparse linear assignment problems*). Not to be assigned costs a row as much as the gate: as many rows as
//! possible are assigned that do better, at the least sum.

/// Solves assignments, and keeps its memory for the next.
///
/// ```
/// use agv_filters::tracking::Assignment;
///
/// let mut assignment = Assignment::default();
/// // Row 0 would take column 0, but row 1 has no other.
/// assignment.solve(3, 2, 9.0, [(0, 0, 1.0), (0, 1, 2.0), (1, 0, 1.5), (2, 1, 20.0)]);
/// assert_eq!(assignment.column_of(), [Some(1), Some(0), None]);
/// ```
#[derive(Debug, Clone, Default)]
pub struct Assignment {
    pairs: Vec<Pair>,
    column_of: Vec<Option<usize>>,
    /// Group of each row, then of each column: the least node that it is connected with.
    group: Vec<usize>,
    rows: Vec<usize>,
    columns: Vec<usize>,
    costs: Vec<f64>,
    row_price: Vec<f64>,
    column_price: Vec<f64>,
    row_of: Vec<usize>,
    way: Vec<usize>,
    least: Vec<f64>,
    done: Vec<bool>,
}

#[derive(Debug, Clone, Copy)]
struct Pair {
    row: usize,
    column: usize,
    cost: f64,
    group: usize,
}

impl Assignment {
    /// Assigns columns to rows: `pairs` are (row, column, cost), the others may not be. Costs from `gate` on, those that are no
    /// numbers, and pairs of a row or column that there is not are left out.
    ///
    /// O(rows + columns + p log p) for p pairs, and O(r² (r + c)) for each group of r rows and c columns.
    pub fn solve(
        &mut self,
        rows: usize,
        columns: usize,
        gate: f64,
        pairs: impl IntoIterator<Item = (usize, usize, f64)>,
    ) {
        self.pairs.clear();
        let may_be = pairs.into_iter().filter(|&(row, column, cost)| row < rows && column < columns && cost < gate);
        self.pairs.extend(may_be.map(|(row, column, cost)| Pair { row, column, cost, group: row }));
        self.column_of.clear();
        self.column_of.resize(rows, None);
        self.group.clear();
        self.group.extend(0..rows + columns);
        for index in 0..self.pairs.len() {
            let Pair { row, column, .. } = self.pairs[index];
            let (a, b) = (self.root(row), self.root(rows + column));
            let (low, high) = (a.min(b), a.max(b));
            self.group[high] = low;
        }
        for index in 0..self.pairs.len() {
            self.pairs[index].group = self.root(self.pairs[index].row);
        }
        let mut pairs = std::mem::take(&mut self.pairs);
        pairs.sort_unstable_by_key(|pair| pair.group);
        for group in pairs.chunk_by(|a, b| a.group == b.group) {
            self.solve_group(group, gate);
        }
        self.pairs = pairs;
    }

    /// The column of each row, none if it is left alone.
    pub fn column_of(&self) -> &[Option<usize>] {
        &self.column_of
    }

    fn root(&mut self, mut node: usize) -> usize {
        while self.group[node] != node {
            self.group[node] = self.group[self.group[node]];
            node = self.group[node];
        }
        node
    }

    fn solve_group(&mut self, pairs: &[Pair], gate: f64) {
        let (mut rows, mut columns) = (std::mem::take(&mut self.rows), std::mem::take(&mut self.columns));
        rows.clear();
        rows.extend(pairs.iter().map(|pair| pair.row));
        columns.clear();
        columns.extend(pairs.iter().map(|pair| pair.column));
        for nodes in [&mut rows, &mut columns] {
            nodes.sort_unstable();
            nodes.dedup();
        }
        // A column of its own for every row, at the gate's cost, stands for being left alone.
        let width = columns.len() + rows.len();
        self.costs.clear();
        self.costs.resize(rows.len() * width, f64::INFINITY);
        for pair in pairs {
            if let (Ok(i), Ok(j)) = (rows.binary_search(&pair.row), columns.binary_search(&pair.column)) {
                let slot = &mut self.costs[i * width + j];
                *slot = slot.min(pair.cost);
            }
        }
        for i in 0..rows.len() {
            self.costs[i * width + columns.len() + i] = gate;
        }
        self.augment(rows.len(), width);
        for (j, &column) in columns.iter().enumerate() {
            if let Some(&row) = self.row_of.get(j + 1).and_then(|&i| i.checked_sub(1)).and_then(|i| rows.get(i)) {
                self.column_of[row] = Some(column);
            }
        }
        (self.rows, self.columns) = (rows, columns);
    }

    /// The method itself, on a dense table of costs of no fewer columns than rows; rows and columns are counted from one.
    fn augment(&mut self, height: usize, width: usize) {
        for (values, len) in [(&mut self.row_price, height + 1), (&mut self.column_price, width + 1)] {
            values.clear();
            values.resize(len, 0.0);
        }
        for places in [&mut self.row_of, &mut self.way] {
            places.clear();
            places.resize(width + 1, 0);
        }
        for row in 1..=height {
            self.row_of[0] = row;
            let mut column = 0;
            self.least.clear();
            self.least.resize(width + 1, f64::INFINITY);
            self.done.clear();
            self.done.resize(width + 1, false);
            loop {
                self.done[column] = true;
                let owner = self.row_of[column];
                let (mut step, mut next) = (f64::INFINITY, 0);
                for j in 1..=width {
                    if self.done[j] {
                        continue;
                    }
                    let reduced =
                        self.costs[(owner - 1) * width + j - 1] - self.row_price[owner] - self.column_price[j];
                    if reduced < self.least[j] {
                        (self.least[j], self.way[j]) = (reduced, column);
                    }
                    if self.least[j] < step {
                        (step, next) = (self.least[j], j);
                    }
                }
                for j in 0..=width {
                    if self.done[j] {
                        self.row_price[self.row_of[j]] += step;
                        self.column_price[j] -= step;
                    } else {
                        self.least[j] -= step;
                    }
                }
                column = next;
                // Every row has a column of its own, so that the way always ends.
                if column == 0 || self.row_of[column] == 0 {
                    break;
                }
            }
            while column != 0 {
                let before = self.way[column];
                self.row_of[column] = self.row_of[before];
                column = before;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The least cost over all ways to assign, by trying them.
    fn least(rows: &[Vec<f64>], gate: f64, taken: &mut Vec<bool>) -> f64 {
        let Some((row, rest)) = rows.split_first() else { return 0.0 };
        let mut best = gate + least(rest, gate, taken);
        for (column, &cost) in row.iter().enumerate() {
            if !taken[column] && cost < gate {
                taken[column] = true;
                best = best.min(cost + least(rest, gate, taken));
                taken[column] = false;
            }
        }
        best
    }

    proptest! {
        #[test]
        fn no_other_assignment_costs_less(
            costs in prop::collection::vec(prop::collection::vec(0.0..12.0_f64, 5), 0..6),
            again in prop::collection::vec(prop::collection::vec(0.0..20.0_f64, 5), 0..6),
        ) {
            let mut assignment = Assignment::default();
            for table in [&costs, &again] {
                let pairs = table.iter().enumerate().flat_map(|(i, row)| row.iter().enumerate().map(move |(j, &c)| (i, j, c)));
                assignment.solve(table.len(), 5, 8.0, pairs);
                let mut taken = [false; 5];
                let mut sum = 0.0;
                for (i, column) in assignment.column_of().iter().enumerate() {
                    sum += column.map_or(8.0, |j| table[i][j]);
                    if let Some(j) = column {
                        prop_assert!(!taken[*j] && table[i][*j] < 8.0);
                        taken[*j] = true;
                    }
                }
                prop_assert!((sum - least(table, 8.0, &mut vec![false; 5])).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn groups_are_solved_each_by_itself() {
        // Rows 2k and 2k + 1 want column 2k; the second of them has another. Pairs come in no order.
        let pairs = (0..60).map(|k| (k * 7) % 60).flat_map(|row| {
            let column = row - row % 2;
            let other = (row % 2 == 1).then_some((row, row, 3.0));
            [Some((row, column, 1.0)), other].into_iter().flatten()
        });
        let mut assignment = Assignment::default();
        assignment.solve(60, 60, 9.0, pairs);
        assert!(assignment.column_of().iter().enumerate().all(|(row, column)| *column == Some(row)));
    }

    #[test]
    fn what_cannot_be_is_left_out() {
        let mut assignment = Assignment::default();
        assignment.solve(2, 1, 5.0, [(0, 0, f64::NAN), (7, 0, 1.0), (1, 3, 1.0), (1, 0, 5.0)]);
        assert_eq!(assignment.column_of(), [None, None]);
        assignment.solve(0, 0, 5.0, []);
        assert!(assignment.column_of().is_empty());
    }
}
