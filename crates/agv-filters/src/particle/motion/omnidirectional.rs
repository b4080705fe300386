//! Odometry motion model of a vehicle that moves in any direction: mecanum wheels, swerve drives.
//!
//! Such a vehicle does not turn towards where it goes, so there is nothing to take apart: the run errs along and across its
//! own direction, and the turn errs by itself (the model of `nav2_amcl` and Beluga, with the αs as factors of the
//! variances):
//!
//! ```text
//! d = |(Δx, Δy)|                           all in the base frame of the start
//! var along  = α3 d² + α4 Δθ²
//! var across = α5 d² + α4 Δθ²
//! var turn   = α1 Δθ² + α2 d²
//! ```

use super::{MotionModel, check_factors, differential::small_turn, stored_as};
use agv_core::{
    Error,
    compute::Stream,
    geometry::{LieGroup, Se2, propagate_covariance},
    odometry::OdometryIncrement,
};
use nalgebra::{Matrix3, Vector2, Vector3};
use rand_distr::{Distribution, StandardNormal};

/// How the variances of a motion grow with it. The order is α1 to α5 of `nav2_amcl`.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OmnidirectionalNoise {
    /// α1: variance of the turn per squared turn, in rad²/rad².
    pub turn_per_turn: f64,
    /// α2: variance of the turn per squared run, in rad²/m².
    pub turn_per_run: f64,
    /// α3: variance along the run per squared run, in m²/m².
    pub run_per_run: f64,
    /// α4: variance of the place per squared turn, in m²/rad², in every direction.
    pub run_per_turn: f64,
    /// α5: variance across the run per squared run, in m²/m².
    pub strafe_per_run: f64,
}

impl Default for OmnidirectionalNoise {
    /// The customary 0.2 of `nav2_amcl` and Beluga, which covers slipping rollers.
    fn default() -> Self {
        Self::uniform(0.2)
    }
}

impl OmnidirectionalNoise {
    /// The same factor for all five.
    pub const fn uniform(alpha: f64) -> Self {
        Self {
            turn_per_turn: alpha,
            turn_per_run: alpha,
            run_per_run: alpha,
            run_per_turn: alpha,
            strafe_per_run: alpha,
        }
    }
}

/// The odometry motion model of an omnidirectional vehicle.
///
/// The covariance that an increment may carry is not used: the model states the noise.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Se2;
/// use agv_core::odometry::OdometryIncrement;
/// use agv_core::time::Stamp;
/// use agv_filters::particle::{MotionModel, OmnidirectionalNoise, OmnidirectionalOdometryModel};
///
/// let model = OmnidirectionalOdometryModel::new(OmnidirectionalNoise::uniform(0.001))?;
/// let (a, b) = (Se2::default(), Se2::new(0.0, 1.0, 0.0)); // sideways
/// let motion = OdometryIncrement::between(Stamp::default(), &a, Stamp::default(), &b)?;
/// let moved = model.condition(&motion)(&Se2::new(5.0, 0.0, 0.0), &mut Seed(7).stream(0, 0));
/// assert!((moved.y() - 1.0).abs() < 0.2 && moved.yaw().abs() < 0.2);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "OmnidirectionalNoise", into = "OmnidirectionalNoise")
)]
pub struct OmnidirectionalOdometryModel {
    noise: OmnidirectionalNoise,
}

stored_as!(OmnidirectionalNoise => OmnidirectionalOdometryModel.noise);

impl OmnidirectionalOdometryModel {
    /// Checks the noise factors.
    ///
    /// # Errors
    /// A factor that is negative or not finite.
    pub fn new(noise: OmnidirectionalNoise) -> Result<Self, Error> {
        check_factors!(noise: turn_per_turn, turn_per_run, run_per_run, run_per_turn, strafe_per_run);
        Ok(Self { noise })
    }

    /// The noise factors.
    pub const fn noise(&self) -> &OmnidirectionalNoise {
        &self.noise
    }

    /// Unit vector of the run in the frame of the start, and the deviations along it, across it and of the turn.
    fn spread(&self, start_from_end: &Se2) -> (Vector2<f64>, Vector3<f64>) {
        let (run, turn) = (start_from_end.translation(), start_from_end.yaw());
        let OmnidirectionalNoise { turn_per_turn, turn_per_run, run_per_run, run_per_turn, strafe_per_run } =
            self.noise;
        let (run2, turn2) = (run.norm_squared(), turn * turn);
        let sigma = Vector3::new(
            (run_per_run * run2 + run_per_turn * turn2).sqrt(),
            (strafe_per_run * run2 + run_per_turn * turn2).sqrt(),
            (turn_per_turn * turn2 + turn_per_run * run2).sqrt(),
        );
        // At rest all directions are alike, so that jitter has none.
        (run.try_normalize(0.0).unwrap_or_else(Vector2::x), sigma)
    }
}

impl MotionModel for OmnidirectionalOdometryModel {
    type Motion = OdometryIncrement;

    fn condition<'a>(&'a self, motion: &'a OdometryIncrement) -> impl Fn(&Se2, &mut Stream) -> Se2 + Sync + 'a {
        let (along, sigma) = self.spread(&motion.start_from_end);
        let (run, turn) = (motion.start_from_end.translation(), motion.start_from_end.rotation());
        let (along, across) = (along * sigma.x, Vector2::new(-along.y, along.x) * sigma.y);
        move |pose, stream| {
            let noise: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(stream));
            let travel = run + along * noise[0] + across * noise[1];
            Se2::from_parts(pose.act(&travel), pose.rotation().compose(&turn).compose(&small_turn(sigma.z * noise[2])))
        }
    }

    fn covariance(&self, motion: &OdometryIncrement) -> Matrix3<f64> {
        let (along, sigma) = self.spread(&motion.start_from_end);
        // The run's direction, seen from the end.
        let along = motion.start_from_end.rotation().inverse().act(&along);
        let jacobian = Matrix3::new(along.x, -along.y, 0.0, along.y, along.x, 0.0, 0.0, 0.0, 1.0);
        propagate_covariance::<Se2>(&jacobian, &Matrix3::from_diagonal(&sigma.component_mul(&sigma)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_noise_is_named() {
        let good = OmnidirectionalNoise::default();
        for (name, bad) in [
            ("turn_per_turn", OmnidirectionalNoise { turn_per_turn: -0.1, ..good }),
            ("turn_per_run", OmnidirectionalNoise { turn_per_run: f64::NAN, ..good }),
            ("run_per_run", OmnidirectionalNoise { run_per_run: f64::INFINITY, ..good }),
            ("run_per_turn", OmnidirectionalNoise { run_per_turn: -1.0, ..good }),
            ("strafe_per_run", OmnidirectionalNoise { strafe_per_run: f64::NEG_INFINITY, ..good }),
        ] {
            assert!(OmnidirectionalOdometryModel::new(bad).unwrap_err().to_string().starts_with(name));
        }
    }
}
