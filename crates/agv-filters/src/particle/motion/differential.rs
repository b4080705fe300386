//! Odometry motion model of a differential drive.
//!
//! A motion is taken apart into a turn towards the end, a straight run and a last turn (paper 001, Eqs. 2–3):
//!
//! ```text
//! rot1 = atan2(Δy, Δx)    trans = |(Δx, Δy)|    rot2 = Δθ - rot1          all in the base frame of the start
//! ```
//!
//! and each is drawn with its own noise (Eqs. 4–5 in their right form; Thrun, Burgard and Fox, *Probabilistic
//! Robotics*, Table 5.6, with the αs as factors of the variances):
//!
//! ```text
//! var rot1  = α1 rot1² + α2 trans²         x' = x + trans^ cos(θ + rot1^)
//! var trans = α3 trans² + α4 (rot1² + rot2²)    y' = y + trans^ sin(θ + rot1^)
//! var rot2  = α1 rot2² + α2 trans²         θ' = θ + rot1^ + rot2^
//! ```
//!
//! To that comes a drift to the side of the run, which the literature's model lacks: a vehicle that turns on the spot could then
//! only ever be drawn ahead or behind, although it slips to any side, and a base frame that sits off the wheels' axle
//! moves sideways by its offset at every turn (by 0.09 m per radian on the Intel log). Particles that cannot follow lag behind
//! across the heading.
//!
//! ```text
//! var drift = α5 (rot1² + rot2²)
//! ```
//!
//! Driving backwards is a straight run with a negative sign and no turn by π: of the two ways to take a motion apart,
//! [`RotTransRot`] takes the one that turns less.

use super::{super::trig::sin_cos, MotionModel, check_factors, sampler::Sampler, stored_as};
use agv_core::{
    Error,
    compute::Stream,
    geometry::{Se2, So2, propagate_covariance},
    odometry::{OdometryIncrement, RotTransRot},
};
use nalgebra::{Matrix3, UnitComplex, Vector3, Vector4};
use pulp::Arch;

/// How the variances of a motion grow with it. The order is α1 to α4 of the literature and of `nav2_amcl`; α5 is ours.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OdometryNoise {
    /// α1: variance of a turn per squared turn, in rad²/rad².
    pub turn_per_turn: f64,
    /// α2: variance of a turn per squared run, in rad²/m².
    pub turn_per_run: f64,
    /// α3: variance of a run per squared run, in m²/m².
    pub run_per_run: f64,
    /// α4: variance of a run per squared turn, in m²/rad².
    pub run_per_turn: f64,
    /// α5: variance of a sideways drift per squared turn, in m²/rad².
    pub drift_per_turn: f64,
}

impl Default for OdometryNoise {
    /// The customary 0.2 of `nav2_amcl` and Beluga, which covers slipping wheels, sideways as along.
    fn default() -> Self {
        Self::uniform(0.2)
    }
}

impl OdometryNoise {
    /// The same factor for all five.
    pub const fn uniform(alpha: f64) -> Self {
        Self {
            turn_per_turn: alpha,
            turn_per_run: alpha,
            run_per_run: alpha,
            run_per_turn: alpha,
            drift_per_turn: alpha,
        }
    }
}

/// The odometry motion model of a differential drive.
///
/// The covariance that an increment may carry is not used: the model states the noise.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::Se2;
/// use agv_core::nalgebra::Matrix3;
/// use agv_core::odometry::OdometryIncrement;
/// use agv_core::time::Stamp;
/// use agv_filters::particle::{DifferentialOdometryModel, MotionModel, OdometryNoise};
///
/// let model = DifferentialOdometryModel::new(OdometryNoise::uniform(0.01))?;
/// let (a, b) = (Se2::new(0.0, 0.0, 0.0), Se2::new(1.0, 0.0, 0.0));
/// let motion = OdometryIncrement::between(Stamp::default(), &a, Stamp::default(), &b)?;
/// let moved = model.condition(&motion)(&Se2::new(5.0, 0.0, 0.0), &mut Seed(7).stream(0, 0));
/// assert!((moved.x() - 6.0).abs() < 0.5);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "OdometryNoise", into = "OdometryNoise")
)]
pub struct DifferentialOdometryModel {
    noise: OdometryNoise,
}

