//! Motion by odometry whose scales are not known.
//!
//! ```text
//! (x, y, θ)    what the odometry read, the logarithm of its motion
//! x' = (1 + s_v) x - c |θ| + e_v Δt      y' = (1 + s_v) y      θ' = (1 + s_ω) θ + (b_ω + e_ω) Δt
//! X ← X exp(x', y', θ')                  e ← e exp(-Δt / T)
//! ```
//!
//! The way lost and the speed error go along the motion, whichever its direction, and vanish where the vehicle turns on the spot.
//! A yaw bias counts while it turns; what wanders counts while it moves, and wanders all the time.

use super::{CalibratedPose, DEGREES, OdometryNoise, Parameter};
use crate::kalman::ProcessModel;
use agv_core::{
    Error,
    geometry::{LieGroup, Se2},
};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// A piece of what the odometry read.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MotionPiece {
    /// Logarithm of the motion: metres ahead and to the left, radians.
    pub read: Vector3<f64>,
    /// Covariance that the odometry states of itself, in the base frame of the end.
    pub covariance: Matrix3<f64>,
}

impl MotionPiece {
    /// A share of it, between 0 and 1: constant velocity, white noise.
    pub(super) fn share(&self, share: f64) -> Self {
        Self { read: self.read * share, covariance: self.covariance * share }
    }
}

/// A [`ProcessModel`] of a [`CalibratedPose`], driven by what the odometry read.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CalibratedOdometry {
    noise: OdometryNoise,
}

impl CalibratedOdometry {
    /// A model with this noise.
    ///
    /// # Errors
    /// The first field of [`OdometryNoise`] that is out of its range.
    pub fn new(noise: OdometryNoise) -> Result<Self, Error> {
        noise.validate()?;
        Ok(Self { noise })
    }

    /// The motion that the state makes of what was read in `dt` seconds, as a logarithm.
    #[inline]
    pub(super) fn motion(state: &CalibratedPose, read: &Vector3<f64>, dt: f64) -> Vector3<f64> {
        let stretch = 1.0 + state.get(Parameter::SpeedScale);
        let (moves, ahead) = (f64::from(*read != Vector3::zeros()) * dt, direction(read));
        let turns = f64::from(read.z != 0.0) * dt;
        let lost = state.get(Parameter::TurnLoss) * read.z.abs();
        Vector3::new(
            stretch * read.x + ahead * (state.get(Parameter::SpeedError) * moves - lost),
            stretch * read.y,
            (1.0 + state.get(Parameter::YawScale)) * read.z
                + state.get(Parameter::YawRateError) * moves
                + state.get(Parameter::YawBias) * turns,
        )
    }

    fn forgetting(&self, dt: f64) -> f64 {
        (-dt / self.noise.wander_time).exp()
    }
}

/// 1 ahead, -1 in reverse, 0 where the vehicle turns on the spot: a way that is not driven cannot be lost.
#[inline]
fn direction(read: &Vector3<f64>) -> f64 {
    if read.x == 0.0 { 0.0 } else { read.x.signum() }
}

impl ProcessModel<CalibratedPose, DEGREES> for CalibratedOdometry {
    type Control = MotionPiece;

    fn transition(&self, state: &CalibratedPose, piece: &MotionPiece, dt: f64) -> CalibratedPose {
        let mut end = *state;
        end.map_from_base = state.map_from_base.plus(&Self::motion(state, &piece.read, dt));
        let forgetting = self.forgetting(dt);
        end.parameters[Parameter::SpeedError.index()] *= forgetting;
        end.parameters[Parameter::YawRateError.index()] *= forgetting;
        end
    }

    fn jacobian(&self, state: &CalibratedPose, piece: &MotionPiece, dt: f64) -> SMatrix<f64, DEGREES, DEGREES> {
        let read = &piece.read;
        let motion = Self::motion(state, read, dt);
        let right = Se2::right_jacobian(&motion);
        let (moves, ahead) = (f64::from(*read != Vector3::zeros()) * dt, direction(read));
        let mut jacobian = SMatrix::<f64, DEGREES, DEGREES>::identity();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&Se2::exp(&motion).inverse().adjoint());
        for (parameter, by_motion) in [
            (Parameter::SpeedScale, Vector3::new(read.x, read.y, 0.0)),
            (Parameter::TurnLoss, Vector3::new(-ahead * read.z.abs(), 0.0, 0.0)),
            (Parameter::YawScale, Vector3::new(0.0, 0.0, read.z)),
            (Parameter::YawBias, Vector3::new(0.0, 0.0, f64::from(read.z != 0.0) * dt)),
            (Parameter::SpeedError, Vector3::new(ahead * moves, 0.0, 0.0)),
            (Parameter::YawRateError, Vector3::new(0.0, 0.0, moves)),
        ] {
            jacobian.fixed_view_mut::<3, 1>(0, parameter.row()).copy_from(&(right * by_motion));
        }
        let forgetting = self.forgetting(dt);
        for parameter in [Parameter::SpeedError, Parameter::YawRateError] {
            jacobian[(parameter.row(), parameter.row())] = forgetting;
        }
        jacobian
    }

    fn noise(&self, state: &CalibratedPose, piece: &MotionPiece, dt: f64) -> SMatrix<f64, DEGREES, DEGREES> {
        let p = &self.noise;
        let moves = f64::from(piece.read != Vector3::zeros()) * dt;
        let (forward, yaw) = (p.forward_density * p.forward_density * moves, p.yaw_density * p.yaw_density * moves);
        let driven = if piece.read.x == 0.0 && piece.read.y == 0.0 { 0.0 } else { forward };
        let right = Se2::right_jacobian(&Self::motion(state, &piece.read, dt));
        let own = Matrix3::from_diagonal(&Vector3::new(driven, driven * p.sideways_share, yaw));
        let mut noise = SMatrix::<f64, DEGREES, DEGREES>::zeros();
        noise.fixed_view_mut::<3, 3>(0, 0).copy_from(&(right * own * right.transpose() + piece.covariance));
        let forgetting = self.forgetting(dt);
        let renewed = 1.0 - forgetting * forgetting;
        for (parameter, sigma) in
            [(Parameter::SpeedError, p.speed_wander), (Parameter::YawRateError, p.yaw_rate_wander)]
        {
            noise[(parameter.row(), parameter.row())] = sigma * sigma * renewed;
        }
        noise
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::{Manifold, laws};
    use nalgebra::SVector;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn jacobians_are_the_derivatives(
            x in prop::array::uniform15(-0.3..0.3_f64), ahead in -1.0..1.0_f64, left in -0.2..0.2_f64, turn in -0.5..0.5_f64, dt in 0.01..0.5_f64,
        ) {
            let zero = CalibratedPose { map_from_base: Se2::new(1.0, -2.0, 2.8), parameters: SVector::zeros() };
            let state = zero.boxplus(&SVector::from(x));
            let model = CalibratedOdometry::new(OdometryNoise::default()).unwrap();
            let piece = MotionPiece { read: Vector3::new(ahead, left, turn), covariance: Matrix3::identity() * 1e-6 };
            prop_assert!(laws::process_jacobian(&model, &state, &piece, dt) < 1e-7);
        }
    }
}
