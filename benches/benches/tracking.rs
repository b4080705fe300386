//! What it costs per scan to find and follow what moves: 720 beams of 10 m in a hall with poles and people.
//!
//! `update` is the tracker's whole cycle; `clusters` finds the groups of hits alone; `assignment` gives 60 clusters to 60 tracks,
//! four of them near each.

use agv_core::{
    compute::Seed,
    geometry::{Se2, Twist2},
    nalgebra::Vector2,
    obstacle::MovingObstacle,
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use agv_filters::tracking::{Assignment, ClusterParams, ObstacleTracker, ScanClusters, TrackerParams};
use agv_sim::{Laser, LaserParams, Populated, Shape, World2d};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

/// Three seconds of scans at 20 Hz from a vehicle that turns on the spot among `poles` poles and `people` who go round it.
fn scans(poles: u32, people: u32) -> Vec<LaserScan> {
    let mut shapes = Shape::room(Vector2::new(-9.0, -9.0), Vector2::new(9.0, 9.0)).to_vec();
    for i in 0..poles {
        let (angle, radius) = (2.399 * f64::from(i), 4.5 + 4.0 * f64::from(i) / f64::from(poles));
        shapes.push(Shape::Circle { center: Vector2::new(angle.cos(), angle.sin()) * radius, radius: 0.075 });
    }
    let world = World2d::new(shapes).expect("a valid world");
    let geometry = ScanGeometry { range_max: 10.0, ..ScanGeometry::default() };
    let params = LaserParams { geometry, ..LaserParams::default() }.with_beams(720, 270_f64.to_radians());
    let mut laser = Laser::new(params, Seed(1)).expect("good parameters");
    let scan_at = |step: u32| {
        let time = 0.05 * f64::from(step);
        let person = |i: u32| {
            let (angle, radius) = (f64::from(i) + 0.4 * time, 2.0 + 0.4 * f64::from(i % 5));
            let (sin, cos) = angle.sin_cos();
            let velocity = Vector2::new(-sin, cos) * (0.4 * radius);
            MovingObstacle::new(Vector2::new(cos, sin) * radius, velocity, 0.25).expect("a valid obstacle")
        };
        let people: Vec<_> = (0..people).map(person).collect();
        let populated = Populated { world: &world, obstacles: &people };
        laser.scan(&populated, &Se2::default(), &Twist2::ZERO, Stamp::from_seconds(time)).expect("a valid pose").clone()
    };
    (0..60).map(scan_at).collect()
}

fn tracking(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("tracking");
    group.throughput(Throughput::Elements(720));
    for (poles, people) in [(20, 2), (100, 6)] {
        let scans = scans(poles, people);
        let mut tracker = ObstacleTracker::new(TrackerParams::default()).expect("good parameters");
        for scan in &scans {
            tracker.update(scan, &Se2::default()).expect("in order");
        }
        assert!(tracker.obstacles().len() >= people as usize / 2, "{} move", tracker.obstacles().len());
        let name = format!("{poles}_poles_{people}_people");
        group.bench_function(format!("update/{name}"), |b| {
            let mut turn = (0..scans.len()).cycle();
            b.iter(|| {
                let next = turn.next().unwrap_or(0);
                if next == 0 {
                    tracker.reset();
                }
                tracker.update(black_box(&scans[next]), &Se2::default()).expect("in order").len()
            });
        });
        let mut clusters = ScanClusters::new(ClusterParams::default()).expect("good parameters");
        group.bench_function(format!("clusters/{name}"), |b| {
            b.iter(|| clusters.segment(black_box(&scans[30]), &Se2::default(), |_, _| true));
        });
    }
    let pairs: Vec<(usize, usize, f64)> = (0..60)
        .flat_map(|row| (0..4).map(move |k| (row, (row + k) % 60, 1.0 + ((7 * row + 5 * k) % 11) as f64)))
        .collect();
    let mut assignment = Assignment::default();
    assignment.solve(60, 60, 14.0, pairs.iter().copied());
    assert!(assignment.column_of().iter().flatten().count() > 50);
    group.throughput(Throughput::Elements(60));
    group.bench_function("assignment/60x60", |b| {
        b.iter(|| assignment.solve(60, 60, 14.0, black_box(&pairs).iter().copied()));
    });
    group.finish();
}

criterion_group!(benches, tracking);
criterion_main!(benches);
