//! What a path costs after it is found: key nodes, a taut string, and a bounded curvature, on a path across a factory.
#![allow(missing_docs, reason = "criterion's macros declare a function")]

use agv_core::compute::Seed;
use agv_core::geometry::Se2;
use agv_core::grid::{CollisionParams, Footprint, Inflation, InflationParams, ObstacleMap};
use agv_core::path::Path;
use agv_core::roles::GlobalPlanner;
use agv_plan::grid::{AStar, AStarParams};
use agv_plan::smooth::{
    CurvatureSmoother, CurvatureSmootherParams, KeyNodes, LineOfSightParams, PathSmoother, TautString,
};
use agv_sim::{Factory, FactoryParams};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

fn smoothing(c: &mut Criterion) {
    let factory = Factory::generate(FactoryParams::default(), Seed(1)).unwrap();
    let map = factory.map(0.1, 0.05, 1.8).unwrap();
    let footprint = Footprint::circle(0.4).unwrap();
    let params = InflationParams { inscribed_radius: 0.6, inflation_radius: 0.6, ..Default::default() };
    let costmap = Inflation::new(params).unwrap().inflate(&map).unwrap();
    let obstacles = ObstacleMap::new(&map, CollisionParams::default(), Some(2.0)).unwrap();
    let (first, last) = (factory.aisles()[0], factory.aisles()[factory.aisles().len() - 1]);
    let goal = last * Se2::new(factory.aisle_length(), 0.0, 0.0);
    let mut path = Path::new();
    AStar::new(AStarParams::default()).unwrap().plan_into(&costmap, &first, &goal, &mut path).unwrap();

    let mut group = c.benchmark_group("smoothing");
    group.throughput(Throughput::Elements(path.len() as u64));
    let mut key_nodes = KeyNodes::new(LineOfSightParams::default()).unwrap();
    let mut string = TautString::new(LineOfSightParams::default()).unwrap();
    let (mut keys, mut taut, mut smooth) = (Path::new(), Path::new(), Path::new());
    key_nodes.smooth_into(&costmap, &path, &mut keys).unwrap();
    string.smooth_into(&costmap, &path, &mut taut).unwrap();
    assert!(taut.length() <= keys.length() && keys.length() <= path.length());
    group.bench_function("key nodes", |b| b.iter(|| key_nodes.smooth_into(&costmap, black_box(&path), &mut smooth)));
    group.bench_function("taut string", |b| b.iter(|| string.smooth_into(&costmap, black_box(&path), &mut smooth)));
    let mut smoother = CurvatureSmoother::new(CurvatureSmootherParams::default()).unwrap();
    let outcome = smoother.smooth_into(&obstacles, &footprint, &keys, &mut smooth).unwrap();
    eprintln!(
        "{} m, key nodes {} m, taut {} m, smooth {} m, {outcome:?}",
        path.length(),
        keys.length(),
        taut.length(),
        smooth.length()
    );
    assert!(outcome.kept == 0 && outcome.max_curvature <= 1.05);
    group.bench_function("bounded curvature", |b| {
        b.iter(|| smoother.smooth_into(&obstacles, &footprint, black_box(&keys), &mut smooth));
    });
    group.finish();
}

criterion_group!(benches, smoothing);
criterion_main!(benches);
