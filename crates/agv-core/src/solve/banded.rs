//! Symmetric positive definite systems whose entries lie near the diagonal: chains of poses, bands, splines.
//!
//! `A = L D Lᵀ` without pivoting (Golub and Van Loan, *Matrix Computations*, section 4.3.5): for `n` unknowns and half
//! bandwidth `b` it costs `n b²` operations and no fill-in, against `n³/3` for a dense factor.

use crate::{Error, check};

/// A symmetric matrix of which only the lower half of a band is stored.
///
/// ```
/// use agv_core::solve::{BandedCholesky, BandedMatrix};
///
/// // -1 2 -1 in each row: a chain of springs.
/// let mut chain = BandedMatrix::new(4, 1);
/// for i in 0..4 {
///     *chain.entry(i, i).unwrap() += 2.0;
///     if i > 0 {
///         *chain.entry(i, i - 1).unwrap() -= 1.0;
///     }
/// }
/// let mut factor = BandedCholesky::new();
/// factor.factor(&chain)?;
/// let mut x = [1.0, 0.0, 0.0, 1.0];
/// factor.solve(&mut x)?;
/// assert!(x.iter().all(|v| (v - 1.0).abs() < 1e-12));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct BandedMatrix {
    dimension: usize,
    half_bandwidth: usize,
    /// Column by column, each from its diagonal entry downwards, `half_bandwidth + 1` long; what would lie below the
    /// last row is zero.
    columns: Vec<f64>,
}

impl BandedMatrix {
    /// A zero matrix of `dimension` rows with `half_bandwidth` diagonals below the main one.
    pub fn new(dimension: usize, half_bandwidth: usize) -> Self {
        let mut matrix = Self::default();
        matrix.reset(dimension, half_bandwidth);
        matrix
    }

    /// Makes it a zero matrix of another size, keeping its memory.
    pub fn reset(&mut self, dimension: usize, half_bandwidth: usize) {
        (self.dimension, self.half_bandwidth) = (dimension, half_bandwidth);
        self.columns.clear();
        self.columns.resize(dimension * (half_bandwidth + 1), 0.0);
    }

    /// Number of rows.
    pub const fn dimension(&self) -> usize {
        self.dimension
    }

    /// Diagonals below the main one.
    pub const fn half_bandwidth(&self) -> usize {
        self.half_bandwidth
    }

    /// The stored entry of a row and a column; `None` above the diagonal, below the band or outside of the matrix.
    #[inline]
    pub fn entry(&mut self, row: usize, column: usize) -> Option<&mut f64> {
        let below = row.checked_sub(column)?;
        if below > self.half_bandwidth || row >= self.dimension {
            return None;
        }
        self.columns.get_mut(column * (self.half_bandwidth + 1) + below)
    }

    /// Adds a symmetric block whose first row and column is `first`, of which the upper half is read; what lies outside of the
    /// matrix or below the band is left out.
    #[inline]
    pub fn add_block<const K: usize>(&mut self, first: usize, block: &[[f64; K]; K]) {
        let width = self.half_bandwidth + 1;
        let columns = self.columns.chunks_exact_mut(width).skip(first);
        for (j, (column, row)) in columns.zip(block).enumerate() {
            let below = self.dimension - first - j;
            for (entry, value) in column.iter_mut().take(below).zip(&row[j..]) {
                *entry += value;
            }
        }
    }

    /// Ties an unknown to its place: its row and column become those of the unit matrix.
    pub fn pin(&mut self, unknown: usize) {
        for column in unknown.saturating_sub(self.half_bandwidth)..=unknown {
            if let Some(entry) = self.entry(unknown, column) {
                *entry = 0.0;
            }
        }
        for row in unknown + 1..=unknown + self.half_bandwidth {
            if let Some(entry) = self.entry(row, unknown) {
                *entry = 0.0;
            }
        }
        if let Some(entry) = self.entry(unknown, unknown) {
            *entry = 1.0;
        }
    }

    /// A diagonal entry; zero outside of the matrix.
    pub(super) fn diagonal(&self, row: usize) -> f64 {
        self.columns.get(row * (self.half_bandwidth + 1)).copied().unwrap_or(0.0)
    }

