//! NDT-map model of a planar scanner: a beam's end point is looked up in the normal distributions of a map's cells.
//!
//! Walls that a likelihood field draws cell by cell are lines here: a [`GaussianGrid`] of 0.5 m cells is a hundredth of an
//! occupancy grid of 5 cm, and knows walls to less than its cells. With `(μ, Σ)` the distributions of the four cells whose
//! centres surround the end point `e`,
//!
//! ```text
//! q = min over the cells of (e - μ)ᵀ (Σ + σ² I)⁻¹ (e - μ)          p = (1 - outlier) exp(-q / 2) + outlier
//! ```
//!
//! (Biber and Straßer, *The normal distributions transform*, 2003, whose four shifted grids the nearest four cells stand for;
//! Saarinen et al., *Normal distributions transform Monte-Carlo localization*, 2013). Beams go together as [`ScanForm`] says.

use super::{MaxBeams, PoseLikelihood, ScanForm, SensorModel, beams::evenly_spread, weigh_per_pose};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2},
    grid::{Gaussian2, GaussianGrid},
    roles::SkipReason,
    sensors::{Beam, LaserScan},
};
use nalgebra::{Matrix2, Vector2};
use std::sync::Arc;

/// Parameters of an [`NdtMapModel`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct NdtMapModelParams {
    /// Standard deviation that is added to every distribution, in metres: the noise of the scanner, and the map's error.
    pub sigma: f64,
    /// Likelihood of a beam that ends far from every distribution, as a share of that of one that ends in the mean; in
    /// [1e-6, 1). So does one that ends off the map, or where too little was seen for a distribution.
    pub outlier: f64,
    /// Most beams of a scan that are used, evenly spread.
    pub max_beams: usize,
    /// Fewest usable hits among them for the scan to count.
    pub min_hits: usize,
    /// Hits beyond this range say nothing, in metres: far end points swing with the heading's error.
    pub max_range: f64,
    /// How the beams make one likelihood.
    pub form: ScanForm,
    /// A beam counts as explained by a pose if it ends within so many deviations of a distribution.
    pub explained_within: f64,
}

impl Default for NdtMapModelParams {
    /// 0.1 m, the width that 5 cm maps and a heading off by half a degree at 10 m make; outliers as in `nav2_amcl`'s likelihood
    /// field, one to two hundred. Beams and their combination as
    /// [`LikelihoodFieldModelParams`](crate::particle::LikelihoodFieldModelParams); three deviations are explained.
    fn default() -> Self {
        Self {
            sigma: 0.1,
            outlier: 0.005,
            max_beams: 60,
            min_hits: 5,
            max_range: 30.0,
            form: ScanForm::Product { independent_beams: 18.0 },
            explained_within: 3.0,
        }
    }
}

impl NdtMapModelParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// Zero or more than [`LaserScan::MAX_BEAMS`] beams, a share out of its range, or another field that is not finite and
    /// positive.
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("sigma", self.sigma)?;
        check::in_range("outlier", self.outlier, 1e-6, 1.0_f64.next_down())?;
        check::in_range("max_beams", self.max_beams as f64, 1.0, LaserScan::MAX_BEAMS as f64)?;
        check::positive("max_range", self.max_range)?;
        check::positive("explained_within", self.explained_within)?;
        if let ScanForm::Product { independent_beams } = self.form {
            check::positive("independent_beams", independent_beams)?;
        }
        Ok(())
    }
}

/// The NDT-map model of planar scans.
///
/// Cheap to clone: the map is shared.
///
/// ```
/// use agv_core::geometry::Se2;
/// use agv_core::grid::{Cell, CellState, GaussianGrid, GaussianParams, Grid, GridLayout};
/// use agv_core::sensors::{LaserScan, ScanGeometry};
/// use agv_core::time::Stamp;
/// use agv_filters::particle::{NdtMapModel, NdtMapModelParams, PoseLikelihood, SensorModel};
///
/// // A wall 2 m ahead of the origin.
/// let mut map = Grid::filled(GridLayout::new(60, 60, 0.05, Se2::new(0.0, -1.5, 0.0))?, CellState::Free);
/// (0..60).for_each(|y| { map.set(Cell::new(40, y), CellState::Occupied); });
/// let distributions = GaussianGrid::from_map(&map, 0.5, GaussianParams::default())?;
/// let mut model = NdtMapModel::new(&distributions, NdtMapModelParams::default())?;
///
/// let geometry = ScanGeometry { angle_min: -0.05, angle_increment: 0.01, ..Default::default() };
/// let scan = LaserScan::new(Stamp::default(), geometry, vec![2.0; 11])?;
/// let likelihood = model.condition(&scan).expect("eleven beams hit");
/// let (near, off) = (Se2::new(0.02, 0.0, 0.0), Se2::new(0.4, 0.0, 0.0));
/// assert!(likelihood.log_likelihood(&near) > likelihood.log_likelihood(&off));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct NdtMapModel {
    params: NdtMapModelParams,
    map: Arc<Distributions>,
    /// End points in the base frame, in cells.
    ends: Vec<[f32; 2]>,
}

