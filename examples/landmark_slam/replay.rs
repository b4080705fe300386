//! A log fed to the filter, step by step.

use super::{Result, settings::Settings};
use agv_nav::{
    core::geometry::UncertainPose,
    filters::slam::landmark::{LandmarkSlam, LandmarkUpdate, SightingOutcome},
    nalgebra::{Matrix2, Vector2},
    prelude::*,
};
use agv_support::{landmark_log::LandmarkLog, timing::Timings};

/// The methods by name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Method {
    /// An extended Kalman filter
    Ekf,
    /// The filter, and behind it a graph of all poses and landmarks
    Graph,
}

/// A landmark that was mapped.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Found {
    pub(crate) key: u32,
    pub(crate) place: Vector2<f64>,
    pub(crate) covariance: Matrix2<f64>,
    pub(crate) confirmed: bool,
}

/// What is counted on the way.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Counts {
    pub(crate) sightings: usize,
    pub(crate) left_out: usize,
    pub(crate) matched: usize,
    /// Sum of the normalised squares of the innovations, and their degrees of freedom.
    pub(crate) square: f64,
    pub(crate) degrees: usize,
    pub(crate) log_likelihood: f64,
}

impl Counts {
    pub(crate) fn add(&mut self, sightings: usize, update: &LandmarkUpdate) {
        self.sightings += sightings;
        self.left_out += update.left_out;
        self.matched += update.matched;
        self.square += update.innovation_square;
        self.degrees += update.innovation_degrees;
        self.log_likelihood += update.log_likelihood;
    }
}

/// What a run leaves behind.
pub(crate) struct Run {
    /// Where the vehicle is at each step.
    pub(crate) way: Vec<(Stamp, Se2)>,
    /// The same with its covariance, as it was known at that step.
    pub(crate) known: Vec<UncertainPose<Se2>>,
    pub(crate) landmarks: Vec<Found>,
    /// The landmark that each sighting was taken for, and the name that the log has for it.
    pub(crate) taken: Vec<(u32, Option<u32>)>,
    pub(crate) counts: Counts,
    pub(crate) timings: Timings,
    pub(crate) range_scale: (f64, f64),
}

/// Runs the filter through a log.
pub(crate) fn run(log: &LandmarkLog, settings: &Settings) -> Result<Run> {
    let mut slam = LandmarkSlam::new(settings.params)?;
    let (mut way, mut known, mut taken, mut timings) = (Vec::new(), Vec::new(), Vec::new(), Timings::default());
    let mut counts = Counts::default();
    let mut before = log.steps.first().map(|step| step.stamp).unwrap_or_default();
    for step in &log.steps {
        let seen: Vec<_> = step.seen.iter().map(|seen| settings.sighting(seen)).collect::<Result<_>>()?;
        let motion = settings.motion(before, step);
        before = step.stamp;
        let mut advance = || {
            slam.predict(&motion)?;
            if seen.is_empty() { Ok(None) } else { slam.update(&seen).map(Some) }
        };
        let update = if seen.is_empty() { advance()? } else { timings.time(advance)? };
        if let Some(update) = update {
            counts.add(seen.len(), &update);
            for (seen, outcome) in step.seen.iter().zip(slam.outcomes()) {
                if let SightingOutcome::Matched(key) | SightingOutcome::Added(key) = outcome {
                    taken.push((key.number(), seen.id));
                }
            }
        }
        way.push((step.stamp, slam.map_from_base()));
        known.push(slam.estimate()?);
    }
    let found = slam.landmarks().map(|landmark| Found {
        key: landmark.key.number(),
        place: *landmark.place.mean(),
        covariance: *landmark.place.covariance(),
        confirmed: landmark.confirmed,
    });
    let landmarks = found.collect();
    Ok(Run { way, known, landmarks, taken, counts, timings, range_scale: slam.range_scale() })
}
