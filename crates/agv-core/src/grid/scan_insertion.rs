//! Scan insertion, shared by the mapping and the live grid.
//!
//! A scan is first projected onto the grid's lattice, which finds all that can be wrong with it before a cell changes.
//! Then every beam frees the cells before its end, and after that the ends are inserted: the result does not depend on
//! the order of the beams, even where updates clamp.

use super::{
    BeamEvidence, InverseModel, Traversal,
    beam_count::{BeamCounts, Bounds, CountSink},
    beam_walk::{Block, update_before_end},
    traversal::{Axis, LATTICE, LATTICE_BITS, to_lattice},
};
use crate::{
    Error, check,
    geometry::{LieGroup, Se2},
    sensors::{Beam, LaserScan},
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
    /// Cells along an axis that no scan of this scanner exceeds.
    span: usize,
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
        let range_max = scan.geometry().range_max;
        let read = |_: usize, beam: Beam, _: (f64, f64)| model.read(beam, range_max);
        self.project_with(scan, map_from_base, map_from_lattice, resolution, model.reach(range_max), read)
    }

    /// As [`project`](Self::project), with what a beam says by its number, reading and direction in the lattice's frame, no
    /// farther than `reach` metres.
    pub(crate) fn project_with(
        &mut self,
        scan: &LaserScan,
        map_from_base: &Se2,
        map_from_lattice: &Se2,
        resolution: f64,
        reach: f64,
        mut read: impl FnMut(usize, Beam, (f64, f64)) -> Option<BeamEvidence>,
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
        for (index, (&range, &(c, s))) in scan.ranges().iter().zip(&self.directions).enumerate() {
            let direction = (cos * c - sin * s, sin * c + cos * s);
            let Some(evidence) = read(index, scan.interpret(range), direction) else { continue };
            let cells = evidence.free_until * per_metre;
            let (end_x, end_y) = (x + cells * direction.0, y + cells * direction.1);
            if !(end_x.abs() <= far && end_y.abs() <= far) {
                check::in_range("beam end x (cells)", end_x, -far, far)?;
                check::in_range("beam end y (cells)", end_y, -far, far)?;
            }
            self.ends.push(End { x: to_lattice(end_x), y: to_lattice(end_y), hit: evidence.hit });
        }
        self.skipped = scan.len() - self.ends.len();
        self.span = 2 * (reach * per_metre).min(far) as usize + 3;
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
    fn free(self, value: Self::Value, by: i16) -> Self::Value;
    /// The value after `count >= 0` times evidence `by < 0`.
    fn free_times(self, value: Self::Value, count: i16, by: i16) -> Self::Value;
    /// The value after evidence `by > 0`.
    fn hit(self, value: Self::Value, by: i16) -> Self::Value;
}

/// Memory that is kept from scan to scan.
#[derive(Debug, Clone)]
pub(crate) struct InsertionScratch<T> {
    /// Values of cells that are hit.
    kept: Vec<(usize, T)>,
    counts: BeamCounts,
}

impl<T> Default for InsertionScratch<T> {
    fn default() -> Self {
        Self { kept: Vec::new(), counts: BeamCounts::default() }
    }
}

/// Inserts the projected scan into the block of cells whose lower-left is the lattice cell `corner`; what lies outside
/// is left out.
pub(crate) fn insert<U: CellUpdate>(
    values: &mut [U::Value],
    block: Block,
    corner: (i64, i64),
    scan: &ProjectedScan,
    model: &InverseModel,
    scratch: &mut InsertionScratch<U::Value>,
    rule: U,
) -> ScanInsertion {
    let shift = (corner.0 * LATTICE, corner.1 * LATTICE);
    let hit_cell = |end: &End| {
        let (x, y) = ((end.x - shift.0) >> LATTICE_BITS, (end.y - shift.1) >> LATTICE_BITS);
        (end.hit != 0 && block.contains(x, y)).then(|| (y * block.width + x) as usize)
    };
    let kept = &mut scratch.kept;
    kept.clear();
    if model.params().protect_hits {
        let cells = scan.ends.iter().filter_map(hit_cell);
        kept.extend(cells.filter_map(|index| Some((index, *values.get(index)?))));
    }

    let mut done = ScanInsertion { beams_used: scan.len(), beams_skipped: scan.skipped, ..Default::default() };
    // Increments fit an i16: |log-odds| <= 13.9 nats = 3537 units.
    let free = model.free() as i16;
    done.free_updates = insert_free(values, block, shift, scan, &mut scratch.counts, free, rule);
    for &(index, value) in kept.iter() {
        if let Some(slot) = values.get_mut(index) {
            *slot = value;
        }
    }
    for end in &scan.ends {
        if let Some(slot) = hit_cell(end).and_then(|index| values.get_mut(index)) {
            *slot = rule.hit(*slot, end.hit as i16);
            done.hit_updates += 1;
        }
    }
    done
}

