//! A motion that is linear in the state: `x' = F x + B u + w`.

use super::ProcessModel;
use agv_core::{Error, check};
use nalgebra::{SMatrix, SVector};

/// `x' = F x + B u + w`, `w ~ N(0, Q)`, with a control of `U` reals; the matrices are those of one step, whatever its `dt`.
///
/// ```
/// use agv_core::nalgebra::{Matrix1, Matrix2, RowVector2, Vector1, Vector2};
/// use agv_filters::kalman::{Gate, KalmanFilter, LinearMeasurement, LinearProcess};
///
/// // A position that is driven at a speed that is not known: steps of 0.1 s.
/// let process = LinearProcess::new(Matrix2::new(1.0, 0.1, 0.0, 1.0), Vector2::zeros(), Matrix2::identity() * 1e-6)?;
/// let position = LinearMeasurement::new(RowVector2::new(1.0, 0.0), Matrix1::new(1e-4))?;
/// let mut filter = KalmanFilter::new(Vector2::zeros(), Matrix2::identity())?;
/// for step in 1..=50 {
///     filter.predict(&process, &Vector1::zeros(), 0.1)?;
///     filter.update(&position, &Vector1::new(0.05 * f64::from(step)), &Gate::OPEN)?;
/// }
/// assert!((filter.state()[1] - 0.5).abs() < 1e-2);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinearProcess<const N: usize, const U: usize> {
    transition: SMatrix<f64, N, N>,
    input: SMatrix<f64, N, U>,
    noise: SMatrix<f64, N, N>,
}

impl<const N: usize, const U: usize> LinearProcess<N, U> {
    /// A process by its matrices `F` and `B`, and the covariance `Q` of its noise.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::NotCovariance`].
    pub fn new(
        transition: SMatrix<f64, N, N>,
        input: SMatrix<f64, N, U>,
        noise: SMatrix<f64, N, N>,
    ) -> Result<Self, Error> {
        check::all_finite("transition matrix", transition.iter())?;
        check::all_finite("input matrix", input.iter())?;
        check::covariance("process noise", &noise)?;
        Ok(Self { transition, input, noise })
    }
}

impl<const N: usize, const U: usize> ProcessModel<SVector<f64, N>, N> for LinearProcess<N, U> {
    type Control = SVector<f64, U>;

    #[inline]
    fn transition(&self, state: &SVector<f64, N>, control: &SVector<f64, U>, _: f64) -> SVector<f64, N> {
        self.transition * state + self.input * control
    }

    #[inline]
    fn jacobian(&self, _: &SVector<f64, N>, _: &SVector<f64, U>, _: f64) -> SMatrix<f64, N, N> {
        self.transition
    }

    #[inline]
    fn noise(&self, _: &SVector<f64, N>, _: &SVector<f64, U>, _: f64) -> SMatrix<f64, N, N> {
        self.noise
    }
}
