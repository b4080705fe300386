//! How good a map is: against the truth, and by what it took.

use super::{Result, replay::Run};
use agv_nav::{
    core::metrics::{PosePair, TrajectoryAlignment, absolute_error, associate},
    prelude::*,
};
use agv_support::{cli::Report, landmark_log::LandmarkLog};
use std::collections::BTreeMap;

/// Reference poses with a clock of their own are met within so many seconds.
const REFERENCE_TOLERANCE: f64 = 0.15;

/// Writes the figures down.
pub(crate) fn report(log: &LandmarkLog, run: &Run, report: &mut Report) -> Result<()> {
    report
        .count("updates", run.timings.count())
        .number("update_ms_p50", run.timings.milliseconds(50.0))
        .number("update_ms_p99", run.timings.milliseconds(99.0))
        .number("total_s", run.timings.total_milliseconds() / 1e3)
        .count("landmarks", run.landmarks.iter().filter(|landmark| landmark.confirmed).count())
        .count("landmarks_tentative", run.landmarks.iter().filter(|landmark| !landmark.confirmed).count())
        .count("sightings", run.counts.sightings)
        .count("sightings_left_out", run.counts.left_out)
        .number("innovation_square_mean", run.counts.square / run.counts.degrees as f64)
        .number("log_likelihood", run.counts.log_likelihood);
    if run.range_scale.1 > 0.0 {
        report.numbers("range_scale", &[run.range_scale.0, run.range_scale.1]);
    }
    let names = names(run);
    if log.steps.iter().flat_map(|step| &step.seen).any(|seen| seen.id.is_some()) {
        let wrong = |(key, id): &&(u32, Option<u32>)| names.get(key) != Some(id);
        let distinct: std::collections::BTreeSet<_> = names.values().collect();
        report
            .count("association_errors", run.taken.iter().filter(wrong).count())
            .count("landmarks_twice", names.len() - distinct.len());
    }
    let pairs = associate(&log.reference, &run.way, REFERENCE_TOLERANCE)?;
    if pairs.len() > 2 {
        let aligned = absolute_error(&pairs, TrajectoryAlignment::Rigid)?;
        report.number("ate_rmse_m", aligned.translation.rmse()).number("ate_max_m", aligned.translation.max());
        report.number("nees_mean", nees(log, run)?);
    }
    let places: Vec<_> = run
        .landmarks
        .iter()
        .filter(|landmark| landmark.confirmed)
        .filter_map(|landmark| {
            let name = names.get(&landmark.key).copied().flatten()?;
            let truth = log.landmarks.iter().find(|(id, _)| *id == name)?.1;
            let (mean, truth) = (landmark.place, Se2::new(truth.x, truth.y, 0.0));
            Some(PosePair { stamp: Stamp::default(), reference: truth, estimate: Se2::new(mean.x, mean.y, 0.0) })
        })
        .collect();
    if places.len() > 2 {
        // Places alone, moved onto the true ones.
        let aligned = absolute_error(&places, TrajectoryAlignment::Rigid)?;
        report
            .number("landmark_rmse_m", aligned.translation.rmse())
            .number("landmark_max_m", aligned.translation.max());
    }
    Ok(())
}

/// The name in the log that most sightings of each landmark have.
fn names(run: &Run) -> BTreeMap<u32, Option<u32>> {
    let mut votes: BTreeMap<u32, BTreeMap<Option<u32>, usize>> = BTreeMap::new();
    for &(key, id) in &run.taken {
        *votes.entry(key).or_default().entry(id).or_default() += 1;
    }
    let most =
        |votes: BTreeMap<Option<u32>, usize>| votes.into_iter().max_by_key(|(_, count)| *count).and_then(|(id, _)| id);
    votes.into_iter().map(|(key, votes)| (key, most(votes))).collect()
}

/// Mean normalised square of the pose's error, in the map that begins at the first pose; the first, which is certain, left out.
fn nees(log: &LandmarkLog, run: &Run) -> Result<f64> {
    let numbered: Vec<_> = run.way.iter().map(|(stamp, pose)| (*stamp, *pose)).collect();
    let pairs = associate(&log.reference, &numbered, REFERENCE_TOLERANCE)?;
    let Some(first) = pairs.first() else { return Ok(f64::NAN) };
    let world_from_map = first.reference.compose(&first.estimate.inverse());
    let known: BTreeMap<_, _> = run.way.iter().zip(&run.known).map(|((stamp, _), known)| (*stamp, known)).collect();
    let squares: Vec<f64> = pairs
        .iter()
        .filter_map(|pair| {
            let known = known.get(&pair.stamp)?;
            let error = world_from_map.inverse().compose(&pair.reference).minus(known.mean());
            Some(error.dot(&known.covariance().cholesky()?.solve(&error)))
        })
        .collect();
    Ok(squares.iter().sum::<f64>() / squares.len() as f64)
}
