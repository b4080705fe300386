//! Updates the cells that a beam crosses before its end: the traversal of [`Traversal`], as fast as memory allows.
//!
//! The traversal's decision variable `e` lies in `[-b, a)`, `a = 2¹⁶ |dy|`, `b = 2¹⁶ |dx|`; a step along x adds `a`, a
//! step along y subtracts `b`. Modulo `a + b` these are the same, so the phase of the beam only ever turns by a constant:
//!
//! ```text
//! phase = (e + b) / (a + b),    phase <- (phase + a / (a + b)) mod 1,    step along y if it wraps, along x if not
//! ```
//!
//! In fixed point with 64 fractional bits that is one addition, whose carry selects the step: no branch, no comparison,
//! a chain of one cycle per cell. It is exact all the same: the turn and the first phase are rounded up, so after `n`
//! steps the error lies in `[0, n + 4)` units of 2⁻⁶⁴, while phases are multiples of `1 / (a + b)`, which is at least
//! 2¹⁷ units for beams with `|dx| + |dy|` below 2¹⁵ cells. So the carry is right, and a sum within the error above one
//! says that the beam meets a corner.
//!
//! Most beams meet no corner, and need not look for one: with the start `o` within its cell a corner `(k, j)` on the
//! line means `2¹⁶ (k |dy| - j |dx|) = o_x |dy| - o_y |dx|`, which 65535 of 65536 beams refute by the low bits of the
//! right side. Beams that are longer or leave the grid go to [`Traversal`].

use super::traversal::{Axis, LATTICE, LATTICE_BITS, Traversal};

/// Longest beam of the fast loop, as `|dx| + |dy|` in lattice steps.
const LONGEST: i64 = 1 << 31;

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

/// Applies `update` to every cell of the block that the segment visits, except the cell of its end, and returns how
/// many there were. `from` and `to` are lattice points relative to the block's corner.
#[inline]
pub(crate) fn update_before_end<T: Copy>(
    values: &mut [T],
    block: Block,
    from: (i64, i64),
    to: (i64, i64),
    update: impl Fn(T) -> T,
) -> u64 {
    let (x, y) = (Axis::new(from.0, to.0), Axis::new(from.1, to.1));
    let end = (to.0 >> LATTICE_BITS, to.1 >> LATTICE_BITS);
    let inside = block.contains(x.cell, y.cell) && block.contains(end.0, end.1);
    let length = x.length + y.length;
    if !inside || length >= LONGEST {
        return update_exactly(values, block, &x, &y, end, update);
    }
    let index = (y.cell * block.width + x.cell) as usize;
    let steps = (x.step as isize, (y.step * block.width) as isize);
    // The first axis is one that has a length.
    let (first, second, along, across) =
        if x.length > 0 { (&x, &y, steps.0, steps.1) } else { (&y, &x, steps.1, steps.0) };
    if length == 0 {
        return 0;
    }

    // 2^64 |dy| / (|dx| + |dy|), rounded up, by two divisions of 64 bits.
    let (numerator, denominator) = ((second.length as u64) << 32, length as u64);
    let (high, rest) = (numerator / denominator, numerator % denominator);
    let turn = (high << 32) + (rest << 32).div_ceil(denominator);
    // phase = ((2^16 - o_x) |dy| + o_y |dx|) / (2^16 (|dx| + |dy|)), by less than 3 units too large.
    let (ahead, behind) = ((LATTICE - first.offset) as u128, second.offset as u128);
    let weighted = ahead * u128::from(turn) + behind * ((1 << 64) - u128::from(turn));
    let phase = (weighted >> LATTICE_BITS) as u64 + 2;

    let lines = (x.lines + y.lines) as u64;
    let walk = Walk { index, phase, turn, along, across, lines };
    if meets_corner(&x, &y) {
        walk.update_with_corners(values, weighted >> LATTICE_BITS > u128::from(u64::MAX), update)
    } else {
        walk.update_without_corners(values, update);
        lines
    }
}

/// Whether the line may pass through a corner between cells; if not, it certainly does not.
#[inline]
pub(crate) const fn meets_corner(x: &Axis, y: &Axis) -> bool {
    (x.offset * y.length - y.offset * x.length) & (LATTICE - 1) == 0
}

