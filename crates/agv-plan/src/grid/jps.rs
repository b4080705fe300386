//! Jump point search (Harabor and Grastien 2011): A* that queues only the cells where a shortest way may turn.
//!
//! Runs are scanned for 64 cells at a time and the cells where a way turns from a diagonal to a straight line are not queued
//! (block-based scanning and intermediate pruning, B and P of Harabor and Grastien, *Improving jump point search*, 2014).

use super::{
    heuristic::{Manhattan, Octile, Offset},
    jumps::{Jump, JumpPoints, Runs, turning_node},
    limits::{Limits, SearchResult},
    planner::{GridPlanner, GridPlannerParams, GridSolver},
    search::Workspace,
    space::GridSpace,
    straight_runs::StraightRuns,
};
use crate::Error;
use agv_core::grid::Connectivity;

/// Jump point search: lengths as those of [`AStar`](super::AStar), for cells of uniform cost.
///
/// The path has a point where it turns and where it was queued, not one per cell. Beside the graph it keeps a byte per cell,
/// which follows the costmap block by block of 64 x 64 cells where it changes. With four neighbours no cell can be run
/// through: it is then A*.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, Costmap, Grid, GridLayout};
/// use agv_core::path::Path;
/// use agv_core::roles::{GlobalPlanner, PlanOutcome};
/// use agv_plan::grid::{GridPlannerParams, Jps};
///
/// let map = Costmap::from_map(&Grid::filled(GridLayout::new(200, 100, 0.1, Se2::default())?, CellState::Free));
/// let (start, goal, mut path) = (Se2::new(0.25, 0.25, 0.0), Se2::new(15.05, 0.25, 0.0), Path::new());
/// let outcome = Jps::new(GridPlannerParams::default())?.plan_into(&map, &start, &goal, &mut path)?;
/// assert!(matches!(outcome, PlanOutcome::Found { cost, expansions: 1 } if (cost - 14.8).abs() < 1e-12));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type Jps = GridPlanner<JpsSolver>;

/// The search of [`Jps`].
#[derive(Debug, Clone, Default)]
pub struct JpsSolver {
    runs: StraightRuns,
    search: JumpSearch,
}

impl Jps {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Tolerances that are not finite or negative; a cost weight that is not zero.
    pub fn new(params: GridPlannerParams) -> Result<Self, Error> {
        Self::with_uniform_solver(params, "Jps", JpsSolver::default())
    }
}

impl GridSolver for JpsSolver {
    fn search(&mut self, space: &GridSpace, start: u32, goal: u32, limits: &mut Limits<'_>) -> SearchResult {
        self.search.run(space, &self.runs.scan(space), (start, goal), limits)
    }

    fn cost(&self, node: u32) -> Option<u32> {
        self.search.cost(node)
    }

    fn way_into(&self, space: &GridSpace, node: u32, way: &mut Vec<u32>) {
        self.search.way_into(space, node, way);
    }
}

/// Best-first search over jump points, whoever knows where runs end.
#[derive(Debug, Clone, Default)]
pub(super) struct JumpSearch {
    workspace: Workspace<Jump>,
}

impl JumpSearch {
    pub(super) fn run(
        &mut self,
        space: &GridSpace,
        runs: &impl Runs,
        (start, goal): (u32, u32),
        limits: &mut Limits<'_>,
    ) -> SearchResult {
        let (jumps, is_goal, offset) = (JumpPoints::new(space, runs, goal), |n| n == goal, Offset::to(space, goal));
        match space.params().connectivity {
            Connectivity::Eight => self.workspace.search(&jumps, &Octile(offset), start, is_goal, limits),
            Connectivity::Four => self.workspace.search(&jumps, &Manhattan(offset), start, is_goal, limits),
        }
    }

    pub(super) fn cost(&self, node: u32) -> Option<u32> {
        self.workspace.cost(node)
    }

    pub(super) fn way_into(&self, space: &GridSpace, node: u32, way: &mut Vec<u32>) {
        way.clear();
        let mut next = self.workspace.link(node).map(|link| (node, link));
        while let Some((node, link)) = next {
            way.push(node);
            let from = link.from();
            way.extend(from.and_then(|from| turning_node(space, from, node)));
            next = from.and_then(|from| Some((from, self.workspace.link(from)?)));
        }
        way.reverse();
    }
}