/// A cell's distribution in the grid frame, in cells.
#[derive(Debug, Clone, Copy)]
struct Packed {
    mean: [f32; 2],
    /// Entries xx, xy and yy of the inverse covariance.
    information: [f32; 3],
    /// Added to the squared distance: zero, or what makes it too far where there is no distribution.
    without: f32,
}

/// A squared distance whose exponential is nothing.
const FAR: f32 = 1e9;

#[derive(Debug)]
struct Distributions {
    /// Row by row, with a border of one without distribution.
    cells: Vec<Packed>,
    stride: usize,
    last: [f32; 2],
    grid_from_map: Se2,
    cells_per_metre: f64,
}

impl Distributions {
    fn new(map: &GaussianGrid, sigma: f64) -> Self {
        let layout = map.layout();
        let (width, height, cells_per_metre) = (layout.width(), layout.height(), layout.resolution().recip());
        let grid_from_map = layout.map_from_grid().inverse();
        let (cos, sin) = (grid_from_map.rotation().cos(), grid_from_map.rotation().sin());
        let turn = Matrix2::new(cos, -sin, sin, cos) * cells_per_metre;
        let widen = Matrix2::identity() * (sigma * cells_per_metre).powi(2);
        let pack = |gaussian: Gaussian2| {
            let mean = layout.to_grid(&gaussian.mean);
            let covariance = turn * gaussian.covariance * turn.transpose() + widen;
            let inverse = Matrix2::new(covariance.m22, -covariance.m12, -covariance.m21, covariance.m11)
                / (covariance.m11 * covariance.m22 - covariance.m12 * covariance.m21);
            let information = [inverse.m11 as f32, inverse.m12 as f32, inverse.m22 as f32];
            Packed { mean: [mean.x as f32, mean.y as f32], information, without: 0.0 }
        };
        let stride = width + 2;
        let nothing = Packed { mean: [0.0; 2], information: [0.0; 3], without: FAR };
        let mut cells = vec![nothing; stride * (height + 2)];
        for index in 0..layout.len() {
            if let Some(gaussian) = map.gaussian(layout.cell(index)) {
                cells[(index / width + 1) * stride + index % width + 1] = pack(gaussian);
            }
        }
        // The four cells around a point: the last one to start from is one before the border.
        Self { cells, stride, last: [width as f32, height as f32], grid_from_map, cells_per_metre }
    }
}

impl NdtMapModel {
    /// A model on the distributions of a map, which may come from points or from an occupancy grid.
    ///
    /// # Errors
    /// Parameters that [`validate`](NdtMapModelParams::validate) refuses.
    pub fn new(map: &GaussianGrid, params: NdtMapModelParams) -> Result<Self, Error> {
        params.validate()?;
        let map = Arc::new(Distributions::new(map, params.sigma));
        Ok(Self { params, map, ends: Vec::with_capacity(params.max_beams.min(1 << 12)) })
    }

    /// The parameters.
    pub const fn params(&self) -> &NdtMapModelParams {
        &self.params
    }

    fn collect_ends(&mut self, scan: &LaserScan) -> usize {
        let geometry = scan.geometry();
        self.ends.clear();
        for index in evenly_spread(scan.len(), self.params.max_beams) {
            let Beam::Hit(range) = scan.interpret(scan.ranges()[index]) else { continue };
            if range <= self.params.max_range {
                let (sin, cos) = geometry.angle(index).sin_cos();
                let end = geometry.base_from_sensor.act(&[range * cos, range * sin].into());
                let end = end * self.map.cells_per_metre;
                self.ends.push([end.x as f32, end.y as f32]);
            }
        }
        self.ends.len()
    }
}

