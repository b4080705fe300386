//! Simulated sensors, with all their noise.

use crate::{
    digest::{Digest, assert_same_bits},
    scenes,
};
use agv_nav::core::{
    compute::Seed,
    geometry::{Se3, So3, Twist2, Twist3},
    nalgebra::Vector3,
    time::Stamp,
};
use agv_sim::{Factory, FactoryParams, GridWorld, Laser, LaserParams, Lidar, LidarParams};

#[test]
fn laser() {
    let world = GridWorld::new(&scenes::room());
    assert_same_bits("Laser", |par| {
        let params = LaserParams { dropout: 0.01, ..Default::default() };
        let mut laser = Laser::new(params, Seed(5)).unwrap().with_parallelism(par);
        (0..3).fold(Digest::new(), |digest, _| {
            let twist = Twist2::new(0.5, 0.0, 0.3);
            digest.singles(laser.scan(&world, &scenes::start(), &twist, Stamp::default()).unwrap().ranges())
        })
    });
}

#[test]
fn lidar() {
    let factory = Factory::generate(FactoryParams::default(), Seed(3)).unwrap();
    let aisle = factory.aisles()[0];
    let heading = So3::from_roll_pitch_yaw(0.0, 0.0, aisle.yaw());
    let pose = Se3::from_parts(Vector3::new(aisle.x(), aisle.y(), 1.2), heading);
    let twist = Twist3 { linear: Vector3::new(1.0, 0.0, 0.0), angular: Vector3::new(0.0, 0.0, 0.2) };
    assert_same_bits("Lidar", |par| {
        let params = LidarParams { columns: 333, dropout: 0.01, ..LidarParams::vlp16() };
        let mut lidar = Lidar::new(params, Seed(4)).unwrap().with_parallelism(par);
        (0..2).fold(Digest::new(), |digest, _| {
            let cloud = lidar.scan(factory.world(), &pose, &twist, Stamp::default()).unwrap();
            let digest = digest.singles(cloud.x()).singles(cloud.y()).singles(cloud.z());
            let digest = digest.singles(cloud.time().unwrap()).singles(cloud.intensity().unwrap());
            digest.integers(cloud.ring().unwrap().iter().copied())
        })
    });
}
