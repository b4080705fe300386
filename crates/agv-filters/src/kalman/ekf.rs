//! The extended Kalman filter, over any state, process and measurement.
//!
//! ```text
//! predict   x ← f(x, u, Δt)                      P ← F P Fᵀ + Q
//! update    ν = z ⊟ h(x)                         S = H P Hᵀ + R          NIS = νᵀ S⁻¹ ν
//!           K = P Hᵀ S⁻¹, x ← x ⊞ K ν            P ← (I - K H) P (I - K H)ᵀ + K R Kᵀ
//! ```
//!
//! Joseph's form of the covariance (Bucy and Joseph 1968) is a sum of two that are positive semi-definite whatever the
//! rounding in `K`. With a linear model this is Kalman's filter; with a pose for a state the error-state filter, whose
//! covariance is carried to the corrected pose by [`Manifold::reset_jacobian`].

use super::{
    Correction, Gate, GaussianBelief, Innovation, Manifold, MeasurementModel, ProcessModel, Transition,
    innovation::Surprise, matrix,
};
use agv_core::{Error, check};
use nalgebra::{SMatrix, SVector};

/// An extended Kalman filter for a state `X` of `N` degrees of freedom.
///
/// A step that returns an error, and a reading beyond the gate, leave the belief as it was. A value of a few hundred bytes
/// that is copied to keep a history; nothing allocates.
///
/// ```
/// use agv_core::geometry::Twist2;
/// use agv_core::nalgebra::{Matrix3, Vector2, Vector3};
/// use agv_filters::kalman::{Ekf, Gate, Landmark, PlanarPose, Unicycle, UnicycleParams};
///
/// let drive = Unicycle::new(UnicycleParams::default())?;
/// let reflector = Landmark::new(Vector2::new(4.0, 1.0), &Vector2::new(0.05, 0.01))?; // 5 cm and 0.01 rad
/// let gate = Gate::at_probability(0.999)?;
/// let start = PlanarPose::from(Vector3::zeros());
/// let mut ekf = Ekf::new(start, Matrix3::from_diagonal(&Vector3::new(0.04, 0.04, 0.01)))?;
///
/// ekf.predict(&drive, &Twist2::new(0.5, 0.0, 0.2), 0.1)?;
/// let seen = ekf.update(&reflector, &Vector2::new(4.1, 0.22), &gate)?;
/// assert!(seen.accepted && seen.innovation.nis < 2.0);
/// // A reading of another landmark is left out.
/// let stray = ekf.update(&reflector, &Vector2::new(2.0, -1.0), &gate)?;
/// assert!(!stray.accepted && stray.innovation.nis > stray.limit);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(
        transparent,
        bound(serialize = "X: serde::Serialize", deserialize = "X: Manifold<N> + serde::Deserialize<'de>")
    )
)]
pub struct Ekf<X, const N: usize> {
    belief: GaussianBelief<X, N>,
}

/// Kalman's filter: an [`Ekf`] whose state is a vector, to be used with [`LinearProcess`](super::LinearProcess) and
/// [`LinearMeasurement`](super::LinearMeasurement).
pub type KalmanFilter<const N: usize> = Ekf<SVector<f64, N>, N>;

impl<X: Manifold<N>, const N: usize> Ekf<X, N> {
    /// A filter that starts at a state with this covariance.
    ///
    /// # Errors
    /// Those of [`GaussianBelief::new`].
    pub fn new(state: X, covariance: SMatrix<f64, N, N>) -> Result<Self, Error> {
        GaussianBelief::new(state, covariance).map(Self::from)
    }

    /// What is known.
    #[inline]
    pub const fn belief(&self) -> &GaussianBelief<X, N> {
        &self.belief
    }

    /// Best estimate.
    #[inline]
    pub const fn state(&self) -> &X {
        self.belief.state()
    }

    /// Covariance of the increment from the best estimate to the truth.
    #[inline]
    pub const fn covariance(&self) -> &SMatrix<f64, N, N> {
        self.belief.covariance()
    }

    /// Moves the belief `dt` seconds on.
    ///
    /// # Errors
    /// [`Error::Negative`] for a `dt` below zero or not finite; [`Error::NotFinite`] or [`Error::NotCovariance`] if what the
    /// model makes of the control cannot be believed.
    #[inline]
    pub fn predict<P: ProcessModel<X, N>>(&mut self, model: &P, control: &P::Control, dt: f64) -> Result<(), Error> {
        check::non_negative("dt", dt)?;
        self.advance(&model.linearize(&self.belief.state, control, dt))
    }

    /// Moves the belief by a motion that was linearised at its state.
    #[inline]
    pub(super) fn advance(&mut self, moved: &Transition<X, N>) -> Result<(), Error> {
        let covariance = matrix::sandwich_plus(&moved.jacobian, &self.belief.covariance, &moved.noise);
        self.belief = GaussianBelief::stepped(moved.state, covariance)?;
        Ok(())
    }

    /// What a reading says that is not known yet, without taking it in: for data association.
    ///
    /// # Errors
    /// Those of [`update`](Self::update).
    #[inline]
    pub fn innovation<const M: usize, H: MeasurementModel<X, N, M>>(
        &self,
        model: &H,
        measured: &H::Value,
    ) -> Result<Innovation<M>, Error> {
        Ok(Surprise::new(&self.belief.state, &self.belief.covariance, model, measured)?.innovation)
    }

    /// Corrects the belief by a reading, unless it is beyond the gate.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for the reading or what the model expects; [`Error::NotCovariance`] if the covariance of the
    /// innovation is not positive definite: the reading's noise and the belief's along it are both zero.
    #[inline]
    pub fn update<const M: usize, H: MeasurementModel<X, N, M>>(
        &mut self,
        model: &H,
        measured: &H::Value,
        gate: &Gate,
    ) -> Result<Correction<M>, Error> {
        let surprise = Surprise::new(&self.belief.state, &self.belief.covariance, model, measured)?;
        let innovation = surprise.innovation;
        let limit = gate.limit(innovation.degrees);
        let accepted = innovation.nis <= limit;
        if accepted {
            let gain = surprise.factor.right_divide(&surprise.cross);
            let correction = gain * innovation.residual;
            let covariance =
                matrix::joseph(&self.belief.covariance, &surprise.cross, &surprise.jacobian, &surprise.noise, &gain);
            self.belief = corrected(&self.belief.state, &correction, covariance)?;
        }
        Ok(Correction { innovation, limit, accepted })
    }
}

/// The belief at `state ⊞ correction`, with a covariance that is still one of increments at `state`.
#[inline]
pub(super) fn corrected<X: Manifold<N>, const N: usize>(
    state: &X,
    correction: &SVector<f64, N>,
    covariance: SMatrix<f64, N, N>,
) -> Result<GaussianBelief<X, N>, Error> {
    let covariance = match X::reset_jacobian(correction) {
        Some(reset) => matrix::sandwich_plus(&reset, &covariance, &SMatrix::zeros()),
        None => covariance,
    };
    GaussianBelief::stepped(state.boxplus(correction), covariance)
}

impl<X, const N: usize> From<GaussianBelief<X, N>> for Ekf<X, N> {
    fn from(belief: GaussianBelief<X, N>) -> Self {
        Self { belief }
    }
}

#[cfg(test)]
mod tests;
