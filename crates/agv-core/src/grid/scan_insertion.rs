//! Scan insertion, shared by the mapping and the live grid.
//!
//! A scan is first projected onto the grid's lattice, which finds all that can be wrong with it before a cell changes.
//! Then every beam frees the cells before its end, and after that the ends are inserted: the result does not depend on
//! the order of the beams, even where updates clamp.

use super::{
    InverseModel, Traversal,
    beam_walk::{Block, update_before_end},
    traversal::{LATTICE, LATTICE_BITS, to_lattice},
};
use crate::{
    Error, check,
    geometry::{LieGroup, Se2},
    sensors::LaserScan,
};

/// What the insertion of a scan did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ScanInsertion {
    /// Beams that said something.
    pub beams_used: usize,
    /// Beams that said nothing: invalid, or without a return where that is ignored.
    pub beams_skipped: usize,
    /// Updates of cells by beams that pass; a cell counts once per beam.
    pub free_updates: u64,
    /// Updates of cells by beams that end there.
    pub hit_updates: u64,
    /// Whether the grid grew.
    pub grown: bool,
}

impl ScanInsertion {
    /// Updates of cells in all.
    pub const fn cells_updated(&self) -> u64 {
        self.free_updates + self.hit_updates
    }
}

/// End of a beam in lattice steps, and the evidence for its cell.
#[derive(Debug, Clone, Copy)]
struct End {
    x: i64,
    y: i64,
    hit: i32,
}

/// A scan on the lattice of a grid, with the memory that is kept from scan to scan.
#[derive(Debug, Clone, Default)]
pub(crate) struct ProjectedScan {
    origin: (i64, i64),
    ends: Vec<End>,
    skipped: usize,
    /// Cosine and sine of each beam, and the `angle_min` and `angle_increment` that they belong to.
    directions: Vec<(f64, f64)>,
    directions_of: (f64, f64),
}

impl ProjectedScan {
    /// Projects `scan`, taken at `map_from_base`, onto the lattice of cells of `resolution` metres at
    /// `map_from_lattice`.
    ///
    /// # Errors
    /// A pose that is not finite, or a scan farther from the lattice's origin than a [`Traversal`] can count.
    pub(crate) fn project(
        &mut self,
        scan: &LaserScan,
        map_from_base: &Se2,
        model: &InverseModel,
        map_from_lattice: &Se2,
        resolution: f64,
    ) -> Result<(), Error> {
        let p = map_from_base;
        check::all_finite("map_from_base", &[p.x(), p.y(), p.yaw()])?;
        self.remember_directions(scan);
        let geometry = scan.geometry();
        let sensor = map_from_lattice.inverse() * *map_from_base * geometry.base_from_sensor;
        let (cos, sin) = (sensor.rotation().cos(), sensor.rotation().sin());
        let per_metre = 1.0 / resolution;
        let (x, y) = (sensor.x() * per_metre, sensor.y() * per_metre);
        let far = Traversal::MAX_COORDINATE;
        check::in_range("scan x (cells)", x, -far, far)?;
        check::in_range("scan y (cells)", y, -far, far)?;
        self.origin = (to_lattice(x), to_lattice(y));
        self.ends.clear();
        self.ends.reserve(scan.len());
        for (&range, &(c, s)) in scan.ranges().iter().zip(&self.directions) {
            let Some(evidence) = model.read(scan.interpret(range), geometry.range_max) else { continue };
            let cells = evidence.free_until * per_metre;
            let (end_x, end_y) = (x + cells * (cos * c - sin * s), y + cells * (sin * c + cos * s));
            if !(end_x.abs() <= far && end_y.abs() <= far) {
                check::in_range("beam end x (cells)", end_x, -far, far)?;
                check::in_range("beam end y (cells)", end_y, -far, far)?;
            }
            self.ends.push(End { x: to_lattice(end_x), y: to_lattice(end_y), hit: evidence.hit });
        }
        self.skipped = scan.len() - self.ends.len();
        Ok(())
    }

    /// A scanner's directions do not change: their sines are computed for the first scan only.
    fn remember_directions(&mut self, scan: &LaserScan) {
        let geometry = scan.geometry();
        let of = (geometry.angle_min, geometry.angle_increment);
        if of != self.directions_of {
            self.directions.clear();
            self.directions_of = of;
        }
        for index in self.directions.len()..scan.len() {
            let (sin, cos) = geometry.angle(index).sin_cos();
            self.directions.push((cos, sin));
        }
    }

    /// Beams that say something.
    pub(crate) fn len(&self) -> usize {
        self.ends.len()
    }

    /// Least and greatest cell that any beam reaches, as (x, y); none if no beam says anything.
    pub(crate) fn bounds(&self) -> Option<((i64, i64), (i64, i64))> {
        self.ends.first()?;
        let (mut low, mut high) = (self.origin, self.origin);
        for end in &self.ends {
            low = (low.0.min(end.x), low.1.min(end.y));
            high = (high.0.max(end.x), high.1.max(end.y));
        }
        let cell = |p: (i64, i64)| (p.0 >> LATTICE_BITS, p.1 >> LATTICE_BITS);
        Some((cell(low), cell(high)))
    }
}

/// How evidence enters a cell.
pub(crate) trait CellUpdate: Copy {
    /// What a cell stores.
    type Value: Copy + From<i16>;
    /// The value after evidence `by < 0`.
    fn free(self, value: Self::Value, by: Self::Value) -> Self::Value;
    /// The value after evidence `by > 0`.
    fn hit(self, value: Self::Value, by: Self::Value) -> Self::Value;
}

/// Inserts the projected scan into the block of cells whose lower-left is the lattice cell `corner`; what lies outside
/// is left out. `kept` is memory for the values of protected cells.
pub(crate) fn insert<U: CellUpdate>(
    values: &mut [U::Value],
    block: Block,
    corner: (i64, i64),
    scan: &ProjectedScan,
    model: &InverseModel,
    kept: &mut Vec<(usize, U::Value)>,
    rule: U,
) -> ScanInsertion {
    let shift = (corner.0 * LATTICE, corner.1 * LATTICE);
    let from = (scan.origin.0 - shift.0, scan.origin.1 - shift.1);
    let hit_cell = |end: &End| {
        let (x, y) = ((end.x - shift.0) >> LATTICE_BITS, (end.y - shift.1) >> LATTICE_BITS);
        (end.hit != 0 && block.contains(x, y)).then(|| (y * block.width + x) as usize)
    };
    kept.clear();
    if model.params().protect_hits {
        let cells = scan.ends.iter().filter_map(hit_cell);
        kept.extend(cells.filter_map(|index| Some((index, *values.get(index)?))));
    }

    let mut done = ScanInsertion { beams_used: scan.len(), beams_skipped: scan.skipped, ..Default::default() };
    // Increments fit an i16: |log-odds| <= 13.9 nats = 3537 units.
    let free = U::Value::from(model.free() as i16);
    for end in &scan.ends {
        let to = (end.x - shift.0, end.y - shift.1);
        done.free_updates += update_before_end(values, block, from, to, |value| rule.free(value, free));
    }
    for &(index, value) in kept.iter() {
        if let Some(slot) = values.get_mut(index) {
            *slot = value;
        }
    }
    for end in &scan.ends {
        if let Some(slot) = hit_cell(end).and_then(|index| values.get_mut(index)) {
            *slot = rule.hit(*slot, U::Value::from(end.hit as i16));
            done.hit_updates += 1;
        }
    }
    done
}
