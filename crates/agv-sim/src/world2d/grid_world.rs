//! An occupancy map as a world: occupied cells are solid squares.

use super::PlanarWorld;
use crate::Body;
use crate::bvh::Bounds;
use agv_core::{
    geometry::{LieGroup, Se2},
    grid::{Cell, CellState, Grid, GridLayout},
};
use nalgebra::Vector2;

/// An occupancy map that rays and bodies meet cell by cell.
///
/// Each cell knows how many cells around it are free in every direction (its chessboard distance to the nearest
/// occupied cell), so that a ray leaps over open space and visits single cells near walls only. The range is the
/// analytic distance to the face of the first occupied cell.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Grid, GridLayout};
/// use agv_core::nalgebra::Vector2;
/// use agv_sim::{GridWorld, PlanarWorld};
///
/// let mut map = Grid::filled(GridLayout::new(100, 100, 0.05, Se2::default())?, CellState::Free);
/// map.set(Cell::new(80, 50), CellState::Occupied);
/// let world = GridWorld::new(&map);
/// let range = world.cast(&Vector2::new(1.0, 2.52), &Vector2::x(), 10.0).unwrap();
/// assert!((range - 3.0).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct GridWorld {
    layout: GridLayout,
    /// Chessboard distance to the nearest solid cell, in cells, at most 255; zero is solid.
    free_around: Vec<u8>,
}

impl GridWorld {
    /// A world in which occupied cells are solid, and unknown ones as open as free ones. O(cells).
    pub fn new(map: &Grid<CellState>) -> Self {
        Self::with_solid(map, |state| state == CellState::Occupied)
    }

    /// A world in which unknown cells are solid too: a vehicle in it cannot leave what the map has seen. O(cells).
    pub fn with_unknown_solid(map: &Grid<CellState>) -> Self {
        Self::with_solid(map, |state| state != CellState::Free)
    }

    fn with_solid(map: &Grid<CellState>, is_solid: impl Fn(CellState) -> bool) -> Self {
        let layout = *map.layout();
        let mut free_around: Vec<u8> = map.values().iter().map(|&s| if is_solid(s) { 0 } else { u8::MAX }).collect();
        chessboard_distance(&mut free_around, layout.width());
        Self { layout, free_around }
    }

    /// Size, resolution and pose of the map.
    pub const fn layout(&self) -> &GridLayout {
        &self.layout
    }

    /// Whether the cell is solid; none outside the map is.
    pub fn is_solid(&self, cell: Cell) -> bool {
        self.layout.index(cell).is_some_and(|index| self.free_around[index] == 0)
    }
}

/// Distances in place: zero where the cell is solid, the greatest value elsewhere. Two passes, each over half of the
/// neighbours, are exact for this metric (Rosenfeld and Pfaltz 1968).
fn chessboard_distance(cells: &mut [u8], width: usize) {
    let height = cells.len() / width;
    for backwards in [false, true] {
        for step in 0..cells.len() {
            // Running backwards, the visited neighbours mirror those of the forward pass.
            let index = if backwards { cells.len() - 1 - step } else { step };
            let (x, y) = (index % width, index / width);
            let (first_column, last_column) = (x == 0, x == width - 1);
            let mut nearest = u8::MAX;
            let mut visit = |neighbour: usize| nearest = nearest.min(cells[neighbour]);
            if backwards {
                if !last_column {
                    visit(index + 1);
                }
                if y + 1 < height {
                    visit(index + width);
                    if !first_column {
                        visit(index + width - 1);
                    }
                    if !last_column {
                        visit(index + width + 1);
                    }
                }
            } else {
                if !first_column {
                    visit(index - 1);
                }
                if y > 0 {
                    visit(index - width);
                    if !first_column {
                        visit(index - width - 1);
                    }
                    if !last_column {
                        visit(index - width + 1);
                    }
                }
            }
            cells[index] = cells[index].min(nearest.saturating_add(1));
        }
    }
}

/// One axis of a ray through the grid, in cells.
struct Axis {
    position: f64,
    direction: f64,
    reciprocal: f64,
    size: i32,
}

impl Axis {
    fn new(position: f64, direction: f64, size: usize) -> Self {
        Self { position, direction, reciprocal: 1.0 / direction, size: size as i32 }
    }

    /// Distances at which the ray enters and leaves `[0, size]`; all of the line if it runs inside and parallel.
    fn span(&self) -> (f64, f64) {
        if self.direction == 0.0 {
            let inside = self.position >= 0.0 && self.position < f64::from(self.size);
            return if inside { (f64::NEG_INFINITY, f64::INFINITY) } else { (f64::INFINITY, f64::NEG_INFINITY) };
        }
        let (a, b) = (-self.position * self.reciprocal, (f64::from(self.size) - self.position) * self.reciprocal);
        (a.min(b), a.max(b))
    }

