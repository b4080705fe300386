//! A log fed to the filter in the order of its stamps, and what the truth says of it.

use agv_nav::{
    core::{geometry::UncertainVector, roles::LocalizationError, sensors::LandmarkObservation},
    filters::landmark::{LandmarkFilter, LandmarkFilterParams, LandmarkMap},
    nalgebra::{Matrix3, Vector2, Vector3},
    prelude::*,
};
use agv_support::mrclam::{MrclamLog, SeenSubject, Velocity};

/// Range deviation at no range, in metres, and bearing deviation, in radians, of a camera that reads barcodes.
const SIGHTING_SIGMAS: [f64; 2] = [0.05, 0.015];

/// Deviations of the pose at the start, in metres and radians.
const START_SIGMAS: [f64; 3] = [0.02, 0.02, 0.02];

/// A velocity is held until the next one, but no longer than this, in seconds.
const LONGEST_HOLD: f64 = 2.0;

/// How far the estimate was off, once.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    /// Seconds since the start.
    pub(crate) time: f64,
    /// Where the vehicle was.
    pub(crate) truth: Se2,
    /// Where the filter took it to be.
    pub(crate) estimate: Se2,
    /// Truth less estimate, in the vehicle's frame.
    pub(crate) error: Vector3<f64>,
    /// Normalised square of the error.
    pub(crate) nees: f64,
    /// Standard deviation of the estimated position.
    pub(crate) position_sigma: f64,
}

/// A log that was run through.
pub(crate) struct Replay {
    /// At each pose of the reference.
    pub(crate) samples: Vec<Sample>,
    /// Sightings of landmarks that the filter took in.
    pub(crate) used: usize,
    /// And those that it left out.
    pub(crate) rejected: usize,
    /// The filter at the end.
    pub(crate) filter: LandmarkFilter,
}

/// What happens, in the order in which it is handled where stamps are equal.
enum Event<'a> {
    Velocity(&'a Velocity),
    Sighting(&'a SeenSubject),
    Reference(&'a Se2),
}

/// Runs a filter of these parameters through a log from the true pose on.
pub(crate) fn replay(log: &MrclamLog, params: &LandmarkFilterParams) -> Result<Replay, Box<dyn std::error::Error>> {
    let map = LandmarkMap::new(log.landmarks.iter().copied())?;
    let mut filter = LandmarkFilter::new(map, *params)?;
    let (Some(first), Some(last)) = (log.odometry.first(), log.odometry.last()) else {
        return Err("the log has no odometry".into());
    };
    let Some(start) = log.reference.iter().find(|reference| reference.stamp >= first.stamp) else {
        return Err("the log has no true pose".into());
    };
    let sigmas = Vector3::from(START_SIGMAS);
    filter.initialize(&PoseBelief::around(start.pose, Matrix3::from_diagonal(&sigmas.component_mul(&sigmas)))?)?;

    let mut now = start.stamp;
    let mut held = Velocity { forward: 0.0, yaw_rate: 0.0, ..*first };
    let (mut samples, mut used, mut rejected) = (Vec::new(), 0, 0);
    for (stamp, event) in events(log) {
        if stamp > last.stamp {
            break;
        }
        if let Event::Velocity(velocity) = event
            && stamp <= now
        {
            held = *velocity;
            continue;
        }
        if stamp < now {
            continue;
        }
        drive(&mut filter, &held, now, stamp)?;
        now = stamp;
        match event {
            Event::Velocity(velocity) => held = *velocity,
            Event::Sighting(seen) => match see(&mut filter, seen)? {
                Some(true) => used += 1,
                Some(false) => rejected += 1,
                None => {}
            },
            Event::Reference(truth) => samples.extend(judge(&filter, stamp - start.stamp, truth)),
        }
    }
    Ok(Replay { samples, used, rejected, filter })
}

/// All that the log holds, by time.
fn events(log: &MrclamLog) -> Vec<(Stamp, Event<'_>)> {
    let velocities = log.odometry.iter().map(|one| (one.stamp, Event::Velocity(one)));
    let sightings = log.sightings.iter().map(|one| (one.stamp, Event::Sighting(one)));
    let reference = log.reference.iter().map(|one| (one.stamp, Event::Reference(&one.pose)));
    let mut events: Vec<_> = velocities.chain(sightings).chain(reference).collect();
    // A stable sort.
    events.sort_by_key(|&(stamp, _)| stamp);
    events
}

/// Drives by a velocity from one time to another.
fn drive(filter: &mut LandmarkFilter, held: &Velocity, from: Stamp, to: Stamp) -> Result<(), LocalizationError> {
    if to <= from {
        return Ok(());
    }
    let moving = (to - from).min(LONGEST_HOLD - (from - held.stamp)).max(0.0);
    filter.predict(&OdometryIncrement {
        start: from,
        end: to,
        start_from_end: Twist2::new(held.forward, 0.0, held.yaw_rate).integrate(moving),
        covariance: Matrix3::zeros(),
    })
}

/// Whether a sighting was taken in; none for one that is not of a landmark.
fn see(filter: &mut LandmarkFilter, seen: &SeenSubject) -> Result<Option<bool>, Box<dyn std::error::Error>> {
    let Some(id) = seen.subject.filter(|&id| filter.map().position(id).is_some()) else { return Ok(None) };
    let reading = UncertainVector::from_sigmas(Vector2::new(seen.range, seen.bearing), &SIGHTING_SIGMAS.into())?;
    let observation = LandmarkObservation::new(seen.stamp, Some(id), reading)?;
    Ok(Some(matches!(filter.update(&observation)?, UpdateOutcome::Applied(_))))
}

fn judge(filter: &LandmarkFilter, time: f64, truth: &Se2) -> Option<Sample> {
    let estimate = filter.estimate()?.pose;
    let error = truth.minus(estimate.mean());
    let nees = error.dot(&estimate.covariance().cholesky()?.solve(&error));
    let position_sigma = estimate.position_deviation();
    Some(Sample { time, truth: *truth, estimate: *estimate.mean(), error, nees, position_sigma })
}
