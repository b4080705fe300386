//! The mapping grid: evidence that adds up in any order.
//!
//! Log-odds (see [`inverse_model`](super::InverseModel)) are kept as integers, multiples of [`QUANTUM`], and are
//! not clamped, so maps form a commutative monoid under [`merge`](EvidenceGrid::merge): a site's map may be built from
//! the logs of many vehicles, in any order and grouping, with the same bits. Clamping happens where values are read.

use super::{
    Cell, CellState, Grid, GridLayout, InverseModel, InverseModelParams, OccupancyThresholds, ScanInsertion,
    beam_walk::Block,
    inverse_model::{MIN_PROBABILITY, QUANTUM, log_odds, probability},
    layout::ensure_same_lattice,
    scan_insertion::{CellUpdate, InsertionScratch, ProjectedScan, insert},
};
use crate::{
    Error,
    geometry::{LieGroup, Se2},
    sensors::LaserScan,
};
use nalgebra::Vector2;

/// Growth happens in whole chunks, so that a vehicle that drives on does not copy its map at every scan.
const CHUNK: i64 = 64;

/// A growing grid of unclamped log-odds evidence.
///
/// Cells belong to a lattice that the first layout fixes; growing adds cells of the same lattice, and which cell a
/// beam falls into does not depend on how the grid has grown. Any permutation of the same scans gives the same grid.
///
/// Two grids are equal if they cover the same cells with the same evidence, whatever their inverse models.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{CellState, EvidenceGrid, GridLayout, InverseModelParams, OccupancyThresholds};
/// use agv_core::sensors::{LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
/// use agv_core::nalgebra::Vector2;
///
/// let start = GridLayout::new(64, 64, 0.05, Se2::new(-1.6, -1.6, 0.0))?;
/// let mut map = EvidenceGrid::new(start, InverseModelParams::default())?;
/// let scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![4.02; 1081])?;
/// let inserted = map.insert_scan(&scan, &Se2::default())?;
/// assert!(inserted.grown && inserted.beams_used == 1081);
///
/// let states = map.states(&OccupancyThresholds::default());
/// let at = |x, y| states.layout().cell_at(&Vector2::new(x, y)).and_then(|cell| states.get(cell).copied());
/// assert_eq!(at(1.0, 0.0), Some(CellState::Free));
/// assert_eq!(at(4.02, 0.01), Some(CellState::Occupied));
/// assert_eq!(at(-2.0, 0.0), Some(CellState::Unknown), "behind the scanner");
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "RawEvidence", into = "RawEvidence")
)]
pub struct EvidenceGrid {
    resolution: f64,
    map_from_lattice: Se2,
    /// Lattice cell of the stored block's lower-left.
    corner: (i64, i64),
    block: Block,
    values: Vec<i32>,
    model: InverseModel,
    /// No cell's magnitude exceeds this; what makes sure that nothing overflows, without a test per update.
    bound: i64,
    scan: ProjectedScan,
    scratch: InsertionScratch<i32>,
}

#[cfg(feature = "serde")]
#[derive(serde::Serialize, serde::Deserialize)]
struct RawEvidence {
    resolution: f64,
    map_from_lattice: Se2,
    corner: (i64, i64),
    width: usize,
    height: usize,
    evidence: Vec<i32>,
    model: InverseModelParams,
}

#[cfg(feature = "serde")]
impl TryFrom<RawEvidence> for EvidenceGrid {
    type Error = Error;

    fn try_from(raw: RawEvidence) -> Result<Self, Error> {
        let layout = GridLayout::new(raw.width, raw.height, raw.resolution, raw.map_from_lattice)?;
        crate::check::length("evidence", raw.evidence.len(), layout.len())?;
        let mut grid = Self::empty(&layout, InverseModel::new(raw.model)?);
        let far = Self::MAX_CORNER;
        for (name, value) in [("corner x (cells)", raw.corner.0), ("corner y (cells)", raw.corner.1)] {
            crate::check::in_range(name, value as f64, -far, far)?;
        }
        if raw.evidence.contains(&i32::MIN) {
            return Err(overflow(i64::from(i32::MIN)));
        }
        grid.corner = raw.corner;
        grid.values = raw.evidence;
        grid.bound = grid.greatest();
        Ok(grid)
    }
}

