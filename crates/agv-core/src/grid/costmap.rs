//! What it costs to stand in a cell, in the scale of ROS's costmaps.

use super::{
    Cell, CellState, Grid, GridLayout,
    revision::{CellRect, History, Revision},
};

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

/// A grid of traversal costs, which knows whether and where it was written.
///
/// Two costmaps are equal if their costs are; a clone has a [`Revision`] of its own.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout, cost};
///
/// let layout = GridLayout::new(40, 30, 0.1, Se2::default())?;
/// let mut costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
/// let seen = costmap.revision().clone(); // what a planner remembers
/// assert_eq!(costmap.changed_since(&seen), None);
/// costmap.set(Cell::new(7, 9), cost::LETHAL);
/// assert_eq!(costmap.changed_since(&seen).unwrap().len(), 1);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(transparent))]
pub struct Costmap {
    grid: Grid<u8>,
    #[cfg_attr(feature = "serde", serde(skip))]
    history: History,
}

const fn cost_of(state: CellState) -> u8 {
    match state {
        CellState::Free => cost::FREE,
        CellState::Unknown => cost::UNKNOWN,
        CellState::Occupied => cost::LETHAL,
    }
}

impl PartialEq for Costmap {
    fn eq(&self, other: &Self) -> bool {
        self.grid == other.grid
    }
}

impl Costmap {
    /// The costmap of a map without inflation: free cells cost nothing, occupied cells are lethal.
    pub fn from_map(map: &Grid<CellState>) -> Self {
        Self::from_costs(map.map(|&state| cost_of(state)))
    }

    /// A costmap from costs per cell in the scale of [`cost`].
    pub fn from_costs(grid: Grid<u8>) -> Self {
        Self { grid, history: History::default() }
    }

    /// For the layers that write costs.
    pub(super) fn grid_mut(&mut self) -> &mut Grid<u8> {
        self.history.all_changed();
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
        let changes = self.cost(cell).is_some_and(|before| before != cost);
        if changes {
            self.history.cell_changed(cell);
        }
        self.grid.set(cell, cost)
    }

    /// Costs, row by row from the lower-left, for layers that write them; all count as changed.
    pub fn costs_mut(&mut self) -> &mut [u8] {
        self.history.all_changed();
        self.grid.values_mut()
    }

    /// Which state of which costmap this is: equal revisions have equal costs.
    pub const fn revision(&self) -> &Revision {
        self.history.revision()
    }

    /// A rectangle that holds all cells written since `seen`; none if there are none. All cells for a revision of another
    /// costmap, and for one from before the last [`settle`](Self::settle).
    pub fn changed_since(&self, seen: &Revision) -> Option<CellRect> {
        let layout = self.layout();
        self.history.changed_since(seen, CellRect::whole(layout.width(), layout.height()))
    }

    /// Begins a new rectangle of changes: for writers, once a cycle, before what they write in it.
    pub const fn settle(&mut self) {
        self.history.settle();
    }

    /// Takes the costs of another costmap; memory is used again if it fits.
    pub(super) fn copy_from(&mut self, other: &Self) {
        let grid = self.grid_mut();
        grid.reshape(*other.layout(), cost::UNKNOWN);
        grid.values_mut().copy_from_slice(other.costs());
    }

    /// Becomes [`from_map`](Self::from_map) of a map; memory is used again if it fits.
    pub(super) fn take_states(&mut self, map: &Grid<CellState>) {
        let grid = self.grid_mut();
        grid.reshape(*map.layout(), cost::UNKNOWN);
        for (cost, state) in grid.values_mut().iter_mut().zip(map.values()) {
            *cost = cost_of(*state);
        }
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

    #[test]
    fn changes_are_told_since_any_revision() {
        let layout = GridLayout::new(30, 20, 0.1, Se2::default()).unwrap();
        let mut costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
        let whole = CellRect::whole(30, 20);
        let first = costmap.revision().clone();
        costmap.set(Cell::new(4, 5), cost::LETHAL);
        costmap.set(Cell::new(9, 3), cost::LETHAL);
        costmap.set(Cell::new(20, 19), cost::FREE); // as it was
        let rect = CellRect { min: Cell::new(4, 3), max: Cell::new(9, 5) };
        assert_eq!(costmap.changed_since(&first), Some(rect));
        let second = costmap.revision().clone();
        assert_eq!(costmap.changed_since(&second), None);
        costmap.settle();
        costmap.set(Cell::new(1, 1), cost::LETHAL);
        assert_eq!(costmap.changed_since(&second), Some(CellRect { min: Cell::new(1, 1), max: Cell::new(1, 1) }));
        assert_eq!(costmap.changed_since(&first), Some(whole), "from before it settled");
        let third = costmap.revision().clone();
        costmap.costs_mut();
        assert_eq!(costmap.changed_since(&third), Some(whole));
        // A clone may go its own way.
        let mut clone = costmap.clone();
        assert_eq!((&clone, clone.changed_since(costmap.revision())), (&costmap, Some(whole)));
        clone.set(Cell::new(2, 2), cost::LETHAL);
        costmap.set(Cell::new(3, 3), cost::LETHAL);
        assert_ne!(clone.revision(), costmap.revision());
    }
}
