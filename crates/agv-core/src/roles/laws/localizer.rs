//! Laws of [`Localizer`] and [`Correct`].

use super::{LawViolation, NOT_FINITE, ensure};
use crate::{
    geometry::LieGroup,
    odometry::MotionIncrement,
    roles::{Correct, LocalizationError, Localizer, PoseBelief, PoseEstimate, UpdateOutcome},
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
    let unknown = player.estimate();
    ensure(ROLE, "before the first belief variances are infinite", variances(&unknown).all(f64::is_infinite))?;
    let early = player.predict(motion);
    ensure(ROLE, "a motion before the first belief is refused", early == Err(LocalizationError::NotInitialized))?;

    for value in NOT_FINITE {
        let nowhere = G::exp(&G::tangent_from_slice(&[value]));
        let refused = player.initialize(&PoseBelief::around(nowhere, *covariance)).is_err()
            && player.initialize(&PoseBelief::around(*start, *covariance * value)).is_err();
        ensure(ROLE, "a belief that is not finite is refused", refused)?;
    }
    let negative = player.initialize(&PoseBelief::around(*start, *covariance * -1.0));
    ensure(ROLE, "a covariance that is not positive is refused", negative.is_err())?;
    ensure(ROLE, "a refused belief changes nothing", same(&player.estimate(), &unknown))?;

    let initialized = player.initialize(&PoseBelief::around(*start, *covariance));
    ensure(ROLE, "a good belief is taken", initialized.is_ok())?;
    ensure(ROLE, "the estimate is near the belief", near(&player.estimate(), start, covariance))?;

    let before = player.estimate();
    for value in NOT_FINITE {
        let nowhere = MotionIncrement { start_from_end: G::exp(&G::tangent_from_slice(&[value])), ..*motion };
        let vague = MotionIncrement { covariance: G::identity_matrix() * value, ..*motion };
        let refused = player.predict(&nowhere).is_err() && player.predict(&vague).is_err();
        ensure(ROLE, "a motion that is not finite is refused", refused)?;
    }
    ensure(ROLE, "a refused motion changes nothing", same(&player.estimate(), &before))?;

    ensure(ROLE, "a good motion is taken", player.predict(motion).is_ok())?;
    let moved = before.map_from_base.compose(&motion.start_from_end);
    let after = player.estimate();
    // The belief's own spread bounds how far its mean may be from the mean moved.
    let carry = motion.start_from_end.inverse().adjoint();
    let carried = carry * before.covariance * G::transpose(&carry) + motion.covariance;
    let [least, trace] = [carried, after.covariance].map(|m| variances(&PoseEstimate::new(moved, m)).sum::<f64>());
    ensure(ROLE, "a motion makes nothing more certain", trace >= (1.0 - SAMPLING_LOSS) * least)?;
    ensure(ROLE, "the estimate refers to the end of the motion", after.stamp == Some(motion.end))?;
    ensure(ROLE, "the estimate follows the motion", near(&after, &moved, &(after.covariance + *covariance)))
}

/// Checks that `empty`, an observation without any usable reading, is skipped and changes nothing.
///
/// The localizer has a belief already.
///
/// # Errors
/// The first law that was broken.
pub fn correct<Z: ?Sized, G: LieGroup>(player: &mut dyn Correct<Z, Pose = G>, empty: &Z) -> Result<(), LawViolation> {
    let before = player.estimate();
    let outcome = player.update(empty);
    ensure("Correct", "an observation that says nothing is skipped", matches!(outcome, Ok(UpdateOutcome::Skipped(_))))?;
    ensure("Correct", "a skipped observation changes nothing", same(&player.estimate(), &before))
}

fn variances<G: LieGroup>(estimate: &PoseEstimate<G>) -> impl Iterator<Item = f64> + use<G> {
    let entries = G::matrix_slice(&estimate.covariance).to_vec();
    (0..G::DOF).map(move |i| entries.get(i * (G::DOF + 1)).copied().unwrap_or(f64::NAN))
}

fn near<G: LieGroup>(estimate: &PoseEstimate<G>, pose: &G, covariance: &G::Matrix) -> bool {
    let difference = estimate.map_from_base.minus(pose);
    let bounds = variances(&PoseEstimate::new(*pose, *covariance));
    G::tangent_slice(&difference).iter().zip(bounds).all(|(d, variance)| d.abs() <= BOUND * variance.sqrt() + 1e-9)
}

fn same<G: LieGroup>(a: &PoseEstimate<G>, b: &PoseEstimate<G>) -> bool {
    a.map_from_base == b.map_from_base && G::matrix_slice(&a.covariance) == G::matrix_slice(&b.covariance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{check, geometry::Se2, time::Stamp};
    use nalgebra::Matrix3;

    /// Dead reckoning that multiplies its covariance by a factor at each motion.
    struct Reckoning {
        known: Option<PoseEstimate<Se2>>,
        factor: f64,
    }

    impl Localizer for Reckoning {
        type Pose = Se2;

        fn initialize(&mut self, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
            if let PoseBelief::Around { map_from_base, covariance } = *belief {
                check::finite("x", map_from_base.x())?;
                Se2::check_covariance("covariance", &covariance)?;
                self.known = Some(PoseEstimate::new(map_from_base, covariance));
            }
            Ok(())
        }

        fn predict(&mut self, motion: &MotionIncrement<Se2>) -> Result<(), LocalizationError> {
            let known = self.known.as_mut().ok_or(LocalizationError::NotInitialized)?;
            if !motion.is_finite() {
                check::finite("motion", f64::NAN)?;
            }
            let carry = motion.start_from_end.inverse().adjoint();
            known.map_from_base = known.map_from_base * motion.start_from_end;
            known.covariance = carry * known.covariance * carry.transpose() * self.factor;
            known.stamp = Some(motion.end);
            Ok(())
        }

        fn estimate(&self) -> PoseEstimate<Se2> {
            let nothing = PoseEstimate::new(Se2::identity(), Matrix3::from_diagonal_element(f64::INFINITY));
            self.known.unwrap_or(nothing)
        }
    }

    #[test]
    fn a_localizer_that_grows_certain_by_driving_is_caught() {
        let now = Stamp::default();
        let ahead = MotionIncrement::between(now, &Se2::identity(), now + 1.0, &Se2::new(1.0, 0.0, 0.3)).unwrap();
        let verdict = |factor| {
            let (start, covariance) = (Se2::new(2.0, 1.0, 0.5), Matrix3::identity() * 0.01);
            localizer(&mut Reckoning { known: None, factor }, &start, &covariance, &ahead)
        };
        assert_eq!(verdict(1.0), Ok(()));
        assert_eq!(verdict(0.5).unwrap_err().law, "a motion makes nothing more certain");
    }
}
