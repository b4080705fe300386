//! A planner whose paths are straightened.

use super::KeyNodes;
use agv_core::{
    geometry::Se2,
    grid::Costmap,
    path::Path,
    roles::{GlobalPlanner, PlanError, PlanOutcome},
};

/// Plans with `P` and leaves only the key nodes of its paths; the [`GlobalPlanner`] role.
///
/// The cost of the outcome is that of `P`'s own path.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, Costmap, Grid, GridLayout};
/// use agv_core::path::Path;
/// use agv_core::roles::GlobalPlanner;
/// use agv_plan::grid::{AStar, AStarParams};
/// use agv_plan::smooth::{KeyNodes, KeyNodesParams, Straightened};
///
/// let map = Costmap::from_map(&Grid::filled(GridLayout::new(60, 60, 0.1, Se2::default())?, CellState::Free));
/// let mut planner =
///     Straightened::new(AStar::new(AStarParams::default())?, KeyNodes::new(KeyNodesParams::default())?);
/// let mut path = Path::new();
/// planner.plan_into(&map, &Se2::new(0.5, 0.5, 0.0), &Se2::new(5.0, 3.0, 0.0), &mut path)?;
/// assert_eq!(path.len(), 2, "nothing stands between start and goal");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Straightened<P> {
    planner: P,
    key_nodes: KeyNodes,
    /// The planner's own path.
    path: Path,
}

impl<P: GlobalPlanner> Straightened<P> {
    /// A planner that straightens what `planner` finds.
    pub const fn new(planner: P, key_nodes: KeyNodes) -> Self {
        Self { planner, key_nodes, path: Path::new() }
    }
}

impl<P: GlobalPlanner> GlobalPlanner for Straightened<P> {
    fn plan_into(
        &mut self,
        costmap: &Costmap,
        start: &Se2,
        goal: &Se2,
        path: &mut Path,
    ) -> Result<PlanOutcome, PlanError> {
        path.clear();
        let outcome = self.planner.plan_into(costmap, start, goal, &mut self.path)?;
        self.key_nodes.shorten_into(costmap, &self.path, path)?;
        Ok(outcome)
    }
}
