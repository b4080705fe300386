//! Updates the cells that a beam crosses before its end: the traversal of [`Traversal`], as fast as memory allows.
//!
//! Along the axis of the longer extent ("major") a beam enters one column after the other, and within a column it
//! visits one cell or, where it crosses a line of the minor axis, two. So a loop over columns has no branch to
//! mispredict: it updates the cell of entry, and then the cell of exit with a weight that is masked to zero if they
//! are the same. The minor coordinate at the k-th column line is
//!
//! ```text
//! Y_k = Y_1 + (k - 1) |d_minor| / |d_major|
//! ```
//!
//! in fixed point with 64 fractional bits, so that the carry of an addition is the crossing. It is exact all the same:
//! slope and `Y_1` are rounded up, hence the error stays in `[0, columns + 2)` units of 2⁻⁶⁴, while `Y_k` is a multiple
//! of `1 / (2¹⁶ |d_major|)`, which is at least 2¹⁸ units for beams below 2¹⁴ cells. So the floor is always right, and
//! `Y_k` is an integer (the beam meets a corner) if and only if the fraction is below `columns + 2`.
//!
//! Most beams meet no corner, and need not look for one: with the start `o` within its cell a corner `(k, j)` on the
//! line means `2¹⁶ (k d_minor - j d_major) = o_major d_minor - o_minor d_major`, which 65535 of 65536 beams refute by
//! the low bits of the right side. Beams that are longer, exactly diagonal, or leave the grid go to [`Traversal`].

use super::traversal::{Axis, LATTICE, LATTICE_BITS, Traversal};

/// Longest beam of the fast loop, in lattice steps.
const LONGEST: i64 = 1 << 30;

/// Size of a row-by-row block of cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Block {
    /// Cells along x.
    pub(crate) width: i64,
    /// Cells along y.
    pub(crate) height: i64,
}

impl Block {
    /// Whether the block holds the cell.
    #[inline]
    pub(crate) const fn contains(self, x: i64, y: i64) -> bool {
        (x as u64) < self.width as u64 && (y as u64) < self.height as u64
    }
}

/// A weight that can be switched off without a branch.
pub(crate) trait Weight: Copy {
    /// The weight itself, or zero.
    fn or_zero(self, keep: bool) -> Self;
}

impl Weight for i32 {
    #[inline]
    fn or_zero(self, keep: bool) -> Self {
        self & Self::from(keep).wrapping_neg()
    }
}

impl Weight for i16 {
    #[inline]
    fn or_zero(self, keep: bool) -> Self {
        self & Self::from(keep).wrapping_neg()
    }
}

/// Applies `update(value, weight)` to every cell of the block that the segment visits, except the cell of its end,
/// and returns how many there were. `from` and `to` are lattice points relative to the block's corner.
///
/// `update` may also be called with a zero weight, which must not change the value.
#[inline]
pub(crate) fn update_before_end<T: Weight>(
    values: &mut [T],
    block: Block,
    from: (i64, i64),
    to: (i64, i64),
    weight: T,
    update: impl Fn(T, T) -> T + Copy,
) -> u64 {
    let (x, y) = (Axis::new(from.0, to.0), Axis::new(from.1, to.1));
    let steep = x.length < y.length;
    let (major, minor) = if steep { (&y, &x) } else { (&x, &y) };
    let end = (to.0 >> LATTICE_BITS, to.1 >> LATTICE_BITS);
    let inside = block.contains(x.cell, y.cell) && block.contains(end.0, end.1);
    if !inside || major.length >= LONGEST || major.length == minor.length {
        return update_exactly(values, block, &x, &y, end, weight, update);
    }
    let (x_stride, y_stride) = (x.step as isize, (y.step * block.width) as isize);
    let (along, across) = if steep { (y_stride, x_stride) } else { (x_stride, y_stride) };
    let mut index = (y.cell * block.width + x.cell) as usize;
    if major.lines == 0 {
        if minor.lines > 0 {
            visit(values, index, weight, update);
        }
        return minor.lines as u64;
    }

    // Rounded up: 2^64 |d_minor| / |d_major| by two divisions of 64 bits, and Y_1 from it.
    let (numerator, denominator) = ((minor.length as u64) << 32, major.length as u64);
    let (high, rest) = (numerator / denominator, numerator % denominator);
    let slope = (high << 32) + (rest << 32).div_ceil(denominator);
    let to_line = (LATTICE - major.offset) as u128;
    let first =
        ((minor.offset as u128) << (64 - LATTICE_BITS)) + (to_line * u128::from(slope)).div_ceil(LATTICE as u128);
    let corner = major.lines as u64 + 3;

    // Column of the start.
    visit(values, index, weight, update);
    let (crossed, fraction) = ((first >> 64) as isize, first as u64);
    let mut count = major.lines as u64;
    if crossed > isize::from(fraction < corner) {
        visit(values, index.wrapping_add_signed(across), weight, update);
        count += 1;
    }
    index = index.wrapping_add_signed(along + across * crossed);

    let columns = major.lines as u64 - 1;
    let line = Line { index, fraction, slope, along, across };
    let meets_corners = (major.offset * minor.length - minor.offset * major.length) & (LATTICE - 1) == 0;
    if meets_corners {
        count += update_columns_with_corners(values, line, columns, corner, weight, update);
    } else {
        update_columns(values, line, columns, weight, update);
    }

    // Column of the end, whose lines are counted without rounding.
    let last = first + u128::from(columns) * u128::from(slope);
    let crossed_in_loop = (last >> 64) as i64 - crossed as i64;
    if !meets_corners {
        count += crossed_in_loop as u64;
    }
    if (last >> 64) as i64 <= minor.lines - 1 {
        let last_index = index.wrapping_add_signed(along * columns as isize + across * crossed_in_loop as isize);
        visit(values, last_index, weight, update);
        count += 1;
    }
    count
}

