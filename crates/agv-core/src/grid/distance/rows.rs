//! The row part of the distance transform: the lower envelope of one parabola per column.
//!
//! The value at `x` is `min_i (x - i)² + g²(i)` over the columns `i` with an obstacle within reach. Felzenszwalb and
//! Huttenlocher keep the envelope's parabolas on a stack; every column then waits for a division and for branches that no
//! processor foresees. Here the same envelope is found by its other property: parabolas of one shape cross once, so the
//! column that is least at `x` never moves left as `x` moves right (the matrix is totally monotone; Aggarwal et al.,
//! *Geometric applications of a matrix-searching algorithm*, 1987). The least columns of every [`BLOCK`]th cell are
//! searched by halving, each between those of its neighbours and no farther off than its own `g`; the cells of a block
//! then look at what lies between the least columns of its ends. Each level of the halving reads every column about once,
//! in plain loops that vectorise: O(width · log(width / `BLOCK`)) with a small constant, at most ten levels.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::{BAND, columns::Columns};
use crate::compute::Split;
use pulp::{Arch, Simd, WithSimd};

/// Cells that are evaluated together.
const BLOCK: usize = 32;

/// Candidates that are compared together.
const LANES: usize = 8;

/// Memory for the rows of a band.
#[derive(Debug, Clone, Default)]
pub(super) struct Scratch {
    /// Per column `g`, then the squared distances.
    values: Vec<i32>,
    /// Columns with an obstacle within reach and their `g²`, and the last of them [`LANES`] times more.
    columns: Vec<i32>,
    heights: Vec<i32>,
    /// Number of such columns before each column of the row, and before its end.
    before: Vec<i32>,
    /// Place among the columns of the one that is least at every [`BLOCK`]th cell, and at the last.
    least: Vec<i32>,
}

impl Scratch {
    fn resize(&mut self, width: usize) {
        self.values.resize(width, 0);
        self.columns.resize(width + LANES, 0);
        self.heights.resize(width + LANES, 0);
        self.before.resize(width + 1, 0);
        self.least.resize(width.div_ceil(BLOCK) + 1, 0);
    }
}

/// Rows of the result with scratch per band, cut between bands.
pub(super) struct Bands<'a, T> {
    width: usize,
    out: &'a mut [T],
    scratch: &'a mut [Scratch],
}

impl<'a, T> Bands<'a, T> {
    pub(super) fn new(width: usize, out: &'a mut [T], scratch: &'a mut [Scratch]) -> Self {
        Self { width, out, scratch }
    }
}

impl<T: Send> Split for Bands<'_, T> {
    fn len(&self) -> usize {
        self.out.len() / self.width
    }

    /// `mid` is a multiple of [`BAND`]: the loop over chunks of `BAND` rows cuts nowhere else.
    fn split_at(self, mid: usize) -> (Self, Self) {
        let (out_a, out_b) = self.out.split_at_mut(mid * self.width);
        let (scratch_a, scratch_b) = self.scratch.split_at_mut(mid / BAND);
        (
            Self { width: self.width, out: out_a, scratch: scratch_a },
            Self { width: self.width, out: out_b, scratch: scratch_b },
        )
    }
}

/// A band's rows, compiled for the instruction set that is found at run time.
pub(super) struct Band<'a, 'b, T, F> {
    pub(super) rows: Bands<'a, T>,
    /// Number of the band in the map.
    pub(super) number: usize,
    pub(super) columns: &'b Columns,
    /// Parabolas of columns whose obstacle is farther than this are left out, in cells.
    pub(super) reach: i16,
    /// Value of a row that has no parabola.
    pub(super) nothing: T,
    pub(super) finish: &'b F,
}

impl<T: Copy, F: Fn(i32) -> T> Band<'_, '_, T, F> {
    pub(super) fn run(self) {
        Arch::new().dispatch(self);
    }
}

impl<T: Copy, F: Fn(i32) -> T> WithSimd for Band<'_, '_, T, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let width = self.rows.width;
        let Some(scratch) = self.rows.scratch.first_mut() else { return };
        scratch.resize(width);
        for (row, out) in self.rows.out.chunks_exact_mut(width).enumerate() {
            self.columns.row_into(self.number, row, &mut scratch.values);
            let count = scratch.collect(i32::from(self.reach));
            if count == 0 {
                out.fill(self.nothing);
            } else {
                scratch.find_least(count);
                scratch.evaluate();
                convert(&scratch.values, out, self.finish);
            }
        }
    }
}

/// A function of its own, so that the compiler knows the slices apart and vectorises.
#[inline(always)]
fn convert<T: Copy>(squared: &[i32], out: &mut [T], finish: &impl Fn(i32) -> T) {
    for (value, &squared) in out.iter_mut().zip(squared) {
        *value = finish(squared);
    }
}

