//! Prediction by another filter: the increment says itself how sure it is.
//!
//! A Kalman filter that fuses wheels and gyro knows the motion better than a model of the wheels alone, and knows how well.
//! Its increments are the proposal of the particle filter (paper 000, section 1.4):
//!
//! ```text
//! end = start motion exp(τ)          τ ~ N(0, inflation Σ + floor)
//! ```
//!
//! with `Σ` the covariance that the [`OdometryIncrement`] carries, of its right increment.

use super::{MotionModel, check_factors, stored_as};
use crate::particle::gaussian::semidefinite_root;
use agv_core::{
    Error,
    compute::Stream,
    geometry::{LieGroup, Se2, UncertainPose, propagate_covariance},
    odometry::OdometryIncrement,
    time::Stamp,
};
use nalgebra::{Matrix3, Vector3};
use rand_distr::{Distribution, StandardNormal};

/// What is made of the stated covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PriorNoise {
    /// Factor on the stated covariance.
    pub inflation: f64,
    /// Least variance of the place per squared run, along each axis, in m²/m².
    pub position_per_run: f64,
    /// Least variance of the turn per squared run, in rad²/m².
    pub turn_per_run: f64,
    /// Least variance of the turn per squared turn, in rad²/rad².
    pub turn_per_turn: f64,
}

impl Default for PriorNoise {
    /// The covariance as it is stated, and 5 % of the run and of the turn beside it: filters are surer of themselves than they
    /// should be, and particles need room between them.
    fn default() -> Self {
        Self { inflation: 1.0, position_per_run: 0.0025, turn_per_run: 0.0025, turn_per_turn: 0.0025 }
    }
}

/// The motion model that takes the increment's own covariance.
///
/// ```
/// use agv_core::geometry::{Se2, UncertainPose};
/// use agv_core::nalgebra::{Matrix3, Vector3};
/// use agv_core::time::Stamp;
/// use agv_filters::particle::{MotionModel, PriorMotionModel, PriorNoise};
///
/// // Two estimates of a filter of wheels and gyro, 0.3 m apart.
/// let spread = |xy: f64, yaw: f64| Matrix3::from_diagonal(&Vector3::new(xy * xy, xy * xy, yaw * yaw));
/// let before = UncertainPose::new(Se2::new(1.0, 0.0, 0.0), spread(0.10, 0.01))?;
/// let after = UncertainPose::new(Se2::new(1.3, 0.0, 0.0), spread(0.11, 0.012))?;
/// let (then, now) = (Stamp::from_seconds(1.0), Stamp::from_seconds(1.5));
/// let motion = PriorMotionModel::increment((then, &before), (now, &after))?;
///
/// let model = PriorMotionModel::new(PriorNoise::default())?;
/// assert!(model.covariance(&motion)[(0, 0)] > 0.11 * 0.11 - 0.10 * 0.10);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "PriorNoise", into = "PriorNoise")
)]
pub struct PriorMotionModel {
    noise: PriorNoise,
}

stored_as!(PriorNoise => PriorMotionModel.noise);

impl PriorMotionModel {
    /// Checks the noise.
    ///
    /// # Errors
    /// A field that is negative or not finite.
    pub fn new(noise: PriorNoise) -> Result<Self, Error> {
        check_factors!(noise: inflation, position_per_run, turn_per_run, turn_per_turn);
        Ok(Self { noise })
    }

    /// What is made of the stated covariance.
    pub const fn noise(&self) -> &PriorNoise {
        &self.noise
    }

