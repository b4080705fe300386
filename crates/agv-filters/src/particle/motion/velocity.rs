//! Velocity motion model: a vehicle that keeps a twist for a while, with noise on both velocities.
//!
//! With `v` and `ω` held for `Δt` the vehicle runs on a circle, then turns by a little more, since two noises alone would
//! leave the three-dimensional pose on a surface (paper 001, Eq. 1 with the sign of its `y` put right; Thrun, Burgard and Fox,
//! *Probabilistic Robotics*, Table 5.3):
//!
//! ```text
//! v^ = v + N(α1 v² + α2 ω²)    ω^ = ω + N(α3 v² + α4 ω²)    γ^ = N(α5 v² + α6 ω²)
//!
//! x' = x - v^/ω^ sin θ + v^/ω^ sin(θ + ω^ Δt)
//! y' = y + v^/ω^ cos θ - v^/ω^ cos(θ + ω^ Δt)
//! θ' = θ + ω^ Δt + γ^ Δt
//! ```
//!
//! which is `x' = x exp((v^ Δt, 0, ω^ Δt)) exp((0, 0, γ^ Δt))`, with its limit for a line built in. All noises are in
//! proportion to the velocities, so `Δt` cancels: run `v Δt` and turn `ω Δt` say all. The model therefore takes increments
//! like the others, of odometry or of commands, by their logarithm.

use super::{MotionModel, check_factors, differential::small_turn, stored_as};
use agv_core::{
    Error,
    compute::Stream,
    geometry::{LieGroup, Se2, propagate_covariance},
    odometry::OdometryIncrement,
};
use nalgebra::{Matrix3, Vector3};
use rand_distr::{Distribution, StandardNormal};

/// How the variances of the velocities grow with them. The order is α1 to α6 of the literature.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct VelocityNoise {
    /// α1: variance of the run per squared run, in m²/m².
    pub run_per_run: f64,
    /// α2: variance of the run per squared turn, in m²/rad².
    pub run_per_turn: f64,
    /// α3: variance of the turn along the arc per squared run, in rad²/m².
    pub turn_per_run: f64,
    /// α4: variance of the turn along the arc per squared turn, in rad²/rad².
    pub turn_per_turn: f64,
    /// α5: variance of the last turn per squared run, in rad²/m².
    pub last_turn_per_run: f64,
    /// α6: variance of the last turn per squared turn, in rad²/rad².
    pub last_turn_per_turn: f64,
}

impl Default for VelocityNoise {
    /// 0.2 each: the heading then errs as with the two turns of the odometry model and `nav2_amcl`'s factors.
    fn default() -> Self {
        Self::uniform(0.2)
    }
}

impl VelocityNoise {
    /// The same factor for all six.
    pub const fn uniform(alpha: f64) -> Self {
        Self {
            run_per_run: alpha,
            run_per_turn: alpha,
            turn_per_run: alpha,
            turn_per_turn: alpha,
            last_turn_per_run: alpha,
            last_turn_per_turn: alpha,
        }
    }
}

/// The velocity motion model.
///
/// For vehicles without odometry the increment is made of the command; what moves to the side is passed on without noise.
/// The covariance that an increment may carry is not used: the model states the noise.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_core::odometry::OdometryIncrement;
/// use agv_core::time::Stamp;
/// use agv_filters::particle::{MotionModel, VelocityModel, VelocityNoise};
///
/// let model = VelocityModel::new(VelocityNoise::uniform(0.001))?;
/// let (start, end) = (Stamp::from_seconds(1.0), Stamp::from_seconds(1.5));
/// // Half a second at 1 m/s on a circle of 2 m radius.
/// let commanded = Twist2::new(1.0, 0.0, 0.5).integrate(end - start);
/// let motion = OdometryIncrement::between(start, &Se2::default(), end, &commanded)?;
/// let moved = model.condition(&motion)(&Se2::default(), &mut Seed(7).stream(0, 0));
/// assert!((moved.x() - 0.495).abs() < 0.1 && (moved.yaw() - 0.25).abs() < 0.1);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "VelocityNoise", into = "VelocityNoise")
)]
pub struct VelocityModel {
    noise: VelocityNoise,
}

stored_as!(VelocityNoise => VelocityModel.noise);

