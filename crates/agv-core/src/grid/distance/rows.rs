//! The row part of the distance transform: the lower envelope of one parabola per column.
//!
//! With `F(i) = g²(i) + i²` the value at `x` is `x² + min_i (F(i) - 2 i x)`. Parabolas are taken from left to right and
//! kept on a stack with the column where each begins to be least; as in Meijster, Roerdink and Hesselink, *A general
//! algorithm for computing distance transforms in linear time* (2000), only columns count, not points between them, so
//! that integers do: one product says whether the last parabola is beaten, one division where the new one begins.

use super::{BAND, columns::Columns};
use crate::compute::Split;

/// A parabola of the envelope: column `i`, `F(i)`, and the first column where it is least.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Site {
    column: i32,
    height: i32,
    start: i32,
}

/// Rows of the result with a row of scratch per band, cut between bands.
pub(super) struct Bands<'a, T> {
    width: usize,
    out: &'a mut [T],
    sites: &'a mut [Site],
    squared: &'a mut [i32],
}

impl<'a, T> Bands<'a, T> {
    pub(super) fn new(width: usize, out: &'a mut [T], sites: &'a mut [Site], squared: &'a mut [i32]) -> Self {
        Self { width, out, sites, squared }
    }
}

impl<T: Send> Split for Bands<'_, T> {
    fn len(&self) -> usize {
        self.out.len() / self.width
    }

    /// `mid` is a multiple of [`BAND`]: the loop over chunks of `BAND` rows cuts nowhere else.
    fn split_at(self, mid: usize) -> (Self, Self) {
        let scratch = mid / BAND * self.width;
        let (out_a, out_b) = self.out.split_at_mut(mid * self.width);
        let (sites_a, sites_b) = self.sites.split_at_mut(scratch);
        let (squared_a, squared_b) = self.squared.split_at_mut(scratch);
        (
            Self { width: self.width, out: out_a, sites: sites_a, squared: squared_a },
            Self { width: self.width, out: out_b, sites: sites_b, squared: squared_b },
        )
    }
}

impl<T: Copy> Bands<'_, T> {
    /// Computes the rows of band `band`; parabolas farther than `reach` cells are left out, and `nothing` is the value
    /// of a row that has none.
    pub(super) fn run(self, band: usize, columns: &Columns, reach: i16, nothing: T, finish: &impl Fn(i32) -> T) {
        let (sites, squared) = (&mut self.sites[..self.width], &mut self.squared[..self.width]);
        for (row, out) in self.out.chunks_exact_mut(self.width).enumerate() {
            columns.row_into(band, row, squared);
            let len = envelope(squared, reach, sites);
            if len == 0 {
                out.fill(nothing);
            } else {
                evaluate(&sites[..len], squared);
                convert(squared, out, finish);
            }
        }
    }
}

/// A function of its own, so that the compiler knows the slices apart and vectorises.
#[inline]
fn convert<T: Copy>(squared: &[i32], out: &mut [T], finish: &impl Fn(i32) -> T) {
    for (value, &squared) in out.iter_mut().zip(squared) {
        *value = finish(squared);
    }
}

/// The parabolas that are least somewhere, among those with `g(i) <= reach`; returns their number.
fn envelope(column_distances: &[i32], reach: i16, sites: &mut [Site]) -> usize {
    let end = column_distances.len() as i32;
    let mut len = 0;
    let mut last = Site::default();
    for (column, &g) in (0_i32..).zip(column_distances) {
        if g > i32::from(reach) {
            continue;
        }
        let height = g * g + column * column;
        // The last parabola goes if the new one is not greater where the last one's part begins. With sides below 2^15
        // all numbers are below 2^31.
        while len > 0 && height - last.height <= 2 * last.start * (column - last.column) {
            len -= 1;
            if len > 0 {
                last = sites[len - 1];
            }
        }
        let start = if len == 0 { 0 } else { last.crossing(column, height) };
        if start < end {
            last = Site { column, height, start };
            sites[len] = last;
            len += 1;
        }
    }
    len
}

/// Writes the envelope's value in every column.
fn evaluate(sites: &[Site], squared: &mut [i32]) {
    let mut stop = squared.len();
    for site in sites.iter().rev() {
        let start = site.start as usize;
        let base = site.height - site.column * site.column;
        for (dx, squared) in (site.start - site.column..).zip(&mut squared[start..stop]) {
            *squared = dx * dx + base;
        }
        stop = start;
    }
}

impl Site {
    /// First column beyond the crossing with the parabola of a later `column`; at the crossing both are equal.
    ///
    /// The quotient of integers below 2^31 and 2^16 is never rounded across an integer in f64.
    #[inline]
    fn crossing(self, column: i32, height: i32) -> i32 {
        (f64::from(height - self.height) / f64::from(2 * (column - self.column))) as i32 + 1
    }
}