    /// Column or row at distance `t`, kept in `[low, high]` against rounding.
    #[inline]
    fn cell_at(&self, t: f64, low: i32, high: i32) -> i32 {
        ((self.position + t * self.direction).floor() as i32).clamp(low, high)
    }

    /// Where the ray leaves a block that reaches `free - 1` cells to either side of `cell`.
    #[inline]
    fn exit(&self, cell: i32, free: i32) -> f64 {
        if self.direction == 0.0 {
            return f64::INFINITY;
        }
        let face = if self.direction > 0.0 { cell + free } else { cell - free + 1 };
        (f64::from(face) - self.position) * self.reciprocal
    }

    /// The first cell beyond that block.
    #[inline]
    fn beyond(&self, cell: i32, free: i32) -> i32 {
        if self.direction > 0.0 { cell + free } else { cell - free }
    }
}

impl PlanarWorld for GridWorld {
    #[inline]
    fn cast(&self, origin: &Vector2<f64>, direction: &Vector2<f64>, max_range: f64) -> Option<f64> {
        let start = self.layout.to_grid(origin);
        let way = self.layout.map_from_grid().rotation().inverse().act(direction);
        let (x, y) = (Axis::new(start.x, way.x, self.layout.width()), Axis::new(start.y, way.y, self.layout.height()));
        let limit = max_range / self.layout.resolution();
        let (span_x, span_y) = (x.span(), y.span());
        let mut t = span_x.0.max(span_y.0).max(0.0);
        // Negated, so that NaN ends here too: then the cells below are of this world.
        if !(t <= span_x.1.min(span_y.1) && t <= limit && (start + way).iter().all(|v| v.is_finite())) {
            return None;
        }
        let (mut column, mut row) = (x.cell_at(t, 0, x.size - 1), y.cell_at(t, 0, y.size - 1));
        loop {
            let free = i32::from(*self.free_around.get(self.layout.index(Cell::new(column, row))?)?);
            if free == 0 {
                return Some(t * self.layout.resolution());
            }
            let (exit_x, exit_y) = (x.exit(column, free), y.exit(row, free));
            t = t.max(exit_x.min(exit_y));
            if t > limit {
                return None;
            }
            if exit_x < exit_y {
                row = y.cell_at(t, row - free + 1, row + free - 1);
                column = x.beyond(column, free);
            } else {
                column = x.cell_at(t, column - free + 1, column + free - 1);
                row = y.beyond(row, free);
            }
        }
    }

