//! A vehicle that is driven by a twist: the pose from measured or commanded velocities.
//!
//! The twist is held over the step, so that the path is an exact arc. Its noise is white in the velocities, stated as
//! what it adds up to: an error with the density `d` becomes `d √t` after `t` seconds, at any rate of the steps.

use super::{ProcessModel, Transition, arc::Arc, noise_from_inputs};
use crate::kalman::{PlanarPose, Wrapped};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2, Twist2},
};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Noise of a [`Unicycle`]'s twist.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct UnicycleParams {
    /// Deviation of the way after a second, whatever the speed, in m/√s.
    pub forward_density: f64,
    /// Deviation of the way to the side after a second, in m/√s; zero for wheels that cannot slip.
    pub left_density: f64,
    /// Deviation of the heading after a second, whatever the turn rate, in rad/√s.
    pub yaw_density: f64,
    /// What a metre per second adds to the variance of the way along it, in m²/m: slip and uneven floors.
    pub variance_per_metre: f64,
    /// What a radian per second adds to the variance of the heading, in rad²/rad.
    pub variance_per_radian: f64,
}

impl Default for UnicycleParams {
    /// Wheels on a hard floor: 3 mm after a metre and 0.2° after a radian, as
    /// [`PoseFilterParams`](crate::kalman::PoseFilterParams) has them, and a millimetre and a milliradian after a second
    /// for what does not depend on the motion.
    fn default() -> Self {
        Self {
            forward_density: 1e-3,
            left_density: 1e-3,
            yaw_density: 1e-3,
            variance_per_metre: 1e-5,
            variance_per_radian: 1e-5,
        }
    }
}

/// A [`ProcessModel`] of [`PlanarPose`] and of [`Se2`], driven by a [`Twist2`] in the base frame.
///
/// With a lateral speed in the twist it serves vehicles that move sideways too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unicycle {
    params: UnicycleParams,
}

impl Unicycle {
    /// A model with this noise.
    ///
    /// # Errors
    /// [`Error::Negative`] names the first parameter that is negative or not finite.
    pub fn new(params: UnicycleParams) -> Result<Self, Error> {
        check::non_negative("forward_density", params.forward_density)?;
        check::non_negative("left_density", params.left_density)?;
        check::non_negative("yaw_density", params.yaw_density)?;
        check::non_negative("variance_per_metre", params.variance_per_metre)?;
        check::non_negative("variance_per_radian", params.variance_per_radian)?;
        Ok(Self { params })
    }

    /// The parameters it was built with.
    pub const fn params(&self) -> &UnicycleParams {
        &self.params
    }

    /// Variances that the twist's components add up to in a second.
    #[inline]
    fn growth(&self, twist: &Twist2) -> Vector3<f64> {
        let p = &self.params;
        Vector3::new(
            p.forward_density * p.forward_density + p.variance_per_metre * twist.vx.abs(),
            p.left_density * p.left_density + p.variance_per_metre * twist.vy.abs(),
            p.yaw_density * p.yaw_density + p.variance_per_radian * twist.yaw_rate.abs(),
        )
    }
}

impl ProcessModel<PlanarPose, 3> for Unicycle {
    type Control = Twist2;

    #[inline]
    fn transition(&self, pose: &PlanarPose, twist: &Twist2, dt: f64) -> PlanarPose {
        self.linearize(pose, twist, dt).state
    }

    #[inline]
    fn jacobian(&self, pose: &PlanarPose, twist: &Twist2, dt: f64) -> Matrix3<f64> {
        ProcessModel::<PlanarPose, 3>::linearize(self, pose, twist, dt).jacobian
    }

    #[inline]
    fn noise(&self, pose: &PlanarPose, twist: &Twist2, dt: f64) -> Matrix3<f64> {
        ProcessModel::<PlanarPose, 3>::linearize(self, pose, twist, dt).noise
    }

    #[inline]
    fn linearize(&self, pose: &PlanarPose, twist: &Twist2, dt: f64) -> Transition<PlanarPose, 3> {
        let arc = Arc::new(pose[2], twist, dt);
        let (turn, forward, left, rate) = (arc.by_yaw(), arc.by_forward, arc.by_left(), arc.by_yaw_rate);
        let state =
            Wrapped::from(Vector3::new(pose[0] + arc.moved.x, pose[1] + arc.moved.y, pose[2] + twist.yaw_rate * dt));
        let jacobian = Matrix3::new(1.0, 0.0, turn.x, 0.0, 1.0, turn.y, 0.0, 0.0, 1.0);
        // Velocities with the variance `growth / dt` over the step; the quotient goes into the derivatives, for `dt = 0`.
        let growth = self.growth(twist);
        let by_twist = Matrix3::new(forward.x, left.x, rate.x, forward.y, left.y, rate.y, 0.0, 0.0, dt);
        let noise = if dt > 0.0 {
            noise_from_inputs(&by_twist, &Matrix3::from_diagonal(&(growth / dt)))
        } else {
            Matrix3::zeros()
        };
        Transition { state, jacobian, noise }
    }
}

