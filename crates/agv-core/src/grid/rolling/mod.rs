//! What the vehicle sees around it: a costmap that moves with it.
//!
//! Scans mark where their beams end and clear where they pass, as Nav2's obstacle layer does; marks that were not seen for a
//! while are forgotten, a static map may lie below, and costs spread around what is marked. The window moves by whole cells
//! of a lattice that stands still in the map frame: no cell is ever sampled anew.

mod below;
#[cfg(feature = "serde")]
mod checkpoint;
mod look;
mod marks;
mod params;

use super::{
    CellState, Costmap, Footprint, Grid, GridLayout, Inflation, InverseModel, InverseModelParams, Traversal,
    scan_insertion::{InsertionScratch, ProjectedScan},
    window::Shift,
};
use crate::{Error, check, compute::Par, geometry::Se2, sensors::LaserScan, time::Stamp};
use below::{Below, layout_at};
use marks::{Mark, Notes, note};
pub use params::RollingParams;

/// What an update of a [`RollingCostmap`] did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RollingUpdate {
    /// Whether the window moved.
    pub moved: bool,
    /// Whether the costmap is another one than before; if not, its revision stays.
    pub changed: bool,
    /// Beams that said something.
    pub beams_used: usize,
    /// Beams that said nothing: invalid, without a return where that is ignored, or ended by the vehicle itself.
    pub beams_skipped: usize,
}

/// A costmap of fixed size that follows the vehicle and holds what its scanners see.
///
/// - A cell that an update hits is marked, however many beams of the same update pass it.
/// - A mark is cleared when it was seen through in [`misses_to_clear`](RollingParams::misses_to_clear) updates in a row, and
///   becomes unknown when it was not hit for [`forget_after`](RollingParams::forget_after).
/// - Hits within the vehicle's footprint are not marked, nor do they clear; cells whose centre the vehicle covers are free,
///   if nothing hits them.
/// - A static map below tells of cells of which no scan told, and what it shows as occupied stays.
/// - Beams that belong to obstacles which are tracked as moving clear, but do not mark (see
///   [`update_where`](Self::update_where)).
///
/// Scans are taken as instantaneous: deskew those of a fast vehicle first (see [`Deskew`](crate::sensors::Deskew)). The map
/// frame may be any that stands still: a drift-free odometry frame serves as well.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{RollingCostmap, RollingParams, cost};
/// use agv_core::nalgebra::Vector2;
/// use agv_core::sensors::{LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
///
/// let mut rolling = RollingCostmap::new(RollingParams::default())?;
/// let scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![3.02; 1081])?;
/// rolling.update([&scan], &Se2::new(7.0, 2.0, 0.0))?;
/// let costmap = rolling.costmap();
/// let at = |x, y| costmap.layout().cell_at(&Vector2::new(x, y)).and_then(|cell| costmap.cost(cell));
/// assert_eq!(at(10.02, 2.01), Some(cost::LETHAL));
/// assert_eq!(at(8.0, 2.01), Some(cost::FREE));
/// assert_eq!(at(11.0, 2.01), Some(cost::UNKNOWN));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct RollingCostmap {
    params: RollingParams,
    footprint: Option<Footprint>,
    /// Cell of the lattice that is the window's lower-left.
    corner: (i64, i64),
    marks: Grid<Mark>,
    below: Option<Below>,
    /// Newest scan so far.
    now: Option<Stamp>,
    /// Time that has passed and is not yet worth a step of age, in seconds.
    pending: f64,
    /// Working memory: notes of the present update, none between updates.
    notes: Vec<i16>,
    model: InverseModel,
    scan: ProjectedScan,
    scratch: InsertionScratch<i16>,
    states: Grid<CellState>,
    inflation: Option<Inflation>,
    costmap: Costmap,
}

