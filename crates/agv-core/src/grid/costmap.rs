//! What it costs to stand in a cell, in the scale of ROS's costmaps.

use super::{Cell, CellState, Grid, GridLayout};

/// The scale of a [`Costmap`], as Nav2's users know it.
pub mod cost {
    /// Nothing near.
    pub const FREE: u8 = 0;
    /// Greatest cost of a cell that may be entered whatever the vehicle's heading.
    pub const MAX_NON_OBSTACLE: u8 = 252;
    /// The vehicle's centre may not enter: an obstacle lies within its inscribed circle.
    pub const INSCRIBED: u8 = 253;
    /// An obstacle.
    pub const LETHAL: u8 = 254;
    /// Not observed.
    pub const UNKNOWN: u8 = 255;
}

/// A grid of traversal costs.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct Costmap {
    grid: Grid<u8>,
}

impl Costmap {
    /// The costmap of a map without inflation: free cells cost nothing, occupied cells are lethal.
    pub fn from_map(map: &Grid<CellState>) -> Self {
        let cost_of = |state: &CellState| match state {
            CellState::Free => cost::FREE,
            CellState::Unknown => cost::UNKNOWN,
            CellState::Occupied => cost::LETHAL,
        };
        Self { grid: map.map(cost_of) }
    }

    /// A costmap from costs per cell in the scale of [`cost`].
    pub const fn from_costs(grid: Grid<u8>) -> Self {
        Self { grid }
    }

    /// For the layers that write costs.
    pub(super) const fn grid_mut(&mut self) -> &mut Grid<u8> {
        &mut self.grid
    }

    /// Size, resolution and pose.
    pub const fn layout(&self) -> &GridLayout {
        self.grid.layout()
    }

    /// Costs, row by row from the lower-left.
    pub fn costs(&self) -> &[u8] {
        self.grid.values()
    }

    /// Cost of a cell; none outside the map.
    #[inline]
    pub fn cost(&self, cell: Cell) -> Option<u8> {
        self.grid.get(cell).copied()
    }

    /// Sets the cost of a cell and says whether it belongs to the map; outside, nothing changes.
    #[inline]
    pub fn set(&mut self, cell: Cell, cost: u8) -> bool {
        self.grid.set(cell, cost)
    }

    /// Costs, row by row from the lower-left, for layers that write them.
    pub fn costs_mut(&mut self) -> &mut [u8] {
        self.grid.values_mut()
    }

    /// The costs as a grid; undoes [`from_costs`](Self::from_costs).
    pub fn into_grid(self) -> Grid<u8> {
        self.grid
    }

    /// Whether the vehicle's centre may stand in the cell: known, inside, and below [`cost::INSCRIBED`].
    #[inline]
    pub fn is_traversable(&self, cell: Cell) -> bool {
        self.cost(cell).is_some_and(|c| c <= cost::MAX_NON_OBSTACLE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Se2;

    #[test]
    fn what_is_written_is_read() {
        let layout = GridLayout::new(3, 2, 0.1, Se2::default()).unwrap();
        let mut costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
        assert!(costmap.set(Cell::new(2, 1), cost::LETHAL) && !costmap.set(Cell::new(3, 1), cost::LETHAL));
        costmap.costs_mut()[0] = cost::UNKNOWN;
        assert!(!costmap.is_traversable(Cell::new(2, 1)) && !costmap.is_traversable(Cell::new(0, 0)));
        assert_eq!(costmap.into_grid().values(), [255, 0, 0, 0, 0, 254]);
    }
}
