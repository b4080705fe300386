//! From a costmap and two poses to a path: what all planners on grids share.

use super::{
    components::Parts,
    heuristic::{Heuristic, Octile, Offset},
    limits::{Limits, SearchEnd, SearchResult},
    query::{Tolerances, endpoints, write_path},
    space::{GridParams, GridSpace},
};
use crate::Error;
use agv_core::{
    check,
    geometry::Se2,
    grid::Costmap,
    path::Path,
    roles::{GlobalPlanner, NoPathReason, PlanError, PlanOutcome},
};

/// Parameters that all planners on grids share.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GridPlannerParams {
    /// How the costmap becomes a graph.
    pub grid: GridParams,
    /// How far from the start pose the path may begin if the vehicle cannot stand there, in metres: the straight line to the
    /// nearest passable cell is then not checked.
    pub start_tolerance: f64,
    /// How far from the goal pose the path may end if the goal cannot be reached, in metres.
    pub goal_tolerance: f64,
    /// Most cells that a query expands.
    pub max_expansions: u64,
}

impl Default for GridPlannerParams {
    /// Eight neighbours, no cut corners, shortest path; start and goal as they are given; no budget.
    fn default() -> Self {
        Self { grid: GridParams::default(), start_tolerance: 0.0, goal_tolerance: 0.0, max_expansions: u64::MAX }
    }
}

/// A search on a grid, from one node to another: what a [`GridPlanner`] is made for.
pub trait GridSolver {
    /// Searches a way from `start` to `goal`, two passable nodes of the space.
    fn search(&mut self, space: &GridSpace, start: u32, goal: u32, limits: &mut Limits<'_>) -> SearchResult;

    /// Cost of the way from the start to a node, if the last search reached it.
    fn cost(&self, node: u32) -> Option<u32>;

    /// Writes the way of the last search from the start to a node, both included: of two that follow one another the
    /// second can be reached from the first on a straight line. Empty if the node was not reached.
    fn way_into(&self, space: &GridSpace, node: u32, way: &mut Vec<u32>);

    /// Whether the search is drawn to the goal, so that [`SearchResult::nearest`] is near it.
    fn is_guided(&self) -> bool {
        true
    }
}

/// A planner on grids: [`AStar`](super::AStar), [`Dijkstra`](super::Dijkstra), [`Bidirectional`](super::Bidirectional),
/// [`Jps`](super::Jps), [`JpsPlus`](super::JpsPlus), [`DStarLite`](super::DStarLite), [`ThetaStar`](super::ThetaStar) and [`LazyThetaStar`](super::LazyThetaStar) are this type with their
/// solvers, and a solver of one's own makes another.
///
/// The path begins with the start pose, runs through the centres of cells (each heading looks at the next) and ends with
/// the goal pose. Its cost is that from the start's to the goal's cell, in metres: lengths are exact (see
/// [`STRAIGHT`](super::STRAIGHT)). The costmap may be another one in every call; what it has in common with the last one is
/// not computed again. Where a query found start and goal in parts of the map that nothing joins, those parts are labelled:
/// until the map changes, such queries are answered without a search. With a goal tolerance the cell is then searched for that
/// is nearest to the goal among those joined to the start.
///
/// On maps no larger than an earlier one, queries allocate nothing beyond the growth of `path` and, rarely, of the open list;
/// the first query between parts that nothing joins allocates the labels.
///
/// With [`NoPathReason::Budget`] and [`NoPathReason::Cancelled`] the path leads to the reached cell that is nearest to the
/// goal.
#[derive(Debug, Clone)]
pub struct GridPlanner<S> {
    params: GridPlannerParams,
    space: GridSpace,
    solver: S,
    way: Vec<u32>,
    parts: Parts,
}

impl<S: GridSolver> GridPlanner<S> {
    /// A planner with this solver.
    ///
    /// # Errors
    /// Tolerances that are not finite or negative, a cost weight out of range.
    pub fn with_solver(params: GridPlannerParams, solver: S) -> Result<Self, Error> {
        check::non_negative("start_tolerance", params.start_tolerance)?;
        check::non_negative("goal_tolerance", params.goal_tolerance)?;
        let (space, parts) = (GridSpace::new(params.grid)?, Parts::default());
        Ok(Self { params, space, solver, way: Vec::new(), parts })
    }

