//! Inflation per cell, and footprint checks per pose and per motion.

use agv_bench::maps;
use agv_core::geometry::{Se2, Twist2};
use agv_core::grid::{CollisionChecker, CollisionParams, Footprint, Inflation, InflationParams};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

fn inflation(c: &mut Criterion) {
    let (name, map) = maps::depot_or_office();
    let mut group = c.benchmark_group(format!("inflation/{name}"));
    group.throughput(Throughput::Elements(map.layout().len() as u64));
    for radius in [0.55, 2.0] {
        let params = InflationParams { inflation_radius: radius, ..Default::default() };
        let mut inflation = Inflation::new(params).expect("good parameters");
        let mut costmap = inflation.inflate(&map).expect("a map of ordinary size");
        group.bench_function(format!("{radius} m"), |b| {
            b.iter(|| inflation.inflate_into(black_box(&map), &mut costmap));
        });
    }
    group.finish();
}

fn collision(c: &mut Criterion) {
    let (name, map) = maps::depot_or_office();
    let layout = *map.layout();
    let poses: Vec<Se2> = (0..2000_u32)
        .map(|i| {
            let center = layout.center(layout.cell((i as usize * 7919 * 13) % layout.len()));
            Se2::new(center.x, center.y, f64::from(i) * 0.7)
        })
        .collect();
    let l_shape = [(-0.6, -0.4), (0.6, -0.4), (0.6, 0.4), (0.1, 0.4), (0.0, 0.1), (-0.6, 0.1)];
    let mut group = c.benchmark_group(format!("collision/{name}"));
    group.throughput(Throughput::Elements(poses.len() as u64));
    for (shape, footprint) in [
        ("circle", Footprint::circle(0.35)),
        ("rectangle", Footprint::rectangle(-0.6, 0.6, 0.8)),
        ("l_shape", Footprint::polygon(l_shape.map(|(x, y)| [x, y].into()).into())),
    ] {
        let footprint = footprint.expect("a good shape");
        let checker = CollisionChecker::new(&map, footprint, CollisionParams::default()).expect("a good map");
        let free: usize = poses.iter().filter(|p| checker.collides(p) == Ok(false)).count();
        assert!(free > 200 && free < 1990, "{free} poses are free");
        group.bench_function(format!("pose/{shape}"), |b| {
            b.iter(|| poses.iter().filter(|pose| checker.collides(pose) == Ok(true)).count());
        });
        let twist = Twist2::new(1.0, 0.0, 0.5);
        group.bench_function(format!("arc_of_1_m/{shape}"), |b| {
            b.iter(|| poses.iter().filter(|pose| checker.collides_along(pose, &twist, 1.0) == Ok(true)).count());
        });
    }
    group.finish();
}

criterion_group!(benches, inflation, collision);
criterion_main!(benches);
