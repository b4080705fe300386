//! Counts how many beams of a scan pass each cell, by the ends of runs instead of the cells.
//!
//! Neighbouring beams cross the same cells, so it is cheaper to count first and to update each cell once. A beam that
//! goes farther along x than along y is a row of runs, one per row of cells; a run is two marks, +1 where it begins and
//! -1 behind its end, and the sums of the marks along a row are the counts. Only the lines between rows cost a step: a
//! third of the cells that the beam visits. Beams that go farther along y are runs along columns, in a table of their own.
//!
//! Where the beam crosses the `n`-th line of its minor axis, its way along the major one is, in cells,
//!
//! ```text
//! X_n = ( o_x |dy| + (2¹⁶ n - o_y) |dx| ) / (2¹⁶ |dy|)
//! ```
//!
//! a whole number of `1 / (2¹⁶ |dy|)`. The loop adds up its fraction in fixed point of 64 bits, rounded to 2⁻⁵³ per
//! step. With beams below 2¹⁰ cells that makes less than 2⁻⁴³ in all, while a fraction that is not zero is at least 2⁻⁴²
//! from a whole number; it is zero only in a corner. So the whole part is exact for the beams that [`mark`] takes.
//!
//! [`mark`]: BeamCounts::mark

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::{
    beam_walk::meets_corner,
    traversal::{Axis, LATTICE, LATTICE_BITS},
};
use pulp::{Arch, Simd, WithSimd};

/// Longest beam that is counted, along either axis, in lattice steps.
const LONGEST: i64 = 1 << 26;

/// The cells from `low` to `high`, both included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Bounds {
    pub(crate) low: (i64, i64),
    pub(crate) high: (i64, i64),
}

/// What takes the counts.
pub(crate) trait CountSink {
    /// Takes the beams that pass each of the cells from `(x, y)` on along the row; `inline(always)`, so that it is
    /// compiled for the instruction set that is found at run time.
    fn row(&mut self, x: i64, y: i64, counts: &[u16]);
}

/// Marks of a scan's beams, all from one start; empty, with its memory, between scans.
#[derive(Debug, Clone, Default)]
pub(crate) struct BeamCounts {
    /// Marks of runs along rows and along columns, row by row; a row and a column more than there are cells.
    rows: Vec<u16>,
    columns: Vec<u16>,
    /// Beams in each column of the present row.
    passing: Vec<u16>,
    sums: RunningSums,
    low: (i64, i64),
    width: usize,
    height: usize,
}

impl BeamCounts {
    /// Most beams of a scan: counts then fit 15 bits.
    pub(crate) const MOST_BEAMS: usize = i16::MAX as usize;

    /// Prepares for beams that stay within `bounds`; no scan of this kind has bounds of more than `most` cells along x
    /// and y, so that later ones find room.
    pub(crate) fn begin(&mut self, bounds: Bounds, most: (usize, usize)) {
        self.low = bounds.low;
        self.width = (bounds.high.0 - bounds.low.0 + 1) as usize;
        self.height = (bounds.high.1 - bounds.low.1 + 1) as usize;
        let len = (self.width + 1) * (self.height + 1);
        if self.rows.len() < len {
            // Memory that is reserved and not touched costs nothing.
            for marks in [&mut self.rows, &mut self.columns] {
                marks.reserve(((most.0 + 1) * (most.1 + 1)).saturating_sub(marks.len()));
                marks.resize(len, 0);
            }
        }
        self.passing.clear();
        self.passing.resize(self.width.max(most.0), 0);
        self.sums.resize(self.width.max(most.0) + 1);
    }

    /// Whether [`mark`](Self::mark) takes a beam: none that is long, or that may meet a corner between cells.
    #[inline]
    pub(crate) const fn takes(x: &Axis, y: &Axis) -> bool {
        // One run, however it passes corners.
        let straight = if x.length >= y.length { y.lines == 0 } else { x.lines == 0 };
        x.length < LONGEST && y.length < LONGEST && (straight || !meets_corner(x, y))
    }

    /// Counts a beam in every cell that it visits, but for that of its end.
    #[inline]
    pub(crate) fn mark(&mut self, x: &Axis, y: &Axis) {
        let pitch = (self.width + 1) as isize;
        let (marks, first, second, unit, across) =
            if x.length >= y.length { (&mut self.rows, x, y, 1, pitch) } else { (&mut self.columns, y, x, pitch, 1) };
        let start = (y.cell - self.low.1) as isize * pitch + (x.cell - self.low.0) as isize;
        let end = start + y.step as isize * y.lines as isize * pitch + x.step as isize * x.lines as isize;
        let (along, across) = (first.step as isize * unit, second.step as isize * across);
        // A run forwards begins at its cell; one backwards ends behind it.
        let forward = along > 0;
        let (opening, closing) = if forward { (0, unit) } else { (unit, 0) };
        let weight = if forward { 1_u16 } else { u16::MAX };
        add(marks, start + opening, weight);
        add(marks, end + opening, weight.wrapping_neg());
        if second.lines == 0 {
            return;
        }

        let (run, rise) = (first.length, second.length);
        let to_line = first.offset * rise + (LATTICE - second.offset) * run;
        // Both quotients are below 2^28 over 2^26: divisions of 32 bits.
        let whole = i64::from((to_line >> LATTICE_BITS) as u32 / rise as u32);
        let whole_turn = i64::from(run as u32 / rise as u32);
        let mut phase = fraction(to_line - whole * (rise << LATTICE_BITS), rise << LATTICE_BITS);
        let turn = fraction(run - whole_turn * rise, rise);
        let step = across + along * whole_turn as isize;
        let carried = step + along;
        let mut place = start + along * whole as isize + closing;
        let opens = across + opening - closing;
        for _ in 0..second.lines {
            add(marks, place, weight.wrapping_neg());
            add(marks, place + opens, weight);
            let (sum, carry) = phase.overflowing_add(turn);
            phase = sum;
            place += if carry { carried } else { step };
        }
    }

