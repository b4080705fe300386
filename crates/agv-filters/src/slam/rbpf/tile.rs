//! A square of map cells, the unit that particles share.
//!
//! A cell counts the beams that passed; a cell in which beams ended counts these too, and keeps the mean of the ends: a surface to a
//! fraction of a cell, as `GMapping` has it, and its normal, which [`insert`](super::insert) fits to the neighbours. Few cells have any
//! end, so that these are kept apart, in the order of the cells, and found by counting bits: a tile takes 2.3 kB and 10 bytes for each
//! of them. Another bit per cell says where surfaces are, so that a look around a place costs a few words and not dozens of cells.

use nalgebra::Vector2;

/// Cells along the edge of a tile: the bits of a word.
pub(super) const TILE: i32 = 32;
/// Binary logarithm of [`TILE`].
pub(super) const TILE_BITS: u32 = 5;
/// Cells of a tile.
pub(super) const TILE_CELLS: usize = (TILE * TILE) as usize;

/// Evidence of an end and of a passing beam, in units of [`QUANTUM`](agv_core::grid::QUANTUM): probabilities of 0.8 and 0.45, the
/// defaults of [`InverseModelParams`](agv_core::grid::InverseModelParams). A cell is a surface if more than one of eight beams end there.
const HIT: i32 = 355;
const MISS: i32 = -51;

/// Parts of a cell that a mean counts in.
const PARTS: f64 = 65_536.0;

/// Parts of a unit vector that a normal counts in.
const UNIT: f64 = 32_767.0;

/// The beams that ended in a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Ends {
    /// How many there were.
    count: u16,
    /// Their mean from the cell's lower-left, in 65536ths of its edge.
    mean: [u16; 2],
    /// Normal of the surface, in 32767ths; zero where the neighbours are on no line.
    normal: [i16; 2],
}

impl Ends {
    /// Their mean from the cell's lower-left, in cells.
    #[inline]
    pub(super) fn mean(&self) -> Vector2<f64> {
        Vector2::new(f64::from(self.mean[0]), f64::from(self.mean[1])) * (1.0 / PARTS)
    }

    /// Unit normal of the surface; zero where there is none.
    #[inline]
    pub(super) fn normal(&self) -> Vector2<f64> {
        Vector2::new(f64::from(self.normal[0]), f64::from(self.normal[1])) * (1.0 / UNIT)
    }

    /// One more, this far from the cell's lower-left, in cells.
    fn add(&mut self, within: &Vector2<f64>) {
        self.count += 1;
        for (mean, end) in self.mean.iter_mut().zip(within.iter()) {
            let (end, count) = ((end * PARTS).clamp(0.0, PARTS - 1.0) as i32, i32::from(self.count));
            let off = end - i32::from(*mean);
            // Rounded to the nearest, so that the mean is not drawn to one side.
            *mean = (i32::from(*mean) + (2 * off + count * off.signum()) / (2 * count)) as u16;
        }
    }
}

/// Log-odds of occupancy by the beams that ended and those that passed.
#[inline]
fn evidence(ends: u16, passes: u16) -> i32 {
    i32::from(ends) * HIT + i32::from(passes) * MISS
}

/// A square of cells, row by row from the lower-left.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "RawTile", into = "RawTile")
)]
pub(super) struct Tile {
    /// Beams that passed each cell.
    passes: [u16; TILE_CELLS],
    /// A bit per cell in which beams ended, and how many of them come before each row.
    met: [u32; TILE as usize],
    before: [u16; TILE as usize],
    /// Those cells, in order.
    ends: Vec<Ends>,
    /// A bit per cell with a surface.
    surfaces: [u32; TILE as usize],
}

impl Default for Tile {
    fn default() -> Self {
        const NONE: [u32; TILE as usize] = [0; TILE as usize];
        Self { passes: [0; TILE_CELLS], met: NONE, before: [0; TILE as usize], ends: Vec::new(), surfaces: NONE }
    }
}

/// Column and row in the tile: the low bits count.
#[inline]
const fn within(x: i32, y: i32) -> (u32, usize) {
    ((x & (TILE - 1)) as u32, (y & (TILE - 1)) as usize)
}

