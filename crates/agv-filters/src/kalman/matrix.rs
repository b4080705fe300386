//! Products and factors of small symmetric matrices, each entry computed once.
//!
//! Jacobians are mostly zeros and ones. A factor that is zero is skipped, which costs a comparison where it is only known at
//! run time, and nothing where the model is inlined and writes it as a constant. Hence the insistence on inlining: it halves
//! the time of a cycle.
#![expect(clippy::inline_always, reason = "constants of the models fold only where the loops are inlined")]

use agv_core::Error;
use nalgebra::{SMatrix, SVector};

/// `A B Aᵀ + C` of symmetric `B` and `C`; the lower triangle is computed and mirrored.
#[inline(always)]
pub(super) fn sandwich_plus<const N: usize, const M: usize>(
    a: &SMatrix<f64, N, M>,
    b: &SMatrix<f64, M, M>,
    c: &SMatrix<f64, N, N>,
) -> SMatrix<f64, N, N> {
    // (A B)ᵀ, since B is symmetric.
    let turned = times_transposed(b, a);
    let mut out = *c;
    for j in 0..N {
        for k in 0..M {
            let factor = a[(j, k)];
            if factor != 0.0 {
                for i in j..N {
                    out[(i, j)] += turned[(k, i)] * factor;
                }
            }
        }
    }
    mirrored(out)
}

/// `A Bᵀ + C`, known to be symmetric; the lower triangle is computed and mirrored.
#[inline(always)]
pub(super) fn lower_plus<const N: usize, const M: usize>(
    a: &SMatrix<f64, N, M>,
    b: &SMatrix<f64, N, M>,
    c: &SMatrix<f64, N, N>,
) -> SMatrix<f64, N, N> {
    let mut out = *c;
    for j in 0..N {
        for k in 0..M {
            let factor = b[(j, k)];
            for i in j..N {
                out[(i, j)] += a[(i, k)] * factor;
            }
        }
    }
    mirrored(out)
}

/// The lower triangle on both sides of the diagonal.
#[inline(always)]
fn mirrored<const N: usize>(mut matrix: SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    for j in 0..N {
        for i in j + 1..N {
            matrix[(j, i)] = matrix[(i, j)];
        }
    }
    matrix
}

/// `A Bᵀ`.
#[inline(always)]
pub(super) fn times_transposed<const N: usize, const K: usize, const M: usize>(
    a: &SMatrix<f64, N, K>,
    b: &SMatrix<f64, M, K>,
) -> SMatrix<f64, N, M> {
    let mut out = SMatrix::zeros();
    for j in 0..M {
        for k in 0..K {
            let factor = b[(j, k)];
            if factor != 0.0 {
                for i in 0..N {
                    out[(i, j)] += a[(i, k)] * factor;
                }
            }
        }
    }
    out
}

/// `A B + C`, known to be symmetric; the lower triangle is computed and mirrored.
#[inline(always)]
pub(super) fn product_plus<const N: usize, const M: usize>(
    a: &SMatrix<f64, M, N>,
    b: &SMatrix<f64, N, M>,
    c: &SMatrix<f64, M, M>,
) -> SMatrix<f64, M, M> {
    let mut out = *c;
    for j in 0..M {
        for i in j..M {
            for k in 0..N {
                let factor = a[(i, k)];
                if factor != 0.0 {
                    out[(i, j)] += factor * b[(k, j)];
                }
            }
        }
    }
    mirrored(out)
}

/// Joseph's `(I - K H) P (I - K H)ᵀ + K R Kᵀ`, from the left to the right: `B = P - K (P Hᵀ)ᵀ`, then `B - (B Hᵀ - K R) Kᵀ`.
/// With `M` columns in `K` that is three products of `N² M` instead of two of `N³`.
#[inline(always)]
pub(super) fn joseph<const N: usize, const M: usize>(
    covariance: &SMatrix<f64, N, N>,
    cross: &SMatrix<f64, N, M>,
    jacobian: &SMatrix<f64, M, N>,
    noise: &SMatrix<f64, M, M>,
    gain: &SMatrix<f64, N, M>,
) -> SMatrix<f64, N, N> {
    let mut left = *covariance;
    for k in 0..M {
        for j in 0..N {
            for i in 0..N {
                left[(i, j)] -= gain[(i, k)] * cross[(j, k)];
            }
        }
    }
    // The noise is symmetric.
    let rest = times_transposed(gain, noise) - times_transposed(&left, jacobian);
    lower_plus(&rest, gain, &left)
}

/// Whether all entries are finite, in one branch: nothing but NaN and the infinities is not zero times itself.
#[inline(always)]
pub(super) fn is_finite<const R: usize, const C: usize>(matrix: &SMatrix<f64, R, C>) -> bool {
    matrix.iter().fold(0.0, |sum, value| sum + value * 0.0) == 0.0
}

/// `S = L D Lᵀ` of a symmetric positive definite matrix, with ones on the diagonal of `L`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ldl<const M: usize> {
    lower: SMatrix<f64, M, M>,
    pivots: SVector<f64, M>,
    reciprocals: SVector<f64, M>,
}

