//! Dijkstra's algorithm (1959): expands cells by their distance from the start, in all directions alike.

use super::{
    heuristic::Zero,
    limits::{Limits, SearchResult},
    planner::{GridPlanner, GridPlannerParams, GridSolver},
    search::Workspace,
    space::GridSpace,
    step::Step,
};
use crate::Error;

/// The planner that [`AStar`](super::AStar) is measured against: the same paths, without a heuristic.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, Costmap, Grid, GridLayout};
/// use agv_core::path::Path;
/// use agv_core::roles::{GlobalPlanner, PlanOutcome};
/// use agv_plan::grid::{Dijkstra, GridPlannerParams};
///
/// let map = Costmap::from_map(&Grid::filled(GridLayout::new(20, 10, 0.1, Se2::default())?, CellState::Free));
/// let (start, goal, mut path) = (Se2::new(0.25, 0.25, 0.0), Se2::new(1.75, 0.25, 0.0), Path::new());
/// let outcome = Dijkstra::new(GridPlannerParams::default())?.plan_into(&map, &start, &goal, &mut path)?;
/// assert!(matches!(outcome, PlanOutcome::Found { cost, .. } if (cost - 1.5).abs() < 1e-12));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type Dijkstra = GridPlanner<DijkstraSolver>;

/// The search of [`Dijkstra`].
#[derive(Debug, Clone, Default)]
pub struct DijkstraSolver {
    workspace: Workspace<Step>,
}

impl Dijkstra {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Tolerances that are not finite or negative, a cost weight out of range.
    pub fn new(params: GridPlannerParams) -> Result<Self, Error> {
        Self::with_solver(params, DijkstraSolver::default())
    }
}

impl GridSolver for DijkstraSolver {
    fn search(&mut self, space: &GridSpace, start: u32, goal: u32, limits: &mut Limits<'_>) -> SearchResult {
        let is_goal = |node| node == goal;
        if space.is_weighted() {
            self.workspace.search(&space.weighted(), &Zero, start, is_goal, limits)
        } else {
            self.workspace.search(&space.uniform(), &Zero, start, is_goal, limits)
        }
    }

    fn cost(&self, node: u32) -> Option<u32> {
        self.workspace.cost(node)
    }

    fn way_into(&self, space: &GridSpace, node: u32, way: &mut Vec<u32>) {
        self.workspace.trace_into(&space.uniform(), node, way);
    }

    fn is_guided(&self) -> bool {
        false
    }
}
