//! A vehicle that steers its front wheels: the bicycle that stands for an Ackermann or a tricycle drive.
//!
//! ```text
//! ω = v tan(δ) / L
//! ```
//!
//! with the speed `v` of the rear axle, the steering angle `δ` of the middle of the front axle and the wheelbase `L`; the
//! path is the exact arc of `(v, ω)`. Noise enters by speed and steering angle, as `G Q Gᵀ`.

use super::{ProcessModel, Transition, arc::Arc, noise_from_inputs};
use crate::kalman::{PlanarPose, Wrapped};
use agv_core::{Error, check, geometry::Twist2};
use nalgebra::{Matrix2, Matrix3, Matrix3x2, Vector3};

/// Wheelbase and noise of a [`Bicycle`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BicycleParams {
    /// Distance of the axles, in metres.
    pub wheelbase: f64,
    /// Deviation of the way after a second, whatever the speed, in m/√s.
    pub forward_density: f64,
    /// Variance of the way per metre driven, in m²/m.
    pub variance_per_metre: f64,
    /// Deviation of the steering angle times the root of the time that it holds, in rad √s: 0.5° that change ten times in a
    /// second are `0.0087 √0.1`.
    pub steering_density: f64,
}

impl Default for BicycleParams {
    /// A fork-lift with 1.2 m between its axles, 3 mm after a metre, a millimetre after a second, and a steering angle that is
    /// known to half a degree, for a tenth of a second at a time.
    fn default() -> Self {
        Self { wheelbase: 1.2, forward_density: 1e-3, variance_per_metre: 1e-5, steering_density: 2.8e-3 }
    }
}

/// Speed of the rear axle and steering angle of the front, held over a step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SteeredMotion {
    /// Speed of the middle of the rear axle, in metres per second.
    pub speed: f64,
    /// Angle of the wheel in the middle of the front axle, in radians, to the left; less than a right angle.
    pub steering: f64,
}

/// A [`ProcessModel`] of [`PlanarPose`], the pose of the middle of the rear axle, driven by a [`SteeredMotion`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bicycle {
    params: BicycleParams,
}

impl Bicycle {
    /// A model with this wheelbase and noise.
    ///
    /// # Errors
    /// [`Error::NotPositive`] for the wheelbase, [`Error::Negative`] for a noise.
    pub fn new(params: BicycleParams) -> Result<Self, Error> {
        check::positive("wheelbase", params.wheelbase)?;
        check::non_negative("forward_density", params.forward_density)?;
        check::non_negative("variance_per_metre", params.variance_per_metre)?;
        check::non_negative("steering_density", params.steering_density)?;
        Ok(Self { params })
    }

    /// The parameters it was built with.
    pub const fn params(&self) -> &BicycleParams {
        &self.params
    }
}

impl ProcessModel<PlanarPose, 3> for Bicycle {
    type Control = SteeredMotion;

    #[inline]
    fn transition(&self, pose: &PlanarPose, motion: &SteeredMotion, dt: f64) -> PlanarPose {
        self.linearize(pose, motion, dt).state
    }

    #[inline]
    fn jacobian(&self, pose: &PlanarPose, motion: &SteeredMotion, dt: f64) -> Matrix3<f64> {
        self.linearize(pose, motion, dt).jacobian
    }

    #[inline]
    fn noise(&self, pose: &PlanarPose, motion: &SteeredMotion, dt: f64) -> Matrix3<f64> {
        self.linearize(pose, motion, dt).noise
    }