    /// All stored entries.
    pub(super) fn entries(&self) -> &[f64] {
        &self.columns
    }

    /// `y = A x`.
    ///
    /// # Errors
    /// [`Error::LengthMismatch`].
    pub fn multiply_into(&self, x: &[f64], y: &mut [f64]) -> Result<(), Error> {
        check::length("x", x.len(), self.dimension)?;
        check::length("y", y.len(), self.dimension)?;
        y.fill(0.0);
        for (j, column) in self.columns.chunks_exact(self.half_bandwidth + 1).enumerate() {
            for (entry, i) in column.iter().zip(j..self.dimension) {
                y[i] += entry * x[j];
                if i != j {
                    y[j] += entry * x[i];
                }
            }
        }
        Ok(())
    }
}

/// The factor of a [`BandedMatrix`], which solves systems with it. Keeps its memory from one factor to the next.
#[derive(Debug, Clone, Default)]
pub struct BandedCholesky {
    dimension: usize,
    half_bandwidth: usize,
    /// Length of a column in memory: the band, filled up with zeros to a width that has its own unrolled loops.
    stride: usize,
    /// The unit triangle `L`, with `1/D` in place of its diagonal, column by column; behind it as many zero columns as
    /// an elimination step reaches, so that it need not look where the matrix ends.
    columns: Vec<f64>,
    /// Copy of the column that is being eliminated, before it is divided by its pivot.
    pivot_column: Vec<f64>,
    ready: bool,
}

impl BandedCholesky {
    /// A solver without a factor yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Factors `A`, in `O(n b²)`; allocates only if `A` is larger than any before.
    ///
    /// # Errors
    /// [`Error::Singular`] with the pivot and its row, if `A` is not positive definite up to rounding or not finite;
    /// there is then no factor.
    pub fn factor(&mut self, matrix: &BandedMatrix) -> Result<(), Error> {
        self.factor_damped(matrix, 0.0)
    }

    /// Factors `A + damping I`, as Levenberg's method asks for.
    ///
    /// # Errors
    /// As [`factor`](Self::factor).
    pub fn factor_damped(&mut self, matrix: &BandedMatrix, damping: f64) -> Result<(), Error> {
        self.factor_shifted(matrix, |_| damping)
    }

    /// Factors `A` with something added to each diagonal entry.
    pub(super) fn factor_shifted(&mut self, matrix: &BandedMatrix, shift: impl Fn(usize) -> f64) -> Result<(), Error> {
        self.ready = false;
        (self.dimension, self.half_bandwidth) = (matrix.dimension, matrix.half_bandwidth);
        let width = self.half_bandwidth + 1;
        self.stride = if width <= 16 { width.next_multiple_of(4) } else { width };
        self.columns.clear();
        self.columns.resize((self.dimension + self.stride) * self.stride, 0.0);
        let columns = self.columns.chunks_exact_mut(self.stride).zip(matrix.columns.chunks_exact(width));
        for (row, (to, from)) in columns.enumerate() {
            to[..width].copy_from_slice(from);
            to[0] += shift(row);
        }
        match self.stride {
            4 => eliminate_unrolled::<4>(&mut self.columns, self.dimension),
            8 => eliminate_unrolled::<8>(&mut self.columns, self.dimension),
            12 => eliminate_unrolled::<12>(&mut self.columns, self.dimension),
            16 => eliminate_unrolled::<16>(&mut self.columns, self.dimension),
            _ => eliminate(&mut self.columns, self.dimension, self.stride, &mut self.pivot_column),
        }
        .map_err(|(row, pivot)| Error::Singular { name: "banded matrix", row, pivot })?;
        // What elimination leaves of a singular matrix is rounding of the size of its diagonal.
        for (row, (l, a)) in self.columns.chunks_exact(self.stride).zip(matrix.columns.chunks_exact(width)).enumerate()
        {
            let (pivot, size) = (1.0 / l[0], a[0].abs() + shift(row));
            if pivot <= 4.0 * f64::EPSILON * size {
                return Err(Error::Singular { name: "banded matrix", row, pivot });
            }
        }
        self.ready = true;
        Ok(())
    }

