//! The cell nearest to a point among those that will do.

use super::{Cell, GridLayout};
use nalgebra::Vector2;

impl GridLayout {
    /// The cell whose centre lies nearest to the map point, among those within `reach` metres that `accept` takes; of equal
    /// ones the first in storage order. None for a point or a reach that is not a number.
    ///
    /// Rings of cells around the point are looked through from the inside out: time grows with the square of the distance
    /// that is found, or of the reach where there is nothing.
    pub fn nearest_cell(&self, point: &Vector2<f64>, reach: f64, mut accept: impl FnMut(Cell) -> bool) -> Option<Cell> {
        let at = self.to_grid(point);
        let limit = reach / self.resolution();
        if !(at.x.is_finite() && at.y.is_finite() && limit >= 0.0) {
            return None;
        }
        // The point of the grid that is nearest: no cell is nearer to the point than to it.
        let (columns, rows) = (self.width() as i32, self.height() as i32);
        let inside = Vector2::new(at.x.clamp(0.0, f64::from(columns)), at.y.clamp(0.0, f64::from(rows)));
        let middle = Cell::new((inside.x as i32).min(columns - 1), (inside.y as i32).min(rows - 1));
        let outside = (at - inside).norm_squared();

        let mut best: Option<(f64, i32, i32)> = None;
        for ring in 0..columns.max(rows) {
            let least = outside + (f64::from(ring) - 0.5).max(0.0).powi(2);
            if least > limit * limit || best.is_some_and(|(squared, ..)| least > squared) {
                break;
            }
            let (left, right) = (middle.x - ring, middle.x + ring);
            for y in (middle.y - ring).max(0)..=(middle.y + ring).min(rows - 1) {
                // Whole rows at the bottom and the top of the ring, its two sides between them.
                let stride = if (y - middle.y).abs() == ring { 1 } else { (2 * ring).max(1) };
                for x in (left..=right).step_by(stride as usize).filter(|x| (0..columns).contains(x)) {
                    let offset = Vector2::new(f64::from(x) + 0.5, f64::from(y) + 0.5) - at;
                    let candidate = (offset.norm_squared(), y, x);
                    let nearer = best.is_none_or(|known| candidate < known);
                    if candidate.0 <= limit * limit && nearer && accept(Cell::new(x, y)) {
                        best = Some(candidate);
                    }
                }
            }
        }
        best.map(|(_, y, x)| Cell::new(x, y))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Se2;
    use proptest::prelude::*;

    proptest! {
        /// Against a look at every cell, for points inside and outside.
        #[test]
        fn rings_find_the_nearest_of_all_cells(
            flags in proptest::collection::vec(prop::bool::weighted(0.15), 77),
            (u, v) in (-6.0..17.0_f64, -6.0..13.0_f64),
            reach in prop_oneof![0.0..8.0_f64, Just(f64::INFINITY), Just(f64::MAX)],
        ) {
            let layout = GridLayout::new(11, 7, 0.5, Se2::new(1.0, 2.0, 0.3)).unwrap();
            let point = layout.to_map(&Vector2::new(u, v));
            let distance = |c: Cell| (layout.center(c) - point).norm();
            let accept = |c: Cell| layout.index(c).is_some_and(|i| flags[i]);
            let all = (0..77).map(|i| layout.cell(i)).filter(|&c| accept(c)).map(distance).fold(f64::INFINITY, f64::min);
            match layout.nearest_cell(&point, reach, accept) {
                Some(cell) => prop_assert!(accept(cell) && (distance(cell) - all).abs() < 1e-9 && all <= reach + 1e-9),
                None => prop_assert!(all > reach - 1e-9),
            }
        }
    }

    #[test]
    fn what_is_not_a_number_finds_nothing() {
        let layout = GridLayout::new(3, 3, 1.0, Se2::default()).unwrap();
        let find = |x, reach| layout.nearest_cell(&Vector2::new(x, 1.5), reach, |_| true);
        for (x, reach) in [(f64::NAN, 1.0), (f64::INFINITY, 1.0), (1.0, f64::NAN), (1.0, -1.0), (1e300, 1.0)] {
            assert_eq!(find(x, reach), None, "{x}, {reach}");
        }
        assert_eq!(find(1.5, 0.0), Some(Cell::new(1, 1)));
        assert_eq!(find(1e300, f64::INFINITY), Some(Cell::new(0, 0)), "all are equally far there");
    }
}