stored_as!(OdometryNoise => DifferentialOdometryModel.noise);

/// Below this run, in metres, its direction says nothing: a vehicle that turns on the spot drifts by millimetres, and must
/// not be taken to have turned towards its drift and back. The value is `nav2_amcl`'s.
const STANDING: f64 = 0.01;

/// A motion taken apart, with the standard deviation of each part.
#[derive(Debug, Clone, Copy)]
pub(super) struct NoisyParts {
    pub(super) parts: RotTransRot,
    /// Drift to the left of a standing vehicle, in metres, which no part holds.
    pub(super) drift: f64,
    /// Standard deviations of the first turn, the run, the last turn and the drift.
    pub(super) sigma: Vector4<f64>,
}

impl DifferentialOdometryModel {
    /// Checks the noise factors.
    ///
    /// # Errors
    /// A factor that is negative or not finite.
    pub fn new(noise: OdometryNoise) -> Result<Self, Error> {
        check_factors!(noise: turn_per_turn, turn_per_run, run_per_run, run_per_turn, drift_per_turn);
        Ok(Self { noise })
    }

    /// The noise factors.
    pub const fn noise(&self) -> &OdometryNoise {
        &self.noise
    }

    pub(super) fn take_apart(&self, start_from_end: &Se2) -> NoisyParts {
        let parts = RotTransRot::from_motion_above(start_from_end, STANDING);
        let standing = start_from_end.translation().norm() < STANDING;
        let square = |value: f64| value * value;
        let (first, last) = (square(parts.rotation1), square(parts.rotation2));
        let along = start_from_end.translation().norm_squared();
        let OdometryNoise { turn_per_turn, turn_per_run, run_per_run, run_per_turn, drift_per_turn } = self.noise;
        let sigma = Vector4::new(
            (turn_per_turn * first + turn_per_run * along).sqrt(),
            (run_per_run * along + run_per_turn * (first + last)).sqrt(),
            (turn_per_turn * last + turn_per_run * along).sqrt(),
            (drift_per_turn * (first + last)).sqrt(),
        );
        NoisyParts { parts, drift: if standing { start_from_end.y() } else { 0.0 }, sigma }
    }
}

impl MotionModel for DifferentialOdometryModel {
    type Motion = OdometryIncrement;

    fn condition<'a>(&'a self, motion: &'a OdometryIncrement) -> impl Fn(&Se2, &mut Stream) -> Se2 + Sync + 'a {
        let sampler = Sampler::new(&self.take_apart(&motion.start_from_end));
        move |pose, stream| {
            let [first, run, last, drift] = sampler.draw(stream);
            sampler.moved(pose, run, drift, &small_turn(first), &small_turn(last))
        }
    }

    fn propagate(&self, motion: &OdometryIncrement, poses: &[Se2], moved: &mut [Se2], stream: &mut Stream) {
        Sampler::new(&self.take_apart(&motion.start_from_end)).propagate(poses, moved, stream, Arch::new());
    }

    fn covariance(&self, motion: &OdometryIncrement) -> Matrix3<f64> {
        let NoisyParts { parts, sigma, .. } = self.take_apart(&motion.start_from_end);
        let (run, (sin, cos)) = (parts.translation, parts.rotation2.sin_cos());
        // Columns: how the end moves, in its own frame, with the first turn, the run and the last turn.
        let jacobian = Matrix3::new(run * sin, cos, 0.0, run * cos, -sin, 0.0, 1.0, 0.0, 1.0);
        let variances = sigma.component_mul(&sigma);
        let drift = Vector3::new(sin, cos, 0.0);
        propagate_covariance::<Se2>(&jacobian, &Matrix3::from_diagonal(&variances.xyz()))
            + drift * drift.transpose() * variances.w
    }
}

