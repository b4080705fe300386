//! What changes as it runs and is no map: controllers, odometry, random streams; and the small values between the parts.

use crate::scenes;
use crate::table::{assert_kept, assert_refused, restored};
use agv_nav::control::pid::{AntiWindup, Pid, PidParams, VelocityPid};
use agv_nav::core::{
    compute::{Par, Seed},
    geometry::{LieGroup, Se2, Se3, So3, Twist2, UncertainPose},
    nalgebra::{Matrix3, Vector2, Vector3},
    odometry::{GyroBiasEstimator, OdometryAccumulator, OdometryIncrement, YawIntegrator},
    path::Path,
    roles::{Controller, PoseBelief, PoseEstimate, VehicleState},
    time::Stamp,
};
use rand::Rng;
use serde_json::json;

fn pid(params: PidParams) -> Pid {
    let mut pid = Pid::new(params).unwrap();
    for k in 0..7 {
        pid.update(1.0, 0.1 * f64::from(k), 0.013).unwrap();
    }
    pid
}

fn full() -> PidParams {
    let anti_windup = AntiWindup::BackCalculation { tracking_time: 0.7 };
    PidParams { integral: 0.3, derivative: 0.1, filter_time: 0.05, output_max: 0.9, anti_windup, ..Default::default() }
}

fn increment(x: f64) -> OdometryIncrement {
    let (start, end) = (Stamp::from_seconds(x), Stamp::from_seconds(x + 1.0));
    let mut motion = OdometryIncrement::between(start, &Se2::identity(), end, &Se2::new(0.1, 0.0, 0.3)).unwrap();
    motion.covariance = Matrix3::identity() * 0.1;
    motion
}

#[test]
fn controllers_go_on_with_the_same_bits() {
    for params in [PidParams::default(), full()] {
        for mut pid in [Pid::new(params).unwrap(), pid(params)] {
            let mut again = restored(&pid);
            assert_eq!(again, pid);
            for k in 0..5 {
                let measurement = 0.3 - 0.07 * f64::from(k);
                let outputs = [&mut pid, &mut again].map(|p| p.update(0.9, measurement, 0.02).unwrap().to_bits());
                assert_eq!(outputs[0], outputs[1]);
            }
        }
    }
}

#[test]
fn a_velocity_form_goes_on_with_the_same_bits() {
    let mut pid = VelocityPid::new(full()).unwrap();
    for k in 0..7 {
        pid.update(1.0, 0.1 * f64::from(k), 0.013).unwrap();
        let mut again = restored(&pid);
        assert_eq!(again, pid);
        let outputs = [&mut pid, &mut again].map(|p| p.update(0.9, 0.25, 0.02).unwrap().to_bits());
        assert_eq!(outputs[0], outputs[1]);
    }
    assert_refused(
        "VelocityPid",
        &pid,
        &[("/output", json!(5.0)), ("/rate", json!(null)), ("/last/1", json!(null)), ("/params/integral", json!(0.0))],
    );
}

#[test]
fn odometry_goes_on_with_the_same_bits() {
    let mut accumulator = OdometryAccumulator::default();
    accumulator.push(&increment(0.0)).unwrap();
    let mut again = restored(&accumulator);
    let sums = [&mut accumulator, &mut again].map(|sum| {
        sum.push(&increment(1.0)).unwrap();
        sum.take()
    });
    assert!(sums[0].is_some() && sums[0] == sums[1]);

    let mut gyro = YawIntegrator::new(0.001).unwrap();
    let mut bias = GyroBiasEstimator::new(0.1, 3).unwrap();
    assert_kept("YawIntegrator", &gyro);
    assert_kept("GyroBiasEstimator", &bias);
    for k in 0..10 {
        gyro.push(Stamp::from_seconds(0.01 * f64::from(k)), 0.1 + 0.03 * f64::from(k)).unwrap();
        bias.push(0.01 + 0.001 * f64::from(k % 3)).unwrap();
    }
    assert_kept("GyroBiasEstimator", &bias);
    assert_eq!(restored(&bias).bias(), bias.bias());
    let mut again = restored(&gyro);
    let until = Stamp::from_seconds(0.1);
    let yaws = [&mut gyro, &mut again].map(|gyro| gyro.take_until(until).unwrap());
    assert!(yaws[0].is_some() && yaws[0] == yaws[1]);
}

