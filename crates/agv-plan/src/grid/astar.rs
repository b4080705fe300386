//! A* (Hart, Nilsson and Raphael 1968): best-first by the cost so far plus a lower bound on the rest.

use super::{
    heuristic::{Euclidean, Heuristic, Manhattan, Octile, Offset, Zero},
    query::{Tolerances, endpoints, nearest_node, write_path},
    search::{Limits, SearchEnd, SearchResult, Workspace},
    space::{GridParams, GridSpace},
    step::Step,
};
use crate::Error;
use agv_core::{
    check,
    geometry::Se2,
    grid::{Connectivity, Costmap, GridLayout},
    path::Path,
    roles::{GlobalPlanner, NoPathReason, PlanError, PlanOutcome},
};

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

/// Parameters of [`AStar`].
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
        Self {
            grid: GridParams::default(),
            heuristic: GridHeuristic::Exact,
            start_tolerance: 0.0,
            goal_tolerance: 0.0,
            max_expansions: u64::MAX,
        }
    }
}

/// Plans least-cost paths over the cells of a costmap.
///
/// The path begins with the start pose, runs through the centres of cells (each heading looks at the next) and ends with
/// the goal pose. Its cost is that of the steps from the start's to the goal's cell, in metres: with uniform costs the
/// octile length, exact (see [`STRAIGHT`](super::STRAIGHT)). The costmap may be another one in every call; what it has
/// in common with the last one is not computed again. Queries on maps no larger than an earlier one allocate nothing
/// beyond the growth of `path` and, rarely, of the open list.
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
#[derive(Debug, Clone)]
pub struct AStar {
    params: AStarParams,
    space: GridSpace,
    workspace: Workspace<Step>,
    way: Vec<u32>,
}

impl AStar {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Tolerances that are not finite or negative, a cost weight out of range, [`GridHeuristic::Manhattan`] with diagonal
    /// steps.
    pub fn new(params: AStarParams) -> Result<Self, Error> {
        check::non_negative("start_tolerance", params.start_tolerance)?;
        check::non_negative("goal_tolerance", params.goal_tolerance)?;
        if params.heuristic == GridHeuristic::Manhattan && params.grid.connectivity == Connectivity::Eight {
            return Err(Error::InconsistentHeuristic { heuristic: "Manhattan" });
        }
        Ok(Self { params, space: GridSpace::new(params.grid)?, workspace: Workspace::default(), way: Vec::new() })
    }

    /// Parameters it was made with.
    pub const fn params(&self) -> &AStarParams {
        &self.params
    }

    /// The graph of the last costmap.
    pub const fn space(&self) -> &GridSpace {
        &self.space
    }

    /// What the last search knows, for pictures of what was looked at.
    pub const fn workspace(&self) -> &Workspace<Step> {
        &self.workspace
    }

    /// As [`plan_into`](GlobalPlanner::plan_into), but asks `cancel` every [`Limits::CANCEL_INTERVAL`] expansions whether
    /// to stop.
    ///
    /// # Errors
    /// As [`plan_into`](GlobalPlanner::plan_into).
    pub fn plan_with_cancel(
        &mut self,
        costmap: &Costmap,
        (start, goal): (&Se2, &Se2),
        path: &mut Path,
        cancel: &mut dyn FnMut() -> bool,
    ) -> Result<PlanOutcome, PlanError> {
        self.plan(costmap, (start, goal), path, Some(cancel))
    }

    fn plan(
        &mut self,
        costmap: &Costmap,
        poses: (&Se2, &Se2),
        path: &mut Path,
        cancel: Option<&mut dyn FnMut() -> bool>,
    ) -> Result<PlanOutcome, PlanError> {
        path.clear();
        let layout = *costmap.layout();
        self.space.update(costmap);
        let tolerances = Tolerances { start: self.params.start_tolerance, goal: self.params.goal_tolerance };
        let ends = match endpoints(&self.space, &layout, poses, tolerances)? {
            Ok(ends) => ends,
            Err(reason) => return Ok(PlanOutcome::NoPath { reason, expansions: 0 }),
        };
        let mut limits = Limits { budget: self.params.max_expansions, cancel };
        let result = self.search(&layout, ends.start, ends.goal, &mut limits);
        let expansions = result.expansions;
        let (last, reason) = match result.end {
            SearchEnd::Goal { node, .. } => (node, None),
            SearchEnd::Exhausted => {
                let reached = |node| self.workspace.cost(node).is_some();
                match nearest_node(&self.space, poses.1, tolerances.goal, reached) {
                    Some(node) => (node, None),
                    None => return Ok(PlanOutcome::NoPath { reason: NoPathReason::Disconnected, expansions }),
                }
            }
            SearchEnd::Budget => (self.most_promising(&layout, ends.goal, &result), Some(NoPathReason::Budget)),
            SearchEnd::Cancelled => (self.most_promising(&layout, ends.goal, &result), Some(NoPathReason::Cancelled)),
        };
        self.workspace.trace_into(&self.space.uniform(), last, &mut self.way);
        write_path(&self.space, &layout, &self.way, poses, path)?;
        Ok(match reason {
            None => PlanOutcome::Found { cost: self.space.path_cost(&self.way) * layout.resolution(), expansions },
            Some(reason) => PlanOutcome::NoPath { reason, expansions },
        })
    }

    fn search(&mut self, layout: &GridLayout, start: u32, goal: u32, limits: &mut Limits<'_>) -> SearchResult {
        let offset = Offset::new(layout.width() as u32, self.space.cell(goal));
        match (self.params.heuristic, self.params.grid.connectivity) {
            (GridHeuristic::Exact | GridHeuristic::Octile, Connectivity::Eight)
            | (GridHeuristic::Octile, Connectivity::Four) => self.search_with(&Octile(offset), start, goal, limits),
            (GridHeuristic::Exact | GridHeuristic::Manhattan, _) => {
                self.search_with(&Manhattan(offset), start, goal, limits)
            }
            (GridHeuristic::Euclidean, _) => self.search_with(&Euclidean(offset), start, goal, limits),
            (GridHeuristic::Zero, _) => self.search_with(&Zero, start, goal, limits),
        }
    }

    fn search_with(
        &mut self,
        heuristic: &impl Heuristic,
        start: u32,
        goal: u32,
        limits: &mut Limits<'_>,
    ) -> SearchResult {
        let is_goal = |node| node == goal;
        if self.space.is_weighted() {
            self.workspace.search(&self.space.weighted(), heuristic, start, is_goal, limits)
        } else {
            self.workspace.search(&self.space.uniform(), heuristic, start, is_goal, limits)
        }
    }

    /// Where an unfinished search came nearest to the goal. Without a heuristic all reached cells are looked through.
    fn most_promising(&self, layout: &GridLayout, goal: u32, result: &SearchResult) -> u32 {
        if self.params.heuristic != GridHeuristic::Zero {
            return result.nearest;
        }
        let octile = Octile(Offset::new(layout.width() as u32, self.space.cell(goal)));
        let reached = (0..layout.len() as u32).filter(|&node| self.workspace.cost(node).is_some());
        reached.min_by_key(|&node| octile.estimate(node)).unwrap_or(result.nearest)
    }
}

impl GlobalPlanner for AStar {
    fn plan_into(
        &mut self,
        costmap: &Costmap,
        start: &Se2,
        goal: &Se2,
        path: &mut Path,
    ) -> Result<PlanOutcome, PlanError> {
        self.plan(costmap, (start, goal), path, None)
    }
}