impl Scratch {
    /// Collects the columns with `g <= reach`, and returns how many there are.
    #[inline(always)]
    fn collect(&mut self, reach: i32) -> usize {
        let width = self.values.len();
        let (columns, heights) = (&mut self.columns[..width + LANES], &mut self.heights[..width + LANES]);
        let (blocks, rest) = self.values.as_chunks::<LANES>();
        let (befores, befores_of_rest) = self.before.as_chunks_mut::<LANES>();
        let mut count = 0;
        for (first, (g, before)) in (0..).step_by(LANES).zip(blocks.iter().zip(befores.iter_mut())) {
            if g.iter().all(|&g| g <= reach) {
                let (columns, heights) = (&mut columns[count..][..LANES], &mut heights[count..][..LANES]);
                for lane in 0..LANES {
                    before[lane] = (count + lane) as i32;
                    columns[lane] = first + lane as i32;
                    heights[lane] = g[lane] * g[lane];
                }
                count += LANES;
            } else {
                count = collect_some(first, g, reach, before, columns, heights, count);
            }
        }
        let first = (blocks.len() * LANES) as i32;
        let before = befores.get_mut(blocks.len()).map_or(befores_of_rest, |block| &mut block[..]);
        count = collect_some(first, rest, reach, before, columns, heights, count);
        self.before[self.values.len()] = count as i32;
        if count > 0 {
            let (column, height) = (self.columns[count - 1], self.heights[count - 1]);
            self.columns[count..][..LANES].fill(column);
            self.heights[count..][..LANES].fill(height);
        }
        count
    }

    /// Fills in [`least`](Self::least), halving the distance between its known entries until all are.
    #[inline(always)]
    fn find_least(&mut self, count: usize) {
        let last = self.values.len().div_ceil(BLOCK);
        self.least[0] = self.search(0, 0, count as i32 - 1);
        self.least[last] = self.search(last, self.least[0], count as i32 - 1);
        let mut stride = last.next_power_of_two();
        while stride > 1 {
            let half = stride / 2;
            for point in (half..last).step_by(stride) {
                let (low, high) = (self.least[point - half], self.least[(point + half).min(last)]);
                self.least[point] = if low == high { low } else { self.search(point, low, high) };
            }
            stride = half;
        }
    }

    /// The parabola from `low` to `high` that is least at the `point`th block's first cell.
    #[inline(always)]
    fn search(&self, point: usize, low: i32, high: i32) -> i32 {
        let width = self.values.len();
        let x = (point * BLOCK).min(width - 1);
        // The column's own obstacle is `g` away, so no better one is farther off. Beyond the reach it is none of the candidates,
        // and there may be none as near: any is as good then, but one beyond its neighbours would leave cells between them none.
        let g = self.values[x] as usize;
        let low = low.max(self.before[x.saturating_sub(g)]).min(high);
        let high = high.min(self.before[(x + g + 1).min(width)] - 1).max(low);
        let x = x as i32;
        let mut best = [i32::MAX; LANES];
        let mut place = [low; LANES];
        // What is read beyond `high` is as good a candidate as any, but one on a tie must not pass its neighbours.
        let len = (high - low) as usize / LANES * LANES + LANES;
        let (columns, _) = self.columns[low as usize..][..len].as_chunks::<LANES>();
        let (heights, _) = self.heights[low as usize..][..len].as_chunks::<LANES>();
        for (first, (columns, heights)) in (low..).step_by(LANES).zip(columns.iter().zip(heights)) {
            for lane in 0..LANES {
                let way = x - columns[lane];
                let value = way * way + heights[lane];
                place[lane] = if value < best[lane] { first } else { place[lane] };
                best[lane] = best[lane].min(value);
            }
        }
        let least = best.iter().fold(i32::MAX, |least, &value| least.min(value));
        let mut found = high;
        for lane in 0..LANES {
            let candidate = place[lane] + lane as i32;
            found = if best[lane] == least { found.min(candidate) } else { found };
        }
        found
    }

    /// Writes the envelope's value in every column.
    #[inline(always)]
    fn evaluate(&mut self) {
        let (columns, heights, least) = (&self.columns[..], &self.heights[..], &self.least[..]);
        let (blocks, rest) = self.values.as_chunks_mut::<BLOCK>();
        for ((first, block), ends) in (0_i32..).step_by(BLOCK).zip(blocks.iter_mut()).zip(least.windows(2)) {
            *block = evaluate_block(first, columns, heights, ends[0], ends[1]);
        }
        if let (&[low, high], false) = (&least[blocks.len()..], rest.is_empty()) {
            let block = evaluate_block((blocks.len() * BLOCK) as i32, columns, heights, low, high);
            rest.copy_from_slice(&block[..rest.len()]);
        }
    }
}

/// Appends the columns from `first` on with `g <= reach` to the `count` that there are.
#[inline(always)]
fn collect_some(
    first: i32,
    distances: &[i32],
    reach: i32,
    before: &mut [i32],
    columns: &mut [i32],
    heights: &mut [i32],
    mut count: usize,
) -> usize {
    for (column, (&g, before)) in (first..).zip(distances.iter().zip(before)) {
        *before = count as i32;
        columns[count] = column;
        heights[count] = g.wrapping_mul(g);
        count += usize::from(g <= reach);
    }
    count
}

/// The least of the parabolas from `low` to `high`, at the columns from `first` on.
#[inline(always)]
fn evaluate_block(first: i32, columns: &[i32], heights: &[i32], low: i32, high: i32) -> [i32; BLOCK] {
    let range = low as usize..=high as usize;
    let mut least = [i32::MAX; BLOCK];
    for (&column, &height) in columns[range.clone()].iter().zip(&heights[range]) {
        let way = first - column;
        for (lane, least) in (0..).zip(&mut least) {
            *least = (*least).min((way + lane) * (way + lane) + height);
        }
    }
    least
}
