//! What do I do now: a motion that follows a path among obstacles.

use crate::{
    Error, check,
    geometry::{LieGroup, Se2, Twist2},
    grid::LocalMap,
    kinematics::{Motion, MotionLimits},
    obstacle::MovingObstacle,
    path::Path,
};

/// Where a vehicle is and how it moves.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct VehicleState {
    /// Pose of the base in the map.
    pub map_from_base: Se2,
    /// Velocity in the base frame.
    pub twist: Twist2,
    /// Angle of the steered wheels, in radians, as [`Motion::steering`] has it; none for a vehicle that does not steer or does
    /// not measure it.
    pub steering: Option<f64>,
}

impl VehicleState {
    /// A vehicle that is not known to steer.
    pub const fn new(map_from_base: Se2, twist: Twist2) -> Self {
        Self { map_from_base, twist, steering: None }
    }

    /// Whether pose, twist and angle are finite.
    pub fn is_finite(&self) -> bool {
        self.map_from_base.is_finite() && self.motion().is_finite()
    }

    /// What the vehicle does.
    pub const fn motion(&self) -> Motion {
        Motion { twist: self.twist, steering: self.steering }
    }

    /// The state of an ideal vehicle that did what it was told for `dt` seconds.
    #[must_use]
    pub fn after(&self, motion: &Motion, dt: f64) -> Self {
        let map_from_base = self.map_from_base.compose(&motion.twist.integrate(dt));
        Self { map_from_base, twist: motion.twist, steering: motion.steering }
    }

    /// Accepts a state that is finite.
    ///
    /// # Errors
    /// [`Error::NotFinite`](crate::Error::NotFinite) names the part that is not.
    pub fn validate(&self) -> Result<(), Error> {
        if self.is_finite() {
            return Ok(());
        }
        let (pose, twist) = (self.map_from_base, self.twist);
        let heading = pose.rotation();
        check::all_finite("map_from_base", &[pose.x(), pose.y(), heading.cos(), heading.sin()])?;
        check::all_finite("twist", &[twist.vx, twist.vy, twist.yaw_rate])?;
        check::all_finite("steering", self.steering.iter())
    }
}

/// All that a local planner may know in one cycle.
#[derive(Debug, Clone, Copy)]
pub struct LocalPlanRequest<'a> {
    /// The vehicle now.
    pub state: VehicleState,
    /// The path to follow, in the map frame.
    pub path: &'a Path,
    /// What is known of the surroundings: costs, inflated or not as the planner documents, and the distance to obstacles.
    pub map: &'a LocalMap,
    /// Obstacles that move, in the map frame, at the time of `state`.
    pub obstacles: &'a [MovingObstacle],
    /// What the vehicle can do.
    pub limits: &'a MotionLimits,
    /// Time until the next cycle, in seconds.
    pub dt: f64,
}

/// What a local planner decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalCommand {
    /// What to do for the next cycle. It respects the limits and can be executed whatever the status says.
    pub motion: Motion,
    /// Why this motion.
    pub status: LocalPlanStatus,
}

/// What a local command is for.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum LocalPlanStatus {
    /// It follows the path.
    Following,
    /// The goal is reached and the vehicle comes to rest.
    Arrived,
    /// No motion along the path is safe: the command brakes.
    Blocked(BlockReason),
    /// The vehicle touches an obstacle already: the command brakes.
    InCollision,
}

/// Why no motion along the path is safe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum BlockReason {
    /// A lethal cell of the costmap is in the way: another path may help.
    Obstacle,
    /// An obstacle that moves is in the way: waiting may help.
    MovingObstacle,
    /// The limits leave no motion that follows the path.
    Limits,
    /// The vehicle is farther from the path than the planner can mend.
    OffPath,
}

/// Why a local planner refused a request.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LocalPlanError {
    /// The path has no points.
    #[error("the path has no points")]
    EmptyPath,
    /// A value was refused.
    #[error(transparent)]
    Invalid(#[from] Error),
}

/// Chooses the motion of the next cycle.
///
/// A motion that is returned is one that [`MotionLimits::allows_step`] allows, always.
///
/// ```
/// use agv_core::roles::{BlockReason, LocalCommand, LocalPlanError, LocalPlanRequest, LocalPlanStatus, LocalPlanner};
///
/// /// An emergency stop: brakes as hard as the limits allow.
/// struct Stop;
///
/// impl LocalPlanner for Stop {
///     fn command(&mut self, request: LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError> {
///         let motion = request.limits.brake(&request.state.motion(), request.dt)?;
///         Ok(LocalCommand { motion, status: LocalPlanStatus::Blocked(BlockReason::Obstacle) })
///     }
/// }
/// ```
pub trait LocalPlanner {
    /// The motion for the next `request.dt` seconds.
    ///
    /// # Errors
    /// An empty path, or a state, limit or `dt` that cannot be one.
    fn command(&mut self, request: LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError>;
}
