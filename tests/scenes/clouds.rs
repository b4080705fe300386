//! Two revolutions of a lidar in a factory, half a metre apart.

use agv_nav::core::{
    compute::Seed,
    sensors::{PointCloud, VoxelGrid},
};
use agv_sim::{CloudPair, LidarParams};

/// A pair that is thinned out.
pub(crate) fn pair() -> CloudPair {
    let params = LidarParams { columns: 900, ..LidarParams::hdl32() };
    let CloudPair { target, source, target_from_source } = CloudPair::in_factory(params, Seed(3)).unwrap();
    CloudPair { target: thinned(&target, 0.1), source: thinned(&source, 0.25), target_from_source }
}

fn thinned(cloud: &PointCloud, leaf: f32) -> PointCloud {
    let mut out = PointCloud::default();
    VoxelGrid::new(leaf).unwrap().filter_into(cloud, &mut out);
    out
}
