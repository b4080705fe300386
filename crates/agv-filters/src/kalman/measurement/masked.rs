//! Some components of a reading only.
//!
//! A component that is masked has no residual, no Jacobian and noise of its own: it changes neither the state nor the
//! normalised innovation squared. What is masked can therefore change from reading to reading without another type.

use super::{Expected, MeasurementModel};
use crate::kalman::Manifold;
use agv_core::Error;
use nalgebra::{SMatrix, SVector};

/// A model of which only some components are read.
///
/// The components that are left out may hold anything, NaN included.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::nalgebra::{Matrix3, Vector3};
/// use agv_filters::kalman::{Ekf, Gate, Masked, PoseReading};
///
/// let pose = PoseReading::new(Matrix3::identity() * 1e-4)?;
/// let heading_only = Masked::new(pose, [false, false, true])?;
/// let mut ekf = Ekf::new(Se2::default(), Matrix3::identity() * 1e-4)?;
/// let seen = ekf.update(&heading_only, &Vector3::new(f64::NAN, 7.0, 0.02).into(), &Gate::OPEN)?;
/// assert_eq!((ekf.state().x(), seen.innovation.degrees), (0.0, 1));
/// assert!((ekf.state().yaw() - 0.01).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Masked<T, const M: usize> {
    model: T,
    read: [bool; M],
    degrees: usize,
}

impl<T, const M: usize> Masked<T, M> {
    /// The components of `model` for which `read` is true.
    ///
    /// # Errors
    /// [`Error::Empty`] if there is none.
    pub fn new(model: T, read: [bool; M]) -> Result<Self, Error> {
        match read.iter().filter(|&&read| read).count() {
            0 => Err(Error::Empty { name: "components to be read" }),
            degrees => Ok(Self { model, read, degrees }),
        }
    }

    #[inline]
    fn rows<const N: usize>(&self, mut jacobian: SMatrix<f64, M, N>) -> SMatrix<f64, M, N> {
        for row in 0..M {
            if !self.read[row] {
                jacobian.row_mut(row).fill(0.0);
            }
        }
        jacobian
    }

    #[inline]
    fn own_noise(&self, noise: &SMatrix<f64, M, M>) -> SMatrix<f64, M, M> {
        SMatrix::from_fn(|i, j| match (self.read[i] && self.read[j], i == j) {
            (true, _) => noise[(i, j)],
            (false, true) => 1.0,
            (false, false) => 0.0,
        })
    }
}

impl<X: Manifold<N>, T: MeasurementModel<X, N, M>, const N: usize, const M: usize> MeasurementModel<X, N, M>
    for Masked<T, M>
{
    type Value = T::Value;

    #[inline]
    fn predict(&self, state: &X) -> T::Value {
        self.model.predict(state)
    }

    #[inline]
    fn jacobian(&self, state: &X) -> SMatrix<f64, M, N> {
        self.rows(self.model.jacobian(state))
    }

    #[inline]
    fn noise(&self, state: &X) -> SMatrix<f64, M, M> {
        self.own_noise(&self.model.noise(state))
    }

    #[inline]
    fn residual(&self, measured: &T::Value, expected: &T::Value) -> SVector<f64, M> {
        let mut residual = self.model.residual(measured, expected);
        for (value, read) in residual.iter_mut().zip(self.read) {
            if !read {
                *value = 0.0;
            }
        }
        residual
    }

    #[inline]
    fn degrees(&self) -> usize {
        self.degrees
    }

    #[inline]
    fn linearize(&self, state: &X) -> Expected<T::Value, N, M> {
        let expected = self.model.linearize(state);
        Expected {
            value: expected.value,
            jacobian: self.rows(expected.jacobian),
            noise: self.own_noise(&expected.noise),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::{Components, Ekf, Gate, PlanarPose};
    use nalgebra::{Matrix2, Matrix3, Vector1, Vector3};
    use proptest::prelude::*;

    proptest! {
        /// As if the components that are masked were not there, correlated noise included.
        #[test]
        fn masked_components_do_not_count(entries in prop::array::uniform9(-1.0..1.0_f64), read in prop::array::uniform3(-0.5..0.5_f64), hidden in 0_usize..3) {
            let root = Matrix3::from_row_slice(&entries);
            let (spread, noise) = (root * root.transpose() + Matrix3::identity(), root.transpose() * root * 0.1 + Matrix3::identity() * 0.05);
            let whole = Components::<3, 3>::with_noise([0, 1, 2], noise).unwrap();
            let mask = std::array::from_fn(|i| i != hidden);
            let start = Ekf::new(PlanarPose::from(Vector3::zeros()), spread).unwrap();
            let (mut masked, mut fewer) = (start, start);
            let mut reading = Vector3::from(read);
            let kept: [usize; 2] = if hidden == 0 { [1, 2] } else if hidden == 1 { [0, 2] } else { [0, 1] };
            let part = Components::<3, 2>::with_noise(kept, Matrix2::from_fn(|i, j| noise[(kept[i], kept[j])])).unwrap();
            let two = nalgebra::Vector2::new(reading[kept[0]], reading[kept[1]]);
            reading[hidden] = f64::NAN;
            let a = masked.update(&Masked::new(whole, mask).unwrap(), &reading, &Gate::OPEN).unwrap();
            let b = fewer.update(&part, &two, &Gate::OPEN).unwrap();
            prop_assert!((a.innovation.nis - b.innovation.nis).abs() < 1e-9);
            prop_assert_eq!(a.innovation.degrees, b.innovation.degrees);
            prop_assert!((a.innovation.log_likelihood() - b.innovation.log_likelihood()).abs() < 1e-9);
            prop_assert!((masked.state().vector() - fewer.state().vector()).amax() < 1e-9);
            prop_assert!((masked.covariance() - fewer.covariance()).amax() < 1e-9);
        }
    }

    #[test]
    fn a_mask_that_leaves_nothing_is_refused() {
        let yaw = Components::<3, 1>::new([2], &Vector1::new(0.1)).unwrap();
        assert!(matches!(Masked::new(yaw, [false]), Err(Error::Empty { .. })));
    }
}
