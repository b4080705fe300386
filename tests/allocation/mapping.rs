//! Inserting scans, once the buffers have their size and the map does not grow.

use crate::{
    counter,
    scenes::{
        self,
        mapping::{graph_slam, map_by_graph, map_by_particles, particle_slam},
    },
};
use agv_nav::core::{
    compute::Par,
    geometry::Se2,
    grid::{EvidenceGrid, GridLayout, InverseModelParams, OccupancyGrid, OccupancyParams},
    odometry::OdometryIncrement,
    roles::{ScanMatcher, TargetScan},
    sensors::{LaserScan, ScanGeometry},
    time::Stamp,
};
use agv_nav::filters::matching::{
    ClimbingMatcher, ClimbingMatcherParams, CorrelativeMatcher, CorrelativeParams, FieldMatcher, FieldMatcherParams,
    PointToLineMatcher, PointToLineParams,
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
            let motion: &OdometryIncrement = motion;
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
    let mut climbing = ClimbingMatcher::new(ClimbingMatcherParams::default()).unwrap();
    let mut point_to_line = PointToLineMatcher::new(PointToLineParams::default()).unwrap();
    let matchers: [&mut dyn ScanMatcher; 4] = [&mut correlative, &mut field, &mut climbing, &mut point_to_line];
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

/// Scans that become no key scans, of a vehicle that creeps; the way that is remembered has its room.
#[test]
fn graph_slam_between_key_scans() {
    let drive = scenes::circle(12);
    for (with_wheels, frozen) in [(true, false), (false, false), (true, true)] {
        let mut slam = graph_slam(Par::Seq);
        map_by_graph(&mut slam, &drive, 0);
        slam.set_frozen(frozen).unwrap();
        let (keys, scan) = (slam.keys(), &drive[11].1);
        let mut run = |steps: std::ops::Range<i32>| {
            for step in steps {
                let odometry = Se2::new(1e-4 * f64::from(step), 0.0, 1e-4 * f64::from(step % 3));
                slam.process(scan, with_wheels.then_some(&odometry)).unwrap();
            }
        };
        run(0..30);
        assert_eq!(counter::count(|| run(30..50)), 0);
        assert!(slam.keys() <= keys + 1, "the vehicle must not get anywhere");
    }
}

/// Scans that are not taken in, by wheels and without.
#[test]
fn particles_with_maps_between_scans_that_are_taken_in() {
    let drive = scenes::circle(12);
    for with_wheels in [true, false] {
        let mut slam = particle_slam(Par::Seq);
        map_by_particles(&mut slam, &drive, with_wheels);
        let standing =
            vec![(OdometryIncrement { start_from_end: Se2::default(), ..drive[0].0 }, drive[11].1.clone()); 22];
        let mut run = |count: usize| {
            for (motion, scan) in &standing[..count] {
                if with_wheels {
                    slam.predict(motion).unwrap();
                }
                assert!(slam.update(scan).unwrap().skipped.is_some());
            }
        };
        run(22);
        assert_eq!(counter::count(|| run(20)), 0);
    }
}
