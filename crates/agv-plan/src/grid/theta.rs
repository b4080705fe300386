//! Theta* (Daniel, Nash, Koenig and Felner 2010): A* along the grid whose ways cut across it.
//!
//! When the neighbour `n` of `s` is looked at, the parent `p` of `s` is asked first: if the straight line from `p` to `n` is
//! open, the way to `n` comes from `p` and not from `s`,
//!
//! ```text
//! g(n) = g(p) + |p n|    if the line is open,    g(s) + |s n|    otherwise
//! ```
//!
//! Ways bend at the cells' centres only. They are no longer than those of A* (nodes whose cost falls are expanded again),
//! though not always the shortest of all: `p` is one of many that could be asked.

use super::{
    any_angle::Parent,
    heuristic::{Euclidean, Offset},
    limits::{Limits, SearchResult},
    planner::{GridPlanner, GridPlannerParams, GridSolver},
    search::{Frontier, Reached, SearchSpace, Workspace},
    space::GridSpace,
    step::{DIAGONAL, Step},
};
use crate::Error;

/// The planner Theta*, for cells of uniform cost.
///
/// The cost of a path is its length between the centres of the start's and the goal's cell.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, Costmap, Grid, GridLayout};
/// use agv_core::path::Path;
/// use agv_core::roles::{GlobalPlanner, PlanOutcome};
/// use agv_plan::grid::{GridPlannerParams, ThetaStar};
///
/// let map = Costmap::from_map(&Grid::filled(GridLayout::new(60, 60, 0.1, Se2::default())?, CellState::Free));
/// let (start, goal, mut path) = (Se2::new(0.55, 0.55, 0.0), Se2::new(4.55, 3.55, 0.0), Path::new());
/// let outcome = ThetaStar::new(GridPlannerParams::default())?.plan_into(&map, &start, &goal, &mut path)?;
/// assert!(matches!(outcome, PlanOutcome::Found { cost, .. } if (cost - 5.0).abs() < 1e-9));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type ThetaStar = GridPlanner<ThetaSolver>;

/// The search of [`ThetaStar`].
#[derive(Debug, Clone, Default)]
pub struct ThetaSolver {
    workspace: Workspace<Parent>,
}

impl ThetaStar {
    /// Checks the parameters.
    ///
    /// # Errors
    /// Tolerances that are not finite or negative; a cost weight that is not zero.
    pub fn new(params: GridPlannerParams) -> Result<Self, Error> {
        Self::with_uniform_solver(params, "ThetaStar", ThetaSolver::default())
    }
}

impl GridSolver for ThetaSolver {
    fn search(&mut self, space: &GridSpace, start: u32, goal: u32, limits: &mut Limits<'_>) -> SearchResult {
        let bound = Euclidean(Offset::to(space, goal));
        self.workspace.search(&Theta::new(space), &bound, start, |node| node == goal, limits)
    }

    fn cost(&self, node: u32) -> Option<u32> {
        self.workspace.cost(node)
    }

    fn way_into(&self, space: &GridSpace, node: u32, way: &mut Vec<u32>) {
        self.workspace.trace_into(&Theta::new(space), node, way);
    }
}

/// A [`GridSpace`] of uniform cost with ways that cut across its cells.
#[derive(Debug, Clone, Copy)]
pub struct Theta<'a> {
    space: &'a GridSpace,
    strides: [u32; 8],
}

impl<'a> Theta<'a> {
    /// The space, cut across.
    pub fn new(space: &'a GridSpace) -> Self {
        Self { space, strides: space.strides() }
    }

    /// The open neighbours of a node.
    #[inline]
    pub(super) fn neighbours(&self, node: u32) -> impl Iterator<Item = u32> + use<'a> {
        let (mask, strides) = (self.space.mask(node), self.strides);
        Step::ALL
            .into_iter()
            .zip(strides)
            .filter(move |(step, _)| mask & step.bit() != 0)
            .map(move |(_, stride)| node.wrapping_add(stride))
    }
}

impl SearchSpace for Theta<'_> {
    type Link = Parent;

    fn node_count(&self) -> usize {
        self.space.len()
    }

    fn max_step(&self) -> u32 {
        DIAGONAL
    }

    fn expand(&self, at: Reached<Parent>, frontier: &mut impl Frontier<Parent>) {
        let parent = at.link.node().unwrap_or(at.node);
        let to_parent = frontier.known(parent).map_or(at.cost, |known| known.cost);
        for next in self.neighbours(at.node) {
            let straight = to_parent.saturating_add(self.space.line_cost(parent, next));
            // The way over this node is no shorter: most neighbours are settled without a look along the line.
            if frontier.known(next).is_some_and(|known| known.cost <= straight) {
                continue;
            }
            if self.space.is_line_open(parent, next) {
                frontier.reach(next, straight, Parent::at(parent));
            } else {
                let step = self.space.line_cost(at.node, next);
                frontier.reach(next, at.cost.saturating_add(step), Parent::at(at.node));
            }
        }
    }

    fn predecessor(&self, _: u32, link: Parent) -> Option<u32> {
        link.node()
    }
}
