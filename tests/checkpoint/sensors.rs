//! Scans and clouds, with all that a driver may send.

use crate::table::{assert_kept, assert_refused, restored};
use agv_nav::core::{
    geometry::{Se2, Se3, So3, UncertainPose, UncertainVector},
    nalgebra::{Matrix3, Vector2, Vector3},
    sensors::{
        ImuSample, LandmarkObservation, LaserScan, MarkerObservation, PointCloud, PoseObservation, PositionObservation,
        ScanGeometry, SensorId, VelocityObservation,
    },
    time::Stamp,
};
use serde_json::json;

/// Readings of every kind, and numbers that are hard to write.
const READINGS: [f32; 9] = [1.1, 0.3, -0.0, 12.0, 7.038_531e-26, f32::MAX, f32::INFINITY, f32::NEG_INFINITY, f32::NAN];

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

fn scan() -> LaserScan {
    let mount = Se2::new(0.3, 0.1, 0.7);
    let geometry = ScanGeometry { sensor: SensorId(3), base_from_sensor: mount, ..Default::default() };
    LaserScan::new(Stamp::from_nanoseconds(1_700_000_000_123_456_789), geometry, READINGS.to_vec()).unwrap()
}

fn cloud() -> PointCloud {
    let mount = Se3::from_parts(Vector3::new(0.1, 0.2, 1.3), So3::from_roll_pitch_yaw(0.1, 0.2, 0.3));
    let [x, y, z] = [1, 2, 3].map(|shift| READINGS.iter().cycle().skip(shift).take(9).copied().collect());
    let cloud = PointCloud::new(x, y, z).unwrap().with_mount(mount).unwrap();
    cloud.with_stamp(Stamp::from_nanoseconds(-7)).with_sensor(SensorId(2))
}

#[test]
fn scans_come_back() {
    let (before, after) = (scan(), restored(&scan()));
    assert_kept("LaserScan", &before);
    assert_eq!(bits(after.ranges()), bits(before.ranges()));
    assert_eq!((after.stamp(), after.geometry()), (before.stamp(), before.geometry()));
}

#[test]
fn clouds_come_back() {
    let all = cloud().with_intensity(READINGS.to_vec()).unwrap().with_time(READINGS.to_vec()).unwrap();
    let all = all.with_ring((0..9).collect()).unwrap();
    for before in [cloud(), all, PointCloud::default()] {
        let after = restored(&before);
        assert_kept("PointCloud", &before);
        for (after, before) in [(after.x(), before.x()), (after.y(), before.y()), (after.z(), before.z())] {
            assert_eq!(bits(after), bits(before));
        }
        assert_eq!(after.intensity().map(bits), before.intensity().map(bits));
        assert_eq!(after.time().map(bits), before.time().map(bits));
        assert_eq!((after.ring(), after.stamp()), (before.ring(), before.stamp()));
        assert_eq!((after.base_from_sensor(), after.sensor()), (before.base_from_sensor(), before.sensor()));
    }
}

#[test]
fn spoilt_scans_and_clouds_are_refused() {
    assert_refused(
        "LaserScan",
        &scan(),
        &[
            ("/ranges/0", json!(null)),
            ("/ranges/0", json!("far")),
            ("/ranges", json!(vec![1.0; LaserScan::MAX_BEAMS + 1])),
            ("/geometry/angle_increment", json!(0.0)),
            ("/geometry/range_max", json!(-1.0)),
            ("/geometry/angle_min", json!(null)),
            ("/geometry/base_from_sensor/rotation/cos", json!(0.5)),
            ("/stamp", json!(0.5)),
        ],
    );
    assert_refused(
        "PointCloud",
        &cloud().with_ring((0..9).collect()).unwrap(),
        &[
            ("/x", json!([1.0])),
            ("/z/3", json!(null)),
            ("/ring", json!([1, 2])),
            ("/ring/0", json!(-1)),
            ("/intensity", json!([0.5])),
            ("/time", json!([0.5])),
            ("/base_from_sensor/translation/0", json!(null)),
        ],
    );
}

fn rates() -> UncertainVector<3> {
    UncertainVector::from_sigmas(Vector3::new(0.1, -0.2, 0.3), &Vector3::new(0.01, 0.02, 0.03)).unwrap()
}

fn imu_sample() -> ImuSample {
    let mount = Se3::from_parts(Vector3::new(0.1, 0.2, 0.3), So3::from_roll_pitch_yaw(0.1, 0.2, 0.3));
    let attitude = UncertainPose::new(So3::from_roll_pitch_yaw(0.0, 0.1, 2.0), Matrix3::identity() * 1e-4).unwrap();
    let sample = ImuSample::new(Stamp::from_nanoseconds(7)).with_angular_velocity(rates()).with_specific_force(rates());
    sample.with_orientation(attitude).with_sensor(SensorId(2)).with_mount(mount).unwrap()
}

fn landmark(id: Option<u32>) -> LandmarkObservation {
    let reading = UncertainVector::from_sigmas(Vector2::new(4.0, 0.3), &Vector2::new(0.1, 0.01)).unwrap();
    let seen = LandmarkObservation::new(Stamp::from_nanoseconds(7), id, reading).unwrap();
    seen.with_sensor(SensorId(2)).with_mount(Se2::new(0.3, 0.1, 0.7)).unwrap()
}

fn velocity() -> VelocityObservation<Se2> {
    let spread = Matrix3::identity() * 0.5;
    VelocityObservation::new(Stamp::from_nanoseconds(7), Vector3::new(0.1, 0.2, 0.3), spread).unwrap()
}

#[test]
fn observations_come_back() {
    assert_kept("ImuSample", &imu_sample());
    assert_kept("ImuSample", &ImuSample::new(Stamp::default()));
    assert_kept("LandmarkObservation", &landmark(Some(9)));
    assert_kept("LandmarkObservation", &landmark(None));
    assert_kept("VelocityObservation", &velocity());
    let planar = UncertainPose::new(Se2::new(0.1, 0.2, 0.3), Matrix3::identity() * 0.1).unwrap();
    let spatial = UncertainPose::exact(Se3::from(Se2::new(0.1, 0.2, 0.3)));
    assert_kept("MarkerObservation", &MarkerObservation::new(Stamp::default(), u32::MAX, planar));
    assert_kept("MarkerObservation", &MarkerObservation::new(Stamp::default(), 0, spatial));
    assert_kept("PoseObservation", &PoseObservation::new(Stamp::default(), planar));
    let place = UncertainVector::from_sigmas(Vector2::new(4.0, 0.3), &Vector2::new(0.1, 0.1)).unwrap();
    assert_kept("PositionObservation", &PositionObservation::new(Stamp::default(), place));
    assert_eq!(restored(&imu_sample()), imu_sample());
    assert_eq!(restored(&landmark(None)), landmark(None));
}

#[test]
fn spoilt_observations_are_refused() {
    assert_refused(
        "ImuSample",
        &imu_sample(),
        &[
            ("/angular_velocity/mean/0", json!(null)),
            ("/specific_force/covariance/0", json!(-1.0)),
            ("/orientation/covariance/1", json!(0.5)),
            ("/origin/base_from_sensor/translation/0", json!(null)),
            ("/origin/sensor", json!(-1)),
        ],
    );
    assert_refused(
        "LandmarkObservation",
        &landmark(Some(9)),
        &[("/range_bearing/mean/0", json!(-1.0)), ("/range_bearing/covariance/1", json!(9.0)), ("/id", json!(-1))],
    );
    assert_refused("VelocityObservation", &velocity(), &[("/covariance/0", json!(-1.0)), ("/velocity/2", json!(null))]);
}