impl VelocityModel {
    /// Checks the noise factors.
    ///
    /// # Errors
    /// A factor that is negative or not finite.
    pub fn new(noise: VelocityNoise) -> Result<Self, Error> {
        check_factors!(noise: run_per_run, run_per_turn, turn_per_run, turn_per_turn, last_turn_per_run, last_turn_per_turn);
        Ok(Self { noise })
    }

    /// The noise factors.
    pub const fn noise(&self) -> &VelocityNoise {
        &self.noise
    }

    /// The motion as a tangent, and the deviations of the run, the turn along the arc and the last turn.
    fn spread(&self, start_from_end: &Se2) -> (Vector3<f64>, Vector3<f64>) {
        let tangent = start_from_end.log();
        let (run2, turn2) = (tangent.x * tangent.x, tangent.z * tangent.z);
        let n = &self.noise;
        let sigma = Vector3::new(
            (n.run_per_run * run2 + n.run_per_turn * turn2).sqrt(),
            (n.turn_per_run * run2 + n.turn_per_turn * turn2).sqrt(),
            (n.last_turn_per_run * run2 + n.last_turn_per_turn * turn2).sqrt(),
        );
        (tangent, sigma)
    }
}

impl MotionModel for VelocityModel {
    type Motion = OdometryIncrement;

    fn condition<'a>(&'a self, motion: &'a OdometryIncrement) -> impl Fn(&Se2, &mut Stream) -> Se2 + Sync + 'a {
        let (tangent, sigma) = self.spread(&motion.start_from_end);
        move |pose, stream| {
            let noise: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(stream));
            let run = Vector3::new(tangent.x + sigma.x * noise[0], tangent.y, tangent.z + sigma.y * noise[1]);
            let arrived = pose.plus(&run);
            Se2::from_parts(arrived.translation(), arrived.rotation().compose(&small_turn(sigma.z * noise[2])))
        }
    }

    fn covariance(&self, motion: &OdometryIncrement) -> Matrix3<f64> {
        let (tangent, sigma) = self.spread(&motion.start_from_end);
        let along_arc = Matrix3::from_diagonal(&Vector3::new(sigma.x * sigma.x, 0.0, sigma.y * sigma.y));
        let mut covariance = propagate_covariance::<Se2>(&Se2::right_jacobian(&tangent), &along_arc);
        covariance[(2, 2)] += sigma.z * sigma.z;
        covariance
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{compute::Seed, geometry::Twist2, time::Stamp};
    use proptest::prelude::*;

    proptest! {
        /// Without noise, the closed form of the paper with its sign put right.
        #[test]
        fn runs_on_the_circle_of_the_paper(v in -1.5..1.5_f64, w in prop_oneof![-2.0..-0.01_f64, 0.01..2.0_f64], yaw in -3.0..3.0_f64) {
            let dt = 0.7;
            let motion = OdometryIncrement::between(
                Stamp::default(), &Se2::default(), Stamp::default(), &Twist2::new(v, 0.0, w).integrate(dt),
            ).unwrap();
            let model = VelocityModel::new(VelocityNoise::uniform(0.0)).unwrap();
            let end = model.condition(&motion)(&Se2::new(2.0, -1.0, yaw), &mut Seed(0).stream(0, 0));
            let x = 2.0 - v / w * yaw.sin() + v / w * (yaw + w * dt).sin();
            let y = -1.0 + v / w * yaw.cos() - v / w * (yaw + w * dt).cos();
            prop_assert!((end.x() - x).abs() < 1e-9 && (end.y() - y).abs() < 1e-9);
            prop_assert!((Se2::new(0.0, 0.0, yaw + w * dt).yaw() - end.yaw()).abs() < 1e-9);
        }
    }

    #[test]
    fn bad_noise_is_named() {
        let good = VelocityNoise::default();
        for (name, bad) in [
            ("run_per_run", VelocityNoise { run_per_run: f64::INFINITY, ..good }),
            ("run_per_turn", VelocityNoise { run_per_turn: -1.0, ..good }),
            ("turn_per_run", VelocityNoise { turn_per_run: f64::NAN, ..good }),
            ("turn_per_turn", VelocityNoise { turn_per_turn: -0.1, ..good }),
            ("last_turn_per_run", VelocityNoise { last_turn_per_run: -0.1, ..good }),
            ("last_turn_per_turn", VelocityNoise { last_turn_per_turn: f64::NAN, ..good }),
        ] {
            assert!(VelocityModel::new(bad).unwrap_err().to_string().starts_with(name));
        }
    }
}
