//! Lazy Theta* (Nash, Koenig and Tovey 2010): Theta* that looks along a line only when its end is expanded.
//!
//! A neighbour is promised the straight line from the parent. When it comes up and the line is blocked, its way comes from
//! the best of its neighbours that were expanded before: one line of sight per expanded node instead of one per neighbour.
//! A node that has been expanded stays as it is.

use super::{
    any_angle::Parent,
    heuristic::{Euclidean, Offset},
    limits::{Limits, SearchResult},
    nodes::{Known, NodeStore},
    planner::{GridPlanner, GridPlannerParams, GridSolver},
    search::{Frontier, Reached, SearchSpace, Workspace},
    space::GridSpace,
    theta::Theta,
};
use crate::Error;

/// The planner Lazy Theta*, for cells of uniform cost.
///
/// Paths are nearly those of [`ThetaStar`](super::ThetaStar), for a fraction of the time.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, Costmap, Grid, GridLayout};
/// use agv_core::path::Path;
/// use agv_core::roles::{GlobalPlanner, PlanOutcome};
/// use agv_plan::grid::{GridPlannerParams, LazyThetaStar};
///
/// let map = Costmap::from_map(&Grid::filled(GridLayout::new(60, 60, 0.1, Se2::default())?, CellState::Free));
/// let (start, goal, mut path) = (Se2::new(0.55, 0.55, 0.0), Se2::new(4.55, 3.55, 0.0), Path::new());
/// let outcome = LazyThetaStar::new(GridPlannerParams::default())?.plan_into(&map, &start, &goal, &mut path)?;
/// assert!(matches!(outcome, PlanOutcome::Found { cost, .. } if (cost - 5.0).abs() < 1e-9));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type LazyThetaStar = GridPlanner<LazyThetaSolver>;

/// The search of [`LazyThetaStar`].
#[derive(Debug, Clone, Default)]
pub struct LazyThetaSolver {
    workspace: Workspace<Promise>,
}

impl LazyThetaStar {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Tolerances that are not finite or negative; a cost weight that is not zero.
    pub fn new(params: GridPlannerParams) -> Result<Self, Error> {
        Self::with_uniform_solver(params, "LazyThetaStar", LazyThetaSolver::default())
    }
}

impl GridSolver for LazyThetaSolver {
    fn search(&mut self, space: &GridSpace, start: u32, goal: u32, limits: &mut Limits<'_>) -> SearchResult {
        let bound = Euclidean(Offset::to(space, goal));
        self.workspace.search(&LazyTheta::new(space), &bound, start, |node| node == goal, limits)
    }

    /// Of expanded nodes only: what was promised to the others may not hold.
    fn cost(&self, node: u32) -> Option<u32> {
        self.workspace.link(node).filter(|promise| promise.is_kept)?;
        self.workspace.cost(node)
    }

    fn way_into(&self, space: &GridSpace, node: u32, way: &mut Vec<u32>) {
        self.workspace.trace_into(&LazyTheta::new(space), node, way);
    }
}

/// The node before, and whether the line from there is known to be open.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Promise {
    parent: Parent,
    is_kept: bool,
}

/// A [`GridSpace`] of uniform cost with ways that cut across its cells, looked along late.
#[derive(Debug, Clone, Copy)]
pub struct LazyTheta<'a> {
    space: &'a GridSpace,
    across: Theta<'a>,
}

impl<'a> LazyTheta<'a> {
    /// The space, cut across.
    pub fn new(space: &'a GridSpace) -> Self {
        Self { space, across: Theta::new(space) }
    }
}

impl SearchSpace for LazyTheta<'_> {
    type Link = Promise;

    fn node_count(&self) -> usize {
        self.across.node_count()
    }

    fn max_step(&self) -> u32 {
        self.across.max_step()
    }

    fn expand(&self, at: Reached<Promise>, frontier: &mut impl Frontier<Promise>) {
        let parent = at.link.parent.node().unwrap_or(at.node);
        let to_parent = frontier.known(parent).map_or(at.cost, |known| known.cost);
        for next in self.across.neighbours(at.node) {
            if frontier.known(next).is_some_and(|known| known.link.is_kept) {
                continue;
            }
            let cost = to_parent.saturating_add(self.space.line_cost(parent, next));
            frontier.reach(next, cost, Promise { parent: Parent::at(parent), is_kept: false });
        }
    }

    fn predecessor(&self, _: u32, link: Promise) -> Option<u32> {
        link.parent.node()
    }

    fn settle(&self, at: Reached<Promise>, nodes: &impl NodeStore<Promise>) -> Option<Known<Promise>> {
        let Reached { node, cost, link } = at;
        let kept = Known { cost, link: Promise { is_kept: true, ..link } };
        if link.is_kept || link.parent.node().is_none_or(|parent| self.space.is_line_open(parent, node)) {
            return Some(kept);
        }
        // At least the neighbour that made the promise was expanded.
        let expanded = self.across.neighbours(node).filter_map(|next| {
            let known = nodes.get(next).filter(|known| known.link.is_kept)?;
            Some((known.cost.saturating_add(self.space.line_cost(next, node)), next))
        });
        let (cost, parent) = expanded.min()?;
        Some(Known { cost, link: Promise { parent: Parent::at(parent), is_kept: true } })
    }
}
