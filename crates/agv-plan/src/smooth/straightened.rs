//! A planner whose paths are straightened.

use super::{KeyNodes, PathSmoother};
use agv_core::{
    geometry::Se2,
    grid::Costmap,
    path::Path,
    roles::{GlobalPlanner, NoPathReason, PlanError, PlanOutcome},
};

/// Plans with `P` and smooths its paths by `S`, as by leaving only their key nodes; the [`GlobalPlanner`] role.
///
/// The cost of the outcome is that of `P`'s own path; when a query is cancelled, that path is given as it is.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, Costmap, Grid, GridLayout};
/// use agv_core::path::Path;
/// use agv_core::roles::GlobalPlanner;
/// use agv_plan::grid::{AStar, AStarParams};
/// use agv_plan::smooth::{KeyNodes, LineOfSightParams, Straightened};
///
/// let map = Costmap::from_map(&Grid::filled(GridLayout::new(60, 60, 0.1, Se2::default())?, CellState::Free));
/// let mut planner =
///     Straightened::new(AStar::new(AStarParams::default())?, KeyNodes::new(LineOfSightParams::default())?);
/// let mut path = Path::new();
/// planner.plan_into(&map, &Se2::new(0.5, 0.5, 0.0), &Se2::new(5.0, 3.0, 0.0), &mut path)?;
/// assert_eq!(path.len(), 2, "nothing stands between start and goal");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Straightened<P, S = KeyNodes> {
    planner: P,
    smoother: S,
    /// The planner's own path.
    path: Path,
}

impl<P: GlobalPlanner, S: PathSmoother> Straightened<P, S> {
    /// A planner that straightens what `planner` finds, by key nodes, a taut string or any other smoother.
    pub const fn new(planner: P, smoother: S) -> Self {
        Self { planner, smoother, path: Path::new() }
    }
}

impl<P: GlobalPlanner, S: PathSmoother> GlobalPlanner for Straightened<P, S> {
    fn plan_with_cancel(
        &mut self,
        costmap: &Costmap,
        start: &Se2,
        goal: &Se2,
        path: &mut Path,
        cancelled: &mut dyn FnMut() -> bool,
    ) -> Result<PlanOutcome, PlanError> {
        path.clear();
        let outcome = self.planner.plan_with_cancel(costmap, start, goal, &mut self.path, cancelled)?;
        if matches!(outcome, PlanOutcome::NoPath { reason: NoPathReason::Cancelled, .. }) {
            std::mem::swap(path, &mut self.path);
            return Ok(outcome);
        }
        self.smoother.smooth_into(costmap, &self.path, path)?;
        Ok(outcome)
    }
}
