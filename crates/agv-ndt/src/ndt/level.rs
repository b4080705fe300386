//! The distributions of a map in voxels of its resolution or a power of two of it, laid out for look-ups.

use super::gaussian::WideSums;
use super::map::{Moments, NdtMap};
use crate::cells::{CellTable, pack, pack_within};

/// A distribution as the inner loop wants it: one cache line.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(64))]
pub(crate) struct Voxel {
    /// Mean from the voxel's corner, in metres: `f32` keeps its digits far from the origin.
    pub(crate) mean: [f32; 3],
    /// Inverse covariance: xx, xy, xz, yy, yz, zz.
    pub(crate) information: [f32; 6],
}

/// All distributions of one voxel size.
#[derive(Debug, Clone, Default)]
pub(crate) struct Level {
    pub(crate) edge: f64,
    table: CellTable,
    voxels: Vec<Voxel>,
    /// Buffers of the merge.
    merged: CellTable,
    cells: Vec<[i32; 3]>,
    sums: Vec<WideSums>,
    touched: Vec<u32>,
}

impl Level {
    /// Takes the distributions of a map in voxels of `2^doublings` times its resolution, six doublings at most; the memory is used
    /// again. The sums are merged exactly, so that the result does not depend on the order in which the map met its voxels, but for
    /// the order of the list.
    pub(crate) fn rebuild(&mut self, map: &NdtMap, doublings: u32) {
        let unit = map.params().resolution;
        self.edge = unit * f64::from(1_u32 << doublings);
        self.table.clear();
        self.voxels.clear();
        if doublings == 0 {
            for (cell, sums) in map.voxels() {
                put(&mut self.table, &mut self.voxels, cell, map.distribution(sums.count(), || sums.moments(), unit));
            }
            return;
        }
        self.merged.clear();
        self.cells.clear();
        self.sums.clear();
        self.merge(map, doublings);
        for (cell, sums) in self.cells.iter().zip(&self.sums) {
            put(&mut self.table, &mut self.voxels, *cell, map.distribution(sums.count(), || sums.moments(), unit));
        }
    }

    /// Takes what a map has gained by another that was merged into it, where `rebuild` has taken the rest: linear in the voxels of
    /// `added`, and the same to the bit as all anew, but for the order of the list.
    pub(crate) fn update(&mut self, map: &NdtMap, added: &NdtMap, doublings: u32) {
        let unit = map.params().resolution;
        if doublings == 0 {
            for (cell, sums) in added.voxels().filter_map(|(cell, _)| Some((cell, map.sums(cell)?))) {
                put(&mut self.table, &mut self.voxels, cell, map.distribution(sums.count(), || sums.moments(), unit));
            }
            return;
        }
        self.merge(added, doublings);
        self.touched.sort_unstable();
        self.touched.dedup();
        for &index in &self.touched {
            // They are places in both lists.
            let (cell, sums) = (self.cells[index as usize], &self.sums[index as usize]);
            put(&mut self.table, &mut self.voxels, cell, map.distribution(sums.count(), || sums.moments(), unit));
        }
    }

    /// Adds the voxels of a map to the sums of the coarse ones that they lie in, and notes which these are.
    fn merge(&mut self, map: &NdtMap, doublings: u32) {
        self.touched.clear();
        for (cell, sums) in map.voxels() {
            let coarse = cell.map(|index| index >> doublings);
            let shift = cell.map(|index| (index & ((1 << doublings) - 1)) as u64);
            let next = self.sums.len() as u32;
            let index = self.merged.get_or_insert(pack_within(coarse), next);
            if index == next {
                self.cells.push(coarse);
                self.sums.push(WideSums::default());
            }
            self.sums[index as usize].add(sums, shift);
            self.touched.push(index);
        }
    }

    /// The distribution of a voxel; `None` out of reach.
    #[inline]
    pub(crate) fn get(&self, cell: [i32; 3]) -> Option<&Voxel> {
        self.voxels.get(self.table.get(pack(cell)?)? as usize)
    }
}

/// Puts a distribution in its voxel's place, or behind all if it has none yet.
fn put(table: &mut CellTable, voxels: &mut Vec<Voxel>, cell: [i32; 3], moments: Option<Moments>) {
    let Some(moments) = moments else { return };
    let i = &moments.information;
    let voxel = Voxel {
        mean: [moments.mean.x as f32, moments.mean.y as f32, moments.mean.z as f32],
        information: [i.m11, i.m12, i.m13, i.m22, i.m23, i.m33].map(|entry| entry as f32),
    };
    let next = voxels.len() as u32;
    let index = table.get_or_insert(pack_within(cell), next);
    if index == next {
        voxels.push(voxel);
    } else {
        voxels[index as usize] = voxel;
    }
}
