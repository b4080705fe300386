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

#![expect(clippy::inline_always, reason = "only what is inlined is compiled for the instruction set found at run time")]

use super::{
    PoseLikelihood, ScanForm, SensorModel, UsedBeams,
    beams::hits,
    end_points::{BLOCK, EndPoints, Placement, PointBlock, Raster},
    weigh_per_pose,
};
use agv_core::{
    Error, check,
    geometry::{LieGroup, Se2},
    grid::GaussianGrid,
    roles::SkipReason,
    sensors::LaserScan,
};
use nalgebra::Matrix2;
use pulp::{Arch, Simd, WithSimd};
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
        self.form.validate()
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
    ends: EndPoints,
}

/// The distributions of the four cells around a corner of the grid, in the grid frame, in cells: lower left, lower right, upper
/// left, upper right, side by side for the four to be read at once.
#[derive(Debug, Clone, Copy)]
struct Corner {
    mean: [[f32; 4]; 2],
    /// Entries xx, xy and yy of the inverse covariance.
    information: [[f32; 4]; 3],
    /// Added to the squared distance: zero, or what makes it too far where there is no distribution.
    without: [f32; 4],
}

/// A squared distance whose exponential is nothing.
const FAR: f32 = 1e9;

#[derive(Debug)]
struct Distributions {
    /// Row by row, those on the map's edge included.
    corners: Vec<Corner>,
    raster: Raster,
}

impl Distributions {
    fn new(map: &GaussianGrid, sigma: f64) -> Self {
        let layout = map.layout();
        let (width, height, cells_per_metre) = (layout.width(), layout.height(), layout.resolution().recip());
        let grid_from_map = layout.map_from_grid().inverse();
        let (cos, sin) = (grid_from_map.rotation().cos(), grid_from_map.rotation().sin());
        let turn = Matrix2::new(cos, -sin, sin, cos) * cells_per_metre;
        let widen = Matrix2::identity() * (sigma * cells_per_metre).powi(2);
        let stride = width + 1;
        let nothing = Corner { mean: [[0.0; 4]; 2], information: [[0.0; 4]; 3], without: [FAR; 4] };
        let mut corners = vec![nothing; stride * (height + 1)];
        for index in 0..layout.len() {
            let Some(gaussian) = map.gaussian(layout.cell(index)) else { continue };
            let mean = layout.to_grid(&gaussian.mean);
            let covariance = turn * gaussian.covariance * turn.transpose() + widen;
            let determinant = covariance.m11 * covariance.m22 - covariance.m12 * covariance.m21;
            let information = [covariance.m22, -covariance.m12, covariance.m11].map(|v| (v / determinant) as f32);
            // It is the upper right one of its lower left corner, and so on.
            let lower_left = index / width * stride + index % width;
            for (corner, place) in [(0, 3), (1, 2), (stride, 1), (stride + 1, 0)] {
                let corner = &mut corners[lower_left + corner];
                (corner.mean[0][place], corner.mean[1][place]) = (mean.x as f32, mean.y as f32);
                corner.information.iter_mut().zip(information).for_each(|(slot, v)| slot[place] = v);
                corner.without[place] = 0.0;
            }
        }
        let last = [width as f32, height as f32];
        Self { corners, raster: Raster { grid_from_map, cells_per_metre, stride: stride as u32, last } }
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
        Ok(Self { params, map, ends: EndPoints::with_capacity(params.max_beams) })
    }

    /// The parameters.
    pub const fn params(&self) -> &NdtMapModelParams {
        &self.params
    }

    fn collect_ends(&mut self, scan: &LaserScan) -> usize {
        self.ends.clear();
        for (_, end) in hits(scan, self.params.max_beams, self.params.max_range) {
            self.ends.push(&(end * self.map.raster.cells_per_metre));
        }
        self.ends.len()
    }
}

/// A scan, ready to judge poses.
struct ScanOnDistributions<'a> {
    map: &'a Distributions,
    ends: &'a EndPoints,
    params: &'a NdtMapModelParams,
    power: f64,
    arch: Arch,
}

