//! Scan insertion: 1081 beams of a hall with pillars into cells of 0.05 m.
//!
//! Throughput is in nominal cells: the sum of range / resolution over all beams, whatever is really visited. The rival
//! in the same run is a plain exact traversal (Amanatides-Woo in floating point) with the same sensor model.

use agv_core::{
    geometry::Se2,
    grid::{Cell, EvidenceGrid, GridLayout, InverseModelParams, OccupancyGrid, OccupancyParams},
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

const RESOLUTION: f64 = 0.05;

/// Distance from `(x, y)` along `angle` to the walls of a hall of 24.04 m by 16.06 m centred at the origin, or to one of its
/// six pillars of 0.4 m radius.
fn distance(x: f64, y: f64, angle: f64) -> f64 {
    let (s, c) = angle.sin_cos();
    let wall = |position: f64, direction: f64, half: f64| (half * direction.signum() - position) / direction;
    let mut nearest = wall(x, c, 12.02).min(wall(y, s, 8.03));
    for (px, py) in [(-6.0, -4.0), (0.0, -4.0), (6.0, -4.0), (-6.0, 4.0), (0.0, 4.0), (6.0, 4.0)] {
        let (dx, dy) = (px - x, py - y);
        let (along, across) = (dx * c + dy * s, dy * c - dx * s);
        if along > 0.0 && across.abs() < 0.4 {
            nearest = nearest.min(along - (0.16 - across * across).sqrt());
        }
    }
    nearest
}

/// Ten scans along an aisle of the hall.
fn scans() -> Vec<(LaserScan, Se2)> {
    let geometry = ScanGeometry::default();
    let scan_at = |i: u32| {
        let (x, y, yaw) = (-3.113 + 0.4 * f64::from(i), -1.217 + 0.13 * f64::from(i), 0.07 * f64::from(i));
        let ranges = (0..1081).map(|beam| distance(x, y, yaw + geometry.angle(beam)) as f32).collect();
        (LaserScan::new(Stamp::default(), geometry, ranges).expect("a valid scan"), Se2::new(x, y, yaw))
    };
    (0..10).map(scan_at).collect()
}

fn nominal_cells(scans: &[(LaserScan, Se2)]) -> u64 {
    scans.iter().flat_map(|(scan, _)| scan.ranges()).map(|&r| f64::from(r) / RESOLUTION).sum::<f64>() as u64
}

fn layout() -> GridLayout {
    GridLayout::new(640, 480, RESOLUTION, Se2::new(-16.0, -12.0, 0.0)).expect("a valid layout")
}

/// Plain traversal in floating point, cell by cell.
fn insert_naively(values: &mut [i32], layout: &GridLayout, scan: &LaserScan, pose: &Se2) {
    let (width, height) = (layout.width() as i32, layout.height() as i32);
    let origin = layout.to_grid(&pose.translation());
    for (beam, &range) in scan.ranges().iter().enumerate() {
        let (s, c) = (pose.yaw() + scan.geometry().angle(beam)).sin_cos();
        let length = f64::from(range) / RESOLUTION;
        let (end_x, end_y) = ((origin.x + length * c).floor() as i32, (origin.y + length * s).floor() as i32);
        let mut cell = Cell::new(origin.x.floor() as i32, origin.y.floor() as i32);
        let (step_x, step_y) = (if c > 0.0 { 1 } else { -1 }, if s > 0.0 { 1 } else { -1 });
        let (gap_x, gap_y) = ((1.0 / c).abs(), (1.0 / s).abs());
        let first = |position: f64, direction: f64| {
            let fraction = position - position.floor();
            if direction > 0.0 { 1.0 - fraction } else { fraction }
        };
        let (mut next_x, mut next_y) = (first(origin.x, c) * gap_x, first(origin.y, s) * gap_y);
        let steps = (end_x - cell.x).abs() + (end_y - cell.y).abs();
        for _ in 0..steps {
            if (cell.x as u32) < width as u32 && (cell.y as u32) < height as u32 {
                values[(cell.y * width + cell.x) as usize] -= 104;
            }
            if next_x < next_y {
                cell.x += step_x;
                next_x += gap_x;
            } else {
                cell.y += step_y;
                next_y += gap_y;
            }
        }
        if (end_x as u32) < width as u32 && (end_y as u32) < height as u32 {
            values[(end_y * width + end_x) as usize] += 217;
        }
    }
}

fn insert_scan(criterion: &mut Criterion) {
    let scans = scans();
    // The evidence that the naive loop adds.
    let model = InverseModelParams { p_hit: 0.7, p_miss: 0.4, protect_hits: false, ..Default::default() };
    let mut group = criterion.benchmark_group("insert_scan");
    group.throughput(Throughput::Elements(nominal_cells(&scans) / scans.len() as u64));

    // The naive sum and ours agree, but for corners that floating point takes on the wrong side.
    let mut evidence = EvidenceGrid::new(layout(), model).expect("valid parameters");
    let mut naive = vec![0; layout().len()];
    for (scan, pose) in &scans {
        evidence.insert_scan(scan, pose).expect("a scan inside the grid");
        insert_naively(&mut naive, &layout(), scan, pose);
    }
    let different = evidence.evidence().iter().zip(&naive).filter(|(a, b)| a != b).count();
    assert!(different < 200, "{different} cells differ");

    let mut turn = (0..scans.len()).cycle();
    let mut next = || &scans[turn.next().unwrap_or(0)];
    group.bench_function("naive", |b| {
        b.iter(|| {
            let (scan, pose) = next();
            insert_naively(black_box(&mut naive), &layout(), scan, pose);
        });
    });
    let protecting = EvidenceGrid::new(layout(), InverseModelParams::default()).expect("valid parameters");
    for (name, empty) in
        [("evidence", EvidenceGrid::new(layout(), model).expect("valid")), ("evidence_protecting_hits", protecting)]
    {
        let mut grid = empty.clone();
        let mut inserted = 0;
        group.bench_function(name, |b| {
            b.iter(|| {
                let (scan, pose) = next();
                inserted += 1;
                // The sensor's own cells would reach the end of the evidence after some 19,000 scans.
                if inserted % 10_000 == 0 {
                    grid = empty.clone();
                }
                grid.insert_scan(black_box(scan), pose).expect("a scan inside the grid")
            });
        });
    }
    let mut live = OccupancyGrid::new(layout(), OccupancyParams::default()).expect("valid parameters");
    group.bench_function("occupancy", |b| {
        b.iter(|| {
            let (scan, pose) = next();
            live.insert_scan(black_box(scan), pose).expect("a valid pose")
        });
    });
    group.finish();
}

criterion_group!(benches, insert_scan);
criterion_main!(benches);
