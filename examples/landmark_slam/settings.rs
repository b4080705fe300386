//! What the filter is told, by what the log measures.

use super::{Args, Result};
use agv_nav::{
    core::{geometry::UncertainVector, odometry::OdometryIncrement},
    filters::slam::landmark::{
        Association, LandmarkReading, LandmarkSighting, LandmarkSlamParams, SlamErrors, WayNoise,
    },
    nalgebra::Matrix3,
    prelude::*,
};
use agv_support::landmark_log::{LandmarkLog, LandmarkStep, Seen, SeenAs};

/// How sightings find their landmarks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Finding {
    /// By the names in the log
    Known,
    /// Each the nearest
    Nearest,
    /// The most that fit together
    Joint,
}

/// Parameters of the filter, and deviations of readings that the log does not state.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Settings {
    pub(crate) params: LandmarkSlamParams,
    pub(crate) finding: Finding,
    /// Of ranges in metres, and of bearings in radians.
    pub(crate) sigmas: [f64; 2],
    /// Of ranges alone.
    pub(crate) range_sigma: f64,
    /// By which the deviations of odometry and of sightings are multiplied.
    pub(crate) factors: [f64; 2],
}

/// Settings for a log.
pub(crate) fn of(log: &LandmarkLog, args: &Args) -> Result<Settings> {
    let seen = || log.steps.iter().flat_map(|step| &step.seen);
    let ranges_alone = seen().any(|seen| matches!(seen.measured, SeenAs::Range(_)));
    let named = seen().all(|seen| seen.id.is_some());
    let finding = args.association.unwrap_or(if ranges_alone { Finding::Known } else { Finding::Joint });
    if finding == Finding::Known && !named {
        return Err("the log has sightings whose landmark it does not name".into());
    }
    if finding != Finding::Known && ranges_alone {
        return Err("ranges alone do not tell landmarks apart: --association known".into());
    }
    let mut params = LandmarkSlamParams {
        association: if finding == Finding::Nearest { Association::Nearest } else { Association::Joint },
        errors: if args.additive { SlamErrors::Additive } else { SlamErrors::Invariant },
        // Odometry of simulated logs slips to all sides alike; what measures its heading is a compass or a gyro.
        way_noise: WayNoise { forward: 0.1, sideways: 0.1, yaw_by_way: 0.005, yaw_by_turn: 0.01 },
        ..LandmarkSlamParams::default()
    };
    if ranges_alone {
        // A car's wheels and gyro; and radios whose scale is not calibrated.
        params.way_noise = WayNoise { forward: 0.02, sideways: 0.01, yaw_by_way: 0.002, yaw_by_turn: 0.005 };
        params.range_scale_sigma = 0.1;
    }
    Ok(Settings { params, finding, sigmas: [0.02, 0.004], range_sigma: 0.7, factors: [1.0; 2] })
}

impl Settings {
    /// The motion of a step for the filter.
    pub(crate) fn motion(&self, start: Stamp, step: &LandmarkStep) -> OdometryIncrement {
        let stated = if step.covariance == Matrix3::zeros() {
            self.params.way_noise.covariance(&step.motion)
        } else {
            step.covariance
        };
        let covariance = stated * (self.factors[0] * self.factors[0]);
        OdometryIncrement { start, end: step.stamp, start_from_end: step.motion, covariance }
    }

    /// A sighting for the filter, with its name or without.
    pub(crate) fn sighting(&self, seen: &Seen) -> Result<LandmarkSighting> {
        let factor = self.factors[1];
        let reading = match seen.measured {
            SeenAs::RangeBearing(range, bearing) => {
                LandmarkReading::range_bearing(range, bearing, self.sigmas.map(|sigma| sigma * factor))?
            }
            SeenAs::Place(place, covariance) => {
                LandmarkReading::Place(UncertainVector::new(place, covariance * (factor * factor))?)
            }
            SeenAs::Range(range) => LandmarkReading::range(range, self.range_sigma * factor)?,
        };
        Ok(LandmarkSighting::new(seen.id.filter(|_| self.finding == Finding::Known), reading))
    }
}
