//! Inserting scans, once the buffers have their size and the map does not grow.

use crate::{counter, scenes};
use agv_nav::core::{
    geometry::Se2,
    grid::{EvidenceGrid, GridLayout, InverseModelParams, OccupancyGrid, OccupancyParams},
    roles::{ScanMatcher, TargetScan},
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use agv_nav::filters::matching::{CorrelativeMatcher, CorrelativeParams, FieldMatcher, FieldMatcherParams};

#[test]
fn insertion() {
    let layout = GridLayout::new(400, 400, 0.05, Se2::new(-10.0, -10.0, 0.0)).unwrap();
    let mut map = EvidenceGrid::new(layout, InverseModelParams::default()).unwrap();
    let live_params = OccupancyParams { half_life: Some(10.0), ..Default::default() };
    let mut live = OccupancyGrid::new(layout, live_params).unwrap();
    let scan = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![7.3; 1081]).unwrap();
    let mut run = |i: i32| {
        let pose = Se2::new(0.01 * f64::from(i), 0.02 * f64::from(i), 0.1 * f64::from(i));
        assert!(!map.insert_scan(&scan, &pose).unwrap().grown);
        live.insert_scan(&scan, &pose).unwrap();
        live.forget(0.1).unwrap();
    };
    run(0);
    assert_eq!(counter::count(|| (1..20).for_each(run)), 0);
}

#[test]
fn insertion_of_scans_as_they_come() {
    let drive = scenes::circle(10);
    let layout = GridLayout::new(400, 400, 0.05, Se2::new(-6.0, -8.0, 0.1)).unwrap();
    let mut map = EvidenceGrid::new(layout, InverseModelParams::default()).unwrap();
    let mut pose = scenes::start();
    let mut run = |steps: &[_]| {
        for (motion, scan) in steps {
            let motion: &agv_nav::core::odometry::OdometryIncrement = motion;
            pose = pose * motion.start_from_end;
            assert!(!map.insert_scan(scan, &pose).unwrap().grown);
        }
    };
    run(&drive[..1]);
    assert_eq!(counter::count(|| run(&drive[1..])), 0);
}

#[test]
fn scan_matchers() {
    let drive = scenes::circle(12);
    let target = [TargetScan { target_from_base: Se2::default(), scan: &drive[0].1 }];
    let mut correlative = CorrelativeMatcher::new(CorrelativeParams::default()).unwrap();
    let mut field = FieldMatcher::new(FieldMatcherParams::default()).unwrap();
    let matchers: [&mut dyn ScanMatcher; 2] = [&mut correlative, &mut field];
    for matcher in matchers {
        matcher.set_target(&target).unwrap();
        let mut run = || {
            for (_, scan) in &drive {
                matcher.match_scan(scan, &Se2::new(0.1, 0.0, 0.1)).unwrap();
            }
        };
        // The search takes memory for the turns that the farthest end point asks for.
        run();
        assert_eq!(counter::count(run), 0);
    }
}
