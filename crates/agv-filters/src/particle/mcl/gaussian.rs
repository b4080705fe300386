//! Draws around a pose.

use agv_core::{
    Error, check,
    compute::Stream,
    geometry::{LieGroup, Se2},
};
use nalgebra::{Matrix3, Vector3};
use rand_distr::{Distribution, StandardNormal};

/// A Gaussian in the tangent space of a pose: `mean ∘ exp(L z)` with `L Lᵀ` the covariance.
#[derive(Debug, Clone, Copy)]
pub(super) struct PoseGaussian {
    mean: Se2,
    root: Matrix3<f64>,
}

impl PoseGaussian {
    /// Checks and factors the covariance; zero variances are allowed.
    ///
    /// # Errors
    /// A mean or covariance that is not finite, or one that is not symmetric and positive semi-definite.
    pub(super) fn new(mean: Se2, covariance: &Matrix3<f64>) -> Result<Self, Error> {
        check::all_finite("map_from_base", &[mean.x(), mean.y(), mean.yaw()])?;
        check::all_finite("covariance", covariance.iter())?;
        let asymmetry = (covariance - covariance.transpose()).abs().max();
        let scale = covariance.diagonal().amax();
        if asymmetry > 1e-9 * scale.max(f64::MIN_POSITIVE) {
            return Err(Error::NotCovariance { name: "covariance", pivot: asymmetry });
        }
        Ok(Self { mean, root: semidefinite_root(covariance)? })
    }

    pub(super) fn sample(&self, stream: &mut Stream) -> Se2 {
        let z = Vector3::from_fn(|_, _| StandardNormal.sample(stream));
        self.mean.plus(&(self.root * z))
    }
}

/// Lower triangular `L` with `L Lᵀ = covariance`; a pivot that vanishes within rounding leaves its column zero.
fn semidefinite_root(covariance: &Matrix3<f64>) -> Result<Matrix3<f64>, Error> {
    let mut root = Matrix3::zeros();
    for j in 0..3 {
        let known = |i: usize, root: &Matrix3<f64>| (0..j).map(|k| root[(i, k)] * root[(j, k)]).sum::<f64>();
        let pivot = covariance[(j, j)] - known(j, &root);
        // What the earlier pivots, which may be small themselves, leave of rounding.
        let rounding = 1e-9 * covariance[(j, j)].abs();
        if pivot > rounding {
            root[(j, j)] = pivot.sqrt();
            for i in j + 1..3 {
                root[(i, j)] = (covariance[(i, j)] - known(i, &root)) / root[(j, j)];
            }
        } else {
            // A variance of zero allows no covariance with anything; one of rounding, its root.
            let loose = (j + 1..3).map(|i| (covariance[(i, j)] - known(i, &root)).abs()).fold(0.0, f64::max);
            let allowed = 1e-4 * (covariance[(j, j)].abs() * covariance.diagonal().amax()).sqrt();
            if pivot < -rounding || loose > allowed {
                return Err(Error::NotCovariance { name: "covariance", pivot: pivot.min(-loose) });
            }
        }
    }
    Ok(root)
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
            let root = semidefinite_root(&covariance).unwrap();
            prop_assert!((root * root.transpose() - covariance).abs().max() < 2e-4 * covariance.amax().max(1e-9));
        }
    }

    #[test]
    fn what_is_no_covariance_is_refused() {
        let diagonal = |a, b, c| Matrix3::from_diagonal(&Vector3::new(a, b, c));
        let mut skew = diagonal(1.0, 1.0, 1.0);
        skew.m12 = 0.1;
        let mut correlated = diagonal(1.0, 1.0, 1.0);
        (correlated.m12, correlated.m21) = (1.1, 1.1);
        let mut with_zero = diagonal(0.0, 1.0, 1.0);
        (with_zero.m12, with_zero.m21) = (0.1, 0.1);
        for bad in [
            diagonal(-1.0, 1.0, 1.0),
            diagonal(1.0, 1.0, -1e-3),
            diagonal(f64::NAN, 1.0, 1.0),
            skew,
            correlated,
            with_zero,
        ] {
            assert!(PoseGaussian::new(Se2::identity(), &bad).is_err(), "{bad}");
        }
        assert!(PoseGaussian::new(Se2::new(f64::NAN, 0.0, 0.0), &diagonal(1.0, 1.0, 1.0)).is_err());
        assert!(PoseGaussian::new(Se2::identity(), &Matrix3::zeros()).is_ok());
    }
}