#[cfg(feature = "serde")]
impl From<EvidenceGrid> for RawEvidence {
    fn from(grid: EvidenceGrid) -> Self {
        Self {
            resolution: grid.resolution,
            map_from_lattice: grid.map_from_lattice,
            corner: grid.corner,
            width: grid.block.width as usize,
            height: grid.block.height as usize,
            evidence: grid.values,
            model: *grid.model.params(),
        }
    }
}

impl PartialEq for EvidenceGrid {
    fn eq(&self, other: &Self) -> bool {
        let shape = |g: &Self| (g.corner, g.block.width, g.block.height);
        self.ensure_same_lattice(other).is_ok() && shape(self) == shape(other) && self.values == other.values
    }
}

/// Evidence adds; the bound of the grid excludes overflow.
#[derive(Debug, Clone, Copy)]
struct Add;

impl CellUpdate for Add {
    type Value = i32;

    #[inline]
    fn free(self, value: i32, by: i16) -> i32 {
        value.wrapping_add(i32::from(by))
    }

    #[inline]
    fn free_times(self, value: i32, count: i16, by: i16) -> i32 {
        value.wrapping_add(i32::from(count) * i32::from(by))
    }

    #[inline]
    fn hit(self, value: i32, by: i16) -> i32 {
        value.wrapping_add(i32::from(by))
    }
}

fn overflow(value: i64) -> Error {
    let max = f64::from(i32::MAX);
    Error::OutOfRange { name: "evidence", value: value as f64, min: -max, max }
}

impl EvidenceGrid {
    /// Farthest that the stored block may begin from the lattice's origin, in cells.
    #[cfg(feature = "serde")]
    const MAX_CORNER: f64 = super::Traversal::MAX_COORDINATE + CHUNK as f64;

    /// A grid without evidence, whose lattice is that of `layout`.
    ///
    /// # Errors
    /// As [`InverseModel::new`].
    pub fn new(layout: GridLayout, model: InverseModelParams) -> Result<Self, Error> {
        let mut grid = Self::empty(&layout, InverseModel::new(model)?);
        grid.values = vec![0; layout.len()];
        Ok(grid)
    }

    /// A grid whose values are still to be filled in.
    fn empty(layout: &GridLayout, model: InverseModel) -> Self {
        Self {
            resolution: layout.resolution(),
            map_from_lattice: layout.map_from_grid(),
            corner: (0, 0),
            block: Block { width: layout.width() as i64, height: layout.height() as i64 },
            values: Vec::new(),
            model,
            bound: 0,
            scan: ProjectedScan::default(),
            scratch: InsertionScratch::default(),
        }
    }

    /// Where the cells lie now: a scan or a merge may extend the grid to every side.
    pub fn layout(&self) -> GridLayout {
        let corner = Vector2::new(self.corner.0 as f64, self.corner.1 as f64) * self.resolution;
        let origin = self.map_from_lattice;
        let map_from_grid = Se2::from_parts(origin.act(&corner), origin.rotation());
        GridLayout::new_unchecked(self.block.width as usize, self.block.height as usize, self.resolution, map_from_grid)
    }

    /// The inverse model of this grid's scans.
    pub const fn model(&self) -> &InverseModel {
        &self.model
    }

    /// Evidence in units of [`QUANTUM`], row by row from the lower-left.
    pub fn evidence(&self) -> &[i32] {
        &self.values
    }

    /// Log-odds of occupancy of a cell of [`layout`](Self::layout), clamped to the probabilities 1e-6 and 1 - 1e-6;
    /// zero for a cell without evidence, none outside the grid.
    pub fn log_odds(&self, cell: Cell) -> Option<f64> {
        let (x, y) = (i64::from(cell.x), i64::from(cell.y));
        let index = self.block.contains(x, y).then(|| (y * self.block.width + x) as usize)?;
        self.values.get(index).map(|&value| read(value))
    }

