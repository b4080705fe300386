//! Rows of cells as runs of free and blocked ones.

use crate::grid::GridSpace;
use agv_core::grid::{Cell, CellRect, Revision};

/// Which cells are free, and from where to where the cells beside one are as it is.
#[derive(Debug, Clone, Default)]
pub(super) struct Runs {
    seen: Option<Revision>,
    width: i32,
    height: i32,
    free: Vec<bool>,
    /// First cell of the run, and the one after its last.
    ends: Vec<[i32; 2]>,
}

impl Runs {
    /// Takes the rows of a space that have changed, and says whether any has. Memory is used again.
    pub(super) fn update(&mut self, space: &GridSpace) -> bool {
        let Some(CellRect { min, max }) = space.follow(&mut self.seen) else { return false };
        let (width, height) = space.layout().map_or((0, 0), |layout| (layout.width(), layout.height()));
        if (width as i32, height as i32) != (self.width, self.height) {
            (self.width, self.height) = (width as i32, height as i32);
            self.free.clear();
            self.free.resize(width * height, false);
            self.ends.clear();
            self.ends.resize(width * height, [0; 2]);
        }
        for y in min.y as usize..=max.y as usize {
            let cells = y * width..(y + 1) * width;
            let (free, ends) = (&mut self.free[cells.clone()], &mut self.ends[cells.clone()]);
            for (free, node) in free.iter_mut().zip(cells) {
                *free = space.is_passable(node as u32);
            }
            let mut begin = 0;
            for run in free.chunk_by(|a, b| a == b) {
                let end = begin + run.len();
                ends[begin..end].fill([begin as i32, end as i32]);
                begin = end;
            }
        }
        true
    }

    /// Points of the lattice of cells' corners.
    pub(super) fn corner_count(&self) -> usize {
        (self.width as usize + 1) * (self.height as usize + 1)
    }

    /// Number of a corner of the lattice that belongs to the map.
    pub(super) fn corner_index(&self, corner: Cell) -> usize {
        corner.y as usize * (self.width as usize + 1) + corner.x as usize
    }

    #[inline]
    fn index(&self, x: i32, y: i32) -> Option<usize> {
        let inside = (0..self.width).contains(&x) && (0..self.height).contains(&y);
        inside.then(|| y as usize * self.width as usize + x as usize)
    }

    /// Whether the cell is free; outside the map none is.
    #[inline]
    pub(super) fn is_free(&self, x: i32, y: i32) -> bool {
        self.index(x, y).is_some_and(|index| self.free[index])
    }

    /// The run of a cell, and whether it is free; none outside the map.
    #[inline]
    pub(super) fn run(&self, x: i32, y: i32) -> Option<([i32; 2], bool)> {
        self.index(x, y).map(|index| (self.ends[index], self.free[index]))
    }

    /// The quadrant (signs of x and y) of the one blocked cell around a corner; none unless it is exactly one.
    #[inline]
    pub(super) fn lone_blocked(&self, corner: Cell) -> Option<[i32; 2]> {
        let mut lone = None;
        for [x, y] in [[-1, -1], [1, -1], [-1, 1], [1, 1]] {
            let cell = (corner.x + (x - 1) / 2, corner.y + (y - 1) / 2);
            if !self.is_free(cell.0, cell.1) && lone.replace([x, y]).is_some() {
                return None;
            }
        }
        lone
    }
}