impl RollingCostmap {
    /// A window around the origin of the map, of which nothing is known.
    ///
    /// # Errors
    /// The first parameter out of the range that its field states, a window without cells or with too many, or an inflation
    /// that [`Inflation::new`] refuses or that reaches too far.
    pub fn new(params: RollingParams) -> Result<Self, Error> {
        params.validate()?;
        let RollingParams { width, height, resolution, .. } = params;
        GridLayout::new(width, height, resolution, Se2::default())?;
        let corner = (-((width / 2) as i64), -((height / 2) as i64));
        let layout = layout_at(corner, width, height, resolution);
        let model = InverseModel::new(InverseModelParams { protect_hits: false, ..Default::default() })?;
        let states = Grid::filled(layout, CellState::Unknown);
        let mut rolling = Self {
            params,
            footprint: None,
            corner,
            marks: Grid::filled(layout, Mark::UNKNOWN),
            below: None,
            now: None,
            pending: 0.0,
            notes: vec![note::NONE; layout.len()],
            model,
            scan: ProjectedScan::default(),
            scratch: InsertionScratch::default(),
            costmap: Costmap::from_map(&states),
            states,
            inflation: params.inflation.map(Inflation::new).transpose()?,
        };
        rolling.settle()?;
        rolling.write_costs()?;
        Ok(rolling)
    }

    /// The same costmap for a vehicle that must not see itself.
    #[must_use]
    pub fn with_footprint(mut self, footprint: Footprint) -> Self {
        self.footprint = Some(footprint);
        self
    }

    /// The same costmap over a static map of any resolution and pose. A cell of the window is as the worst of the map's cells
    /// that it touches.
    ///
    /// # Errors
    /// None in practice: what the window holds was inflated before.
    pub fn with_static_map(mut self, map: Grid<CellState>) -> Result<Self, Error> {
        self.below = Some(Below::new(map, self.marks.layout()));
        self.settle()?;
        self.write_costs()?;
        Ok(self)
    }

    /// The same costmap, inflated on several threads; the bits do not depend on it.
    #[must_use]
    pub fn with_parallelism(mut self, par: Par) -> Self {
        self.inflation = self.inflation.map(|inflation| inflation.with_parallelism(par));
        self
    }

    /// The parameters that were given.
    pub const fn params(&self) -> &RollingParams {
        &self.params
    }

    /// The costs around the vehicle. Its [`revision`](Costmap::revision) changes when an update brings something new.
    pub const fn costmap(&self) -> &Costmap {
        &self.costmap
    }

    /// The same without costs around obstacles: free, unknown or occupied.
    pub const fn states(&self) -> &Grid<CellState> {
        &self.states
    }

    /// Size, resolution and pose of the window.
    pub const fn layout(&self) -> &GridLayout {
        self.marks.layout()
    }

