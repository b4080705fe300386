//! The cells that a segment crosses, exactly and in order.
//!
//! Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing" (Eurographics 1987), decide by comparing two
//! rounded numbers which grid line comes next, and sometimes decide wrongly. Here the end points are rounded once, to a
//! lattice of 2⁻¹⁶ of a cell, and everything after that is integer arithmetic: the next line is told by the sign of
//!
//! ```text
//! e = (distance to the next x line) |dy| - (distance to the next y line) |dx|
//! ```
//!
//! which changes by 2¹⁶ |dy| or -2¹⁶ |dx| at each step and never leaves an `i64`.
//!
//! A segment visits the cell of its start, every cell whose interior it crosses, and the cell of its end, each once.
//! Cells are half-open, `[i, i+1) x [j, j+1)`, so a segment along a grid line visits the cells above or to the right of
//! it. Where it passes exactly through a corner it steps diagonally: the two cells it only touches are not visited. The
//! reversed segment visits the same cells in the opposite order.

use super::{Cell, GridLayout};
use crate::{Error, check};
use nalgebra::Vector2;

/// Bits of the lattice that end points are rounded to.
pub(crate) const LATTICE_BITS: u32 = 16;
/// Lattice steps per cell.
pub(crate) const LATTICE: i64 = 1 << LATTICE_BITS;

/// Rounds a coordinate in cells to the lattice; the coordinate must be below 2³⁵ cells.
#[inline]
pub(crate) fn to_lattice(in_cells: f64) -> i64 {
    // Adding and subtracting 1.5 * 2^52 rounds to the nearest integer, without a library call.
    const MAGIC: f64 = 6_755_399_441_055_744.0;
    ((in_cells * LATTICE as f64 + MAGIC) - MAGIC) as i64
}

/// One coordinate of a segment, mirrored so that it grows.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Axis {
    /// Cell of the start.
    pub(crate) cell: i64,
    /// Direction, 1 or -1.
    pub(crate) step: i64,
    /// Grid lines that are crossed.
    pub(crate) lines: i64,
    /// Way from the cell's near line to the start, in `[0, 2¹⁶)`, or in `(0, 2¹⁶]` if mirrored.
    pub(crate) offset: i64,
    /// Length of the segment along this axis, in lattice steps.
    pub(crate) length: i64,
}

impl Axis {
    #[inline]
    pub(crate) const fn new(from: i64, to: i64) -> Self {
        let cell = from >> LATTICE_BITS;
        let fraction = from & (LATTICE - 1);
        let lines = ((to >> LATTICE_BITS) - cell).abs();
        // A start on a line belongs to the cell above it: downwards, that whole cell lies ahead already crossed.
        let (step, offset) = if to < from { (-1, LATTICE - fraction) } else { (1, fraction) };
        Self { cell, step, lines, offset, length: (to - from).abs() }
    }

    /// Lines of this axis crossed at or before the other axis' line `line`.
    fn lines_crossed_at(&self, other: &Self, line: i64) -> i64 {
        let time = i128::from(line) * i128::from(LATTICE) - i128::from(other.offset);
        let way = i128::from(self.offset) * i128::from(other.length) + time * i128::from(self.length);
        let crossed = way.div_euclid(i128::from(other.length) * i128::from(LATTICE));
        (crossed as i64).min(self.lines)
    }
}

/// Iterator over the cells that a segment visits, from its start to its end.
///
/// Stopping early is a `break`, `find` or `try_for_each`. Each step takes constant time; nothing is allocated.
///
/// ```
/// use agv_core::grid::{Cell, Traversal};
/// use agv_core::nalgebra::Vector2;
///
/// let (from, to) = (Vector2::new(0.5, 0.5), Vector2::new(2.5, 1.5));
/// let cells: Vec<Cell> = Traversal::new(&from, &to)?.collect();
/// // Through the corner (1.5, 1) it passes from column 1 in row 0 to row 1.
/// assert_eq!(cells, [Cell::new(0, 0), Cell::new(1, 0), Cell::new(1, 1), Cell::new(2, 1)]);
///
/// let diagonal = Traversal::new(&Vector2::new(0.5, 0.5), &Vector2::new(1.5, 1.5))?;
/// assert_eq!(diagonal.collect::<Vec<_>>(), [Cell::new(0, 0), Cell::new(1, 1)]);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Traversal {
    cell: Cell,
    step: Cell,
    /// Lines still to cross, along x and y.
    left: (i64, i64),
    /// Steps that may still be taken before the clipping rectangle is left, along x and y.
    room: (i64, i64),
    /// Negative: the next line is one of x; positive: one of y; zero: a corner.
    error: i64,
    /// What the error gains by a step along x and loses by a step along y.
    gain: (i64, i64),
    done: bool,
}

impl Traversal {
    /// Greatest coordinate of an end point, in cells.
    pub const MAX_COORDINATE: f64 = (1_i64 << 29) as f64;

