//! The distance to the goal from everywhere: Dijkstra's algorithm run until nothing is left.
//!
//! No step costs less than [`STRAIGHT`]. So the open list need not be sorted within that width: from a cell whose cost lies
//! in `[k, k + 985)` no cell of the same range is reached more cheaply, and all of them may be expanded in any order (Denardo
//! and Fox 1979). They are expanded in the order in which they were reached, that is along the front and through memory.

use super::{
    heuristic::Heuristic,
    nodes::Known,
    search::{Frontier, Reached, SearchSpace},
    space::GridSpace,
    step::{STRAIGHT, Step},
};
use crate::Error;

/// Least cost from every cell to one goal, or to the nearest of several.
///
/// As a [`Heuristic`] it is exact on the space it was computed on, and a lower bound on any space with fewer free cells or
/// dearer ones. Local planners read it as a navigation function: it falls towards the goal and has no local minima.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout};
/// use agv_plan::grid::{GridParams, GridSpace, Potential};
///
/// let map = Grid::filled(GridLayout::new(50, 40, 0.1, Se2::default())?, CellState::Free);
/// let mut space = GridSpace::new(GridParams::default())?;
/// space.update(&Costmap::from_map(&map));
/// let mut potential = Potential::default();
/// potential.compute(&space, space.node(Cell::new(10, 10)).unwrap())?;
/// assert_eq!(potential.distance(space.node(Cell::new(10, 30)).unwrap()), Some(20.0));
/// # Ok::<(), agv_plan::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct Potential {
    /// Cost to the goal by node.
    costs: Vec<u32>,
    /// The step that led to a node, of those that were reached.
    steps: Vec<Step>,
    /// Open nodes by the multiple of the least step in their cost, going round.
    open: Vec<Vec<Open>>,
}

/// A node that waits with the cost that it had when it was reached.
#[derive(Debug, Clone, Copy)]
struct Open {
    node: u32,
    cost: u32,
}

const UNREACHED: u32 = u32::MAX;

impl Potential {
    /// Computes the costs to `goal`, reusing the memory; time is linear in the cells that can be reached. A goal that is
    /// blocked can be reached from nowhere but itself.
    ///
    /// # Errors
    /// [`Error::NoSuchNode`] if the goal is not a node of the space; the potential is then as it was.
    pub fn compute(&mut self, space: &GridSpace, goal: u32) -> Result<(), Error> {
        self.compute_to_nearest(space, &[goal])
    }

    /// As [`compute`](Self::compute), to the nearest of several goals (docks, charging stations); without any, nothing is
    /// reached.
    ///
    /// # Errors
    /// [`Error::NoSuchNode`] names the first goal that is not a node of the space; the potential is then as it was.
    pub fn compute_to_nearest(&mut self, space: &GridSpace, goals: &[u32]) -> Result<(), Error> {
        if let Some(&node) = goals.iter().find(|&&goal| goal as usize >= space.len()) {
            return Err(Error::NoSuchNode { node, len: space.len() });
        }
        if space.is_weighted() {
            self.flood(&space.weighted(), goals);
        } else {
            self.flood(&space.uniform(), goals);
        }
        Ok(())
    }

    /// Steps cost the same in both directions, so the search may begin at the goals.
    fn flood(&mut self, space: &impl SearchSpace<Link = Step>, goals: &[u32]) {
        self.costs.clear();
        self.costs.resize(space.node_count(), UNREACHED);
        self.steps.resize(space.node_count(), Step::NONE);
        // As many ranges as lie between the current one and what one step reaches.
        let ranges = (space.max_step() / STRAIGHT) as usize + 2;
        self.open.resize_with(ranges, Vec::new);
        for &goal in goals {
            self.costs[goal as usize] = 0;
            self.steps[goal as usize] = Step::NONE;
            self.open[0].push(Open { node: goal, cost: 0 });
        }
        let (mut range, mut slot, mut empty) = (0, 0, 0);
        while empty < ranges {
            let mut current = std::mem::take(&mut self.open[slot]);
            empty = if current.is_empty() { empty + 1 } else { 0 };
            let mut flood = Flood { costs: &mut self.costs, steps: &mut self.steps, open: &mut self.open, range, slot };
            for &Open { node, cost } in &current {
                // Otherwise it was reached more cheaply since.
                if flood.costs[node as usize] == cost {
                    let link = flood.steps[node as usize];
                    space.expand(Reached { node, cost, link }, &mut flood);
                }
            }
            current.clear();
            self.open[slot] = current;
            range += 1;
            slot = if slot + 1 == ranges { 0 } else { slot + 1 };
        }
    }

    /// Cost from a node to the goal in the integers of the search, if the goal can be reached.
    #[inline]
    fn cost(&self, node: u32) -> Option<u32> {
        self.costs.get(node as usize).copied().filter(|&cost| cost != UNREACHED)
    }

