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
//! in fixed point with 64 fractional bits, so that the carry of an addition is the crossing. Rounding it does not: the
//! slope and `Y_1` are rounded up, hence the error stays in `[0, columns + 2)` units of 2⁻⁶⁴. `Y_k` is a multiple of
//! `1 / (2¹⁶ |d_major|)`, which is more than that for beams below 2¹⁴ cells; so a fraction in `[0, columns + 2)`
//! says that `Y_k` is an integer (the beam meets a corner), and any other that the floor is right. What is longer, or
//! exactly diagonal, or leaves the grid goes to [`Traversal`].

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

/// Applies `update(value, weight)` to every cell of the block that the segment visits, except the cell of its end,
/// and returns how many there were. `from` and `to` are lattice points relative to the block's corner.
///
/// `update` may also be called with a zero weight, which must not change the value.
#[inline]
pub(crate) fn update_before_end<T: Copy + Default>(
    values: &mut [T],
    block: Block,
    from: (i64, i64),
    to: (i64, i64),
    weight: T,
    update: impl Fn(T, T) -> T,
) -> u64 {
    let (x, y) = (Axis::new(from.0, to.0), Axis::new(from.1, to.1));
    let (major, minor) = if x.length >= y.length { (&x, &y) } else { (&y, &x) };
    let inside = block.contains(x.cell, y.cell) && block.contains(to.0 >> LATTICE_BITS, to.1 >> LATTICE_BITS);
    if !inside || major.length >= LONGEST || major.length == minor.length {
        return update_exactly(values, block, &x, &y, (to.0 >> LATTICE_BITS, to.1 >> LATTICE_BITS), weight, update);
    }
    let (x_stride, y_stride) = (x.step, y.step * block.width);
    let (along, across) = if x.length >= y.length { (x_stride, y_stride) } else { (y_stride, x_stride) };
    let mut index = (y.cell * block.width + x.cell) as usize;
    let mut visit = |index: usize, weight: T| {
        // Both ends lie in the block, which is convex: the check never fails.
        if let Some(value) = values.get_mut(index) {
            *value = update(*value, weight);
        }
    };
    if major.lines == 0 {
        if minor.lines > 0 {
            visit(index, weight);
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
    let crossing = slope.saturating_sub(corner);

    // Column of the start.
    visit(index, weight);
    let (crossed, mut fraction) = ((first >> 64) as u64, first as u64);
    let mut count = 1;
    if crossed > u64::from(fraction < corner) {
        visit(index.wrapping_add_signed(across as isize), weight);
        count += 1;
    }
    index = index.wrapping_add_signed((along + across * crossed as i64) as isize);

    let mut seconds = 0_u64;
    for _ in 1..major.lines {
        visit(index, weight);
        fraction = fraction.wrapping_add(slope);
        // A crossing inside the column leaves a fraction in [corner, slope), one at a corner a fraction in [0, corner).
        let second = fraction.wrapping_sub(corner) < crossing;
        let carry = fraction < slope;
        let exit = index.wrapping_add_signed(if second { across as isize } else { 0 });
        visit(exit, if second { weight } else { T::default() });
        seconds += u64::from(second);
        index = index.wrapping_add_signed(if carry { (along + across) as isize } else { along as isize });
    }

    // Column of the end, whose lines are counted without rounding.
    let last = (first + (major.lines - 1) as u128 * u128::from(slope)) >> 64;
    count += major.lines as u64 - 1 + seconds;
    if (last as i64) < minor.lines {
        visit(index, weight);
        count += 1;
    }
    count
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
