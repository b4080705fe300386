//! The methods by name.

use crate::{Args, Result};
use agv_nav::core::roles::LidarOdometry;
use agv_nav::ndt::{
    gicp::{PointParams, PointRegistration},
    loam::{LoamOdometry, LoamParams, LoamSolve, LoamTarget},
    ndt::{NdtParams, NdtRegistration},
    odometry::{Follow, FollowParams},
};

/// Who follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Method {
    /// Edges and surfaces
    Loam,
    /// Normal distributions transform
    Ndt,
    /// Generalized iterated closest points
    Gicp,
}

/// What loam aligns scans with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Target {
    /// The last scan
    Last,
    /// The local map
    Map,
    /// The last scan, then the local map
    Both,
}

impl Method {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Loam => "loam",
            Self::Ndt => "ndt",
            Self::Gicp => "gicp",
        }
    }

    pub(crate) fn build(self, args: &Args) -> Result<Box<dyn LidarOdometry>> {
        let par = args.common.par();
        Ok(match self {
            Self::Ndt => {
                let params = FollowParams::for_distributions();
                Box::new(Follow::new(NdtRegistration::new(NdtParams::default())?.with_parallelism(par), params)?)
            }
            Self::Gicp => Box::new(Follow::new(
                PointRegistration::new(PointParams::default())?.with_parallelism(par),
                FollowParams::default(),
            )?),
            Self::Loam => {
                let target = match args.target {
                    Target::Last => LoamTarget::LastCloud,
                    Target::Map => LoamTarget::LocalMap,
                    Target::Both => LoamTarget::LastCloudThenMap,
                };
                let solve = if args.two_step { LoamSolve::TwoStep } else { LoamSolve::Joint };
                Box::new(
                    LoamOdometry::new(LoamParams { target, solve, ..LoamParams::default() })?.with_parallelism(par),
                )
            }
        })
    }
}
