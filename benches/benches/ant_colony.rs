//! Ant colonies: a whole run of 50 ants and 100 iterations, on maps of the paper's sizes.
//!
//! Where the shared maps are not there, seeded ones of the same sizes and densities stand in. Throughput in ants; the first
//! lines printed give milliseconds a run (the least of twenty), nanoseconds a step and the ratio to the optimum.
#![allow(missing_docs, reason = "criterion's macros declare a function")]

use agv_core::{
    compute::Seed,
    geometry::Se2,
    grid::{Cell, CellState, Costmap, Grid, GridLayout},
};
use agv_plan::{
    aco::{Colony, ColonyParams, SparrowParams, Swarm},
    grid::{GridParams, GridSolver, GridSpace, Limits, Potential, SearchEnd},
};
use agv_support::movingai::read_map;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rand::RngExt;
use std::{hint::black_box, time::Instant};

struct Case {
    name: &'static str,
    space: GridSpace,
    start: u32,
    goal: u32,
    optimum: f64,
}

fn cases() -> Vec<Case> {
    [
        ("rand20-20-1", 20, 0.2),
        ("rand20-25-3", 20, 0.25),
        ("rand20-30-2", 20, 0.3),
        ("rand50-20-1", 50, 0.2),
        ("rand50-25-1", 50, 0.25),
    ]
    .into_iter()
    .map(|(name, size, density)| {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data/gridplan/aco");
        let shared = read_map(format!("{folder}/{name}.map")).ok().and_then(|map| case(name, &map));
        shared.unwrap_or_else(|| (0..).find_map(|seed| case(name, &random_map(size, density, seed))).unwrap())
    })
    .collect()
}

fn random_map(size: usize, density: f64, seed: u64) -> Grid<CellState> {
    let layout = GridLayout::new(size, size, 1.0, Se2::default()).unwrap();
    let mut stream = Seed(seed).stream(size as u64, 0);
    let state = |_| if stream.random::<f64>() < density { CellState::Occupied } else { CellState::Free };
    Grid::new(layout, (0..layout.len()).map(state).collect()).unwrap()
}

/// From the upper left to the lower right corner, if they are joined.
fn case(name: &'static str, map: &Grid<CellState>) -> Option<Case> {
    let mut space = GridSpace::new(GridParams::default()).unwrap();
    space.update(&Costmap::from_map(map));
    let last = map.layout().width() as i32 - 1;
    let (start, goal) = (space.node(Cell::new(0, last))?, space.node(Cell::new(last, 0))?);
    let mut potential = Potential::default();
    potential.compute(&space, goal).ok()?;
    let optimum = potential.distance(start)?;
    Some(Case { name, space, start, goal, optimum })
}

fn runs(c: &mut Criterion) {
    let colonies = [("ACO", ColonyParams::aco()), ("IACO", ColonyParams::iaco()), ("refined", ColonyParams::refined())];
    for case in cases() {
        let mut group = c.benchmark_group(format!("ant_colony/{}", case.name));
        group.sample_size(10);
        for (name, params) in colonies {
            let mut colony = Colony::new(params, Seed(1)).unwrap();
            let mut run = || colony.search(&case.space, case.start, case.goal, &mut Limits::none());
            assert!(matches!(run().end, SearchEnd::Goal { .. }));
            let least = (0..20).map(|_| {
                let start = Instant::now();
                black_box(run());
                start.elapsed().as_secs_f64()
            });
            let least = least.fold(f64::INFINITY, f64::min);
            group.throughput(Throughput::Elements((params.ants * params.iterations) as u64));
            group.bench_function(name, |b| b.iter(&mut run));
            let (steps, length) = (colony.run().steps as f64, colony.run().length.unwrap());
            assert!(length >= case.optimum - 1e-4);
            println!(
                "{:12} {name:8} {:6.2} ms, {:5.1} ns a step, ratio {:.4}",
                case.name,
                least * 1e3,
                least * 1e9 / steps,
                length / case.optimum
            );
        }
        let mut swarm = Swarm::new(SparrowParams::improved(), Seed(1)).unwrap();
        if matches!(swarm.search(&case.space, case.start, case.goal, &mut Limits::none()).end, SearchEnd::Goal { .. }) {
            group.bench_function("sparrows", |b| {
                b.iter(|| swarm.search(&case.space, case.start, case.goal, &mut Limits::none()));
            });
        }
        group.finish();
    }
}

criterion_group!(benches, runs);
criterion_main!(benches);
