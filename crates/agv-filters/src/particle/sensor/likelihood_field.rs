//! Likelihood-field model of a planar scanner: a beam's end point is looked up in the map's
//! [`LikelihoodField`], whatever lies between (Thrun, Burgard and Fox, *Probabilistic Robotics*, Table 6.3).
//!
//! How the beams `p_1 … p_n` of a scan go together is a matter of [`ScanForm`]:
//!
//! ```text
//! product:       log w = τ Σ ln p_i          sum of cubes:  log w = ln(1 + Σ p_i³)
//! ```
//!
//! The beam end points are brought to the base frame, in cells, once per scan. Per particle, an index pass turns and
//! shifts them (plain arithmetic on `f32`, which the compiler vectorises for the machine it finds at run time) and a
//! look-up pass adds the table's entries in four fixed lanes: the bits do not depend on the instruction set.

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::{PoseLikelihood, SensorModel};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2},
    grid::LikelihoodField,
    roles::SkipReason,
    sensors::{Beam, LaserScan},
};
use pulp::{Arch, Simd, WithSimd};
use std::sync::Arc;

/// How the beams of a scan make one likelihood.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum ScanForm {
    /// The product of the beams' likelihoods, to the power of `tempering` in (0, 1].
    ///
    /// One takes the beams for independent (`likelihood_field_prob` of `nav2_amcl` and Beluga): sharp. They are not: the
    /// map's error is common to neighbouring beams. A power of `k / n` lets `n` beams count as `k`.
    Product {
        /// The power.
        tempering: f64,
    },
    /// One plus the sum of the cubes (`likelihood_field` of `nav2_amcl` and Beluga): without a derivation, blunt, and
    /// hard to lose.
    SumOfCubes,
}

/// Parameters of a [`LikelihoodFieldModel`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LikelihoodFieldModelParams {
    /// Most beams of a scan that are used, evenly spread.
    pub max_beams: usize,
    /// Fewest usable hits among them for the scan to count.
    pub min_hits: usize,
    /// Hits beyond this range say nothing, in metres: far end points swing with the heading's error.
    pub max_range: f64,
    /// How the beams make one likelihood.
    pub form: ScanForm,
}

impl Default for LikelihoodFieldModelParams {
    /// 60 beams, as `nav2_amcl`, of which 5 must hit within 30 m. 60 count as 18: on the Intel log the effective sample
    /// size is then 21 % of the particles instead of 9 %, at the price of 2 mm.
    fn default() -> Self {
        Self { max_beams: 60, min_hits: 5, max_range: 30.0, form: ScanForm::Product { tempering: 0.3 } }
    }
}

/// What is looked up: the term of a beam, per cell, with a border for all that lies off the map.
#[derive(Debug)]
struct Table {
    /// `ln p` or `p³`, row by row; one cell more on every side.
    terms: Vec<f32>,
    stride: u32,
    /// Greatest column and row, border included.
    last: [f32; 2],
    /// From the map to the grid, and metres to cells.
    grid_from_map: Se2,
    cells_per_metre: f64,
}

/// The likelihood-field model of planar scans.
///
/// Cheap to clone: the table is shared, so that several filters can use one map.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, Grid, GridLayout, LikelihoodField, LikelihoodFieldParams};
/// use agv_core::sensors::{LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
/// use agv_filters::particle::{LikelihoodFieldModel, LikelihoodFieldModelParams, PoseLikelihood, SensorModel};
///
/// // A wall 2 m ahead of the origin.
/// let mut map = Grid::filled(GridLayout::new(60, 60, 0.05, Se2::new(0.0, -1.5, 0.0))?, CellState::Free);
/// (0..60).for_each(|y| { map.set(Cell::new(40, y), CellState::Occupied); });
/// let field = LikelihoodField::new(&map, LikelihoodFieldParams::default())?;
/// let mut model = LikelihoodFieldModel::new(&field, LikelihoodFieldModelParams::default())?;
///
/// let geometry = ScanGeometry { angle_min: -0.05, angle_increment: 0.01, ..Default::default() };
/// let scan = LaserScan::new(Stamp::default(), geometry, vec![2.0; 11])?;
/// let likelihood = model.condition(&scan).expect("eleven beams hit");
/// let (near, off) = (Se2::new(0.02, 0.0, 0.0), Se2::new(0.4, 0.0, 0.0));
/// assert!(likelihood.log_likelihood(&near) > likelihood.log_likelihood(&off));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct LikelihoodFieldModel {
    params: LikelihoodFieldModelParams,
    table: Arc<Table>,
    /// End points in the base frame, in cells, padded to whole blocks.
    ends: Vec<[[f32; BLOCK]; 2]>,
}

/// Beams per step of the index pass: two registers of the widest machines, and little padding for 60 beams.
const BLOCK: usize = 32;

