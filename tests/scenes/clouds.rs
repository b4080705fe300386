//! Two revolutions of a lidar in a factory, half a metre apart.

use agv_nav::core::{
    compute::Seed,
    geometry::{LieGroup, Se3, So3, Twist3},
    nalgebra::Vector3,
    sensors::{PointCloud, VoxelGrid},
    time::Stamp,
};
use agv_sim::{Factory, FactoryParams, Lidar, LidarParams};

/// A target, a source, and the pose of the source in the target frame.
pub(crate) struct CloudPair {
    pub(crate) target: PointCloud,
    pub(crate) source: PointCloud,
    pub(crate) target_from_source: Se3,
}

pub(crate) fn pair() -> CloudPair {
    let factory = Factory::generate(FactoryParams::default(), Seed(3)).unwrap();
    let mount = Se3::from_parts(Vector3::new(0.0, 0.0, 1.8), So3::identity());
    let params = LidarParams { columns: 900, ..LidarParams::hdl32() }.with_mount(mount);
    let mut lidar = Lidar::new(params, Seed(4)).unwrap();
    let first = Se3::from(factory.aisles()[1]);
    let step = Se3::from_parts(Vector3::new(0.5, 0.1, 0.0), So3::from_roll_pitch_yaw(0.0, 0.0, 0.1));
    let mut scan = |pose: Se3, leaf: f32| {
        let cloud = lidar.scan(factory.world(), &pose, &Twist3::default(), Stamp::default()).unwrap();
        let mut thinned = PointCloud::default();
        VoxelGrid::new(leaf).unwrap().filter_into(cloud, &mut thinned);
        thinned
    };
    CloudPair {
        target: scan(first, 0.1),
        source: scan(first * step, 0.25),
        target_from_source: mount.inverse() * step * mount,
    }
}
