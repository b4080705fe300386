//! Eigenvalues of symmetric 3x3 matrices by cyclic Jacobi rotations (Golub and Van Loan, *Matrix computations*, section 8.5):
//! accurate for the flattest surface.

use nalgebra::{Matrix3, Vector3};

/// Eigenvalues from the least to the greatest, and their eigenvectors in the columns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SymmetricEigen {
    pub(crate) values: Vector3<f64>,
    pub(crate) vectors: Matrix3<f64>,
}

impl SymmetricEigen {
    /// Decomposes a finite symmetric matrix; the lower half counts.
    pub(crate) fn new(matrix: &Matrix3<f64>) -> Self {
        let (mut a, mut v) = (*matrix, Matrix3::identity());
        // Convergence is quadratic: four sweeps leave rounding of any matrix that was met, six of all.
        for _ in 0..6 {
            let off = a.m21 * a.m21 + a.m31 * a.m31 + a.m32 * a.m32;
            if off <= 1e-28 * (a.m11 * a.m11 + a.m22 * a.m22 + a.m33 * a.m33) {
                break;
            }
            for (p, q, r) in [(0, 1, 2), (0, 2, 1), (1, 2, 0)] {
                rotate(&mut a, &mut v, p, q, r);
            }
        }
        let mut order = [0, 1, 2];
        let value = |i: usize| a[(i, i)];
        order.sort_unstable_by(|&i, &j| value(i).total_cmp(&value(j)));
        Self {
            values: Vector3::from_fn(|i, _| value(order[i])),
            vectors: Matrix3::from_fn(|row, column| v[(row, order[column])]),
        }
    }

    /// The matrix with the same eigenvectors and other eigenvalues.
    pub(crate) fn with_values(&self, values: &Vector3<f64>) -> Matrix3<f64> {
        let v = &self.vectors;
        let entry = |i: usize, j: usize| (0..3).map(|k| v[(i, k)] * values[k] * v[(j, k)]).sum::<f64>();
        let (a, b, c) = (entry(1, 0), entry(2, 0), entry(2, 1));
        Matrix3::new(entry(0, 0), a, b, a, entry(1, 1), c, b, c, entry(2, 2))
    }
}

/// Makes the entry (q, p) vanish.
#[inline]
fn rotate(a: &mut Matrix3<f64>, v: &mut Matrix3<f64>, p: usize, q: usize, r: usize) {
    let off = a[(q, p)];
    if off == 0.0 {
        return;
    }
    let theta = (a[(q, q)] - a[(p, p)]) / (2.0 * off);
    let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let c = 1.0 / (t * t + 1.0).sqrt();
    let s = t * c;
    a[(p, p)] -= t * off;
    a[(q, q)] += t * off;
    a[(q, p)] = 0.0;
    let at = |i: usize, j: usize| if i > j { (i, j) } else { (j, i) };
    let (rp, rq) = (a[at(r, p)], a[at(r, q)]);
    a[at(r, p)] = c * rp - s * rq;
    a[at(r, q)] = s * rp + c * rq;
    for row in 0..3 {
        let (vp, vq) = (v[(row, p)], v[(row, q)]);
        v[(row, p)] = c * vp - s * vq;
        v[(row, q)] = s * vp + c * vq;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Any symmetric matrix, scales far apart included, is what its eigenvalues and vectors say.
        #[test]
        fn the_matrix_is_recomposed(entries in prop::array::uniform6(-1.0..1.0_f64), scale in -6.0..6.0_f64, flat in -8.0..0.0_f64) {
            let [a, b, c, d, e, f] = entries;
            let squeeze = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 10_f64.powf(flat)));
            let matrix = squeeze * Matrix3::new(a, b, c, b, d, e, c, e, f) * squeeze * 10_f64.powf(scale);
            let eigen = SymmetricEigen::new(&matrix);
            prop_assert!((eigen.with_values(&eigen.values) - matrix).norm() <= 1e-13 * matrix.norm());
            prop_assert!((eigen.vectors.transpose() * eigen.vectors - Matrix3::identity()).norm() < 1e-13);
            prop_assert!(eigen.values[0] <= eigen.values[1] && eigen.values[1] <= eigen.values[2]);
        }
    }

    #[test]
    fn diagonal_and_zero_matrices_are_themselves() {
        let eigen = SymmetricEigen::new(&Matrix3::from_diagonal(&Vector3::new(3.0, 1.0, 2.0)));
        assert_eq!(eigen.values, Vector3::new(1.0, 2.0, 3.0));
        assert_eq!(SymmetricEigen::new(&Matrix3::zeros()).values, Vector3::zeros());
    }
}
