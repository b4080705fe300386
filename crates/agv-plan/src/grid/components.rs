//! Which cells a planner can reach from which.

use super::{
    query::{Endpoints, nearest_node},
    space::GridSpace,
};
use agv_core::{
    geometry::Se2,
    grid::{Components, Revision},
};

impl GridSpace {
    /// Labels the connected components of the space, reusing the memory: "there is no path" is then known without a search,
    /// for as long as the map stands still. Node numbers are the cells' indices ([`Components::label_at`]).
    ///
    /// ```
    /// use agv_core::geometry::Se2;
    /// use agv_core::grid::{CellState, Components, Costmap, Grid, GridLayout};
    /// use agv_plan::grid::{GridParams, GridSpace};
    ///
    /// let states = [CellState::Free, CellState::Free, CellState::Occupied, CellState::Free].to_vec();
    /// let map = Grid::new(GridLayout::new(4, 1, 1.0, Se2::default())?, states)?;
    /// let mut space = GridSpace::new(GridParams::default())?;
    /// space.update(&Costmap::from_map(&map));
    /// let mut components = Components::default();
    /// space.components_into(&mut components);
    /// assert_eq!(components.count(), 2);
    /// # Ok::<(), agv_plan::Error>(())
    /// ```
    pub fn components_into(&self, components: &mut Components) {
        let Some(layout) = self.layout() else { return components.clear() };
        let steps = (self.params().connectivity, self.params().corner_rule);
        components.compute(layout, steps, |index| self.is_passable(index as u32));
    }
}

/// The parts of a map that nothing joins: labelled when a search has found that there are some, and told without one until
/// the map changes.
#[derive(Debug, Clone, Default)]
pub(super) struct Parts {
    components: Components,
    /// State of the space that the labels are of.
    labelled: Option<Revision>,
}

impl Parts {
    /// Labels the parts, unless they are known.
    pub(super) fn label(&mut self, space: &GridSpace) {
        if !self.are_known(space) {
            space.components_into(&mut self.components);
            self.labelled = Some(space.revision().clone());
        }
    }

    fn are_known(&self, space: &GridSpace) -> bool {
        self.labelled.as_ref() == Some(space.revision())
    }

    /// The goal, or where it is known that nothing joins it to the start, the nearest cell to its pose within the tolerance
    /// that is joined.
    pub(super) fn joined_goal(&self, space: &GridSpace, ends: Endpoints, goal: &Se2, tolerance: f64) -> Option<u32> {
        let label = |node: u32| self.components.label_at(node as usize);
        let joined = |node: u32| label(node) == label(ends.start);
        if !self.are_known(space) || joined(ends.goal) {
            return Some(ends.goal);
        }
        nearest_node(space, goal, tolerance, joined)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{Connectivity, CornerRule, GridParams, Potential};
    use agv_core::{
        geometry::Se2,
        grid::{Costmap, Grid, GridLayout},
    };
    use proptest::prelude::*;

    proptest! {
        /// Joined is what a full search says.
        #[test]
        fn labels_agree_with_searches(
            costs in proptest::collection::vec(prop_oneof![Just(0_u8), Just(254_u8)], 63),
            corner_rule in prop_oneof![Just(CornerRule::Never), Just(CornerRule::OneFree), Just(CornerRule::Free)],
            connectivity in prop_oneof![Just(Connectivity::Four), Just(Connectivity::Eight)],
        ) {
            let layout = GridLayout::new(9, 7, 1.0, Se2::default()).unwrap();
            let mut space = GridSpace::new(GridParams { connectivity, corner_rule, ..Default::default() }).unwrap();
            let (mut components, mut potential) = (Components::default(), Potential::default());
            space.components_into(&mut components);
            prop_assert_eq!(components.count(), 0);
            space.update(&Costmap::from_costs(Grid::new(layout, costs).unwrap()));
            space.components_into(&mut components);
            for a in (0..63).filter(|&a| space.is_passable(a)) {
                potential.compute(&space, a).unwrap();
                for b in 0..63 {
                    let joined = components.are_joined(space.cell(a), space.cell(b));
                    prop_assert_eq!(joined, potential.distance(b).is_some());
                }
            }
        }
    }
}
