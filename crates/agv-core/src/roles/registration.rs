//! Where was this cloud taken, given a target cloud or a map, or the clouds before it.

use crate::{
    Error,
    geometry::Se3,
    sensors::{PointCloud, PointSource},
};
use nalgebra::Matrix6;

/// Why an iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Termination {
    /// The last step was below the tolerance.
    Converged,
    /// The iteration limit was reached.
    IterationLimit,
    /// No step improved the score any more, though the gradient has not vanished.
    Stalled,
    /// Too few points met the target to say anything.
    TooFewPoints,
    /// The points leave directions free, and nothing was there to hold them.
    Degenerate,
}

/// How a source fits a target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alignment {
    /// Pose of the source in the target frame.
    pub target_from_source: Se3,
    /// Information (inverse covariance) of the right increment, translation first.
    pub information: Matrix6<f64>,
    /// The method's own score of the result; larger is better.
    pub score: f64,
    /// Iterations that were run.
    pub iterations: usize,
    /// Why it ended; anything but [`Termination::Converged`] is a result not to rely on.
    pub termination: Termination,
}

/// Why a registration refused a call.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RegistrationError {
    /// There is no target yet.
    #[error("the registration has no target yet")]
    NoTarget,
    /// A value was refused.
    #[error(transparent)]
    Invalid(#[from] Error),
}

/// Aligns clouds with a target that it holds.
///
/// Points that are not finite are skipped; an empty source is the outcome [`Termination::TooFewPoints`] at the guess.
///
/// ```
/// use agv_core::{geometry::Se3, roles::{Registration, Termination}, sensors::PointSource};
///
/// /// Takes the first guess that converges: multi-start over any registration.
/// fn first_converged(method: &mut dyn Registration, source: &dyn PointSource, guesses: &[Se3]) -> Option<Se3> {
///     guesses.iter().find_map(|guess| {
///         let alignment = method.align(source, guess).ok()?;
///         (alignment.termination == Termination::Converged).then_some(alignment.target_from_source)
///     })
/// }
/// ```
pub trait Registration {
    /// Best pose of `source` near `guess` (target from source).
    ///
    /// # Errors
    /// [`RegistrationError::NoTarget`], or a guess that is not finite.
    fn align(&mut self, source: &dyn PointSource, guess: &Se3) -> Result<Alignment, RegistrationError>;
}

/// What a lidar odometry made of one cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LidarOdometryStep {
    /// Pose of the vehicle in the frame of its first cloud.
    pub odom_from_base: Se3,
    /// Information of the right increment, translation first.
    pub information: Matrix6<f64>,
    /// Why the matching ended.
    pub termination: Termination,
}

/// Follows a moving lidar, cloud after cloud.
pub trait LidarOdometry {
    /// Takes the next cloud; `prior` is the motion since the last one where wheels or an IMU know it (pose of the base
    /// now in the base frame of the last cloud).
    ///
    /// A cloud that cannot be matched moves the pose by the prior, or by constant velocity, and says so in
    /// [`LidarOdometryStep::termination`].
    ///
    /// # Errors
    /// A prior that is not finite.
    fn process(&mut self, cloud: &PointCloud, prior: Option<&Se3>) -> Result<LidarOdometryStep, RegistrationError>;
}
