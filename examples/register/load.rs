//! The pair of clouds: files, or a simulated factory.

use crate::{Args, Result};
use agv_nav::core::{
    compute::Seed,
    geometry::{LieGroup, Se3, So3, Twist3},
    nalgebra::Vector3,
    sensors::{PointCloud, VoxelGrid},
    time::Stamp,
};
use agv_sim::{Factory, FactoryParams, Lidar, LidarParams};
use agv_support::{cloud, pairs};

/// Two clouds, down-sampled, and what is known of their relative pose.
pub(crate) struct Pair {
    pub(crate) target: PointCloud,
    pub(crate) source: PointCloud,
    pub(crate) truth: Option<Se3>,
}

/// Reads the clouds that the arguments name, or simulates them.
pub(crate) fn load(args: &Args) -> Result<Pair> {
    let (target, source, mut truth) = match (&args.target, &args.source) {
        (Some(target), Some(source)) => (cloud::read(target)?, cloud::read(source)?, None),
        _ => simulate(args.common.seed())?,
    };
    if let Some(path) = &args.truth {
        let name = args.pair.as_deref().unwrap_or_default();
        let pairs = pairs::read(path)?;
        let pair = pairs.into_iter().find(|pair| pair.name == name && pair.kind == args.kind);
        let missing = || format!("{} has no pair `{name}` of kind `{}`", path.display(), args.kind);
        truth = Some(pair.ok_or_else(missing)?.target_from_source);
    }
    Ok(Pair { target: thinned(&target, args.target_leaf())?, source: thinned(&source, args.source_leaf)?, truth })
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

/// Two revolutions of a 32-line lidar in an aisle of a generated factory, half a metre and five degrees apart.
fn simulate(seed: Seed) -> Result<(PointCloud, PointCloud, Option<Se3>)> {
    let factory = Factory::generate(FactoryParams::default(), seed)?;
    let mount = Se3::from_parts(Vector3::new(0.0, 0.0, 1.8), So3::identity());
    let mut lidar = Lidar::new(LidarParams::hdl32().with_mount(mount), seed)?;
    let first = Se3::from(factory.aisles()[1]);
    let step = Se3::from_parts(Vector3::new(0.5, 0.08, 0.0), So3::from_roll_pitch_yaw(0.0, 0.0, 5_f64.to_radians()));
    let second = first * step;
    let still = Twist3::default();
    let target = lidar.scan(factory.world(), &first, &still, Stamp::default())?.clone();
    let source = lidar.scan(factory.world(), &second, &still, Stamp::default())?.clone();
    Ok((target, source, Some(mount.inverse() * step * mount)))
}
