//! A grid of values, and the three-valued map that planners and localizers share.

use super::{Cell, GridLayout};
use crate::{Error, check};

/// What a map says of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[repr(u8)]
pub enum CellState {
    /// Observed, and nothing there.
    Free,
    /// Not observed, or undecided.
    #[default]
    Unknown,
    /// An obstacle.
    Occupied,
}

/// A value per cell, stored row by row from the lower-left.
///
/// `Grid<CellState>` is the static map that localizers, planners, ray casters and the simulator take; mapping grids
/// produce one.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Grid, GridLayout};
///
/// let mut map = Grid::filled(GridLayout::new(20, 10, 0.1, Se2::default())?, CellState::Free);
/// map.set(Cell::new(3, 4), CellState::Occupied);
/// assert_eq!(map.get(Cell::new(3, 4)), Some(&CellState::Occupied));
/// assert_eq!(map.get(Cell::new(20, 0)), None);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "RawGrid<T>", bound(deserialize = "T: serde::Deserialize<'de>"))
)]
pub struct Grid<T> {
    layout: GridLayout,
    values: Vec<T>,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawGrid<T> {
    layout: GridLayout,
    values: Vec<T>,
}

#[cfg(feature = "serde")]
impl<T> TryFrom<RawGrid<T>> for Grid<T> {
    type Error = Error;

    fn try_from(raw: RawGrid<T>) -> Result<Self, Error> {
        Self::new(raw.layout, raw.values)
    }
}

impl<T> Grid<T> {
    /// A grid from its values, row by row from the lower-left.
    ///
    /// # Errors
    /// [`Error::LengthMismatch`] if there is not one value per cell.
    pub fn new(layout: GridLayout, values: Vec<T>) -> Result<Self, Error> {
        check::length("values", values.len(), layout.len())?;
        Ok(Self { layout, values })
    }

    /// A grid with the same value in every cell.
    pub fn filled(layout: GridLayout, value: T) -> Self
    where
        T: Clone,
    {
        Self { layout, values: vec![value; layout.len()] }
    }

    /// Size, resolution and pose.
    pub const fn layout(&self) -> &GridLayout {
        &self.layout
    }

    /// Values, row by row from the lower-left.
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// Values, row by row from the lower-left.
    pub fn values_mut(&mut self) -> &mut [T] {
        &mut self.values
    }

    /// Value of a cell; none outside the grid.
    #[inline]
    pub fn get(&self, cell: Cell) -> Option<&T> {
        self.layout.index(cell).and_then(|index| self.values.get(index))
    }

    /// Sets a cell and says whether it belongs to the grid; outside, nothing changes.
    #[inline]
    pub fn set(&mut self, cell: Cell, value: T) -> bool {
        match self.layout.index(cell).and_then(|index| self.values.get_mut(index)) {
            Some(slot) => {
                *slot = value;
                true
            }
            None => false,
        }
    }

    /// Gives the grid another layout; its values are then unspecified, new ones being `fill`. Keeps the memory.
    pub(crate) fn reshape(&mut self, layout: GridLayout, fill: T)
    where
        T: Clone,
    {
        self.values.resize(layout.len(), fill);
        self.layout = layout;
    }

    /// The values of row `y`, left to right; none outside the grid.
    pub fn row(&self, y: usize) -> Option<&[T]> {
        self.values.chunks_exact(self.layout.width()).nth(y)
    }

    /// A grid of the same layout with `f` of each value.
    pub fn map<U>(&self, f: impl FnMut(&T) -> U) -> Grid<U> {
        Grid { layout: self.layout, values: self.values.iter().map(f).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Se2;

    #[test]
    fn a_grid_needs_a_value_per_cell() {
        let layout = GridLayout::new(3, 2, 1.0, Se2::default()).unwrap();
        assert_eq!(Grid::new(layout, vec![0; 5]), Err(Error::LengthMismatch { name: "values", len: 5, expected: 6 }));
        let grid = Grid::new(layout, (0..6).collect()).unwrap();
        assert_eq!(grid.row(1), Some(&[3, 4, 5][..]));
        assert_eq!(grid.row(2), None);
        assert_eq!(grid.get(Cell::new(2, 1)), Some(&5));
    }
}
