//! Which cells can reach which: the connected components of a grid.

use super::space::GridSpace;
use super::step::Step;

/// A label per cell; two cells are joined by a path if and only if their labels are equal.
///
/// For maps that stand still: one pass over the map, and "there is no path" is known without a search.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, Costmap, Grid, GridLayout};
/// use agv_plan::grid::{Components, GridParams, GridSpace};
///
/// let states = [CellState::Free, CellState::Free, CellState::Occupied, CellState::Free].to_vec();
/// let map = Grid::new(GridLayout::new(4, 1, 1.0, Se2::default())?, states)?;
/// let mut space = GridSpace::new(GridParams::default())?;
/// space.update(&Costmap::from_map(&map));
/// let mut components = Components::default();
/// components.compute(&space);
/// assert_eq!(components.count(), 2);
/// assert!(components.are_joined(0, 1) && !components.are_joined(1, 3) && !components.are_joined(2, 2));
/// # Ok::<(), agv_plan::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct Components {
    /// Zero for blocked cells, else one more than the component's number.
    labels: Vec<u32>,
    sizes: Vec<u32>,
    stack: Vec<u32>,
}

impl Components {
    /// Labels the cells of a space, reusing the memory; time is linear in its cells.
    ///
    /// Components are numbered by their first cell in storage order.
    pub fn compute(&mut self, space: &GridSpace) {
        let Some(layout) = space.layout() else {
            self.labels.clear();
            self.sizes.clear();
            return;
        };
        let width = layout.width() as u32;
        let strides = Step::ALL.map(|s| (s.dx() as u32).wrapping_add((s.dy() as u32).wrapping_mul(width)));
        self.labels.clear();
        self.labels.resize(layout.len(), 0);
        self.sizes.clear();
        for seed in 0..layout.len() as u32 {
            if self.labels[seed as usize] != 0 || !space.is_passable(seed) {
                continue;
            }
            let label = self.sizes.len() as u32 + 1;
            let mut size = 1;
            self.labels[seed as usize] = label;
            self.stack.push(seed);
            while let Some(node) = self.stack.pop() {
                let mut open = space.mask(node);
                while open != 0 {
                    let next = node.wrapping_add(strides[open.trailing_zeros() as usize & 7]);
                    open &= open - 1;
                    if let Some(slot) = self.labels.get_mut(next as usize).filter(|slot| **slot == 0) {
                        *slot = label;
                        size += 1;
                        self.stack.push(next);
                    }
                }
            }
            self.sizes.push(size);
        }
    }

    /// Number of components.
    pub fn count(&self) -> usize {
        self.sizes.len()
    }

    /// Component of a node, from zero; none for blocked cells and nodes beyond the space.
    #[inline]
    pub fn label(&self, node: u32) -> Option<u32> {
        self.labels.get(node as usize).and_then(|label| label.checked_sub(1))
    }

    /// Cells of a component; zero if there is no such component.
    pub fn size(&self, label: u32) -> u32 {
        self.sizes.get(label as usize).copied().unwrap_or(0)
    }

    /// Whether a path joins the two nodes.
    #[inline]
    pub fn are_joined(&self, a: u32, b: u32) -> bool {
        self.label(a).is_some_and(|label| self.label(b) == Some(label))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{CornerRule, GridParams, Potential};
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
            rule in prop_oneof![Just(CornerRule::Never), Just(CornerRule::OneFree), Just(CornerRule::Free)],
        ) {
            let layout = GridLayout::new(9, 7, 1.0, Se2::default()).unwrap();
            let mut space = GridSpace::new(GridParams { corner_rule: rule, ..Default::default() }).unwrap();
            space.update(&Costmap::from_costs(Grid::new(layout, costs).unwrap()));
            let (mut components, mut potential) = (Components::default(), Potential::default());
            components.compute(&space);
            for a in (0..63).filter(|&a| space.is_passable(a)) {
                potential.compute(&space, a).unwrap();
                let reached = (0..63).filter(|&b| potential.distance(b).is_some()).count();
                prop_assert_eq!(components.size(components.label(a).unwrap()) as usize, reached);
                for b in 0..63 {
                    prop_assert_eq!(components.are_joined(a, b), potential.distance(b).is_some());
                }
            }
        }
    }

    #[test]
    fn a_space_without_cells_has_no_components() {
        let mut components = Components::default();
        components.compute(&GridSpace::new(GridParams::default()).unwrap());
        assert_eq!((components.count(), components.label(0), components.size(0)), (0, None, 0));
        assert!(!components.are_joined(0, 0));
    }
}
