//! What the vehicle sees around it.

use crate::counter;
use agv_nav::{
    core::{
        geometry::Se2,
        grid::{CellState, Footprint, Grid, GridLayout, RollingCostmap, RollingParams},
        sensors::{LaserScan, ScanGeometry},
        time::Stamp,
    },
    filters::tracking::{ObstacleTracker, TrackerParams},
};

/// A wall 8 m away, and somebody who crosses 4 m ahead.
fn scan(step: u32) -> LaserScan {
    let time = 0.05 * f64::from(step);
    let geometry = ScanGeometry::default();
    let range = |beam: usize| {
        let (sin, cos) = geometry.angle(beam).sin_cos();
        let (x, y) = (4.0, 0.8 * time - 1.5);
        let (along, across) = (x * cos + y * sin, y * cos - x * sin);
        if along > 0.0 && across.abs() < 0.3 { along - (0.09 - across * across).sqrt() } else { 8.0 }
    };
    let ranges = (0..1081).map(|beam| range(beam) as f32).collect();
    LaserScan::new(Stamp::from_seconds(time), geometry, ranges).unwrap()
}

#[test]
fn rolling_costmap() {
    let layout = GridLayout::new(300, 300, 0.05, Se2::new(-5.0, -7.0, 0.1)).unwrap();
    let map = Grid::filled(layout, CellState::Free);
    let rolling = RollingCostmap::new(RollingParams::default()).unwrap();
    let mut rolling = rolling.with_footprint(Footprint::circle(0.3).unwrap()).with_static_map(map).unwrap();
    let pose = |step: u32| Se2::new(0.04 * f64::from(step), 0.0, 0.05 * f64::from(step));
    for step in 0..10 {
        rolling.update([&scan(step)], &pose(step)).unwrap();
    }
    let scans: Vec<LaserScan> = (10..60).map(scan).collect();
    let count = counter::count(|| {
        for (step, scan) in (10..).zip(&scans) {
            assert!(rolling.update([scan], &pose(step)).unwrap().changed);
        }
    });
    assert_eq!(count, 0);
}

#[test]
fn obstacle_tracker() {
    let mut tracker = ObstacleTracker::new(TrackerParams::default()).unwrap();
    let scans: Vec<LaserScan> = (0..80).map(scan).collect();
    for scan in &scans[..40] {
        tracker.update(scan, &Se2::default()).unwrap();
    }
    let count = counter::count(|| {
        for scan in &scans[40..] {
            tracker.update(scan, &Se2::default()).unwrap();
        }
    });
    assert_eq!((count, tracker.obstacles().len()), (0, 1));
}
