//! What do I do now: a twist that follows a path among obstacles.

use crate::{
    Error,
    geometry::{LieGroup, Se2, Twist2},
    grid::Costmap,
    kinematics::TwistLimits,
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
}

impl VehicleState {
    /// Whether pose and twist are finite.
    pub fn is_finite(&self) -> bool {
        self.map_from_base.is_finite() && self.twist.is_finite()
    }
}

/// All that a local planner may know in one cycle.
#[derive(Debug, Clone, Copy)]
pub struct LocalPlanRequest<'a> {
    /// The vehicle now.
    pub state: VehicleState,
    /// The path to follow, in the map frame.
    pub path: &'a Path,
    /// What is known of the surroundings, inflated or not as the planner documents.
    pub costmap: &'a Costmap,
    /// Obstacles that move, in the map frame, at the time of `state`.
    pub obstacles: &'a [MovingObstacle],
    /// What the vehicle can do.
    pub limits: &'a TwistLimits,
    /// Time until the next cycle, in seconds.
    pub dt: f64,
}

/// What a local planner decided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalCommand {
    /// Twist for the next cycle. It respects the limits and can be executed whatever the status says.
    pub twist: Twist2,
    /// Why this twist.
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
    /// No motion along the path is safe: the twist brakes.
    Blocked(BlockReason),
    /// The vehicle touches an obstacle already: the twist brakes.
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

/// Chooses the twist of the next cycle.
///
/// A twist that is returned respects the velocity and acceleration limits of the request, always.
///
/// ```
/// use agv_core::geometry::Twist2;
/// use agv_core::roles::{BlockReason, LocalCommand, LocalPlanError, LocalPlanRequest, LocalPlanStatus, LocalPlanner};
///
/// /// An emergency stop: brakes as hard as the limits allow.
/// struct Stop;
///
/// impl LocalPlanner for Stop {
///     fn command(&mut self, request: LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError> {
///         let v = request.state.twist.vx;
///         let slower = (v.abs() - request.limits.deceleration * request.dt).max(0.0).copysign(v);
///         Ok(LocalCommand { twist: Twist2::new(slower, 0.0, 0.0), status: LocalPlanStatus::Blocked(BlockReason::Obstacle) })
///     }
/// }
/// ```
pub trait LocalPlanner {
    /// The twist for the next `request.dt` seconds.
    ///
    /// # Errors
    /// An empty path, or a state, limit or `dt` that cannot be one.
    fn command(&mut self, request: LocalPlanRequest<'_>) -> Result<LocalCommand, LocalPlanError>;
}
