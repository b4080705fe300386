//! Where am I.

use super::LocalizationStatus;
use crate::{
    Error,
    geometry::{LieGroup, UncertainPose},
    odometry::MotionIncrement,
    time::Stamp,
};

/// What is known of the pose before the first observation.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound(
        serialize = "G: serde::Serialize, G::Matrix: serde::Serialize",
        deserialize = "G: serde::Deserialize<'de>, G::Matrix: serde::Deserialize<'de>"
    ))
)]
#[non_exhaustive]
pub enum PoseBelief<G: LieGroup> {
    /// Near a pose: a Gaussian in the tangent space of `map_from_base`.
    Around(UncertainPose<G>),
    /// Anywhere in the map where the vehicle can stand.
    Anywhere,
}

impl<G: LieGroup> PoseBelief<G> {
    /// A Gaussian around `map_from_base` whose covariance is in the base frame.
    ///
    /// # Errors
    /// What [`UncertainPose::new`] refuses: numbers that are not finite, or a matrix that is not a covariance.
    pub fn around(map_from_base: G, covariance: G::Matrix) -> Result<Self, Error> {
        Ok(Self::Around(UncertainPose::new(map_from_base, covariance)?))
    }
}

/// Where a vehicle is, how surely, and when.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound(
        serialize = "G: serde::Serialize, G::Matrix: serde::Serialize",
        deserialize = "G: serde::Deserialize<'de>, G::Matrix: serde::Deserialize<'de>"
    ))
)]
pub struct PoseEstimate<G: LieGroup> {
    /// Best pose of the vehicle in the map, with the covariance of its right increment.
    pub pose: UncertainPose<G>,
    /// The time that the pose refers to: the end of the last motion, or the time of the first observation if there was no
    /// motion yet. None before the first of them that has a time.
    pub stamp: Option<Stamp>,
}

impl<G: LieGroup> PoseEstimate<G> {
    /// An estimate that refers to no known time.
    pub const fn new(pose: UncertainPose<G>) -> Self {
        Self { pose, stamp: None }
    }

    /// Best pose of the vehicle in the map.
    pub const fn map_from_base(&self) -> &G {
        self.pose.mean()
    }

    /// Covariance of the right increment, that is in the base frame, translation first (m², m rad, rad²).
    pub const fn covariance(&self) -> &G::Matrix {
        self.pose.covariance()
    }
}

/// What became of an observation.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum UpdateOutcome {
    /// The belief has taken it in.
    Applied(UpdateReport),
    /// The belief is as it was.
    Skipped(SkipReason),
}

/// How well an observation fitted the belief, as far as the player knows; `UpdateReport::default()` says nothing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct UpdateReport {
    /// Share of the usable readings that the belief explains, from 0 to 1.
    pub explained: Option<f64>,
    /// Normalised innovation squared.
    pub nis: Option<f64>,
}

impl UpdateReport {
    /// The report of a player that knows which share of the readings its belief explains.
    pub fn explaining(share: f64) -> Self {
        Self { explained: Some(share), ..Self::default() }
    }
}

/// Why an observation was not applied.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum SkipReason {
    /// The vehicle has moved too little since the last update to learn anything new.
    LittleMotion,
    /// The observation holds too few readings that say anything.
    TooFewReadings {
        /// Usable readings.
        usable: usize,
        /// Readings needed.
        needed: usize,
    },
    /// The observation contradicts the belief beyond its gate.
    Gated {
        /// Normalised innovation squared.
        nis: f64,
        /// The gate.
        limit: f64,
    },
    /// The observation is older than the motions that the belief remembers, or newer than they can be carried on.
    OutsideHistory {
        /// Seconds from the observation to the end of the last motion; negative for one that is newer.
        age: f64,
    },
    /// There was an observation of this sensor with this very stamp.
    Duplicate,
    /// No hypothesis of the belief explains the observation at all.
    Unexplained,
}

/// Why a localizer refused a call; the belief is as it was.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LocalizationError {
    /// The belief was never initialised.
    #[error("the localizer has no belief yet: call `initialize` first")]
    NotInitialized,
    /// No pose of the belief lies where the vehicle can stand.
    #[error("no pose around ({x}, {y}) lies in the map")]
    OffMap {
        /// Mean of the belief along x, in metres.
        x: f64,
        /// Mean of the belief along y, in metres.
        y: f64,
    },
    /// A value was refused.
    #[error(transparent)]
    Invalid(#[from] Error),
}