impl ScanOnDistributions<'_> {
    /// Squared distance of each end point of a block from the nearest distribution, in deviations.
    #[inline(always)]
    fn distances(&self, at: &Placement, block: &PointBlock) -> [f32; BLOCK] {
        let points = at.act(block, 0.0);
        let indices = self.map.raster.nearest_corners(&points);
        let mut squared = [0.0; BLOCK];
        for (k, squared) in squared.iter_mut().enumerate() {
            let Corner { mean, information: [xx, xy, yy], without } = &self.map.corners[indices[k] as usize];
            let mut four = [0.0; 4];
            for (i, four) in four.iter_mut().enumerate() {
                let (dx, dy) = (points[0][k] - mean[0][i], points[1][k] - mean[1][i]);
                *four = (xx[i] * dx + 2.0 * (xy[i] * dy)) * dx + yy[i] * (dy * dy) + without[i];
            }
            // NaN, of an absurd pose, is not less.
            *squared = four.into_iter().fold(FAR, |least, next| if next < least { next } else { least });
        }
        squared
    }

    #[inline(always)]
    fn judge(&self, map_from_base: &Se2) -> f64 {
        let at = self.map.raster.place(map_from_base);
        let (hit, outlier) = (1.0 - self.params.outlier as f32, self.params.outlier as f32);
        let mut sum = 0.0;
        for (block, count) in self.ends.blocks() {
            let mut likelihoods =
                self.distances(&at, block).map(|squared| hit * exp_of_negative(0.5 * squared) + outlier);
            if matches!(self.params.form, ScanForm::SumOfCubes) {
                sum += likelihoods[..count].iter().map(|&p| f64::from(p * p * p)).sum::<f64>();
            } else {
                likelihoods[count..].fill(1.0);
                // A logarithm per block: thirty-two factors of 1e-6 and more are still a number.
                let mut lanes = [1.0; 4];
                for four in likelihoods.chunks_exact(4) {
                    lanes.iter_mut().zip(four).for_each(|(lane, &p)| *lane *= f64::from(p));
                }
                sum += ((lanes[0] * lanes[1]) * (lanes[2] * lanes[3])).ln();
            }
        }
        if matches!(self.params.form, ScanForm::SumOfCubes) { sum.ln_1p() } else { self.power * sum }
    }
}

/// exp(-x) for x >= 0, to 3e-7 of it; zero beyond 87.
///
/// A power of two by its exponent's bits, and the Taylor series of what is left, at most half a factor of two: without calls
/// or branches, so that a block is computed at once.
#[inline(always)]
fn exp_of_negative(x: f32) -> f32 {
    /// Adding 1.5 · 2²³ leaves the nearest whole number in the low bits.
    const ROUNDER: f32 = 12_582_912.0;
    let scaled = (if x < 87.0 { x } else { 87.0 }) * -std::f32::consts::LOG2_E;
    let shifted = scaled + ROUNDER;
    let rest = (scaled - (shifted - ROUNDER)) * std::f32::consts::LN_2;
    let series = 1.0
        + rest * (1.0 + rest * (0.5 + rest * (1.0 / 6.0 + rest * (1.0 / 24.0 + rest * (1.0 / 120.0 + rest / 720.0)))));
    let power = f32::from_bits(shifted.to_bits().wrapping_sub(ROUNDER.to_bits()).wrapping_add(127) << 23);
    if x < 87.0 { series * power } else { 0.0 }
}

/// The work on a batch, compiled once for each instruction set.
struct Batch<'a, 'b> {
    scan: &'b ScanOnDistributions<'a>,
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

impl PoseLikelihood for ScanOnDistributions<'_> {
    fn log_likelihood(&self, map_from_base: &Se2) -> f64 {
        self.judge(map_from_base)
    }

    fn log_likelihoods(&self, poses: &[Se2], log_likelihoods: &mut [f64]) {
        self.arch.dispatch(Batch { scan: self, poses, log_likelihoods });
    }

    fn explained(&self, map_from_base: &Se2) -> Option<f64> {
        let within = self.params.explained_within * self.params.explained_within;
        let at = self.map.raster.place(map_from_base);
        let near = |(block, count): (&PointBlock, usize)| {
            let squared = self.distances(&at, block);
            squared[..count].iter().filter(|&&squared| f64::from(squared) <= within).count()
        };
        Some(self.ends.blocks().map(near).sum::<usize>() as f64 / self.ends.len().max(1) as f64)
    }
}

impl SensorModel<LaserScan> for NdtMapModel {
    fn condition<'a>(&'a mut self, scan: &'a LaserScan) -> Result<impl PoseLikelihood + 'a, SkipReason> {
        let (usable, needed) = (self.collect_ends(scan), self.params.min_hits.max(1));
        if usable < needed {
            return Err(SkipReason::TooFewReadings { usable, needed });
        }
        let (power, arch) = (self.params.form.power(usable), Arch::new());
        Ok(ScanOnDistributions { map: &self.map, ends: &self.ends, params: &self.params, power, arch })
    }

    fn independent_readings(&self) -> f64 {
        self.params.form.independent_readings(self.ends.len())
    }
}

weigh_per_pose!(NdtMapModel: LaserScan);

impl UsedBeams for NdtMapModel {
    fn max_beams(&self) -> usize {
        self.params.max_beams
    }

    fn max_range(&self) -> f64 {
        self.params.max_range
    }
}

#[cfg(test)]
mod tests;
