//! How a state moves: process models.

mod arc;
mod bicycle;
mod constant_turn;
mod linear;
mod unicycle;

use super::Manifold;
use agv_core::compute::Stream;
use nalgebra::{SMatrix, SVector};
use rand_distr::{Distribution, StandardNormal};

pub use bicycle::{Bicycle, BicycleParams, SteeredMotion};
pub use constant_turn::{ConstantTurn, ConstantTurnParams, TurningState};
pub use linear::LinearProcess;
pub use unicycle::{Unicycle, UnicycleParams};

/// A state that moved, with what the filters need to know of the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transition<X, const N: usize> {
    /// The state at the end.
    pub state: X,
    /// Jacobian of the end's increment with respect to the start's.
    pub jacobian: SMatrix<f64, N, N>,
    /// Covariance that the motion adds to the end's increment.
    pub noise: SMatrix<f64, N, N>,
}

/// A model of motion for a state `X` of `N` degrees of freedom: `x' = f(x, u, Δt) ⊞ w`, `w ~ N(0, Q)`.
///
/// Models are plain values; whatever they return is checked by the filter before it is believed. A model of your own is
/// three short functions:
///
/// ```
/// use agv_core::nalgebra::{Matrix1, Matrix2, RowVector2, Vector1, Vector2};
/// use agv_filters::kalman::{Ekf, Gate, LinearMeasurement, ProcessModel, noise_from_inputs};
///
/// /// A cart on a rail: position and speed, pushed by an acceleration that is known to 0.1 m/s².
/// struct Cart;
///
/// impl ProcessModel<Vector2<f64>, 2> for Cart {
///     type Control = f64;
///     fn transition(&self, x: &Vector2<f64>, acceleration: &f64, dt: f64) -> Vector2<f64> {
///         Vector2::new(x[0] + x[1] * dt + 0.5 * acceleration * dt * dt, x[1] + acceleration * dt)
///     }
///     fn jacobian(&self, _: &Vector2<f64>, _: &f64, dt: f64) -> Matrix2<f64> {
///         Matrix2::new(1.0, dt, 0.0, 1.0)
///     }
///     fn noise(&self, _: &Vector2<f64>, _: &f64, dt: f64) -> Matrix2<f64> {
///         noise_from_inputs(&Vector2::new(0.5 * dt * dt, dt), &Matrix1::new(0.1 * 0.1))
///     }
/// }
///
/// let mut ekf = Ekf::new(Vector2::zeros(), Matrix2::identity())?;
/// let position = LinearMeasurement::new(RowVector2::new(1.0, 0.0), Matrix1::new(1e-4))?;
/// for step in 1..=100 {
///     ekf.predict(&Cart, &0.5, 0.1)?;
///     let time = 0.1 * f64::from(step);
///     ekf.update(&position, &Vector1::new(0.25 * time * time), &Gate::OPEN)?;
/// }
/// assert!((ekf.state()[1] - 5.0).abs() < 0.05);
/// # Ok::<(), agv_core::Error>(())
/// ```
pub trait ProcessModel<X: Manifold<N>, const N: usize> {
    /// What drives the motion beside the state: a twist, an odometry increment, an acceleration; `()` for nothing.
    type Control: ?Sized;

    /// `f(x, u, Δt)`: the state `dt` seconds later, without noise.
    fn transition(&self, state: &X, control: &Self::Control, dt: f64) -> X;

    /// `F`: Jacobian of the end's increment with respect to the start's.
    /// [`laws::process_jacobian`](super::laws::process_jacobian) compares it with differences.
    fn jacobian(&self, state: &X, control: &Self::Control, dt: f64) -> SMatrix<f64, N, N>;

    /// `Q`: covariance that the motion adds to the end's increment; [`noise_from_inputs`] makes it of the inputs' noise.
    fn noise(&self, state: &X, control: &Self::Control, dt: f64) -> SMatrix<f64, N, N>;

    /// All three at once, for models whose parts share work.
    #[inline]
    fn linearize(&self, state: &X, control: &Self::Control, dt: f64) -> Transition<X, N> {
        Transition {
            state: self.transition(state, control, dt),
            jacobian: self.jacobian(state, control, dt),
            noise: self.noise(state, control, dt),
        }
    }

    /// The state `dt` seconds later with a draw of the noise, for particle filters; Gaussian unless the model says otherwise.
    fn sample(&self, state: &X, control: &Self::Control, dt: f64, stream: &mut Stream) -> X {
        let moved = self.linearize(state, control, dt);
        let root = crate::particle::semidefinite_root(&moved.noise);
        let unit = SVector::<f64, N>::from_fn(|_, _| StandardNormal.sample(stream));
        moved.state.boxplus(&(root * unit))
    }
}

/// `G Q Gᵀ`: the state's noise from that of `U` inputs with covariance `Q`, where `G` is the Jacobian of the end with respect
/// to the inputs.
#[inline]
pub fn noise_from_inputs<const N: usize, const U: usize>(
    by_inputs: &SMatrix<f64, N, U>,
    inputs: &SMatrix<f64, U, U>,
) -> SMatrix<f64, N, N> {
    super::matrix::sandwich_plus(by_inputs, inputs, &SMatrix::zeros())
}
