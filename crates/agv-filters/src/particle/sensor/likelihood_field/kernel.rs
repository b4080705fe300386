//! The work per particle and beam: turn the end point, round it to a cell, look up its level.
//!
//! A beam is laid at a block of poses side by side: the way to the cells is plain arithmetic on `f32`, which the compiler
//! vectorises for the machine that it finds at run time, and the cells that one beam reaches from neighbouring poses lie
//! near each other, so that the look-ups, which are scalar, stay in the first-level cache. The sums are whole numbers, the
//! same in any order: the bits depend neither on where a pose stands in a batch nor on the instruction set.
//!
//! Cells off the map are those of a border of the table: a coordinate is held to it by two comparisons, which are left out
//! where the whole block is so far inside that no end point can leave the map.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::table::Table;
use crate::particle::{PoseLikelihood, ScanForm};
use agv_core::geometry::{LieGroup, Se2};
use pulp::{Arch, Simd, WithSimd};

/// Poses that a beam is laid at together.
const BLOCK: usize = 64;

/// The same for what is left of a batch.
const TAIL: usize = 16;

/// Beams that are looked up together.
pub(super) const GROUP: usize = 4;

/// Adding 2²³ to a number in [0, 2²²] leaves its nearest whole number in the low bits of the sum.
const ROUNDER: f32 = 8_388_608.0;

/// Bits of a cell's coordinate, and of the table's stride: a product of two such numbers is one instruction everywhere.
pub(super) const COORDINATE_BITS: u32 = 15;
const COORDINATE: u32 = (1 << COORDINATE_BITS) - 1;

/// End points of a few beams in the base frame, in cells.
#[derive(Debug, Clone, Copy)]
struct EndGroup {
    x: [f32; GROUP],
    y: [f32; GROUP],
    /// No end point is farther from the base than this, with some margin.
    reach: f32,
}

/// End points of the beams of a scan.
#[derive(Debug, Clone)]
pub(super) struct EndPoints {
    /// Padded to whole groups.
    groups: Vec<EndGroup>,
    count: usize,
}

impl EndPoints {
    pub(super) fn with_capacity(beams: usize) -> Self {
        Self { groups: Vec::with_capacity(beams.div_ceil(GROUP)), count: 0 }
    }

    pub(super) const fn len(&self) -> usize {
        self.count
    }

    /// The end points, in the base frame, in cells.
    pub(super) fn iter(&self) -> impl Iterator<Item = (f32, f32)> + Clone + '_ {
        self.groups.iter().flat_map(|group| group.x.into_iter().zip(group.y)).take(self.count)
    }

    /// The end points by groups, `(x, y, how many of them are end points)`.
    #[inline(always)]
    pub(super) fn groups(&self) -> impl Iterator<Item = (&[f32; GROUP], &[f32; GROUP], usize)> {
        let counts = (0..self.count).step_by(GROUP).map(|first| (self.count - first).min(GROUP));
        self.groups.iter().zip(counts).map(|(group, count)| (&group.x, &group.y, count))
    }

    pub(super) fn clear(&mut self) {
        self.groups.clear();
        self.count = 0;
    }

    /// Adds an end point in the base frame, in cells.
    pub(super) fn push(&mut self, x: f32, y: f32) {
        let place = self.count % GROUP;
        if place == 0 {
            self.groups.push(EndGroup { x: [0.0; GROUP], y: [0.0; GROUP], reach: 0.0 });
        }
        if let Some(group) = self.groups.last_mut() {
            (group.x[place], group.y[place]) = (x, y);
            // The margin covers the rounding of all that follows.
            group.reach = group.reach.max((x * x + y * y).sqrt() * 1.01 + 1.0);
        }
        self.count += 1;
    }
}

/// A scan, ready to judge poses.
pub(super) struct ScanOnTable<'a> {
    table: &'a Table,
    ends: &'a EndPoints,
    form: ScanForm,
    /// What the sum of a product's logarithms is multiplied by.
    power: f64,
    arch: Arch,
}

