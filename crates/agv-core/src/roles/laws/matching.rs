//! Laws of [`ScanMatcher`], [`Registration`] and [`LidarOdometry`].

use super::{LawViolation, NOT_FINITE, ensure};
use crate::{
    geometry::{LieGroup, Se2, Se3, So3},
    roles::{Alignment, AlignmentError, LidarOdometry, Registration, ScanMatcher, TargetScan, Termination},
    sensors::{LaserScan, PointCloud, PointSource},
};
use nalgebra::Vector3;

/// Checks a scan matcher on a `target` and on a `scan` that it can match with it from `guess`.
///
/// # Errors
/// The first law that was broken.
pub fn scan_matcher(
    player: &mut dyn ScanMatcher,
    target: &[TargetScan<'_>],
    scan: &LaserScan,
    guess: &Se2,
) -> Result<(), LawViolation> {
    const ROLE: &str = "ScanMatcher";
    ensure(ROLE, "a good target is taken", player.set_target(target).is_ok())?;
    for value in NOT_FINITE {
        let refused = player.match_scan(scan, &Se2::new(value, 0.0, 0.0)).is_err();
        ensure(ROLE, "a guess that is not finite is refused", refused)?;
    }
    let result = player.match_scan(scan, guess);
    sound(ROLE, &result)?;
    ensure(ROLE, "the same call has the same answer, bit for bit", player.match_scan(scan, guess) == result)?;

    let mut blind = scan.clone();
    let refilled = blind.refill(scan.stamp(), std::iter::repeat_n(f32::NAN, scan.len()));
    let unseen = refilled.is_ok() && nothing_learnt(&player.match_scan(&blind, guess), guess);
    ensure(ROLE, "a scan without readings leaves the guess, without information", unseen)?;

    let nowhere = TargetScan { target_from_base: Se2::new(f64::NAN, 0.0, 0.0), scan };
    let empty = TargetScan { target_from_base: *guess, scan: &blind };
    for hopeless in [&[][..], &[nowhere], &[empty]] {
        ensure(ROLE, "a target without readings or pose is refused", player.set_target(hopeless).is_err())?;
    }
    ensure(ROLE, "a refused target leaves the last one", player.match_scan(scan, guess) == result)
}

/// Checks a registration that was just built on a `target` and a `source` that it can align with it from `guess`.
///
/// # Errors
/// The first law that was broken.
pub fn registration(
    player: &mut dyn Registration,
    target: &dyn PointSource,
    source: &dyn PointSource,
    guess: &Se3,
) -> Result<(), LawViolation> {
    const ROLE: &str = "Registration";
    let early = player.align(source, guess);
    ensure(ROLE, "without a target nothing is aligned", early == Err(AlignmentError::NoTarget))?;
    ensure(ROLE, "a good target is taken", player.set_target(target).is_ok())?;
    for value in NOT_FINITE {
        let nowhere = Se3::from_parts(Vector3::new(value, 0.0, 0.0), So3::identity());
        ensure(ROLE, "a guess that is not finite is refused", player.align(source, &nowhere).is_err())?;
    }
    let result = player.align(source, guess);
    sound(ROLE, &result)?;
    ensure(ROLE, "the same call has the same answer, bit for bit", player.align(source, guess) == result)?;
    for hopeless in [PointCloud::default(), PointCloud::from_points([Vector3::from_element(f32::NAN); 3])] {
        let unseen = nothing_learnt(&player.align(&hopeless, guess), guess);
        ensure(ROLE, "a source without points leaves the guess, without information", unseen)?;
        ensure(ROLE, "a target without points is refused", player.set_target(&hopeless).is_err())?;
    }
    ensure(ROLE, "a refused target leaves the last one", player.align(source, guess) == result)
}

/// A result of a case that the player can handle.
fn sound<G: LieGroup>(role: &'static str, result: &Result<Alignment<G>, AlignmentError>) -> Result<(), LawViolation> {
    let found = result.as_ref().ok().filter(|a| a.converged() && a.target_from_source.is_finite());
    let Some(found) = found else { return ensure(role, "a source that fits is aligned", false) };
    let graded = found.score.is_finite() && (0.0..=1.0).contains(&found.inlier_ratio);
    ensure(role, "the score is a number and the inlier ratio a share", graded)?;
    let information = G::check_covariance("information", &found.information).is_ok();
    ensure(role, "the information is symmetric and positive semi-definite", information)?;
    let projector = found.unobserved;
    let apart = |a: &G::Matrix, b: &G::Matrix| G::matrix_slice(&(*a - *b)).iter().all(|v| v.abs() < 1e-9);
    let projects = apart(&(projector * projector), &projector) && apart(&G::transpose(&projector), &projector);
    ensure(role, "the unobserved directions are an orthogonal projector", projects)
}

/// A result of a source without points.
fn nothing_learnt<G: LieGroup>(result: &Result<Alignment<G>, AlignmentError>, guess: &G) -> bool {
    let expected = Alignment::unknown(*guess, Termination::TooFewPoints);
    result.as_ref().is_ok_and(|found| {
        (found.target_from_source, found.information, found.unobserved, found.termination)
            == (expected.target_from_source, expected.information, expected.unobserved, expected.termination)
    })
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
    let at_origin = begun.is_ok_and(|step| step.odom_from_base == Se3::identity() && step.alignment.is_none());
    ensure(ROLE, "the first cloud is the origin, and aligned with nothing", at_origin)?;
    for value in NOT_FINITE {
        let nowhere = Se3::from_parts(Vector3::new(value, 0.0, 0.0), So3::identity());
        ensure(ROLE, "a prior that is not finite is refused", player.process(second, Some(&nowhere)).is_err())?;
    }
    let followed = player.process(second, None).ok().and_then(|step| step.alignment.map(|a| (step.odom_from_base, a)));
    let Some((odom_from_base, alignment)) = followed else {
        return ensure(ROLE, "a cloud of the same scene is taken", false);
    };
    let agrees = odom_from_base == alignment.target_from_source;
    ensure(ROLE, "the pose is that of the alignment", agrees || !alignment.converged())?;
    sound(ROLE, &Ok(alignment))?;
    let lost = player.process(&PointCloud::default(), None);
    let said = lost.is_ok_and(|step| {
        let termination = step.alignment.map(|alignment| alignment.termination);
        termination == Some(Termination::TooFewPoints) && step.odom_from_base.is_finite()
    });
    ensure(ROLE, "a cloud without points is an outcome", said)
}

#[cfg(test)]
mod tests;
