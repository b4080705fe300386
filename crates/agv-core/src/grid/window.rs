//! Windows that follow a vehicle: values are moved by whole cells, in place.

use std::ops::Range;

/// By how many cells a window moves over the lattice that its cells lie on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shift {
    /// To the right, towards greater x.
    pub(super) right: i64,
    /// Upwards, towards greater y.
    pub(super) up: i64,
}

impl Shift {
    /// The shift that brings the cell `middle` of the window, counted from its lower-left, to its middle.
    pub(super) const fn to_center(middle: (i64, i64), width: usize, height: usize) -> Self {
        Self { right: middle.0 - (width / 2) as i64, up: middle.1 - (height / 2) as i64 }
    }

    pub(super) fn is_none(self) -> bool {
        (self.right, self.up) == (0, 0)
    }

    /// Rows and columns that the window did not hold before; if both windows have no cell in common, all rows.
    pub(super) const fn new_cells(self, width: usize, height: usize) -> (Range<usize>, Range<usize>) {
        let (columns, rows) = (self.right.unsigned_abs() as usize, self.up.unsigned_abs() as usize);
        if columns >= width || rows >= height {
            return (0..height, 0..0);
        }
        let rows = if self.up > 0 { height - rows..height } else { 0..rows };
        let columns = if self.right > 0 { width - columns..width } else { 0..columns };
        (rows, columns)
    }

    /// Moves values that are stored row by row; what is new becomes `fill`. Linear in the cells.
    pub(super) fn apply<T: Copy>(self, values: &mut [T], width: usize, fill: T) {
        let height = values.len() / width;
        let (rows, columns) = self.new_cells(width, height);
        if rows != (0..height) {
            // One move of the whole block; what it wraps around the ends of rows is new, and filled.
            let distance = self.up * width as i64 + self.right;
            let shift = distance.unsigned_abs() as usize;
            if distance > 0 {
                values.copy_within(shift.., 0);
            } else {
                values.copy_within(..values.len() - shift, shift);
            }
            for row in values.chunks_exact_mut(width) {
                row[columns.clone()].fill(fill);
            }
        }
        values[rows.start * width..rows.end * width].fill(fill);
    }
}