    /// Cost from a node to the goal in cells, if the goal can be reached by a way short enough to be counted (up to
    /// [`u32::MAX`] / [`STRAIGHT`] cells, some four million): within 1/985 of a cell per step where cells are
    /// weighted, within 3 parts in ten million where they are not.
    #[inline]
    pub fn distance(&self, node: u32) -> Option<f64> {
        self.cost(node).map(|cost| f64::from(cost) / f64::from(STRAIGHT))
    }

    /// The first step of a least-cost way from a node to the goal; none at the goal and where it cannot be reached.
    #[inline]
    pub fn step_to_goal(&self, node: u32) -> Option<Step> {
        let step = *self.steps.get(node as usize).filter(|_| self.cost(node).is_some())?;
        (step != Step::NONE).then(|| step.reversed())
    }
}

impl Heuristic for Potential {
    /// Greater than every cost that can be counted where the goal cannot be reached, or by such a way only: still a lower bound
    /// for the searches, which do not reach nodes at such costs.
    #[inline]
    fn estimate(&self, node: u32) -> u32 {
        self.cost(node).unwrap_or(u32::MAX)
    }
}

/// The frontier of a [`Potential`].
struct Flood<'a> {
    costs: &'a mut [u32],
    steps: &'a mut [Step],
    open: &'a mut [Vec<Open>],
    /// The range of costs that is expanded, and its place among the open ones.
    range: u32,
    slot: usize,
}

impl Frontier<Step> for Flood<'_> {
    #[inline]
    fn known(&self, node: u32) -> Option<Known<Step>> {
        let (&cost, &link) = (self.costs.get(node as usize)?, self.steps.get(node as usize)?);
        (cost != UNREACHED).then_some(Known { cost, link })
    }

    #[inline]
    fn reach(&mut self, node: u32, cost: u32, link: Step) {
        if let Some(known) = self.costs.get_mut(node as usize)
            && cost < *known
        {
            *known = cost;
            self.steps[node as usize] = link;
            let ahead = self.slot + (cost / STRAIGHT - self.range) as usize;
            let place = if ahead < self.open.len() { ahead } else { ahead - self.open.len() };
            self.open[place].push(Open { node, cost });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{CornerRule, GridParams, Limits, SearchEnd, Workspace, Zero};
    use agv_core::{
        geometry::Se2,
        grid::{Cell, Costmap, Grid, GridLayout},
    };
    use proptest::prelude::*;

    proptest! {
        /// Against one search per start; and steps lead down to the goal at the cost that was told.
        #[test]
        fn potentials_are_the_costs_of_single_searches(
            costs in proptest::collection::vec(prop_oneof![3 => 0_u8..200, 1 => Just(254_u8)], 80),
            weighted in any::<bool>(),
            goal in 0_u32..80,
        ) {
            let layout = GridLayout::new(10, 8, 1.0, Se2::default()).unwrap();
            let cost_weight = if weighted { 3.0 } else { 0.0 };
            let params = GridParams { cost_weight, corner_rule: CornerRule::OneFree, ..Default::default() };
            let mut space = GridSpace::new(params).unwrap();
            space.update(&Costmap::from_costs(Grid::new(layout, costs).unwrap()));
            let mut potential = Potential::default();
            potential.compute(&space, (goal + 1) % 80).unwrap();
            potential.compute(&space, goal).unwrap();
            let mut workspace: Workspace<Step> = Workspace::default();
            for start in 0..80 {
                let is_goal = |node| node == goal;
                let result = if weighted {
                    workspace.search(&space.weighted(), &potential, start, is_goal, &mut Limits::none())
                } else {
                    workspace.search(&space.uniform(), &Zero, start, is_goal, &mut Limits::none())
                };
                let single = match result.end {
                    SearchEnd::Goal { cost, .. } => Some(cost),
                    _ => None,
                };
                prop_assert_eq!(potential.cost(start), single);
                let mut cell = space.cell(start);
                for _ in 0..80 {
                    let Some(step) = space.node(cell).and_then(|node| potential.step_to_goal(node)) else { break };
                    cell = step.from(cell);
                }
                prop_assert_eq!(single.is_some(), space.node(cell) == Some(goal));
            }
        }
    }

    #[test]
    fn a_goal_outside_is_refused() {
        let layout = GridLayout::new(3, 3, 1.0, Se2::default()).unwrap();
        let mut space = GridSpace::new(GridParams::default()).unwrap();
        let mut potential = Potential::default();
        assert_eq!(potential.compute(&space, 0), Err(Error::NoSuchNode { node: 0, len: 0 }));
        space.update(&Costmap::from_costs(Grid::filled(layout, 0)));
        potential.compute(&space, space.node(Cell::new(2, 2)).unwrap()).unwrap();
        assert_eq!(potential.compute(&space, 9), Err(Error::NoSuchNode { node: 9, len: 9 }));
        assert_eq!(potential.distance(8), Some(0.0));
        assert_eq!(potential.distance(9), None);
    }
}
