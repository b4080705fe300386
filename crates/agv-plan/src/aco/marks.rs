//! A set of cells that is emptied at no cost.

/// Cells that carry the current stamp.
#[derive(Debug, Clone, Default)]
pub(super) struct Marks {
    stamps: Vec<u32>,
    stamp: u32,
}

impl Marks {
    /// Empties the set, for a map of so many cells.
    pub(super) fn clear(&mut self, cells: usize) {
        if self.stamps.len() != cells || self.stamp == u32::MAX {
            self.stamps.clear();
            self.stamps.resize(cells, 0);
            self.stamp = 0;
        }
        self.stamp += 1;
    }

    #[inline]
    pub(super) fn insert(&mut self, node: u32) {
        if let Some(slot) = self.stamps.get_mut(node as usize) {
            *slot = self.stamp;
        }
    }

    #[inline]
    pub(super) fn contains(&self, node: u32) -> bool {
        self.stamps.get(node as usize).is_some_and(|&stamp| stamp == self.stamp)
    }
}