    /// Solves `A x = b` in place: `b` goes in, `x` comes out, in `O(n b)`.
    ///
    /// # Errors
    /// [`Error::LengthMismatch`], or [`Error::Empty`] if there is no factor; `b` is then as it was.
    pub fn solve(&self, b: &mut [f64]) -> Result<(), Error> {
        if !self.ready {
            return Err(Error::Empty { name: "banded factor" });
        }
        check::length("right-hand side", b.len(), self.dimension)?;
        let columns = || self.columns.chunks_exact(self.stride).take(self.dimension);
        // L y = b, column by column.
        let mut rest = &mut *b;
        for column in columns() {
            let Some((&mut value, below)) = rest.split_first_mut() else { break };
            for (b, l) in below.iter_mut().zip(&column[1..]) {
                *b -= l * value;
            }
            rest = below;
        }
        // D Lᵀ x = y, from the last row upwards. Each sum ends with the unknown that was found last, so that the
        // processor need not wait for it at the start.
        for (row, column) in columns().enumerate().rev() {
            let known = b.len().min(row + self.half_bandwidth + 1);
            let sum = (row + 1..known).rev().fold(0.0, |sum, i| sum + column[i - row] * b[i]);
            b[row] = b[row] * column[0] - sum;
        }
        Ok(())
    }
}

/// `1 / pivot`, or the row and the pivot of a matrix that is not positive definite.
#[inline]
fn reciprocal(row: usize, pivot: f64) -> Result<f64, (usize, f64)> {
    if pivot > 0.0 && pivot < f64::INFINITY { Ok(1.0 / pivot) } else { Err((row, pivot)) }
}

/// `L D Lᵀ` in place; each column in turn is divided by its pivot, and those behind it lose the outer product.
fn eliminate(columns: &mut [f64], dimension: usize, stride: usize, copy: &mut Vec<f64>) -> Result<(), (usize, f64)> {
    let mut rest = columns;
    for row in 0..dimension {
        let (column, below) = rest.split_at_mut(stride);
        copy.clear();
        copy.extend_from_slice(column);
        let inverse = reciprocal(row, column[0])?;
        for v in column.iter_mut() {
            *v *= inverse;
        }
        column[0] = inverse;
        for (k, target) in (1..stride).zip(below.chunks_exact_mut(stride)) {
            let lower = column[k];
            target.iter_mut().zip(&copy[k..]).for_each(|(t, c)| *t -= lower * c);
        }
        rest = below;
    }
    Ok(())
}

/// [`eliminate`] for a width known to the compiler, with the same operations in the same order.
fn eliminate_unrolled<const W: usize>(columns: &mut [f64], dimension: usize) -> Result<(), (usize, f64)> {
    let (mut rest, _) = columns.as_chunks_mut::<W>();
    for row in 0..dimension {
        let Some((column, below)) = rest.split_first_mut() else { break };
        let copy = *column;
        let inverse = reciprocal(row, copy[0])?;
        let scaled = copy.map(|v| v * inverse);
        *column = scaled;
        column[0] = inverse;
        let targets = &mut below[..W - 1]; // the zero columns at the end make it fit
        for k in 1..W {
            for i in 0..W - k {
                targets[k - 1][i] -= scaled[k] * copy[k + i];
            }
        }
        rest = below;
    }
    Ok(())
}

