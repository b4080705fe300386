//! The pair of clouds: files, or a simulated factory.

use crate::{Args, Result};
use agv_nav::core::{
    geometry::Se3,
    sensors::{PointCloud, VoxelGrid},
};
use agv_sim::{CloudPair, LidarParams};
use agv_support::{cloud, pairs};

/// Two clouds, down-sampled, and what is known of their relative pose.
pub(crate) struct Pair {
    pub(crate) target: PointCloud,
    pub(crate) source: PointCloud,
    pub(crate) truth: Option<Se3>,
}

/// Reads the clouds that the arguments name, or simulates them.
pub(crate) fn load(args: &Args) -> Result<Pair> {
    let (target, source, mut truth) = if let (Some(target), Some(source)) = (&args.target, &args.source) {
        (cloud::read(target)?, cloud::read(source)?, None)
    } else {
        let pair = CloudPair::in_factory(LidarParams::hdl32(), args.common.seed())?;
        (pair.target, pair.source, Some(pair.target_from_source))
    };
    if let Some(path) = &args.truth {
        let name = args.pair.as_deref().unwrap_or_default();
        let pairs = pairs::read(path)?;
        let pair = pairs.into_iter().find(|pair| pair.name == name && pair.kind == args.kind);
        let missing = || format!("{} has no pair `{name}` of kind `{}`", path.display(), args.kind);
        truth = Some(pair.ok_or_else(missing)?.target_from_source);
    }
    Ok(Pair { target: thinned(&target, args.target_leaf())?, source: thinned(&source, args.source_leaf())?, truth })
}

/// One point per occupied cube of `leaf` metres; all points for zero.
fn thinned(cloud: &PointCloud, leaf: f32) -> Result<PointCloud> {
    let mut out = PointCloud::default();
    if leaf == 0.0 {
        return Ok(cloud.clone());
    }
    VoxelGrid::new(leaf)?.filter_into(cloud, &mut out);
    Ok(out)
}