    /// The motion between two estimates of one filter, with what the filter lost in certainty on the way.
    ///
    /// What it knew at the start travels with the motion; what the end's covariance has beyond that is the motion's own. In
    /// directions where a measurement has made the filter surer meanwhile, that is nothing: a variance of zero.
    ///
    /// # Errors
    /// [`Error::NotFinite`].
    pub fn increment(
        start: (Stamp, &UncertainPose<Se2>),
        end: (Stamp, &UncertainPose<Se2>),
    ) -> Result<OdometryIncrement, Error> {
        let motion = OdometryIncrement::between(start.0, start.1.mean(), end.0, end.1.mean())?;
        let (jacobian, _) = start.1.mean().compose_jacobians(&motion.start_from_end);
        let lost = end.1.covariance() - propagate_covariance::<Se2>(&jacobian, start.1.covariance());
        let not_finite = Error::NotFinite { name: "covariance", value: f64::NAN };
        let (variances, axes) = Se2::symmetric_eigen(&lost).ok_or(not_finite)?;
        let kept = Matrix3::from_diagonal(&variances.map(|variance| variance.max(0.0)));
        Ok(OdometryIncrement { covariance: propagate_covariance::<Se2>(&axes, &kept), ..motion })
    }
}

impl MotionModel for PriorMotionModel {
    type Motion = OdometryIncrement;

    fn condition<'a>(&'a self, motion: &'a OdometryIncrement) -> impl Fn(&Se2, &mut Stream) -> Se2 + Sync + 'a {
        let root = semidefinite_root(&self.covariance(motion));
        move |pose, stream| {
            let noise = Vector3::from_fn(|_, _| StandardNormal.sample(stream));
            (*pose * motion.start_from_end).plus(&(root * noise))
        }
    }

    fn covariance(&self, motion: &OdometryIncrement) -> Matrix3<f64> {
        let PriorNoise { inflation, position_per_run, turn_per_run, turn_per_turn } = self.noise;
        let (run2, turn2) = (motion.start_from_end.translation().norm_squared(), motion.start_from_end.yaw().powi(2));
        let place = position_per_run * run2;
        let floor = Vector3::new(place, place, turn_per_run * run2 + turn_per_turn * turn2);
        motion.covariance * inflation + Matrix3::from_diagonal(&floor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Two estimates of a filter that only dead-reckons give back the covariance of the motion between them.
        #[test]
        fn increments_between_estimates_are_those_that_were_composed(
            x in -1.0..1.0_f64, y in -1.0..1.0_f64, yaw in -3.0..3.0_f64,
            a in prop::array::uniform9(-0.3..0.3_f64), b in prop::array::uniform9(-0.1..0.1_f64),
        ) {
            let [a, b] = [a, b].map(|entries| Matrix3::from_row_slice(&entries));
            let before = UncertainPose::new(Se2::new(3.0, -2.0, 0.7), a * a.transpose()).unwrap();
            let moved = UncertainPose::new(Se2::new(x, y, yaw), b * b.transpose()).unwrap();
            let after = before.compose(&moved);
            let now = Stamp::default();
            let motion = PriorMotionModel::increment((now, &before), (now, &after)).unwrap();
            prop_assert!(motion.start_from_end.minus(moved.mean()).norm() < 1e-9);
            prop_assert!((motion.covariance - moved.covariance()).norm() < 1e-9);
        }
    }

    #[test]
    fn a_filter_that_became_surer_states_no_noise() {
        let spread = |yaw: f64| Matrix3::from_diagonal(&Vector3::new(0.01, 0.01, yaw));
        let [before, after] = [0.1, 0.05].map(|yaw| UncertainPose::new(Se2::default(), spread(yaw)).unwrap());
        let motion = PriorMotionModel::increment((Stamp::default(), &before), (Stamp::default(), &after)).unwrap();
        assert_eq!(motion.covariance, Matrix3::zeros());
    }

    #[test]
    fn bad_noise_is_named() {
        let good = PriorNoise::default();
        for (name, bad) in [
            ("inflation", PriorNoise { inflation: -1.0, ..good }),
            ("position_per_run", PriorNoise { position_per_run: f64::NAN, ..good }),
            ("turn_per_run", PriorNoise { turn_per_run: f64::INFINITY, ..good }),
            ("turn_per_turn", PriorNoise { turn_per_turn: -0.1, ..good }),
        ] {
            assert!(PriorMotionModel::new(bad).unwrap_err().to_string().starts_with(name));
        }
    }
}
