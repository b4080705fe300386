//! One ray through the cells, as a fixed-point DDA.
//!
//! A ray runs column by column along its *major* axis, the one along which it goes farther, so that it crosses at most
//! two cells of a column. Its minor coordinate where it enters column `k` is `Y_1 + (k - 1) S` in units of 2^-32 cells: an
//! integer, so that `k` steps at once and `k` single steps end in the same bits. That is what makes skipping exact.

use crate::grid::Cell;
use nalgebra::Vector2;

/// Fractional bits of the minor coordinate.
const BITS: u32 = 32;
const ONE: f64 = (1_u64 << BITS) as f64;

/// Farthest start and longest ray, in cells: coordinates then fit 62 bits.
const FAR: f64 = (1_u64 << 28) as f64;

/// A ray in grid coordinates, quantised.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ray {
    /// Whether the major axis is x.
    pub(super) along_x: bool,
    /// Direction along the major axis, 1 or -1.
    pub(super) step: i64,
    /// Minor coordinate gained per column; at most one cell.
    pub(super) slope: i64,
    /// Column of the start.
    pub(super) column: i64,
    /// Minor coordinate of the start.
    pub(super) start: i64,
    /// Minor coordinate where the ray leaves the column of its start.
    pub(super) first: i64,
    /// Columns that the ray enters within its length, beyond that of its start.
    pub(super) columns: i64,
    /// Start along the minor axis, in cells.
    minor: f64,
    /// Direction along the minor axis.
    minor_direction: f64,
    /// Cells along the ray from the start to the end of its column, and per column.
    to_first: f64,
    per_column: f64,
    length: f64,
}

/// The whole number below, of a number below 2^62, without the call that older processors need.
#[inline]
fn floor(number: f64) -> i64 {
    let whole = number as i64;
    whole - i64::from(whole as f64 > number)
}

impl Ray {
    /// The ray from `origin` (in cells) along the unit vector `direction` for `length` cells; none for an origin that is
    /// absurdly far, a length below zero, or anything not a number.
    #[inline]
    pub(super) fn new(origin: Vector2<f64>, direction: Vector2<f64>, length: f64) -> Option<Self> {
        // Written so that NaN fails.
        let near = origin.x.abs() < FAR && origin.y.abs() < FAR && length >= 0.0;
        let unit = (0.5..2.0).contains(&(direction.x.abs() + direction.y.abs()));
        if !(near && unit) {
            return None;
        }
        let length = length.min(FAR);
        let along_x = direction.x.abs() >= direction.y.abs();
        let (major, minor, du, dv) = if along_x {
            (origin.x, origin.y, direction.x, direction.y)
        } else {
            (origin.y, origin.x, direction.y, direction.x)
        };
        let column = floor(major);
        // A ray backwards from a line has left its column at once.
        let to_edge = if du > 0.0 { column as f64 + 1.0 - major } else { major - column as f64 };
        let per_column = 1.0 / du.abs();
        let slope = dv * per_column;
        let to_first = to_edge * per_column;
        let start = floor(minor * ONE);
        Some(Self {
            along_x,
            step: if du > 0.0 { 1 } else { -1 },
            slope: (slope * ONE) as i64,
            column,
            start,
            first: start + (slope * to_edge * ONE) as i64,
            columns: ((length - to_first) * du.abs() + 1.0).max(0.0) as i64,
            minor,
            to_first,
            per_column,
            minor_direction: dv,
            length,
        })
    }

    /// Minor coordinate where the ray enters the `k`-th column after its first, `k >= 1`.
    #[inline]
    pub(super) const fn entry(&self, k: i64) -> i64 {
        self.first + (k - 1) * self.slope
    }

    /// Row of a minor coordinate.
    #[inline]
    pub(super) const fn row(minor: i64) -> i64 {
        minor >> BITS
    }

    /// Cell in the `k`-th column after the first.
    #[inline]
    pub(super) fn cell(&self, k: i64, row: i64) -> Cell {
        let column = (self.column + k * self.step) as i32;
        if self.along_x { Cell::new(column, row as i32) } else { Cell::new(row as i32, column) }
    }

    /// Cells along the ray to where it enters the first (or else the second) cell of the `k`-th column; none beyond
    /// its length.
    #[inline]
    pub(super) fn range(&self, k: i64, row: i64, second: bool) -> Option<f64> {
        let entry = if k == 0 { 0.0 } else { self.to_first + (k - 1) as f64 * self.per_column };
        let range = if second {
            // The line between the two cells; rounding may not move it out of the column.
            let line = if self.slope > 0 { row as f64 - self.minor } else { self.minor - (row + 1) as f64 };
            // Rays along a row have no second cells.
            let per_row = 1.0 / self.minor_direction.abs();
            (line * per_row).clamp(entry, self.to_first + k as f64 * self.per_column)
        } else {
            entry
        };
        (range <= self.length).then_some(range)
    }
}