/// Where am I: a belief over poses that odometry moves and observations correct.
///
/// - [`initialize`](Self::initialize) replaces the belief; it may be called again at any time.
/// - [`predict`](Self::predict) composes the belief with a motion and never makes it more certain.
/// - [`estimate`](Self::estimate) and [`status`](Self::status) can be asked at any time.
///
/// Observations come through [`Correct`], one implementation per kind.
///
/// ```
/// use agv_core::geometry::{Se2, UncertainPose};
/// use agv_core::nalgebra::Matrix3;
/// use agv_core::odometry::OdometryIncrement;
/// use agv_core::roles::*;
///
/// /// Dead reckoning from a known start.
/// struct DeadReckoning { known: Option<PoseEstimate<Se2>>, monitor: StatusMonitor }
///
/// impl Localizer for DeadReckoning {
///     type Pose = Se2;
///     fn initialize(&mut self, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
///         if let PoseBelief::Around(pose) = belief {
///             self.known = Some(PoseEstimate::new(*pose));
///             self.monitor.initialized(pose);
///         }
///         Ok(())
///     }
///     fn predict(&mut self, odometry: &OdometryIncrement) -> Result<(), LocalizationError> {
///         let known = self.known.as_mut().ok_or(LocalizationError::NotInitialized)?;
///         let motion = UncertainPose::new(odometry.start_from_end, odometry.covariance)?;
///         *known = PoseEstimate { pose: known.pose.compose(&motion), stamp: Some(odometry.end) };
///         self.monitor.moved(&known.pose);
///         Ok(())
///     }
///     fn estimate(&self) -> Option<PoseEstimate<Se2>> {
///         self.known
///     }
///     fn status(&self) -> LocalizationStatus {
///         self.monitor.status()
///     }
/// }
///
/// let monitor = StatusMonitor::new(StatusParams::default())?;
/// let mut localizer: Box<dyn Localizer<Pose = Se2> + Send> = Box::new(DeadReckoning { known: None, monitor });
/// assert_eq!(localizer.estimate(), None);
/// localizer.initialize(&PoseBelief::around(Se2::new(1.0, 0.0, 0.0), Matrix3::identity() * 0.01)?)?;
/// assert_eq!(localizer.estimate().expect("initialised").map_from_base().x(), 1.0);
/// # Ok::<(), LocalizationError>(())
/// ```
pub trait Localizer {
    /// [`Se2`](crate::geometry::Se2) or [`Se3`](crate::geometry::Se3).
    type Pose: LieGroup;

    /// Replaces the belief.
    ///
    /// # Errors
    /// [`LocalizationError::OffMap`], or a belief that the player cannot hold, as its documentation says.
    fn initialize(&mut self, belief: &PoseBelief<Self::Pose>) -> Result<(), LocalizationError>;

    /// Moves the belief by what the odometry reports; a localizer in space takes planar odometry
    /// lifted by `MotionIncrement::<Se3>::from`.
    ///
    /// # Errors
    /// [`LocalizationError::NotInitialized`], or a motion that is not finite.
    fn predict(&mut self, odometry: &MotionIncrement<Self::Pose>) -> Result<(), LocalizationError>;

    /// Best pose, its covariance and its time; none before the first [`initialize`](Self::initialize).
    fn estimate(&self) -> Option<PoseEstimate<Self::Pose>>;

    /// How far that estimate can be trusted: [`LocalizationStatus::Uninitialized`] before the first
    /// [`initialize`](Self::initialize), and [`LocalizationStatus::Converging`] right after each. A
    /// [`StatusMonitor`](super::StatusMonitor) derives the rest from spread and explained observations.
    fn status(&self) -> LocalizationStatus;
}

/// A localizer that an observation `Z` corrects: a scan, a marker, a cloud.
///
/// Held as `Box<dyn Correct<LaserScan, Pose = Se2> + Send>`; one filter may implement it for several kinds.
pub trait Correct<Z: ?Sized>: Localizer {
    /// Weighs the belief with the observation; says whether it was applied, or why it was skipped.
    ///
    /// The observation refers to its own stamp, the belief to the end of the last motion. A player either compensates for
    /// the motion between the two, or treats the observation as taken at the end of the last motion; its documentation
    /// says which. Callers of the latter predict up to the observation's stamp first.
    ///
    /// Each sensor counts for itself: an observation is not skipped for little motion because that of another
    /// sensor, seen from the same place, was applied.
    ///
    /// # Errors
    /// [`LocalizationError::NotInitialized`], or an observation that cannot be one (a reading without meaning is
    /// skipped, as the observation's type documents).
    fn update(&mut self, observation: &Z) -> Result<UpdateOutcome, LocalizationError>;
}
