//! Curves of bounded curvature, and hybrid A*.
//!
//! `length` and `curve` are the mean over goals spread around the start, `hybrid_a_star` the time of a query on a map that is
//! known: a generated warehouse of 60 x 40 m at 5 cm, and a parking space.

use agv_core::{
    compute::Seed,
    geometry::Se2,
    grid::{Cell, CellState, CollisionChecker, CollisionParams, Costmap, Footprint, Grid, GridLayout},
    path::Path,
    roles::{GlobalPlanner as _, PlanOutcome},
};
use agv_plan::hybrid::{Dubins, HybridAStar, HybridAStarParams, ReedsShepp};
use agv_sim::{Factory, FactoryParams};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rand::RngExt as _;
use std::{f64::consts::PI, hint::black_box};

fn curves(c: &mut Criterion) {
    let start = Se2::default();
    let (car, dubins) = (ReedsShepp::new(1.0).unwrap(), Dubins::new(1.0).unwrap());
    for (name, reach) in [("near", 2.0), ("far", 10.0)] {
        let mut stream = Seed(3).stream(0, 0);
        let goals: Vec<Se2> = (0..1000)
            .map(|_| {
                let mut draw = |half: f64| stream.random_range(-half..half);
                Se2::new(draw(reach), draw(reach), draw(PI))
            })
            .collect();
        assert!(
            goals.iter().all(|goal| car.cost(&start, goal).unwrap() <= dubins.length(&start, goal).unwrap() + 1e-9)
        );
        let mut group = c.benchmark_group(format!("curves/{name}"));
        group.throughput(Throughput::Elements(goals.len() as u64));
        group.bench_function("reeds_shepp_length", |b| {
            b.iter(|| goals.iter().map(|goal| car.cost(&start, black_box(goal)).unwrap()).sum::<f64>());
        });
        group.bench_function("reeds_shepp_curve", |b| {
            b.iter(|| goals.iter().map(|goal| car.shortest(&start, black_box(goal)).unwrap().length()).sum::<f64>());
        });
        group.bench_function("dubins_length", |b| {
            b.iter(|| goals.iter().map(|goal| dubins.length(&start, black_box(goal)).unwrap()).sum::<f64>());
        });
        group.finish();
    }
}

fn footprint() -> Footprint {
    Footprint::rectangle(-0.4, 1.6, 0.8).unwrap()
}

fn hybrid(c: &mut Criterion) {
    let mut group = c.benchmark_group("hybrid_a_star");
    group.sample_size(10);

    let map = Factory::generate(FactoryParams::default(), Seed(1)).unwrap().map(0.05, 0.1, 1.8).unwrap();
    let checker = CollisionChecker::new(&map, footprint(), CollisionParams::default()).unwrap();
    let mut stream = Seed(5).stream(0, 0);
    let mut free = || loop {
        let mut draw = |from: f64, to: f64| stream.random_range(from..to);
        let pose = Se2::new(draw(0.0, 60.0), draw(0.0, 40.0), draw(-PI, PI));
        if !checker.collides(&pose).unwrap() {
            return pose;
        }
    };
    let queries: Vec<(Se2, Se2)> = (0..10).map(|_| (free(), free())).collect();
    let costmap = Costmap::from_map(&map);
    let mut planner = HybridAStar::new(HybridAStarParams::default(), footprint()).unwrap();
    let mut path = Path::new();
    let mut solves = |(start, goal): &(Se2, Se2)| {
        matches!(planner.plan_into(&costmap, start, goal, &mut path), Ok(PlanOutcome::Found { .. }))
    };
    assert!(queries.iter().all(&mut solves));
    group.throughput(Throughput::Elements(queries.len() as u64));
    group.bench_function("warehouse", |b| {
        b.iter(|| queries.iter().filter(|query| solves(query)).count());
    });

    let cells = |metres: f64| (metres / 0.05_f64).round() as i32;
    let mut lot = Grid::filled(GridLayout::new(240, 92, 0.05, Se2::default()).unwrap(), CellState::Occupied);
    for [x0, y0, x1, y1] in [[0.3, 0.3, 11.7, 2.9], [4.5, 2.9, 7.7, 4.1]] {
        for (x, y) in (cells(x0)..cells(x1)).flat_map(|x| (cells(y0)..cells(y1)).map(move |y| (x, y))) {
            lot.set(Cell::new(x, y), CellState::Free);
        }
    }
    let costmap = Costmap::from_map(&lot);
    let (start, goal) = (Se2::new(1.2, 1.5, 0.0), Se2::new(5.5, 3.5, 0.0));
    let found = planner.plan_into(&costmap, &start, &goal, &mut path).unwrap();
    assert!(matches!(found, PlanOutcome::Found { .. }), "{found:?}");
    group.throughput(Throughput::Elements(1));
    group.bench_function("parking", |b| b.iter(|| planner.plan_into(&costmap, &start, &goal, &mut path).unwrap()));
    group.finish();
}

criterion_group!(benches, curves, hybrid);
criterion_main!(benches);