/// Poses in the grid, in cells.
struct Block<const P: usize> {
    x: [f32; P],
    y: [f32; P],
    cos: [f32; P],
    sin: [f32; P],
    /// End points of this reach stay on the map; negative or NaN if that cannot be told.
    room: f32,
}

impl<const P: usize> Block<P> {
    /// Places poses, at most `P`; what is left over stands at the grid's origin.
    #[inline(always)]
    fn new(table: &Table, poses: &[Se2]) -> Self {
        let mut block = Self { x: [0.0; P], y: [0.0; P], cos: [1.0; P], sin: [0.0; P], room: -1.0 };
        let position = block.x.iter_mut().zip(&mut block.y);
        let rotation = block.cos.iter_mut().zip(&mut block.sin);
        for ((pose, (x, y)), (cos, sin)) in poses.iter().zip(position).zip(rotation) {
            let in_grid = table.grid_from_map.compose(pose);
            // One cell of border, less the half that rounding adds to the cell's floor.
            *x = (in_grid.x() * table.cells_per_metre + 0.5) as f32;
            *y = (in_grid.y() * table.cells_per_metre + 0.5) as f32;
            *cos = in_grid.rotation().cos() as f32;
            *sin = in_grid.rotation().sin() as f32;
        }
        if poses.len() == P {
            block.room = block.room_on(table);
        }
        block
    }

    /// Distance from all poses to the edge of the table.
    #[inline(always)]
    fn room_on(&self, table: &Table) -> f32 {
        // As whole numbers, the bits of floats have the floats' order above zero; what is below zero is below there too, and
        // what is not a number comes out at an end, as one that fails every comparison.
        let order = |value: f32| value.to_bits() as i32;
        let (mut low, mut high, mut norm) = ([i32::MAX; 2], [i32::MIN; 2], i32::MIN);
        for lane in 0..P {
            let (x, y, cos, sin) = (self.x[lane], self.y[lane], self.cos[lane], self.sin[lane]);
            low = [low[0].min(order(x)), low[1].min(order(y))];
            high = [high[0].max(order(x)), high[1].max(order(y))];
            // What is not a number may carry a sign.
            norm = norm.max(order((cos * cos + sin * sin).abs()));
        }
        let [low, high] = [low, high].map(|bounds| bounds.map(|bits| f32::from_bits(bits as u32)));
        let spans = [low[0], low[1], table.last[0] - high[0], table.last[1] - high[1]];
        let is_rotation = f32::from_bits(norm as u32) <= 1.001;
        spans.into_iter().fold(if is_rotation { f32::INFINITY } else { -1.0 }, |room, span| {
            if room <= span {
                room
            } else if span < room {
                span
            } else {
                // One of them is not a number, which `min` would pass over.
                f32::NAN
            }
        })
    }

    /// Where in the table an end point lies, from each pose.
    #[inline(always)]
    fn indices<const INSIDE: bool>(&self, table: &Table, end_x: f32, end_y: f32, indices: &mut [u32; P]) {
        let stride = table.stride & COORDINATE;
        for (lane, index) in indices.iter_mut().enumerate() {
            let (cos, sin) = (self.cos[lane], self.sin[lane]);
            let column = self.x[lane] + (cos * end_x - sin * end_y);
            let row = self.y[lane] + (sin * end_x + cos * end_y);
            let (column, row) = if INSIDE {
                (rounded(column), rounded(row))
            } else {
                (rounded(held(column, table.last[0])), rounded(held(row, table.last[1])))
            };
            // Both below 2¹⁵, and said so.
            *index = (row & COORDINATE) * stride + column.wrapping_sub(ROUNDER.to_bits());
        }
    }

    /// Adds the terms of `G` beams, the first of a group or the one at `first`, to each pose's sum.
    #[inline(always)]
    fn add_terms<const G: usize>(&self, table: &Table, group: &EndGroup, first: usize, sums: &mut [u32; P]) {
        let mut indices = [[0_u32; P]; G];
        if group.reach < self.room {
            for (g, indices) in indices.iter_mut().enumerate() {
                self.indices::<true>(table, group.x[first + g], group.y[first + g], indices);
            }
        } else {
            for (g, indices) in indices.iter_mut().enumerate() {
                self.indices::<false>(table, group.x[first + g], group.y[first + g], indices);
            }
        }
        let terms = &table.coarse[..];
        for (lane, sum) in sums.iter_mut().enumerate() {
            for indices in &indices {
                *sum += u32::from(terms[indices[lane] as usize]);
            }
        }
    }
}

