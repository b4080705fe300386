//! What the planar matcher may be told.

use agv_core::{Error, check, grid::GaussianParams};

/// Parameters of [`NdtScanMatcher`](super::NdtScanMatcher).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct NdtScanMatcherParams {
    /// Edge of the finest cells, in metres.
    pub resolution: f64,
    /// Levels before the finest, each of cells twice as large: 0 to 6.
    pub coarse_levels: u32,
    /// How a cell's points become a distribution.
    pub cells: GaussianParams,
    /// Share of points that meet no surface of the target, in the mixture's uniform part: 0.001 to 0.999.
    pub outlier_ratio: f64,
    /// Most evaluations of each level.
    pub max_iterations: usize,
    /// At rest when a step moves less than this, in metres, ...
    pub translation_tolerance: f64,
    /// ... and turns less than this, in radians.
    pub rotation_tolerance: f64,
    /// Fewest readings that a scan, or a target, must have.
    pub min_points: usize,
    /// Share of inliers below which a result is [`PoorFit`](agv_core::roles::Termination::PoorFit).
    pub min_inlier_ratio: f64,
    /// Share of the points that must face a direction for it to be observed.
    pub min_facing_share: f64,
}

impl Default for NdtScanMatcherParams {
    /// Cells of 0.5 m, half of what Biber and Straßer have, since scanners are denser now, after 2 m and 1 m: guesses may be a metre
    /// off. Tolerances below a scanner's noise, and the outliers of [`NdtParams`](super::super::NdtParams).
    fn default() -> Self {
        Self {
            resolution: 0.5,
            coarse_levels: 2,
            cells: GaussianParams { min_sigma: 0.01, ..GaussianParams::default() },
            outlier_ratio: 0.3,
            max_iterations: 40,
            translation_tolerance: 2e-4,
            rotation_tolerance: 1e-4,
            min_points: 20,
            min_inlier_ratio: 0.5,
            min_facing_share: 0.02,
        }
    }
}

impl NdtScanMatcherParams {
    pub(super) fn validate(&self) -> Result<(), Error> {
        check::in_range("resolution", self.resolution, 0.01, 100.0)?;
        check::in_range("coarse_levels", f64::from(self.coarse_levels), 0.0, 6.0)?;
        check::in_range("outlier_ratio", self.outlier_ratio, 0.001, 0.999)?;
        check::at_least("max_iterations", self.max_iterations, 1)?;
        check::positive("translation_tolerance", self.translation_tolerance)?;
        check::positive("rotation_tolerance", self.rotation_tolerance)?;
        check::at_least("min_points", self.min_points, 3)?;
        check::in_range("min_inlier_ratio", self.min_inlier_ratio, 0.0, 1.0)?;
        check::positive("min_facing_share", self.min_facing_share)?;
        check::in_range("min_facing_share", self.min_facing_share, 0.0, 1.0)?;
        Ok(())
    }
}
