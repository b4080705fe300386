//! The work per particle: turn the end points, round them to cells, look up.
//!
//! The index pass is plain arithmetic on `f32`, which the compiler vectorises for the machine it finds at run time; the
//! look-up pass adds the table's entries in four fixed lanes: the bits do not depend on the instruction set.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::{ScanForm, table::Table};
use crate::particle::PoseLikelihood;
use agv_core::geometry::{LieGroup, Se2};
use pulp::{Arch, Simd, WithSimd};

/// Beams per step of the index pass: two registers of the widest machines, and little padding for 60 beams.
pub(super) const BLOCK: usize = 32;

/// The coordinates of a block of end points in the base frame, in cells.
pub(super) type EndBlock = [[f32; BLOCK]; 2];

/// Adding 2²³ to a number in [0, 2²²] leaves its nearest whole number in the low bits of the sum.
const ROUNDER: f32 = 8_388_608.0;

/// A scan, ready to judge poses.
pub(super) struct ScanOnTable<'a> {
    table: &'a Table,
    /// Padded to whole blocks.
    ends: &'a [EndBlock],
    hits: usize,
    form: ScanForm,
    /// What the sum of a product's logarithms is multiplied by.
    power: f64,
    arch: Arch,
}

/// A pose in the grid, in cells.
struct Placement {
    x: f32,
    y: f32,
    cos: f32,
    sin: f32,
}

impl<'a> ScanOnTable<'a> {
    pub(super) fn new(table: &'a Table, ends: &'a [EndBlock], hits: usize, form: ScanForm) -> Self {
        let power = match form {
            ScanForm::Product { independent_beams } => (independent_beams / hits.max(1) as f64).min(1.0),
            ScanForm::SumOfCubes => 1.0,
        };
        Self { table, ends, hits, form, power, arch: Arch::new() }
    }

    #[inline(always)]
    fn judge(&self, map_from_base: &Se2) -> f64 {
        let sum = self.sum_of_terms(map_from_base);
        match self.form {
            ScanForm::Product { .. } => self.power * sum,
            ScanForm::SumOfCubes => sum.ln_1p(),
        }
    }

    #[inline(always)]
    fn place(&self, map_from_base: &Se2) -> Placement {
        let table = self.table;
        let in_grid = table.grid_from_map.compose(map_from_base);
        // One cell of border, less the half that rounding adds to the cell's floor.
        let (x, y) = (in_grid.x() * table.cells_per_metre + 0.5, in_grid.y() * table.cells_per_metre + 0.5);
        let (cos, sin) = (in_grid.rotation().cos(), in_grid.rotation().sin());
        Placement { x: x as f32, y: y as f32, cos: cos as f32, sin: sin as f32 }
    }

    /// Where in the table the end points of a block lie.
    #[inline(always)]
    fn indices(&self, at: &Placement, [xs, ys]: &EndBlock) -> [u32; BLOCK] {
        let mut indices = [0_u32; BLOCK];
        for ((index, &bx), &by) in indices.iter_mut().zip(xs).zip(ys) {
            let column = whole(at.x + (at.cos * bx - at.sin * by), self.table.last[0]);
            let row = whole(at.y + (at.sin * bx + at.cos * by), self.table.last[1]);
            *index = row * self.table.stride + column;
        }
        indices
    }

    /// Sum of the table's entries at all end points.
    #[inline(always)]
    fn sum_of_terms(&self, map_from_base: &Se2) -> f64 {
        let (table, at) = (self.table, self.place(map_from_base));
        let mut lanes = [0.0_f32; 4];
        let mut left = self.hits;
        for block in self.ends {
            let indices = self.indices(&at, block);
            let count = left.min(BLOCK);
            left -= count;
            // Lanes by name, so that they stay in registers.
            let fours = indices[..count].chunks_exact(4);
            let rest = fours.remainder();
            for four in fours {
                lanes[0] += table.terms[four[0] as usize];
                lanes[1] += table.terms[four[1] as usize];
                lanes[2] += table.terms[four[2] as usize];
                lanes[3] += table.terms[four[3] as usize];
            }
            for (lane, &index) in lanes.iter_mut().zip(rest) {
                *lane += table.terms[index as usize];
            }
        }
        f64::from((lanes[0] + lanes[1]) + (lanes[2] + lanes[3]))
    }

    /// Number of end points near what the map shows.
    fn explained_hits(&self, map_from_base: &Se2) -> usize {
        let at = self.place(map_from_base);
        let indices = self.ends.iter().flat_map(|block| self.indices(&at, block));
        indices.take(self.hits).filter(|&index| self.table.terms[index as usize] >= self.table.explained).count()
    }
}

/// The nearest whole number in [0, last]; NaN gives 0.
#[inline(always)]
fn whole(value: f32, last: f32) -> u32 {
    // In this form each comparison is one instruction; `clamp` would keep NaN, at twice the price.
    let value = if value > 0.0 { value } else { 0.0 };
    let value = if value < last { value } else { last };
    (value + ROUNDER).to_bits() - ROUNDER.to_bits()
}

/// The work on a batch, compiled once for each instruction set.
struct Batch<'a, 'b> {
    scan: &'b ScanOnTable<'a>,
    poses: &'b [Se2],
    log_likelihoods: &'b mut [f64],
}

impl WithSimd for Batch<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (log_likelihood, pose) in self.log_likelihoods.iter_mut().zip(self.poses) {
            *log_likelihood = self.scan.judge(pose);
        }
    }
}

impl PoseLikelihood for ScanOnTable<'_> {
    fn log_likelihood(&self, map_from_base: &Se2) -> f64 {
        self.judge(map_from_base)
    }

    fn log_likelihoods(&self, poses: &[Se2], log_likelihoods: &mut [f64]) {
        self.arch.dispatch(Batch { scan: self, poses, log_likelihoods });
    }

    fn explained(&self, map_from_base: &Se2) -> Option<f64> {
        Some(self.explained_hits(map_from_base) as f64 / self.hits.max(1) as f64)
    }
}
