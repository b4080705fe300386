//! The live grid: log-odds that are clamped at every update, for a world that changes.
//!
//! Clamping bounds how long a cell remembers: a parked pallet that drives off is forgotten after a bounded number of
//! scans (Yguel, Aycard and Laugier 2008; `OctoMap`, Hornung et al. 2013, section 3.4). The price is that updates no
//! longer commute, so live grids are not merged; the mapping grid is [`EvidenceGrid`].

use super::{
    Cell, CellState, EvidenceGrid, Grid, GridLayout, InverseModel, InverseModelParams, OccupancyThresholds,
    ScanInsertion, Traversal,
    beam_walk::Block,
    inverse_model::{MIN_PROBABILITY, QUANTUM, log_odds, probability, quantize},
    scan_insertion::{CellUpdate, InsertionScratch, ProjectedScan, insert},
    window::Shift,
};
use crate::{Error, check, geometry::Se2, sensors::LaserScan};
use nalgebra::Vector2;

/// Parameters of [`OccupancyGrid`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OccupancyParams {
    /// What a beam says of the cells it crosses.
    pub model: InverseModelParams,
    /// Least probability of occupancy that a cell may reach, in [1e-6, 0.5).
    pub p_min: f64,
    /// Greatest probability of occupancy that a cell may reach, in (0.5, 1 - 1e-6].
    pub p_max: f64,
    /// Time after which an unobserved cell has lost half of its log-odds, in seconds, by
    /// [`forget`](OccupancyGrid::forget).
    pub half_life: Option<f64>,
}

impl Default for OccupancyParams {
    /// `OctoMap`'s 0.7 and 0.4, clamped to 0.1192 and 0.971 (-2 and 3.5 in log-odds), without decay.
    ///
    /// The mapping grid's weaker evidence of free space is not needed where evidence is clamped, and would make this
    /// grid forget half as fast.
    fn default() -> Self {
        let model = InverseModelParams { p_hit: 0.7, p_miss: 0.4, ..Default::default() };
        Self { model, p_min: 0.1192, p_max: 0.971, half_life: None }
    }
}

/// An occupancy grid of fixed extent whose log-odds are clamped at every update.
///
/// The free evidence of a scan enters before its hits, so the order of its beams does not matter. Every cell starts at
/// probability 0.5.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{GridLayout, OccupancyGrid, OccupancyParams};
/// use agv_core::sensors::{LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
/// use agv_core::nalgebra::Vector2;
///
/// let layout = GridLayout::new(200, 200, 0.05, Se2::new(-5.0, -5.0, 0.0))?;
/// let mut grid = OccupancyGrid::new(layout, OccupancyParams::default())?;
/// let scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![3.02; 1081])?;
/// grid.insert_scan(&scan, &Se2::default())?;
/// let wall = layout.cell_at(&Vector2::new(3.02, 0.01)).and_then(|cell| grid.probability(cell));
/// assert!(wall.is_some_and(|p| p > 0.65));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "RawOccupancy", into = "RawOccupancy")
)]
pub struct OccupancyGrid {
    params: OccupancyParams,
    model: InverseModel,
    rule: Clamp,
    values: Grid<i16>,
    /// Time that has passed and is not yet worth a step of decay, in seconds.
    pending: f64,
    scan: ProjectedScan,
    scratch: InsertionScratch<i16>,
}

#[cfg(feature = "serde")]
#[derive(serde::Serialize, serde::Deserialize)]
struct RawOccupancy {
    params: OccupancyParams,
    values: Grid<i16>,
    pending: f64,
}

#[cfg(feature = "serde")]
impl TryFrom<RawOccupancy> for OccupancyGrid {
    type Error = Error;

    fn try_from(raw: RawOccupancy) -> Result<Self, Error> {
        let mut grid = Self::new(*raw.values.layout(), raw.params)?;
        let (min, max) = (grid.rule.min, grid.rule.max);
        for &value in raw.values.values() {
            check::in_range("log-odds (units)", f64::from(value), f64::from(min), f64::from(max))?;
        }
        grid.pending = check::non_negative("pending", raw.pending)?;
        grid.values = raw.values;
        Ok(grid)
    }
}

#[cfg(feature = "serde")]
impl From<OccupancyGrid> for RawOccupancy {
    fn from(grid: OccupancyGrid) -> Self {
        Self { params: grid.params, values: grid.values, pending: grid.pending }
    }
}

impl PartialEq for OccupancyGrid {
    fn eq(&self, other: &Self) -> bool {
        self.params == other.params && self.values == other.values && self.pending == other.pending
    }
}