/// Adding 2²³ to a number in [0, 2²²] leaves its nearest whole number in the low bits of the sum.
const ROUNDER: f32 = 8_388_608.0;

impl LikelihoodFieldModel {
    /// Most cells along a side: positions counted in cells must fit an `f32` with room for their fraction.
    pub const MAX_SIDE: usize = 1 << 20;

    /// A model on the field of a map.
    ///
    /// # Errors
    /// Zero or more than [`LaserScan::MAX_BEAMS`] beams, a range that is not finite and positive, a tempering outside
    /// (0, 1], or a map longer than [`MAX_SIDE`](Self::MAX_SIDE).
    pub fn new(field: &LikelihoodField, params: LikelihoodFieldModelParams) -> Result<Self, Error> {
        check::in_range("max_beams", params.max_beams as f64, 1.0, LaserScan::MAX_BEAMS as f64)?;
        check::positive("max_range", params.max_range)?;
        if let ScanForm::Product { tempering } = params.form {
            check::positive("tempering", tempering)?;
            check::in_range("tempering", tempering, 0.0, 1.0)?;
        }
        let table = Arc::new(Table::new(field, params.form)?);
        Ok(Self { params, table, ends: Vec::with_capacity(params.max_beams.div_ceil(BLOCK)) })
    }

    /// The parameters.
    pub const fn params(&self) -> &LikelihoodFieldModelParams {
        &self.params
    }

    /// Collects the end points of the beams that are used; returns their number.
    fn collect_ends(&mut self, scan: &LaserScan) -> usize {
        let (geometry, mount) = (scan.geometry(), scan.geometry().base_from_sensor);
        let (beams, used) = (scan.len(), scan.len().min(self.params.max_beams));
        self.ends.clear();
        let mut hits = 0;
        for k in 0..used {
            // The middle of the k-th of `used` equal parts of the scan.
            let index = (2 * k + 1) * beams / (2 * used);
            let Beam::Hit(range) = scan.interpret(scan.ranges()[index]) else { continue };
            if range > self.params.max_range {
                continue;
            }
            let (sin, cos) = geometry.angle(index).sin_cos();
            let end = mount.act(&[range * cos, range * sin].into()) * self.table.cells_per_metre;
            if hits % BLOCK == 0 {
                self.ends.push([[0.0; BLOCK]; 2]);
            }
            if let Some([x, y]) = self.ends.last_mut() {
                (x[hits % BLOCK], y[hits % BLOCK]) = (end.x as f32, end.y as f32);
            }
            hits += 1;
        }
        hits
    }
}

impl SensorModel<LaserScan> for LikelihoodFieldModel {
    fn condition<'a>(&'a mut self, scan: &'a LaserScan) -> Result<impl PoseLikelihood + 'a, SkipReason> {
        let (usable, needed) = (self.collect_ends(scan), self.params.min_hits.max(1));
        if usable < needed {
            return Err(SkipReason::TooFewReadings { usable, needed });
        }
        Ok(ScanOnTable {
            table: &self.table,
            ends: &self.ends,
            hits: usable,
            form: self.params.form,
            arch: Arch::new(),
        })
    }
}

impl Table {
    fn new(field: &LikelihoodField, form: ScanForm) -> Result<Self, Error> {
        let layout = field.layout();
        let (width, height) = (layout.width(), layout.height());
        for (name, side) in [("map width", width), ("map height", height)] {
            if side > LikelihoodFieldModel::MAX_SIDE {
                return Err(Error::TooMany { name, len: side, max: LikelihoodFieldModel::MAX_SIDE });
            }
        }
        let term = |density: f32| match form {
            ScanForm::Product { .. } => density.ln(),
            ScanForm::SumOfCubes => density * density * density,
        };
        let border = term(field.off_map());
        let mut terms = Vec::with_capacity((width + 2) * (height + 2));
        terms.resize(width + 2, border);
        // Most of a map is far from everything: a logarithm per run of equal cells is enough.
        let mut last = (f32::NAN, border);
        for row in field.values().chunks_exact(width) {
            terms.push(border);
            terms.extend(row.iter().map(|&density| {
                if density != last.0 {
                    last = (density, term(density));
                }
                last.1
            }));
            terms.push(border);
        }
        terms.resize((width + 2) * (height + 2), border);
        Ok(Self {
            terms,
            stride: width as u32 + 2,
            last: [(width + 1) as f32, (height + 1) as f32],
            grid_from_map: layout.map_from_grid().inverse(),
            cells_per_metre: layout.resolution().recip(),
        })
    }
}

/// A scan, ready to judge poses.
struct ScanOnTable<'a> {
    table: &'a Table,
    ends: &'a [[[f32; BLOCK]; 2]],
    hits: usize,
    form: ScanForm,
    arch: Arch,
}