/// A scan, ready to judge poses.
struct ScanOnDistributions<'a> {
    map: &'a Distributions,
    ends: &'a [[f32; 2]],
    params: &'a NdtMapModelParams,
    power: f64,
}

/// Beams whose product is taken before a logarithm: 1e-6 to this power is still a number.
const TOGETHER: usize = 32;

impl ScanOnDistributions<'_> {
    /// Squared distance of each end point from the nearest distribution, in deviations.
    #[inline]
    fn distances(&self, map_from_base: &Se2) -> impl Iterator<Item = f32> + '_ {
        let map = self.map;
        let in_grid = map.grid_from_map.compose(map_from_base);
        let at: Vector2<f64> = in_grid.translation() * map.cells_per_metre;
        let (x, y) = (at.x as f32, at.y as f32);
        let (cos, sin) = (in_grid.rotation().cos() as f32, in_grid.rotation().sin() as f32);
        self.ends.iter().map(move |&[bx, by]| {
            let (ex, ey) = (x + (cos * bx - sin * by), y + (sin * bx + cos * by));
            // The lower left one of the four, with the border counted; what is below zero, and NaN, goes to zero.
            let column = (ex + 0.5).min(map.last[0]) as usize;
            let row = (ey + 0.5).min(map.last[1]) as usize;
            let first = row * map.stride + column;
            let mut least = FAR;
            for index in [first, first + 1, first + map.stride, first + map.stride + 1] {
                let cell = &map.cells[index];
                let (dx, dy) = (ex - cell.mean[0], ey - cell.mean[1]);
                let [xx, xy, yy] = cell.information;
                // NaN, of an absurd pose, is not less.
                let squared = (xx * dx + 2.0 * (xy * dy)) * dx + yy * (dy * dy) + cell.without;
                least = if squared < least { squared } else { least };
            }
            least
        })
    }
}

impl PoseLikelihood for ScanOnDistributions<'_> {
    fn log_likelihood(&self, map_from_base: &Se2) -> f64 {
        let (hit, outlier) = (1.0 - self.params.outlier, self.params.outlier);
        let likelihoods =
            self.distances(map_from_base).map(|squared| hit * f64::from((-0.5 * squared).exp()) + outlier);
        if matches!(self.params.form, ScanForm::SumOfCubes) {
            return likelihoods.map(|p| p * p * p).sum::<f64>().ln_1p();
        }
        let (mut sum, mut product, mut factors) = (0.0, 1.0, 0);
        for p in likelihoods {
            (product, factors) = (product * p, factors + 1);
            if factors == TOGETHER {
                sum += product.ln();
                (product, factors) = (1.0, 0);
            }
        }
        self.power * (sum + product.ln())
    }

    fn explained(&self, map_from_base: &Se2) -> Option<f64> {
        let within = self.params.explained_within * self.params.explained_within;
        let explained = self.distances(map_from_base).filter(|&squared| f64::from(squared) <= within).count();
        Some(explained as f64 / self.ends.len().max(1) as f64)
    }
}

impl SensorModel<LaserScan> for NdtMapModel {
    fn condition<'a>(&'a mut self, scan: &'a LaserScan) -> Result<impl PoseLikelihood + 'a, SkipReason> {
        let (usable, needed) = (self.collect_ends(scan), self.params.min_hits.max(1));
        if usable < needed {
            return Err(SkipReason::TooFewReadings { usable, needed });
        }
        let power = match self.params.form {
            ScanForm::Product { independent_beams } => (independent_beams / usable as f64).min(1.0),
            ScanForm::SumOfCubes => 1.0,
        };
        Ok(ScanOnDistributions { map: &self.map, ends: &self.ends, params: &self.params, power })
    }
}

weigh_per_pose!(NdtMapModel: LaserScan);