    /// The traversal of the segment between two points counted in cells (see [`GridLayout::to_grid`]).
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a coordinate that is NaN, infinite or beyond
    /// [`MAX_COORDINATE`](Self::MAX_COORDINATE).
    pub fn new(from: &Vector2<f64>, to: &Vector2<f64>) -> Result<Self, Error> {
        let (x, y) = Self::axes(from, to)?;
        Ok(Self::from_axes(&x, &y))
    }

    /// The part of a traversal that lies in a grid of `width` by `height` cells: the very cells that
    /// [`new`](Self::new) gives, without those outside. Empty if the segment misses the grid.
    ///
    /// Constant time whatever the length of the part outside.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn clipped(from: &Vector2<f64>, to: &Vector2<f64>, layout: &GridLayout) -> Result<Self, Error> {
        let (x, y) = Self::axes(from, to)?;
        Ok(Self::clipped_axes(&x, &y, layout.width() as i64, layout.height() as i64))
    }

    fn axes(from: &Vector2<f64>, to: &Vector2<f64>) -> Result<(Axis, Axis), Error> {
        for point in [from, to] {
            check::in_range("segment x (cells)", point.x, -Self::MAX_COORDINATE, Self::MAX_COORDINATE)?;
            check::in_range("segment y (cells)", point.y, -Self::MAX_COORDINATE, Self::MAX_COORDINATE)?;
        }
        let axis = |a: f64, b: f64| Axis::new(to_lattice(a), to_lattice(b));
        Ok((axis(from.x, to.x), axis(from.y, to.y)))
    }

    pub(crate) fn from_axes(x: &Axis, y: &Axis) -> Self {
        // |e| <= 2^16 max(|dx|, |dy|) <= 2^16 2^46, as at each step the line that comes next is less than a cell away.
        Self {
            cell: Cell::new(x.cell as i32, y.cell as i32),
            step: Cell::new(x.step as i32, y.step as i32),
            left: (x.lines, y.lines),
            room: (x.lines, y.lines),
            error: (LATTICE - x.offset) * y.length - (LATTICE - y.offset) * x.length,
            gain: (LATTICE * y.length, LATTICE * x.length),
            done: false,
        }
    }

    pub(crate) fn clipped_axes(x: &Axis, y: &Axis, width: i64, height: i64) -> Self {
        let mut clipped = Self::from_axes(x, y);
        // First and last admissible step count along an axis, seen from the start.
        let bounds = |axis: &Axis, size: i64| {
            let (near, far) = if axis.step > 0 { (0, size - 1) } else { (size - 1, 0) };
            ((near - axis.cell) * axis.step, (far - axis.cell) * axis.step)
        };
        let ((enter_x, leave_x), (enter_y, leave_y)) = (bounds(x, width), bounds(y, height));
        clipped.done = enter_x > x.lines || enter_y > y.lines || leave_x < 0 || leave_y < 0;
        if clipped.done {
            return clipped;
        }
        // The state right after the line by which the segment enters; the later one counts if it must cross two.
        let by_x = (enter_x > 0).then(|| (enter_x, y.lines_crossed_at(x, enter_x)));
        let by_y = (enter_y > 0).then(|| (x.lines_crossed_at(y, enter_y), enter_y));
        let (i, j) = match (by_x, by_y) {
            (None, None) => (0, 0),
            (Some(state), None) | (None, Some(state)) => state,
            (Some(a), Some(b)) => (a.0.max(b.0), a.1.max(b.1)),
        };
        clipped.done = i > leave_x || j > leave_y;
        if !clipped.done {
            clipped.advance(x, y, i, j);
            clipped.room = ((x.lines.min(leave_x)) - i, (y.lines.min(leave_y)) - j);
        }
        clipped
    }

    /// Moves the fresh traversal to the state after `i` lines of x and `j` of y.
    fn advance(&mut self, x: &Axis, y: &Axis, i: i64, j: i64) {
        self.cell = Cell::new((x.cell + x.step * i) as i32, (y.cell + y.step * j) as i32);
        self.left = (x.lines - i, y.lines - j);
        // The difference of large products is small where both kinds of line are still ahead, and unused elsewhere.
        let error =
            i128::from(self.error) + i128::from(i) * i128::from(self.gain.0) - i128::from(j) * i128::from(self.gain.1);
        self.error = error as i64;
    }
}

impl Iterator for Traversal {
    type Item = Cell;

    #[inline]
    fn next(&mut self) -> Option<Cell> {
        if self.done {
            return None;
        }
        let current = self.cell;
        let (along_x, along_y) = match self.left {
            (0, 0) => {
                self.done = true;
                return Some(current);
            }
            (0, _) => (false, true),
            (_, 0) => (true, false),
            _ => (self.error <= 0, self.error >= 0),
        };
        if along_x {
            self.cell.x += self.step.x;
            self.left.0 -= 1;
            self.room.0 -= 1;
            self.error = self.error.wrapping_add(self.gain.0);
        }
        if along_y {
            self.cell.y += self.step.y;
            self.left.1 -= 1;
            self.room.1 -= 1;
            self.error = self.error.wrapping_sub(self.gain.1);
        }
        self.done = self.room.0 < 0 || self.room.1 < 0;
        Some(current)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        if self.done { (0, Some(0)) } else { (1, Some((self.room.0 + self.room.1) as usize + 1)) }
    }
}

