//! Inserting scans, once the buffers have their size and the map does not grow.

use crate::{counter, scenes};
use agv_nav::core::{
    geometry::Se2,
    grid::{EvidenceGrid, GridLayout, InverseModelParams, OccupancyGrid, OccupancyParams},
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};

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