impl MaxBeams for NdtMapModel {
    fn max_beams(&self) -> usize {
        self.params.max_beams
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{
        grid::{Cell, GaussianParams, GridLayout},
        sensors::ScanGeometry,
        time::Stamp,
    };
    use proptest::prelude::*;

    /// Two walls, in a grid that is turned.
    fn map() -> GaussianGrid {
        let layout = GridLayout::new(9, 7, 0.5, Se2::new(-1.0, -2.0, 0.4)).unwrap();
        let mut map = GaussianGrid::new(layout, GaussianParams::default()).unwrap();
        let wiggle = |i: i32| 0.01 * f64::from(i % 5);
        map.extend((0..300).map(|i| layout.to_map(&Vector2::new(0.5 + 0.025 * f64::from(i), 5.3 + wiggle(i)))));
        map.extend((0..200).map(|i| layout.to_map(&Vector2::new(7.6 + wiggle(i), 0.5 + 0.025 * f64::from(i)))));
        map
    }

    fn scan(ranges: Vec<f32>) -> LaserScan {
        let geometry = ScanGeometry {
            base_from_sensor: Se2::new(0.3, -0.1, 0.2),
            angle_min: -1.5,
            angle_increment: 0.07,
            ..Default::default()
        };
        LaserScan::new(Stamp::default(), geometry, ranges).unwrap()
    }

    proptest! {
        /// The least distance over the four cells, from the grid's own distributions.
        #[test]
        fn agrees_with_the_definition(
            ranges in prop::collection::vec(0.1..5.0_f32, 5..50),
            x in -2.0..4.0_f64, y in -3.0..3.0_f64, yaw in -3.2..3.2_f64,
        ) {
            let (map, scan, pose) = (map(), scan(ranges), Se2::new(x, y, yaw));
            let params = NdtMapModelParams { form: ScanForm::Product { independent_beams: 100.0 }, ..Default::default() };
            let mut model = NdtMapModel::new(&map, params).unwrap();
            let got = model.condition(&scan).unwrap().log_likelihood(&pose);
            let widen = Matrix2::identity() * params.sigma * params.sigma;
            let mut expected = 0.0;
            for end in scan.points_in_base().map(|point| pose * point) {
                let in_cells = map.layout().to_grid(&end);
                let (i, j) = ((in_cells.x - 0.5).floor() as i32, (in_cells.y - 0.5).floor() as i32);
                let squared = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(a, b)| {
                    map.gaussian(Cell::new(i + a, j + b)).map_or(f64::INFINITY, |g| {
                        let d = end - g.mean;
                        d.dot(&((g.covariance + widen).try_inverse().unwrap() * d))
                    })
                });
                let least = squared.into_iter().fold(f64::INFINITY, f64::min);
                expected += ((1.0 - params.outlier) * (-0.5 * least).exp() + params.outlier).ln();
            }
            prop_assert!((got - expected).abs() < 2e-3 * expected.abs().max(1.0), "{} {}", got, expected);
        }
    }

    #[test]
    fn scans_that_say_nothing_are_skipped_and_absurd_poses_read_the_outlier() {
        let mut model = NdtMapModel::new(&map(), NdtMapModelParams::default()).unwrap();
        for ranges in [vec![], vec![f32::NAN; 50], vec![f32::INFINITY; 50], vec![-1.0; 50], vec![1.0; 4]] {
            let usable = if ranges.len() == 4 { 4 } else { 0 };
            assert_eq!(
                model.condition(&scan(ranges)).map(|_| ()),
                Err(SkipReason::TooFewReadings { usable, needed: 5 })
            );
        }
        let scan = scan(vec![1.0; 40]);
        let judged = model.condition(&scan).unwrap();
        for pose in [Se2::new(1e300, 0.0, 0.0), Se2::new(-1e9, 1e9, 1.0), Se2::new(f64::NAN, 0.0, 0.0)] {
            assert!((judged.log_likelihood(&pose) - 18.0 * 0.005_f64.ln()).abs() < 1e-6, "{pose:?}");
            assert_eq!(judged.explained(&pose), Some(0.0));
        }
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = NdtMapModelParams::default();
        for (name, bad) in [
            ("sigma", NdtMapModelParams { sigma: 0.0, ..good }),
            ("outlier", NdtMapModelParams { outlier: 0.0, ..good }),
            ("outlier", NdtMapModelParams { outlier: 1.0, ..good }),
            ("max_beams", NdtMapModelParams { max_beams: 0, ..good }),
            ("max_range", NdtMapModelParams { max_range: f64::NAN, ..good }),
            ("explained_within", NdtMapModelParams { explained_within: -1.0, ..good }),
            ("independent_beams", NdtMapModelParams { form: ScanForm::Product { independent_beams: 0.0 }, ..good }),
        ] {
            let error = NdtMapModel::new(&map(), bad).unwrap_err();
            assert!(error.to_string().starts_with(name), "{error}");
        }
    }
}
