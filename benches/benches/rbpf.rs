//! Mapping with a particle filter: an update of 10 and 30 particles by a scan, in a ring of corridors that has been mapped once
//! around.
//!
//! An update matches the scan with the last ones, then for each particle with its map, fits the proposal and inserts the scan.
//! Throughput is in particles. Beside it the copy of all particles that an update is measured on: a counted reference per map.

use agv_core::{
    compute::{Par, Seed},
    geometry::{LieGroup, Se2, Twist2},
    nalgebra::{Matrix3, Vector2},
    odometry::OdometryIncrement,
    sensors::LaserScan,
    time::Stamp,
};
use agv_filters::{
    particle::{DifferentialOdometryModel, OdometryNoise},
    slam::{Rbpf, RbpfParams},
};
use agv_sim::{Laser, LaserParams, Shape, World2d};
use criterion::{BatchSize, BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use std::f64::consts::{PI, TAU};

fn ring() -> World2d {
    let mut shapes = Shape::room(Vector2::new(-9.0, -9.0), Vector2::new(9.0, 9.0)).to_vec();
    shapes.push(Shape::rectangle(Se2::new(0.0, 0.0, 0.0), 7.0, 7.0));
    shapes.push(Shape::rectangle(Se2::new(8.5, 2.0, 0.4), 0.8, 0.6));
    shapes.push(Shape::rectangle(Se2::new(-1.0, 8.7, 0.0), 1.0, 0.6));
    shapes.push(Shape::rectangle(Se2::new(-8.7, -1.0, 0.2), 0.5, 1.5));
    World2d::new(shapes).expect("sound")
}

/// Once around in steps of 0.35 m, and a step more.
fn drive(beams: usize) -> Vec<(Se2, LaserScan)> {
    let (world, params) = (ring(), LaserParams { range_sigma: 0.02, ..LaserParams::default() });
    let mut laser = Laser::new(params.with_beams(beams, PI), Seed(1)).expect("sound");
    let radius = 6.2;
    let steps = (TAU * radius / 0.35) as usize;
    let pose = |i: usize| {
        let turn = TAU * i as f64 / steps as f64;
        Se2::new(radius * turn.cos(), radius * turn.sin(), turn + 0.5 * PI)
    };
    let scan = |i: usize| laser.scan(&world, &pose(i), &Twist2::ZERO, Stamp::default()).expect("finite").clone();
    let scans: Vec<_> = (0..=steps).map(scan).collect();
    scans.into_iter().enumerate().map(|(i, scan)| (pose(i.max(1) - 1).between(&pose(i)), scan)).collect()
}

fn odometry(motion: Se2) -> OdometryIncrement {
    let stamp = Stamp::default();
    OdometryIncrement { start: stamp, end: stamp, start_from_end: motion, covariance: Matrix3::zeros() }
}

fn rbpf(c: &mut Criterion) {
    let mut group = c.benchmark_group("rbpf");
    for (particles, beams) in [(10, 361), (30, 181), (30, 361)] {
        let steps = drive(beams);
        let motion = DifferentialOdometryModel::new(OdometryNoise::uniform(0.05)).expect("sound");
        let params = RbpfParams { particles, ..RbpfParams::default() };
        let mut slam = Rbpf::new(motion, params, Seed(1)).expect("sound");
        let (last, before) = steps.split_last().expect("some");
        for (motion, scan) in before {
            slam.predict(&odometry(*motion)).expect("finite");
            slam.update(scan).expect("near");
        }
        slam.predict(&odometry(last.0)).expect("finite");
        let (mut once, start) = (slam.clone(), slam.trajectory()[0].1);
        let update = once.update(&last.1).expect("near");
        let off = start.between(&once.map_from_base()).translation().norm();
        assert!(update.skipped.is_none() && update.matched == particles && off < 0.15, "{update:?} {off}");
        println!("{particles} particles, {beams} beams: {:.1} MB", once.memory() as f64 / 1e6);

        let name = format!("{particles} particles, {beams} beams");
        group.throughput(Throughput::Elements(particles as u64));
        for threads in [1, 2] {
            let slam = slam.clone().with_parallelism(Par::threads(threads));
            group.bench_function(BenchmarkId::new(format!("update, {threads} threads"), &name), |b| {
                let update = |mut slam: Rbpf<_>| {
                    slam.update(&last.1).expect("near");
                    slam
                };
                b.iter_batched(|| slam.clone(), update, BatchSize::LargeInput);
            });
        }
        group.bench_function(BenchmarkId::new("copy", &name), |b| b.iter_with_large_drop(|| slam.clone()));
    }
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(30);
    targets = rbpf
}
criterion_main!(benches);
