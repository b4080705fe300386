//! Dijkstra's algorithm (1959): expands cells by their distance from the start, in all directions alike.

use super::{
    astar::{AStar, AStarParams, GridHeuristic},
    space::GridParams,
};
use crate::Error;
use agv_core::{
    geometry::Se2,
    grid::Costmap,
    path::Path,
    roles::{GlobalPlanner, PlanError, PlanOutcome},
};

/// Parameters of [`Dijkstra`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DijkstraParams {
    /// How the costmap becomes a graph.
    pub grid: GridParams,
    /// As [`AStarParams::start_tolerance`], in metres.
    pub start_tolerance: f64,
    /// As [`AStarParams::goal_tolerance`], in metres.
    pub goal_tolerance: f64,
    /// Most cells that a query expands.
    pub max_expansions: u64,
}

impl Default for DijkstraParams {
    /// As [`AStarParams`].
    fn default() -> Self {
        let AStarParams { grid, start_tolerance, goal_tolerance, max_expansions, .. } = AStarParams::default();
        Self { grid, start_tolerance, goal_tolerance, max_expansions }
    }
}

/// The planner that [`AStar`] is measured against: the same paths, without a heuristic.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, Costmap, Grid, GridLayout};
/// use agv_core::path::Path;
/// use agv_core::roles::{GlobalPlanner, PlanOutcome};
/// use agv_plan::grid::{Dijkstra, DijkstraParams};
///
/// let map = Costmap::from_map(&Grid::filled(GridLayout::new(20, 10, 0.1, Se2::default())?, CellState::Free));
/// let (start, goal, mut path) = (Se2::new(0.25, 0.25, 0.0), Se2::new(1.75, 0.25, 0.0), Path::new());
/// let outcome = Dijkstra::new(DijkstraParams::default())?.plan_into(&map, &start, &goal, &mut path)?;
/// assert!(matches!(outcome, PlanOutcome::Found { cost, .. } if (cost - 1.5).abs() < 1e-12));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
pub struct Dijkstra {
    engine: AStar,
}

impl Dijkstra {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Tolerances that are not finite or negative, a cost weight out of range.
    pub fn new(params: DijkstraParams) -> Result<Self, Error> {
        let DijkstraParams { grid, start_tolerance, goal_tolerance, max_expansions } = params;
        let heuristic = GridHeuristic::Zero;
        let engine = AStar::new(AStarParams { grid, heuristic, start_tolerance, goal_tolerance, max_expansions })?;
        Ok(Self { engine })
    }

    /// As [`AStar::plan_with_cancel`].
    ///
    /// # Errors
    /// As [`plan_into`](GlobalPlanner::plan_into).
    pub fn plan_with_cancel(
        &mut self,
        costmap: &Costmap,
        poses: (&Se2, &Se2),
        path: &mut Path,
        cancel: &mut dyn FnMut() -> bool,
    ) -> Result<PlanOutcome, PlanError> {
        self.engine.plan_with_cancel(costmap, poses, path, cancel)
    }
}

impl GlobalPlanner for Dijkstra {
    fn plan_into(
        &mut self,
        costmap: &Costmap,
        start: &Se2,
        goal: &Se2,
        path: &mut Path,
    ) -> Result<PlanOutcome, PlanError> {
        self.engine.plan_into(costmap, start, goal, path)
    }
}
