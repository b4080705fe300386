//! How do I get there: a twist that keeps the vehicle on a path.

use super::VehicleState;
use crate::{Error, geometry::Twist2, kinematics::TwistLimits, path::Path};

/// What a tracker decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackCommand {
    /// Twist for the next cycle; it respects the limits.
    pub twist: Twist2,
    /// How far the vehicle has come.
    pub status: TrackStatus,
    /// Distance of the vehicle to the left of the path, in metres.
    pub cross_track_error: f64,
    /// Heading of the vehicle relative to the path's, in radians.
    pub heading_error: f64,
    /// Length of path that remains, in metres.
    pub remaining: f64,
}

/// How far a vehicle has come along its path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum TrackStatus {
    /// On the way.
    Tracking,
    /// At the end of the path, within tolerance, and at rest.
    Arrived,
    /// Farther from the path than the tracker can mend: the twist brakes.
    OffPath,
}

/// Why a tracker refused a call.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TrackError {
    /// There is no path yet, or it has too few distinct points.
    #[error("the tracker has no path to follow")]
    NoPath,
    /// A value was refused.
    #[error(transparent)]
    Invalid(#[from] Error),
}

/// Follows a path with the vehicle's pose and twist in the loop.
///
/// ```
/// use agv_core::geometry::Twist2;
/// use agv_core::kinematics::TwistLimits;
/// use agv_core::roles::{PathTracker, TrackError, TrackStatus, VehicleState};
///
/// /// Drives an ideal vehicle to the end of its path; the number of cycles it took.
/// fn drive(tracker: &mut dyn PathTracker, mut state: VehicleState, limits: &TwistLimits) -> Result<usize, TrackError> {
///     for cycle in 0..10_000 {
///         let command = tracker.command(&state, limits, 0.05)?;
///         if command.status == TrackStatus::Arrived {
///             return Ok(cycle);
///         }
///         state.twist = command.twist;
///         state.map_from_base = state.map_from_base * command.twist.integrate(0.05);
///     }
///     Ok(10_000)
/// }
/// ```
pub trait PathTracker {
    /// Takes a new path and starts at its beginning; repeated points are ignored.
    ///
    /// # Errors
    /// [`TrackError::NoPath`] if there are not two distinct points; the old path is then kept.
    fn set_path(&mut self, path: &Path) -> Result<(), TrackError>;

    /// The twist for the next `dt` seconds.
    ///
    /// # Errors
    /// [`TrackError::NoPath`], or a state, limit or `dt` that cannot be one.
    fn command(&mut self, state: &VehicleState, limits: &TwistLimits, dt: f64) -> Result<TrackCommand, TrackError>;
}