    /// Hands all counts of the beams from `start` out; a cell may come twice, in parts. Clears all marks.
    pub(crate) fn drain(&mut self, start: (i64, i64), sink: &mut impl CountSink) {
        Arch::new().dispatch(Drain { counts: self, start, sink });
    }

    #[inline(always)]
    fn drain_rows(&mut self, start: (i64, i64), sink: &mut impl CountSink) {
        let (width, pitch) = (self.width, self.width + 1);
        let x0 = (start.0 - self.low.0) as usize;
        for j in 0..=self.height {
            let y = self.low.1 + j as i64;
            // Beams along y are within this many columns of the start's, the others farther off; two cells of margin.
            let off = (y - start.1).unsigned_abs() as usize;
            let (near, far) = (x0.saturating_sub(off + 2), (x0 + off + 3).min(width));
            let marks = &mut self.columns[j * pitch..][..width];
            if near < far {
                let (passing, marks) = (&mut self.passing[near..far], &mut marks[near..far]);
                for (passing, mark) in passing.iter_mut().zip(marks) {
                    *passing = passing.wrapping_add(*mark);
                    *mark = 0;
                }
                if j < self.height {
                    sink.row(self.low.0 + near as i64, y, passing);
                }
            }
            if j == self.height {
                break;
            }
            let marks = &mut self.rows[j * pitch..][..pitch];
            let (left, right) = ((x0 + 3).saturating_sub(off), (x0 + off).saturating_sub(2));
            let pieces = if left >= right { [(0, pitch), (0, 0)] } else { [(0, left), (right.min(pitch), pitch)] };
            for (from, to) in pieces {
                let marks = &mut marks[from..to];
                if marks.is_empty() {
                    continue;
                }
                let counts = self.sums.take(marks);
                sink.row(self.low.0 + from as i64, y, &counts[..counts.len().min(width - from)]);
            }
        }
    }
}

/// The sweep, compiled for the instruction set that is found at run time.
struct Drain<'a, K> {
    counts: &'a mut BeamCounts,
    start: (i64, i64),
    sink: &'a mut K,
}

impl<K: CountSink> WithSimd for Drain<'_, K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.counts.drain_rows(self.start, self.sink);
    }
}

/// `part / whole` below one, in units of 2⁻⁶⁴, rounded to 53 bits.
#[inline]
fn fraction(part: i64, whole: i64) -> u64 {
    const HALF: f64 = (1_u64 << 63) as f64;
    (((part as f64 / whole as f64) * HALF) as i64 as u64) << 1
}

/// Marks lie within the bounds of [`BeamCounts::begin`], so the place always exists.
#[inline]
fn add(marks: &mut [u16], place: isize, weight: u16) {
    if let Some(mark) = marks.get_mut(place as usize) {
        *mark = mark.wrapping_add(weight);
    }
}

/// Entries that are summed at a time.
const LANES: usize = 8;

/// Memory for running sums: [`LANES`] zeros, then as many numbers as a row has.
#[derive(Debug, Clone, Default)]
struct RunningSums {
    a: Vec<u16>,
    b: Vec<u16>,
}

impl RunningSums {
    fn resize(&mut self, len: usize) {
        let padded = LANES + len.next_multiple_of(LANES);
        for buffer in [&mut self.a, &mut self.b] {
            if buffer.len() < padded {
                buffer.resize(padded, 0);
            }
        }
    }

    /// The running sums of `marks`, which are cleared. Sums over the last 2, 4 and 8 numbers, so that what is left is a
    /// running sum in every lane of its own: all of it vectorises.
    #[inline(always)]
    fn take(&mut self, marks: &mut [u16]) -> &[u16] {
        let len = marks.len().next_multiple_of(LANES);
        let (a, b) = (&mut self.a[..LANES + len], &mut self.b[..LANES + len]);
        a[LANES..][..marks.len()].copy_from_slice(marks);
        a[LANES + marks.len()..].fill(0);
        marks.fill(0);
        add_earlier::<1>(a, b);
        add_earlier::<2>(b, a);
        add_earlier::<4>(a, b);
        let mut sums = [0_u16; LANES];
        let (blocks, _) = b[LANES..].as_chunks_mut::<LANES>();
        for block in blocks {
            for (sum, more) in sums.iter_mut().zip(block.iter_mut()) {
                *sum = sum.wrapping_add(*more);
                *more = *sum;
            }
        }
        &self.b[LANES..][..marks.len()]
    }
}

/// Adds to each number the one `BACK` places before it; the first [`LANES`] are zeros that stay.
#[inline(always)]
fn add_earlier<const BACK: usize>(from: &[u16], into: &mut [u16]) {
    let earlier = &from[LANES - BACK..];
    for ((into, &own), &earlier) in into[LANES..].iter_mut().zip(&from[LANES..]).zip(earlier) {
        *into = own.wrapping_add(earlier);
    }
}
