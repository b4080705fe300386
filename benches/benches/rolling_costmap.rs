//! What a local planner's map costs per scan: 720 beams of 10 m in a room with pillars, cells of 0.05 m, the vehicle moving.
//!
//! `update` marks, clears, moves the window and inflates; `without_inflation` leaves the costs out, as local planners that ask
//! a `LocalMap` for distances may; `local_map` is that map's update beside it. Throughput is in cells of the window.

use agv_core::{
    geometry::Se2,
    grid::{CellState, Footprint, LocalMap, LocalMapParams, RollingCostmap, RollingParams},
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

/// Distance from `(x, y)` along `angle` to a round pillar of 0.15 m on every second metre, if one is within 10 m.
fn distance(x: f64, y: f64, angle: f64) -> f64 {
    let (s, c) = angle.sin_cos();
    let mut nearest = f64::INFINITY;
    for row in -8..9 {
        for column in -8..9 {
            let (dx, dy) = (2.0 * f64::from(column) + 1.0 - x, 2.0 * f64::from(row) + 1.0 - y);
            let (along, across) = (dx * c + dy * s, dy * c - dx * s);
            if along > 0.0 && across.abs() < 0.15 {
                nearest = nearest.min(along - (0.0225 - across * across).sqrt());
            }
        }
    }
    nearest
}

/// Scans at 20 Hz of a vehicle of 1 m/s, whose window moves by a cell with each.
fn drive() -> Vec<(LaserScan, Se2)> {
    let geometry = ScanGeometry {
        angle_increment: 270_f64.to_radians() / 719.0,
        range_max: 10.0,
        base_from_sensor: Se2::new(0.2, 0.0, 0.0),
        ..Default::default()
    };
    let scan_at = |i: u32| {
        let pose = Se2::new(-0.5 + 0.05 * f64::from(i), 0.01 * f64::from(i), 0.02 * f64::from(i));
        let sensor = pose * geometry.base_from_sensor;
        let range = |beam| distance(sensor.x(), sensor.y(), sensor.yaw() + geometry.angle(beam)) as f32;
        let ranges = (0..720).map(range).collect();
        (LaserScan::new(Stamp::from_seconds(0.05 * f64::from(i)), geometry, ranges).expect("a valid scan"), pose)
    };
    (0..20).map(scan_at).collect()
}

fn rolling_costmap(criterion: &mut Criterion) {
    let drive = drive();
    let footprint = Footprint::rectangle(-0.254, 0.254, 0.43).expect("a rectangle");
    let mut group = criterion.benchmark_group("rolling_costmap");
    for side in [200, 300, 400] {
        group.throughput(Throughput::Elements((side * side) as u64));
        let full = RollingParams { width: side, height: side, ..RollingParams::for_footprint(&footprint) };
        for (name, params) in [("update", full), ("without_inflation", RollingParams { inflation: None, ..full })] {
            let mut rolling = RollingCostmap::new(params).expect("good parameters").with_footprint(footprint.clone());
            for (scan, pose) in &drive {
                rolling.update([scan], pose).expect("a valid pose");
            }
            let (scan, pose) = &drive[19];
            let ends = scan.points_in_base().filter_map(|p| rolling.layout().cell_at(&(*pose * p)));
            let marked = ends.map(|cell| rolling.states().get(cell) == Some(&CellState::Occupied));
            assert!(marked.fold((0, true), |(n, all), one| (n + 1, all && one)).1, "every hit is marked");
            let mut turn = (0..drive.len()).cycle();
            group.bench_function(format!("{name}/{side}x{side}"), |b| {
                b.iter(|| {
                    let (scan, pose) = &drive[turn.next().unwrap_or(0)];
                    rolling.update([black_box(scan)], pose).expect("a valid pose")
                });
            });
            if name == "update" {
                continue;
            }
            // Two costmaps in turn, so that each update brings something new.
            let earlier = rolling.costmap().clone();
            rolling.update([&drive[3].0], &drive[3].1).expect("a valid pose");
            let mut local = LocalMap::new(&earlier, LocalMapParams::default()).expect("good parameters");
            let mut later = false;
            group.bench_function(format!("local_map/{side}x{side}"), |b| {
                b.iter(|| {
                    later = !later;
                    local.update(black_box(if later { rolling.costmap() } else { &earlier }))
                });
            });
        }
    }
    group.finish();
}

criterion_group!(benches, rolling_costmap);
criterion_main!(benches);
