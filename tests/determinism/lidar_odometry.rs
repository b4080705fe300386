//! Lidar odometry.

use crate::{
    digest::{Digest, assert_same_bits},
    scenes::clouds,
};
use agv_nav::core::{compute::Par, roles::LidarOdometry};
use agv_nav::ndt::{
    gicp::{PointParams, PointRegistration},
    loam::{LoamOdometry, LoamParams},
    odometry::{Follow, FollowParams},
};

fn digest(mut odometry: impl LidarOdometry) -> Digest {
    let pair = clouds::pair();
    let seen = [&pair.target, &pair.source, &pair.target, &pair.source];
    let poses = seen.map(|cloud| odometry.process(cloud, None).unwrap().odom_from_base);
    let numbers = poses.iter().flat_map(|pose| {
        let (translation, rotation) = (pose.translation(), pose.rotation().matrix());
        translation.iter().chain(rotation.iter()).copied().collect::<Vec<_>>()
    });
    Digest::new().bits(numbers.map(f64::to_bits))
}

#[test]
fn edges_and_surfaces() {
    assert_same_bits("LoamOdometry", |par: Par| {
        digest(LoamOdometry::new(LoamParams::default()).unwrap().with_parallelism(par))
    });
}

#[test]
fn a_registration() {
    assert_same_bits("Follow", |par: Par| {
        let registration = PointRegistration::new(PointParams::default()).unwrap().with_parallelism(par);
        digest(Follow::new(registration, FollowParams::default()).unwrap())
    });
}
