//! Model predictive path integral control: a whole cycle among points, on one thread and on two. (Nav2's controller takes 7.5 to 12 ms
//! for 2000 samples of 50 steps, as published and as measured elsewhere.)

use agv_bench::window::{costmap, limits};
use agv_core::compute::{Par, Seed};
use agv_core::geometry::{Se2, Twist2};
use agv_core::grid::{Footprint, LocalMap, LocalMapParams};
use agv_core::nalgebra::Vector2;
use agv_core::path::Path;
use agv_core::roles::{LocalPlanRequest, LocalPlanStatus, LocalPlanner, VehicleState};
use agv_plan::mppi::{Mppi, MppiParams};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

fn mppi(criterion: &mut Criterion) {
    let footprint = Footprint::rectangle(-0.254, 0.254, 0.43).unwrap();
    let limits = limits();
    let state = VehicleState::new(Se2::new(0.0, 0.0, 0.1), Twist2::new(1.0, 0.0, 0.0));
    let path = Path::from_positions(&[Vector2::new(-1.0, 0.0), Vector2::new(4.5, 0.0)]).unwrap();
    let map = LocalMap::new(&costmap(100), LocalMapParams::default()).unwrap();
    let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.05 };
    let mut group = criterion.benchmark_group("mppi");
    for (samples, steps) in [(1000, 56), (2000, 50)] {
        // The vehicle does not move on, so that the planner must not lose its patience.
        let horizon = 0.05 * steps as f64;
        let params = MppiParams { samples, steps, horizon, patience: 1e9, ..MppiParams::for_footprint(&footprint) };
        group.throughput(Throughput::Elements((samples * steps) as u64));
        for threads in [1, 2] {
            let mut planner = Mppi::new(params.clone(), Seed(1)).unwrap().with_parallelism(Par::threads(threads));
            assert_eq!(planner.command(request).unwrap().status, LocalPlanStatus::Following);
            let name = format!("{samples} x {steps}, threads");
            group.bench_function(BenchmarkId::new(name, threads), |bencher| {
                bencher.iter(|| black_box(planner.command(black_box(request)).unwrap()));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, mppi);
criterion_main!(benches);