impl<const M: usize> Ldl<M> {
    /// Factors the lower triangle.
    ///
    /// # Errors
    /// [`Error::NotCovariance`] if a pivot is no more than the rounding of its diagonal entry.
    #[inline(always)]
    pub(super) fn new(name: &'static str, matrix: &SMatrix<f64, M, M>) -> Result<Self, Error> {
        let mut lower = *matrix;
        let (mut pivots, mut reciprocals) = (SVector::zeros(), SVector::zeros());
        for j in 0..M {
            let pivot = lower[(j, j)];
            // Written so that NaN is refused as well.
            if !(pivot > f64::EPSILON * matrix[(j, j)] && pivot < f64::INFINITY) {
                return Err(Error::NotCovariance { name, pivot });
            }
            let reciprocal = 1.0 / pivot;
            (pivots[j], reciprocals[j]) = (pivot, reciprocal);
            for i in j + 1..M {
                let factor = lower[(i, j)] * reciprocal;
                for k in j + 1..=i {
                    lower[(i, k)] -= factor * lower[(k, j)];
                }
            }
            for i in j + 1..M {
                lower[(i, j)] *= reciprocal;
            }
        }
        Ok(Self { lower, pivots, reciprocals })
    }

    /// Factors a matrix that may be singular: a pivot that is no more than rounding counts as zero, and so does its
    /// reciprocal, so that dividing leaves out what the matrix says nothing of.
    pub(super) fn of_semidefinite(matrix: &SMatrix<f64, M, M>) -> Self {
        let mut lower = *matrix;
        let (mut pivots, mut reciprocals) = (SVector::zeros(), SVector::zeros());
        for j in 0..M {
            let pivot = lower[(j, j)];
            let reciprocal = if pivot > 1e-12 * matrix[(j, j)] { 1.0 / pivot } else { 0.0 };
            (pivots[j], reciprocals[j]) = (pivot, reciprocal);
            for i in j + 1..M {
                let factor = lower[(i, j)] * reciprocal;
                for k in j + 1..=i {
                    lower[(i, k)] -= factor * lower[(k, j)];
                }
            }
            for i in j + 1..M {
                lower[(i, j)] *= reciprocal;
            }
        }
        Self { lower, pivots, reciprocals }
    }

    /// `vᵀ S⁻¹ v`.
    #[inline(always)]
    pub(super) fn squared_norm(&self, v: &SVector<f64, M>) -> f64 {
        let (mut rest, mut sum) = (*v, 0.0);
        for j in 0..M {
            sum += rest[j] * rest[j] * self.reciprocals[j];
            for i in j + 1..M {
                rest[i] -= self.lower[(i, j)] * rest[j];
            }
        }
        sum
    }

    /// `W S⁻¹`, column by column.
    #[inline(always)]
    pub(super) fn right_divide<const N: usize>(&self, w: &SMatrix<f64, N, M>) -> SMatrix<f64, N, M> {
        let mut out = *w;
        for j in 0..M {
            for i in j + 1..M {
                for n in 0..N {
                    out[(n, i)] -= self.lower[(i, j)] * out[(n, j)];
                }
            }
        }
        for j in (0..M).rev() {
            for n in 0..N {
                out[(n, j)] *= self.reciprocals[j];
            }
            for i in j + 1..M {
                for n in 0..N {
                    out[(n, j)] -= self.lower[(i, j)] * out[(n, i)];
                }
            }
        }
        out
    }

    /// `ln det S`.
    pub(super) fn log_determinant(&self) -> f64 {
        self.pivots.iter().map(|pivot| pivot.ln()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix1x3, Matrix2, SMatrix, Vector3};
    use proptest::prelude::*;

    proptest! {
        /// Against nalgebra's general inverse.
        #[test]
        fn factors_divide_as_the_inverse_does(entries in prop::array::uniform9(-2.0..2.0_f64), w in prop::array::uniform9(-2.0..2.0_f64)) {
            let root = SMatrix::<f64, 3, 3>::from_row_slice(&entries);
            let spread = root * root.transpose() + SMatrix::identity() * 0.1;
            let (inverse, w) = (spread.try_inverse().unwrap(), SMatrix::<f64, 3, 3>::from_row_slice(&w));
            let factor = Ldl::new("spread", &spread).unwrap();
            prop_assert!((factor.right_divide(&w) - w * inverse).amax() < 1e-9);
            let v: Vector3<f64> = w.column(0).into();
            prop_assert!((factor.squared_norm(&v) - v.dot(&(inverse * v))).abs() < 1e-9);
            prop_assert!((factor.log_determinant() - spread.determinant().ln()).abs() < 1e-9);
            let sum = sandwich_plus(&w, &spread, &spread);
            prop_assert!((sum - (w * spread * w.transpose() + spread)).amax() < 1e-9);
            prop_assert_eq!(sum, sum.transpose());
        }
    }

    #[test]
    fn what_is_no_covariance_is_not_factored() {
        for bad in [[1.0, 2.0, 2.0, 1.0], [0.0, 0.0, 0.0, 1.0], [f64::NAN, 0.0, 0.0, 1.0], [1.0, f64::NAN, 0.0, 1.0]] {
            assert!(
                matches!(Ldl::new("s", &Matrix2::from_column_slice(&bad)), Err(Error::NotCovariance { .. })),
                "{bad:?}"
            );
        }
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(!is_finite(&Matrix1x3::new(0.0, bad, 1.0)));
        }
        assert!(is_finite(&Matrix1x3::new(0.0, -1e300, 1e300)));
    }
}