impl ScanOnTable<'_> {
    #[inline(always)]
    fn judge(&self, map_from_base: &Se2) -> f64 {
        let sum = self.sum_of_terms(map_from_base);
        match self.form {
            ScanForm::Product { tempering } => tempering * sum,
            ScanForm::SumOfCubes => sum.ln_1p(),
        }
    }

    /// Sum of the table's entries at all end points.
    #[inline(always)]
    fn sum_of_terms(&self, map_from_base: &Se2) -> f64 {
        let table = self.table;
        let in_grid = table.grid_from_map.compose(map_from_base);
        // One cell of border, less the half that rounding adds to the cell's floor.
        let (x, y) = (in_grid.x() * table.cells_per_metre + 0.5, in_grid.y() * table.cells_per_metre + 0.5);
        let (x, y) = (x as f32, y as f32);
        let (cos, sin) = (in_grid.rotation().cos() as f32, in_grid.rotation().sin() as f32);
        let mut lanes = [0.0_f32; 4];
        let mut left = self.hits;
        for [xs, ys] in self.ends {
            let mut indices = [0_u32; BLOCK];
            for ((index, &bx), &by) in indices.iter_mut().zip(xs).zip(ys) {
                let column = whole(x + (cos * bx - sin * by), table.last[0]);
                let row = whole(y + (sin * bx + cos * by), table.last[1]);
                *index = row * table.stride + column;
            }
            let count = left.min(BLOCK);
            left -= count;
            // Lanes by name, so that they stay in registers.
            let fours = indices[..count].chunks_exact(4);
            let rest = fours.remainder();
            for four in fours {
                lanes[0] += table.terms[four[0] as usize];
                lanes[1] += table.terms[four[1] as usize];
                lanes[2] += table.terms[four[2] as usize];
                lanes[3] += table.terms[four[3] as usize];
            }
            for (lane, &index) in lanes.iter_mut().zip(rest) {
                *lane += table.terms[index as usize];
            }
        }
        f64::from((lanes[0] + lanes[1]) + (lanes[2] + lanes[3]))
    }
}

/// The nearest whole number in [0, last]; NaN gives 0.
#[inline(always)]
fn whole(value: f32, last: f32) -> u32 {
    // In this form each comparison is one instruction; `clamp` would keep NaN, at twice the price.
    let value = if value > 0.0 { value } else { 0.0 };
    let value = if value < last { value } else { last };
    (value + ROUNDER).to_bits() - ROUNDER.to_bits()
}

/// The work on a batch, compiled once for each instruction set.
struct Batch<'a, 'b> {
    scan: &'b ScanOnTable<'a>,
    poses: &'b [Se2],
    log_likelihoods: &'b mut [f64],
}

impl WithSimd for Batch<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (log_likelihood, pose) in self.log_likelihoods.iter_mut().zip(self.poses) {
            *log_likelihood = self.scan.judge(pose);
        }
    }
}

