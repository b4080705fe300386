//! On which occupied cells of a map a beam can end.
//!
//! Walls have an inside and a back that no beam meets: a cell with a free neighbour is a surface, one among occupied cells is
//! not, and of those that border on unobserved space only the ones that are not the back of a wall.

use super::{Cell, CellState, Grid};

/// Thickest wall whose back is known for one, in metres.
const WALL: f64 = 0.5;

/// Occupied cells this near to a surface, in metres along either axis, belong to it: a wall that runs askew to the grid has its
/// back beside its front, not straight behind it.
const NEAR: f64 = 0.15;

const SIDES: [(i32, i32); 4] = [(-1, 0), (1, 0), (0, -1), (0, 1)];

/// The map without occupied cells that no beam ends on; none if no occupied cell has a free neighbour.
///
/// A cell with a free neighbour is a surface, and one whose neighbours are all occupied is not. Between the two are those that
/// border on unobserved space: what was seen through a gap too narrow to free the cells before it is a surface too, the back of a
/// wall is not, which is told by a surface straight through it or close by.
pub(super) fn surfaces(map: &Grid<CellState>) -> Option<Grid<CellState>> {
    let layout = map.layout();
    let cells = |metres: f64| (metres / layout.resolution()).round().min(f64::from(i32::MAX)) as i32;
    // Of a map as fine as that, the sums must not overflow.
    let (steps, near) = (cells(WALL), cells(NEAR).min(32));
    let mut surfaces = map.clone();
    let (mut some_left, mut bordering) = (false, Vec::new());
    for (index, state) in surfaces.values_mut().iter_mut().enumerate() {
        if *state != CellState::Occupied {
            continue;
        }
        let Cell { x, y } = layout.cell(index);
        let neighbours = SIDES.map(|(dx, dy)| map.get(Cell::new(x + dx, y + dy)).copied());
        if neighbours.contains(&Some(CellState::Free)) {
            some_left = true;
        } else {
            *state = CellState::Free;
            if neighbours.contains(&Some(CellState::Unknown)) {
                bordering.push(Cell::new(x, y));
            }
        }
    }
    // The cells that are left in `surfaces` have free neighbours.
    bordering.retain(|&Cell { x, y }| {
        let is_back = |&(dx, dy): &(i32, i32)| {
            let inwards = |k: i32| Cell::new(x - k * dx, y - k * dy);
            map.get(Cell::new(x + dx, y + dy)) == Some(&CellState::Unknown)
                && (1..=steps)
                    .take_while(|&k| map.get(inwards(k)) == Some(&CellState::Occupied))
                    .any(|k| surfaces.get(inwards(k)) == Some(&CellState::Occupied))
        };
        let is_surface = |x: i32, y: i32| surfaces.get(Cell::new(x, y)) == Some(&CellState::Occupied);
        let is_near = || (x - near..=x + near).any(|x| (y - near..=y + near).any(|y| is_surface(x, y)));
        !(SIDES.iter().any(is_back) || is_near())
    });
    for &cell in &bordering {
        surfaces.set(cell, CellState::Occupied);
    }
    some_left.then_some(surfaces)
}
