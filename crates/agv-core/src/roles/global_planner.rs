//! Where do I go: a path through a map.

use crate::{Error, geometry::Se2, grid::Costmap, path::Path};

/// What became of a query.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum PlanOutcome {
    /// The path leads from start to goal.
    Found {
        /// Cost of the path in the planner's own measure; for uniform costs its length, in metres.
        cost: f64,
        /// States that were expanded.
        expansions: u64,
    },
    /// There is no path, or none was found.
    NoPath {
        /// Why.
        reason: NoPathReason,
        /// States that were expanded.
        expansions: u64,
    },
}

/// Why there is no path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum NoPathReason {
    /// The vehicle cannot stand at the start.
    StartBlocked,
    /// The vehicle cannot stand at the goal, nor within its tolerance.
    GoalBlocked,
    /// Start and goal lie in parts of the map that nothing joins.
    Disconnected,
    /// The budget of expansions ran out; the path then leads to the most promising state that was reached.
    Budget,
    /// The caller's callback asked to stop; the path is as for [`NoPathReason::Budget`].
    Cancelled,
}

/// Why a planner refused a query.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// The start lies outside the map.
    #[error("start ({x}, {y}) lies outside the map")]
    StartOutside {
        /// Its x, in metres.
        x: f64,
        /// Its y, in metres.
        y: f64,
    },
    /// The goal lies outside the map.
    #[error("goal ({x}, {y}) lies outside the map")]
    GoalOutside {
        /// Its x, in metres.
        x: f64,
        /// Its y, in metres.
        y: f64,
    },
    /// A value was refused.
    #[error(transparent)]
    Invalid(#[from] Error),
}

/// Plans a path through a costmap.
///
/// The path starts at the start pose and ends at the goal pose (or within the planner's stated tolerance), and every
/// straight line between its points crosses only cells that the vehicle may enter. With [`PlanOutcome::NoPath`] the
/// path is empty, except for the best-so-far path of an exhausted budget or of a query that was cancelled.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::Costmap;
/// use agv_core::path::Path;
/// use agv_core::roles::{GlobalPlanner, PlanError, PlanOutcome};
///
/// /// Visits stations in order with whatever planner the user holds; the cost of the round, if there is one.
/// fn round_trip(planner: &mut dyn GlobalPlanner, costmap: &Costmap, stations: &[Se2]) -> Result<Option<f64>, PlanError> {
///     let (mut path, mut total) = (Path::new(), 0.0);
///     for leg in stations.windows(2) {
///         match planner.plan_into(costmap, &leg[0], &leg[1], &mut path)? {
///             PlanOutcome::Found { cost, .. } => total += cost,
///             _ => return Ok(None),
///         }
///     }
///     Ok(Some(total))
/// }
/// ```
pub trait GlobalPlanner {
    /// As [`plan_into`](Self::plan_into), and asks `cancelled` from time to time whether to stop: often enough for a control loop
    /// to wait for it, and not again once it said so.
    ///
    /// # Errors
    /// As [`plan_into`](Self::plan_into).
    fn plan_with_cancel(
        &mut self,
        costmap: &Costmap,
        start: &Se2,
        goal: &Se2,
        path: &mut Path,
        cancelled: &mut dyn FnMut() -> bool,
    ) -> Result<PlanOutcome, PlanError>;

    /// Plans from `start` to `goal` (poses of the base in the map) and leaves the result in `path`, whose memory is
    /// reused.
    ///
    /// # Errors
    /// A pose that is not finite or lies outside the map; `path` is then empty.
    fn plan_into(
        &mut self,
        costmap: &Costmap,
        start: &Se2,
        goal: &Se2,
        path: &mut Path,
    ) -> Result<PlanOutcome, PlanError> {
        self.plan_with_cancel(costmap, start, goal, path, &mut || false)
    }
}
