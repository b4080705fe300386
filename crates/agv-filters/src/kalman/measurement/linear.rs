//! A reading that is linear in the state: `z = H x + v`.

use super::MeasurementModel;
use agv_core::{Error, check};
use nalgebra::{SMatrix, SVector};

/// `z = H x + v`, `v ~ N(0, R)`, of a state that is a vector: with it an [`Ekf`](crate::kalman::Ekf) is Kalman's filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinearMeasurement<const N: usize, const M: usize> {
    matrix: SMatrix<f64, M, N>,
    noise: SMatrix<f64, M, M>,
}

impl<const N: usize, const M: usize> LinearMeasurement<N, M> {
    /// A measurement by its matrix `H` and the covariance `R` of its noise.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::NotCovariance`].
    pub fn new(matrix: SMatrix<f64, M, N>, noise: SMatrix<f64, M, M>) -> Result<Self, Error> {
        check::all_finite("measurement matrix", matrix.iter())?;
        check::covariance("measurement noise", &noise)?;
        Ok(Self { matrix, noise })
    }
}

impl<const N: usize, const M: usize> MeasurementModel<SVector<f64, N>, N, M> for LinearMeasurement<N, M> {
    type Value = SVector<f64, M>;

    #[inline]
    fn predict(&self, state: &SVector<f64, N>) -> SVector<f64, M> {
        self.matrix * state
    }

    #[inline]
    fn jacobian(&self, _: &SVector<f64, N>) -> SMatrix<f64, M, N> {
        self.matrix
    }

    #[inline]
    fn noise(&self, _: &SVector<f64, N>) -> SMatrix<f64, M, M> {
        self.noise
    }

    #[inline]
    fn residual(&self, measured: &SVector<f64, M>, expected: &SVector<f64, M>) -> SVector<f64, M> {
        measured - expected
    }
}
