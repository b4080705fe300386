//! Rays of 10 m: skipping free space, exact along the cells, and a textbook traversal beside them in the same run.
//!
//! `scan` casts 60 beams from each of 400 poses through the scan interface, `rays` single rays of random origin and
//! direction, sine and cosine included. The `naive` figure tells how fast the machine is at the moment.

use agv_bench::maps;
use agv_core::compute::Par;
use agv_core::geometry::Se2;
use agv_core::grid::{Cell, CellState, Grid, RayCastParams, RayCaster};
use agv_core::nalgebra::Vector2;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

const MAX_RANGE: f64 = 10.0;
const BEAMS: usize = 60;

/// Amanatides and Woo's traversal in floating point.
fn naive(map: &Grid<CellState>, origin: &Vector2<f64>, angle: f64) -> Option<Cell> {
    let layout = map.layout();
    let start = layout.to_grid(origin);
    let (dir, reach) = (Vector2::new(angle.cos(), angle.sin()), MAX_RANGE / layout.resolution());
    let mut cell = Cell::new(start.x.floor() as i32, start.y.floor() as i32);
    let step = |d: f64| if d > 0.0 { 1 } else { -1 };
    let (sx, sy) = (step(dir.x), step(dir.y));
    let first = |s: f64, d: f64| if d > 0.0 { (s.floor() + 1.0 - s) / d } else { (s - s.floor()) / -d };
    let (mut tx, mut ty) = (first(start.x, dir.x), first(start.y, dir.y));
    let (dx, dy) = (1.0 / dir.x.abs(), 1.0 / dir.y.abs());
    loop {
        match map.get(cell) {
            Some(CellState::Occupied) => return Some(cell),
            Some(_) => {}
            None => return None,
        }
        let t = tx.min(ty);
        if t > reach {
            return None;
        }
        if tx <= ty {
            (cell.x, tx) = (cell.x + sx, tx + dx);
        } else {
            (cell.y, ty) = (cell.y + sy, ty + dy);
        }
    }
}

fn ray_cast(c: &mut Criterion) {
    let (name, map) = maps::depot_or_office();
    let layout = *map.layout();
    let caster = RayCaster::new(&map, RayCastParams::default()).expect("a map of ordinary size");
    // Xorshift: enough to scatter rays.
    let mut state = 88_172_645_463_325_252_u64;
    let mut uniform = |max: f64| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        max * (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let (width, height) = (layout.width() as f64 * 0.05, layout.height() as f64 * 0.05);
    let mut rays = Vec::new();
    while rays.len() < 24_000 {
        let origin = Vector2::new(uniform(width), uniform(height));
        let free = layout.cell_at(&origin).and_then(|cell| map.get(cell)) == Some(&CellState::Free);
        if free {
            rays.push((origin, uniform(std::f64::consts::TAU)));
        }
    }
    let directions: Vec<_> = (0..BEAMS).map(|i| i as f64 * std::f64::consts::TAU / BEAMS as f64).collect();
    let directions: Vec<_> = directions.iter().map(|a| Vector2::new(a.cos(), a.sin())).collect();
    check(&map, &caster, &rays);

    let mut group = c.benchmark_group(format!("ray_cast/{name}"));
    group.throughput(Throughput::Elements(rays.len() as u64));
    group.sample_size(40);
    group.bench_function("scan/skipping", |b| {
        let mut ranges = vec![0.0_f32; BEAMS];
        b.iter(|| {
            for (origin, yaw) in &rays[..rays.len() / BEAMS] {
                let pose = Se2::new(origin.x, origin.y, *yaw);
                caster.cast_into(&pose, &directions, MAX_RANGE, &mut ranges, Par::Seq);
                black_box(&mut ranges);
            }
        });
    });
    group.bench_function("rays/skipping", |b| {
        b.iter(|| rays.iter().filter_map(|(o, a)| caster.cast(o, *a, MAX_RANGE)).map(|h| h.range).sum::<f64>());
    });
    group.bench_function("rays/exact", |b| {
        b.iter(|| rays.iter().filter_map(|(o, a)| caster.cast_exact(o, *a, MAX_RANGE)).map(|h| h.range).sum::<f64>());
    });
    group.bench_function("rays/naive", |b| {
        b.iter(|| rays.iter().filter_map(|(o, a)| naive(&map, o, *a)).map(|c| i64::from(c.x)).sum::<i64>());
    });
    group.throughput(Throughput::Elements(layout.len() as u64));
    group.bench_function("build", |b| b.iter(|| RayCaster::new(black_box(&map), RayCastParams::default())));
    group.finish();
}

/// Skipping changes nothing on any ray; the textbook agrees but for rays through corners.
fn check(map: &Grid<CellState>, caster: &RayCaster, rays: &[(Vector2<f64>, f64)]) {
    let mut differences = 0;
    for (origin, angle) in rays {
        let exact = caster.cast_exact(origin, *angle, MAX_RANGE);
        assert_eq!(caster.cast(origin, *angle, MAX_RANGE), exact);
        differences += usize::from(naive(map, origin, *angle) != exact.map(|hit| hit.cell));
    }
    assert!(differences * 1000 < rays.len(), "{differences} rays end elsewhere");
}

criterion_group!(benches, ray_cast);
criterion_main!(benches);
