//! How good a run was.

use super::{Result, follow::Run, load::Drive};
use agv_nav::{
    core::{
        geometry::angle_difference,
        metrics::{Delta, PosePair, Statistics, TrajectoryAlignment, absolute_error, relation_errors, relative_error},
    },
    prelude::*,
};
use agv_support::cli::Report;

/// Stamps of logs and relations are written to the microsecond.
const STAMP_TOLERANCE: f64 = 2e-6;

/// Position errors in metres and heading errors in radians at each update; none without a reference.
pub(crate) fn errors(drive: &Drive, run: &Run) -> Vec<(f64, f64)> {
    let of = |update: &super::follow::Update| {
        let reference = drive.reference.get(update.row)?.pose;
        let position = (update.map_from_base.translation() - reference.translation()).norm();
        Some((position, angle_difference(update.map_from_base.yaw(), reference.yaw()).abs()))
    };
    run.updates.iter().filter_map(of).collect()
}

/// Writes the figures down.
pub(crate) fn report(drive: &Drive, run: &Run, report: &mut Report) -> Result<()> {
    report.count("updates", run.updates.len());
    let errors = errors(drive, run);
    if errors.is_empty() {
        // Programs find the same keys without a reference: nobody knows.
        for key in ["position_rmse_m", "position_max_m", "heading_rmse_deg"] {
            report.number(key, f64::NAN);
        }
    } else {
        let position = Statistics::new(errors.iter().map(|e| e.0).collect())?;
        let heading = Statistics::new(errors.iter().map(|e| e.1.to_degrees()).collect())?;
        report
            .number("position_rmse_m", position.rmse())
            .number("position_mean_m", position.mean())
            .number("position_max_m", position.max())
            .number("heading_rmse_deg", heading.rmse())
            .number("heading_mean_deg", heading.mean())
            .number("heading_max_deg", heading.max());
        trajectory(drive, run, report);
    }
    let particles = Statistics::new(run.updates.iter().map(|update| update.particles as f64).collect())?;
    report
        .number("particles_mean", particles.mean())
        .count("particles_max", particles.max() as usize)
        .number("update_ms_p50", run.timings.milliseconds(50.0))
        .number("update_ms_p99", run.timings.milliseconds(99.0))
        .count("lost", times_lost(run))
        .count("tempered", run.tempered)
        .count("recovering", run.recovering);
    let explained: Vec<f64> = run.updates.iter().filter_map(|update| update.explained).collect();
    if !explained.is_empty() {
        report.number("explained_mean", Statistics::new(explained)?.mean());
    }
    if !drive.relations.is_empty() {
        let stamps = drive.log.entries.iter().map(|entry| entry.scan.stamp());
        let way: Vec<_> = stamps.zip(run.way.iter().copied()).collect();
        let errors = relation_errors(&way, &drive.relations, STAMP_TOLERANCE)?;
        report
            .count("relations", errors.translation.count())
            .number("relations_translation_mean_m", errors.translation.mean())
            .number("relations_rotation_mean_deg", errors.rotation.mean().to_degrees());
    }
    Ok(())
}

/// The usual errors of trajectories: moved onto the reference as a whole, and over each metre of the way.
fn trajectory(drive: &Drive, run: &Run, report: &mut Report) {
    let pairs: Vec<_> = run
        .updates
        .iter()
        .map(|update| {
            let reference = drive.reference[update.row];
            PosePair { stamp: reference.stamp, reference: reference.pose, estimate: update.map_from_base }
        })
        .collect();
    // A drive that is too short for them has none.
    if let Ok(aligned) = absolute_error(&pairs, TrajectoryAlignment::Rigid) {
        report.number("ate_rmse_m", aligned.translation.rmse());
    }
    if let Ok(relative) = relative_error(&pairs, Delta::Metres(1.0)) {
        report
            .number("rpe_1m_rmse_m", relative.translation.rmse())
            .number("rpe_1m_rmse_deg", relative.rotation.rmse().to_degrees());
    }
}

/// How often the status turned to lost.
fn times_lost(run: &Run) -> usize {
    let is_lost = |status| matches!(status, LocalizationStatus::Lost { .. });
    let mut was_lost = false;
    let turns = run
        .updates
        .iter()
        .filter(|update| !std::mem::replace(&mut was_lost, is_lost(update.status)) && is_lost(update.status));
    turns.count()
}
