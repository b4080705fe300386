//! The methods by name.

use crate::{Args, Result};
use agv_nav::core::roles::Registration;
use agv_nav::ndt::gicp::{PointMetric, PointParams, PointRegistration};
use agv_nav::ndt::ndt::{NdtParams, NdtRegistration, VoxelParams};

/// Who aligns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Method {
    /// Normal distributions transform
    Ndt,
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
            Self::Gicp => "gicp",
            Self::Vgicp => "vgicp",
            Self::Icp => "icp",
        }
    }

    /// Voxels want more points than pairs of points do.
    pub(crate) const fn target_leaf(self) -> f32 {
        match self {
            Self::Ndt => 0.1,
            Self::Gicp | Self::Vgicp | Self::Icp => 0.25,
        }
    }

    pub(crate) fn build(self, args: &Args) -> Result<Box<dyn Registration>> {
        let voxels = VoxelParams { resolution: args.resolution, ..VoxelParams::default() };
        let points = |metric| -> Result<Box<dyn Registration>> {
            let params = PointParams { metric, resolution: args.resolution, ..PointParams::default() };
            Ok(Box::new(PointRegistration::new(params)?.with_parallelism(args.common.par())))
        };
        Ok(match self {
            Self::Gicp => points(PointMetric::Generalized)?,
            Self::Vgicp => points(PointMetric::Voxelized)?,
            Self::Icp => points(PointMetric::PointToPlane)?,
            Self::Ndt => {
                let params = NdtParams { voxels, outlier_ratio: args.outlier_ratio, ..NdtParams::default() };
                Box::new(NdtRegistration::new(params)?.with_parallelism(args.common.par()))
            }
        })
    }
}