    /// Moves the window to the vehicle and takes the scans of its lasers, all taken where it is now.
    ///
    /// Without scans, or with empty ones, the window only moves; a laser mounted outside of the window says nothing. O(cells that beams cross + cells of the window); allocates
    /// only for scans that have more beams, or reach farther, than any before.
    ///
    /// # Errors
    /// A pose that is not finite, or farther off than [`Traversal::MAX_COORDINATE`] cells; the costmap is then as it was.
    pub fn update<'a>(
        &mut self,
        scans: impl IntoIterator<Item = &'a LaserScan>,
        map_from_base: &Se2,
    ) -> Result<RollingUpdate, Error> {
        self.update_where(scans, map_from_base, |_, _| true)
    }

    /// As [`update`](Self::update), for scans some of whose beams hit what is tracked as moving: a beam for which
    /// `stands(scan, beam)` is false clears the cells that it crosses and sees through old marks in the cell of its end, but
    /// does not mark it. Scans and beams are counted from zero.
    ///
    /// # Errors
    /// As [`update`](Self::update).
    pub fn update_where<'a>(
        &mut self,
        scans: impl IntoIterator<Item = &'a LaserScan>,
        map_from_base: &Se2,
        mut stands: impl FnMut(usize, usize) -> bool,
    ) -> Result<RollingUpdate, Error> {
        let mut done = RollingUpdate { moved: self.move_to(map_from_base)?, ..Default::default() };
        for (number, scan) in scans.into_iter().enumerate() {
            self.advance(scan.stamp());
            let used = self.note(scan, map_from_base, |beam| stands(number, beam))?;
            done.beams_used += used;
            done.beams_skipped += scan.len() - used;
        }
        self.free_own_place(map_from_base);
        done.changed = self.settle()? || done.moved;
        if done.changed {
            self.write_costs()?;
        }
        Ok(done)
    }

    /// Forgets all that was seen, as after a jump of the vehicle's estimate; the static map stays.
    ///
    /// # Errors
    /// None in practice, as with [`with_static_map`](Self::with_static_map).
    pub fn reset(&mut self) -> Result<(), Error> {
        self.marks.values_mut().fill(Mark::UNKNOWN);
        if self.settle()? {
            self.write_costs()?;
        }
        Ok(())
    }

    /// Brings the window's middle to the vehicle, and says whether it moved.
    fn move_to(&mut self, map_from_base: &Se2) -> Result<bool, Error> {
        check::all_finite("map_from_base", &[map_from_base.x(), map_from_base.y(), map_from_base.yaw()])?;
        let RollingParams { width, height, resolution, .. } = self.params;
        // Half of what traversals count, so that beams from there are counted too.
        let far = 0.5 * Traversal::MAX_COORDINATE;
        let x = check::in_range("map_from_base x (cells)", map_from_base.x() / resolution, -far, far)?;
        let y = check::in_range("map_from_base y (cells)", map_from_base.y() / resolution, -far, far)?;
        let middle = (x.floor() as i64 - self.corner.0, y.floor() as i64 - self.corner.1);
        let shift = Shift::to_center(middle, width, height);
        if shift.is_none() {
            return Ok(false);
        }
        self.corner = (self.corner.0 + shift.right, self.corner.1 + shift.up);
        let layout = layout_at(self.corner, width, height, resolution);
        shift.apply(self.marks.values_mut(), width, Mark::UNKNOWN);
        self.marks.reshape(layout, Mark::UNKNOWN);
        self.states.reshape(layout, CellState::Unknown);
        if let Some(below) = &mut self.below {
            below.shift(shift, &layout);
        }
        Ok(true)
    }

    /// Lets the time pass to that of a scan.
    fn advance(&mut self, stamp: Stamp) {
        let passed = self.now.map_or(0.0, |now| (stamp - now).max(0.0));
        self.now = Some(self.now.map_or(stamp, |now| now.max(stamp)));
        let Some(forget_after) = self.params.forget_after else { return };
        let step = forget_after / f64::from(Mark::AGES);
        self.pending += passed;
        let due = (self.pending / step).floor();
        self.pending = (self.pending - due * step).max(0.0);
        let steps = due.min(f64::from(Mark::AGES + 1)) as u16;
        if steps > 0 {
            for mark in self.marks.values_mut() {
                *mark = mark.aged(steps);
            }
        }
    }

    /// Every cell takes its note; says whether any has another state than before.
    fn settle(&mut self) -> Result<bool, Error> {
        check::length("notes", self.notes.len(), self.marks.layout().len())?;
        let fresh = Mark::hit(self.params.misses_to_clear);
        let below = self.below.as_ref().map(|below| below.states.as_slice());
        let nothing = if self.params.keep_unknown { CellState::Unknown } else { CellState::Free };
        let mut changed = false;
        let cells = self.marks.values_mut().iter_mut().zip(&mut self.notes).zip(self.states.values_mut());
        let mut settle = |mark: &mut Mark, noted: &mut i16, state: &mut CellState, below: CellState| {
            let next = if *noted & note::HIT != 0 {
                fresh
            } else if *noted != note::NONE {
                mark.missed()
            } else {
                *mark
            };
            (*mark, *noted) = (next, note::NONE);
            let seen = if next.is_marked() {
                CellState::Occupied
            } else if next.is_unknown() {
                below
            } else {
                CellState::Free
            };
            let now = if below == CellState::Occupied { below } else { seen };
            let now = if now == CellState::Unknown { nothing } else { now };
            changed |= *state != now;
            *state = now;
        };
        match below {
            Some(below) => cells.zip(below).for_each(|(((m, n), s), &b)| settle(m, n, s, b)),
            None => cells.for_each(|((m, n), s)| settle(m, n, s, CellState::Unknown)),
        }
        Ok(changed)
    }

    fn write_costs(&mut self) -> Result<(), Error> {
        if let Some(inflation) = &mut self.inflation {
            return inflation.inflate_into(&self.states, &mut self.costmap);
        }
        self.costmap.take_states(&self.states);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
