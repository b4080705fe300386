//! Whether a vehicle can drive straight from one point to another.

use crate::Error;
use agv_core::{
    check,
    grid::{Costmap, cost},
};
use nalgebra::Vector2;

/// What counts as blocked on a straight line: parameters of a [`LineOfSight`], and of [`KeyNodes`](super::KeyNodes) and
/// [`TautString`](super::TautString), whose lines it decides on.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LineOfSightParams {
    /// Room that a line must have on both sides, in metres: the vehicle's radius where the costmap is not inflated, zero
    /// where it is.
    pub margin: f64,
    /// Greatest cost of a cell that a line may cross, in the scale of [`cost`]; less keeps lines away from obstacles.
    pub max_cost: u8,
    /// Whether lines may cross unknown cells.
    pub cross_unknown: bool,
}

impl Default for LineOfSightParams {
    /// For an inflated costmap: no margin of its own, any cell that may be entered, no unknown ones.
    fn default() -> Self {
        Self { margin: 0.0, max_cost: cost::MAX_NON_OBSTACLE, cross_unknown: false }
    }
}

/// Says which straight lines are free.
///
/// The line is widened to a strip: every cell that comes within the margin of it along either axis must be enterable, which
/// covers the disc of that radius wherever it stands on the line (a square holds its disc). With a margin of zero these
/// are the cells that the line touches, corners and edges included: conservative, never a cell too few.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Costmap, Grid, GridLayout};
/// use agv_core::nalgebra::Vector2;
/// use agv_plan::smooth::LineOfSight;
///
/// let mut map = Grid::filled(GridLayout::new(10, 10, 1.0, Se2::default())?, CellState::Free);
/// map.set(Cell::new(5, 5), CellState::Occupied);
/// let costmap = Costmap::from_map(&map);
/// let sight = LineOfSight::default();
/// assert!(sight.is_clear(&costmap, &Vector2::new(0.5, 0.5), &Vector2::new(9.5, 3.5)));
/// assert!(!sight.is_clear(&costmap, &Vector2::new(0.5, 0.5), &Vector2::new(9.5, 9.5)));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "LineOfSightParams", into = "LineOfSightParams")
)]
pub struct LineOfSight {
    params: LineOfSightParams,
}

impl TryFrom<LineOfSightParams> for LineOfSight {
    type Error = Error;

    fn try_from(params: LineOfSightParams) -> Result<Self, Error> {
        Self::new(params)
    }
}

impl From<LineOfSight> for LineOfSightParams {
    fn from(sight: LineOfSight) -> Self {
        sight.params
    }
}

impl LineOfSight {
    /// Rounding of coordinates, in cells: what comes as near as this counts as touched.
    const ROUNDING: f64 = 1e-9;

    /// Checks the parameters.
    ///
    /// # Errors
    /// A margin that is not finite or negative; a `max_cost` that would let lines through obstacles.
    pub fn new(params: LineOfSightParams) -> Result<Self, Error> {
        check::non_negative("margin", params.margin)?;
        let greatest = f64::from(cost::MAX_NON_OBSTACLE);
        check::in_range("max_cost", f64::from(params.max_cost), 0.0, greatest)?;
        Ok(Self { params })
    }

    /// What counts as blocked.
    pub const fn params(&self) -> &LineOfSightParams {
        &self.params
    }

    /// Whether the strip from `a` to `b`, in map coordinates, is free. What lies outside the map is not free, nor is a
    /// point that is not finite. Time is in proportion to the cells of the strip.
    pub fn is_clear(&self, costmap: &Costmap, a: &Vector2<f64>, b: &Vector2<f64>) -> bool {
        let layout = costmap.layout();
        let (a, b) = (layout.to_grid(a), layout.to_grid(b));
        let margin = self.params.margin / layout.resolution() + Self::ROUNDING * (1.0 + a.amax().max(b.amax()));
        let (low, high) = (a.inf(&b).add_scalar(-margin), a.sup(&b).add_scalar(margin));
        // `inf` and `sup` would drop a NaN; the map's edge may be passed by no more than rounding.
        let finite = a.iter().chain(&b).all(|v| v.is_finite());
        if !(finite && nearly_inside(costmap, &low, &high)) {
            return false;
        }
        let d = b - a;
        let last = |len: usize| len as f64 - 1.0;
        let row_of = |y: f64| y.floor().clamp(0.0, last(layout.height())) as usize;
        let column_of = |x: f64| x.floor().clamp(0.0, last(layout.width())) as usize;
        for y in row_of(low.y)..=row_of(high.y) {
            // Part of the segment that comes within the margin of this row of cells.
            let (bottom, top) = (y as f64 - margin, y as f64 + 1.0 + margin);
            let (from, to) = if d.y.abs() > Self::ROUNDING {
                let (s, t) = ((bottom - a.y) / d.y, (top - a.y) / d.y);
                (s.min(t).clamp(0.0, 1.0), s.max(t).clamp(0.0, 1.0))
            } else {
                (0.0, 1.0)
            };
            let (x0, x1) = (a.x + d.x * from, a.x + d.x * to);
            let columns = column_of(x0.min(x1) - margin)..=column_of(x0.max(x1) + margin);
            let row = y * layout.width();
            let cells = costmap.costs().get(row + columns.start()..=row + columns.end());
            if !cells.is_some_and(|cells| cells.iter().all(|&c| self.may_cross(c))) {
                return false;
            }
        }
        true
    }

