use super::*;
use crate::{
    FloorCameraParams, FloorCode, FrontCameraParams, ImuParams, KeyFrame, Landmark, LaserParams, MovingDisc, Shape,
    VehicleParams, WheelEncodersParams, World2d,
};
use agv_core::{
    compute::{Par, Seed},
    sensors::{Observation, ScanGeometry, SensorId},
};
use nalgebra::Vector2;
use std::fmt::Write;

fn bare() -> Simulator2d<World2d> {
    let world = World2d::new(Shape::room(Vector2::zeros(), Vector2::new(10.0, 6.0)).to_vec()).unwrap();
    let vehicle = Vehicle::new(VehicleParams::default(), Se2::new(2.0, 3.0, 0.0), Seed(1)).unwrap();
    Simulator2d::new(world, vehicle, Body::rectangle(0.5, 0.3).unwrap(), 0.05).unwrap()
}

/// A small laser; the rear one looks back.
fn laser(number: u16) -> Laser {
    let yaw = if number == 0 { 0.0 } else { std::f64::consts::PI };
    let base_from_sensor = Se2::new(0.2 * yaw.cos(), 0.0, yaw);
    let geometry = ScanGeometry { sensor: SensorId(number), base_from_sensor, ..Default::default() };
    Laser::new(LaserParams { geometry, ..Default::default() }.with_beams(91, 3.0), Seed(1)).unwrap()
}

fn imu(number: u16) -> Imu {
    Imu::new(ImuParams { sensor: SensorId(number), ..Default::default() }, Seed(1)).unwrap()
}

fn encoders() -> WheelEncoders {
    WheelEncoders::new(WheelEncodersParams { steering_sigma: 0.01, ..Default::default() }, Seed(1)).unwrap()
}

fn floor_camera() -> FloorCamera {
    let codes = FloorCode::lattice(Se2::new(2.0, 3.0, 0.0), 20, 1, 0.1).unwrap();
    FloorCamera::new(FloorCameraParams::default(), codes, Seed(1)).unwrap()
}

fn front_camera() -> FrontCamera {
    let landmarks = [(9.9, 2.0), (9.9, 4.0)].map(|(x, y)| Landmark { id: 7, position: Vector2::new(x, y) });
    FrontCamera::new(FrontCameraParams { range_max: 20.0, ..Default::default() }, landmarks.to_vec(), Seed(1)).unwrap()
}

fn full() -> Simulator2d<World2d> {
    let lasers = bare().with_laser(laser(0), 2).unwrap().with_laser(laser(1), 3).unwrap();
    let inside = lasers.with_imu(imu(0), 1).unwrap().with_encoders(encoders(), 1).unwrap();
    inside.with_floor_camera(floor_camera(), 4).unwrap().with_front_camera(front_camera(), 5).unwrap()
}

/// All that a step says, as text: numbers print all their bits.
#[derive(Default, PartialEq, Debug)]
struct Told {
    motion: String,
    scans: [String; 2],
    samples: String,
    wheels: String,
    markers: String,
    landmarks: String,
}

fn run(mut simulator: Simulator2d<World2d>) -> Told {
    let mut told = Told::default();
    for step in 0..30 {
        let seen = simulator.step(&Twist2::new(0.5, 0.0, f64::from(step) * 0.01)).unwrap();
        write!(told.motion, "{:?} {:?}", seen.odometry, seen.truth).unwrap();
        for scan in seen.scans() {
            write!(told.scans[usize::from(scan.sensor().0)], "{:?} {:?}", scan.stamp(), scan.ranges()).unwrap();
        }
        seen.imu_samples().for_each(|sample| write!(told.samples, "{sample:?}").unwrap());
        seen.wheel_readings().for_each(|reading| write!(told.wheels, "{reading:?}").unwrap());
        seen.markers().for_each(|markers| write!(told.markers, "{markers:?}").unwrap());
        seen.landmarks().for_each(|landmarks| write!(told.landmarks, "{landmarks:?}").unwrap());
    }
    told
}

#[test]
fn a_run_can_be_replayed_on_any_number_of_threads() {
    let threads = bare().with_laser(laser(0).with_parallelism(Par::threads(3)), 1).unwrap();
    assert_eq!(run(bare().with_laser(laser(0), 1).unwrap()), run(threads));
    assert_eq!(run(full()), run(full()));
}

/// Alone on the vehicle each sensor says, to the bit, what it says among the others.
#[test]
fn a_sensor_more_changes_no_others_readings() {
    let all = run(full());
    let alone = [
        bare(),
        bare().with_laser(laser(0), 2).unwrap(),
        bare().with_laser(laser(1), 3).unwrap(),
        bare().with_imu(imu(0), 1).unwrap(),
        bare().with_encoders(encoders(), 1).unwrap(),
        bare().with_floor_camera(floor_camera(), 4).unwrap(),
        bare().with_front_camera(front_camera(), 5).unwrap(),
    ]
    .map(run);
    let [none, front, rear, inertial, counts, down, ahead] = alone;
    assert!(!all.scans[0].is_empty() && !all.markers.is_empty() && !all.landmarks.is_empty());
    assert_eq!(none.motion, all.motion);
    assert_eq!(front.scans[0], all.scans[0]);
    assert_eq!(rear.scans[1], all.scans[1]);
    assert_eq!(inertial.samples, all.samples);
    assert_eq!(counts.wheels, all.wheels);
    assert_eq!(down.markers, all.markers);
    assert_eq!(ahead.landmarks, all.landmarks);
}

