//! Paths at any angle: exact (Anya) beside Theta* and Lazy Theta*, on grids of an ant colony's size and on the query sets W, D
//! and C of the grid searches. The first lines printed give how far the others are from the shortest.
//!
//! Where the shared data is not there, random grids alone are timed.
#![allow(missing_docs, reason = "criterion's macros declare a function")]

use agv_core::compute::Seed;
use agv_core::geometry::Se2;
use agv_core::grid::{CellState, Costmap, Grid, GridLayout};
use agv_core::path::Path;
use agv_core::roles::{GlobalPlanner, PlanOutcome};
use agv_plan::grid::{Anya, GridPlannerParams, LazyThetaStar, ThetaStar};
use agv_support::movingai::{read_map, read_scenario};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rand::RngExt;
use std::{hint::black_box, path::PathBuf};

type Queries = Vec<(Se2, Se2)>;

/// A fifth of the cells blocked, from corner to corner.
fn random(size: usize, seed: u64) -> (Costmap, Queries) {
    let layout = GridLayout::new(size, size, 1.0, Se2::default()).unwrap();
    let mut stream = Seed(seed).stream(0, 0);
    let mut states: Vec<_> = (0..layout.len())
        .map(|_| if stream.random_bool(0.2) { CellState::Occupied } else { CellState::Free })
        .collect();
    (states[0], states[layout.len() - 1]) = (CellState::Free, CellState::Free);
    let end = size as f64 - 0.5;
    (Costmap::from_map(&Grid::new(layout, states).unwrap()), vec![(Se2::new(0.5, 0.5, 0.0), Se2::new(end, end, 0.0))])
}

fn sets() -> Vec<(String, Costmap, Queries)> {
    let folder = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data/gridplan"));
    let mut sets: Vec<_> = [20, 50, 200]
        .into_iter()
        .map(|size| {
            let (costmap, queries) = random(size, 2);
            (format!("random {size} x {size}"), costmap, queries)
        })
        .collect();
    for (name, map) in [("W", "warehouse-20-40-10-2-2"), ("D", "brc202d"), ("C", "Berlin_1_1024")] {
        let map = read_map(folder.join(format!("movingai/{map}.map.gz")));
        let queries = read_scenario(folder.join(format!("bench/{name}.scen.gz")));
        let (Ok(map), Ok(queries)) = (map, queries) else { continue };
        let pose = |cell| Se2::new(map.layout().center(cell).x, map.layout().center(cell).y, 0.0);
        let queries = queries.iter().step_by(10).map(|query| (pose(query.start), pose(query.goal))).collect();
        sets.push((name.to_owned(), Costmap::from_map(&map), queries));
    }
    sets
}

fn lengths(planner: &mut dyn GlobalPlanner, costmap: &Costmap, queries: &Queries) -> Vec<f64> {
    let mut path = Path::new();
    let length = |(start, goal): &(Se2, Se2)| match planner.plan_into(costmap, start, goal, &mut path).unwrap() {
        PlanOutcome::Found { cost, .. } => cost,
        _ => f64::NAN,
    };
    queries.iter().map(length).collect()
}

fn any_angle(c: &mut Criterion) {
    for (name, costmap, queries) in sets() {
        let mut group = c.benchmark_group(format!("any_angle/{name}"));
        group.throughput(Throughput::Elements(queries.len() as u64)).sample_size(10);
        let params = GridPlannerParams::default();
        let least = lengths(&mut Anya::new(params).unwrap(), &costmap, &queries);
        let planners: [(_, Box<dyn GlobalPlanner>); 3] = [
            ("Anya", Box::new(Anya::new(params).unwrap())),
            ("Theta*", Box::new(ThetaStar::new(params).unwrap())),
            ("Lazy Theta*", Box::new(LazyThetaStar::new(params).unwrap())),
        ];
        for (what, mut planner) in planners {
            let found = lengths(planner.as_mut(), &costmap, &queries);
            let ratios: Vec<f64> = found.iter().zip(&least).filter(|(_, l)| **l > 0.0).map(|(f, l)| f / l).collect();
            assert!(ratios.iter().all(|&ratio| ratio >= 1.0 - 1e-9), "{name} {what}");
            let greatest = ratios.iter().fold(1.0, |a: f64, b| a.max(*b));
            eprintln!("{name} {what}: mean {:.5}, max {greatest:.4}", ratios.iter().sum::<f64>() / ratios.len() as f64);
            group.bench_function(what, |b| b.iter(|| black_box(lengths(planner.as_mut(), &costmap, &queries))));
        }
        group.finish();
    }
}

criterion_group!(benches, any_angle);
criterion_main!(benches);
