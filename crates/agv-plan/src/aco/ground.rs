//! The ground under an ant: which neighbours it can still step to.

use crate::grid::GridSpace;
use agv_core::grid::GridLayout;

/// Open steps of every cell that lead to where an ant has not been.
///
/// An ant that enters a cell closes the steps to it in the eight cells around: to look for a way on is then one byte.
#[derive(Debug, Clone, Default)]
pub(super) struct Ground {
    /// A mask per cell, with room before and after for the neighbours of the first and last row.
    open: Vec<u8>,
    /// Cells before the first one.
    guard: usize,
    width: usize,
}

impl Ground {
    /// Takes another map, all open.
    pub(super) fn prepare(&mut self, space: &GridSpace) {
        self.width = space.layout().map_or(0, GridLayout::width);
        self.guard = self.width + 1;
        self.open.clear();
        self.open.resize(self.guard, 0);
        self.open.extend_from_slice(space.masks());
        self.open.resize(self.open.len() + self.guard + 1, 0);
    }

    /// Opens all steps again: a copy of a byte per cell.
    pub(super) fn restore(&mut self, masks: &[u8]) {
        if let Some(open) = self.open.get_mut(self.guard..self.guard + masks.len()) {
            open.copy_from_slice(masks);
        }
    }

    /// Enters a cell: nobody steps there again.
    #[inline]
    pub(super) fn tread(&mut self, node: u32) {
        let below = node as usize;
        let (beside, above) = (below + self.width, below + 2 * self.width);
        // The bits of the steps from the eight cells around to this one. At the edges of the map some are those of cells at
        // the other edge, whose steps that way are closed anyway.
        for (row, closed) in [(below, [0x10, 0x02, 0x20]), (beside, [0x01, 0x00, 0x04]), (above, [0x80, 0x08, 0x40])] {
            if let Some(cells) = self.open.get_mut(row..row + 3) {
                for (cell, bits) in cells.iter_mut().zip(closed) {
                    *cell &= !bits;
                }
            }
        }
    }

    /// Steps from a cell to where the ant has not been.
    #[inline]
    pub(super) fn open(&self, node: u32) -> u8 {
        self.open.get(node as usize + self.guard).copied().unwrap_or(0)
    }
}
