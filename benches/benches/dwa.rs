//! The dynamic window: roll-outs on a distance field, with few and many obstacle points, the field's update apart, and a whole cycle.

use agv_bench::window::{costmap, limits};
use agv_core::geometry::{Se2, Twist2};
use agv_core::grid::{Footprint, LocalMap, LocalMapParams};
use agv_core::nalgebra::Vector2;
use agv_core::path::Path;
use agv_core::roles::{LocalPlanRequest, LocalPlanStatus, LocalPlanner, VehicleState};
use agv_plan::dwa::{Dwa, DwaParams};
use agv_plan::local::Trajectories;
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

fn dwa(criterion: &mut Criterion) {
    let footprint = Footprint::rectangle(-0.254, 0.254, 0.43).unwrap();
    let limits = limits();
    let state = VehicleState::new(Se2::new(0.0, 0.0, 0.1), Twist2::new(1.0, 0.0, 0.0));
    let path = Path::from_positions(&[Vector2::new(-1.0, 0.0), Vector2::new(4.5, 0.0)]).unwrap();
    let mut group = criterion.benchmark_group("dwa");
    for points in [100, 1000] {
        let costmap = costmap(points);
        let mut map = LocalMap::new(&costmap, LocalMapParams::default()).unwrap();
        let fill = |batch: &mut Trajectories, map: &LocalMap| {
            batch.begin(&state, map, 30, 0.05);
            for i in 0..400 {
                batch.push([0.1 * (i / 20) as f32, 0.0, -2.0 + 0.2 * (i % 20) as f32]);
            }
        };
        let mut batch = Trajectories::default();
        for (name, outline) in [("rectangle", footprint.clone()), ("circle", Footprint::circle(0.3).unwrap())] {
            group.throughput(Throughput::Elements(400 * 30));
            group.bench_function(BenchmarkId::new(format!("400 x 30, {name}"), points), |bencher| {
                bencher.iter(|| {
                    fill(&mut batch, &map);
                    batch.roll_out(&state, &limits, &map, &outline);
                    black_box(batch.free().len())
                });
            });
            assert!(batch.free().contains(&30) && batch.free().iter().any(|&free| free < 30));
        }
        group.throughput(Throughput::Elements(map.layout().len() as u64));
        let mut other = costmap.clone();
        other.costs_mut()[0] = 254;
        group.bench_function(BenchmarkId::new("update of the field", points), |bencher| {
            let mut odd = false;
            bencher.iter(|| {
                odd = !odd;
                black_box(map.update(if odd { &other } else { &costmap }).unwrap())
            });
        });
        let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.05 };
        // The vehicle does not move on, so that the planner must not lose its patience.
        let params = DwaParams { patience: 1e9, ..DwaParams::for_footprint(&footprint) };
        let mut planner = Dwa::new(params).unwrap();
        assert_eq!(planner.command(request).unwrap().status, LocalPlanStatus::Following);
        group.throughput(Throughput::Elements(1));
        group.bench_function(BenchmarkId::new("cycle", points), |bencher| {
            bencher.iter(|| black_box(planner.command(black_box(request)).unwrap()));
        });
    }
    group.finish();
}

criterion_group!(benches, dwa);
criterion_main!(benches);
