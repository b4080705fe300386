//! Laws of [`Localizer`] and [`Correct`].

use super::{LawViolation, NOT_FINITE, ensure};
use crate::{
    geometry::{LieGroup, UncertainPose, propagate_covariance},
    odometry::MotionIncrement,
    roles::{Correct, LocalizationError, LocalizationStatus, Localizer, PoseBelief, PoseEstimate, UpdateOutcome},
    sensors::Observation,
};

const ROLE: &str = "Localizer";

/// Standard deviations within which a sampled mean must lie: with ten standard deviations a law never fails by chance.
const BOUND: f64 = 10.0;

/// Share of its trace that a sampled covariance may lose over a motion. What samples of belief and noise have in common by
/// chance is at most `1/√N` of the trace: ten standard deviations of it for 2000 samples, five for 400.
const SAMPLING_LOSS: f64 = 0.25;

/// Checks a localizer that was just built: it refuses what it must, and a belief around `start` follows `motion`.
///
/// `covariance` is that of the belief; `motion` should be a plausible one, for instance 1 m ahead. The motion may not make the
/// belief more certain: the trace of its covariance, carried to the end of the motion, may shrink by a quarter at most, which
/// is left to the sampling error of filters with some hundred samples or more.
///
/// # Errors
/// The first law that was broken.
pub fn localizer<G: LieGroup>(
    player: &mut dyn Localizer<Pose = G>,
    start: &G,
    covariance: &G::Matrix,
    motion: &MotionIncrement<G>,
) -> Result<(), LawViolation> {
    ensure(ROLE, "before the first belief there is no estimate", player.estimate().is_none())?;
    let status = player.status();
    ensure(ROLE, "before the first belief the status says so", status == LocalizationStatus::Uninitialized)?;
    let early = player.predict(motion);
    ensure(ROLE, "a motion before the first belief is refused", early == Err(LocalizationError::NotInitialized))?;

    let belief = UncertainPose::new(*start, *covariance).ok();
    let initialized = belief.is_some_and(|pose| player.initialize(&PoseBelief::Around(pose)).is_ok());
    ensure(ROLE, "a good belief is taken", initialized)?;
    let before = known(player)?;
    ensure(ROLE, "the estimate is near the belief", near(&before, start, covariance))?;
    let is_converging = matches!(player.status(), LocalizationStatus::Converging { .. });
    ensure(ROLE, "a belief that no observation confirmed is not trusted", is_converging)?;

    for value in NOT_FINITE {
        let nowhere = MotionIncrement { start_from_end: G::exp(&G::tangent_from_slice(&[value])), ..*motion };
        let vague = MotionIncrement { covariance: G::identity_matrix() * value, ..*motion };
        let refused = player.predict(&nowhere).is_err() && player.predict(&vague).is_err();
        ensure(ROLE, "a motion that is not finite is refused", refused)?;
    }
    ensure(ROLE, "a refused motion changes nothing", known(player)? == before)?;

    ensure(ROLE, "a good motion is taken", player.predict(motion).is_ok())?;
    let after = known(player)?;
    // The belief's own spread bounds how far its mean may be from the mean moved.
    let moved = before.map_from_base().compose(&motion.start_from_end);
    let (carry, _) = before.map_from_base().compose_jacobians(&motion.start_from_end);
    let carried = propagate_covariance::<G>(&carry, before.covariance()) + motion.covariance;
    let [least, trace] = [&carried, after.covariance()].map(|m| variances::<G>(m).sum::<f64>());
    ensure(ROLE, "a motion makes nothing more certain", trace >= (1.0 - SAMPLING_LOSS) * least)?;
    ensure(ROLE, "the estimate refers to the end of the motion", after.stamp == Some(motion.end))?;
    ensure(ROLE, "the estimate follows the motion", near(&after, &moved, &(*after.covariance() + *covariance)))
}

/// Checks that `empty`, an observation without any usable reading, is skipped and changes nothing.
///
/// The localizer has a belief already.
///
/// # Errors
/// The first law that was broken.
pub fn correct<Z: ?Sized, G: LieGroup>(player: &mut dyn Correct<Z, Pose = G>, empty: &Z) -> Result<(), LawViolation> {
    let before = (player.estimate(), player.status());
    let outcome = player.update(empty);
    ensure("Correct", "an observation that says nothing is skipped", matches!(outcome, Ok(UpdateOutcome::Skipped(_))))?;
    ensure("Correct", "a skipped observation changes nothing", (player.estimate(), player.status()) == before)
}

