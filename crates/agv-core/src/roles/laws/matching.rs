//! Laws of [`ScanMatcher`], [`Registration`] and [`LidarOdometry`].

use super::{LawViolation, NOT_FINITE, ensure};
use crate::{
    geometry::{LieGroup, Se2, Se3, So3},
    roles::{LidarOdometry, Registration, ScanMatcher, Termination},
    sensors::{LaserScan, PointCloud, PointSource},
};
use nalgebra::Vector3;

/// Checks a scan matcher that has a reference, on a `scan` that it can match from `guess`.
///
/// # Errors
/// The first law that was broken.
pub fn scan_matcher(player: &mut dyn ScanMatcher, scan: &LaserScan, guess: &Se2) -> Result<(), LawViolation> {
    const ROLE: &str = "ScanMatcher";
    for value in NOT_FINITE {
        let refused = player.match_scan(scan, &Se2::new(value, 0.0, 0.0)).is_err();
        ensure(ROLE, "a guess that is not finite is refused", refused)?;
    }
    let result = player.match_scan(scan, guess);
    let found =
        result.as_ref().is_ok_and(|m| m.converged && m.map_from_base.is_finite() && (0.0..=1.0).contains(&m.score));
    ensure(ROLE, "a scan that fits is matched", found)?;
    ensure(ROLE, "the same call has the same answer, bit for bit", player.match_scan(scan, guess) == result)?;
    let mut blind = scan.clone();
    let refilled = blind.refill(scan.stamp(), std::iter::repeat_n(f32::NAN, scan.len()));
    let unmatched = player.match_scan(&blind, guess);
    let held = unmatched.is_ok_and(|m| !m.converged && m.map_from_base == *guess);
    ensure(ROLE, "a scan without readings leaves the guess", refilled.is_ok() && held)
}

/// Checks a registration that has a target, on a `source` that it can align from `guess`.
///
/// # Errors
/// The first law that was broken.
pub fn registration(player: &mut dyn Registration, source: &dyn PointSource, guess: &Se3) -> Result<(), LawViolation> {
    const ROLE: &str = "Registration";
    for value in NOT_FINITE {
        let nowhere = Se3::from_parts(Vector3::new(value, 0.0, 0.0), So3::identity());
        ensure(ROLE, "a guess that is not finite is refused", player.align(source, &nowhere).is_err())?;
    }
    let result = player.align(source, guess);
    let found =
        result.as_ref().is_ok_and(|a| a.termination == Termination::Converged && a.target_from_source.is_finite());
    ensure(ROLE, "a source that fits is aligned", found)?;
    ensure(ROLE, "the same call has the same answer, bit for bit", player.align(source, guess) == result)?;
    for hopeless in [PointCloud::default(), PointCloud::from_points([Vector3::from_element(f32::NAN); 3])] {
        let held = player
            .align(&hopeless, guess)
            .is_ok_and(|a| a.termination == Termination::TooFewPoints && a.target_from_source == *guess);
        ensure(ROLE, "a source without points leaves the guess", held)?;
    }
    Ok(())
}

/// Checks a lidar odometry that was just built, on two clouds of one scene.
///
/// # Errors
/// The first law that was broken.
pub fn lidar_odometry(
    player: &mut dyn LidarOdometry,
    first: &PointCloud,
    second: &PointCloud,
) -> Result<(), LawViolation> {
    const ROLE: &str = "LidarOdometry";
    let begun = player.process(first, None);
    let at_origin = begun.is_ok_and(|step| step.odom_from_base == Se3::identity());
    ensure(ROLE, "the first cloud is the origin", at_origin)?;
    for value in NOT_FINITE {
        let nowhere = Se3::from_parts(Vector3::new(value, 0.0, 0.0), So3::identity());
        ensure(ROLE, "a prior that is not finite is refused", player.process(second, Some(&nowhere)).is_err())?;
    }
    let followed = player.process(second, None).is_ok_and(|step| step.odom_from_base.is_finite());
    ensure(ROLE, "a cloud of the same scene is taken", followed)?;
    let lost = player.process(&PointCloud::default(), None);
    let said = lost.is_ok_and(|step| step.termination == Termination::TooFewPoints && step.odom_from_base.is_finite());
    ensure(ROLE, "a cloud without points is an outcome", said)
}
