//! Normal equations of graphs: the Hessian is sparse, in blocks of one size, or of two: poses first, then points.
//!
//! The lower half is held by columns, as [`faer`] factors it: sparse Cholesky in an order that keeps the fill small (approximate
//! minimum degree, Amestoy et al. 1996), found once for a pattern. Factoring is the simplicial kind, plain loops without
//! run-time dispatch: the same bits on every machine, and as fast as the blocked kind on graphs that are as thin as those of
//! vehicles.

use agv_core::{
    Error, check,
    solve::{FIXED, NormalSystem, diagonal_damping},
};
use faer::{
    Conj, MatMut, Par, Side,
    dyn_stack::{MemBuffer, MemStack},
    linalg::cholesky::llt::factor::LltRegularization,
    sparse::{
        SparseColMatRef, SymbolicSparseColMatRef,
        linalg::{
            SupernodalThreshold,
            cholesky::{
                CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
            },
        },
    },
};
use nalgebra::{SMatrix, SVector};

/// Sums whose Hessian has blocks where a pattern says so; keeps its memory, and the order of factoring while the pattern stays.
#[derive(Debug, Default)]
pub(crate) struct SparseNormalEquations {
    layout: Layout,
    /// Where the blocks of each block column begin in `rows`, the diagonal's first.
    starts: Vec<usize>,
    /// Block rows of the lower half, ascending in each column.
    rows: Vec<u32>,
    /// The scalar pattern.
    column_starts: Vec<usize>,
    row_indices: Vec<usize>,
    hessian: Vec<f64>,
    gradient: Vec<f64>,
    cost: f64,
    fault: Option<Error>,
    factor: Option<Factor>,
    /// Whether the factor is that of the Hessian as it stands.
    factored: bool,
}

/// Blocks of unknowns: `large` ones of `size` unknowns, then `small` ones of `small_size`.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Layout {
    pub(crate) size: usize,
    pub(crate) large: usize,
    pub(crate) small_size: usize,
    pub(crate) small: usize,
}

impl Layout {
    /// Blocks of one size.
    pub(crate) const fn uniform(size: usize, blocks: usize) -> Self {
        Self { size, large: blocks, small_size: size, small: 0 }
    }

    pub(super) const fn blocks(&self) -> usize {
        self.large + self.small
    }

    pub(super) const fn unknowns(&self) -> usize {
        self.first_of(self.blocks())
    }

    #[inline]
    const fn size_of(&self, block: usize) -> usize {
        if block < self.large { self.size } else { self.small_size }
    }

    /// The first unknown of a block.
    #[inline]
    pub(crate) const fn first_of(&self, block: usize) -> usize {
        if block <= self.large {
            block * self.size
        } else {
            self.large * self.size + (block - self.large) * self.small_size
        }
    }

    /// The block of an unknown, and its place there.
    #[inline]
    const fn split(&self, unknown: usize) -> (usize, usize) {
        let first_small = self.large * self.size;
        if unknown < first_small {
            (unknown / self.size, unknown % self.size)
        } else {
            let beyond = unknown - first_small;
            (self.large + beyond / self.small_size, beyond % self.small_size)
        }
    }
}

/// The order of factoring, and memory for it.
struct Factor {
    symbolic: SymbolicCholesky<usize>,
    /// The damped Hessian, and its factor.
    damped: Vec<f64>,
    values: Vec<f64>,
    memory: MemBuffer,
}

impl std::fmt::Debug for Factor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Factor").field("entries", &self.values.len()).finish_non_exhaustive()
    }
}

/// A pattern that the factoring has no room for.
const TOO_LARGE: Error = Error::TooMany { name: "entries of the factor", len: usize::MAX, max: isize::MAX as usize };

impl SparseNormalEquations {
    /// Makes them empty sums of the blocks of a layout, of which residuals tie those in `pairs`.
    ///
    /// The order of factoring is found anew if the pattern is another than before. O(pairs log pairs).
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a pair of blocks that are not there, [`Error::NotPositive`] for a size of zero, or
    /// [`Error::TooMany`] if there is no room for the factor.
    pub(crate) fn reset(&mut self, layout: Layout, pairs: impl IntoIterator<Item = (u32, u32)>) -> Result<(), Error> {
        check::positive("size", layout.size as f64)?;
        check::positive("size", layout.small_size as f64)?;
        let blocks = layout.blocks();
        let mut places: Vec<(u32, u32)> = (0..blocks as u32).map(|i| (i, i)).collect();
        for (a, b) in pairs {
            for block in [a, b] {
                check::in_range("block", f64::from(block), 0.0, blocks as f64 - 1.0)?;
            }
            places.push((a.min(b), a.max(b)));
        }
        places.sort_unstable();
        places.dedup();
        let same = self.factor.is_some()
            && (self.layout, self.rows.len()) == (layout, places.len())
            && places.iter().enumerate().all(|(i, &(column, row))| {
                self.rows[i] == row && (self.starts[column as usize]..self.starts[column as usize + 1]).contains(&i)
            });
        if !same {
            (self.layout, self.factor) = (layout, None);
            self.set_pattern(&places);
            self.factor = Some(Factor::new(layout.unknowns(), &self.column_starts, &self.row_indices)?);
        }
        self.clear();
        Ok(())
    }

