//! A vehicle that keeps its speed and its turn rate: the 5-state model of paper 001, Eq. 18.
//!
//! The state is `(x, y, v, θ, ω)`. What changes speed and turn rate is noise, an acceleration and an angular acceleration
//! that are white and held over the step:
//!
//! ```text
//! x' = x ⊞ (arc of v, ω over Δt)    v' = v + a Δt    θ' = θ + ω Δt + ½ α Δt²    ω' = ω + α Δt
//! ```
//!
//! and `½ a Δt²` along the chord of the arc. The paper prints the straight-line transition and `α Δt²` for the turn rate;
//! here the arc is exact and its straight-line limit needs no case of its own.

use super::{ProcessModel, Transition, arc::Arc};
use crate::kalman::Wrapped;
use agv_core::{Error, check, geometry::Twist2};
use nalgebra::{SMatrix, SVector};

/// Position in metres, speed in metres per second, heading in radians and turn rate in radians per second: `(x, y, v, θ, ω)`.
pub type TurningState = Wrapped<5, 0b01000>;

/// How a vehicle's speed and turn rate wander.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ConstantTurnParams {
    /// Deviation of the speed after a second, in m/s/√s. An acceleration of `σ` held over steps of `Δt` is `σ √Δt`.
    pub acceleration_density: f64,
    /// Deviation of the turn rate after a second, in rad/s/√s.
    pub yaw_acceleration_density: f64,
}

impl Default for ConstantTurnParams {
    /// The vehicle of paper 001, which accelerates by 0.5 m/s² and 0.5 rad/s², over steps of 0.1 s: `0.5 √0.1`.
    fn default() -> Self {
        Self { acceleration_density: 0.158, yaw_acceleration_density: 0.158 }
    }
}

/// A [`ProcessModel`] of [`TurningState`], driven by nothing: constant turn rate and velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConstantTurn {
    params: ConstantTurnParams,
}

impl ConstantTurn {
    /// Index of the speed in the state.
    pub const SPEED: usize = 2;
    /// Index of the heading in the state.
    pub const YAW: usize = 3;
    /// Index of the turn rate in the state.
    pub const YAW_RATE: usize = 4;

    /// A model with this noise.
    ///
    /// # Errors
    /// [`Error::Negative`] for a density that is negative or not finite.
    pub fn new(params: ConstantTurnParams) -> Result<Self, Error> {
        check::non_negative("acceleration_density", params.acceleration_density)?;
        check::non_negative("yaw_acceleration_density", params.yaw_acceleration_density)?;
        Ok(Self { params })
    }

    /// The parameters it was built with.
    pub const fn params(&self) -> &ConstantTurnParams {
        &self.params
    }
}

impl ProcessModel<TurningState, 5> for ConstantTurn {
    type Control = ();

    #[inline]
    fn transition(&self, state: &TurningState, (): &(), dt: f64) -> TurningState {
        self.linearize(state, &(), dt).state
    }

    #[inline]
    fn jacobian(&self, state: &TurningState, (): &(), dt: f64) -> SMatrix<f64, 5, 5> {
        self.linearize(state, &(), dt).jacobian
    }

    #[inline]
    fn noise(&self, state: &TurningState, (): &(), dt: f64) -> SMatrix<f64, 5, 5> {
        self.linearize(state, &(), dt).noise
    }

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "the Jacobian's zeros and ones fold only in the filter")]
    fn linearize(&self, state: &TurningState, (): &(), dt: f64) -> Transition<TurningState, 5> {
        let (speed, yaw, rate) = (state[Self::SPEED], state[Self::YAW], state[Self::YAW_RATE]);
        let arc = Arc::new(yaw, &Twist2::new(speed, 0.0, rate), dt);
        let end = SVector::<f64, 5>::new(state[0] + arc.moved.x, state[1] + arc.moved.y, speed, yaw + rate * dt, rate);

        let mut jacobian = SMatrix::<f64, 5, 5>::identity();
        let columns = [(Self::SPEED, arc.by_forward), (Self::YAW, arc.by_yaw()), (Self::YAW_RATE, arc.by_yaw_rate)];
        for (column, derivative) in columns {
            (jacobian[(0, column)], jacobian[(1, column)]) = (derivative.x, derivative.y);
        }
        jacobian[(Self::YAW, Self::YAW_RATE)] = dt;

        // An acceleration of the variance `q / dt` moves the state by `(½ dt by_forward, dt)`: entries that are not zero
        // only, once each.
        let p = &self.params;
        let (q, r) = (p.acceleration_density * p.acceleration_density * dt, p.yaw_acceleration_density);
        let r = r * r * dt;
        let half = 0.5 * arc.by_forward;
        let mut noise = SMatrix::<f64, 5, 5>::zeros();
        let mut set = |i: usize, j: usize, value: f64| (noise[(i, j)], noise[(j, i)]) = (value, value);
        set(0, 0, q * half.x * half.x);
        set(0, 1, q * half.x * half.y);
        set(1, 1, q * half.y * half.y);
        set(0, 2, q * half.x);
        set(1, 2, q * half.y);
        set(2, 2, q);
        set(3, 3, r * 0.25 * dt * dt);
        set(3, 4, r * 0.5 * dt);
        set(4, 4, r);
        Transition { state: end.into(), jacobian, noise }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::laws;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn jacobians_are_the_derivatives(v in -2.0..2.0_f64, yaw in -3.1..3.1_f64, rate in -3.0..3.0_f64, dt in 0.0..0.5_f64) {
            let state = TurningState::from(SVector::<f64, 5>::new(3.0, -2.0, v, yaw, rate));
            let model = ConstantTurn::new(ConstantTurnParams::default()).unwrap();
            prop_assert!(laws::process_jacobian(&model, &state, &(), dt) < 1e-8);
            prop_assert!(check::covariance("noise", &model.noise(&state, &(), dt)).is_ok());
        }
    }

    /// A quarter of a circle of 2 m in one step, and the noise of the straight line, `½ a Δt²` and `a Δt`.
    #[test]
    fn arcs_are_exact_and_accelerations_are_noise() {
        let model =
            ConstantTurn::new(ConstantTurnParams { acceleration_density: 2.0, yaw_acceleration_density: 0.0 }).unwrap();
        let quarter = std::f64::consts::FRAC_PI_2;
        let end = model.transition(&SVector::<f64, 5>::new(0.0, 0.0, 2.0, 0.0, 1.0).into(), &(), quarter);
        assert!((end.vector() - SVector::<f64, 5>::new(2.0, 2.0, 2.0, quarter, 1.0)).amax() < 1e-12);
        let noise = model.noise(&SVector::<f64, 5>::new(0.0, 0.0, 2.0, 0.0, 0.0).into(), &(), 0.1);
        let variance = 4.0 / 0.1; // of the acceleration that is held over the step
        assert!((noise[(0, 0)] - variance * 0.005 * 0.005).abs() < 1e-15 && noise[(1, 1)] == 0.0);
        assert!(
            (noise[(0, 2)] - variance * 0.005 * 0.1).abs() < 1e-15 && (noise[(2, 2)] - variance * 0.01).abs() < 1e-12
        );
    }

    #[test]
    fn bad_parameters_are_refused() {
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(ConstantTurn::new(ConstantTurnParams { acceleration_density: bad, ..Default::default() }).is_err());
            assert!(
                ConstantTurn::new(ConstantTurnParams { yaw_acceleration_density: bad, ..Default::default() }).is_err()
            );
        }
    }
}
