//! Beam end points in a grid, many at a time.
//!
//! Turning end points and finding their cells is plain arithmetic on `f32` over fixed blocks, which the compiler vectorises
//! for the machine that it finds at run time; the bits do not depend on the instruction set.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use agv_core::geometry::{LieGroup, Se2};
use nalgebra::Vector2;

/// End points per block: two registers of the widest machines.
pub(super) const BLOCK: usize = 32;

/// Coordinates of a block of points, x and y apart.
pub(super) type PointBlock = [[f32; BLOCK]; 2];

/// End points in the base frame, in cells, padded to whole blocks.
#[derive(Debug, Clone, Default)]
pub(super) struct EndPoints {
    blocks: Vec<PointBlock>,
    len: usize,
}

impl EndPoints {
    /// None, with room for as many.
    pub(super) fn with_capacity(points: usize) -> Self {
        Self { blocks: Vec::with_capacity(points.min(1 << 12).div_ceil(BLOCK)), len: 0 }
    }

    pub(super) fn clear(&mut self) {
        self.blocks.clear();
        self.len = 0;
    }

    pub(super) fn push(&mut self, point: &Vector2<f64>) {
        let slot = self.len % BLOCK;
        if slot == 0 {
            self.blocks.push([[0.0; BLOCK]; 2]);
        }
        if let Some([x, y]) = self.blocks.last_mut() {
            (x[slot], y[slot]) = (point.x as f32, point.y as f32);
        }
        self.len += 1;
    }

    pub(super) const fn len(&self) -> usize {
        self.len
    }

    /// The blocks, each with the number of points that it holds.
    #[inline(always)]
    pub(super) fn blocks(&self) -> impl Iterator<Item = (&PointBlock, usize)> {
        self.blocks.iter().enumerate().map(|(k, block)| (block, (self.len - k * BLOCK).min(BLOCK)))
    }
}

/// Where a grid's cells lie, in `f32`.
#[derive(Debug)]
pub(super) struct Raster {
    pub(super) grid_from_map: Se2,
    pub(super) cells_per_metre: f64,
    pub(super) stride: u32,
    /// Greatest column and row.
    pub(super) last: [f32; 2],
}

/// A pose in the grid, in cells.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placement {
    x: f32,
    y: f32,
    cos: f32,
    sin: f32,
}

/// Adding 2²³ to a number in [0, 2²²] leaves its nearest whole number in the low bits of the sum.
const ROUNDER: f32 = 8_388_608.0;

impl Raster {
    /// The pose of a vehicle, for its end points.
    #[inline(always)]
    pub(super) fn place(&self, map_from_base: &Se2) -> Placement {
        let in_grid = self.grid_from_map.compose(map_from_base);
        let at: Vector2<f64> = in_grid.translation() * self.cells_per_metre;
        let (cos, sin) = (in_grid.rotation().cos(), in_grid.rotation().sin());
        Placement { x: at.x as f32, y: at.y as f32, cos: cos as f32, sin: sin as f32 }
    }

    /// Index of the cell whose lower left corner lies nearest to each point; for points that are not in the grid, or no
    /// numbers, of one at its edge.
    #[inline(always)]
    pub(super) fn nearest_corners(&self, [xs, ys]: &PointBlock) -> [u32; BLOCK] {
        let mut indices = [0; BLOCK];
        for ((index, &x), &y) in indices.iter_mut().zip(xs).zip(ys) {
            *index = whole(y, self.last[1]) * self.stride + whole(x, self.last[0]);
        }
        indices
    }
}

impl Placement {
    /// The points of a block seen from the grid, moved by `shift` cells along both axes.
    #[inline(always)]
    pub(super) fn act(&self, [xs, ys]: &PointBlock, shift: f32) -> PointBlock {
        let (x, y) = (self.x + shift, self.y + shift);
        let mut moved = [[0.0; BLOCK]; 2];
        for k in 0..BLOCK {
            moved[0][k] = x + (self.cos * xs[k] - self.sin * ys[k]);
            moved[1][k] = y + (self.sin * xs[k] + self.cos * ys[k]);
        }
        moved
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
