//! The simulator: it stands inside the loops whose allocations are counted.

use crate::{counter, scenes};
use agv_nav::core::{
    compute::Seed,
    geometry::{Se2, Se3, So3, Twist2, Twist3},
    nalgebra::{Vector2, Vector3},
    sensors::{ScanGeometry, SensorId},
    time::Stamp,
};
use agv_sim::{
    Body, Factory, FactoryParams, FloorCamera, FloorCameraParams, FloorCode, FrontCamera, FrontCameraParams, GridWorld,
    Imu, ImuParams, KeyFrame, Landmark, Laser, LaserParams, Lidar, LidarParams, MovingDisc, MovingDiscs, PlanarWorld,
    Shape, Simulator2d, Simulator3d, Vehicle, VehicleParams, WheelEncoders, WheelEncodersParams, World2d,
};

fn shapes() -> World2d {
    World2d::new(Shape::room(Vector2::zeros(), Vector2::new(8.0, 5.0)).to_vec()).unwrap()
}

#[test]
fn laser() {
    fn count(world: &impl PlanarWorld) -> usize {
        let mut laser = Laser::new(LaserParams::default(), Seed(1)).unwrap();
        let mut run = |k: i32| {
            let pose = Se2::new(4.0, 0.9 + 0.01 * f64::from(k), 0.1 * f64::from(k));
            let scan = laser.scan(world, &pose, &Twist2::new(0.5, 0.0, 0.2), Stamp::default()).unwrap();
            assert_eq!(scan.len(), 1081);
        };
        run(0);
        counter::count(|| (1..5).for_each(run))
    }
    assert_eq!((count(&shapes()), count(&GridWorld::new(&scenes::room()))), (0, 0));
}

#[test]
fn lidar() {
    let factory = Factory::generate(FactoryParams::default(), Seed(3)).unwrap();
    let mount = Se3::from_parts(Vector3::new(0.0, 0.0, 1.2), So3::default());
    let params = LidarParams { columns: 200, ..LidarParams::vlp16().with_mount(mount) };
    let mut lidar = Lidar::new(params, Seed(4)).unwrap();
    let aisle = factory.aisles()[0];
    let mut run = |k: i32| {
        let ahead = Vector3::new(aisle.x() + 0.1 * f64::from(k), aisle.y(), 0.0);
        let pose = Se3::from_parts(ahead, So3::from_roll_pitch_yaw(0.0, 0.0, aisle.yaw()));
        let twist = Twist3 { linear: Vector3::new(1.0, 0.0, 0.0), angular: Vector3::zeros() };
        assert!(lidar.scan(factory.world(), &pose, &twist, Stamp::default()).unwrap().len() > 1000);
    };
    run(0);
    assert_eq!(counter::count(|| (1..5).for_each(run)), 0);
}

#[test]
fn planar_simulator() {
    let vehicle = Vehicle::new(VehicleParams::default(), Se2::new(2.0, 2.0, 0.0), Seed(1)).unwrap();
    let laser = Laser::new(LaserParams::default().with_beams(181, 3.0), Seed(2)).unwrap();
    let rear = ScanGeometry { sensor: SensorId(1), ..Default::default() };
    let rear = Laser::new(LaserParams { geometry: rear, ..Default::default() }, Seed(2)).unwrap();
    let codes = FloorCode::lattice(Se2::new(2.0, 2.0, 0.0), 9, 9, 0.1).unwrap();
    let landmark = Landmark { id: 1, position: Vector2::new(7.9, 2.5) };
    let frames = [(0.0, 6.0), (10.0, 3.0)].map(|(time, x)| KeyFrame { time, position: Vector2::new(x, 4.0) });
    let moving = MovingDiscs::new(vec![MovingDisc::new(0.3, 20.0, frames.to_vec()).unwrap()]);
    let mut simulator = Simulator2d::new(shapes(), vehicle, Body::rectangle(0.5, 0.3).unwrap(), 0.05)
        .and_then(|s| s.with_laser(laser, 1)?.with_laser(rear, 3))
        .and_then(|s| s.with_imu(Imu::new(ImuParams::default(), Seed(3))?, 1))
        .and_then(|s| s.with_encoders(WheelEncoders::new(WheelEncodersParams::default(), Seed(4))?, 1))
        .and_then(|s| s.with_floor_camera(FloorCamera::new(FloorCameraParams::default(), codes, Seed(5))?, 2))
        .and_then(|s| s.with_front_camera(FrontCamera::new(FrontCameraParams::default(), vec![landmark], Seed(6))?, 2))
        .unwrap()
        .with_moving(moving);
    let mut run = |steps: i32| {
        for _ in 0..steps {
            let seen = simulator.step(&Twist2::new(0.4, 0.0, 0.4)).unwrap();
            assert!(seen.scan().is_some() && seen.imu_samples().count() == 1 && seen.wheel_readings().count() == 1);
            assert!(seen.markers().flatten().count() + seen.landmarks().flatten().count() < 99);
        }
        simulator.look().unwrap();
    };
    run(1);
    assert_eq!(counter::count(|| run(40)), 0);
}

#[test]
fn spatial_simulator() {
    let factory = Factory::generate(FactoryParams::default(), Seed(3)).unwrap();
    let vehicle = Vehicle::new(VehicleParams::default(), factory.aisles()[0], Seed(1)).unwrap();
    let mount = Se3::from_parts(Vector3::new(0.0, 0.0, 1.2), So3::default());
    let lidar = Lidar::new(LidarParams { columns: 100, ..LidarParams::vlp16().with_mount(mount) }, Seed(4)).unwrap();
    let mut simulator = Simulator3d::new(factory.world(), vehicle, 0.02)
        .and_then(|s| s.with_lidar(lidar)?.with_imu(Imu::new(ImuParams::default(), Seed(3))?, 1))
        .unwrap();
    let mut run = |steps: i32| {
        let mut clouds = 0;
        for _ in 0..steps {
            clouds += simulator.step(&Twist2::new(0.4, 0.0, 0.1)).unwrap().clouds().count();
        }
        clouds
    };
    run(11);
    assert_eq!(counter::count(|| assert_eq!(run(20), 4)), 0);
}
