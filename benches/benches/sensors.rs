//! What sensors cost before any algorithm sees them: voxel down-sampling, transform, deskewing, range image, and the
//! single-line scan of a cloud.

use agv_core::{
    geometry::{Se2, Se3, So3, Twist2, Twist3},
    nalgebra::{Vector2, Vector3},
    sensors::{
        ConstantTwist, Deskew, LaserScan, PointCloud, RangeImage, RangeImageParams, RowSource, ScanGeometry, VoxelGrid,
    },
    time::Stamp,
};
use agv_ndt::convert::{CloudToScan, CloudToScanParams};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::{collections::BTreeMap, f64::consts::TAU, hint::black_box};

/// A turn of a spinning lidar 1.5 m up in a hall of 40 m x 24 m x 6 m with racks, in firing order, with ring and time.
fn hall(lines: u16, directions: u32) -> PointCloud {
    let (mut points, mut rings, mut times) = (Vec::new(), Vec::new(), Vec::new());
    for direction in 0..directions {
        let azimuth = (f64::from(direction) + 0.5) / f64::from(directions) * TAU;
        // Racks: every fourth sector is nearer.
        let near = if ((azimuth * 8.0) as u32).is_multiple_of(4) { 0.4 } else { 1.0 };
        for ring in 0..lines {
            let elevation = (-15.0 + 30.0 * f64::from(ring) / f64::from(lines - 1)).to_radians();
            let ray = Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
            let reach = |d: f64, low: f64, high: f64| if d > 0.0 { high / d } else { low / d };
            let wall = near * reach(ray.x, -20.0, 20.0).min(reach(ray.y, -12.0, 12.0));
            let range = wall.min(reach(ray.z, -1.5, 4.5)).min(100.0);
            points.push((ray * range).cast::<f32>());
            rings.push(ring);
            times.push(direction as f32 * 0.1 / directions as f32);
        }
    }
    let mount = Se3::from_parts(Vector3::new(0.3, 0.0, 1.5), So3::from_roll_pitch_yaw(0.0, 0.02, 0.0));
    let cloud = PointCloud::from_points(points).with_mount(mount).expect("a finite pose");
    cloud.with_ring(rings).and_then(|c| c.with_time(times)).expect("channels of equal length")
}

/// The textbook way, as a yardstick: sort points by voxel, then average runs.
fn sorted_voxels(cloud: &PointCloud, leaf: f32) -> usize {
    let floor = |v: f32| (v / leaf).floor() as i64;
    let mut keys: Vec<(u64, u32)> = cloud
        .points()
        .enumerate()
        .map(|(i, p)| {
            let bits = |v: f32| (floor(v) + (1 << 20)) as u64;
            ((bits(p.x) << 42) | (bits(p.y) << 21) | bits(p.z), i as u32)
        })
        .collect();
    keys.sort_unstable();
    let (x, y, z) = (cloud.x(), cloud.y(), cloud.z());
    let mean = |run: &[(u64, u32)]| {
        let point = |i: u32| Vector3::new(x[i as usize], y[i as usize], z[i as usize]);
        run.iter().map(|&(_, i)| point(i)).sum::<Vector3<f32>>() / run.len() as f32
    };
    let means: Vec<Vector3<f32>> = keys.chunk_by(|a, b| a.0 == b.0).map(mean).collect();
    black_box(means).len()
}

fn voxels(c: &mut Criterion) {
    let cloud = hall(64, 1800);
    let mut out = PointCloud::default();
    let mut group = c.benchmark_group("voxel");
    group.throughput(Throughput::Elements(cloud.len() as u64));
    for leaf in [0.1, 0.25, 0.5] {
        let mut grid = VoxelGrid::new(leaf).expect("a sound leaf");
        grid.filter_into(&cloud, &mut out);
        let mut bins: BTreeMap<[i64; 3], u32> = BTreeMap::new();
        cloud.points().for_each(|p| *bins.entry([p.x, p.y, p.z].map(|v| (v / leaf).floor() as i64)).or_default() += 1);
        // Multiplying by 1/leaf and dividing by leaf may differ for a point on a face.
        assert!(out.len().abs_diff(bins.len()) <= 1 + bins.len() / 100, "{} {}", out.len(), bins.len());
        group.bench_function(format!("grid/{leaf}"), |b| b.iter(|| grid.filter_into(black_box(&cloud), &mut out)));
        group.bench_function(format!("sort/{leaf}"), |b| b.iter(|| sorted_voxels(black_box(&cloud), leaf)));
    }
}

