//! Graph SLAM: 361 beams at 0.1 m steps, around a block of 9 m by 5 m and on until the loop is closed.
//!
//! The whole drive with all that key scans and closures take, and a scan that becomes no key scan: the front end alone. Throughput is
//! in scans.

use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2, Twist2},
    nalgebra::{Vector2, Vector3},
    sensors::LaserScan,
    time::Stamp,
};
use agv_filters::slam::graph::{GraphSlam, GraphSlamParams};
use agv_sim::{Laser, LaserParams, Shape, World2d};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::{
    f64::consts::{FRAC_PI_2, PI},
    hint::black_box,
};

fn building() -> World2d {
    let mut shapes = Shape::room(Vector2::new(0.0, 0.0), Vector2::new(15.0, 11.0)).to_vec();
    shapes.push(Shape::rectangle(Se2::new(7.5, 5.5, 0.0), 9.0, 5.0));
    let posts = [(2.1, 10.6), (4.3, 0.3), (9.7, 0.4), (14.7, 3.0), (14.6, 7.9), (11.2, 10.7), (0.3, 7.1), (0.4, 3.9)];
    shapes.extend(posts.map(|(x, y)| Shape::Circle { center: Vector2::new(x, y), radius: 0.4 }));
    World2d::new(shapes).expect("sound")
}

/// Odometry and scan of each step.
fn drive() -> Vec<(Se2, LaserScan)> {
    let (world, params) = (building(), LaserParams { range_sigma: 0.02, ..LaserParams::default() });
    let mut laser = Laser::new(params.with_beams(361, PI), Seed(1)).expect("sound");
    let (mut truth, mut odometry, mut steps) = (Se2::new(3.0, 1.5, 0.0), Se2::default(), Vec::new());
    let lengths = [9.0, FRAC_PI_2, 5.0, FRAC_PI_2, 9.0, FRAC_PI_2, 5.0, FRAC_PI_2, 9.0];
    for (part, length) in lengths.into_iter().enumerate() {
        let count = (length / 0.1_f64).round();
        let step: f64 = length / count;
        let motion = Se2::exp(&Vector3::new(step, 0.0, if part % 2 == 1 { step } else { 0.0 }));
        for _ in 0..count as usize {
            let scan = laser.scan(&world, &truth, &Twist2::ZERO, Stamp::default()).expect("finite").clone();
            steps.push((odometry, scan));
            truth = truth * motion;
            odometry = odometry * Se2::new(1.03 * motion.x(), motion.y(), 0.97 * motion.yaw());
        }
    }
    steps
}

fn graph_slam(c: &mut Criterion) {
    let steps = drive();
    let map_all = || {
        let mut slam = GraphSlam::new(GraphSlamParams::default()).expect("sound");
        let closures: usize =
            steps.iter().map(|(odometry, scan)| slam.process(scan, Some(odometry)).expect("finite").closures).sum();
        (slam, closures)
    };
    let (mut slam, closures) = map_all();
    println!(
        "{} scans, {} key scans, {closures} closures, {:.1} kB",
        steps.len(),
        slam.keys(),
        slam.memory() as f64 / 1e3
    );
    assert!(closures > 5);

    let mut group = c.benchmark_group("graph_slam");
    group.sample_size(10).throughput(Throughput::Elements(steps.len() as u64));
    group.bench_function("drive", |b| b.iter(&map_all));
    group.sample_size(100).throughput(Throughput::Elements(1));
    slam.set_frozen(true).expect("sound");
    let (odometry, scan) = &steps[steps.len() - 1];
    group.bench_function("scan", |b| b.iter(|| slam.process(black_box(scan), Some(odometry))));
    group.finish();
}

criterion_group!(benches, graph_slam);
criterion_main!(benches);
