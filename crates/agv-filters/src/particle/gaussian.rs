//! Draws around a pose.

use agv_core::{
    compute::Stream,
    geometry::{LieGroup, Se2, UncertainPose},
};
use nalgebra::{Matrix3, SMatrix, Vector3};
use rand_distr::{Distribution, StandardNormal};

/// A Gaussian in the tangent space of a pose: `mean ∘ exp(L z)` with `L Lᵀ` the covariance.
#[derive(Debug, Clone, Copy)]
pub(super) struct PoseGaussian {
    mean: Se2,
    root: Matrix3<f64>,
}

impl PoseGaussian {
    /// Factors the covariance; zero variances are allowed.
    pub(super) fn new(pose: &UncertainPose<Se2>) -> Self {
        Self { mean: *pose.mean(), root: semidefinite_root(pose.covariance()) }
    }

    pub(super) fn sample(&self, stream: &mut Stream) -> Se2 {
        let z = Vector3::from_fn(|_, _| StandardNormal.sample(stream));
        self.mean.plus(&(self.root * z))
    }
}

/// Lower triangular `L` with `L Lᵀ = covariance`; a pivot that is no more than rounding leaves its column zero.
pub(crate) fn semidefinite_root<const N: usize>(covariance: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    let mut root = SMatrix::<f64, N, N>::zeros();
    for j in 0..N {
        let known = |i: usize, root: &SMatrix<f64, N, N>| (0..j).map(|k| root[(i, k)] * root[(j, k)]).sum::<f64>();
        let pivot = covariance[(j, j)] - known(j, &root);
        // What the earlier pivots, which may be small themselves, leave of rounding.
        if pivot > 1e-9 * covariance[(j, j)].abs() {
            root[(j, j)] = pivot.sqrt();
            for i in j + 1..N {
                root[(i, j)] = (covariance[(i, j)] - known(i, &root)) / root[(j, j)];
            }
        }
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn roots_square_to_the_covariance(entries in prop::array::uniform9(-2.0..2.0_f64), rank in 0_usize..4) {
            let mut factor = Matrix3::from_row_slice(&entries);
            (rank..3).for_each(|column| factor.set_column(column, &Vector3::zeros()));
            let covariance = factor * factor.transpose();
            let root = semidefinite_root(&covariance);
            prop_assert!((root * root.transpose() - covariance).abs().max() < 2e-4 * covariance.amax().max(1e-9));
        }
    }

    #[test]
    fn what_is_known_exactly_is_drawn_exactly() {
        let pose = UncertainPose::new(Se2::new(1.0, 2.0, 0.5), Matrix3::from_diagonal(&Vector3::new(0.0, 0.04, 0.0)));
        let gaussian = PoseGaussian::new(&pose.unwrap());
        let mut stream = agv_core::compute::Seed(1).stream(0, 0);
        let offsets: Vec<Vector3<f64>> =
            (0..1000).map(|_| gaussian.sample(&mut stream).minus(&Se2::new(1.0, 2.0, 0.5))).collect();
        assert!(offsets.iter().all(|d| d.x.abs() < 1e-12 && d.z.abs() < 1e-12));
        // The variance of a sample variance of n Gaussians is 2 / n of its square: five deviations.
        let variance = offsets.iter().map(|d| d.y * d.y).sum::<f64>() / 1000.0;
        assert!((variance / 0.04 - 1.0).abs() < 5.0 * (2.0_f64 / 1000.0).sqrt());
    }
}