    /// Probability that a cell is occupied, in [1e-6, 1 - 1e-6]; none outside the grid.
    pub fn probability(&self, cell: Cell) -> Option<f64> {
        self.log_odds(cell).map(probability)
    }

    /// What the map says of a cell; none outside the grid.
    pub fn state(&self, cell: Cell, thresholds: &OccupancyThresholds) -> Option<CellState> {
        self.log_odds(cell).map(|l| thresholds.state_of_log_odds(l))
    }

    /// The map that localizers and planners take.
    pub fn states(&self, thresholds: &OccupancyThresholds) -> Grid<CellState> {
        let mut states = Grid::filled(self.layout(), CellState::Unknown);
        self.states_into(thresholds, &mut states);
        states
    }

    /// As [`states`](Self::states), into a grid whose layout and values are replaced; allocates only if it must grow.
    pub fn states_into(&self, thresholds: &OccupancyThresholds, states: &mut Grid<CellState>) {
        states.reshape(self.layout(), CellState::Unknown);
        for (state, &value) in states.values_mut().iter_mut().zip(&self.values) {
            *state = thresholds.state_of_log_odds(read(value));
        }
    }

    /// Adds the evidence of a scan taken at `map_from_base`, growing the grid where the scan leaves it.
    ///
    /// Cells before the end of a beam become more free, the cell of its end more occupied; beams without a statement
    /// are skipped, see [`InverseModelParams`]. An empty scan changes nothing. Time is linear in the cells crossed;
    /// memory is allocated only when the grid grows, or the scan has more beams or reaches farther than any before.
    ///
    /// # Errors
    /// A pose that is not finite or too far off, [`Error::TooMany`] if the grid would exceed
    /// [`GridLayout::MAX_CELLS`], and [`Error::OutOfRange`] if the evidence of some cell might exceed an `i32`. The
    /// evidence is then as it was.
    pub fn insert_scan(&mut self, scan: &LaserScan, map_from_base: &Se2) -> Result<ScanInsertion, Error> {
        self.scan.project(scan, map_from_base, &self.model, &self.map_from_lattice, self.resolution)?;
        let Some((low, high)) = self.scan.bounds() else {
            return Ok(ScanInsertion { beams_skipped: scan.len(), ..Default::default() });
        };
        // At worst every beam frees, or hits, the same cell.
        let most = self.scan.len() as i64 * i64::from(self.model.hit().max(-self.model.free()));
        let bound = self.bound_after(most)?;
        let grown = self.grow(low, high)?;
        self.bound = bound;
        let done = insert(&mut self.values, self.block, self.corner, &self.scan, &self.model, &mut self.scratch, Add);
        Ok(ScanInsertion { grown, ..done })
    }

    /// Adds the evidence of another grid on the same lattice, growing to the union of the two.
    ///
    /// Associative and commutative to the bit. The result keeps this grid's inverse model.
    ///
    /// # Errors
    /// [`Error::LayoutMismatch`] if the lattices differ in resolution or origin, [`Error::TooMany`] if the union
    /// exceeds [`GridLayout::MAX_CELLS`], [`Error::OutOfRange`] if a sum exceeds an `i32`. The evidence is then as it
    /// was.
    pub fn merge(&mut self, other: &Self) -> Result<(), Error> {
        self.ensure_same_lattice(other)?;
        let end = |g: &Self| (g.corner.0 + g.block.width, g.corner.1 + g.block.height);
        let (own, others) = (end(self), end(other));
        let corner = (self.corner.0.min(other.corner.0), self.corner.1.min(other.corner.1));
        let sums_fit = self.bound + other.bound <= i64::from(i32::MAX);
        if !sums_fit {
            self.check_sums(other)?;
        }
        self.extend(corner, (own.0.max(others.0), own.1.max(others.1)))?;
        for (row, theirs) in other.values.chunks_exact(other.block.width as usize).enumerate() {
            let start = self.index_of(other.corner.0, other.corner.1 + row as i64);
            for (value, &more) in self.values.iter_mut().skip(start).zip(theirs) {
                *value = value.wrapping_add(more);
            }
        }
        self.bound = if sums_fit { self.bound + other.bound } else { self.greatest() };
        Ok(())
    }

