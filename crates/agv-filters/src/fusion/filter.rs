//! The filter.

use super::{
    FusionOutcome, FusionParams, Measurement, Reference, RoleInput, SourceId, SourceParams,
    happen::happen,
    history::{Event, Happening, History, NoPlace},
    linearize::{anchored_at, overlaps},
    measurement::Reading,
    source::{MAX_SOURCES, Source},
    state::{ANCHORS, MAX_ANCHORS, State, VELOCITY},
};
use agv_core::{
    Error, check,
    geometry::Se2,
    roles::{LocalizationError, PoseBelief, SkipReason, StatusMonitor, UpdateOutcome, UpdateReport},
    time::Stamp,
};

/// What the filter counts of a source whatever becomes of the past.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Traffic {
    pub(super) dropped: u64,
    pub(super) last: Option<Stamp>,
}

/// Joins odometry, inertial units, poses, places and velocities into one estimate: pose, velocity, gyro bias and, where asked
/// for, acceleration, the wheels' scales and the latency of a source of poses.
///
/// Add the sources, [`initialize`](Self::initialize), and [`fuse`](Self::fuse) every measurement as it comes, in whatever order.
/// Each is taken in at its own time; one that comes late is put to its place in the history, and all that is newer is done
/// again. Nothing allocates after the first belief.
///
/// ```
/// use agv_core::geometry::{Se2, Twist2, UncertainVector};
/// use agv_core::nalgebra::{Matrix3, Vector3};
/// use agv_core::odometry::OdometryIncrement;
/// use agv_core::roles::PoseBelief;
/// use agv_core::sensors::ImuSample;
/// use agv_core::time::Stamp;
/// use agv_filters::fusion::{FusionFilter, FusionParams, SourceParams};
///
/// let mut filter = FusionFilter::new(FusionParams::default())?;
/// let wheels = filter.add_source(SourceParams::wheels())?;
/// let gyro = filter.add_source(SourceParams::imu())?;
/// filter.initialize(&PoseBelief::around(Se2::default(), Matrix3::zeros())?)?;
///
/// let (twist, dt) = (Twist2::new(0.5, 0.0, 0.1), 0.02);
/// let (mut odom, mut now) = (Se2::default(), Stamp::default());
/// for _ in 0..500 {
///     let (next, then) = (odom * twist.integrate(dt), now + dt);
///     filter.fuse(wheels, OdometryIncrement::between(now, &odom, then, &next)?)?;
///     let rates = UncertainVector::from_sigmas(Vector3::new(0.0, 0.0, 0.103), &Vector3::repeat(1e-3))?;
///     filter.fuse(gyro, ImuSample::new(then).with_angular_velocity(rates))?;
///     (odom, now) = (next, then);
/// }
/// let state = filter.state().expect("initialised");
/// assert!((state.twist.vx - 0.5).abs() < 0.01);
/// let (bias, sigma) = state.gyro_bias; // 0.003 rad/s, by the wheels
/// assert!((bias - 0.003).abs() < 3.0 * sigma && sigma < 2e-3);
/// # Ok::<(), agv_core::roles::LocalizationError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "super::checkpoint::RawFilter")
)]
pub struct FusionFilter {
    pub(super) params: FusionParams,
    pub(super) sources: Vec<Source>,
    pub(super) traffic: Vec<Traffic>,
    pub(super) history: Option<History>,
    /// Whether the belief refers to a time; before the first measurement it refers to none.
    pub(super) timed: bool,
    /// Measurements in a row whose stamps could not be.
    pub(super) strange: u32,
    /// Anchor of the motion that is handed out.
    pub(super) outlet: Option<u8>,
    /// Which source takes what comes in through the roles.
    pub(super) inputs: Vec<(RoleInput, SourceId)>,
    pub(super) monitor: StatusMonitor,
}

impl FusionFilter {
    /// Most sources.
    pub const MAX_SOURCES: usize = MAX_SOURCES;

    /// Most sources whose measurements refer to one another ([`Reference::Previous`] and [`Reference::First`]), the motion that is
    /// handed out ([`take_motion`](Self::take_motion)) counted.
    pub const MAX_RELATIVE: usize = MAX_ANCHORS;

