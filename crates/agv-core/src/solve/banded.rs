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
    /// The unit triangle `L` with `1/D` in place of its diagonal, laid out as the matrix.
    factor: BandedMatrix,
    /// Column that is being eliminated, before it is divided by its pivot.
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
        let (dimension, band) = (matrix.dimension, matrix.half_bandwidth);
        self.ready = false;
        (self.factor.dimension, self.factor.half_bandwidth) = (dimension, band);
        self.factor.columns.clear();
        self.factor.columns.extend_from_slice(&matrix.columns);
        self.pivot_column.clear();
        self.pivot_column.resize(band, 0.0);

        let mut rest = self.factor.columns.as_mut_slice();
        for row in 0..dimension {
            let (column, below) = rest.split_at_mut(band + 1);
            let Some((diagonal, column)) = column.split_first_mut() else { break };
            let pivot = *diagonal + damping;
            // What elimination leaves of a singular matrix is rounding of the size of its diagonal.
            let size = matrix.columns[row * (band + 1)].abs() + damping;
            if !(pivot > 4.0 * f64::EPSILON * size && pivot < f64::INFINITY) {
                return Err(Error::Singular { name: "banded matrix", row, pivot });
            }
            let inverse = 1.0 / pivot;
            *diagonal = inverse;
            self.pivot_column.copy_from_slice(column);
            column.iter_mut().for_each(|v| *v *= inverse);
            // The trailing columns lose the outer product of this one with itself.
            for ((k, target), &lower) in below.chunks_exact_mut(band + 1).enumerate().zip(column.iter()) {
                for (t, p) in target.iter_mut().zip(&self.pivot_column[k..]) {
                    *t -= lower * p;
                }
            }
            rest = below;
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
        check::length("right-hand side", b.len(), self.factor.dimension)?;
        let width = self.factor.half_bandwidth + 1;
        // L y = b, column by column.
        let mut rest = &mut *b;
        for column in self.factor.columns.chunks_exact(width) {
            let Some((&mut value, below)) = rest.split_first_mut() else { break };
            below.iter_mut().zip(&column[1..]).for_each(|(b, l)| *b -= l * value);
            rest = below;
        }
        // D Lᵀ x = y, from the last row upwards.
        for (row, column) in self.factor.columns.chunks_exact(width).enumerate().rev() {
            let sum: f64 = column[1..].iter().zip(&b[row + 1..]).map(|(l, x)| l * x).sum();
            b[row] = b[row] * column[0] - sum;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    proptest! {
        /// Any banded Gram matrix plus a little of the unit matrix, against a dense factor.
        #[test]
        fn dense_cholesky_agrees(
            n in 1..30_usize,
            band in 0..7_usize,
            entries in prop::collection::vec(-1.0..1.0_f64, 30 * 7),
            rhs in prop::collection::vec(-1.0..1.0_f64, 30),
        ) {
            let root = DMatrix::from_fn(n, n, |i, j| if i >= j && i - j <= band { entries[i * 7 + (i - j)] } else { 0.0 });
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
