//! The distance to the goal from everywhere: Dijkstra's algorithm run until nothing is left.

use super::{
    heuristic::{Heuristic, Zero},
    limits::Limits,
    search::{SearchSpace, Workspace},
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
    workspace: Workspace<Step>,
}

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
        self.workspace.begin(space);
        for &goal in goals {
            self.workspace.add_start(&Zero, goal, 0);
        }
        self.workspace.run(space, &Zero, |_| false, &mut Limits::none());
    }

    /// Cost from a node to the goal in cells, if the goal can be reached: within 1/985 of a cell per step where cells are
    /// weighted, within 3 parts in ten million where they are not.
    #[inline]
    pub fn distance(&self, node: u32) -> Option<f64> {
        self.workspace.cost(node).map(|cost| f64::from(cost) / f64::from(STRAIGHT))
    }

    /// The first step of a least-cost way from a node to the goal; none at the goal and where it cannot be reached.
    #[inline]
    pub fn step_to_goal(&self, node: u32) -> Option<Step> {
        self.workspace.link(node).filter(|&step| step != Step::NONE).map(Step::reversed)
    }
}

impl Heuristic for Potential {
    /// As far as can be told apart from "not at all" where the goal cannot be reached.
    #[inline]
    fn estimate(&self, node: u32) -> u32 {
        self.workspace.cost(node).unwrap_or(u32::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{CornerRule, GridParams, SearchEnd};
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
                prop_assert_eq!(potential.workspace.cost(start), single);
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
