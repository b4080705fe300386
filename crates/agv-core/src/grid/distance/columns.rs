//! The column part of the distance transform: distance to the nearest obstacle in the same column.
//!
//! Whole rows are processed at a time, so that memory is read in order and the loops vectorise. Bands of rows are
//! scanned on their own, up and down; what lies in other bands enters by two *carry* rows per band, and is joined in when
//! a row is read.

use super::{BAND, CellState, Grid, NONE};
use crate::compute::{Par, Split};

/// Distances along columns, in cells; [`NONE`] where a column has no obstacle.
#[derive(Debug, Clone, Default)]
pub(super) struct Columns {
    width: usize,
    height: usize,
    /// Distance to the nearest obstacle of the same column and band.
    within: Vec<i16>,
    /// Per band: distance from its first row to the nearest obstacle in bands before it.
    before: Vec<i16>,
    /// Per band: distance from its last row to the nearest obstacle in bands after it.
    after: Vec<i16>,
}

/// Rows of the map and of the result, cut between rows.
struct Rows<'a> {
    width: usize,
    states: &'a [CellState],
    distances: &'a mut [i16],
}

impl Split for Rows<'_> {
    fn len(&self) -> usize {
        self.states.len() / self.width
    }

    fn split_at(self, mid: usize) -> (Self, Self) {
        let (states_a, states_b) = self.states.split_at(mid * self.width);
        let (distances_a, distances_b) = self.distances.split_at_mut(mid * self.width);
        (
            Self { states: states_a, distances: distances_a, ..self },
            Self { states: states_b, distances: distances_b, ..self },
        )
    }
}

impl Columns {
    pub(super) fn scan(&mut self, map: &Grid<CellState>, par: Par, least_obstacle: CellState) {
        (self.width, self.height) = (map.layout().width(), map.layout().height());
        let bands = self.height.div_ceil(BAND);
        self.within.resize(self.width * self.height, 0);
        self.before.resize(bands * self.width, NONE);
        self.after.resize(bands * self.width, NONE);
        let rows = Rows { width: self.width, states: map.values(), distances: &mut self.within };
        par.for_each_chunk(rows, BAND, |_, rows| scan_band(rows, least_obstacle as u8));
        self.carry();
    }

    /// Fills the carry rows: upwards from the first band, downwards from the last.
    fn carry(&mut self) {
        let width = self.width;
        let bands = self.height.div_ceil(BAND);
        // The last row of a band is as far from what lies below it as `within` and the band's own carry say.
        self.before[..width].fill(NONE);
        for band in 1..bands {
            let (done, rest) = self.before.split_at_mut(band * width);
            let last = &self.within[(band * BAND - 1) * width..][..width];
            for ((next, &own), &carried) in rest.iter_mut().zip(last).zip(&done[(band - 1) * width..]) {
                *next = own.min(carried.saturating_add(BAND as i16 - 1)).saturating_add(1);
            }
        }
        self.after[(bands - 1) * width..].fill(NONE);
        for band in (0..bands - 1).rev() {
            let (rest, done) = self.after.split_at_mut((band + 1) * width);
            let rows_above = (self.height - (band + 1) * BAND).min(BAND) as i16;
            let first = &self.within[(band + 1) * BAND * width..][..width];
            for ((next, &own), &carried) in rest[band * width..].iter_mut().zip(first).zip(&done[..width]) {
                *next = own.min(carried.saturating_add(rows_above - 1)).saturating_add(1);
            }
        }
    }

    /// Column distances of row `row` of a band, in cells.
    #[expect(clippy::inline_always, reason = "compiled with the rows, for the instruction set found at run time")]
    #[inline(always)]
    pub(super) fn row_into(&self, band: usize, row: usize, out: &mut [i32]) {
        let width = self.width;
        let rows = (self.height - band * BAND).min(BAND);
        let (up, down) = (row as i16, (rows - 1 - row) as i16);
        let within = &self.within[(band * BAND + row) * width..][..width];
        let (before, after) = (&self.before[band * width..][..width], &self.after[band * width..][..width]);
        for (((out, &own), &before), &after) in out.iter_mut().zip(within).zip(before).zip(after) {
            *out = i32::from(own.min(before.saturating_add(up)).min(after.saturating_add(down)));
        }
    }
}

/// States from `least_obstacle` upwards are obstacles.
fn scan_band(rows: Rows<'_>, least_obstacle: u8) {
    let Rows { width, states, distances } = rows;
    for (d, &state) in distances.iter_mut().zip(states) {
        *d = if state as u8 >= least_obstacle { 0 } else { NONE };
    }
    let count = distances.len() / width;
    for y in 1..count {
        let (below, row) = distances.split_at_mut(y * width);
        approach(&mut row[..width], &below[(y - 1) * width..]);
    }
    for y in (1..count).rev() {
        let (row, above) = distances.split_at_mut(y * width);
        approach(&mut row[(y - 1) * width..], &above[..width]);
    }
}

/// No cell is farther from an obstacle than its neighbour is, and one.
#[inline]
fn approach(row: &mut [i16], neighbour: &[i16]) {
    for (d, &next) in row.iter_mut().zip(neighbour) {
        *d = (*d).min(next.saturating_add(1));
    }
}
