//! Exact Euclidean distance transform: time per cell, with the memory reused.

use agv_bench::maps;
use agv_core::grid::{CellState, DistanceParams, DistanceTransform, Grid};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

/// Compares some cells with a search over all obstacles.
fn check(map: &Grid<CellState>) {
    let layout = *map.layout();
    let mut squared = Grid::filled(layout, 0);
    DistanceTransform::default().squared_into(map, &mut squared).expect("a map of ordinary size");
    let obstacles: Vec<_> =
        (0..layout.len()).filter(|&i| map.values()[i] == CellState::Occupied).map(|i| layout.cell(i)).collect();
    for index in (0..layout.len()).step_by(layout.len() / 97) {
        let c = layout.cell(index);
        let nearest = obstacles.iter().map(|o| (o.x - c.x).pow(2) + (o.y - c.y).pow(2)).min();
        assert_eq!(squared.get(c).copied(), nearest, "cell {c:?}");
    }
}

fn distance(c: &mut Criterion) {
    let mut group = c.benchmark_group("distance_transform");
    let limited = DistanceParams { max_distance: Some(2.0), ..Default::default() };
    let (name, small) = maps::depot_or_office();
    for (name, map) in [(name, small), ("office_4000x4000", maps::office(4000, 4000))] {
        check(&map);
        group.throughput(Throughput::Elements(map.layout().len() as u64));
        group.sample_size(if map.layout().len() > 1_000_000 { 10 } else { 60 });
        for (limit, params) in [("all", DistanceParams::default()), ("to_2m", limited)] {
            let mut transform = DistanceTransform::new(params).expect("good parameters");
            let mut field = transform.compute(&map).expect("a map of ordinary size");
            group.bench_function(format!("{name}/{limit}"), |b| {
                b.iter(|| transform.compute_into(black_box(&map), &mut field));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, distance);
criterion_main!(benches);