#[cfg(test)]
#[expect(clippy::disallowed_types, reason = "the dense reference")]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    proptest! {
        /// Any banded Gram matrix plus a little of the unit matrix, against a dense factor.
        #[test]
        fn dense_cholesky_agrees(
            n in 1..30_usize,
            band in 0..20_usize,
            entries in prop::collection::vec(-1.0..1.0_f64, 30 * 20),
            rhs in prop::collection::vec(-1.0..1.0_f64, 30),
        ) {
            let root = DMatrix::from_fn(n, n, |i, j| if i >= j && i - j <= band { entries[i * 20 + (i - j)] } else { 0.0 });
            let dense = &root * root.transpose() + DMatrix::identity(n, n) * 0.1;
            let mut matrix = BandedMatrix::new(n, band);
            for i in 0..n {
                for j in i.saturating_sub(band)..=i {
                    *matrix.entry(i, j).unwrap() = dense[(i, j)];
                }
            }
            let mut x = rhs[..n].to_vec();
            let mut factor = BandedCholesky::new();
            factor.factor(&matrix).unwrap();
            factor.solve(&mut x).unwrap();
            let expected = dense.cholesky().unwrap().solve(&DVector::from_column_slice(&rhs[..n]));
            prop_assert!((DVector::from_column_slice(&x) - &expected).norm() < 1e-12 * (1.0 + expected.norm()));
            let mut product = vec![0.0; n];
            matrix.multiply_into(&x, &mut product).unwrap();
            prop_assert!(product.iter().zip(&rhs).all(|(p, b)| (p - b).abs() < 1e-11));
        }
    }

    #[test]
    fn singular_and_broken_matrices_are_named() {
        let mut factor = BandedCholesky::new();
        assert!(matches!(factor.solve(&mut []), Err(Error::Empty { .. })));
        // A free chain: positive semi-definite, its last pivot vanishes.
        let mut chain = BandedMatrix::new(5, 2);
        for i in 1..5 {
            *chain.entry(i, i).unwrap() += 0.3;
            *chain.entry(i - 1, i - 1).unwrap() += 0.3;
            *chain.entry(i, i - 1).unwrap() -= 0.3;
        }
        assert!(matches!(factor.factor(&chain), Err(Error::Singular { row: 4, .. })));
        assert!(factor.solve(&mut [0.0; 5]).is_err(), "no factor is left behind");
        assert!(factor.factor_damped(&chain, 1e-3).is_ok());
        assert!(matches!(factor.solve(&mut [0.0; 4]), Err(Error::LengthMismatch { .. })));
        for bad in [f64::NAN, f64::INFINITY, -1.0, 0.0] {
            *chain.entry(2, 2).unwrap() = bad;
            assert!(matches!(factor.factor(&chain), Err(Error::Singular { row: 2, .. })), "{bad}");
        }
        for (row, column) in [(0, 1), (3, 0), (5, 4), (5, 5)] {
            assert_eq!(chain.entry(row, column), None, "{row} {column}");
        }
    }

    /// Blocks add up to the entries they were added to one by one, cut at the end; a pinned unknown does not move.
    #[test]
    fn blocks_are_added_and_unknowns_pinned() {
        let block = [[4.0, 1.0, 0.5], [f64::NAN, 5.0, 0.25], [f64::NAN, f64::NAN, 6.0]];
        let mut matrix = BandedMatrix::new(4, 2);
        for first in 0..4 {
            matrix.add_block(first, &block);
        }
        let expected = [[4.0, 0.0, 0.0, 0.0], [1.0, 9.0, 0.0, 0.0], [0.5, 1.25, 15.0, 0.0], [0.0, 0.5, 1.25, 15.0]];
        for (i, row) in expected.iter().enumerate() {
            for (j, &value) in row.iter().enumerate().take(i + 1).skip(i.saturating_sub(2)) {
                assert_eq!(matrix.entry(i, j).copied(), Some(value), "{i} {j}");
            }
        }
        matrix.pin(1);
        let mut x = [0.0, 0.0, 1.0, 2.0];
        let mut factor = BandedCholesky::new();
        factor.factor(&matrix).unwrap();
        factor.solve(&mut x).unwrap();
        assert_eq!(x[1], 0.0);
        let mut back = [0.0; 4];
        matrix.multiply_into(&x, &mut back).unwrap();
        assert!(back.iter().zip([0.0, 0.0, 1.0, 2.0]).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn empty_and_diagonal_systems_are_systems() {
        let mut factor = BandedCholesky::new();
        factor.factor(&BandedMatrix::new(0, 3)).unwrap();
        factor.solve(&mut []).unwrap();
        let mut diagonal = BandedMatrix::new(2, 0);
        *diagonal.entry(0, 0).unwrap() = 2.0;
        *diagonal.entry(1, 1).unwrap() = 4.0;
        factor.factor(&diagonal).unwrap();
        let mut x = [2.0, 2.0];
        factor.solve(&mut x).unwrap();
        assert_eq!(x, [1.0, 0.5]);
    }
}
