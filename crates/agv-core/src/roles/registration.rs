//! Where was this cloud taken, given a target cloud or a map, or the clouds before it.

use super::{Alignment, AlignmentError};
use crate::{
    geometry::Se3,
    sensors::{PointCloud, PointSource},
};

/// Aligns clouds with a target that it holds.
///
/// Points that are not finite are skipped; a source without usable points is the outcome
/// [`Alignment::unknown`] at the guess with [`Termination::TooFewPoints`](super::Termination::TooFewPoints).
///
/// ```
/// use agv_core::{geometry::Se3, roles::{Alignment, Registration}, sensors::PointSource};
///
/// /// The best of several guesses: multi-start over any registration.
/// fn best(method: &mut dyn Registration, source: &dyn PointSource, guesses: &[Se3]) -> Option<Alignment<Se3>> {
///     let found = guesses.iter().filter_map(|guess| method.align(source, guess).ok());
///     found.filter(Alignment::converged).max_by(|a, b| a.score.total_cmp(&b.score))
/// }
/// ```
pub trait Registration {
    /// Replaces the target.
    ///
    /// # Errors
    /// [`Error::Empty`](crate::Error::Empty) or [`Error::TooFew`](crate::Error::TooFew) for a target without enough usable
    /// points; the last target is then still there.
    fn set_target(&mut self, target: &dyn PointSource) -> Result<(), AlignmentError>;

    /// Best pose of `source` near `guess` (target from source).
    ///
    /// # Errors
    /// [`AlignmentError::NoTarget`], or a guess that is not finite.
    fn align(&mut self, source: &dyn PointSource, guess: &Se3) -> Result<Alignment<Se3>, AlignmentError>;
}

/// What a lidar odometry made of one cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LidarOdometryStep {
    /// Pose of the vehicle in the frame of its first cloud: that of the alignment, or a prediction if that failed.
    pub odom_from_base: Se3,
    /// How the cloud met those before it, with the frame of the first cloud as the target and the base as the source; none
    /// for the first cloud, whose pose is exact.
    pub alignment: Option<Alignment<Se3>>,
}

/// Follows a moving lidar, cloud after cloud.
pub trait LidarOdometry {
    /// Takes the next cloud; `prior` is the motion since the last one where wheels or an IMU know it (pose of the base
    /// now in the base frame of the last cloud).
    ///
    /// A cloud that cannot be matched moves the pose by the prior, or by constant velocity, and says so in the termination
    /// of its [`alignment`](LidarOdometryStep::alignment).
    ///
    /// # Errors
    /// A prior that is not finite.
    fn process(&mut self, cloud: &PointCloud, prior: Option<&Se3>) -> Result<LidarOdometryStep, AlignmentError>;
}