    fn clearance(&self, body: &Body, map_from_body: &Se2, limit: f64) -> f64 {
        let grid_from_body = self.layout.map_from_grid().inverse() * *map_from_body;
        let resolution = self.layout.resolution();
        if !grid_from_body.is_finite() {
            return limit;
        }
        let around = body.bounds(&grid_from_body);
        let reached = around.grown(limit.max(0.0));
        let range = |axis: usize, size: usize| {
            let low = (reached.min[axis] / resolution).floor().max(0.0) as i32;
            let high = (reached.max[axis] / resolution).floor().min(size as f64 - 1.0) as i32;
            low..=high
        };
        let reference = grid_from_body * body.reference_point();
        let mut best = limit;
        for row in range(1, self.layout.height()) {
            for column in range(0, self.layout.width()) {
                if !self.is_solid(Cell::new(column, row)) {
                    continue;
                }
                let min = Vector2::new(f64::from(column), f64::from(row)) * resolution;
                let max = min + Vector2::repeat(resolution);
                let square = Bounds { min: min.into(), max: max.into() };
                if square.gap_squared(&around) >= best * best {
                    continue;
                }
                let corners = [min, Vector2::new(max.x, min.y), max, Vector2::new(min.x, max.y)];
                let point = Bounds::around([reference.into()]);
                if square.gap_squared(&point) <= 0.0 {
                    return 0.0;
                }
                for (i, corner) in corners.iter().enumerate() {
                    best = best.min(body.distance_to_segment(&grid_from_body, corner, &corners[(i + 1) % 4]));
                }
                if best <= 0.0 {
                    return 0.0;
                }
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Shape, World2d};
    use proptest::prelude::*;

    fn map(solid: &[(i32, i32)], pose: Se2) -> Grid<CellState> {
        let mut map = Grid::filled(GridLayout::new(40, 30, 0.25, pose).unwrap(), CellState::Free);
        for &(x, y) in solid {
            map.set(Cell::new(x, y), CellState::Occupied);
        }
        map
    }

    /// The same world with every solid cell as an exact square.
    fn squares(map: &Grid<CellState>) -> World2d {
        let layout = map.layout();
        let solid = (0..layout.len()).map(|i| layout.cell(i)).filter(|c| map.get(*c) == Some(&CellState::Occupied));
        let square = |cell: Cell| {
            let center = layout.center(cell);
            let pose = Se2::from_parts(center, layout.map_from_grid().rotation());
            Shape::rectangle(pose, layout.resolution(), layout.resolution())
        };
        World2d::new(solid.map(square).collect()).unwrap()
    }

    proptest! {
        /// Leaping gives the ranges of exact squares, from inside and outside the map, in a rotated map too.
        #[test]
        fn ranges_agree_with_exact_squares(
            solid in prop::collection::vec((0_i32..40, 0_i32..30), 0..30),
            x in -3.0..12.0_f64, y in -3.0..9.0_f64, yaw in -3.1..3.1_f64, turn in -3.1..3.1_f64,
        ) {
            let map = map(&solid, Se2::new(0.3, -0.2, turn));
            let (origin, direction) = (Vector2::new(x, y), Vector2::new(yaw.cos(), yaw.sin()));
            let world = GridWorld::new(&map);
            let inside = map.layout().cell_at(&origin).is_some_and(|c| world.is_solid(c));
            let (found, exact) = (world.cast(&origin, &direction, 15.0), squares(&map).cast(&origin, &direction, 15.0));
            match (inside, found, exact) {
                (true, found, _) => prop_assert_eq!(found, Some(0.0)),
                (false, Some(a), Some(b)) => prop_assert!((a - b).abs() < 1e-9, "{} {}", a, b),
                (false, a, b) => prop_assert_eq!(a.is_some(), b.is_some()),
            }
        }

        #[test]
        fn clearance_agrees_with_exact_squares(
            solid in prop::collection::vec((0_i32..40, 0_i32..30), 1..20),
            x in 0.0..10.0_f64, y in 0.0..7.0_f64, yaw in -3.1..3.1_f64, turn in -3.1..3.1_f64,
        ) {
            let map = map(&solid, Se2::new(0.3, -0.2, turn));
            let (body, pose) = (Body::rectangle(0.9, 0.5).unwrap(), Se2::new(x, y, yaw));
            let (a, b) = (GridWorld::new(&map).clearance(&body, &pose, 2.0), squares(&map).clearance(&body, &pose, 2.0));
            prop_assert!((a - b).abs() < 1e-9, "{} {}", a, b);
        }
    }

    #[test]
    fn axis_parallel_rays_run_along_cell_faces() {
        let world = GridWorld::new(&map(&[(20, 10)], Se2::default()));
        for y in [2.5, 2.6, 2.7499] {
            assert_eq!(world.cast(&Vector2::new(1.0, y), &Vector2::x(), 20.0), Some(4.0), "{y}");
        }
        assert_eq!(world.cast(&Vector2::new(1.0, 2.75), &Vector2::x(), 20.0), None);
        assert_eq!(world.cast(&Vector2::new(5.1, -1.0), &Vector2::y(), 20.0), Some(3.5));
    }

    #[test]
    fn unknown_cells_are_solid_on_demand() {
        let mut map = map(&[], Se2::default());
        map.set(Cell::new(20, 10), CellState::Unknown);
        let (origin, east) = (Vector2::new(1.0, 2.6), Vector2::x());
        assert_eq!(GridWorld::new(&map).cast(&origin, &east, 20.0), None);
        assert_eq!(GridWorld::with_unknown_solid(&map).cast(&origin, &east, 20.0), Some(4.0));
    }

    #[test]
    fn rays_that_are_none_hit_nothing() {
        let world = GridWorld::new(&map(&[(20, 10)], Se2::default()));
        let (inside, nan) = (Vector2::new(1.0, 2.6), Vector2::new(f64::NAN, 0.0));
        assert_eq!(world.cast(&nan, &Vector2::x(), 10.0), None);
        assert_eq!(world.cast(&inside, &nan, 10.0), None);
        assert_eq!(world.cast(&inside, &Vector2::x(), f64::NAN), None);
        assert_eq!(world.cast(&inside, &Vector2::zeros(), 10.0), None);
        assert_eq!(world.cast(&Vector2::new(1e300, 0.0), &Vector2::x(), f64::INFINITY), None);
    }
}
