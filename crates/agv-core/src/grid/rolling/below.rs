//! The static map below a rolling window, cell by cell of the window.

use crate::{
    geometry::Se2,
    grid::{Cell, CellState, Grid, GridLayout, window::Shift},
};
use nalgebra::Vector2;

/// A static map, and its part below the window.
#[derive(Debug, Clone)]
pub(super) struct Below {
    pub(super) map: Grid<CellState>,
    pub(super) states: Vec<CellState>,
}

impl Below {
    pub(super) fn new(map: Grid<CellState>, window: &GridLayout) -> Self {
        let mut below = Self { map, states: vec![CellState::Unknown; window.len()] };
        for y in 0..window.height() {
            below.look(window, y, 0..window.width());
        }
        below
    }

    /// Moves with the window, which lies at `window` now.
    pub(super) fn shift(&mut self, shift: Shift, window: &GridLayout) {
        let width = window.width();
        shift.apply(&mut self.states, width, CellState::Unknown);
        let (rows, columns) = shift.new_cells(width, window.height());
        for y in 0..window.height() {
            self.look(window, y, if rows.contains(&y) { 0..width } else { columns.clone() });
        }
    }

    fn look(&mut self, window: &GridLayout, row: usize, columns: std::ops::Range<usize>) {
        for column in columns {
            let state = self.state(window, Cell::new(column as i32, row as i32));
            if let Some(slot) = self.states.get_mut(row * window.width() + column) {
                *slot = state;
            }
        }
    }

    /// The worst that the map says of the window's cell: of all the map's cells that its bounding box touches by more than
    /// rounding. Outside the map nothing is known.
    fn state(&self, window: &GridLayout, cell: Cell) -> CellState {
        let layout = self.map.layout();
        let center = layout.to_grid(&window.center(cell));
        let turn: Se2 = layout.map_from_grid();
        let (cos, sin) = (turn.rotation().cos().abs(), turn.rotation().sin().abs());
        let half = 0.5 * (cos + sin) * window.resolution() / layout.resolution() - 1e-6;
        let clamp = |value: f64, size: usize| value.floor().clamp(-1.0, size as f64) as i32;
        let first = (clamp(center.x - half, layout.width()), clamp(center.y - half, layout.height()));
        let last = (clamp(center.x + half, layout.width()), clamp(center.y + half, layout.height()));
        let mut worst = CellState::Free;
        for y in first.1..=last.1 {
            for x in first.0..=last.0 {
                match self.map.get(Cell::new(x, y)) {
                    Some(CellState::Occupied) => return CellState::Occupied,
                    Some(CellState::Free) => {}
                    _ => worst = CellState::Unknown,
                }
            }
        }
        worst
    }
}

/// Position of a window's corner on the lattice, from which its layout follows without adding up rounding.
pub(super) fn layout_at(corner: (i64, i64), width: usize, height: usize, resolution: f64) -> GridLayout {
    let place = Vector2::new(corner.0 as f64 * resolution, corner.1 as f64 * resolution);
    GridLayout::new_unchecked(width, height, resolution, Se2::from_parts(place, Se2::default().rotation()))
}