/// The error-state form: increments are along the axes of the vehicle (Solà et al. 2018, section IV).
impl ProcessModel<Se2, 3> for Unicycle {
    type Control = Twist2;

    #[inline]
    fn transition(&self, pose: &Se2, twist: &Twist2, dt: f64) -> Se2 {
        *pose * twist.integrate(dt)
    }

    #[inline]
    fn jacobian(&self, _: &Se2, twist: &Twist2, dt: f64) -> Matrix3<f64> {
        twist.integrate(dt).inverse().adjoint()
    }

    #[inline]
    fn noise(&self, _: &Se2, twist: &Twist2, dt: f64) -> SMatrix<f64, 3, 3> {
        let by_motion = Se2::right_jacobian(&(Vector3::from(*twist) * dt));
        noise_from_inputs(&by_motion, &Matrix3::from_diagonal(&(self.growth(twist) * dt)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::{Ekf, laws};
    use proptest::prelude::*;

    fn model() -> Unicycle {
        Unicycle::new(UnicycleParams { left_density: 2e-3, ..Default::default() }).unwrap()
    }

    proptest! {
        #[test]
        fn jacobians_are_the_derivatives(yaw in -3.1..3.1_f64, vx in -2.0..2.0_f64, vy in -1.0..1.0_f64, rate in -3.0..3.0_f64, dt in 0.0..0.5_f64) {
            let (twist, pose) = (Twist2::new(vx, vy, rate), Vector3::new(3.0, -2.0, yaw));
            prop_assert!(laws::process_jacobian(&model(), &PlanarPose::from(pose), &twist, dt) < 1e-8);
            prop_assert!(laws::process_jacobian(&model(), &Se2::new(3.0, -2.0, yaw), &twist, dt) < 1e-8);
        }

        /// A belief with increments along the map's axes and one along the vehicle's are one to first order.
        #[test]
        fn both_forms_carry_the_same_belief(yaw in -3.1..3.1_f64, vx in -2.0..2.0_f64, vy in -1.0..1.0_f64, rate in -3.0..3.0_f64) {
            let twist = Twist2::new(vx, vy, rate);
            let start = Se2::new(1.0, 2.0, yaw);
            let turn = |pose: &Se2| Matrix3::new(pose.rotation().cos(), -pose.rotation().sin(), 0.0, pose.rotation().sin(), pose.rotation().cos(), 0.0, 0.0, 0.0, 1.0);
            let spread = Matrix3::new(4e-4, 1e-4, 0.0, 1e-4, 9e-4, 2e-4, 0.0, 2e-4, 1e-4);
            let mut along_map = Ekf::new(PlanarPose::from(Vector3::new(1.0, 2.0, yaw)), spread).unwrap();
            let mut along_base = Ekf::new(start, turn(&start).transpose() * spread * turn(&start)).unwrap();
            for _ in 0..20 {
                along_map.predict(&model(), &twist, 0.05).unwrap();
                along_base.predict(&model(), &twist, 0.05).unwrap();
            }
            let end = turn(along_base.state());
            prop_assert!((along_map.covariance() - end * along_base.covariance() * end.transpose()).amax() < 1e-9);
        }
    }

    #[test]
    fn noise_does_not_depend_on_the_rate_of_the_steps() {
        let twist = Twist2::new(1.0, 0.0, 0.0);
        let after = |steps: u32| {
            let mut ekf = Ekf::new(PlanarPose::from(Vector3::zeros()), Matrix3::zeros()).unwrap();
            for _ in 0..steps {
                ekf.predict(&model(), &twist, 4.0 / f64::from(steps)).unwrap();
            }
            *ekf.covariance()
        };
        let p = model().params;
        assert!((after(400)[(0, 0)] - 4.0 * (p.forward_density.powi(2) + p.variance_per_metre)).abs() < 1e-15);
        assert!((after(400)[(2, 2)] - 4.0 * p.yaw_density.powi(2)).abs() < 1e-15);
        // The heading's part of the position: within the discretisation's 1/n.
        assert!((after(400)[(1, 1)] / after(800)[(1, 1)] - 1.0).abs() < 1e-2);
    }

    #[test]
    fn bad_parameters_are_refused() {
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(Unicycle::new(UnicycleParams { forward_density: bad, ..Default::default() }).is_err());
            assert!(Unicycle::new(UnicycleParams { left_density: bad, ..Default::default() }).is_err());
            assert!(Unicycle::new(UnicycleParams { yaw_density: bad, ..Default::default() }).is_err());
            assert!(Unicycle::new(UnicycleParams { variance_per_metre: bad, ..Default::default() }).is_err());
            assert!(Unicycle::new(UnicycleParams { variance_per_radian: bad, ..Default::default() }).is_err());
        }
    }
}
