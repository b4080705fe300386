//! Jump point search with the runs of all cells computed beforehand (JPS+; Harabor and Grastien, *Improving jump point search*,
//! 2014): no cell is looked at between two jump points.

use super::{
    jps::JumpSearch,
    jump_table::JumpTable,
    limits::{Limits, SearchResult},
    planner::{GridPlanner, GridPlannerParams, GridSolver},
    space::GridSpace,
};
use crate::Error;

/// JPS+: paths as those of [`Jps`](super::Jps), sooner, for maps that seldom change.
///
/// Beside the graph it keeps 16 bytes per cell, computed when the first query comes and followed where the costmap changes:
/// the rows and columns of the changed cells, and the diagonals of the whole map.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, Costmap, Grid, GridLayout};
/// use agv_core::path::Path;
/// use agv_core::roles::{GlobalPlanner, PlanOutcome};
/// use agv_plan::grid::{GridPlannerParams, JpsPlus};
///
/// let map = Costmap::from_map(&Grid::filled(GridLayout::new(200, 100, 0.1, Se2::default())?, CellState::Free));
/// let (start, goal, mut path) = (Se2::new(0.25, 0.25, 0.0), Se2::new(15.05, 0.25, 0.0), Path::new());
/// let outcome = JpsPlus::new(GridPlannerParams::default())?.plan_into(&map, &start, &goal, &mut path)?;
/// assert!(matches!(outcome, PlanOutcome::Found { cost, expansions: 1 } if (cost - 14.8).abs() < 1e-12));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type JpsPlus = GridPlanner<JpsPlusSolver>;

/// The search of [`JpsPlus`].
#[derive(Debug, Clone, Default)]
pub struct JpsPlusSolver {
    table: JumpTable,
    search: JumpSearch,
}

impl JpsPlus {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Tolerances that are not finite or negative; a cost weight that is not zero.
    pub fn new(params: GridPlannerParams) -> Result<Self, Error> {
        Self::with_uniform_solver(params, "JpsPlus", JpsPlusSolver::default())
    }
}

impl JpsPlusSolver {
    /// Computes or follows the table for a space, so that the next query need not.
    pub fn prepare(&mut self, space: &GridSpace) {
        self.table.update(space);
    }
}

impl GridSolver for JpsPlusSolver {
    fn search(&mut self, space: &GridSpace, start: u32, goal: u32, limits: &mut Limits<'_>) -> SearchResult {
        self.prepare(space);
        self.search.run(space, &self.table, (start, goal), limits)
    }

    fn cost(&self, node: u32) -> Option<u32> {
        self.search.cost(node)
    }

    fn way_into(&self, space: &GridSpace, node: u32, way: &mut Vec<u32>) {
        self.search.way_into(space, node, way);
    }
}