impl Tile {
    /// Where surfaces are in a row: a bit per column.
    #[inline]
    pub(super) const fn surfaces(&self, y: i32) -> u32 {
        self.surfaces[within(0, y).1]
    }

    /// Log-odds of occupancy of all cells, in units of [`QUANTUM`](agv_core::grid::QUANTUM); none of a cell that no beam has met.
    pub(super) fn evidence(&self) -> impl Iterator<Item = Option<i32>> + '_ {
        (0_i32..).zip(&self.passes).map(|(i, &passes)| {
            let ends = self.ends(i & (TILE - 1), i >> TILE_BITS).map_or(0, |ends| ends.count);
            (ends > 0 || passes > 0).then(|| evidence(ends, passes))
        })
    }

    /// The beams that ended in a cell, if there were any.
    #[inline]
    pub(super) fn ends(&self, x: i32, y: i32) -> Option<&Ends> {
        let (column, row) = within(x, y);
        (self.met[row] >> column & 1 != 0).then(|| self.ends.get(self.index(column, row)))?
    }

    /// Place of a cell among those in which beams ended, if it is one.
    #[inline]
    fn index(&self, column: u32, row: usize) -> usize {
        self.before[row] as usize + (self.met[row] & !(u32::MAX << column)).count_ones() as usize
    }

    /// A beam passed.
    #[inline]
    pub(super) fn pass(&mut self, x: i32, y: i32) {
        let (column, row) = within(x, y);
        let passes = &mut self.passes[row * TILE as usize + column as usize];
        *passes = passes.saturating_add(1);
        // A cell without a surface cannot become one by this.
        if *passes == u16::MAX || self.surfaces[row] >> column & 1 != 0 {
            self.reconsider(column, row);
        }
    }

    /// A beam ended, this far from the cell's lower-left, in cells.
    pub(super) fn hit(&mut self, x: i32, y: i32, from_lower_left: &Vector2<f64>) {
        let (column, row) = within(x, y);
        let index = self.index(column, row);
        if self.met[row] >> column & 1 == 0 {
            self.met[row] |= 1 << column;
            self.before[row + 1..].iter_mut().for_each(|before| *before += 1);
            self.ends.insert(index, Ends::default());
        }
        if let Some(ends) = self.ends.get_mut(index) {
            ends.add(from_lower_left);
        }
        self.reconsider(column, row);
    }

    /// Sets the unit normal of a cell's surface, or zero for none.
    pub(super) fn set_normal(&mut self, x: i32, y: i32, normal: &Vector2<f64>) {
        let (column, row) = within(x, y);
        let index = self.index(column, row);
        if let Some(ends) = self.ends.get_mut(index) {
            ends.normal = [normal.x, normal.y].map(|v| (v * UNIT).round() as i16);
        }
    }

    /// Whether there is a surface in a cell, after its counts have changed; where one is full, both are halved.
    fn reconsider(&mut self, column: u32, row: usize) {
        let index = self.index(column, row);
        let met = self.met[row] >> column & 1 != 0;
        let passes = &mut self.passes[row * TILE as usize + column as usize];
        let mut none = 0;
        let ends = self.ends.get_mut(index).filter(|_| met).map_or(&mut none, |ends| &mut ends.count);
        if *passes == u16::MAX || *ends == u16::MAX {
            (*passes, *ends) = (*passes / 2, *ends / 2);
        }
        let bit = 1 << column;
        let surfaces = &mut self.surfaces[row];
        *surfaces = if evidence(*ends, *passes) > 0 { *surfaces | bit } else { *surfaces & !bit };
    }

    /// Bytes of the tile.
    pub(super) const fn bytes(&self) -> usize {
        size_of::<Self>() + self.ends.capacity() * size_of::<Ends>()
    }
}

/// A tile as it is stored.
#[cfg(feature = "serde")]
#[derive(serde::Serialize, serde::Deserialize)]
struct RawTile {
    passes: Vec<u16>,
    met: Vec<u32>,
    ends: Vec<Ends>,
}

#[cfg(feature = "serde")]
impl From<Tile> for RawTile {
    fn from(tile: Tile) -> Self {
        Self { passes: tile.passes.to_vec(), met: tile.met.to_vec(), ends: tile.ends }
    }
}

#[cfg(feature = "serde")]
impl TryFrom<RawTile> for Tile {
    type Error = agv_core::Error;

