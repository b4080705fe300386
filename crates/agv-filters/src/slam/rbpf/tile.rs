//! A square of map cells, the unit that particles share.
//!
//! A cell counts the beams that ended in it and those that passed, and keeps the mean of the ends: a surface to a fraction of a
//! cell, as GMapping has it. Beside that it keeps the normal of the surface there, which [`surface`](super::surface) finds from the
//! neighbours. A bit per cell says where surfaces are, so that a look around a place costs a few words and not dozens of cells.

use nalgebra::Vector2;

/// Cells along the edge of a tile: the bits of a word.
pub(super) const TILE: i32 = 32;
/// Binary logarithm of [`TILE`].
pub(super) const TILE_BITS: u32 = 5;
/// Cells of a tile.
pub(super) const TILE_CELLS: usize = (TILE * TILE) as usize;

/// Evidence of an end and of a passing beam, in units of [`QUANTUM`](agv_core::grid::QUANTUM): probabilities of 0.8 and 0.45, the
/// defaults of [`InverseModelParams`](agv_core::grid::InverseModelParams). A cell is a surface if more than one of eight beams end there.
pub(super) const HIT: i32 = 355;
pub(super) const MISS: i32 = -51;

/// Parts of a cell that a mean counts in.
const PARTS: f64 = 65_536.0;

/// Parts of a unit vector that a normal counts in.
const UNIT: f64 = 32_767.0;

/// What a map knows of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct MapCell {
    /// Beams that ended here.
    pub(super) hits: u16,
    /// Beams that passed.
    pub(super) passes: u16,
    /// Mean of the ends from the cell's lower-left, in 65536ths of its edge.
    pub(super) mean: [u16; 2],
    /// Normal of the surface, in 32767ths; zero where the neighbours are on no line.
    pub(super) normal: [i16; 2],
}

impl MapCell {
    /// Log-odds of occupancy, in units of [`QUANTUM`](agv_core::grid::QUANTUM); none of a cell that no beam has met.
    #[inline]
    pub(super) fn evidence(&self) -> Option<i32> {
        let sum = i32::from(self.hits) * HIT + i32::from(self.passes) * MISS;
        (self.hits > 0 || self.passes > 0).then_some(sum)
    }

    /// Whether there is a surface here.
    #[inline]
    pub(super) fn is_surface(&self) -> bool {
        i32::from(self.hits) * HIT > i32::from(self.passes) * -MISS
    }

    /// Mean of the ends from the cell's lower-left, in cells.
    #[inline]
    pub(super) fn mean(&self) -> Vector2<f64> {
        Vector2::new(f64::from(self.mean[0]), f64::from(self.mean[1])) * (1.0 / PARTS)
    }

    /// Unit normal of the surface; zero where there is none.
    #[inline]
    pub(super) fn normal(&self) -> Vector2<f64> {
        Vector2::new(f64::from(self.normal[0]), f64::from(self.normal[1])) * (1.0 / UNIT)
    }

    /// Sets the unit normal, or zero for none.
    pub(super) fn set_normal(&mut self, normal: &Vector2<f64>) {
        self.normal = [normal.x, normal.y].map(|v| (v * UNIT).round() as i16);
    }

    /// A beam passed.
    #[inline]
    fn pass(&mut self) {
        if self.passes == u16::MAX {
            self.halve();
        }
        self.passes += 1;
    }

    /// A beam ended here, this far from the cell's lower-left, in cells.
    fn hit(&mut self, within: &Vector2<f64>) {
        if self.hits == u16::MAX {
            self.halve();
        }
        self.hits += 1;
        for (mean, end) in self.mean.iter_mut().zip(within.iter()) {
            let (end, count) = ((end * PARTS).clamp(0.0, PARTS - 1.0) as i32, i32::from(self.hits));
            let off = end - i32::from(*mean);
            // Rounded to the nearest, so that the mean is not drawn to one side.
            *mean = (i32::from(*mean) + (2 * off + count * off.signum()) / (2 * count)) as u16;
        }
    }

    /// Keeps the share of hits where a count is full.
    fn halve(&mut self) {
        (self.hits, self.passes) = (self.hits / 2, self.passes / 2);
    }
}

/// A square of cells, row by row from the lower-left.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Tile {
    cells: [MapCell; TILE_CELLS],
    /// A bit per cell with a surface.
    rows: [u32; TILE as usize],
}

impl Default for Tile {
    fn default() -> Self {
        Self { cells: [MapCell::default(); TILE_CELLS], rows: [0; TILE as usize] }
    }
}

