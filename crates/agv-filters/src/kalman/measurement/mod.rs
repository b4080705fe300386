//! What a sensor reads of a state: measurement models.

mod landmark;
mod linear;

use super::{Manifold, matrix::Ldl};
use nalgebra::{SMatrix, SVector};
use std::f64::consts::TAU;

pub use landmark::Landmark;
pub use linear::LinearMeasurement;

/// A reading that is expected, with what the filters need to know of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected<Z, const N: usize, const M: usize> {
    /// The reading without noise.
    pub value: Z,
    /// Jacobian of the reading's residual with respect to the state's increment, as a reading that grows with the state has
    /// it: `∂residual(h(x ⊞ δ), h(x)) / ∂δ`.
    pub jacobian: SMatrix<f64, M, N>,
    /// Covariance of the reading's noise.
    pub noise: SMatrix<f64, M, M>,
}

/// A model of a sensor that reads `M` reals of a state `X` of `N` degrees of freedom: `z = h(x) + v`, `v ~ N(0, R)`.
///
/// ```
/// use agv_core::geometry::angle_difference;
/// use agv_core::nalgebra::{Matrix1, Matrix3, RowVector3, Vector1, Vector3};
/// use agv_filters::kalman::{Ekf, Gate, MeasurementModel, PlanarPose};
///
/// /// A compass with this variance, in rad². Its readings are angles.
/// struct Compass(f64);
///
/// impl MeasurementModel<PlanarPose, 3, 1> for Compass {
///     type Value = f64;
///     fn predict(&self, pose: &PlanarPose) -> f64 {
///         pose[2]
///     }
///     fn jacobian(&self, _: &PlanarPose) -> RowVector3<f64> {
///         RowVector3::new(0.0, 0.0, 1.0)
///     }
///     fn noise(&self, _: &PlanarPose) -> Matrix1<f64> {
///         Matrix1::new(self.0)
///     }
///     fn residual(&self, measured: &f64, expected: &f64) -> Vector1<f64> {
///         Vector1::new(angle_difference(*measured, *expected))
///     }
/// }
///
/// let start = PlanarPose::from(Vector3::new(0.0, 0.0, 3.1));
/// let mut ekf = Ekf::new(start, Matrix3::identity() * 0.01)?;
/// let seen = ekf.update(&Compass(0.01), &-3.1, &Gate::at_probability(0.999)?)?;
/// assert!(seen.accepted && (seen.innovation.residual[0] - 0.083).abs() < 1e-3);
/// assert!((ekf.state()[2] + 3.142).abs() < 1e-3);
/// # Ok::<(), agv_core::Error>(())
/// ```
pub trait MeasurementModel<X: Manifold<N>, const N: usize, const M: usize> {
    /// A reading: `SVector<f64, M>`, or what the sensor reads by nature, as an angle or a pose.
    type Value: Copy;

    /// `h(x)`: the reading without noise.
    fn predict(&self, state: &X) -> Self::Value;

    /// `H`: Jacobian of the reading with respect to the state's increment.
    /// [`laws::measurement_jacobian`](super::laws::measurement_jacobian) compares it with differences.
    fn jacobian(&self, state: &X) -> SMatrix<f64, M, N>;

    /// `R`: covariance of the reading's noise, which may depend on the state, as that of a range grows with it.
    fn noise(&self, state: &X) -> SMatrix<f64, M, M>;

    /// What `measured` has more than `expected`; angles are to be wrapped here.
    fn residual(&self, measured: &Self::Value, expected: &Self::Value) -> SVector<f64, M>;

    /// Readings that count: fewer than `M` where some are masked. The degrees of freedom of the gate.
    #[inline]
    fn degrees(&self) -> usize {
        M
    }

    /// Reading, Jacobian and noise at once, for models whose parts share work.
    #[inline]
    fn linearize(&self, state: &X) -> Expected<Self::Value, N, M> {
        Expected { value: self.predict(state), jacobian: self.jacobian(state), noise: self.noise(state) }
    }

    /// Logarithm of the reading's likelihood at a state, for particle filters; Gaussian unless the model says otherwise, and
    /// NaN if the noise is not positive definite.
    fn log_likelihood(&self, state: &X, measured: &Self::Value) -> f64 {
        let residual = self.residual(measured, &self.predict(state));
        Ldl::new("noise", &self.noise(state)).map_or(f64::NAN, |factor| {
            -0.5 * (factor.squared_norm(&residual) + factor.log_determinant() + M as f64 * TAU.ln())
        })
    }
}
