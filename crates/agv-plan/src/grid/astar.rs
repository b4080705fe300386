//! A* (Hart, Nilsson and Raphael 1968): best-first by the cost so far plus a lower bound on the rest.

use super::{
    heuristic::{Euclidean, Heuristic, Manhattan, Octile, Offset, Zero},
    limits::{Limits, SearchResult},
    planner::{GridPlanner, GridPlannerParams, GridSolver},
    search::Workspace,
    space::{GridParams, GridSpace},
    step::Step,
};
use crate::Error;
use agv_core::grid::Connectivity;

/// Which lower bound guides the search. All lead to paths of the same cost; the larger the bound, the fewer expansions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum GridHeuristic {
    /// The exact distance without obstacles: [`Octile`] or, where there are no diagonal steps, [`Manhattan`].
    #[default]
    Exact,
    /// [`Octile`] also where there are no diagonal steps.
    Octile,
    /// [`Manhattan`]; refused where there are diagonal steps.
    Manhattan,
    /// [`Euclidean`].
    Euclidean,
    /// [`Zero`]: Dijkstra's algorithm.
    Zero,
}

impl GridHeuristic {
    /// The one meant by [`Exact`](Self::Exact).
    pub(super) fn resolved(self, connectivity: Connectivity) -> Self {
        match (self, connectivity) {
            (Self::Exact, Connectivity::Four) => Self::Manhattan,
            (Self::Exact, Connectivity::Eight) => Self::Octile,
            (other, _) => other,
        }
    }
}

/// Parameters of [`AStar`] and of [`Bidirectional`](super::Bidirectional).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AStarParams {
    /// How the costmap becomes a graph.
    pub grid: GridParams,
    /// Lower bound on the rest of the way.
    pub heuristic: GridHeuristic,
    /// How far from the start pose the path may begin if the vehicle cannot stand there, in metres: the straight line to the
    /// nearest passable cell is then not checked.
    pub start_tolerance: f64,
    /// How far from the goal pose the path may end if the goal cannot be reached, in metres.
    pub goal_tolerance: f64,
    /// Most cells that a query expands.
    pub max_expansions: u64,
}

impl Default for AStarParams {
    /// Eight neighbours, no cut corners, shortest path; start and goal as they are given; no budget.
    fn default() -> Self {
        let GridPlannerParams { grid, start_tolerance, goal_tolerance, max_expansions } = GridPlannerParams::default();
        Self { grid, heuristic: GridHeuristic::Exact, start_tolerance, goal_tolerance, max_expansions }
    }
}

impl AStarParams {
    /// What is common to all planners, and the heuristic with its `Exact` resolved.
    ///
    /// # Errors
    /// [`GridHeuristic::Manhattan`] with diagonal steps.
    pub(super) fn split(self) -> Result<(GridPlannerParams, GridHeuristic), Error> {
        let Self { grid, heuristic, start_tolerance, goal_tolerance, max_expansions } = self;
        if heuristic == GridHeuristic::Manhattan && grid.connectivity == Connectivity::Eight {
            return Err(Error::InconsistentHeuristic { heuristic: "Manhattan" });
        }
        let params = GridPlannerParams { grid, start_tolerance, goal_tolerance, max_expansions };
        Ok((params, heuristic.resolved(grid.connectivity)))
    }
}

/// Plans least-cost paths over the cells of a costmap.
///
/// The path is as [`GridPlanner`] says, its cost for uniform cells the octile length.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout};
/// use agv_core::path::Path;
/// use agv_core::roles::{GlobalPlanner, PlanOutcome};
/// use agv_plan::grid::{AStar, AStarParams};
///
/// // A wall between start and goal, open at its upper end.
/// let mut map = Grid::filled(GridLayout::new(20, 10, 0.1, Se2::default())?, CellState::Free);
/// for y in 0..8 {
///     map.set(Cell::new(10, y), CellState::Occupied);
/// }
/// let mut planner = AStar::new(AStarParams::default())?;
/// let mut path = Path::new();
/// let (start, goal) = (Se2::new(0.25, 0.25, 0.0), Se2::new(1.75, 0.25, 0.0));
/// let outcome = planner.plan_into(&Costmap::from_map(&map), &start, &goal, &mut path)?;
/// assert!(matches!(outcome, PlanOutcome::Found { cost, .. } if cost > 1.5 && cost < 2.5));
/// assert_eq!(path.points()[0].pose, start);
/// assert_eq!(path.points()[path.len() - 1].pose, goal);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type AStar = GridPlanner<AStarSolver>;

/// The search of [`AStar`].
#[derive(Debug, Clone)]
pub struct AStarSolver {
    heuristic: GridHeuristic,
    workspace: Workspace<Step>,
}

impl AStar {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Tolerances that are not finite or negative, a cost weight out of range, [`GridHeuristic::Manhattan`] with diagonal
    /// steps.
    pub fn new(params: AStarParams) -> Result<Self, Error> {
        let (params, heuristic) = params.split()?;
        Self::with_solver(params, AStarSolver { heuristic, workspace: Workspace::default() })
    }
}

impl AStarSolver {
    fn search_with(
        &mut self,
        space: &GridSpace,
        heuristic: &impl Heuristic,
        (start, goal): (u32, u32),
        limits: &mut Limits<'_>,
    ) -> SearchResult {
        let is_goal = |node| node == goal;
        if space.is_weighted() {
            self.workspace.search(&space.weighted(), heuristic, start, is_goal, limits)
        } else {
            self.workspace.search(&space.uniform(), heuristic, start, is_goal, limits)
        }
    }
}

impl GridSolver for AStarSolver {
    fn search(&mut self, space: &GridSpace, start: u32, goal: u32, limits: &mut Limits<'_>) -> SearchResult {
        let (offset, ends) = (Offset::to(space, goal), (start, goal));
        match self.heuristic {
            GridHeuristic::Exact | GridHeuristic::Octile => self.search_with(space, &Octile(offset), ends, limits),
            GridHeuristic::Manhattan => self.search_with(space, &Manhattan(offset), ends, limits),
            GridHeuristic::Euclidean => self.search_with(space, &Euclidean(offset), ends, limits),
            GridHeuristic::Zero => self.search_with(space, &Zero, ends, limits),
        }
    }

    fn cost(&self, node: u32) -> Option<u32> {
        self.workspace.cost(node)
    }

    fn way_into(&self, space: &GridSpace, node: u32, way: &mut Vec<u32>) {
        self.workspace.trace_into(&space.uniform(), node, way);
    }

    fn is_guided(&self) -> bool {
        self.heuristic != GridHeuristic::Zero
    }
}