/// Held to [0, last]; NaN gives 0.
#[inline(always)]
fn held(value: f32, last: f32) -> f32 {
    // In this form each comparison is one instruction; `clamp` would keep NaN, at twice the price.
    let value = if value > 0.0 { value } else { 0.0 };
    if value < last { value } else { last }
}

/// The nearest whole number in the low bits, and those of [`ROUNDER`] above.
#[inline(always)]
fn rounded(value: f32) -> u32 {
    (value + ROUNDER).to_bits()
}

impl<'a> ScanOnTable<'a> {
    pub(super) fn new(table: &'a Table, ends: &'a EndPoints, form: ScanForm, arch: Arch) -> Self {
        Self { table, ends, form, power: form.power(ends.len()), arch }
    }

    /// Judges at most `P` poses.
    #[inline(always)]
    fn judge<const P: usize>(&self, poses: &[Se2], log_likelihoods: &mut [f64]) {
        let block = Block::<P>::new(self.table, poses);
        let mut sums = [0_u32; P];
        let (full, rest) = self.ends.groups.split_at(self.ends.count / GROUP);
        for group in full {
            block.add_terms::<GROUP>(self.table, group, 0, &mut sums);
        }
        for group in rest {
            for beam in 0..self.ends.count % GROUP {
                block.add_terms::<1>(self.table, group, beam, &mut sums);
            }
        }
        for (log_likelihood, &sum) in log_likelihoods.iter_mut().zip(&sums) {
            let sum = self.table.sum_of_coarse(sum, self.ends.count);
            *log_likelihood = match self.form {
                ScanForm::Product { .. } => self.power * sum,
                ScanForm::SumOfCubes => sum.ln_1p(),
            };
        }
    }

    /// Number of end points near what the map shows.
    fn explained_hits(&self, map_from_base: &Se2) -> usize {
        let block = Block::<1>::new(self.table, std::slice::from_ref(map_from_base));
        let mut index = [0];
        self.ends
            .iter()
            .filter(|&(x, y)| {
                block.indices::<false>(self.table, x, y, &mut index);
                u32::from(self.table.terms[index[0] as usize]) >= self.table.explained
            })
            .count()
    }
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
        let whole = self.poses.len().min(self.log_likelihoods.len()) / BLOCK * BLOCK;
        let (poses, rest) = self.poses.split_at(whole);
        let (log_likelihoods, rest_of_log_likelihoods) = self.log_likelihoods.split_at_mut(whole);
        for (poses, log_likelihoods) in poses.chunks_exact(BLOCK).zip(log_likelihoods.chunks_exact_mut(BLOCK)) {
            self.scan.judge::<BLOCK>(poses, log_likelihoods);
        }
        for (poses, log_likelihoods) in rest.chunks(TAIL).zip(rest_of_log_likelihoods.chunks_mut(TAIL)) {
            self.scan.judge::<TAIL>(poses, log_likelihoods);
        }
    }
}

impl PoseLikelihood for ScanOnTable<'_> {
    fn log_likelihood(&self, map_from_base: &Se2) -> f64 {
        let mut log_likelihood = [0.0];
        self.judge::<1>(std::slice::from_ref(map_from_base), &mut log_likelihood);
        log_likelihood[0]
    }

    fn log_likelihoods(&self, poses: &[Se2], log_likelihoods: &mut [f64]) {
        self.arch.dispatch(Batch { scan: self, poses, log_likelihoods });
    }

    fn explained(&self, map_from_base: &Se2) -> Option<f64> {
        Some(self.explained_hits(map_from_base) as f64 / self.ends.len().max(1) as f64)
    }
}