    /// A filter without sources and belief.
    ///
    /// # Errors
    /// Parameters that [`validate`](FusionParams::validate) refuses.
    pub fn new(params: FusionParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self {
            params,
            sources: Vec::with_capacity(MAX_SOURCES),
            traffic: Vec::with_capacity(MAX_SOURCES),
            history: None,
            timed: false,
            strange: 0,
            outlet: None,
            inputs: Vec::new(),
            monitor: StatusMonitor::new(params.status)?,
        })
    }

    /// Adds a source.
    ///
    /// # Errors
    /// A parameter out of its range; [`Error::Empty`] for accelerations that the filter does not estimate; [`Error::TooMany`]
    /// beyond [`MAX_SOURCES`](Self::MAX_SOURCES) or [`MAX_RELATIVE`](Self::MAX_RELATIVE), or for a second source that is
    /// [`late`](SourceParams::late).
    pub fn add_source(&mut self, params: SourceParams) -> Result<SourceId, Error> {
        let len = self.sources.len();
        if len >= MAX_SOURCES {
            return Err(Error::TooMany { name: "sources", len: len + 1, max: MAX_SOURCES });
        }
        if params.late && self.sources.iter().any(|source| source.params.late) {
            return Err(Error::TooMany { name: "sources of unknown latency", len: 2, max: 1 });
        }
        let slot = if params.reference == Reference::Map { None } else { Some(self.free_slot()?) };
        self.sources.push(Source::new(params, slot, &self.params)?);
        self.traffic.push(Traffic::default());
        Ok(SourceId(len as u8))
    }

    /// An anchor that nobody has.
    pub(super) fn free_slot(&self) -> Result<u8, Error> {
        let is_taken =
            |slot: &u8| self.sources.iter().any(|source| source.slot == Some(*slot)) || self.outlet == Some(*slot);
        let full = Error::TooMany { name: "relative sources", len: MAX_ANCHORS + 1, max: MAX_ANCHORS };
        (0..MAX_ANCHORS as u8).find(|slot| !is_taken(slot)).ok_or(full)
    }

    /// The parameters it was built with.
    pub const fn params(&self) -> &FusionParams {
        &self.params
    }

    /// Takes a belief, at rest, and forgets history, calibration and what was counted; the first measurement says when it was, and
    /// until then its stamp is zero.
    ///
    /// # Errors
    /// [`Error::Empty`] for [`PoseBelief::Anywhere`], which no Gaussian is; a variance above (1000 km)².
    pub fn initialize(&mut self, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
        self.start(belief, None)
    }

    /// As [`initialize`](Self::initialize), with the time of the belief: measurements from before it are left out, unless there are
    /// so many that the clock must be another ([`FusionParams::clock_patience`]).
    ///
    /// # Errors
    /// As [`initialize`](Self::initialize).
    pub fn initialize_at(&mut self, stamp: Stamp, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
        self.start(belief, Some(stamp))
    }

    fn start(&mut self, belief: &PoseBelief<Se2>, stamp: Option<Stamp>) -> Result<(), LocalizationError> {
        let PoseBelief::Around(pose) = belief else { return Err(Error::Empty { name: "pose of the belief" }.into()) };
        check::in_range("covariance", pose.covariance().amax(), 0.0, 1e12)?;
        let p = &self.params;
        let acceleration = p.motion.acceleration.map_or(0.0, |wander| wander.sigma);
        let mut sigmas = [0.0; ANCHORS];
        sigmas[VELOCITY..].copy_from_slice(&[
            p.motion.vx.sigma,
            p.motion.vy.sigma,
            p.motion.yaw_rate.sigma,
            acceleration,
            acceleration,
            p.gyro_bias_sigma,
            p.distance_scale_sigma,
            p.yaw_scale_sigma,
            p.latency_sigma,
        ]);
        let state = State::new(stamp.unwrap_or_default(), *pose.mean(), pose.covariance(), &sigmas);
        match &mut self.history {
            Some(history) => history.restart(&state),
            None => self.history = Some(History::new(&state, p.capacity)),
        }
        (self.timed, self.strange) = (stamp.is_some(), 0);
        self.traffic.fill(Traffic::default());
        self.monitor.initialized(pose);
        Ok(())
    }

    /// Takes a measurement in, at its own time.
    ///
    /// A motion counts between its two stamps, so that one of a source that reports every so often may come when other
    /// measurements of that time have been taken in already; it must not begin before the last one of its source ended
    /// ([`FusionOutcome::Overlapping`]).
    ///
    /// # Errors
    /// [`LocalizationError::NotInitialized`]; a source that is none, numbers beyond 10⁷, no noise at all, nothing in it that
    /// counts, a motion of a source that has no [`Reference::Previous`] or that does not last. The filter is as it was then.
    pub fn fuse(
        &mut self,
        source: SourceId,
        measurement: impl Into<Measurement>,
    ) -> Result<FusionOutcome, LocalizationError> {
        let measurement = measurement.into();
        let entry = *self.sources.get(source.index()).ok_or(Error::Empty { name: "source of the measurement" })?;
        let history = self.history.as_mut().ok_or(LocalizationError::NotInitialized)?;
        let late = -entry.params.latency;
        let mut reading = measurement.reading(&entry)?;
        let stamp = measurement.stamp() + late;
        let mut begin = stamp;
        if let Reading::Motion { start, .. } = &mut reading {
            *start = *start + late;
            begin = *start;
        }
        if !self.timed {
            restart_at(history, begin);
            self.timed = true;
        }

        let event = Event::new(stamp, source.0, Happening::Measured(reading));
        let refused = match history.place(&event) {
            _ if stamp - history.latest() > self.params.longest_gap => Some(FusionOutcome::TooEarly),
            Err(NoPlace::TooOld) => Some(FusionOutcome::TooOld),
            Err(NoPlace::Duplicate) => Some(FusionOutcome::Duplicate),
            Ok(_) => None,
        };
        let traffic = &mut self.traffic[source.index()];
        match refused {
            Some(FusionOutcome::Duplicate) => {
                traffic.dropped += 1;
                return Ok(FusionOutcome::Duplicate);
            }
            Some(outcome) => {
                // What is newer than all that its source has sent is not of another clock, but a backlog.
                let is_late = outcome == FusionOutcome::TooOld && traffic.last.is_some_and(|last| stamp > last);
                self.strange = self.strange.saturating_add(u32::from(!is_late));
                if is_late || self.strange < self.params.clock_patience {
                    traffic.dropped += 1;
                    return Ok(outcome);
                }
                // So many cannot all be wrong. A clock that was set back says that no time has passed; one that went ahead may
                // have stood still, so that the time counts.
                if outcome == FusionOutcome::TooOld {
                    restart_at(history, begin);
                    // What the others sent last was by the old clock.
                    self.traffic.iter_mut().for_each(|traffic| traffic.last = None);
                }
            }
            None => {}
        }
        self.strange = 0;
        let traffic = &mut self.traffic[source.index()];
        traffic.last = Some(traffic.last.filter(|last| *last > stamp && refused.is_none()).unwrap_or(stamp));
        let outcome = self.insert(&event, begin);
        if outcome == FusionOutcome::Overlapping {
            self.traffic[source.index()].dropped += 1;
        }
        let fixes = entry.params.reference == Reference::Map && matches!(reading, Reading::Place { .. });
        self.judge(outcome, fixes);
        Ok(outcome)
    }

    /// Follows how far the pose can be trusted: places and poses in the map confirm it, or contradict it.
    fn judge(&mut self, outcome: FusionOutcome, fixes: bool) {
        let newest = self.history.as_ref().and_then(History::newest);
        let Some(pose) = newest.and_then(|state| state.pose().ok()) else { return };
        match outcome {
            FusionOutcome::Applied { nis, .. } if fixes => {
                let mut report = UpdateReport::explaining(1.0);
                report.nis = Some(nis);
                self.monitor.updated(&pose, &UpdateOutcome::Applied(report));
            }
            FusionOutcome::Gated { nis, limit } if fixes => {
                self.monitor.updated(&pose, &UpdateOutcome::Skipped(SkipReason::Gated { nis, limit }));
            }
            _ => self.monitor.moved(&pose),
        }
    }

    /// Puts a measurement to its place and does again what follows it.
    pub(super) fn insert(&mut self, event: &Event, begin: Stamp) -> FusionOutcome {
        let Some(history) = self.history.as_mut() else { return FusionOutcome::TooOld };
        let mut place = match history.place(event) {
            Ok(place) => place,
            Err(NoPlace::TooOld) => return FusionOutcome::TooOld,
            Err(NoPlace::Duplicate) => return FusionOutcome::Duplicate,
        };
        let mut from = place;
        let slot = self.sources.get(usize::from(event.source)).and_then(|source| source.slot);
        if let (Happening::Measured(Reading::Motion { start, .. }), Some(slot)) = (&event.happening, slot) {
            // A motion that does not begin where the last one ended needs the pose where it began; one that began before that
            // is left out.
            let slot = usize::from(slot);
            if history.take_anchor(place, event, slot as u8) {
                place -= 1;
                from = place;
            }
            let known = history
                .before(place)
                .is_some_and(|state| anchored_at(state, slot, *start).is_some() || overlaps(state, slot, *start));
            let anchor = Event::new(begin, event.source, Happening::Anchor(slot as u8));
            if let (false, Ok(earlier)) = (known, history.place(&anchor)) {
                history.insert(earlier, anchor);
                from = earlier;
                place += 1;
            }
        }
        history.insert(place, *event);
        let (params, sources) = (&self.params, &self.sources);
        history.replay(from, |state, event| happen(state, event, params, sources));
        let outcome = history.outcome(place).unwrap_or(FusionOutcome::Degenerate);
        history.trim(self.params.history, self.params.capacity);
        outcome
    }
}

/// Begins the history anew at a time with what is known; poses of another time mean nothing there.
fn restart_at(history: &mut History, stamp: Stamp) {
    if let Some(mut state) = history.newest().copied() {
        (0..MAX_ANCHORS).for_each(|slot| state.forget_anchor(slot));
        state.stamp = stamp;
        history.restart(&state);
    }
}