    /// Storage index of a lattice cell inside the block.
    fn index_of(&self, x: i64, y: i64) -> usize {
        ((y - self.corner.1) * self.block.width + (x - self.corner.0)) as usize
    }

    fn ensure_same_lattice(&self, other: &Self) -> Result<(), Error> {
        ensure_same_lattice((self.resolution, other.resolution), (&self.map_from_lattice, &other.map_from_lattice))
    }

    /// Greatest magnitude of any cell.
    fn greatest(&self) -> i64 {
        self.values.iter().map(|v| i64::from(v.unsigned_abs())).max().unwrap_or(0)
    }

    /// The bound after `most` more evidence, recomputed from the cells if the running one is exhausted.
    fn bound_after(&mut self, most: i64) -> Result<i64, Error> {
        if self.bound + most > i64::from(i32::MAX) {
            self.bound = self.greatest();
        }
        let bound = self.bound + most;
        if bound > i64::from(i32::MAX) { Err(overflow(bound)) } else { Ok(bound) }
    }

    /// Checks every cell that two grids share.
    fn check_sums(&self, other: &Self) -> Result<(), Error> {
        for (index, &more) in other.values.iter().enumerate() {
            let index = index as i64;
            let (x, y) = (other.corner.0 + index % other.block.width, other.corner.1 + index / other.block.width);
            if self.block.contains(x - self.corner.0, y - self.corner.1) {
                let own = self.values.get(self.index_of(x, y)).copied().unwrap_or(0);
                let sum = i64::from(own) + i64::from(more);
                if sum.abs() > i64::from(i32::MAX) {
                    return Err(overflow(sum));
                }
            }
        }
        Ok(())
    }

    /// Makes room for the lattice cells from `low` to `high`; sides that must move go to the next whole chunk.
    fn grow(&mut self, low: (i64, i64), high: (i64, i64)) -> Result<bool, Error> {
        // A side moves only if it must, so the final extent does not depend on the order of the scans.
        let down = |low: i64, own: i64| if low < own { low.div_euclid(CHUNK) * CHUNK } else { own };
        let up = |high: i64, own: i64| if high >= own { (high.div_euclid(CHUNK) + 1) * CHUNK } else { own };
        let corner = (down(low.0, self.corner.0), down(low.1, self.corner.1));
        let end = (self.corner.0 + self.block.width, self.corner.1 + self.block.height);
        self.extend(corner, (up(high.0, end.0), up(high.1, end.1)))
    }

    /// Moves the values into a block from `corner` to before `end`, which covers the present one.
    fn extend(&mut self, corner: (i64, i64), end: (i64, i64)) -> Result<bool, Error> {
        let block = Block { width: end.0 - corner.0, height: end.1 - corner.1 };
        if block == self.block {
            return Ok(false);
        }
        let cells = (block.width as usize).saturating_mul(block.height as usize);
        if cells > GridLayout::MAX_CELLS {
            return Err(Error::TooMany { name: "grid", len: cells, max: GridLayout::MAX_CELLS });
        }
        let mut values = vec![0; cells];
        let first = ((self.corner.1 - corner.1) * block.width + (self.corner.0 - corner.0)) as usize;
        let width = self.block.width as usize;
        let rows = values.get_mut(first..).unwrap_or_default().chunks_mut(block.width as usize);
        for (row, own) in rows.zip(self.values.chunks_exact(width)) {
            row[..width].copy_from_slice(own);
        }
        (self.corner, self.block, self.values) = (corner, block, values);
        Ok(true)
    }
}

/// Log-odds of a cell, clamped.
fn read(value: i32) -> f64 {
    let limit = log_odds(1.0 - MIN_PROBABILITY);
    (f64::from(value) * QUANTUM).clamp(-limit, limit)
}
