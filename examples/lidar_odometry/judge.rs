//! How far the trajectory is from the reference.

use crate::{Result, load::Drive};
use agv_nav::core::{
    geometry::{LieGroup, Se3},
    metrics::{Delta, PosePair, TrajectoryAlignment, TrajectoryPose, absolute_error, relative_error},
    time::Stamp,
};
use agv_support::cli::Report;

/// Errors over the scans that have a reference: each step's, that of the last pose with the first aligned, and the root mean square of
/// the positions after the best rigid alignment.
pub(crate) fn errors(drive: &Drive, poses: &[Se3], report: &mut Report) -> Result<()> {
    let pairs: Vec<_> = std::iter::zip(&drive.truth, poses)
        .enumerate()
        .filter_map(|(index, (truth, &estimate))| {
            Some(PosePair { stamp: Stamp::from_seconds(index as f64), reference: (*truth)?, estimate })
        })
        .collect();
    let (Some(first), Some(last)) = (pairs.first(), pairs.last()) else { return Ok(()) };
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
    let end = first.reference.between(&last.reference).between(&first.estimate.between(&last.estimate));
    let from_first = absolute_error(&pairs, TrajectoryAlignment::FirstPose)?;
    report
        .number("end_error_m", end.distance())
        .number("end_error_deg", end.angle().to_degrees())
        .number("worst_error_m", from_first.translation.max())
        .number("ate_rmse_m", absolute_error(&pairs, TrajectoryAlignment::Rigid)?.translation.rmse());
    Ok(())
}