/// Frees the cells before the beams' ends, one by one or counted; returns how many updates there were.
fn insert_free<U: CellUpdate>(
    values: &mut [U::Value],
    block: Block,
    shift: (i64, i64),
    scan: &ProjectedScan,
    counts: &mut BeamCounts,
    free: i16,
    rule: U,
) -> u64 {
    let from = (scan.origin.0 - shift.0, scan.origin.1 - shift.1);
    let axes = |end: &End| (Axis::new(from.0, end.x - shift.0), Axis::new(from.1, end.y - shift.1));
    let start = (from.0 >> LATTICE_BITS, from.1 >> LATTICE_BITS);
    let bounds = worth_counting(scan, block, start, axes);
    if let Some(bounds) = bounds {
        let most = |cells: i64| scan.span.min(cells as usize);
        counts.begin(bounds, (most(block.width), most(block.height)));
    }
    let mut updates = 0;
    for end in &scan.ends {
        let (x, y) = axes(end);
        if bounds.is_some() && ends_inside(block, &x, &y) && BeamCounts::takes(&x, &y) {
            counts.mark(&x, &y);
            updates += (x.lines + y.lines) as u64;
        } else {
            let to = (end.x - shift.0, end.y - shift.1);
            updates += update_before_end(values, block, from, to, |value| rule.free(value, free));
        }
    }
    if bounds.is_some() {
        counts.drain(start, &mut FreeRows { values, width: block.width, free, rule });
    }
    updates
}

/// Frees the cells of a block as often as they were counted.
struct FreeRows<'a, U: CellUpdate> {
    values: &'a mut [U::Value],
    width: i64,
    free: i16,
    rule: U,
}

impl<U: CellUpdate> CountSink for FreeRows<'_, U> {
    #[expect(
        clippy::inline_always,
        reason = "only what is inlined is compiled for the instruction set found at run time"
    )]
    #[inline(always)]
    fn row(&mut self, x: i64, y: i64, counts: &[u16]) {
        let first = (y * self.width + x) as usize;
        let row = self.values.get_mut(first..first + counts.len()).unwrap_or_default();
        for (value, &count) in row.iter_mut().zip(counts) {
            *value = self.rule.free_times(*value, count as i16, self.free);
        }
    }
}

#[inline]
fn ends_inside(block: Block, x: &Axis, y: &Axis) -> bool {
    block.contains(x.cell + x.step * x.lines, y.cell + y.step * y.lines)
}

