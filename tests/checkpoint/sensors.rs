//! Scans and clouds, with all that a driver may send.

use crate::table::{assert_kept, assert_refused, restored};
use agv_nav::core::{
    geometry::{Se2, Se3, So3},
    nalgebra::Vector3,
    sensors::{LaserScan, PointCloud, ScanGeometry, SensorId},
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
