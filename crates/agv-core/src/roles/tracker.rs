//! How do I get there: a motion that keeps the vehicle on a path.

use super::VehicleState;
use crate::{
    Error,
    kinematics::{Motion, MotionLimits},
    path::Path,
};

/// What a tracker decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackCommand {
    /// What to do for the next cycle, in the base frame; it respects the limits.
    pub motion: Motion,
    /// How far the vehicle has come.
    pub status: TrackStatus,
    /// Distance of the vehicle from the nearest point of the path, in metres; positive to the left of the direction of travel,
    /// so to the vehicle's right where it reverses.
    pub cross_track_error: f64,
    /// Heading of the vehicle's leading end (the tail, where it reverses) relative to the direction of travel, or relative to the
    /// heading to turn to in a turn on the spot, in radians within (-π, π]; positive if it points to the left of it.
    pub heading_error: f64,
    /// Length of path from the nearest point to the end, in metres, over all cusps; a turn on the spot has none.
    pub remaining: f64,
}

/// How far a vehicle has come along its path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum TrackStatus {
    /// On the way.
    Tracking,
    /// At the end of the path, with its heading, each within tolerance, and at rest.
    Arrived,
    /// Farther from the path than the tracker can mend, or at its end with a heading that the vehicle cannot mend: the
    /// command brakes.
    OffPath,
}

/// Why a tracker refused a call.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TrackError {
    /// There is no path yet, or it has too few distinct poses.
    #[error("the tracker has no path to follow")]
    NoPath,
    /// A value was refused.
    #[error(transparent)]
    Invalid(#[from] Error),
}

/// Follows a path with the vehicle's pose and motion in the loop.
///
/// A motion that is returned is one that [`MotionLimits::allows_step`] allows, always.
///
/// ```
/// use agv_core::kinematics::MotionLimits;
/// use agv_core::roles::{PathTracker, TrackError, TrackStatus, VehicleState};
///
/// /// Drives an ideal vehicle to the end of its path; the number of cycles it took.
/// fn drive(tracker: &mut dyn PathTracker, mut state: VehicleState, limits: &MotionLimits) -> Result<usize, TrackError> {
///     for cycle in 0..10_000 {
///         let command = tracker.command(&state, limits, 0.05)?;
///         if command.status == TrackStatus::Arrived {
///             return Ok(cycle);
///         }
///         state = state.after(&command.motion, 0.05);
///     }
///     Ok(10_000)
/// }
/// ```
pub trait PathTracker {
    /// Takes a new path and starts at its beginning; repeated points are ignored, turns on the spot are executed.
    ///
    /// # Errors
    /// [`TrackError::NoPath`] if there are not two distinct poses; the old path is then kept.
    fn set_path(&mut self, path: &Path) -> Result<(), TrackError>;

    /// The motion for the next `dt` seconds.
    ///
    /// # Errors
    /// [`TrackError::NoPath`], or a state, limit or `dt` that cannot be one.
    fn command(&mut self, state: &VehicleState, limits: &MotionLimits, dt: f64) -> Result<TrackCommand, TrackError>;
}
