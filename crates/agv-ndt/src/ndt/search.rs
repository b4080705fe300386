//! Which distributions a point feels.

use super::kernel::{Block, CHUNK, LANES};
use super::level::Level;
use crate::cells::CellTable;
use agv_core::compute::Par;

/// Which distributions around a point count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum VoxelSearch {
    /// That of the point's own voxel.
    Direct1,
    /// Those of the point's voxel and of the six that share a face with it.
    Direct7,
    /// Those of the eight voxels around the corner that is nearest to the point: as fast as seven, and steadier, since a voxel joins
    /// and leaves a full edge from its centre. With seven the score jumps where a point crosses a face, and has false optima there.
    #[default]
    Direct8,
    /// Those of the point's voxel and of all 26 around it.
    Direct27,
    /// Those whose mean is no farther than an edge: what a radius search in a kd-tree of the means gives.
    Radius,
}

impl VoxelSearch {
    /// Offsets of the voxels that are looked at.
    fn offsets(self) -> &'static [[i32; 3]] {
        match self {
            Self::Direct1 => &OFFSETS[..1],
            Self::Direct7 => &OFFSETS[..7],
            Self::Direct8 => &CORNER,
            Self::Direct27 | Self::Radius => &OFFSETS,
        }
    }

    /// Blocks that hold them.
    pub(super) const fn blocks(self) -> usize {
        match self {
            Self::Direct1 | Self::Direct7 | Self::Direct8 => 1,
            Self::Direct27 | Self::Radius => MAX_BLOCKS,
        }
    }

    /// What is taken off a point's place, in edges, before its voxel is looked up.
    pub(super) const fn shift(self) -> f32 {
        match self {
            Self::Direct8 => 0.5,
            _ => 0.0,
        }
    }

    /// Distance beyond which a mean does not count, in edges.
    pub(super) const fn reach(self) -> f64 {
        match self {
            Self::Radius => 1.0,
            _ => f64::INFINITY,
        }
    }
}

/// The voxel itself, those that share a face, an edge, and a corner with it.
#[rustfmt::skip]
const OFFSETS: [[i32; 3]; 27] = [
    [0, 0, 0],
    [-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1],
    [-1, -1, 0], [-1, 1, 0], [1, -1, 0], [1, 1, 0], [-1, 0, -1], [-1, 0, 1],
    [1, 0, -1], [1, 0, 1], [0, -1, -1], [0, -1, 1], [0, 1, -1], [0, 1, 1],
    [-1, -1, -1], [-1, -1, 1], [-1, 1, -1], [-1, 1, 1], [1, -1, -1], [1, -1, 1], [1, 1, -1], [1, 1, 1],
];

/// The voxels around a corner, from the lowest.
const CORNER: [[i32; 3]; 8] = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]];

/// Blocks for 27 distributions.
pub(super) const MAX_BLOCKS: usize = 27_usize.div_ceil(LANES);

/// The voxel has not been looked at yet.
pub(super) const UNKNOWN: u32 = u32::MAX;

/// Blocks of the voxels that points have met, made once and kept: points move little between evaluations.
#[derive(Debug, Clone, Default)]
pub(super) struct Surroundings {
    /// Voxel that coordinates are relative to.
    pub(super) origin: [i32; 3],
    /// Numbers of the voxels that were entered, and their cells from the origin.
    table: CellTable,
    cells: Vec<[i32; 3]>,
    /// As many for each voxel as the search needs; behind the last voxel's they are stale.
    blocks: Vec<Block>,
    filled: usize,
}

impl Surroundings {
    /// Forgets all voxels; the memory stays.
    pub(super) fn clear(&mut self, origin: [i32; 3]) {
        self.origin = origin;
        self.table.clear();
        self.cells.clear();
        self.filled = 0;
    }

    /// Number of a voxel, by its key from the origin; [`UNKNOWN`] if it was not entered.
    #[inline]
    pub(super) fn number(&self, key: u64) -> u32 {
        self.table.get(key).unwrap_or(UNKNOWN)
    }

    /// The blocks of a voxel, by its number.
    #[inline]
    pub(super) fn blocks(&self, number: u32, search: VoxelSearch) -> &[Block] {
        let (first, count) = (number as usize * search.blocks(), search.blocks());
        self.blocks.get(first..first + count).unwrap_or_default()
    }

    /// The blocks of a voxel, given from the origin, by its number; made in `own` for one that was not entered.
    #[inline]
    pub(super) fn blocks_or_own<'a>(
        &'a self,
        level: &Level,
        search: VoxelSearch,
        (cell, number): ([i32; 3], u32),
        own: &'a mut [Block; MAX_BLOCKS],
    ) -> &'a [Block] {
        if number != UNKNOWN {
            return self.blocks(number, search);
        }
        let own = &mut own[..search.blocks()];
        own.fill(Block::default());
        gather(level, search, self.origin, cell, own);
        own
    }

    /// Enters a voxel, given from the origin, if it is new, and says its number; its blocks are made by [`fill`](Self::fill).
    #[inline]
    pub(super) fn enter(&mut self, cell: [i32; 3], key: u64) -> u32 {
        let next = self.cells.len() as u32;
        let number = self.table.get_or_insert(key, next);
        if number == next {
            self.cells.push(cell);
        }
        number
    }

    /// Makes the blocks of the voxels that were entered since the last time.
    pub(super) fn fill(&mut self, level: &Level, search: VoxelSearch, par: Par) {
        let (each, origin) = (search.blocks(), self.origin);
        if self.blocks.len() < self.cells.len() * each {
            self.blocks.resize(self.cells.len() * each, Block::default());
        }
        let new = self.filled * each..self.cells.len() * each;
        let cells = &self.cells[self.filled..];
        par.for_each_chunk(&mut self.blocks[new], CHUNK * each, |chunk, blocks| {
            for (blocks, cell) in blocks.chunks_mut(each).zip(&cells[chunk * CHUNK..]) {
                blocks.fill(Block::default());
                gather(level, search, origin, *cell, blocks);
            }
        });
        self.filled = self.cells.len();
    }
}

/// Puts the distributions around a voxel, given from the origin, side by side in empty blocks, as many as the search needs.
fn gather(level: &Level, search: VoxelSearch, origin: [i32; 3], cell: [i32; 3], blocks: &mut [Block]) {
    let mut found = 0;
    for offset in search.offsets() {
        let near = [cell[0] + offset[0], cell[1] + offset[1], cell[2] + offset[2]];
        let absolute = [0, 1, 2].map(|axis| near[axis].saturating_add(origin[axis]));
        let Some(voxel) = level.get(absolute) else { continue };
        // As many as the search has at most, so the block exists.
        let (block, lane) = (&mut blocks[found / LANES], found % LANES);
        for ((mean, from_corner), index) in block.mean.iter_mut().zip(voxel.mean).zip(near) {
            mean[lane] = index as f32 * level.edge as f32 + from_corner;
        }
        for (entry, value) in block.information.iter_mut().zip(voxel.information) {
            entry[lane] = value;
        }
        block.weight[lane] = 1.0;
        found += 1;
    }
}
