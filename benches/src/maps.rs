//! Maps to measure on: a recorded one where it is at hand, and ones that code draws.

use agv_core::geometry::Se2;
use agv_core::grid::{Cell, CellState, Grid, GridLayout};
use std::path::Path;

/// The `depot` map of Nav2 (604 x 307 cells of 5 cm), or, where it is not at hand, an office of the same size.
///
/// The name says which of the two it is; benches print it as part of their group's name.
pub fn depot_or_office() -> (&'static str, Grid<CellState>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/localization/depot.yaml");
    match agv_support::map::read(path) {
        Ok(map) => ("depot", map),
        Err(_) => ("office", office(604, 307)),
    }
}

/// The `warehouse` map of Nav2 (1006 x 1674 cells of 3 cm), or, where it is not at hand, an office of as many cells.
///
/// The name says which of the two it is.
pub fn warehouse_or_office() -> (&'static str, Grid<CellState>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/localization/warehouse.yaml");
    match agv_support::map::read(path) {
        Ok(map) => ("warehouse", map),
        Err(_) => ("large office", office(1006, 1674)),
    }
}

/// An office of 5 cm cells: rooms of 6 m by 5 m behind walls with doors, and a table with legs or a pillar in each.
///
/// # Panics
/// A size that no grid has.
pub fn office(width: usize, height: usize) -> Grid<CellState> {
    const ROOM_X: usize = 120;
    const ROOM_Y: usize = 100;
    const DOOR: std::ops::Range<usize> = 40..60;
    let layout = GridLayout::new(width, height, 0.05, Se2::default()).expect("a size that a grid can have");
    let mut map = Grid::filled(layout, CellState::Free);
    for index in 0..layout.len() {
        let cell = layout.cell(index);
        let (x, y) = (cell.x as usize, cell.y as usize);
        let (in_x, in_y) = (x % ROOM_X, y % ROOM_Y);
        let border = x == 0 || y == 0 || x + 1 == width || y + 1 == height;
        let wall = (in_x < 3 && !DOOR.contains(&in_y)) || (in_y < 3 && !DOOR.contains(&in_x));
        let pillar =
            (x / ROOM_X + y / ROOM_Y).is_multiple_of(2) && (70..76).contains(&in_x) && (70..76).contains(&in_y);
        let legs = (x / ROOM_X + y / ROOM_Y) % 2 == 1 && (30..=70).contains(&in_x) && (70..=85).contains(&in_y);
        let leg = legs && (in_x - 30) % 20 < 2 && (in_y - 70) % 15 < 2;
        if border || wall || pillar || leg {
            map.set(Cell::new(cell.x, cell.y), CellState::Occupied);
        }
    }
    map
}
