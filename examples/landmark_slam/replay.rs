//! A log fed to the filter, step by step.

use super::{Result, settings::Settings};
use agv_nav::{
    core::{geometry::UncertainPose, odometry::OdometryIncrement},
    filters::slam::landmark::{LandmarkSlam, MappedLandmark, SightingOutcome},
    prelude::*,
};
use agv_support::{landmark_log::LandmarkLog, progress::Progress, timing::Timings};

/// The methods by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Method {
    /// An extended Kalman filter
    Ekf,
}

/// What a run leaves behind.
pub(crate) struct Run {
    /// Where the vehicle is at each step.
    pub(crate) way: Vec<(Stamp, Se2)>,
    /// The same with its covariance, as it was known at that step.
    pub(crate) known: Vec<UncertainPose<Se2>>,
    pub(crate) landmarks: Vec<MappedLandmark>,
    /// The landmark that each sighting was taken for, and the name that the log has for it.
    pub(crate) taken: Vec<(u32, Option<u32>)>,
    pub(crate) sightings: usize,
    pub(crate) left_out: usize,
    pub(crate) timings: Timings,
    /// Mean normalised square of the innovations for each degree of freedom.
    pub(crate) innovation_square: f64,
    pub(crate) log_likelihood: f64,
    pub(crate) range_scale: (f64, f64),
}

/// Runs through a log.
pub(crate) fn run(log: &LandmarkLog, settings: &Settings, _method: Method) -> Result<Run> {
    let mut slam = LandmarkSlam::new(settings.params)?;
    let (mut way, mut known, mut taken, mut timings) = (Vec::new(), Vec::new(), Vec::new(), Timings::default());
    let (mut sightings, mut left_out, mut square, mut degrees, mut log_likelihood) = (0, 0, 0.0, 0, 0.0);
    let progress = Progress::new(log.steps.len(), "mapping");
    let mut before = log.steps.first().map(|step| step.stamp).unwrap_or_default();
    for step in progress.over(&log.steps) {
        let seen: Vec<_> = step.seen.iter().map(|seen| settings.sighting(seen)).collect::<Result<_>>()?;
        let motion = OdometryIncrement {
            start: before,
            end: step.stamp,
            start_from_end: step.motion,
            covariance: step.covariance,
        };
        before = step.stamp;
        let mut advance = || {
            slam.predict(&motion)?;
            if seen.is_empty() { Ok(None) } else { slam.update(&seen).map(Some) }
        };
        let update = if seen.is_empty() { advance()? } else { timings.time(advance)? };
        if let Some(update) = update {
            sightings += seen.len();
            left_out += update.left_out;
            square += update.innovation_square;
            degrees += update.innovation_degrees;
            log_likelihood += update.log_likelihood;
            for (seen, outcome) in step.seen.iter().zip(slam.outcomes()) {
                if let SightingOutcome::Matched(key) | SightingOutcome::Added(key) = outcome {
                    taken.push((key.number(), seen.id));
                }
            }
        }
        way.push((step.stamp, slam.map_from_base()));
        known.push(slam.estimate()?);
    }
    let landmarks = slam.landmarks().collect();
    let (innovation_square, range_scale) = (square / degrees as f64, slam.range_scale());
    Ok(Run {
        way,
        known,
        landmarks,
        taken,
        sightings,
        left_out,
        timings,
        innovation_square,
        log_likelihood,
        range_scale,
    })
}