/// Place of a cell in its tile.
#[inline]
const fn place(x: i32, y: i32) -> usize {
    ((y & (TILE - 1)) << TILE_BITS | (x & (TILE - 1))) as usize
}

impl Tile {
    /// A tile of these cells, which are as many as a tile has.
    #[cfg(feature = "serde")]
    pub(super) fn from_cells(cells: &[MapCell]) -> Option<Self> {
        let mut tile = Self { cells: cells.try_into().ok()?, rows: [0; TILE as usize] };
        for (x, y) in (0..TILE).flat_map(|y| (0..TILE).map(move |x| (x, y))) {
            tile.mark(x, y);
        }
        Some(tile)
    }

    /// All cells.
    pub(super) const fn cells(&self) -> &[MapCell; TILE_CELLS] {
        &self.cells
    }

    /// The cell at these coordinates, of which the low bits count.
    #[inline]
    pub(super) const fn cell(&self, x: i32, y: i32) -> &MapCell {
        &self.cells[place(x, y)]
    }

    /// Where surfaces are in a row: a bit per column.
    #[inline]
    pub(super) const fn row(&self, y: i32) -> u32 {
        self.rows[(y & (TILE - 1)) as usize]
    }

    /// A beam passed.
    #[inline]
    pub(super) fn pass(&mut self, x: i32, y: i32) {
        let cell = &mut self.cells[place(x, y)];
        cell.pass();
        if cell.hits > 0 {
            self.mark(x, y);
        }
    }

    /// A beam ended, this far from the cell's lower-left, in cells.
    pub(super) fn hit(&mut self, x: i32, y: i32, within: &Vector2<f64>) {
        self.cells[place(x, y)].hit(within);
        self.mark(x, y);
    }

    /// Sets the normal of a cell's surface.
    pub(super) fn set_normal(&mut self, x: i32, y: i32, normal: &Vector2<f64>) {
        self.cells[place(x, y)].set_normal(normal);
    }

    /// Keeps the bit of a cell true.
    fn mark(&mut self, x: i32, y: i32) {
        let bit = 1 << (x & (TILE - 1));
        let row = &mut self.rows[(y & (TILE - 1)) as usize];
        *row = if self.cells[place(x, y)].is_surface() { *row | bit } else { *row & !bit };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::grid::{InverseModel, InverseModelParams};

    #[test]
    fn evidence_is_that_of_the_mapping_grid() {
        let model = InverseModel::new(InverseModelParams::default()).unwrap();
        assert_eq!((HIT, MISS), (model.hit(), model.free()));
    }

    #[test]
    fn the_mean_is_that_of_the_ends_and_the_bit_that_of_the_cell() {
        let mut tile = Tile::default();
        let ends = [(0.2, 0.9), (0.4, 0.7), (0.3, 0.8), (0.9, 0.1)].map(|(x, y)| Vector2::new(x, y));
        for end in &ends {
            tile.hit(33, -1, end);
        }
        assert!((tile.cell(1, 31).mean() - ends.iter().sum::<Vector2<f64>>() / 4.0).amax() < 1e-4);
        assert_eq!(tile.row(31), 2);
        // Seven passing beams outweigh one that ends, nearly: 28 outweigh four.
        for passes in 0..28 {
            assert_eq!(tile.row(-1), 2, "{passes}");
            tile.pass(1, 31);
        }
        assert_eq!(tile.row(-1), 0);
        assert_eq!(tile.cell(1, 31).evidence(), Some(4 * HIT + 28 * MISS));
        assert_eq!(tile.cell(2, 31).evidence(), None);
    }

    #[test]
    fn full_counts_keep_their_share() {
        let mut cell = MapCell { hits: 20_000, passes: u16::MAX, ..MapCell::default() };
        cell.pass();
        assert_eq!((cell.hits, cell.passes), (10_000, 32_768));
        let mut cell = MapCell { hits: u16::MAX, mean: [100, 65_535], ..MapCell::default() };
        (0..70_000).for_each(|_| cell.hit(&Vector2::new(0.5, 1.5)));
        assert!(cell.hits > 30_000 && cell.mean[0].abs_diff(32_768) < 30_000 && cell.mean[1] == 65_535);
    }

    #[test]
    fn normals_come_back() {
        let mut tile = Tile::default();
        let normal = Vector2::new(0.6, -0.8);
        tile.set_normal(3, 4, &normal);
        assert!((tile.cell(3, 4).normal() - normal).amax() < 1e-4);
    }
}
