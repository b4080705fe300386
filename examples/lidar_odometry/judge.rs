//! How far the trajectory is from the reference.

use crate::{Result, load::Drive};
use agv_nav::core::{
    geometry::{LieGroup, Se3},
    metrics::{Delta, PosePair, TrajectoryAlignment, TrajectoryPose, absolute_error, relative_error},
    time::Stamp,
};
use agv_support::cli::Report;

/// How far a trajectory is off as a whole.
pub(crate) struct TrajectoryErrors {
    /// Of the last pose with the first aligned, in metres and degrees.
    pub(crate) end: (f64, f64),
    /// Greatest with the first pose aligned, in metres.
    pub(crate) worst: f64,
    /// Root mean square of the positions after the best rigid alignment, in metres.
    pub(crate) ate: f64,
}

/// The scans that have a reference.
fn pairs(drive: &Drive, poses: &[Se3]) -> Vec<PosePair<Se3>> {
    std::iter::zip(&drive.truth, poses)
        .enumerate()
        .filter_map(|(index, (truth, &estimate))| {
            Some(PosePair { stamp: Stamp::from_seconds(index as f64), reference: (*truth)?, estimate })
        })
        .collect()
}

/// Errors over the scans that have a reference; none without any.
pub(crate) fn trajectory(drive: &Drive, poses: &[Se3]) -> Result<Option<TrajectoryErrors>> {
    let pairs = pairs(drive, poses);
    let (Some(first), Some(last)) = (pairs.first(), pairs.last()) else { return Ok(None) };
    let end = first.reference.between(&last.reference).between(&first.estimate.between(&last.estimate));
    Ok(Some(TrajectoryErrors {
        end: (end.distance(), end.angle().to_degrees()),
        worst: absolute_error(&pairs, TrajectoryAlignment::FirstPose)?.translation.max(),
        ate: absolute_error(&pairs, TrajectoryAlignment::Rigid)?.translation.rmse(),
    }))
}

/// Reports the odometry's errors: each step's, and those of the trajectory.
pub(crate) fn errors(drive: &Drive, poses: &[Se3], report: &mut Report) -> Result<()> {
    let Some(errors) = trajectory(drive, poses)? else { return Ok(()) };
    let pairs = pairs(drive, poses);
    let path = pairs.windows(2).map(|pair| pair[0].reference.between(&pair[1].reference).distance()).sum();
    report.number("path_m", path);
    if pairs.len() > 1 {
        let step = relative_error(&pairs, Delta::Frames(1))?;
        report
            .number("step_translation_error_median_m", step.translation.median())
            .number("step_translation_error_p95_m", step.translation.percentile(95.0))
            .number("step_rotation_error_median_deg", step.rotation.median().to_degrees())
            .number("step_rotation_error_p95_deg", step.rotation.percentile(95.0).to_degrees());
    }
    report
        .number("end_error_m", errors.end.0)
        .number("end_error_deg", errors.end.1)
        .number("worst_error_m", errors.worst)
        .number("ate_rmse_m", errors.ate);
    Ok(())
}
