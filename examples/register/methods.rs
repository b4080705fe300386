//! The methods by name.

use crate::{Args, Result};
use agv_nav::core::roles::Registration;
use agv_nav::ndt::gicp::{PointMetric, PointParams, PointRegistration};
use agv_nav::ndt::ndt::{DistributionRegistration, NdtParams, NdtRegistration, VoxelParams};

/// Who aligns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Method {
    /// Normal distributions transform
    Ndt,
    /// Normal distributions of both clouds
    D2d,
    /// Generalized iterated closest points
    Gicp,
    /// Generalized, voxel by voxel
    Vgicp,
    /// Iterated closest points, point to plane
    Icp,
}

impl Method {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Ndt => "ndt",
            Self::D2d => "d2d",
            Self::Gicp => "gicp",
            Self::Vgicp => "vgicp",
            Self::Icp => "icp",
        }
    }

    /// The source of a method that makes voxels of it is thinned out as a target of voxels is.
    pub(crate) const fn source_leaf(self) -> f32 {
        match self {
            Self::D2d => 0.1,
            Self::Ndt | Self::Gicp | Self::Vgicp | Self::Icp => 0.25,
        }
    }

    /// Voxels want more points than pairs of points do.
    pub(crate) const fn target_leaf(self) -> f32 {
        match self {
            Self::Ndt | Self::D2d => 0.1,
            Self::Gicp | Self::Vgicp | Self::Icp => 0.25,
        }
    }

    pub(crate) fn build(self, args: &Args) -> Result<Box<dyn Registration>> {
        let voxels = VoxelParams { resolution: args.resolution, ..VoxelParams::default() };
        let points = |metric| -> Result<Box<dyn Registration>> {
            let params = PointParams { metric, resolution: args.resolution, ..PointParams::default() };
            Ok(Box::new(PointRegistration::new(params)?.with_parallelism(args.common.par())))
        };
        let distributions = NdtParams { voxels, outlier_ratio: args.outlier_ratio, ..NdtParams::default() };
        Ok(match self {
            Self::Gicp => points(PointMetric::Generalized)?,
            Self::Vgicp => points(PointMetric::Voxelized)?,
            Self::Icp => points(PointMetric::PointToPlane)?,
            Self::Ndt => Box::new(NdtRegistration::new(distributions)?.with_parallelism(args.common.par())),
            Self::D2d => Box::new(DistributionRegistration::new(distributions)?.with_parallelism(args.common.par())),
        })
    }
}