fn clouds(c: &mut Criterion) {
    let cloud = hall(64, 1800);
    let mut out = PointCloud::default();
    let mut group = c.benchmark_group("cloud");
    group.throughput(Throughput::Elements(cloud.len() as u64));
    let turn = Se3::from_parts(Vector3::zeros(), So3::from_roll_pitch_yaw(0.1, 0.2, 0.3));
    let mut moved = cloud.clone();
    group.bench_function("transform", |b| b.iter(|| moved.transform(black_box(&turn))));
    group.bench_function("transform_into", |b| b.iter(|| cloud.transform_into(black_box(&turn), &mut out)));
    let twist = Twist3 { linear: Vector3::new(2.0, 0.0, 0.0), angular: Vector3::new(0.0, 0.0, 0.8) };
    let motion = ConstantTwist::spatial(Stamp::default(), &twist).expect("a finite twist");
    group.bench_function("deskew", |b| b.iter(|| Deskew::cloud_into(black_box(&cloud), &motion, &mut out)));
    let (bottom, top) = (-15_f32.to_radians(), 15_f32.to_radians());
    for (name, row_source) in [("ring", RowSource::Ring), ("elevation", RowSource::Uniform { bottom, top })] {
        let mut image =
            RangeImage::new(RangeImageParams { rows: 64, columns: 1800, row_source }).expect("a sound image");
        group.bench_function(format!("range_image/{name}"), |b| b.iter(|| image.fill(black_box(&cloud))));
    }
    group.finish();

    let cloud = hall(16, 1800);
    let mut group = c.benchmark_group("to_scan");
    group.throughput(Throughput::Elements(cloud.len() as u64));
    let geometry = ScanGeometry { angle_min: -0.5 * TAU, angle_increment: 0.25_f64.to_radians(), ..Default::default() };
    let mut scan = LaserScan::new(Stamp::default(), geometry, vec![0.0; 1440]).expect("a sound scan");
    let mut converter = CloudToScan::new(CloudToScanParams::default()).expect("sound parameters");
    let report = converter.convert_into(&cloud, &mut scan).expect("a cloud with rings");
    assert!(report.obstacles > 1000 && report.ground > 1000, "{report:?}");
    group.bench_function("16x1800", |b| b.iter(|| converter.convert_into(black_box(&cloud), &mut scan)));
}

fn scans(c: &mut Criterion) {
    let mount = Se2::new(0.3, 0.0, 0.0);
    let geometry = ScanGeometry { base_from_sensor: mount, time_increment: 25e-6, ..Default::default() };
    let ranges: Vec<f32> = (0..1081_u16).map(|i| 5.0 + f32::from(i % 97) * 0.1).collect();
    let scan = LaserScan::new(Stamp::default(), geometry, ranges).expect("a sound scan");
    let motion = ConstantTwist::planar(Stamp::default(), &Twist2::new(1.5, 0.0, 1.0)).expect("a finite twist");
    let mut points: Vec<Vector2<f64>> = Vec::new();
    Deskew::points_into(&scan, &motion, &mut points);
    assert_eq!(points.len(), scan.len());
    let mut group = c.benchmark_group("scan");
    group.throughput(Throughput::Elements(scan.len() as u64));
    group.bench_function("deskew_points", |b| b.iter(|| Deskew::points_into(black_box(&scan), &motion, &mut points)));
    let mut out = scan.clone();
    let mut deskew = Deskew::default();
    group.bench_function("deskew_scan", |b| b.iter(|| deskew.scan_into(black_box(&scan), &motion, &mut out)));
    group.bench_function("points_in_base", |b| {
        b.iter(|| {
            points.clear();
            points.extend(black_box(&scan).points_in_base());
        });
    });
}

criterion_group!(benches, voxels, clouds, scans);
criterion_main!(benches);
