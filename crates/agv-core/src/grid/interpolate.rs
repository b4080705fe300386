//! Values between the centres of cells.
//!
//! With the four centres around a point, `u` and `v` being the point's shares of the way between them along the grid's
//! axes, bilinear interpolation is
//!
//! ```text
//! f = (1 - v) ((1 - u) f00 + u f10) + v ((1 - u) f01 + u f11)
//! ∂f/∂x = ((1 - v) (f10 - f00) + v (f11 - f01)) / e        e: edge of a cell
//! ```
//!
//! It is continuous, so that what follows a distance or likelihood field down its slope does not stall on steps.

use super::Grid;
use crate::geometry::LieGroup;
use nalgebra::Vector2;

/// Where a coordinate lies among the `count` centres of an axis.
struct Between {
    first: usize,
    second: usize,
    share: f64,
    /// One between centres; zero in the outer half cell, where the value does not change.
    slope: f64,
}

impl Between {
    #[inline]
    fn new(in_cells: f64, count: usize) -> Self {
        let last = (count - 1) as f64;
        let from_first_center = in_cells - 0.5;
        let place = from_first_center.clamp(0.0, last);
        let first = (place as usize).min(count.saturating_sub(2));
        let slope = if place == from_first_center { 1.0 } else { 0.0 };
        Self { first, second: (first + 1).min(count - 1), share: place - first as f64, slope }
    }

    #[inline]
    fn mix(&self, first: f64, second: f64) -> f64 {
        (1.0 - self.share) * first + self.share * second
    }
}

impl Grid<f32> {
    /// Bilinear value at a map point, and its gradient in the map frame, per metre. O(1).
    ///
    /// At a cell's centre it is the cell's value. In the outer half cell of the grid the value at the line of the last
    /// centres goes on. None outside the grid, for a point that is not finite, and where one of the four values is not
    /// finite (as the distance in a map without obstacles).
    ///
    /// ```
    /// use agv_core::geometry::Se2;
    /// use agv_core::grid::{Grid, GridLayout};
    /// use agv_core::nalgebra::Vector2;
    ///
    /// let ramp = Grid::new(GridLayout::new(3, 1, 0.5, Se2::default())?, vec![0.0, 2.0, 4.0])?;
    /// let (value, gradient) = ramp.interpolate(&Vector2::new(0.5, 0.25)).unwrap();
    /// assert_eq!((value, gradient), (1.0, Vector2::new(4.0, 0.0)));
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    #[inline]
    pub fn interpolate(&self, point: &Vector2<f64>) -> Option<(f32, Vector2<f32>)> {
        let layout = self.layout();
        let p = layout.to_grid(point);
        let (width, height) = (layout.width(), layout.height());
        // NaN fails all comparisons.
        if !(p.x >= 0.0 && p.y >= 0.0 && p.x < width as f64 && p.y < height as f64) {
            return None;
        }
        let (x, y) = (Between::new(p.x, width), Between::new(p.y, height));
        let at = |x: usize, y: usize| self.values().get(y * width + x).map(|&value| f64::from(value));
        let (f00, f10) = (at(x.first, y.first)?, at(x.second, y.first)?);
        let (f01, f11) = (at(x.first, y.second)?, at(x.second, y.second)?);
        let value = y.mix(x.mix(f00, f10), x.mix(f01, f11));
        let along = Vector2::new(x.slope * y.mix(f10 - f00, f11 - f01), y.slope * x.mix(f01 - f00, f11 - f10));
        let gradient = layout.map_from_grid().rotation().act(&(along / layout.resolution()));
        value.is_finite().then(|| (value as f32, gradient.cast()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        geometry::Se2,
        grid::{Cell, GridLayout},
    };
    use proptest::prelude::*;

    fn grid(width: usize, height: usize, yaw: f64, values: Vec<f32>) -> Grid<f32> {
        Grid::new(GridLayout::new(width, height, 0.05, Se2::new(1.0, -2.0, yaw)).unwrap(), values).unwrap()
    }

    proptest! {
        #[test]
        fn the_gradient_is_that_of_the_value_and_centres_are_exact(
            values in prop::collection::vec(-3.0..3.0_f32, 7 * 5), yaw in -3.2..3.2_f64,
            cell in (0..7_i32, 0..5_i32), inside in (0.02..0.48_f64, 0.02..0.48_f64), half in (0..2_u8, 0..2_u8),
        ) {
            let grid = grid(7, 5, yaw, values);
            let layout = *grid.layout();
            let (value, _) = grid.interpolate(&layout.center(Cell::new(cell.0, cell.1))).unwrap();
            prop_assert!((value - grid.get(Cell::new(cell.0, cell.1)).unwrap()).abs() < 1e-6);
            // Off the lines on which the gradient jumps, which are those of the centres.
            let place = |i: i32, half: u8, inside: f64| f64::from(i) + 0.5 * f64::from(half) + inside;
            let point = layout.to_map(&Vector2::new(place(cell.0, half.0, inside.0), place(cell.1, half.1, inside.1)));
            let (_, gradient) = grid.interpolate(&point).unwrap();
            for (axis, step) in [(0, Vector2::new(4e-4, 0.0)), (1, Vector2::new(0.0, 4e-4))] {
                let [after, before] = [point + step, point - step].map(|p| f64::from(grid.interpolate(&p).unwrap().0));
                // Two roundings to f32 over the step; the second derivative of a bilinear function along an axis of
                // the map is at most 12 / 0.05², but the central difference of a quadratic is exact.
                let difference = (after - before) / 8e-4;
                prop_assert!((difference - f64::from(gradient[axis])).abs() < 2e-3, "{difference} {gradient}");
            }
        }
    }

    #[test]
    fn the_outer_half_cell_goes_on_and_beyond_it_there_is_nothing() {
        let one = grid(1, 1, 0.4, vec![7.0]);
        let at = |x: f64, y: f64| one.interpolate(&one.layout().to_map(&Vector2::new(x, y)));
        assert_eq!(at(0.1, 0.9), Some((7.0, Vector2::zeros())));
        for (x, y) in [(-0.1, 0.5), (0.5, 1.1), (f64::NAN, 0.5), (0.5, f64::INFINITY)] {
            assert_eq!(at(x, y), None);
        }
        assert_eq!(grid(1, 1, 0.0, vec![f32::INFINITY]).interpolate(&Vector2::new(1.01, -1.99)), None);
    }
}