/// Adds and clamps; both summands are below 3,600, so an `i16` holds the sum.
#[derive(Debug, Clone, Copy)]
struct Clamp {
    min: i16,
    max: i16,
    /// So much free evidence takes every cell to `min`: with more of it an `i16` might not hold the sum.
    most: i16,
}

impl Clamp {
    fn new(params: &OccupancyParams, model: &InverseModel) -> Self {
        let (min, max) = (quantize(log_odds(params.p_min)), quantize(log_odds(params.p_max)));
        let most = (max - min) / -model.free() + 1;
        Self { min: min as i16, max: max as i16, most: most as i16 }
    }
}

impl CellUpdate for Clamp {
    type Value = i16;

    #[inline]
    fn free(self, value: i16, by: i16) -> i16 {
        value.wrapping_add(by).max(self.min)
    }

    #[inline]
    fn free_times(self, value: i16, count: i16, by: i16) -> i16 {
        value.wrapping_add(count.min(self.most).wrapping_mul(by)).max(self.min)
    }

    #[inline]
    fn hit(self, value: i16, by: i16) -> i16 {
        value.wrapping_add(by).min(self.max)
    }
}

impl OccupancyGrid {
    /// Steps of decay per half-life, and the factor of one, 2^(-1/8), in 1/65536.
    const STEPS_PER_HALF_LIFE: f64 = 8.0;
    const STEP: i32 = 60_097;

    /// A grid of which nothing is known.
    ///
    /// # Errors
    /// The first parameter out of the range that its field states.
    pub fn new(layout: GridLayout, params: OccupancyParams) -> Result<Self, Error> {
        let model = InverseModel::new(params.model)?;
        check::in_range("p_min", params.p_min, MIN_PROBABILITY, 0.5_f64.next_down())?;
        check::in_range("p_max", params.p_max, 0.5_f64.next_up(), 1.0 - MIN_PROBABILITY)?;
        if let Some(half_life) = params.half_life {
            check::positive("half_life", half_life)?;
        }
        let rule = Clamp::new(&params, &model);
        let values = Grid::filled(layout, 0);
        Ok(Self {
            params,
            model,
            rule,
            values,
            pending: 0.0,
            scan: ProjectedScan::default(),
            scratch: InsertionScratch::default(),
        })
    }