    /// As [`with_solver`](Self::with_solver), for solvers that know lengths only.
    pub(crate) fn with_uniform_solver(
        params: GridPlannerParams,
        planner: &'static str,
        solver: S,
    ) -> Result<Self, Error> {
        if params.grid.cost_weight > 0.0 {
            return Err(Error::UniformCostsOnly { planner, cost_weight: params.grid.cost_weight });
        }
        Self::with_solver(params, solver)
    }

    /// Parameters it was made with.
    pub const fn params(&self) -> &GridPlannerParams {
        &self.params
    }

    /// The graph of the last costmap.
    pub const fn space(&self) -> &GridSpace {
        &self.space
    }

    /// What the last search knows, for pictures of what was looked at.
    pub const fn solver(&self) -> &S {
        &self.solver
    }

    pub(crate) const fn solver_mut(&mut self) -> &mut S {
        &mut self.solver
    }

    /// Where an unfinished search came nearest to the goal. Without a guide all reached cells are looked through.
    fn most_promising(&self, goal: u32, result: &SearchResult) -> u32 {
        if self.solver.is_guided() {
            return result.nearest;
        }
        let octile = Octile(Offset::to(&self.space, goal));
        let reached = (0..self.space.len() as u32).filter(|&node| self.solver.cost(node).is_some());
        reached.min_by_key(|&node| octile.estimate(node)).unwrap_or(result.nearest)
    }
}

impl<S: GridSolver> GlobalPlanner for GridPlanner<S> {
    /// Asks as often as its solver does: searches every [`Limits::CANCEL_INTERVAL`] expansions, swarms after every iteration.
    fn plan_with_cancel(
        &mut self,
        costmap: &Costmap,
        start: &Se2,
        goal: &Se2,
        path: &mut Path,
        cancelled: &mut dyn FnMut() -> bool,
    ) -> Result<PlanOutcome, PlanError> {
        path.clear();
        let layout = *costmap.layout();
        self.space.update(costmap);
        let tolerances = Tolerances { start: self.params.start_tolerance, goal: self.params.goal_tolerance };
        let ends = match endpoints(&self.space, &layout, (start, goal), tolerances)? {
            Ok(ends) => ends,
            Err(reason) => return Ok(PlanOutcome::NoPath { reason, expansions: 0 }),
        };
        let disconnected = |expansions| Ok(PlanOutcome::NoPath { reason: NoPathReason::Disconnected, expansions });
        let joined_goal =
            |parts: &Parts, space: &GridSpace| parts.joined_goal(space, ends, goal, self.params.goal_tolerance);
        let Some(mut end) = joined_goal(&self.parts, &self.space) else { return disconnected(0) };
        let mut limits = Limits { budget: self.params.max_expansions, cancel: Some(cancelled) };
        let mut result = self.solver.search(&self.space, ends.start, end, &mut limits);
        let mut expansions = result.expansions;
        if result.end == SearchEnd::Exhausted {
            self.parts.label(&self.space);
            let instead = joined_goal(&self.parts, &self.space).filter(|&node| node != end);
            let Some(node) = instead else { return disconnected(expansions) };
            end = node;
            limits.budget = limits.budget.saturating_sub(expansions);
            result = self.solver.search(&self.space, ends.start, end, &mut limits);
            expansions += result.expansions;
        }
        let (last, reason) = match result.end {
            SearchEnd::Goal { node, .. } => (node, None),
            SearchEnd::Exhausted => return disconnected(expansions),
            SearchEnd::Budget => (self.most_promising(end, &result), Some(NoPathReason::Budget)),
            SearchEnd::Cancelled => (self.most_promising(end, &result), Some(NoPathReason::Cancelled)),
        };
        self.solver.way_into(&self.space, last, &mut self.way);
        write_path(&self.space, &layout, &self.way, (start, goal), path)?;
        Ok(match reason {
            None => PlanOutcome::Found { cost: self.space.path_cost(&self.way) * layout.resolution(), expansions },
            Some(reason) => PlanOutcome::NoPath { reason, expansions },
        })
    }
}
