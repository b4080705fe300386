//! Where am I, from odometry and landmarks that are both to be calibrated on the way.

use super::{
    CalibratedOdometry, CalibratedPose, DEGREES, EstimateClock, LandmarkFilterParams, LandmarkMap, Parameter, Sighting,
    history::{History, WINDOW},
    track::{Cursor, Track},
};
use crate::kalman::{Correction, Gate};
use agv_core::{
    Error, check,
    geometry::{Se2, UncertainPose},
    roles::{SkipReason, StatusMonitor, UpdateOutcome},
    sensors::LandmarkObservation,
    time::Stamp,
};
use nalgebra::SMatrix;

mod role;

/// What a filter has learnt of a parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Learnt {
    /// Best estimate, in the parameter's unit.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// An extended Kalman filter for the pose and the calibration of odometry and landmark sensor; it plays the roles
/// [`Localizer`](agv_core::roles::Localizer) and [`Correct<LandmarkObservation>`](agv_core::roles::Correct).
///
/// Call `predict` with every increment of the odometry and `update` with every sighting, in the order of their arrival. A
/// sighting may be late: it is taken in where it belongs, by its stamp and the latency learnt so far, and what was driven since
/// is driven again. Sightings come in the order of their stamps, give or take a quarter of a second; one that is older than the
/// last by more is skipped. They are those of one sensor: a second one would need biases and a latency of its own (with priors
/// of zero deviation, [`CalibrationPriors::KNOWN`](super::CalibrationPriors::KNOWN), several sensors may be mixed).
///
/// A sighting that does not know its landmark is given to the only one that explains it, at a cost of O(landmarks); it never
/// raises doubt of the belief. Nothing allocates after construction. A `predict` costs one or two steps of a filter of 15 states, an
/// `update` one for every reading since.
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2, Twist2, UncertainVector};
/// use agv_core::nalgebra::{Matrix3, Vector2};
/// use agv_core::odometry::OdometryIncrement;
/// use agv_core::roles::{Correct, Localizer, PoseBelief};
/// use agv_core::sensors::LandmarkObservation;
/// use agv_core::time::Stamp;
/// use agv_filters::landmark::{LandmarkFilter, LandmarkFilterParams, LandmarkMap, Parameter};
///
/// let places = [(1, Vector2::new(4.0, 3.0)), (2, Vector2::new(-4.0, 2.0)), (3, Vector2::new(0.0, -5.0))];
/// let mut filter = LandmarkFilter::new(LandmarkMap::new(places)?, LandmarkFilterParams::default())?;
/// filter.initialize(&PoseBelief::around(Se2::default(), Matrix3::identity() * 1e-4)?)?;
///
/// // A circle by odometry that reads ways 5 % too short.
/// let (mut odom, mut truth, mut now) = (Se2::default(), Se2::default(), Stamp::default());
/// for step in 0..1000 {
///     let (next, then) = (odom * Twist2::new(0.5, 0.0, 0.25).integrate(0.05), now + 0.05);
///     filter.predict(&OdometryIncrement::between(now, &odom, then, &next)?)?;
///     (odom, now, truth) = (next, then, truth * Twist2::new(0.525, 0.0, 0.25).integrate(0.05));
///     let (id, place) = places[step % 3];
///     let seen = truth.inverse().act(&place);
///     let reading = Vector2::new(seen.norm(), seen.y.atan2(seen.x));
///     let reading = UncertainVector::from_sigmas(reading, &Vector2::new(0.05, 0.01))?;
///     filter.update(&LandmarkObservation::new(now, Some(id), reading)?)?;
/// }
/// assert!(filter.estimate().expect("initialised").map_from_base().minus(&truth).norm() < 0.05);
/// let scale = filter.learnt(Parameter::SpeedScale).expect("initialised");
/// assert!((scale.value - 0.05).abs() < 3.0 * scale.sigma && scale.sigma < 0.05);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawFilter"))]
pub struct LandmarkFilter {
    map: LandmarkMap,
    params: LandmarkFilterParams,
    track: Option<Track>,
    history: History,
    monitor: StatusMonitor,
    #[cfg_attr(feature = "serde", serde(skip))]
    model: CalibratedOdometry,
    #[cfg_attr(feature = "serde", serde(skip))]
    gate: Gate,
}

