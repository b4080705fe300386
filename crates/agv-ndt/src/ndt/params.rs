//! What a registration by normal distributions may be told.

use super::{
    gaussian::{MAX_DOUBLINGS, VoxelParams},
    search::VoxelSearch,
};
use crate::registration::{DescentParams, Freedom, MIN_POINTS, Optimizer};
use agv_core::{Error, check};

/// Parameters of [`NdtRegistration`](super::NdtRegistration).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct NdtParams {
    /// Voxels of the finest level, and how they become distributions.
    pub voxels: VoxelParams,
    /// Levels before the finest, each of voxels twice as large: 0 to 6.
    pub coarse_levels: u32,
    /// Which distributions a point feels.
    pub search: VoxelSearch,
    /// Share of points that meet no distribution's surface, in the mixture's uniform part: 0.001 to 0.999.
    pub outlier_ratio: f64,
    /// What of the pose may change.
    pub freedom: Freedom,
    /// Whether the pose keeps the guess's place along directions that the source does not fix. If not, it slides along them as noise
    /// has it, and the outcome is [`Degenerate`](agv_core::roles::Termination::Degenerate).
    pub hold_unobserved: bool,
    /// How the score is climbed.
    pub optimizer: Optimizer,
    /// When to stop, on the finest level.
    pub descent: DescentParams,
    /// How often the search runs through the levels again from where it ended, if that was no good fit.
    pub restarts: u32,
    /// Finite points of a source below which a result is [`TooFewPoints`](agv_core::roles::Termination::TooFewPoints): a handful fits
    /// anywhere.
    pub min_points: usize,
    /// Share of inliers below which a result is [`PoorFit`](agv_core::roles::Termination::PoorFit). Coarse voxels explain more than fine
    /// ones, also where the pose is wrong: the default is for voxels of about a metre. At half a metre right poses fall short of it,
    /// and far above a metre wrong ones do not (`docs/experiments.md`).
    pub min_inlier_ratio: f64,
    /// Share of the points that must face a direction for it to be observed.
    pub min_facing_share: f64,
}

impl Default for NdtParams {
    /// Two coarse levels (4 m and 2 m), from which every guess within 2 m and 20° was found on three recorded pairs. A share of
    /// outliers of 0.3 and not PCL's 0.55: the score is sharper, and was closer to the reference on six of seven pairs. On those pairs
    /// right poses have inliers of 0.64 to 0.81, and wrong ones, from 182 guesses 2 to 10 m off, at most 0.50
    /// (`docs/experiments.md`).
    fn default() -> Self {
        Self {
            voxels: VoxelParams::default(),
            coarse_levels: 2,
            search: VoxelSearch::Direct8,
            outlier_ratio: 0.3,
            freedom: Freedom::Full,
            hold_unobserved: false,
            optimizer: Optimizer::TrustRegion,
            descent: DescentParams::default(),
            restarts: 2,
            min_points: MIN_POINTS,
            min_inlier_ratio: 0.55,
            min_facing_share: 0.01,
        }
    }
}

impl NdtParams {
    pub(super) fn validate(&self) -> Result<(), Error> {
        self.voxels.validate()?;
        self.descent.validate()?;
        check::in_range("coarse_levels", f64::from(self.coarse_levels), 0.0, f64::from(MAX_DOUBLINGS))?;
        check::in_range("outlier_ratio", self.outlier_ratio, 0.001, 0.999)?;
        check::at_least("min_points", self.min_points, 1)?;
        check::in_range("min_inlier_ratio", self.min_inlier_ratio, 0.0, 1.0)?;
        check::positive("min_facing_share", self.min_facing_share)?;
        check::in_range("min_facing_share", self.min_facing_share, 0.0, 1.0)?;
        Ok(())
    }
}