    fn set_pattern(&mut self, places: &[(u32, u32)]) {
        let layout = self.layout;
        self.rows.clear();
        self.rows.extend(places.iter().map(|&(_, row)| row));
        self.starts.clear();
        self.starts.extend((0..=layout.blocks() as u32).map(|column| places.partition_point(|&(c, _)| c < column)));
        self.column_starts.clear();
        self.row_indices.clear();
        for column in 0..layout.blocks() {
            for inner in 0..layout.size_of(column) {
                self.column_starts.push(self.row_indices.len());
                for (i, &row) in self.rows[self.starts[column]..self.starts[column + 1]].iter().enumerate() {
                    let (skipped, start) = (if i == 0 { inner } else { 0 }, layout.first_of(row as usize));
                    self.row_indices.extend((skipped..layout.size_of(row as usize)).map(|r| start + r));
                }
            }
        }
        self.column_starts.push(self.row_indices.len());
        self.hessian.clear();
        self.hessian.resize(self.row_indices.len(), 0.0);
        self.gradient.clear();
        self.gradient.resize(layout.unknowns(), 0.0);
    }

    /// Where the block of a row and a column of the lower half is among the column's, if it has a place.
    #[inline]
    fn find(&self, row: u32, column: u32) -> Option<usize> {
        let (start, end) = (*self.starts.get(column as usize)?, *self.starts.get(column as usize + 1)?);
        self.rows[start..end].binary_search(&row).ok()
    }

    /// Index of an entry of the lower half: of the block at a place among its column's, which is that of a scalar column.
    #[inline]
    fn entry(&self, place: usize, inner_row: usize, block_column: usize, inner_column: usize) -> usize {
        let layout = self.layout;
        // The diagonal's block is cut at the diagonal.
        let skipped = if place == 0 {
            inner_row - inner_column
        } else {
            let above = if layout.small == 0 {
                place * layout.size
            } else {
                // Rows ascend, so that the small blocks of a column come last.
                let rows = &self.rows[self.starts[block_column]..self.starts[block_column] + place];
                let large = rows.partition_point(|&row| (row as usize) < layout.large);
                large * layout.size + (place - large) * layout.small_size
            };
            above - inner_column + inner_row
        };
        self.column_starts[layout.first_of(block_column) + inner_column] + skipped
    }

    /// Adds `product`, a matrix by columns with the sizes of the two blocks, to the block at (`row`, `column`), and its transpose to that at
    /// (`column`, `row`) if these differ.
    #[inline]
    pub(crate) fn add_block(&mut self, row: u32, column: u32, product: &[f64]) {
        let (low, high) = (row.min(column), row.max(column));
        let Some(place) = self.find(high, low) else {
            let max = self.layout.blocks().saturating_sub(1) as f64;
            self.fault.get_or_insert(Error::OutOfRange { name: "block", value: f64::from(high), min: 0.0, max });
            return;
        };
        let (rows, columns) = (self.layout.size_of(high as usize), self.layout.size_of(low as usize));
        self.factored = false;
        for c in 0..columns {
            let first = if place == 0 { c } else { 0 };
            let start = self.entry(place, first, low as usize, c);
            for (r, entry) in (first..rows).zip(&mut self.hessian[start..]) {
                // The lower half is asked for: where the product was said of the upper one, its transpose.
                *entry += if row >= column { product[c * rows + r] } else { product[r * columns + c] };
            }
        }
    }

    /// Adds to the gradient of a block.
    #[inline]
    pub(crate) fn add_gradient(&mut self, block: u32, slope: &[f64]) {
        let (first, size) = (self.layout.first_of(block as usize), self.layout.size_of(block as usize));
        if let Some(gradient) = self.gradient.get_mut(first..first + size) {
            gradient.iter_mut().zip(slope).for_each(|(sum, slope)| *sum += slope);
        }
    }

    /// Factors the Hessian as it stands, unless that was done, for [`substitute`](Self::substitute); false if it is not positive
    /// definite.
    pub(crate) fn factorize(&mut self) -> bool {
        let Some(factor) = &mut self.factor else { return self.gradient.is_empty() };
        if !self.factored {
            factor.damped.copy_from_slice(&self.hessian);
            self.factored = factor.factorize(&self.column_starts, &self.row_indices);
        }
        self.factored
    }

    /// Solves `H x = rhs` in place, with the Hessian that was factored last; false if the solution is not finite, or the length of
    /// `rhs` is not the number of unknowns.
    pub(crate) fn substitute(&mut self, rhs: &mut [f64]) -> bool {
        rhs.len() == self.gradient.len() && self.factor.as_mut().map_or(rhs.is_empty(), |factor| factor.substitute(rhs))
    }
}