/// A beam where it enters a column.
#[derive(Debug, Clone, Copy)]
struct Line {
    index: usize,
    /// Position within the cell along the minor axis, and its gain per column, in 2⁻⁶⁴.
    fraction: u64,
    slope: u64,
    /// Storage distance of the next cell along the major and across it.
    along: isize,
    across: isize,
}

#[inline]
fn visit<T: Copy>(values: &mut [T], index: usize, weight: T, update: impl Fn(T, T) -> T) {
    // Both ends of the beam lie in the block, which is convex: the index always exists.
    if let Some(value) = values.get_mut(index) {
        *value = update(*value, weight);
    }
}

/// Whole columns of a beam that meets no corner.
#[inline(never)]
fn update_columns<T: Weight>(values: &mut [T], line: Line, columns: u64, weight: T, update: impl Fn(T, T) -> T + Copy) {
    let Line { mut index, mut fraction, slope, along, across } = line;
    for _ in 0..columns {
        visit(values, index, weight, update);
        let (sum, crosses) = fraction.overflowing_add(slope);
        fraction = sum;
        let aside = across & isize::from(crosses).wrapping_neg();
        let exit = index.wrapping_add_signed(aside);
        visit(values, exit, weight.or_zero(crosses), update);
        index = exit.wrapping_add_signed(along);
    }
}

/// Whole columns of a beam that may meet corners; returns how many cells of exit there were.
#[inline(never)]
fn update_columns_with_corners<T: Weight>(
    values: &mut [T],
    line: Line,
    columns: u64,
    corner: u64,
    weight: T,
    update: impl Fn(T, T) -> T + Copy,
) -> u64 {
    let Line { mut index, mut fraction, slope, along, across } = line;
    let mut exits = 0;
    for _ in 0..columns {
        visit(values, index, weight, update);
        let (sum, crosses) = fraction.overflowing_add(slope);
        fraction = sum;
        let inside = crosses && fraction >= corner;
        if inside {
            visit(values, index.wrapping_add_signed(across), weight, update);
            exits += 1;
        }
        index = index.wrapping_add_signed(along + if crosses { across } else { 0 });
    }
    exits
}

/// The same by [`Traversal`], for beams that the fast loop does not take.
#[cold]
fn update_exactly<T: Copy>(
    values: &mut [T],
    block: Block,
    x: &Axis,
    y: &Axis,
    end: (i64, i64),
    weight: T,
    update: impl Fn(T, T) -> T,
) -> u64 {
    let mut count = 0;
    for cell in Traversal::clipped_axes(x, y, block.width, block.height) {
        let (x, y) = (i64::from(cell.x), i64::from(cell.y));
        if (x, y) == end {
            break;
        }
        if let Some(value) = values.get_mut((y * block.width + x) as usize) {
            *value = update(*value, weight);
            count += 1;
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn fast(block: Block, from: (i64, i64), to: (i64, i64)) -> (Vec<i32>, u64) {
        let mut values = vec![0; (block.width * block.height) as usize];
        let count = update_before_end(&mut values, block, from, to, 1, |v: i32, w| v + w);
        (values, count)
    }

    fn exact(block: Block, from: (i64, i64), to: (i64, i64)) -> (Vec<i32>, u64) {
        let mut values = vec![0; (block.width * block.height) as usize];
        let (x, y) = (Axis::new(from.0, to.0), Axis::new(from.1, to.1));
        let end = (to.0 >> LATTICE_BITS, to.1 >> LATTICE_BITS);
        let count = update_exactly(&mut values, block, &x, &y, end, 1, |v: i32, w| v + w);
        (values, count)
    }

    fn coordinate(cells: i64) -> impl Strategy<Value = i64> {
        prop_oneof![
            (-2..cells + 2).prop_map(|c| c * LATTICE),
            (-4..2 * cells + 4).prop_map(|c| c * LATTICE / 2),
            (-1..cells * 3).prop_map(|c| c * LATTICE / 3),
            -LATTICE..(cells + 1) * LATTICE,
        ]
    }

    fn agree(block: Block, from: (i64, i64), to: (i64, i64)) -> Result<(), TestCaseError> {
        prop_assert_eq!(fast(block, from, to), exact(block, from, to));
        Ok(())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(6000))]

        #[test]
        fn the_fast_loop_visits_the_exact_cells(
            from in (coordinate(24), coordinate(19)), to in (coordinate(24), coordinate(19)),
        ) {
            agree(Block { width: 24, height: 19 }, from, to)?;
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]

        /// Long beams whose slope is a fraction of small numbers meet many corners, and near misses of corners.
        #[test]
        fn corners_are_told_from_near_misses_on_long_beams(
            rise in 0_i64..12, run in 1_i64..12, shift in -1_i64..=1, steep in any::<bool>(), back in any::<bool>(),
        ) {
            let n = 1200 / run.max(rise);
            let (from, to) = ((0, 0), (n * run * LATTICE, n * rise * LATTICE + shift));
            let mirrored = |p: (i64, i64)| if steep { (p.1 + LATTICE, p.0) } else { (p.0, p.1 + LATTICE) };
            let (from, to) = (mirrored(from), mirrored(to));
            let block = if steep { Block { width: 1210, height: 1210 } } else { Block { width: 1210, height: 1210 } };
            if back { agree(block, to, from)?; } else { agree(block, from, to)?; }
        }
    }
}
