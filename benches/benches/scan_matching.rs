//! Scan matching: a scan of 361 beams in a hall of 13 m by 9 m, against three others.
//!
//! The search of the default window as odometry needs it, the refinement alone, and the search of all headings within 3 m as a loop
//! closure needs it; the other matchers from a near guess; and what a target costs. Throughput is in scans.

use agv_core::{
    compute::Seed,
    geometry::{Se2, Twist2},
    nalgebra::Vector2,
    roles::{ScanMatcher, TargetScan},
    sensors::LaserScan,
    time::Stamp,
};
use agv_filters::matching::{
    ClimbingMatcher, ClimbingMatcherParams, CorrelativeMatcher, CorrelativeParams, FieldMatcher, FieldMatcherParams,
    PointToLineMatcher, PointToLineParams, SearchWindow,
};
use agv_ndt::ndt::{NdtScanMatcher, NdtScanMatcherParams};
use agv_sim::{Laser, LaserParams, Shape, World2d};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::{f64::consts::PI, hint::black_box};

fn hall() -> World2d {
    let mut shapes = Shape::room(Vector2::new(-6.0, -4.0), Vector2::new(7.0, 5.0)).to_vec();
    shapes.push(Shape::rectangle(Se2::new(3.0, 2.5, 0.3), 1.5, 0.8));
    shapes.push(Shape::rectangle(Se2::new(-3.0, -1.5, 0.0), 0.6, 2.0));
    shapes.push(Shape::Circle { center: Vector2::new(0.5, -2.5), radius: 0.4 });
    World2d::new(shapes).expect("sound")
}

fn scan_matching(c: &mut Criterion) {
    let (world, params) = (hall(), LaserParams { range_sigma: 0.02, ..LaserParams::default() });
    let mut laser = Laser::new(params.with_beams(361, 1.5 * PI), Seed(1)).expect("sound");
    let mut scan = |pose: &Se2| -> LaserScan {
        laser.scan(&world, pose, &Twist2::ZERO, Stamp::default()).expect("finite").clone()
    };
    let poses = [(0.0, 0.0, 0.0), (0.5, 0.5, 2.0), (-0.5, 0.3, -2.0)].map(|(x, y, yaw)| Se2::new(x, y, yaw));
    let scans = poses.map(|pose| scan(&pose));
    let target: Vec<_> =
        poses.iter().zip(&scans).map(|(pose, scan)| TargetScan { target_from_base: *pose, scan }).collect();
    let (truth, guess) = (Se2::new(0.3, -0.2, 0.4), Se2::new(0.15, -0.05, 0.25));
    let reading = scan(&truth);
    let mut matcher = CorrelativeMatcher::new(CorrelativeParams::default()).expect("sound");

    let mut group = c.benchmark_group("scan_matching");
    group.throughput(Throughput::Elements(1));
    group.bench_function("target of three scans", |b| b.iter(|| matcher.set_target(black_box(&target))));
    matcher.set_target(&target).expect("sound");
    let here = SearchWindow { distance: 0.0, angle: 0.0 };
    let wide = SearchWindow { distance: 3.0, angle: PI };
    let near = Se2::new(0.28, -0.18, 0.39);
    for (name, window, guess) in
        [("window", matcher.params().window, guess), ("refinement", here, near), ("loop closure", wide, guess)]
    {
        let found = matcher.match_within(&reading, &guess, window).expect("finite");
        let off = found.target_from_source.translation() - truth.translation();
        assert!(found.converged() && off.norm() < 0.03, "{name}: {found:?}");
        println!("{name}: {} poses and squares", found.iterations);
        group.bench_function(name, |b| b.iter(|| matcher.match_within(black_box(&reading), &guess, window)));
    }

    let guided: [(&str, Box<dyn ScanMatcher>); 4] = [
        ("field", Box::new(FieldMatcher::new(FieldMatcherParams::default()).expect("sound"))),
        ("climbing", Box::new(ClimbingMatcher::new(ClimbingMatcherParams::default()).expect("sound"))),
        ("point to line", Box::new(PointToLineMatcher::new(PointToLineParams::default()).expect("sound"))),
        ("ndt", Box::new(NdtScanMatcher::new(NdtScanMatcherParams::default()).expect("sound"))),
    ];
    for (name, mut matcher) in guided {
        group.bench_function(format!("target, {name}"), |b| b.iter(|| matcher.set_target(black_box(&target))));
        matcher.set_target(&target).expect("sound");
        let found = matcher.match_scan(&reading, &near).expect("finite");
        let off = found.target_from_source.translation() - truth.translation();
        assert!(found.converged() && off.norm() < 0.03, "{name}: {found:?}");
        group.bench_function(name, |b| b.iter(|| matcher.match_scan(black_box(&reading), &near)));
    }
    group.finish();
}

criterion_group!(benches, scan_matching);
criterion_main!(benches);