impl std::iter::FusedIterator for Traversal {}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const UNIT: i64 = 1024;

    /// Rational reference on a lattice of 1/1024: sorts all crossings by their exact time.
    fn reference(from: (i64, i64), to: (i64, i64)) -> Vec<Cell> {
        // Every crossing as (numerator, denominator, dx, dy); times are non-negative fractions.
        let mut events: Vec<(i128, i128, i32, i32)> = Vec::new();
        for axis in 0..2 {
            let (a, b) = if axis == 0 { (from.0, to.0) } else { (from.1, to.1) };
            let (low, high) = (a.div_euclid(UNIT).min(b.div_euclid(UNIT)), a.div_euclid(UNIT).max(b.div_euclid(UNIT)));
            let sign = (b - a).signum() as i32;
            for line in low + 1..=high {
                let time = i128::from((line * UNIT - a).abs());
                let (dx, dy) = if axis == 0 { (sign, 0) } else { (0, sign) };
                events.push((time, i128::from((b - a).abs()), dx, dy));
            }
        }
        events.sort_by(|p, q| (p.0 * q.1).cmp(&(q.0 * p.1)));
        let mut cell = Cell::new(from.0.div_euclid(UNIT) as i32, from.1.div_euclid(UNIT) as i32);
        let mut cells = vec![cell];
        let mut rest = events.as_slice();
        while let Some(&first) = rest.first() {
            let together = rest.iter().take_while(|e| e.0 * first.1 == first.0 * e.1).count();
            for event in &rest[..together] {
                cell = Cell::new(cell.x + event.2, cell.y + event.3);
            }
            cells.push(cell);
            rest = &rest[together..];
        }
        cells
    }

    fn point(lattice: (i64, i64)) -> Vector2<f64> {
        Vector2::new(lattice.0 as f64 / UNIT as f64, lattice.1 as f64 / UNIT as f64)
    }

    /// Coordinates that often lie on grid lines, so that corners and lines are met.
    fn coordinate() -> impl Strategy<Value = i64> {
        prop_oneof![(-12_i64..24).prop_map(|c| c * UNIT), (-24_i64..48).prop_map(|c| c * UNIT / 2), -12_000_i64..24_000]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn agrees_with_rational_arithmetic(from in (coordinate(), coordinate()), to in (coordinate(), coordinate())) {
            let cells: Vec<Cell> = Traversal::new(&point(from), &point(to)).unwrap().collect();
            prop_assert_eq!(&cells, &reference(from, to));
            let mut back: Vec<Cell> = Traversal::new(&point(to), &point(from)).unwrap().collect();
            back.reverse();
            prop_assert_eq!(cells, back, "the reversed segment visits the same cells");
        }

        #[test]
        fn clipping_keeps_exactly_the_cells_inside(
            from in (coordinate(), coordinate()), to in (coordinate(), coordinate()),
            width in 1_usize..14, height in 1_usize..14,
        ) {
            let layout = GridLayout::new(width, height, 1.0, crate::geometry::Se2::default()).unwrap();
            let inside: Vec<Cell> = reference(from, to).into_iter().filter(|&c| layout.contains(c)).collect();
            let clipped: Vec<Cell> = Traversal::clipped(&point(from), &point(to), &layout).unwrap().collect();
            prop_assert_eq!(clipped, inside);
        }

        /// Far from the grid the integers are largest: compare with the same segment near the origin.
        #[test]
        fn long_segments_neither_overflow_nor_lose_cells(y in -400_000_000.0..400_000_000.0_f64, x in 0.0..8.0_f64) {
            let layout = GridLayout::new(8, 8, 1.0, crate::geometry::Se2::default()).unwrap();
            let (from, to) = (Vector2::new(-5e8, -y), Vector2::new(5e8 + x, y + 8.0 * x));
            for cell in Traversal::clipped(&from, &to, &layout).unwrap() {
                prop_assert!(layout.contains(cell));
                // The line passes within a cell's diagonal of the centre.
                let (d, to_center) = (to - from, Vector2::new(f64::from(cell.x) + 0.5, f64::from(cell.y) + 0.5) - from);
                prop_assert!((d.x * to_center.y - d.y * to_center.x).abs() / d.norm() < 0.7072);
            }
        }
    }

    #[test]
    fn a_point_visits_its_cell() {
        let p = Vector2::new(2.0, -0.25);
        assert_eq!(Traversal::new(&p, &p).unwrap().collect::<Vec<_>>(), [Cell::new(2, -1)]);
    }

    #[test]
    fn end_points_that_cannot_be_counted_are_refused() {
        let good = Vector2::new(1.0, 1.0);
        let layout = GridLayout::new(4, 4, 1.0, crate::geometry::Se2::default()).unwrap();
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e9, -1e300] {
            for p in [Vector2::new(bad, 0.0), Vector2::new(0.0, bad)] {
                assert!(matches!(Traversal::new(&p, &good), Err(Error::OutOfRange { .. })));
                assert!(matches!(Traversal::clipped(&good, &p, &layout), Err(Error::OutOfRange { .. })));
            }
        }
    }
}
