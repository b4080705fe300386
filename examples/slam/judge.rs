//! How good a map is: by relations, by reference poses, and by what it took.

use super::{Result, load::Drive, methods::Run};
use agv_nav::core::metrics::{PosePair, TrajectoryAlignment, absolute_error, associate, relation_errors};
use agv_support::cli::Report;

/// Stamps of logs and relations are written to the microsecond.
const STAMP_TOLERANCE: f64 = 2e-6;

/// Reference poses with a clock of their own are met within so many seconds.
const REFERENCE_TOLERANCE: f64 = 0.02;

/// Writes the figures down.
pub(crate) fn report(drive: &Drive, run: &Run, report: &mut Report) -> Result<()> {
    report
        .count("scans", drive.entries.len())
        .number("scan_ms_p50", run.timings.milliseconds(50.0))
        .number("scan_ms_p99", run.timings.milliseconds(99.0))
        .number("total_s", run.timings.total_milliseconds() / 1e3)
        .number("memory_mb", (run.kept + run.working) as f64 / 1e6)
        .number("kept_mb", run.kept as f64 / 1e6);
    report.append(&run.figures);
    if !drive.relations.is_empty() {
        let way: Vec<_> = run.way.iter().map(|at| (at.stamp, at.pose)).collect();
        let errors = relation_errors(&way, &drive.relations, STAMP_TOLERANCE)?;
        report
            .count("relations", errors.translation.count())
            .number("relations_translation_mean_m", errors.translation.mean())
            .number("relations_translation_max_m", errors.translation.max())
            .number("relations_rotation_mean_deg", errors.rotation.mean().to_degrees());
    }
    let pairs = pairs(drive, run)?;
    if pairs.len() > 2 {
        let aligned = absolute_error(&pairs, TrajectoryAlignment::Rigid)?;
        report.number("ate_rmse_m", aligned.translation.rmse());
    }
    Ok(())
}

/// Estimates beside their references: row by row where there are as many, else by their stamps.
fn pairs(drive: &Drive, run: &Run) -> Result<Vec<PosePair<agv_nav::prelude::Se2>>> {
    if drive.reference.len() == run.way.len() {
        let pair = |(reference, at): (&agv_support::log::StampedPose, &agv_support::log::StampedPose)| PosePair {
            stamp: at.stamp,
            reference: reference.pose,
            estimate: at.pose,
        };
        return Ok(drive.reference.iter().zip(&run.way).map(pair).collect());
    }
    if drive.reference.is_empty() {
        return Ok(Vec::new());
    }
    let stamped =
        |poses: &[agv_support::log::StampedPose]| poses.iter().map(|at| (at.stamp, at.pose)).collect::<Vec<_>>();
    Ok(associate(&stamped(&drive.reference), &stamped(&run.way), REFERENCE_TOLERANCE)?)
}