/// Two lasers that stand in one place with one seed err differently: their numbers are part of the key.
#[test]
fn two_sensors_of_a_kind_have_noise_of_their_own() {
    let twin = |number| {
        let geometry = ScanGeometry { sensor: SensorId(number), ..Default::default() };
        Laser::new(LaserParams { geometry, ..Default::default() }, Seed(1)).unwrap()
    };
    let mut simulator = bare().with_laser(twin(4), 1).unwrap().with_laser(twin(5), 1).unwrap();
    let seen = simulator.step(&Twist2::ZERO).unwrap();
    let scans: Vec<_> = seen.scans().collect();
    assert_eq!(scans.iter().map(|scan| scan.sensor().0).collect::<Vec<_>>(), [4, 5]);
    let equal = scans[0].ranges().iter().zip(scans[1].ranges()).filter(|(a, b)| a == b).count();
    assert!(equal < 20, "{equal} of 1081");
}

#[test]
fn every_sensor_keeps_its_rate() {
    let mut simulator = full().with_imu(imu(1), 0).unwrap();
    let mut counts = [0; 5];
    for _ in 0..60 {
        let seen = simulator.step(&Twist2::new(0.2, 0.0, 0.0)).unwrap();
        let now = [
            seen.scans().count(),
            seen.imu_samples().count(),
            seen.wheel_readings().count(),
            seen.markers().count(),
            seen.landmarks().count(),
        ];
        counts.iter_mut().zip(now).for_each(|(sum, n)| *sum += n);
        assert!(seen.imu_samples().all(|sample| sample.stamp() == seen.truth.stamp));
        assert!(seen.markers().flatten().all(|code| Observation::stamp(code) == Some(seen.truth.stamp)));
    }
    assert_eq!(counts, [30 + 20, 60, 60, 15, 12]);
    let all = simulator.look().unwrap();
    assert_eq!((all.scans().count(), all.imu_samples().count(), all.wheel_readings().count()), (2, 0, 1));
    assert_eq!(all.odometry.start_from_end, Se2::default());
}

/// The gyro's rates, integrated, and the wheels' counts tell of the turn that was really made.
#[test]
fn sensors_tell_of_one_motion() {
    let ideal = Imu::new(ImuParams::default().ideal(), Seed(0)).unwrap();
    let mut simulator = bare().with_imu(ideal, 1).unwrap();
    let mut turned = 0.0;
    for step in 0..60 {
        let seen = simulator.step(&Twist2::new(0.3, 0.0, if step < 40 { 0.4 } else { 0.0 })).unwrap();
        turned += seen.imu_samples().next().unwrap().yaw_rate().unwrap().0 * 0.05;
        assert_eq!(seen.truth.twist, simulator.vehicle().twist());
    }
    let yaw = simulator.vehicle().map_from_base().yaw();
    assert!((yaw - turned).abs() < 1e-9 && turned > 0.5, "{yaw} {turned}");
}

#[test]
fn contact_is_reported_when_the_bumper_reaches_the_wall() {
    let mut simulator = bare();
    let (mut contact, mut clear) = (false, true);
    while !contact {
        clear &= simulator.clearance(10.0) > 0.0;
        contact = simulator.step(&Twist2::new(1.0, 0.0, 0.0)).unwrap().contact;
    }
    // 8 m to the wall less 0.25 m of body, overshot by less than a step.
    let travelled = simulator.vehicle().map_from_base().x() - 2.0;
    assert!(clear && (7.75..7.8 + 1e-9).contains(&travelled), "{travelled}");
    assert_eq!(simulator.clearance(10.0), 0.0);
}

#[test]
fn a_moving_obstacle_runs_into_a_vehicle_at_rest() {
    let frame = |time, x| KeyFrame { time, position: Vector2::new(x, 3.0) };
    let disc = MovingDisc::new(0.5, 10.0, vec![frame(0.0, 8.0), frame(5.5, 2.5), frame(10.0, 8.0)]).unwrap();
    let laser = Laser::new(LaserParams::default(), Seed(2)).unwrap();
    let mut simulator = bare().with_laser(laser, 1).unwrap().with_moving(MovingDiscs::new(vec![disc]));
    let ahead = simulator.look().unwrap().scan().unwrap().ranges()[540];
    assert!((ahead - 5.5).abs() < 0.1, "{ahead}");
    // At 1 m/s its edge reaches the bumper, at x = 2.25 m, after 5.25 s.
    let first = (1..=120).find(|_| simulator.step(&Twist2::ZERO).unwrap().contact).unwrap();
    assert!((105..=106).contains(&first), "{first}");
}

#[test]
fn bad_steps_and_doubled_sensors_are_refused() {
    let mut simulator = full();
    let before = simulator.vehicle().clone();
    assert!(simulator.step(&Twist2::new(f64::NAN, 0.0, 0.0)).is_err());
    assert_eq!(simulator.vehicle(), &before);
    let taken = |result: Result<_, Error>| matches!(result, Err(Error::SensorTaken { sensor: SensorId(0), .. }));
    assert!(taken(full().with_laser(laser(0), 1).map(|_| ())));
    assert!(taken(full().with_imu(imu(0), 1).map(|_| ())));
    assert!(taken(full().with_encoders(encoders(), 1).map(|_| ())));
    assert!(taken(full().with_floor_camera(floor_camera(), 1).map(|_| ())));
    assert!(taken(full().with_front_camera(front_camera(), 1).map(|_| ())));
    assert!(full().with_imu(imu(1), 1).is_ok());
    for dt in [0.0, -0.1, f64::NAN, f64::INFINITY] {
        let world = World2d::new(vec![]).unwrap();
        assert!(Simulator2d::new(world, before.clone(), Body::circle(0.1).unwrap(), dt).is_err());
    }
}