#[test]
fn random_streams_keep_their_position() {
    let mut stream = Seed(5).stream(2, 3);
    let fresh = stream.clone();
    stream.next_u64();
    let mut again = restored(&stream);
    assert!(again == stream && again != fresh);
    assert_eq!(again.next_u64(), stream.next_u64());
    assert_kept("Seed", &Seed(u64::MAX));
    assert_kept("Par", &Par::threads(3));
}

#[test]
fn values_between_the_parts_come_back() {
    let covariance = Matrix3::new(0.2, 0.01, 0.0, 0.01, 0.3, 0.0, 0.0, 0.0, 0.1);
    let pose = Se2::new(0.1, 0.2, 0.3) * Se2::new(1e-9, 1e9, 3.1);
    let spatial = Se3::from_parts(Vector3::new(0.1, -0.0, 1e-300), So3::from_roll_pitch_yaw(0.3, 1.2, -3.0));
    assert_kept("Se3", &spatial);
    assert_kept("UncertainPose", &UncertainPose::new(pose, covariance).unwrap());
    let uncertain = UncertainPose::new(pose, covariance).unwrap();
    assert_kept("PoseEstimate", &PoseEstimate::new(uncertain));
    let stamp = Some(Stamp::from_nanoseconds(i64::MAX));
    assert_kept("PoseEstimate", &PoseEstimate { stamp, ..PoseEstimate::new(uncertain) });
    assert_kept("PoseBelief", &PoseBelief::Around(uncertain));
    assert_kept("PoseBelief", &PoseBelief::<Se2>::Anywhere);
    assert_kept("OdometryIncrement", &increment(0.1));
    assert_kept(
        "VehicleState",
        &VehicleState { steering: Some(0.4), ..VehicleState::new(pose, Twist2::new(0.1, 0.2, 0.3)) },
    );
    let corner = [(0.1, 0.2), (0.7, 0.2), (0.7, 0.9)].map(|(x, y)| Vector2::new(x, y));
    let path = Path::from_positions(&corner).unwrap();
    assert_kept("Path", &path);
    assert_eq!(restored(&path), path);
}

#[test]
fn spoilt_states_are_refused() {
    assert_refused(
        "Pid",
        &pid(full()),
        &[
            ("/integral", json!(null)),
            ("/last/measurement", json!(null)),
            ("/params/proportional", json!(null)),
            ("/params/filter_time", json!(-1.0)),
            ("/params/output_rate", json!(0.0)),
            ("/params/output_min", json!(5.0)),
        ],
    );
    let pose = Se2::new(0.1, 0.2, 0.3);
    assert_refused(
        "UncertainPose",
        &UncertainPose::new(pose, Matrix3::identity()).unwrap(),
        &[
            ("/covariance/0", json!(-1.0)),
            ("/covariance/1", json!(0.5)),
            ("/covariance/8", json!(null)),
            ("/mean/rotation/sin", json!(2.0)),
        ],
    );
    assert_refused("Path", &Path::from_positions(&[pose.translation()]).unwrap(), &[("/points/0/pose", json!(null))]);
}

/// Once while a beacon still waits for its place, and once after.
#[test]
fn landmark_slam_goes_on_with_the_same_bits() {
    let looks = scenes::landmarks::rounds(90);
    for stop in [4, 70] {
        let mut slam = scenes::landmarks::filter();
        scenes::landmarks::run(&mut slam, &looks[..stop]);
        let mut resumed = restored(&slam);
        for filter in [&mut slam, &mut resumed] {
            scenes::landmarks::run(filter, &looks[stop..]);
        }
        let [one, other] = [&slam, &resumed].map(|slam| serde_json::to_string(slam).unwrap());
        assert!(one == other, "stopped at {stop}");
    }
}

#[test]
fn spoilt_landmark_maps_are_refused() {
    let mut slam = scenes::landmarks::filter();
    scenes::landmarks::run(&mut slam, &scenes::landmarks::rounds(4));
    assert_kept("LandmarkSlam", &slam);
    assert_refused(
        "LandmarkSlam",
        &slam,
        &[
            ("/next", json!(0)),
            ("/params/gate_probability", json!(1.5)),
            ("/state/scale", json!(null)),
            ("/state/points", json!([])),
            ("/state/points/0/key", json!(1_000_000)),
            ("/state/covariance/size", json!(3)),
            ("/state/covariance/entries/0", json!(-1.0)),
            ("/waiting/0/ranges/0/anchor", json!(0)),
            ("/waiting/0/ranges/0/variance", json!(0.0)),
            ("/waiting/0/spacing", json!(-1.0)),
        ],
    );
}
