//! Components of the state that are read as they are: a speed, a turn rate, a heading.

use super::MeasurementModel;
use crate::kalman::Wrapped;
use agv_core::{Error, check, geometry::wrap_angle};
use nalgebra::{SMatrix, SVector};

/// `M` components of a [`Wrapped`] state, read with noise; residuals of angles are wrapped.
///
/// ```
/// use agv_core::nalgebra::{SMatrix, SVector, Vector1};
/// use agv_filters::kalman::{Components, ConstantTurn, ConstantTurnParams, Ekf, Gate, TurningState};
///
/// let gyro = Components::<5, 1>::new([ConstantTurn::YAW_RATE], &Vector1::new(0.01))?;
/// let start = TurningState::from(SVector::<f64, 5>::new(0.0, 0.0, 1.0, 0.0, 0.2));
/// let mut ekf = Ekf::new(start, SMatrix::<f64, 5, 5>::identity() * 0.01)?;
/// ekf.predict(&ConstantTurn::new(ConstantTurnParams::default())?, &(), 0.1)?;
/// ekf.update(&gyro, &Vector1::new(0.25), &Gate::OPEN)?;
/// assert!((ekf.state()[ConstantTurn::YAW_RATE] - 0.25).abs() < 0.01);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Components<const N: usize, const M: usize> {
    indices: [usize; M],
    noise: SMatrix<f64, M, M>,
}

impl<const N: usize, const M: usize> Components<N, M> {
    /// The components with these indices, read with these standard deviations, in their units.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for an index, [`Error::Negative`] for a deviation.
    pub fn new(indices: [usize; M], sigmas: &SVector<f64, M>) -> Result<Self, Error> {
        sigmas.iter().try_for_each(|&sigma| check::non_negative("sigma", sigma).map(|_| ()))?;
        Self::with_noise(indices, SMatrix::from_diagonal(&sigmas.component_mul(sigmas)))
    }

    /// The components with these indices, read with noise of this covariance.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for an index, [`Error::NotFinite`] or [`Error::NotCovariance`] for the noise.
    pub fn with_noise(indices: [usize; M], noise: SMatrix<f64, M, M>) -> Result<Self, Error> {
        for &index in &indices {
            check::in_range("component", index as f64, 0.0, N.saturating_sub(1) as f64)?;
        }
        check::covariance("measurement noise", &noise)?;
        Ok(Self { indices, noise })
    }
}

impl<const N: usize, const ANGLES: u32, const M: usize> MeasurementModel<Wrapped<N, ANGLES>, N, M>
    for Components<N, M>
{
    type Value = SVector<f64, M>;

    #[inline]
    fn predict(&self, state: &Wrapped<N, ANGLES>) -> SVector<f64, M> {
        SVector::from_fn(|row, _| state[self.indices[row]])
    }

    #[inline]
    fn jacobian(&self, _: &Wrapped<N, ANGLES>) -> SMatrix<f64, M, N> {
        SMatrix::from_fn(|row, column| if self.indices[row] == column { 1.0 } else { 0.0 })
    }

    #[inline]
    fn noise(&self, _: &Wrapped<N, ANGLES>) -> SMatrix<f64, M, M> {
        self.noise
    }

    #[inline]
    fn residual(&self, measured: &SVector<f64, M>, expected: &SVector<f64, M>) -> SVector<f64, M> {
        let mut residual = measured - expected;
        for (value, &index) in residual.iter_mut().zip(&self.indices) {
            if Wrapped::<N, ANGLES>::is_angle(index) {
                *value = wrap_angle(*value);
            }
        }
        residual
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::{TurningState, laws};
    use nalgebra::{Vector1, Vector2};

    #[test]
    fn components_are_read_as_they_are() {
        let state = TurningState::from(SVector::<f64, 5>::new(1.0, 2.0, 0.5, 3.1, -0.2));
        let model = Components::<5, 2>::new([3, 4], &Vector2::new(0.1, 0.2)).unwrap();
        assert_eq!(model.predict(&state), Vector2::new(3.1, -0.2));
        assert!(laws::measurement_jacobian(&model, &state) < 1e-9);
        let residual =
            MeasurementModel::<TurningState, 5, 2>::residual(&model, &Vector2::new(-3.1, 5.0), &model.predict(&state));
        assert!((residual - Vector2::new(std::f64::consts::TAU - 6.2, 5.2)).amax() < 1e-12);
    }

    #[test]
    fn bad_components_are_refused() {
        assert!(matches!(Components::<5, 1>::new([5], &Vector1::new(0.1)), Err(Error::OutOfRange { .. })));
        for bad in [-0.1, f64::NAN, f64::INFINITY] {
            assert!(Components::<5, 1>::new([0], &Vector1::new(bad)).is_err(), "{bad}");
            assert!(Components::<5, 1>::with_noise([0], SMatrix::<f64, 1, 1>::new(bad)).is_err(), "{bad}");
        }
    }
}
