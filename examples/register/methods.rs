//! The methods by name.

use crate::{Args, Result};
use agv_nav::core::roles::Registration;
use agv_nav::ndt::ndt::{NdtParams, NdtRegistration, VoxelParams};

/// Who aligns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Method {
    /// Normal distributions transform
    Ndt,
}

impl Method {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Ndt => "ndt",
        }
    }

    /// Voxels want more points than pairs of points do.
    pub(crate) const fn target_leaf(self) -> f32 {
        match self {
            Self::Ndt => 0.1,
        }
    }

    pub(crate) fn build(self, args: &Args) -> Result<Box<dyn Registration>> {
        let voxels = VoxelParams { resolution: args.resolution, ..VoxelParams::default() };
        Ok(match self {
            Self::Ndt => {
                let params = NdtParams { voxels, ..NdtParams::default() };
                Box::new(NdtRegistration::new(params)?.with_parallelism(args.common.par()))
            }
        })
    }
}