/// A beam at the cell of its start.
#[derive(Debug, Clone, Copy)]
struct Walk {
    index: usize,
    /// Phase and its turn per step, in units of 2⁻⁶⁴.
    phase: u64,
    turn: u64,
    /// Storage distance to the next cell without and with a wrap of the phase.
    along: isize,
    across: isize,
    /// Lines to cross, each a step unless two meet in a corner.
    lines: u64,
}

impl Walk {
    #[inline(never)]
    fn update_without_corners<T: Copy>(self, values: &mut [T], update: impl Fn(T) -> T) {
        let Self { mut index, mut phase, turn, along, across, lines } = self;
        for _ in 0..lines {
            // Both ends of the beam lie in the block, which is convex: the index always exists.
            let Some(value) = values.get_mut(index) else { return };
            *value = update(*value);
            let (sum, wraps) = phase.overflowing_add(turn);
            phase = sum;
            index = index.wrapping_add_signed(if wraps { across } else { along });
        }
    }

    /// Returns how many cells were visited.
    #[inline(never)]
    fn update_with_corners<T: Copy>(self, values: &mut [T], starts_at_one: bool, update: impl Fn(T) -> T) -> u64 {
        let Self { mut index, mut phase, turn, along, across, lines } = self;
        let error = lines + 4;
        let (mut left, mut visited) = (lines, 0);
        while left > 0 {
            let Some(value) = values.get_mut(index) else { break };
            *value = update(*value);
            visited += 1;
            let (sum, carry) = phase.overflowing_add(turn);
            // A start in a corner may have to leave its cell at once: its phase is one.
            let wraps = carry || (visited == 1 && starts_at_one);
            if carry && sum < error && left > 1 {
                // Both lines at once.
                index = index.wrapping_add_signed(along + across);
                phase = sum.wrapping_add(turn);
                left -= 2;
            } else {
                index = index.wrapping_add_signed(if wraps { across } else { along });
                phase = sum;
                left -= 1;
            }
        }
        visited
    }
}

/// The same by [`Traversal`], for beams that the fast loop does not take.
#[cold]
fn update_exactly<T: Copy>(
    values: &mut [T],
    block: Block,
    x: &Axis,
    y: &Axis,
    end: (i64, i64),
    update: impl Fn(T) -> T,
) -> u64 {
    let mut count = 0;
    for cell in Traversal::clipped_axes(x, y, block.width, block.height) {
        let (x, y) = (i64::from(cell.x), i64::from(cell.y));
        if (x, y) == end {
            break;
        }
        if let Some(value) = values.get_mut((y * block.width + x) as usize) {
            *value = update(*value);
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
        let count = update_before_end(&mut values, block, from, to, |v: i32| v + 1);
        (values, count)
    }

    fn exact(block: Block, from: (i64, i64), to: (i64, i64)) -> (Vec<i32>, u64) {
        let mut values = vec![0; (block.width * block.height) as usize];
        let (x, y) = (Axis::new(from.0, to.0), Axis::new(from.1, to.1));
        let end = (to.0 >> LATTICE_BITS, to.1 >> LATTICE_BITS);
        let count = update_exactly(&mut values, block, &x, &y, end, |v: i32| v + 1);
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
        let ((ours, count), (reference, expected)) = (fast(block, from, to), exact(block, from, to));
        let difference = ours.iter().zip(&reference).position(|(a, b)| a != b);
        prop_assert_eq!(difference.map(|i| (i as i64 % block.width, i as i64 / block.width)), None);
        prop_assert_eq!(count, expected);
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
            let n = 560 / run.max(rise);
            let (from, to) = ((0, 0), (n * run * LATTICE, n * rise * LATTICE + shift));
            let mirrored = |p: (i64, i64)| if steep { (p.1 + LATTICE, p.0) } else { (p.0, p.1 + LATTICE) };
            let (from, to) = (mirrored(from), mirrored(to));
            let block = Block { width: 570, height: 570 };
            if back { agree(block, to, from)?; } else { agree(block, from, to)?; }
        }

        /// Up to the longest beams of the fast loop the rounding stays below the distance of phases.
        #[test]
        fn the_longest_beams_are_exact_too(
            from in (0..1_000 * LATTICE, 0..2 * LATTICE), to in (29_000 * LATTICE..30_000 * LATTICE, 0..2 * LATTICE),
        ) {
            agree(Block { width: 30_000, height: 2 }, from, to)?;
        }
    }
}
