//! What is written: the trajectory, and a picture of the map.

use crate::{Result, load::Drive};
use agv_nav::core::{
    geometry::{LieGroup, Se2, Se3},
    sensors::{PointCloud, VoxelGrid},
};
use agv_support::{
    log::StampedPose,
    plot::{Color, Scene},
    trajectory::{write_kitti, write_tum},
};
use std::path::Path;

/// Edge of the cubes of which the picture shows one point, in metres.
const LEAF: f32 = 0.1;

/// Writes `trajectory.tum`, `trajectory.kitti` and `map.png`, all in the frame of the first scan.
pub(crate) fn write(drive: &Drive, poses: &[Se3], folder: &Path) -> Result<()> {
    let stamped: Vec<_> =
        std::iter::zip(&drive.scans, poses).map(|(scan, &pose)| StampedPose { stamp: scan.stamp(), pose }).collect();
    write_tum(folder.join("trajectory.tum"), &stamped)?;
    write_kitti(folder.join("trajectory.kitti"), poses)?;

    let mut grid = VoxelGrid::new(LEAF)?;
    let (mut map, mut thinned, mut moved) = (PointCloud::default(), PointCloud::default(), PointCloud::default());
    // A picture needs no more than some dozens of scans.
    for (scan, pose) in std::iter::zip(&drive.scans, poses).step_by(poses.len().div_ceil(60).max(1)) {
        grid.filter_into(scan, &mut thinned);
        thinned.transform_into(&pose.compose(&scan.base_from_sensor()), &mut moved);
        map = PointCloud::from_points(map.points().chain(moved.points()));
    }
    grid.filter_into(&map, &mut thinned);
    let planar = |pose: &Se3| pose.to_planar();
    let path: Vec<Se2> = poses.iter().map(planar).collect();
    let mut scene = Scene::new("Lidar odometry").cloud(&thinned);
    let known = std::iter::zip(&drive.truth, poses).find_map(|(truth, pose)| Some(pose.compose(&(*truth)?.inverse())));
    if let Some(odom_from_world) = known {
        let truth = drive.truth.iter().flatten().map(|pose| odom_from_world.compose(pose).to_planar());
        scene = scene.trajectory("reference", Color::Black, &truth.collect::<Vec<_>>());
    }
    scene.trajectory("odometry", Color::Red, &path).write(folder.join("map.png"))?;
    Ok(())
}
