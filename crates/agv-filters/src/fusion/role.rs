//! The filter in the roles of core, for a user who holds a `Box<dyn Localizer>`.

use super::{FusionFilter, FusionOutcome, Measurement, SourceId};
use agv_core::{
    Error,
    geometry::Se2,
    odometry::OdometryIncrement,
    roles::{
        Correct, LocalizationError, LocalizationStatus, Localizer, PoseBelief, PoseEstimate, SkipReason, UpdateOutcome,
        UpdateReport,
    },
    sensors::{ImuSample, PoseObservation, PositionObservation, SensorId, VelocityObservation},
};

/// What comes in through the roles [`Localizer`] and [`Correct`], by kind and sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum RoleInput {
    /// The motions of [`Localizer::predict`].
    Odometry,
    /// Poses by this sensor.
    Pose(SensorId),
    /// Places by this sensor.
    Position(SensorId),
    /// Velocities by this sensor.
    Velocity(SensorId),
    /// Samples of this inertial unit.
    Imu(SensorId),
}

impl FusionFilter {
    /// Says which source takes what comes in through the roles, instead of the one that it may have had. A call of
    /// [`fuse`](Self::fuse) names its source itself.
    ///
    /// # Errors
    /// [`Error::Empty`] if there is no such source.
    pub fn connect(&mut self, input: RoleInput, source: SourceId) -> Result<(), Error> {
        if source.index() >= self.sources.len() {
            return Err(Error::Empty { name: "source to connect" });
        }
        self.inputs.retain(|(known, _)| *known != input);
        self.inputs.push((input, source));
        Ok(())
    }

    /// Takes in what has come through a role.
    fn fuse_input(
        &mut self,
        input: RoleInput,
        measurement: impl Into<Measurement>,
    ) -> Result<FusionOutcome, LocalizationError> {
        if self.history.is_none() {
            return Err(LocalizationError::NotInitialized);
        }
        let connected = self.inputs.iter().find(|(known, _)| *known == input);
        let (_, source) = *connected.ok_or(Error::Empty { name: "source that is connected to the sensor" })?;
        self.fuse(source, measurement)
    }

    /// What a role says of it.
    fn outcome_of(
        &mut self,
        input: RoleInput,
        measurement: impl Into<Measurement>,
    ) -> Result<UpdateOutcome, LocalizationError> {
        let measurement = measurement.into();
        let stamp = measurement.stamp();
        Ok(match self.fuse_input(input, measurement)? {
            FusionOutcome::Applied { nis, .. } => {
                let mut report = UpdateReport::explaining(1.0);
                report.nis = Some(nis);
                UpdateOutcome::Applied(report)
            }
            FusionOutcome::Anchored => UpdateOutcome::Applied(UpdateReport::default()),
            FusionOutcome::Gated { nis, limit } => UpdateOutcome::Skipped(SkipReason::Gated { nis, limit }),
            FusionOutcome::TooOld | FusionOutcome::TooEarly => {
                let latency = self.inputs.iter().find(|(known, _)| *known == input).map_or(0.0, |(_, source)| {
                    self.sources.get(source.index()).map_or(0.0, |source| source.params.latency)
                });
                let age = self.history.as_ref().map_or(0.0, |history| history.latest() - (stamp + -latency));
                UpdateOutcome::Skipped(SkipReason::OutsideHistory { age })
            }
            FusionOutcome::Duplicate | FusionOutcome::Overlapping => UpdateOutcome::Skipped(SkipReason::Duplicate),
            FusionOutcome::Degenerate => UpdateOutcome::Skipped(SkipReason::Unexplained),
        })
    }
}

/// What comes in through the roles goes to the sources that are [connected](FusionFilter::connect); what has none is refused.
impl Localizer for FusionFilter {
    type Pose = Se2;

    /// As [`FusionFilter::initialize`].
    fn initialize(&mut self, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
        Self::initialize(self, belief)
    }

    /// Takes the motion in at its own time, as [`FusionFilter::fuse`] does: it may be late, it may be gated, and it must last.
    fn predict(&mut self, odometry: &OdometryIncrement) -> Result<(), LocalizationError> {
        self.fuse_input(RoleInput::Odometry, odometry).map(|_| ())
    }

    /// That of the newest measurement.
    fn estimate(&self) -> Option<PoseEstimate<Se2>> {
        let state = self.state()?;
        Some(PoseEstimate { stamp: self.timed.then_some(state.stamp), ..PoseEstimate::new(state.pose) })
    }

    fn status(&self) -> LocalizationStatus {
        Self::status(self)
    }
}

macro_rules! corrected_by {
    ($($observation:ty => $input:ident),+) => {$(
        /// Taken in at its own time, however late, if its sensor is [connected](FusionFilter::connect).
        impl Correct<$observation> for FusionFilter {
            fn update(&mut self, observation: &$observation) -> Result<UpdateOutcome, LocalizationError> {
                self.outcome_of(RoleInput::$input(observation.sensor()), observation)
            }
        }
    )+};
}
corrected_by!(
    PoseObservation<Se2> => Pose,
    PositionObservation => Position,
    VelocityObservation<Se2> => Velocity,
    ImuSample => Imu
);
