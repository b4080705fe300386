//! Where am I.

use crate::{Error, geometry::LieGroup, odometry::MotionIncrement, time::Stamp};

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
    Around {
        /// Its mean.
        map_from_base: G,
        /// Its covariance, in the base frame.
        covariance: G::Matrix,
    },
    /// Anywhere in the map where the vehicle can stand.
    Anywhere,
}

impl<G: LieGroup> PoseBelief<G> {
    /// A Gaussian around `map_from_base` whose covariance is in the base frame.
    pub const fn around(map_from_base: G, covariance: G::Matrix) -> Self {
        Self::Around { map_from_base, covariance }
    }
}

/// A pose with its uncertainty.
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
    /// Best pose of the vehicle in the map.
    pub map_from_base: G,
    /// Covariance of the right increment, that is in the base frame, translation first (m², m rad, rad²).
    pub covariance: G::Matrix,
    /// The time that the pose refers to: the end of the last motion, or the time of the first observation if there was no
    /// motion yet. None before the first of them that has a time.
    pub stamp: Option<Stamp>,
}

impl<G: LieGroup> PoseEstimate<G> {
    /// An estimate that refers to no known time.
    pub const fn new(map_from_base: G, covariance: G::Matrix) -> Self {
        Self { map_from_base, covariance, stamp: None }
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
/// - [`estimate`](Self::estimate) can be asked at any time. Before the first `initialize` it is the identity with
///   infinite variances: nothing is known.
///
/// Observations come through [`Correct`], one implementation per kind.
///
/// ```
/// use agv_core::geometry::{LieGroup, Se2};
/// use agv_core::nalgebra::Matrix3;
/// use agv_core::odometry::OdometryIncrement;
/// use agv_core::roles::{LocalizationError, Localizer, PoseBelief, PoseEstimate};
///
/// /// Dead reckoning with a known start.
/// struct DeadReckoning(PoseEstimate<Se2>);
///
/// impl Localizer for DeadReckoning {
///     type Pose = Se2;
///     fn initialize(&mut self, belief: &PoseBelief<Se2>) -> Result<(), LocalizationError> {
///         if let PoseBelief::Around { map_from_base, covariance } = *belief {
///             self.0 = PoseEstimate::new(map_from_base, covariance);
///         }
///         Ok(())
///     }
///     fn predict(&mut self, odometry: &OdometryIncrement) -> Result<(), LocalizationError> {
///         let back = odometry.start_from_end.inverse().adjoint();
///         self.0.map_from_base = self.0.map_from_base * odometry.start_from_end;
///         self.0.stamp = Some(odometry.end);
///         self.0.covariance = back * self.0.covariance * back.transpose() + odometry.covariance;
///         Ok(())
///     }
///     fn estimate(&self) -> PoseEstimate<Se2> {
///         self.0
///     }
/// }
///
/// let mut localizer: Box<dyn Localizer<Pose = Se2> + Send> =
///     Box::new(DeadReckoning(PoseEstimate::new(Se2::identity(), Matrix3::zeros())));
/// localizer.initialize(&PoseBelief::around(Se2::new(1.0, 0.0, 0.0), Matrix3::identity() * 0.01))?;
/// assert_eq!(localizer.estimate().map_from_base.x(), 1.0);
/// # Ok::<(), LocalizationError>(())
/// ```
pub trait Localizer {
    /// [`Se2`](crate::geometry::Se2) or [`Se3`](crate::geometry::Se3).
    type Pose: LieGroup;

    /// Replaces the belief.
    ///
    /// # Errors
    /// A mean or covariance that is not finite, a covariance that is not positive semi-definite, or a belief off the map.
    fn initialize(&mut self, belief: &PoseBelief<Self::Pose>) -> Result<(), LocalizationError>;

    /// Moves the belief by what the odometry reports; a localizer in space takes planar odometry
    /// lifted by `MotionIncrement::<Se3>::from`.
    ///
    /// # Errors
    /// [`LocalizationError::NotInitialized`], or a motion that is not finite.
    fn predict(&mut self, odometry: &MotionIncrement<Self::Pose>) -> Result<(), LocalizationError>;

    /// Best pose and its covariance.
    fn estimate(&self) -> PoseEstimate<Self::Pose>;
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
    /// # Errors
    /// [`LocalizationError::NotInitialized`], or an observation that cannot be one (a reading without meaning is
    /// skipped, as the observation's type documents).
    fn update(&mut self, observation: &Z) -> Result<UpdateOutcome, LocalizationError>;
}
