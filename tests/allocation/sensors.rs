//! Scans, clouds and wheel odometry.

use crate::counter;
use agv_nav::core::{
    geometry::{Se2, Se3, So3, Twist2, Twist3},
    kinematics::{DifferentialDrive, DifferentialParams, Mecanum, MecanumParams},
    nalgebra::Vector3,
    odometry::{EncoderParams, WheelNoise, WheelOdometry},
    sensors::{
        ConstantTwist, Deskew, LaserScan, LidarReturn, PointCloud, RangeImage, RangeImageParams, ScanGeometry,
        VoxelGrid,
    },
    time::Stamp,
};
use agv_nav::ndt::convert::{CloudToScan, CloudToScanParams};

/// Returns of a lidar of 16 lines in a round tower of this radius.
fn returns(radius: f32) -> impl Iterator<Item = LidarReturn> {
    (0..900_u16).flat_map(move |column| {
        (0..16_u16).map(move |ring| {
            let (azimuth, elevation) = (f32::from(column) * 0.006_98 - 3.1, f32::from(ring) * 0.035 - 0.26);
            let position = Vector3::new(radius * azimuth.cos(), radius * azimuth.sin(), radius * elevation.tan());
            LidarReturn { position, intensity: 0.5, ring, time: f32::from(column) * 1e-4 }
        })
    })
}

fn cloud(radius: f32) -> PointCloud {
    let mount = Se3::from_parts(Vector3::new(0.0, 0.0, 1.2), So3::default());
    let mut cloud = PointCloud::default().with_mount(mount).unwrap();
    cloud = cloud.with_intensity(vec![]).unwrap().with_ring(vec![]).unwrap().with_time(vec![]).unwrap();
    cloud.refill(Stamp::default(), returns(radius));
    assert!(cloud.ring().is_some() && cloud.time().is_some() && cloud.len() == 14_400);
    cloud
}

/// Runs on a first cloud, and counts on another one that is no larger.
fn count_on_clouds(mut run: impl FnMut(&PointCloud)) -> usize {
    let (first, second) = (cloud(8.0), cloud(5.0));
    run(&first);
    counter::count(|| run(&second))
}

#[test]
fn filling_a_cloud_and_a_scan() {
    let (mut cloud, geometry) = (cloud(8.0), ScanGeometry::default());
    let mut scan = LaserScan::new(Stamp::default(), geometry, vec![1.0; 1081]).unwrap();
    let count = counter::count(|| {
        cloud.refill(Stamp::default(), returns(6.0));
        scan.refill(Stamp::default(), (0..1081).map(|_| 2.0)).unwrap();
        assert!(scan.points_in_base().all(|point| point.x.is_finite()));
    });
    assert_eq!(count, 0);
}

#[test]
fn transforming_and_cropping() {
    let target_from_source = Se3::from_parts(Vector3::new(1.0, 2.0, 0.0), So3::from_roll_pitch_yaw(0.0, 0.1, 0.3));
    let mut out = PointCloud::default();
    let count = count_on_clouds(|cloud| {
        cloud.transform_into(&target_from_source, &mut out);
        out.transform(&target_from_source);
        out.copy_from(cloud);
        out.remove_non_finite();
        out.crop_range(0.5, 50.0).unwrap();
        out.crop_box(&Vector3::repeat(-6.0), &Vector3::repeat(6.0)).unwrap();
        out.cut_out_box(&Vector3::repeat(-1.0), &Vector3::repeat(1.0)).unwrap();
        assert!(!out.is_empty());
    });
    assert_eq!(count, 0);
}

#[test]
fn voxel_grid() {
    let (mut voxels, mut out) = (VoxelGrid::new(0.2).unwrap(), PointCloud::default());
    let count = count_on_clouds(|cloud| {
        voxels.filter_into(cloud, &mut out);
        assert!(out.len() > 100);
    });
    assert_eq!(count, 0);
}

#[test]
fn range_image() {
    let mut image = RangeImage::new(RangeImageParams::default()).unwrap();
    let count = count_on_clouds(|cloud| {
        image.fill(cloud).unwrap();
        assert!((0..1800).any(|column| image.point_index(3, column).is_some()));
    });
    assert_eq!(count, 0);
}

#[test]
fn cloud_to_scan() {
    let geometry = ScanGeometry { angle_min: -3.1, angle_increment: 0.01, ..Default::default() };
    let mut scan = LaserScan::new(Stamp::default(), geometry, vec![0.0; 621]).unwrap();
    let mut converter = CloudToScan::new(CloudToScanParams::default()).unwrap();
    let count = count_on_clouds(|cloud| {
        assert!(converter.convert_into(cloud, &mut scan).unwrap().obstacles > 0);
    });
    assert_eq!(count, 0);
}

#[test]
fn deskewing() {
    let geometry = ScanGeometry { time_increment: 25e-6, ..Default::default() };
    let scans = [3.0, 5.0].map(|r| LaserScan::new(Stamp::default(), geometry, vec![r; 1081]).unwrap());
    let planar = ConstantTwist::planar(Stamp::default(), &Twist2::new(1.0, 0.0, 0.5)).unwrap();
    let (mut deskew, mut points, mut out) = (Deskew::default(), Vec::new(), scans[0].clone());
    let mut run = |scan: &LaserScan| {
        Deskew::points_into(scan, &planar, &mut points);
        deskew.scan_into(scan, &planar, &mut out).unwrap();
        assert!(points.len() == 1081 && out.ranges().iter().filter(|r| r.is_finite()).count() > 1000);
    };
    run(&scans[0]);
    assert_eq!(counter::count(|| run(&scans[1])), 0);

    let twist = Twist3 { linear: Vector3::new(2.0, 0.1, 0.0), angular: Vector3::new(0.0, 0.1, 0.8) };
    let spatial = ConstantTwist::spatial(Stamp::default(), &twist).unwrap();
    let mut out = PointCloud::default();
    assert_eq!(count_on_clouds(|cloud| Deskew::cloud_into(cloud, &spatial, &mut out)), 0);
}

#[test]
fn wheel_odometry() {
    let drive = DifferentialDrive::new(DifferentialParams::default()).unwrap();
    let mecanum = Mecanum::new(MecanumParams::default()).unwrap();
    let mut two = WheelOdometry::new(drive, EncoderParams::default(), WheelNoise::default()).unwrap();
    let mut four = WheelOdometry::new(mecanum, EncoderParams::default(), WheelNoise::default()).unwrap();
    let mut odom_from_base = Se2::default();
    let count = counter::count(|| {
        for k in 0..50 {
            let stamp = Stamp::from_seconds(0.1 * k as f64);
            if let Some(motion) = two.update(stamp, [300 * k, 310 * k], []).unwrap() {
                odom_from_base = odom_from_base * motion.start_from_end;
            }
            four.update(stamp, [300 * k, 310 * k, 300 * k, 310 * k], []).unwrap();
        }
    });
    assert_eq!(count, 0);
    assert!(odom_from_base.yaw() > 0.0);
}