impl PoseLikelihood for ScanOnTable<'_> {
    fn log_likelihood(&self, map_from_base: &Se2) -> f64 {
        self.judge(map_from_base)
    }

    fn log_likelihoods(&self, poses: &[Se2], log_likelihoods: &mut [f64]) {
        self.arch.dispatch(Batch { scan: self, poses, log_likelihoods });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{
        grid::{CellState, Grid, GridLayout, LikelihoodFieldParams},
        sensors::ScanGeometry,
        time::Stamp,
    };
    use proptest::prelude::*;

    fn field() -> LikelihoodField {
        let layout = GridLayout::new(70, 50, 0.1, Se2::new(-2.0, 1.0, 0.3)).unwrap();
        let states = (0..layout.len()).map(|i| if i % 37 == 0 { CellState::Occupied } else { CellState::Free });
        let map = Grid::new(layout, states.collect()).unwrap();
        LikelihoodField::new(&map, LikelihoodFieldParams { sigma_hit: 0.1, ..Default::default() }).unwrap()
    }

    fn scan(ranges: Vec<f32>) -> LaserScan {
        let geometry = ScanGeometry {
            base_from_sensor: Se2::new(0.3, -0.1, 0.2),
            angle_min: -1.5,
            angle_increment: 0.03,
            ..Default::default()
        };
        LaserScan::new(Stamp::default(), geometry, ranges).unwrap()
    }

    proptest! {
        /// The batch agrees with a plain reading of the table in the book, on and off the map.
        #[test]
        fn agrees_with_the_textbook(
            ranges in prop::collection::vec(0.1..6.0_f32, 5..100),
            poses in prop::collection::vec((-6.0..9.0_f64, -4.0..9.0_f64, -3.2..3.2_f64), 1..20),
        ) {
            let (field, scan) = (field(), scan(ranges));
            let poses: Vec<Se2> = poses.into_iter().map(|(x, y, yaw)| Se2::new(x, y, yaw)).collect();
            for form in [ScanForm::Product { tempering: 0.3 }, ScanForm::SumOfCubes] {
                let params = LikelihoodFieldModelParams { max_beams: 100, form, ..Default::default() };
                let mut model = LikelihoodFieldModel::new(&field, params).unwrap();
                let mut batch = vec![0.0; poses.len()];
                model.condition(&scan).unwrap().log_likelihoods(&poses, &mut batch);
                for (pose, got) in poses.iter().zip(batch) {
                    let densities = scan.points_in_base().map(|point| {
                        let end = pose.act(&point);
                        // An end point on the edge of a cell may be rounded into either.
                        let shifts = [(0.0, 0.0), (1e-5, 1e-5), (-1e-5, -1e-5), (1e-5, -1e-5), (-1e-5, 1e-5)];
                        shifts.map(|(dx, dy)| f64::from(field.likelihood_at(&(end + nalgebra::Vector2::new(dx, dy)))))
                    });
                    let (low, high) = densities.fold((0.0, 0.0), |(low, high), p| {
                        let term = |p: f64| if form == ScanForm::SumOfCubes { p.powi(3) } else { 0.3 * p.ln() };
                        let terms = p.map(term);
                        (low + terms.into_iter().fold(f64::INFINITY, f64::min), high + terms.into_iter().fold(f64::NEG_INFINITY, f64::max))
                    });
                    let (low, high) = if form == ScanForm::SumOfCubes { (low.ln_1p(), high.ln_1p()) } else { (low, high) };
                    prop_assert!(got > low - 1e-3 && got < high + 1e-3, "{low} <= {got} <= {high}");
                }
            }
        }

        /// One pose at a time or all at once, with any instruction set: the same bits.
        #[test]
        fn the_batch_has_the_bits_of_the_single_call(poses in prop::collection::vec((-6.0..9.0_f64, -4.0..9.0_f64, -3.2..3.2_f64), 1..20)) {
            let mut model = LikelihoodFieldModel::new(&field(), LikelihoodFieldModelParams::default()).unwrap();
            let scan = scan((0..100).map(|i| 0.5 + 0.04 * i as f32).collect());
            let likelihood = model.condition(&scan).unwrap();
            let poses: Vec<Se2> = poses.into_iter().map(|(x, y, yaw)| Se2::new(x, y, yaw)).collect();
            let mut batch = vec![0.0; poses.len()];
            likelihood.log_likelihoods(&poses, &mut batch);
            let single: Vec<f64> = poses.iter().map(|pose| likelihood.log_likelihood(pose)).collect();
            prop_assert_eq!(batch, single);
        }
    }

    #[test]
    fn scans_that_say_nothing_are_skipped() {
        let mut model = LikelihoodFieldModel::new(&field(), LikelihoodFieldModelParams::default()).unwrap();
        for ranges in
            [vec![], vec![f32::NAN; 50], vec![f32::INFINITY; 50], vec![-1.0; 50], vec![31.0; 50], vec![1.0; 4]]
        {
            let usable = if ranges.len() == 4 { 4 } else { 0 };
            assert_eq!(
                model.condition(&scan(ranges)).map(|_| ()),
                Err(SkipReason::TooFewReadings { usable, needed: 5 })
            );
        }
    }

    #[test]
    fn absurd_poses_read_the_border() {
        let mut model = LikelihoodFieldModel::new(&field(), LikelihoodFieldModelParams::default()).unwrap();
        let scan = scan(vec![1.0; 60]);
        let likelihood = model.condition(&scan).unwrap();
        for pose in [Se2::new(1e300, 0.0, 0.0), Se2::new(-1e9, 1e9, 1.0), Se2::new(f64::NAN, 0.0, 0.0)] {
            assert!((likelihood.log_likelihood(&pose) - 0.3 * 60.0 * 0.005_f64.ln()).abs() < 1e-2);
        }
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = LikelihoodFieldModelParams::default();
        for (name, bad) in [
            ("max_beams", LikelihoodFieldModelParams { max_beams: 0, ..good }),
            ("max_range", LikelihoodFieldModelParams { max_range: f64::NAN, ..good }),
            ("tempering", LikelihoodFieldModelParams { form: ScanForm::Product { tempering: 0.0 }, ..good }),
            ("tempering", LikelihoodFieldModelParams { form: ScanForm::Product { tempering: 1.5 }, ..good }),
        ] {
            let error = LikelihoodFieldModel::new(&field(), bad).unwrap_err();
            assert!(error.to_string().starts_with(name), "{error}");
        }
    }
}