impl Factor {
    fn new(dimension: usize, column_starts: &[usize], row_indices: &[usize]) -> Result<Self, Error> {
        let pattern = SymbolicSparseColMatRef::new_checked(dimension, dimension, column_starts, None, row_indices);
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SIMPLICIAL,
            ..CholeskySymbolicParams::default()
        };
        let symbolic =
            factorize_symbolic_cholesky(pattern, Side::Lower, SymmetricOrdering::Amd, params).map_err(|_| TOO_LARGE)?;
        let needed = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, faer::Spec::default());
        let needed = needed.or(symbolic.solve_in_place_scratch::<f64>(1, Par::Seq));
        let memory = MemBuffer::try_new(needed).map_err(|_| TOO_LARGE)?;
        let mut values = Vec::new();
        values.try_reserve_exact(symbolic.len_val()).map_err(|_| TOO_LARGE)?;
        values.resize(symbolic.len_val(), 0.0);
        Ok(Self { symbolic, damped: vec![0.0; row_indices.len()], values, memory })
    }

    /// Factors `damped`.
    fn factorize(&mut self, column_starts: &[usize], row_indices: &[usize]) -> bool {
        let dimension = column_starts.len() - 1;
        let pattern = SymbolicSparseColMatRef::new_checked(dimension, dimension, column_starts, None, row_indices);
        let matrix = SparseColMatRef::new(pattern, &self.damped);
        let stack = MemStack::new(&mut self.memory);
        let factored = self.symbolic.factorize_numeric_llt(
            &mut self.values,
            matrix,
            Side::Lower,
            LltRegularization::default(),
            Par::Seq,
            stack,
            faer::Spec::default(),
        );
        factored.is_ok()
    }

    /// Solves in place with the factor.
    fn substitute(&mut self, rhs: &mut [f64]) -> bool {
        let factor = LltRef::<usize, f64>::new(&self.symbolic, &self.values);
        let stack = MemStack::new(&mut self.memory);
        let rhs_len = rhs.len();
        let column = MatMut::from_column_major_slice_mut(rhs, rhs_len, 1);
        factor.solve_in_place_with_conj(Conj::No, column, Par::Seq, stack);
        rhs.iter().all(|v| v.is_finite())
    }
}

impl NormalSystem for SparseNormalEquations {
    fn dimension(&self) -> usize {
        self.gradient.len()
    }

    fn clear(&mut self) {
        self.hessian.fill(0.0);
        self.gradient.fill(0.0);
        (self.cost, self.fault, self.factored) = (0.0, None, false);
    }

    fn accumulate<const M: usize, const K: usize>(
        &mut self,
        unknowns: &[usize; K],
        residual: &SVector<f64, M>,
        jacobian: &SMatrix<f64, M, K>,
        weight: f64,
    ) {
        let outer = jacobian.transpose() * jacobian * weight;
        let slope = jacobian.transpose() * residual * weight;
        self.factored = false;
        for (i, &row) in unknowns.iter().enumerate().filter(|(_, row)| **row != FIXED) {
            if let Some(sum) = self.gradient.get_mut(row) {
                *sum += slope[i];
            }
            for (j, &column) in unknowns.iter().enumerate().take(i + 1).filter(|(_, column)| **column != FIXED) {
                let (low, high) = (row.min(column), row.max(column));
                let ((high_block, inner_row), (low_block, inner_column)) =
                    (self.layout.split(high), self.layout.split(low));
                if let Some(place) = self.find(high_block as u32, low_block as u32) {
                    let entry = self.entry(place, inner_row, low_block, inner_column);
                    self.hessian[entry] += outer[(i, j)];
                } else {
                    let max = self.dimension().saturating_sub(1) as f64;
                    let value = high as f64;
                    let absent = Error::OutOfRange { name: "unknown of a residual", value, min: 0.0, max };
                    self.fault.get_or_insert(absent);
                }
            }
        }
    }

    #[inline]
    fn add_cost(&mut self, cost: f64) {
        self.cost += cost;
    }

    #[inline]
    fn cost(&self) -> f64 {
        self.cost
    }

    #[inline]
    fn gradient(&self) -> &[f64] {
        &self.gradient
    }

    #[inline]
    fn diagonal(&self, unknown: usize) -> f64 {
        self.hessian[self.column_starts[unknown]]
    }

    fn check(&self) -> Result<(), Error> {
        self.fault.map_or(Ok(()), Err)?;
        check::finite("cost", self.cost)?;
        check::all_finite("gradient", &self.gradient)?;
        check::all_finite("hessian", &self.hessian)
    }

    fn solve_damped(&mut self, damping: f64, scale: &[f64], step: &mut [f64]) -> bool {
        let Some(factor) = &mut self.factor else { return step.is_empty() };
        self.factored = false;
        factor.damped.copy_from_slice(&self.hessian);
        for (&start, &scale) in self.column_starts.iter().zip(scale) {
            factor.damped[start] += diagonal_damping(damping, scale);
        }
        step.iter_mut().zip(&self.gradient).for_each(|(step, g)| *step = -g);
        factor.factorize(&self.column_starts, &self.row_indices) && factor.substitute(step)
    }
}

#[cfg(test)]
mod tests;