    pub(super) fn may_cross(self, value: u8) -> bool {
        if value == cost::UNKNOWN { self.params.cross_unknown } else { value <= self.params.max_cost }
    }
}

/// Whether a box, in cells, leaves the map by no more than rounding.
fn nearly_inside(costmap: &Costmap, low: &Vector2<f64>, high: &Vector2<f64>) -> bool {
    let (width, height) = (costmap.layout().width() as f64, costmap.layout().height() as f64);
    let slack = 4.0 * LineOfSight::ROUNDING * (1.0 + width.max(height));
    low.x >= -slack && low.y >= -slack && high.x <= width + slack && high.y <= height + slack
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{
        geometry::Se2,
        grid::{Cell, CellState, Grid, GridLayout},
    };
    use proptest::prelude::*;

    fn sight(margin: f64) -> LineOfSight {
        LineOfSight::new(LineOfSightParams { margin, ..Default::default() }).unwrap()
    }

    proptest! {
        /// A clear line keeps its distance from every blocked cell, and a line that keeps the square's distance is clear.
        #[test]
        fn clear_lines_keep_their_distance(
            blocked in proptest::collection::vec((0..16, 0..12), 0..12),
            ends in ((0.5..15.5_f64, 0.5..11.5_f64), (0.5..15.5_f64, 0.5..11.5_f64)),
            margin in prop_oneof![Just(0.0), 0.0..0.49_f64],
        ) {
            let layout = GridLayout::new(16, 12, 0.25, Se2::new(3.0, -1.0, 0.4)).unwrap();
            let mut map = Grid::filled(layout, CellState::Free);
            for (x, y) in &blocked {
                map.set(Cell::new(*x, *y), CellState::Occupied);
            }
            let (a, b) = (Vector2::new(ends.0.0, ends.0.1), Vector2::new(ends.1.0, ends.1.1));
            let costmap = Costmap::from_map(&map);
            let clear = sight(margin * 0.25).is_clear(&costmap, &layout.to_map(&a), &layout.to_map(&b));
            // Least distance of the sampled line to a blocked square, in the largest coordinate and in a straight line.
            let (mut box_distance, mut distance) = (f64::INFINITY, f64::INFINITY);
            for (x, y) in &blocked {
                for k in 0..=2000 {
                    let p = a + (b - a) * (f64::from(k) / 2000.0);
                    let away = |v: f64, cell: i32| (f64::from(cell) - v).max(v - f64::from(cell) - 1.0).max(0.0);
                    let (dx, dy) = (away(p.x, *x), away(p.y, *y));
                    box_distance = box_distance.min(dx.max(dy));
                    distance = distance.min(dx.hypot(dy));
                }
            }
            if clear {
                prop_assert!(distance >= margin - 1e-6 && box_distance > 0.0);
            } else {
                // The samples lie 0.01 cells apart.
                prop_assert!(box_distance <= margin + 0.011);
            }
        }
    }

    #[test]
    fn what_is_outside_or_not_finite_is_not_clear() {
        let layout = GridLayout::new(4, 4, 1.0, Se2::default()).unwrap();
        let costmap = Costmap::from_map(&Grid::filled(layout, CellState::Free));
        let inside = Vector2::new(2.0, 2.0);
        for (x, y) in [(-0.1, 1.0), (4.1, 1.0), (f64::NAN, 1.0), (1.0, f64::INFINITY), (1e300, -1e300)] {
            assert!(!sight(0.0).is_clear(&costmap, &inside, &Vector2::new(x, y)), "({x}, {y})");
            assert!(!sight(0.0).is_clear(&costmap, &Vector2::new(x, y), &inside), "({x}, {y})");
        }
        assert!(sight(0.0).is_clear(&costmap, &inside, &inside));
        assert!(sight(0.0).is_clear(&costmap, &Vector2::zeros(), &Vector2::new(4.0, 4.0)));
        assert!(!sight(0.5).is_clear(&costmap, &Vector2::new(0.4, 2.0), &inside));
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = LineOfSightParams::default();
        for (name, params) in [
            ("margin", LineOfSightParams { margin: -0.1, ..good }),
            ("margin", LineOfSightParams { margin: f64::NAN, ..good }),
            ("margin", LineOfSightParams { margin: f64::INFINITY, ..good }),
            ("max_cost", LineOfSightParams { max_cost: cost::INSCRIBED, ..good }),
        ] {
            assert!(LineOfSight::new(params).unwrap_err().to_string().starts_with(name), "{name}");
        }
    }
}
