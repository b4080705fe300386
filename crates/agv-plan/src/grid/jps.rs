//! Jump point search (Harabor and Grastien 2011): A* that queues only the cells where a shortest way may turn.
//!
//! With the canonical ordering of [`Uniform`](super::Uniform) most cells have one successor, straight ahead. Those are run
//! through without being queued, until a cell has others (a *jump point*), or is the goal. A diagonal run also stops where a
//! straight run to one of its sides finds such a cell. The ordering is tabulated for each corner rule, and so are the jumps.

use super::{
    heuristic::{Manhattan, Octile, Offset, Zero},
    limits::{Limits, SearchResult},
    masks::Pruning,
    planner::{GridPlanner, GridPlannerParams, GridSolver},
    search::{Frontier, Reached, SearchSpace, Workspace},
    space::GridSpace,
    step::{DIAGONAL, STRAIGHT, Step},
};
use crate::Error;
use agv_core::grid::Connectivity;

/// Jump point search: lengths as those of [`AStar`](super::AStar), for cells of uniform cost.
///
/// The path has a point where it turns and where it was queued, not one per cell.
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
    workspace: Workspace<Jump>,
    start: u32,
    /// All that can be reached, cell by cell, where the last search found nothing and was asked for the rest.
    flood: Option<Box<Workspace<Step>>>,
    is_flooded: bool,
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
        (self.start, self.is_flooded) = (start, false);
        let (jumps, is_goal, offset) = (JumpPoints::new(space, goal), |node| node == goal, Offset::to(space, goal));
        match space.params().connectivity {
            Connectivity::Eight => self.workspace.search(&jumps, &Octile(offset), start, is_goal, limits),
            Connectivity::Four => self.workspace.search(&jumps, &Manhattan(offset), start, is_goal, limits),
        }
    }

    /// The cells between jump points are reached too, but nothing is known of them: they are searched one by one.
    fn exhaust(&mut self, space: &GridSpace, limits: &mut Limits<'_>) -> u64 {
        self.is_flooded = true;
        let flood = self.flood.get_or_insert_default();
        flood.search(&space.uniform(), &Zero, self.start, |_| false, limits).expansions
    }

    fn cost(&self, node: u32) -> Option<u32> {
        match &self.flood {
            Some(flood) if self.is_flooded => flood.cost(node),
            _ => self.workspace.cost(node),
        }
    }

    fn way_into(&self, space: &GridSpace, node: u32, way: &mut Vec<u32>) {
        match &self.flood {
            Some(flood) if self.is_flooded => flood.trace_into(&space.uniform(), node, way),
            _ => self.workspace.trace_into(&JumpPoints::new(space, node), node, way),
        }
    }
}

/// How a jump point was reached: from where, and by a run of which step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Jump {
    from: u32,
    step: Step,
}

impl Default for Jump {
    /// No jump: a start.
    fn default() -> Self {
        Self { from: u32::MAX, step: Step::NONE }
    }
}

/// A [`GridSpace`] of uniform cost as a graph of jump points on the way to one goal.
#[derive(Debug, Clone, Copy)]
pub struct JumpPoints<'a> {
    space: &'a GridSpace,
    strides: [u32; 8],
    pruning: &'a Pruning,
    goal: u32,
}

impl<'a> JumpPoints<'a> {
    /// Straight steps that are counted as a usual jump.
    const USUAL_JUMP: u32 = 16;

    /// The jump points of a space, for ways to `goal`.
    pub fn new(space: &'a GridSpace, goal: u32) -> Self {
        Self { space, strides: space.strides(), pruning: space.canonical(), goal }
    }

    /// Where a run from `node` ends in a jump point or the goal, and its steps.
    fn jump(&self, node: u32, step: Step) -> Option<(u32, u32)> {
        if step.is_diagonal() { self.jump_diagonally(node, step) } else { self.jump_straight(node, step) }
    }

    fn jump_straight(&self, mut node: u32, step: Step) -> Option<(u32, u32)> {
        let stride = self.strides[step.index() & 7];
        for steps in 1.. {
            node = node.wrapping_add(stride);
            if node == self.goal {
                return Some((node, steps));
            }
            let successors = self.pruning.successors(step, self.space.mask(node));
            if successors != step.bit() {
                return (successors != 0).then_some((node, steps));
            }
        }
        None
    }

    fn jump_diagonally(&self, mut node: u32, step: Step) -> Option<(u32, u32)> {
        let stride = self.strides[step.index() & 7];
        let sides = [Step::towards(step.dx(), 0), Step::towards(0, step.dy())];
        let natural = step.bit() | sides[0].bit() | sides[1].bit();
        for steps in 1.. {
            node = node.wrapping_add(stride);
            let successors = self.pruning.successors(step, self.space.mask(node));
            let turns = |side: Step| successors & side.bit() != 0 && self.jump_straight(node, side).is_some();
            if node == self.goal || successors & !natural != 0 || sides.into_iter().any(turns) {
                return Some((node, steps));
            }
            if successors & step.bit() == 0 {
                return None;
            }
        }
        None
    }
}

impl SearchSpace for JumpPoints<'_> {
    type Link = Jump;

    fn node_count(&self) -> usize {
        self.space.len()
    }

    fn max_step(&self) -> u32 {
        Self::USUAL_JUMP * DIAGONAL
    }

    #[inline]
    fn expand(&self, at: Reached<Jump>, frontier: &mut impl Frontier<Jump>) {
        let mut open = self.pruning.successors(at.link.step, self.space.mask(at.node));
        while open != 0 {
            let step = Step::from_bit(open.trailing_zeros());
            open &= open - 1;
            if let Some((node, steps)) = self.jump(at.node, step) {
                let price = if step.is_diagonal() { DIAGONAL } else { STRAIGHT };
                let cost = at.cost.saturating_add(steps.saturating_mul(price));
                frontier.reach(node, cost, Jump { from: at.node, step });
            }
        }
    }

    fn predecessor(&self, _: u32, link: Jump) -> Option<u32> {
        (link.step != Step::NONE).then_some(link.from)
    }
}