    /// A live grid that starts from a map.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn from_evidence(map: &EvidenceGrid, params: OccupancyParams) -> Result<Self, Error> {
        let mut grid = Self::new(map.layout(), params)?;
        let (min, max) = (i32::from(grid.rule.min), i32::from(grid.rule.max));
        for (value, &evidence) in grid.values.values_mut().iter_mut().zip(map.evidence()) {
            *value = evidence.clamp(min, max) as i16;
        }
        Ok(grid)
    }

    /// Size, resolution and pose.
    pub const fn layout(&self) -> &GridLayout {
        self.values.layout()
    }

    /// The parameters that were given.
    pub const fn params(&self) -> &OccupancyParams {
        &self.params
    }

    /// Log-odds of occupancy of a cell; none outside the grid.
    #[inline]
    pub fn log_odds(&self, cell: Cell) -> Option<f64> {
        self.values.get(cell).map(|&value| f64::from(value) * QUANTUM)
    }

    /// Probability that a cell is occupied; none outside the grid.
    pub fn probability(&self, cell: Cell) -> Option<f64> {
        self.log_odds(cell).map(probability)
    }

    /// What the grid says of a cell; none outside.
    pub fn state(&self, cell: Cell, thresholds: &OccupancyThresholds) -> Option<CellState> {
        self.log_odds(cell).map(|l| thresholds.state_of_log_odds(l))
    }

    /// The map that planners take.
    pub fn states(&self, thresholds: &OccupancyThresholds) -> Grid<CellState> {
        let mut states = Grid::filled(*self.layout(), CellState::Unknown);
        self.states_into(thresholds, &mut states);
        states
    }

    /// As [`states`](Self::states), into a grid whose layout and values are replaced; allocates only if it must grow.
    pub fn states_into(&self, thresholds: &OccupancyThresholds, states: &mut Grid<CellState>) {
        states.reshape(*self.layout(), CellState::Unknown);
        for (state, &value) in states.values_mut().iter_mut().zip(self.values.values()) {
            *state = thresholds.state_of_log_odds(f64::from(value) * QUANTUM);
        }
    }

    /// Updates the cells that a scan taken at `map_from_base` crosses and hits; what lies outside the grid is left out.
    ///
    /// Time is linear in the cells crossed; memory is allocated only if the scan has more beams, or
    /// reaches farther, than any before.
    ///
    /// # Errors
    /// A pose that is not finite, or farther off than [`Traversal::MAX_COORDINATE`]
    /// cells; the grid is then as it was.
    pub fn insert_scan(&mut self, scan: &LaserScan, map_from_base: &Se2) -> Result<ScanInsertion, Error> {
        let layout = *self.values.layout();
        self.scan.project(scan, map_from_base, &self.model, &layout.map_from_grid(), layout.resolution())?;
        let block = Block { width: layout.width() as i64, height: layout.height() as i64 };
        let values = self.values.values_mut();
        Ok(insert(values, block, (0, 0), &self.scan, &self.model, &mut self.scratch, self.rule))
    }

    /// Moves the grid by whole cells until its middle cell holds the map point `center`, as a window that follows a
    /// vehicle, and says whether it moved. What both windows cover is kept; what is new is unknown.
    ///
    /// Linear in the cells, in place.
    ///
    /// # Errors
    /// A point that is not finite, or farther off than [`Traversal::MAX_COORDINATE`] cells; the grid is then as it was.
    pub fn recenter(&mut self, center: &Vector2<f64>) -> Result<bool, Error> {
        let layout = *self.values.layout();
        let (point, far) = (layout.to_grid(center), Traversal::MAX_COORDINATE);
        check::in_range("center x (cells)", point.x, -far, far)?;
        check::in_range("center y (cells)", point.y, -far, far)?;
        let (width, height) = (layout.width(), layout.height());
        let shift = Shift::to_center((point.x.floor() as i64, point.y.floor() as i64), width, height);
        if shift.is_none() {
            return Ok(false);
        }
        shift.apply(self.values.values_mut(), width, 0);
        let corner = layout.to_map(&Vector2::new(shift.right as f64, shift.up as f64));
        let map_from_grid = Se2::from_parts(corner, layout.map_from_grid().rotation());
        self.values.reshape(GridLayout::new_unchecked(width, height, layout.resolution(), map_from_grid), 0);
        Ok(true)
    }

    /// Lets `dt` seconds pass: every cell's log-odds decay towards unknown, by half in each half-life. Nothing happens
    /// without [`half_life`](OccupancyParams::half_life).
    ///
    /// Decay is applied in whole steps of an eighth of the half-life; the rest of the time is kept for the next call,
    /// so the call rate does not matter. Linear in the cells when a step is due, constant otherwise.
    ///
    /// # Errors
    /// [`Error::Negative`] if `dt` is negative or not finite.
    pub fn forget(&mut self, dt: f64) -> Result<(), Error> {
        check::non_negative("dt", dt)?;
        let Some(half_life) = self.params.half_life else { return Ok(()) };
        let step = half_life / Self::STEPS_PER_HALF_LIFE;
        self.pending += dt;
        // After 13 half-lives the greatest value is below one unit.
        let due = (self.pending / step).floor();
        self.pending = (self.pending - due * step).max(0.0);
        for _ in 0..due.min(13.0 * Self::STEPS_PER_HALF_LIFE) as u32 {
            for value in self.values.values_mut() {
                // Division rounds towards zero, so every cell gets there.
                *value = (i32::from(*value) * Self::STEP / 65_536) as i16;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn grid() -> OccupancyGrid {
        let layout = GridLayout::new(9, 6, 0.5, Se2::new(1.0, -2.0, 0.7)).unwrap();
        let mut grid = OccupancyGrid::new(layout, OccupancyParams::default()).unwrap();
        for (index, value) in grid.values.values_mut().iter_mut().enumerate() {
            *value = index as i16 + 1;
        }
        grid
    }

    proptest! {
        /// Seen from the map, cells that both windows cover keep their values, and the others are unknown.
        #[test]
        fn a_moved_window_keeps_what_it_still_covers(x in -16_i32..24, y in -12_i32..18) {
            let (old, mut new) = (grid(), grid());
            let center = old.layout().center(Cell::new(x, y));
            prop_assert_eq!(new.recenter(&center).unwrap(), (x, y) != (4, 3));
            prop_assert_eq!(new.layout().cell_at(&center), Some(Cell::new(4, 3)));
            for index in 0..new.layout().len() {
                let before = old.layout().cell_at(&new.layout().center(new.layout().cell(index)));
                let expected = before.and_then(|cell| old.values.get(cell).copied()).unwrap_or(0);
                prop_assert_eq!(new.values.values()[index], expected);
            }
        }
    }

    #[test]
    fn a_center_that_cannot_be_counted_changes_nothing() {
        for bad in [f64::NAN, f64::INFINITY, -1e300] {
            let mut moved = grid();
            assert!(matches!(moved.recenter(&Vector2::new(bad, 0.0)), Err(Error::OutOfRange { .. })), "{bad}");
            assert!(matches!(moved.recenter(&Vector2::new(0.0, bad)), Err(Error::OutOfRange { .. })), "{bad}");
            assert!(moved == grid());
        }
    }
}
