//! What a registration of points may be told.

use super::surface::FLATNESS;
use crate::preprocess::NormalParams;
use crate::registration::{DescentParams, Freedom, MIN_POINTS};
use agv_core::{Error, check};

/// How the distance of a pair of points is weighed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum PointMetric {
    /// To the plane of the target's point (Chen and Medioni 1992).
    PointToPlane,
    /// Plane to plane: both points are flat distributions (Segal, Haehnel and Thrun, *Generalized-ICP*, 2009).
    #[default]
    Generalized,
    /// As [`Generalized`](Self::Generalized), with the mean of the target's points and distributions in the voxel that the source's
    /// point falls into: no search for the nearest (Koide et al., *Voxelized GICP*, 2021).
    Voxelized,
}

/// Parameters of [`PointRegistration`](super::PointRegistration).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PointParams {
    /// How pairs are weighed.
    pub metric: PointMetric,
    /// Distance beyond which points are no pair, in metres.
    pub max_distance: f32,
    /// Edge of the voxels of [`PointMetric::Voxelized`], in metres.
    pub resolution: f64,
    /// How normals are found.
    pub normals: NormalParams,
    /// What of the pose may change.
    pub freedom: Freedom,
    /// When to stop.
    pub descent: DescentParams,
    /// Scale of the robust kernel of the last steps, in metres along a normal: pairs that are well beyond it count for nothing then.
    /// From 1 mm to 1 km. Where the descent by squares does not come to rest, or is degenerate, it is not used; each of the two descents
    /// has the iterations of [`descent`](Self::descent). None for squares to the end.
    pub kernel: Option<f64>,
    /// Distance up to which a pair is an inlier, in metres: from the target's plane, or from the source's where the metric is
    /// [`Voxelized`](PointMetric::Voxelized); between the points where that has no normal. Where both have one, as the generalized metric
    /// has it, the surfaces must also face the same way within 45°.
    pub inlier_distance: f64,
    /// Finite points of a source below which a result is [`TooFewPoints`](agv_core::roles::Termination::TooFewPoints): a handful fits
    /// anywhere.
    pub min_points: usize,
    /// Share of inliers below which a result is [`PoorFit`](agv_core::roles::Termination::PoorFit).
    pub min_inlier_ratio: f64,
    /// Share of the inliers that must face a direction for it to be observed.
    pub min_facing_share: f64,
}

impl Default for PointParams {
    /// Generalized ICP with pairs of up to 1 m and voxels of 1 m, as `small_gicp` has them; the kernel is five times a lidar's noise, as
    /// [`LoamParams`](crate::loam::LoamParams) has it.
    fn default() -> Self {
        Self {
            metric: PointMetric::Generalized,
            max_distance: 1.0,
            resolution: 1.0,
            normals: NormalParams::default(),
            freedom: Freedom::Full,
            descent: DescentParams::default(),
            kernel: Some(0.1),
            inlier_distance: 0.1,
            min_points: MIN_POINTS,
            min_inlier_ratio: 0.5,
            min_facing_share: 0.01,
        }
    }
}

impl PointParams {
    /// Square of the kernel's scale in units of the metric: variances along a normal are those of one plane, or of two.
    pub(super) fn kernel_square(&self) -> Option<f64> {
        let planes = if self.metric == PointMetric::PointToPlane { 1.0 } else { 2.0 };
        self.kernel.map(|kernel| kernel * kernel / (planes * FLATNESS))
    }

    pub(super) fn validate(&self) -> Result<(), Error> {
        self.normals.validate()?;
        self.descent.validate()?;
        check::positive("max_distance", f64::from(self.max_distance))?;
        check::in_range("resolution", self.resolution, 0.01, 1000.0)?;
        if let Some(kernel) = self.kernel {
            check::in_range("kernel", kernel, 1e-3, 1e3)?;
        }
        check::positive("inlier_distance", self.inlier_distance)?;
        check::at_least("min_points", self.min_points, 1)?;
        check::in_range("min_inlier_ratio", self.min_inlier_ratio, 0.0, 1.0)?;
        check::positive("min_facing_share", self.min_facing_share)?;
        check::in_range("min_facing_share", self.min_facing_share, 0.0, 1.0)?;
        Ok(())
    }
}