/// Checks that two sensors do not shadow each other: `first` and `second`, good observations by two sensors from where
/// the vehicle stands, are both applied.
///
/// The localizer has a belief already, and neither sensor was applied since the vehicle stands there.
///
/// # Errors
/// The first law that was broken.
pub fn two_sensors<Z: Observation + ?Sized, G: LieGroup>(
    player: &mut dyn Correct<Z, Pose = G>,
    first: &Z,
    second: &Z,
) -> Result<(), LawViolation> {
    ensure("Correct", "the case needs two sensors", first.sensor() != second.sensor())?;
    let mut is_applied = |observation: &Z| matches!(player.update(observation), Ok(UpdateOutcome::Applied(_)));
    ensure("Correct", "a good observation is applied", is_applied(first))?;
    ensure("Correct", "an observation does not stand for that of another sensor", is_applied(second))
}

/// The estimate of a player that has a belief.
fn known<G: LieGroup>(player: &dyn Localizer<Pose = G>) -> Result<PoseEstimate<G>, LawViolation> {
    let law = "a localizer with a belief has an estimate";
    player.estimate().ok_or(LawViolation { role: ROLE, law })
}

fn variances<G: LieGroup>(covariance: &G::Matrix) -> impl Iterator<Item = f64> {
    G::matrix_slice(covariance).iter().step_by(G::DOF + 1).copied()
}

fn near<G: LieGroup>(estimate: &PoseEstimate<G>, pose: &G, covariance: &G::Matrix) -> bool {
    let difference = estimate.map_from_base().minus(pose);
    let bounds = variances::<G>(covariance);
    G::tangent_slice(&difference).iter().zip(bounds).all(|(d, variance)| d.abs() <= BOUND * variance.sqrt() + 1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        geometry::Se2,
        roles::{SkipReason, StatusMonitor, StatusParams, UpdateReport},
        sensors::{LaserScan, ScanGeometry, SensorId},
        time::Stamp,
    };
    use nalgebra::Matrix3;

    /// Dead reckoning that multiplies its covariance by a factor at each motion, and that takes one scan.
    struct Reckoning {
        known: Option<PoseEstimate<Se2>>,
        monitor: StatusMonitor,
        factor: f64,
        scans: usize,
    }

    impl Reckoning {
        fn new(factor: f64) -> Self {
            let monitor = StatusMonitor::new(StatusParams::default()).unwrap();
            Self { known: None, monitor, factor, scans: 1 }
        }
    }

    impl Localizer for Reckoning {
        type Pose = Se2;

        fn initialize(&mut self, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
            if let PoseBelief::Around(pose) = belief {
                self.known = Some(PoseEstimate::new(*pose));
                self.monitor.initialized(pose);
            }
            Ok(())
        }

        fn predict(&mut self, motion: &MotionIncrement<Se2>) -> Result<(), LocalizationError> {
            let known = self.known.as_mut().ok_or(LocalizationError::NotInitialized)?;
            let moved = known.pose.compose(&UncertainPose::new(motion.start_from_end, motion.covariance)?);
            let pose = UncertainPose::new(*moved.mean(), *moved.covariance() * self.factor)?;
            *known = PoseEstimate { pose, stamp: Some(motion.end) };
            Ok(())
        }

        fn estimate(&self) -> Option<PoseEstimate<Se2>> {
            self.known
        }

        fn status(&self) -> LocalizationStatus {
            self.monitor.status()
        }
    }

    impl Correct<LaserScan> for Reckoning {
        fn update(&mut self, _: &LaserScan) -> Result<UpdateOutcome, LocalizationError> {
            let Some(left) = self.scans.checked_sub(1) else {
                return Ok(UpdateOutcome::Skipped(SkipReason::LittleMotion));
            };
            self.scans = left;
            Ok(UpdateOutcome::Applied(UpdateReport::default()))
        }
    }

    #[test]
    fn a_localizer_that_grows_certain_by_driving_is_caught() {
        let now = Stamp::default();
        let ahead = MotionIncrement::between(now, &Se2::identity(), now + 1.0, &Se2::new(1.0, 0.0, 0.3)).unwrap();
        let verdict = |factor| {
            let (start, covariance) = (Se2::new(2.0, 1.0, 0.5), Matrix3::identity() * 0.01);
            localizer(&mut Reckoning::new(factor), &start, &covariance, &ahead)
        };
        assert_eq!(verdict(1.0), Ok(()));
        assert_eq!(verdict(0.5).unwrap_err().law, "a motion makes nothing more certain");
    }
    #[test]
    fn a_localizer_that_takes_one_sensor_for_all_is_caught() {
        let scan = |sensor| {
            let geometry = ScanGeometry { sensor: SensorId(sensor), ..Default::default() };
            LaserScan::new(Stamp::default(), geometry, vec![1.0]).unwrap()
        };
        let verdict = |scans| two_sensors(&mut Reckoning { scans, ..Reckoning::new(1.0) }, &scan(0), &scan(1));
        assert_eq!(verdict(2), Ok(()));
        assert_eq!(verdict(1).unwrap_err().law, "an observation does not stand for that of another sensor");
    }
}