    fn try_from(raw: RawTile) -> Result<Self, agv_core::Error> {
        use agv_core::check;

        let RawTile { passes, met, ends } = raw;
        check::length("passes", passes.len(), TILE_CELLS)?;
        check::length("met", met.len(), TILE as usize)?;
        check::length("ends", ends.len(), met.iter().map(|row| row.count_ones() as usize).sum())?;
        let mut tile = Self::default();
        tile.passes.copy_from_slice(&passes);
        tile.met.copy_from_slice(&met);
        tile.ends = ends;
        let mut sum = 0;
        for (before, row) in tile.before.iter_mut().zip(&tile.met) {
            *before = sum;
            sum += row.count_ones() as u16;
        }
        for (row, column) in (0..TILE as usize).flat_map(|row| (0..TILE as u32).map(move |column| (row, column))) {
            tile.reconsider(column, row);
        }
        Ok(tile)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::grid::{InverseModel, InverseModelParams};
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    #[test]
    fn evidence_is_that_of_the_mapping_grid() {
        let model = InverseModel::new(InverseModelParams::default()).unwrap();
        assert_eq!((HIT, MISS), (model.hit(), model.free()));
    }

    proptest! {
        /// Against plain tables of counts and sums.
        #[test]
        fn counts_and_means_are_those_of_tables(
            beams in prop::collection::vec((0_i32..32, 28_i32..36, prop::bool::weighted(0.4), 0.0..1.0_f64, 0.0..1.0_f64), 1..300)
        ) {
            let (mut tile, mut passes, mut ends) = (Tile::default(), BTreeMap::new(), BTreeMap::new());
            for &(x, y, hit, u, v) in &beams {
                // Coordinates of any tile: y from 28 to 35 wraps around.
                let (place, end) = ((x, y & 31), Vector2::new(u, v));
                if hit {
                    tile.hit(x - 64, y, &end);
                    let (count, sum) = ends.entry(place).or_insert((0, Vector2::zeros()));
                    (*count, *sum) = (*count + 1, *sum + end);
                } else {
                    tile.pass(x - 64, y);
                    *passes.entry(place).or_insert(0) += 1;
                }
            }
            for (i, found) in (0_i32..).zip(tile.evidence()) {
                let place = (i & 31, i >> 5);
                let (count, passed) = (ends.get(&place).map(|e| e.0), passes.get(&place).copied());
                let sum = count.unwrap_or(0) * HIT + passed.unwrap_or(0) * MISS;
                prop_assert_eq!(found, (count.is_some() || passed.is_some()).then_some(sum));
                prop_assert_eq!(tile.surfaces(place.1) >> place.0 & 1 == 1, sum > 0);
                if let Some((count, sum)) = ends.get(&place) {
                    let mean = tile.ends(place.0, place.1).unwrap().mean();
                    prop_assert!((mean - sum / f64::from(*count)).amax() < 1e-4);
                }
            }
        }
    }

    #[test]
    fn full_counts_keep_their_share() {
        let mut tile = Tile::default();
        (0..20_000).for_each(|_| tile.hit(3, 4, &Vector2::new(0.25, 1.5)));
        (0..u32::from(u16::MAX)).for_each(|_| tile.pass(3, 4));
        assert_eq!((tile.ends(3, 4).unwrap().count, tile.passes[4 * 32 + 3]), (10_000, 32_767));
        (0..70_000).for_each(|_| tile.hit(3, 4, &Vector2::new(0.25, 1.5)));
        let ends = tile.ends(3, 4).unwrap();
        assert!(ends.count > 30_000 && ends.mean[0].abs_diff(16_384) < 2 && ends.mean[1] == u16::MAX);
    }

    #[test]
    fn normals_come_back() {
        let (mut tile, normal) = (Tile::default(), Vector2::new(0.6, -0.8));
        tile.hit(2, 4, &Vector2::zeros());
        tile.hit(3, 4, &Vector2::zeros());
        tile.set_normal(3, 4, &normal);
        assert!((tile.ends(3, 4).unwrap().normal() - normal).amax() < 1e-4);
        assert!(tile.ends(2, 4).unwrap().normal() == Vector2::zeros() && tile.ends(1, 4).is_none());
    }
}