    #[inline]
    fn linearize(&self, pose: &PlanarPose, motion: &SteeredMotion, dt: f64) -> Transition<PlanarPose, 3> {
        let p = &self.params;
        let slope = motion.steering.tan();
        let per_metre = slope / p.wheelbase;
        let rate = motion.speed * per_metre;
        let arc = Arc::new(pose[2], &Twist2::new(motion.speed, 0.0, rate), dt);
        let turn = arc.by_yaw();
        let rate_by_steering = motion.speed * (1.0 + slope * slope) / p.wheelbase;
        let by_speed = arc.by_forward + arc.by_yaw_rate * per_metre;
        let by_steering = arc.by_yaw_rate * rate_by_steering;
        let inputs =
            Matrix3x2::new(by_speed.x, by_steering.x, by_speed.y, by_steering.y, per_metre * dt, rate_by_steering * dt);
        let along = p.forward_density * p.forward_density + p.variance_per_metre * motion.speed.abs();
        let steering = p.steering_density * p.steering_density;
        let noise = if dt > 0.0 {
            noise_from_inputs(&inputs, &Matrix2::new(along / dt, 0.0, 0.0, steering / dt))
        } else {
            Matrix3::zeros()
        };
        Transition {
            state: Wrapped::from(Vector3::new(pose[0] + arc.moved.x, pose[1] + arc.moved.y, pose[2] + rate * dt)),
            jacobian: Matrix3::new(1.0, 0.0, turn.x, 0.0, 1.0, turn.y, 0.0, 0.0, 1.0),
            noise,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kalman::laws;
    use agv_core::compute::Seed;
    use proptest::prelude::*;
    use rand_distr::{Distribution, StandardNormal};

    proptest! {
        #[test]
        fn jacobians_are_the_derivatives(yaw in -3.1..3.1_f64, speed in -2.0..2.0_f64, steering in -1.2..1.2_f64, dt in 0.0..0.5_f64) {
            let (pose, model) = (PlanarPose::from(Vector3::new(3.0, -2.0, yaw)), Bicycle::new(BicycleParams::default()).unwrap());
            let motion = SteeredMotion { speed, steering };
            prop_assert!(laws::process_jacobian(&model, &pose, &motion, dt) < 1e-8);
        }
    }

    /// The stated noise against the spread of 20 000 steps with drawn inputs: entries within five of their own deviations.
    #[test]
    fn noise_is_that_of_drawn_inputs() {
        let model =
            Bicycle::new(BicycleParams { forward_density: 0.02, steering_density: 0.004, ..Default::default() })
                .unwrap();
        let (pose, motion, dt) =
            (PlanarPose::from(Vector3::new(0.0, 0.0, 0.4)), SteeredMotion { speed: 1.5, steering: 0.5 }, 0.1);
        let end = model.transition(&pose, &motion, dt);
        let (mut stream, mut scatter, count) = (Seed(1).stream(0, 0), Matrix3::zeros(), 20_000);
        let sigma_speed = ((0.02_f64.powi(2) + 1e-5 * 1.5) / dt).sqrt();
        for _ in 0..count {
            let [a, b]: [f64; 2] = [StandardNormal.sample(&mut stream), StandardNormal.sample(&mut stream)];
            let drawn = SteeredMotion { speed: 1.5 + sigma_speed * a, steering: 0.5 + 0.004 / dt.sqrt() * b };
            let error = (*model.transition(&pose, &drawn, dt)).into_owned() - end.vector();
            scatter += error * error.transpose() / f64::from(count);
        }
        let noise = model.noise(&pose, &motion, dt);
        for i in 0..3 {
            for j in 0..3 {
                let deviation = ((noise[(i, i)] * noise[(j, j)] + noise[(i, j)].powi(2)) / f64::from(count)).sqrt();
                assert!((scatter[(i, j)] - noise[(i, j)]).abs() < 5.0 * deviation, "{i} {j}: {scatter} {noise}");
            }
        }
    }

    #[test]
    fn bad_parameters_are_refused() {
        let good = BicycleParams::default();
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(Bicycle::new(BicycleParams { wheelbase: bad, ..good }).is_err());
            assert!(Bicycle::new(BicycleParams { forward_density: bad, ..good }).is_err());
            assert!(Bicycle::new(BicycleParams { variance_per_metre: bad, ..good }).is_err());
            assert!(Bicycle::new(BicycleParams { steering_density: bad, ..good }).is_err());
        }
        assert!(Bicycle::new(BicycleParams { wheelbase: 0.0, ..good }).is_err());
    }
}