/// A rotation by a noise.
#[inline]
pub(super) fn small_turn(angle: f64) -> So2 {
    let (sin, cos) = sin_cos(angle);
    UnitComplex::from_cos_sin_unchecked(cos, sin).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{compute::Seed, geometry::LieGroup, time::Stamp};
    use proptest::prelude::*;

    fn motion(start_from_end: Se2) -> OdometryIncrement {
        OdometryIncrement::between(Stamp::default(), &Se2::identity(), Stamp::default(), &start_from_end).unwrap()
    }

    #[test]
    fn a_turn_on_the_spot_is_one_turn_whatever_the_drift() {
        let model = DifferentialOdometryModel::new(OdometryNoise::default()).unwrap();
        let sigma = |x: f64, y: f64, yaw: f64| model.covariance(&motion(Se2::new(x, y, yaw)))[(2, 2)].sqrt();
        let still = sigma(0.0, 0.0, 0.2);
        for (x, y) in [(0.0015, 0.0), (0.0, 0.005), (-0.003, 0.004)] {
            assert!((sigma(x, y, 0.2) / still - 1.0).abs() < 0.02, "{x} {y}: {}", sigma(x, y, 0.2));
        }
        let turns: Vec<f64> = (0..=31).map(|i| sigma(0.0, 0.0, 0.1 * f64::from(i))).collect();
        assert!(turns.is_sorted(), "more turn, more noise: {turns:?}");
    }

    proptest! {
        /// Without noise the particle moves exactly as the odometry says, in whatever direction.
        #[test]
        fn a_noiseless_model_composes(x in -1.0..1.0_f64, y in -1.0..1.0_f64, yaw in -3.1..3.1_f64, heading in -3.0..3.0_f64) {
            let (start, travel) = (Se2::new(3.0, -2.0, heading), Se2::new(x, y, yaw));
            let model = DifferentialOdometryModel::new(OdometryNoise::uniform(0.0)).unwrap();
            let end = model.condition(&motion(travel))(&start, &mut Seed(0).stream(0, 0));
            prop_assert!(end.minus(&(start * travel)).norm() < 1e-9);
        }
    }

    #[test]
    fn a_turn_on_the_spot_drifts_to_any_side() {
        let model = DifferentialOdometryModel::new(OdometryNoise::default()).unwrap();
        let spot = model.covariance(&motion(Se2::new(0.0, 0.0, 0.2)));
        assert!((spot.m11 / spot.m22 - 1.0).abs() < 1e-9 && spot.m11 > 0.0);
    }

    #[test]
    fn reversing_is_as_certain_as_driving_ahead() {
        let model = DifferentialOdometryModel::new(OdometryNoise::default()).unwrap();
        let ahead = model.covariance(&motion(Se2::new(0.5, 0.0, 0.0)));
        let back = model.covariance(&motion(Se2::new(-0.5, 0.0, 0.0)));
        assert!((ahead.diagonal() - back.diagonal()).norm() < 1e-9);
        // A turn to the left swings the end of a reverse run to the right.
        assert!(ahead.m23 > 0.0 && (ahead.m23 + back.m23).abs() < 1e-9);
    }

    #[test]
    fn bad_noise_is_named() {
        let good = OdometryNoise::default();
        for (name, bad) in [
            ("turn_per_turn", OdometryNoise { turn_per_turn: -0.1, ..good }),
            ("turn_per_run", OdometryNoise { turn_per_run: f64::NAN, ..good }),
            ("run_per_run", OdometryNoise { run_per_run: f64::INFINITY, ..good }),
            ("run_per_turn", OdometryNoise { run_per_turn: -1.0, ..good }),
            ("drift_per_turn", OdometryNoise { drift_per_turn: -1e-9, ..good }),
        ] {
            assert!(DifferentialOdometryModel::new(bad).unwrap_err().to_string().starts_with(name));
        }
    }
}