/// The cells that the beams inside the block reach, if counting them is cheaper than walking along each.
fn worth_counting(
    scan: &ProjectedScan,
    block: Block,
    start: (i64, i64),
    axes: impl Fn(&End) -> (Axis, Axis),
) -> Option<Bounds> {
    // Instructions per cell of a walk, per line of the minor axis, and per cell of the bounds, as counted.
    const WALK: i64 = 9;
    const MARK: i64 = 12;
    const SWEEP: i64 = 4;
    if !block.contains(start.0, start.1) || scan.len() > BeamCounts::MOST_BEAMS {
        return None;
    }
    let (mut low, mut high) = (start, start);
    let mut saved = 0;
    for end in &scan.ends {
        let (x, y) = axes(end);
        if ends_inside(block, &x, &y) {
            let cell = (x.cell + x.step * x.lines, y.cell + y.step * y.lines);
            low = (low.0.min(cell.0), low.1.min(cell.1));
            high = (high.0.max(cell.0), high.1.max(cell.1));
            saved += WALK * (x.lines + y.lines) - MARK * x.lines.min(y.lines);
        }
    }
    let area = (high.0 - low.0 + 1) * (high.1 - low.1 + 1);
    (saved > SWEEP * area).then_some(Bounds { low, high })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Sums that must not depend on how the beams are taken.
    #[derive(Debug, Clone, Copy)]
    struct Sum;

    impl CellUpdate for Sum {
        type Value = i32;

        fn free(self, value: i32, by: i16) -> i32 {
            value + i32::from(by)
        }

        fn free_times(self, value: i32, count: i16, by: i16) -> i32 {
            value + i32::from(count) * i32::from(by)
        }

        fn hit(self, value: i32, by: i16) -> i32 {
            value + i32::from(by)
        }
    }

    fn scan_of(origin: (i64, i64), ends: &[(i64, i64)]) -> ProjectedScan {
        let ends = ends.iter().map(|&(x, y)| End { x, y, hit: 7 }).collect();
        ProjectedScan { origin, ends, ..Default::default() }
    }

    /// Lattice points, many of them on lines and corners between cells.
    fn coordinate(cells: i64) -> impl Strategy<Value = i64> {
        prop_oneof![
            1 => (0..=cells).prop_map(|c| c * LATTICE),
            1 => (0..2 * cells).prop_map(|c| c * LATTICE / 2),
            6 => -LATTICE / 2..(cells + 1) * LATTICE,
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        /// Counted or walked, every cell gets what [`Traversal`] says, and no mark is left for the next scan.
        #[test]
        fn every_beam_frees_the_cells_of_its_traversal(
            origin in (coordinate(40), coordinate(33)),
            ends in prop::collection::vec((coordinate(40), coordinate(33)), 1..400),
            corner in (-3_i64..3, -3_i64..3),
        ) {
            let (block, mut scratch) = (Block { width: 40, height: 33 }, InsertionScratch::default());
            let params = crate::grid::InverseModelParams { protect_hits: false, ..Default::default() };
            let model = InverseModel::new(params).unwrap();
            let mut expected = vec![0; (block.width * block.height) as usize];
            let mut visits = 0;
            for &(x, y) in &ends {
                let (x, y) = (Axis::new(origin.0, x), Axis::new(origin.1, y));
                let (last_x, last_y) = (x.cell + x.step * x.lines, y.cell + y.step * y.lines);
                for cell in Traversal::from_axes(&x, &y) {
                    let (x, y) = (i64::from(cell.x), i64::from(cell.y));
                    let end = (x, y) == (last_x, last_y);
                    if block.contains(x, y) {
                        expected[(y * block.width + x) as usize] += if end { 7 } else { model.free() };
                        visits += u64::from(!end);
                    }
                }
            }
            let shift = |p: (i64, i64)| (p.0 + corner.0 * LATTICE, p.1 + corner.1 * LATTICE);
            let ends: Vec<_> = ends.iter().map(|&p| shift(p)).collect();
            let scan = scan_of(shift(origin), &ends);
            for time in 1..=2 {
                let mut values = vec![0; expected.len()];
                let done = insert(&mut values, block, corner, &scan, &model, &mut scratch, Sum);
                prop_assert_eq!(done.free_updates, visits, "scan {}", time);
                prop_assert_eq!(&values, &expected, "scan {}", time);
            }
        }
    }

    /// The longest beams that are counted, at the least slopes: where the fractions must be most exact.
    #[test]
    fn long_beams_are_counted_exactly() {
        let (block, mut scratch) = (Block { width: 1030, height: 1030 }, InsertionScratch::<i32>::default());
        let model = InverseModel::new(crate::grid::InverseModelParams::default()).unwrap();
        let origin = (3 * LATTICE + 12_345, 5 * LATTICE + 54_321);
        let mut ends = Vec::new();
        for i in 0..2500 {
            let far = (1 << 26) - 1 - i * 7;
            let near = (i * i * 11) % (1 << 26);
            ends.push(if i % 2 == 0 { (origin.0 + far, origin.1 + near) } else { (origin.0 + near, origin.1 + far) });
        }
        let bounds = Bounds { low: (0, 0), high: (1029, 1029) };
        let mut walked = vec![0; (block.width * block.height) as usize];
        let mut counted = walked.clone();
        let counts = &mut scratch.counts;
        counts.begin(bounds, (0, 0));
        for &end in &ends {
            let (x, y) = (Axis::new(origin.0, end.0), Axis::new(origin.1, end.1));
            if BeamCounts::takes(&x, &y) {
                counts.mark(&x, &y);
                update_before_end(&mut walked, block, origin, end, |v: i32| v + 1);
            }
        }
        counts.drain((3, 5), &mut FreeRows { values: &mut counted, width: 1030, free: 1, rule: Sum });
        assert!(walked.iter().sum::<i32>() > 2_000_000 && model.free() < 0);
        assert!(walked == counted);
    }
}