/// A [`LandmarkFilter`] as it is stored, before it is checked.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawFilter {
    map: LandmarkMap,
    params: LandmarkFilterParams,
    track: Option<Track>,
    history: History,
    monitor: StatusMonitor,
}

#[cfg(feature = "serde")]
impl TryFrom<RawFilter> for LandmarkFilter {
    type Error = Error;

    fn try_from(raw: RawFilter) -> Result<Self, Error> {
        let fresh = Self::new(raw.map, raw.params)?;
        Ok(Self { track: raw.track, history: raw.history, monitor: raw.monitor, ..fresh })
    }
}

/// Longest motion and largest deviation, in metres: beyond, the numbers have no meaning.
const LARGEST: f64 = 1e6;

/// Longest time that is bridged by holding the velocity, in seconds; so much older than the last may a sighting be.
const REACH: f64 = 0.25;

/// Most doublings of a doubted belief's variance: from a centimetre to some metres.
const MOST_DOUBTS: usize = 20;

impl LandmarkFilter {
    /// A filter without a belief, for landmarks on a map.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(map: LandmarkMap, params: LandmarkFilterParams) -> Result<Self, Error> {
        check::non_negative("range_share", params.range_share)?;
        check::in_range("history", params.history, 0.0, 60.0)?;
        check::at_least("patience", params.patience, 1)?;
        params.priors.validate()?;
        check::in_range("latency", params.priors.latency.mean, -params.history, params.history)?;
        Ok(Self {
            map,
            params,
            track: None,
            history: History::new(),
            monitor: StatusMonitor::new(params.status)?,
            model: CalibratedOdometry::new(params.noise)?,
            gate: Gate::at_probability(params.gate_probability)?,
        })
    }

    /// The parameters it was built with.
    pub const fn params(&self) -> &LandmarkFilterParams {
        &self.params
    }

    /// The landmarks.
    pub const fn map(&self) -> &LandmarkMap {
        &self.map
    }

    /// What has been learnt of a parameter; none before there is a belief.
    pub fn learnt(&self, parameter: Parameter) -> Option<Learnt> {
        self.track.map(|track| Learnt {
            value: track.tip.ekf.state().get(parameter),
            sigma: track.tip.ekf.belief().sigma(parameter.row()),
        })
    }

    /// The state with its covariance at the odometry's last time, for checks against a truth; none before there is a belief.
    pub fn state(&self) -> Option<(&CalibratedPose, &SMatrix<f64, DEGREES, DEGREES>)> {
        self.track.as_ref().map(|track| (track.tip.ekf.state(), track.tip.ekf.covariance()))
    }

    fn pose(&self, track: &Track) -> Result<UncertainPose<Se2>, Error> {
        match (self.params.clock, track.stamp) {
            (EstimateClock::Landmarks, Some(stamp)) => track.tip.pose_on_sensor_clock(&self.history, stamp),
            _ => track.tip.pose(),
        }
    }

    /// The odometry's time at which the vehicle is where it is to be told.
    fn advance_tip(&self, track: &mut Track) -> Result<(), Error> {
        let Some(end) = self.history.end() else { return Ok(()) };
        let late = match self.params.clock {
            EstimateClock::Odometry => 0.0,
            EstimateClock::Landmarks => track.tip.latency(),
        };
        track.tip.advance(&self.model, &self.history, end + -late)
    }

    /// Adds a checked motion to the track; the history is as it was if that fails.
    fn moved(&mut self, mut track: Track, start: Stamp, end: Stamp, piece: super::MotionPiece) -> Result<Track, Error> {
        self.history.push(start, end, piece);
        let known = self.history.end().unwrap_or(end);
        track.stamp = Some(known);
        let mut follow = || {
            for cursor in [&mut track.anchor, &mut track.tip] {
                cursor.time = cursor.time.or(Some(start));
            }
            track.anchor.advance(&self.model, &self.history, known + -self.params.history)?;
            if let Some(overdue) = self.history.overdue() {
                track.anchor.advance(&self.model, &self.history, overdue)?;
                track.tip.advance(&self.model, &self.history, overdue)?;
            }
            self.advance_tip(&mut track)?;
            self.pose(&track)
        };
        match follow() {
            Ok(pose) => {
                self.monitor.moved(&pose);
                if let Some(kept) = track.anchor.time.min(track.tip.time) {
                    // A velocity is a mean over a while.
                    self.history.forget(kept + -WINDOW);
                }
                if let Some(overdue) = self.history.overdue() {
                    self.history.forget(overdue);
                }
                Ok(track)
            }
            Err(error) => {
                self.history.pop();
                Err(error)
            }
        }
    }

    /// A sighting of the landmark at `index` by a belief at the right time, if the time is known.
    fn sighting(&self, anchor: &Cursor, observation: &LandmarkObservation) -> Sighting {
        let (twist, delay) = match anchor.time {
            Some(time) => (anchor.twist(&self.history, time), observation.stamp() - time),
            None => (nalgebra::Vector3::zeros(), anchor.latency()),
        };
        Sighting {
            landmark: nalgebra::Vector2::zeros(),
            base_from_sensor: observation.base_from_sensor(),
            range_kind: self.params.range_kind,
            covariance: *observation.range_bearing().covariance(),
            range_share: self.params.range_share,
            twist,
            delay,
        }
    }

    /// The only landmark that explains a sighting of an unknown one.
    fn associate(&self, anchor: &Cursor, sighting: &Sighting, observation: &LandmarkObservation) -> Option<Sighting> {
        let mut found = None;
        for &(_, landmark) in self.map.landmarks() {
            let candidate = Sighting { landmark, ..*sighting };
            let fits = anchor
                .ekf
                .innovation(&candidate, observation.range_bearing().mean())
                .is_ok_and(|innovation| innovation.nis <= self.gate.limit(innovation.degrees));
            if fits && found.replace(candidate).is_some() {
                return None;
            }
        }
        found
    }

    /// The anchor with a sighting taken in, doubted if that is due.
    fn corrected(
        &self,
        track: &Track,
        mut anchor: Cursor,
        sighting: &Sighting,
        observation: &LandmarkObservation,
    ) -> Result<(Cursor, Correction<2>), Error> {
        let measured = observation.range_bearing().mean();
        let mut correction = anchor.ekf.update(sighting, measured, &self.gate)?;
        if !correction.accepted && track.contradictions + 1 >= self.params.patience {
            for _ in 0..MOST_DOUBTS {
                anchor = anchor.doubted(2.0)?;
                correction = anchor.ekf.update(sighting, measured, &self.gate)?;
                if correction.accepted {
                    break;
                }
            }
        }
        if anchor.latency().abs() > self.params.history {
            anchor = anchor.bounded(self.params.history)?;
        }
        Ok((anchor, correction))
    }

    /// What becomes of a sighting; the belief changes only if it is applied.
    fn take_in(&mut self, observation: &LandmarkObservation, track: &mut Track) -> Result<UpdateOutcome, Error> {
        let mut anchor = track.anchor;
        if let (Some(time), Some(end)) = (anchor.time, self.history.end()) {
            let target = observation.stamp() + -anchor.latency();
            if target - time < -REACH || target - end > REACH {
                return Ok(UpdateOutcome::Skipped(SkipReason::OutsideHistory { age: end - target }));
            }
            anchor.advance(&self.model, &self.history, target)?;
        }
        let blank = self.sighting(&anchor, observation);
        let sighting = match observation.id() {
            Some(id) => self.map.position(id).map(|landmark| Sighting { landmark, ..blank }),
            None => self.associate(&anchor, &blank, observation),
        };
        let Some(sighting) = sighting else { return Ok(UpdateOutcome::Skipped(SkipReason::Unexplained)) };
        let (anchor, correction) = self.corrected(track, anchor, &sighting, observation)?;
        if correction.accepted {
            *track = Track { anchor, tip: anchor, stamp: track.stamp.or(Some(observation.stamp())), contradictions: 0 };
            self.advance_tip(track)?;
        } else {
            track.contradictions = track.contradictions.saturating_add(1);
        }
        Ok(correction.into())
    }
}

#[cfg(test)]
mod tests;
