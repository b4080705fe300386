//! Switched on anywhere, again and again: how often is the right place found within 15 m?

use super::{Args, Result, follow, load::Drive};
use agv_nav::{
    core::{geometry::angle_difference, metrics::Statistics},
    prelude::*,
};
use agv_support::{cli::Report, progress::Progress, timing::Timings};
use rand::RngExt;

/// Travel after which the estimate is judged, in metres.
const TRAVEL: f64 = 15.0;

/// Error up to which the place counts as found: in metres and radians.
const FOUND: (f64, f64) = (0.2, 5.0_f64.to_radians());

/// What became of a start.
struct Outcome {
    is_found: bool,
    /// Whether the status says so.
    is_tracking: bool,
    /// Travel after which the estimate was right for good, in metres.
    travel: f64,
}

/// Starts anywhere at random rows of the drive that have 15 m before them.
pub(crate) fn run(args: &Args, drive: &Drive, starts: u32, report: &mut Report) -> Result<()> {
    if drive.reference.is_empty() {
        return Err("whether a place is found, only a --reference can tell".into());
    }
    let mut travelled = vec![0.0];
    for pair in drive.reference.windows(2) {
        let step = (pair[1].pose.translation() - pair[0].pose.translation()).norm();
        travelled.push(travelled[travelled.len() - 1] + step);
    }
    let rows = travelled.partition_point(|t| t + TRAVEL <= travelled[travelled.len() - 1]);
    if rows == 0 {
        return Err(format!("the drive is shorter than {TRAVEL} m").into());
    }
    let parts = follow::Parts::new(drive, args.common.par())?;
    let (mut stream, mut timings) = (args.common.seed().derive(1).stream(0, 0), Timings::default());
    let mut outcomes = Vec::new();
    let progress = Progress::new(starts as usize, "starting");
    for index in progress.over(0..starts) {
        let row = stream.random_range(0..rows);
        let end = travelled.partition_point(|t| *t < travelled[row] + TRAVEL);
        let filter = parts.filter(args.common.par(), args.common.seed().derive(100 + u64::from(index)))?;
        outcomes.push(start(filter, drive, row..end.min(drive.reference.len()), &travelled, &mut timings)?);
    }
    let share = |count: usize| count as f64 / outcomes.len() as f64;
    let found: Vec<f64> = outcomes.iter().filter(|o| o.is_found).map(|o| o.travel).collect();
    report
        .count("starts", outcomes.len())
        .count("found", found.len())
        .number("found_share", share(found.len()))
        .number("tracking_share", share(outcomes.iter().filter(|o| o.is_tracking).count()))
        .count("wrong_but_tracking", outcomes.iter().filter(|o| o.is_tracking && !o.is_found).count())
        .number("update_ms_p50", timings.milliseconds(50.0))
        .number("update_ms_p99", timings.milliseconds(99.0));
    if !found.is_empty() {
        let travel = Statistics::new(found)?;
        report.number("travel_median_m", travel.median()).number("travel_p95_m", travel.percentile(95.0));
    }
    Ok(())
}

fn start(
    mut filter: follow::Filter,
    drive: &Drive,
    rows: std::ops::Range<usize>,
    travelled: &[f64],
    timings: &mut Timings,
) -> Result<Outcome> {
    filter.initialize(&PoseBelief::Anywhere)?;
    let begin = travelled[rows.start];
    let mut outcome = Outcome { is_found: false, is_tracking: false, travel: 0.0 };
    let mut last = &drive.log.entries[rows.start];
    for row in rows {
        let entry = &drive.log.entries[row];
        let (from, to) = (last.scan.stamp(), entry.scan.stamp());
        filter.predict(&OdometryIncrement::between(from, &last.odom_from_base, to, &entry.odom_from_base)?)?;
        last = entry;
        let mut attempt = Timings::default();
        if matches!(attempt.time(|| filter.update(&entry.scan))?, UpdateOutcome::Applied(_)) {
            timings.append(attempt);
        }
        let estimate = *filter.estimate().ok_or("the filter has no belief")?.map_from_base();
        let reference = drive.reference[row].pose;
        let is_right = (estimate.translation() - reference.translation()).norm() < FOUND.0
            && angle_difference(estimate.yaw(), reference.yaw()).abs() < FOUND.1;
        if is_right && !outcome.is_found {
            outcome.travel = travelled[row] - begin;
        }
        outcome.is_found = is_right;
    }
    outcome.is_tracking = filter.status() == LocalizationStatus::Tracking;
    Ok(outcome)
}
