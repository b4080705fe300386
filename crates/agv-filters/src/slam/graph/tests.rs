//! Drives around a block of a building, whose poses are known.

use super::{GraphSlam, GraphSlamParams, SlamStep, TrackingOutcome};
use agv_core::{
    check,
    compute::{Par, Seed},
    geometry::{LieGroup, Se2, Twist2},
    grid::{CellState, OccupancyThresholds},
    metrics::{AbsoluteError, PosePair, TrajectoryAlignment, absolute_error},
    sensors::{LaserScan, ScanGeometry},
    solve::RobustKernel,
    time::Stamp,
};
use agv_sim::{Laser, LaserParams, Shape, World2d};
use nalgebra::Vector2;
use std::f64::consts::{FRAC_PI_2, PI};

/// Round things that make no two places alike.
const POSTS: [(f64, f64); 8] =
    [(2.1, 10.6), (4.3, 0.3), (9.7, 0.4), (14.7, 3.0), (14.6, 7.9), (11.2, 10.7), (0.3, 7.1), (0.4, 3.9)];

fn radius(x: f64) -> f64 {
    0.3 + 0.02 * x
}

/// Corridors of 3 m around a block, with posts in them.
fn building() -> World2d {
    let mut shapes = Shape::room(Vector2::new(0.0, 0.0), Vector2::new(15.0, 11.0)).to_vec();
    shapes.push(Shape::rectangle(Se2::new(7.5, 5.5, 0.0), 9.0, 5.0));
    shapes.extend(POSTS.map(|(x, y)| Shape::Circle { center: Vector2::new(x, y), radius: radius(x) }));
    World2d::new(shapes).unwrap()
}

/// Distance from a place to the nearest surface of the building, inside of it.
fn distance(p: &Vector2<f64>) -> f64 {
    let outside = [p.x, 15.0 - p.x, p.y, 11.0 - p.y].into_iter().map(f64::abs).fold(f64::INFINITY, f64::min);
    let beyond = (p - Vector2::new(7.5, 5.5)).abs() - Vector2::new(4.5, 2.5);
    let block = if beyond.max() > 0.0 { beyond.sup(&Vector2::zeros()).norm() } else { -beyond.max() };
    let post = |(x, y): (f64, f64)| ((p - Vector2::new(x, y)).norm() - radius(x)).abs();
    POSTS.map(post).into_iter().fold(outside.min(block), f64::min)
}

/// One step of a drive.
struct Moment {
    truth: Se2,
    odometry: Se2,
    scan: LaserScan,
}

fn laser(field_of_view: f64, base_from_sensor: Se2, seed: u64) -> Laser {
    let params = LaserParams { range_sigma: 0.02, relative_sigma: 0.0, dropout: 0.0, ..LaserParams::default() };
    let mut params = params.with_beams(181, field_of_view);
    params.geometry.base_from_sensor = base_from_sensor;
    Laser::new(params, Seed(seed)).unwrap()
}

/// Counter-clockwise around the block, `metres` far, in steps of 0.15 m, with odometry that turns too little and is too long.
fn drive_with(laser: &mut Laser, metres: f64) -> Vec<Moment> {
    let world = building();
    let lengths = [9.0, FRAC_PI_2, 5.0, FRAC_PI_2];
    let (mut truth, mut odometry) = (Se2::new(3.0, 1.5, 0.0), Se2::new(40.0, -7.0, 2.0));
    let (mut part, mut left, mut done) = (0, lengths[0], 0.0);
    let mut moments = Vec::new();
    while done < metres {
        let scan = laser.scan(&world, &truth, &Twist2::ZERO, Stamp::from_seconds(0.1 * moments.len() as f64)).unwrap();
        moments.push(Moment { truth, odometry, scan: scan.clone() });
        let step = 0.15_f64.min(left);
        // Quarter turns have a radius of 1 m: their arc is as long as their angle.
        let motion = Se2::exp(&nalgebra::Vector3::new(step, 0.0, if part % 2 == 1 { step } else { 0.0 }));
        let measured = Se2::new(1.04 * motion.x(), motion.y(), 0.96 * motion.yaw() - 0.004 * step);
        (truth, odometry) = (truth * motion, odometry * measured);
        (left, done) = (left - step, done + step);
        if left < 1e-9 {
            part = (part + 1) % 4;
            left = lengths[part];
        }
    }
    moments
}

fn drive(metres: f64) -> Vec<Moment> {
    drive_with(&mut laser(PI, Se2::default(), 1), metres)
}

fn slam() -> GraphSlam {
    GraphSlam::new(GraphSlamParams::default()).unwrap()
}

/// The errors of the trajectory, once it lies as a whole where it fits best.
fn errors(slam: &GraphSlam, drive: &[Moment]) -> AbsoluteError<Se2> {
    assert_eq!(slam.trajectory().len(), drive.len());
    let pair =
        |((stamp, estimate), moment): ((Stamp, Se2), &Moment)| PosePair { stamp, reference: moment.truth, estimate };
    let pairs: Vec<_> = slam.trajectory().zip(drive).map(pair).collect();
    absolute_error(&pairs, TrajectoryAlignment::Rigid).unwrap()
}

/// The worst of them, in metres and radians.
fn worst(slam: &GraphSlam, drive: &[Moment]) -> (f64, f64) {
    let errors = errors(slam, drive);
    (errors.translation.max(), errors.rotation.max())
}

fn run(slam: &mut GraphSlam, drive: &[Moment]) -> Vec<SlamStep> {
    drive.iter().map(|moment| slam.process(&moment.scan, Some(&moment.odometry)).unwrap()).collect()
}

#[test]
fn a_loop_is_closed_and_the_map_is_the_building() {
    let drive = drive(42.0);
    let mut slam = slam();
    let steps = run(&mut slam, &drive);
    assert!(steps.iter().map(|step| step.closures).sum::<usize>() > 3);
    let (far, turned) = worst(&slam, &drive);
    assert!(far < 0.06 && turned < 0.02, "{far} {turned}");
    let odometry = drive[0].odometry.between(&drive[drive.len() - 1].odometry);
    let truth = drive[0].truth.between(&drive[drive.len() - 1].truth);
    assert!((odometry.translation() - truth.translation()).norm() > 1.0, "the drive proves nothing");
    // Every wall is where it is: cells of the map that are occupied lie on a surface.
    let map = slam.map().unwrap().states(&OccupancyThresholds::default());
    let world_from_map = errors(&slam, &drive).reference_from_estimate;
    let occupied = (0..map.layout().len()).filter(|&i| map.values()[i] == CellState::Occupied);
    let center = |i: usize| map.layout().center(map.layout().cell(i));
    let places: Vec<_> = occupied.map(|i| world_from_map.act(&center(i))).collect();
    let near = places.iter().filter(|place| distance(place) < 0.1).count();
    assert!(places.len() > 500 && near as f64 > 0.97 * places.len() as f64, "{near} of {}", places.len());
    assert!(slam.memory() > 100_000 && slam.memory() < 1_500_000, "{}", slam.memory());
    // The grids of a target of this building, 300 by 220 cells of 8 bytes; those of the closures beside it, a quarter each.
    let working = slam.working_memory();
    assert!(working > 528_000 && working < 3_000_000, "{working}");
}

#[test]
fn scans_alone_do_where_odometry_is_missing_or_jumps() {
    let drive = drive(12.0);
    let mut alone = slam();
    for moment in &drive {
        let step = alone.process(&moment.scan, None).unwrap();
        assert_ne!(step.outcome, TrackingOutcome::DeadReckoning);
    }
    let (far, turned) = worst(&alone, &drive);
    assert!(far < 0.08 && turned < 0.02, "{far} {turned}");

    // The frame of the odometry is reset, and is absent for a while.
    let mut jumping = slam();
    for (i, moment) in drive.iter().enumerate() {
        let odometry = if i < 20 { moment.odometry } else { Se2::new(-300.0, 7.0, 1.0) * moment.odometry };
        jumping.process(&moment.scan, (i % 30 < 20).then_some(&odometry)).unwrap();
    }
    let (far, turned) = worst(&jumping, &drive);
    assert!(far < 0.08 && turned < 0.02, "{far} {turned}");
}

#[test]
fn lasers_may_be_upside_down_beside_the_middle_and_see_little() {
    // The same readings, told by a scanner whose beams run clockwise.
    let right = drive(8.0);
    let turn = |scan: &LaserScan| {
        let seen = *scan.geometry();
        let last = seen.angle(scan.len() - 1);
        let geometry = ScanGeometry { angle_min: last, angle_increment: -seen.angle_increment, ..seen };
        LaserScan::new(scan.stamp(), geometry, scan.ranges().iter().rev().copied().collect()).unwrap()
    };
    let mut upside_down = slam();
    for moment in &right {
        upside_down.process(&turn(&moment.scan), Some(&moment.odometry)).unwrap();
    }
    assert!(worst(&upside_down, &right).0 < 0.06, "{:?}", worst(&upside_down, &right));

    for (field_of_view, mount) in [(1.6, Se2::new(0.4, 0.1, -0.3)), (1.4 * PI, Se2::new(-0.3, 0.2, 2.5))] {
        let drive = drive_with(&mut laser(field_of_view, mount, 3), 8.0);
        let mut slam = slam();
        run(&mut slam, &drive);
        let (far, turned) = worst(&slam, &drive);
        assert!(far < 0.08 && turned < 0.02, "{field_of_view}: {far} {turned}");
    }
}

#[test]
fn clocks_may_jump_and_threads_may_be_many() {
    let drive = drive(38.0);
    let mut first = slam();
    run(&mut first, &drive);
    let poses = |slam: &GraphSlam| slam.trajectory().map(|(_, pose)| pose).collect::<Vec<_>>();
    for threads in [2, 4] {
        let mut other = slam().with_parallelism(Par::threads(threads));
        for (i, moment) in drive.iter().enumerate() {
            let stamp = Stamp::from_seconds(1e9 - 7.3 * ((i * 37) % 11) as f64);
            let scan = LaserScan::new(stamp, *moment.scan.geometry(), moment.scan.ranges().to_vec()).unwrap();
            other.process(&scan, Some(&moment.odometry)).unwrap();
        }
        assert_eq!(poses(&first), poses(&other));
    }
}

#[test]
fn a_corridor_hides_the_way_along_it_and_odometry_tells_it() {
    let world = World2d::new(Shape::room(Vector2::new(-100.0, -1.2), Vector2::new(100.0, 1.2)).to_vec()).unwrap();
    let (mut laser, mut slam, mut matched) = (laser(PI, Se2::default(), 5), slam(), 0);
    for i in 0..60 {
        let truth = Se2::new(0.1 * f64::from(i), 0.0, 0.0);
        let scan = laser.scan(&world, &truth, &Twist2::ZERO, Stamp::default()).unwrap();
        let step = slam.process(scan, Some(&truth)).unwrap();
        assert!(i == 0 || step.alignment.unobserved[(0, 0)] > 0.99, "{}", step.alignment.unobserved);
        if step.outcome == TrackingOutcome::Matched {
            matched += 1;
            let seen = super::closures::seen_information(&step.alignment, slam.params()).unwrap();
            // The sum over the directions that are not observed.
            assert!((step.alignment.unobserved * seen).trace() < 1e-3, "{seen}");
            check::covariance("information", &seen).unwrap();
        }
    }
    assert!(matched > 0);
    // Nothing else tells the way along the corridor: the odometry counts for good.
    assert!(slam.graph().relations().iter().all(|relation| relation.kernel == RobustKernel::Square), "none may let go");
    let pose = slam.map_from_base();
    assert!((pose.x() - 5.9).abs() < 0.2 && pose.y().abs() < 0.02 && pose.yaw().abs() < 0.01, "{pose:?}");
}

/// The other side: among walls in all directions a match stands in for odometry that slips.
#[test]
fn odometry_may_be_let_go_where_the_match_sees_all() {
    let (mut slam, mut moments) = (slam(), drive(41.0));
    run(&mut slam, &moments);
    let kernels = slam.graph().relations().iter().map(|relation| relation.kernel);
    let may_slip = kernels.filter(|kernel| matches!(kernel, RobustKernel::GemanMcClure { .. })).count();
    assert!(slam.keys() > 5 && may_slip + 3 > slam.keys(), "{may_slip} of {}", slam.keys());

    // Wheels that spin for 0.4 m, some ten deviations of a key step, hardly move the graph: by 3 mm if odometry could not be let go.
    let (before, slipped) = (moments[40].odometry, moments[40].odometry * Se2::new(0.4, 0.0, 0.0));
    for moment in &mut moments[40..] {
        moment.odometry = slipped * before.between(&moment.odometry);
    }
    let mut spinning = self::slam();
    run(&mut spinning, &moments);
    assert_eq!(spinning.keys(), slam.keys());
    for (straight, spun) in slam.graph().poses().iter().zip(spinning.graph().poses()) {
        let off = straight.between(spun);
        assert!(off.translation().norm() < 0.0015 && off.yaw().abs() < 0.001, "{off:?}");
    }
}

#[test]
fn a_map_is_localised_in_and_gone_on_with() {
    let (first, second) = (drive(41.0), drive_with(&mut laser(PI, Se2::default(), 8), 16.0));
    let mut slam = slam();
    run(&mut slam, &first);
    let (keys, map_from_world) = (slam.keys(), slam.trajectory().next().unwrap().1 * first[0].truth.inverse());
    let error = |pose: &Se2, moment: &Moment| (map_from_world * moment.truth).between(pose).translation().norm();

    // Anywhere, then by a guess that is a metre off.
    slam.set_frozen(true).unwrap();
    assert!(slam.is_frozen());
    let found = slam.relocate(&second[40].scan, None).unwrap().unwrap();
    assert!(found.score > 0.8 && error(&slam.map_from_base(), &second[40]) < 0.1);
    let guess = map_from_world * second[0].truth * Se2::new(0.8, -0.6, 0.3);
    slam.relocate(&second[0].scan, Some(&guess)).unwrap().unwrap();
    for moment in &second[..60] {
        let step = slam.process(&moment.scan, Some(&moment.odometry)).unwrap();
        assert!(step.key.is_none() && error(&step.map_from_base, moment) < 0.08, "{:?}", step.outcome);
    }
    assert_eq!(slam.keys(), keys);

    // A second drive adds to the map.
    slam.set_frozen(false).unwrap();
    for moment in &second[60..] {
        let step = slam.process(&moment.scan, Some(&moment.odometry)).unwrap();
        assert!(error(&step.map_from_base, moment) < 0.1, "{step:?}");
    }
    assert!(slam.keys() > keys + 10);

    // A scan of another place is not found.
    let elsewhere = World2d::new(vec![Shape::Circle { center: Vector2::new(1.0, 0.5), radius: 3.0 }]).unwrap();
    let scan = laser(PI, Se2::default(), 9)
        .scan(&elsewhere, &Se2::default(), &Twist2::ZERO, Stamp::default())
        .unwrap()
        .clone();
    let before = slam.map_from_base();
    assert_eq!(slam.relocate(&scan, None).unwrap(), None);
    assert_eq!(slam.map_from_base(), before);
}

/// A drive that begins beside the key scans that are there is related to them by where it was found.
#[test]
fn a_drive_that_begins_elsewhere_is_tied_to_where_it_was_found() {
    let (first, mut laser, mut slam) = (drive(12.0), laser(PI, Se2::default(), 4), slam());
    run(&mut slam, &first);
    let (keys, map_from_world, world) = (slam.keys(), first[0].truth.inverse(), building());
    for i in 0..12 {
        let truth = Se2::new(5.5 + 0.1 * f64::from(i), 0.7, 0.0);
        let scan = laser.scan(&world, &truth, &Twist2::ZERO, Stamp::default()).unwrap();
        if i == 0 {
            slam.relocate(scan, Some(&(map_from_world * truth))).unwrap().unwrap();
        }
        slam.process(scan, Some(&truth)).unwrap();
    }
    assert!(slam.keys() > keys + 2);
    let poses = slam.graph().poses();
    for relation in slam.graph().relations() {
        let found = poses[relation.from.index()].between(&poses[relation.to.index()]);
        let off = relation.from_from_to.between(&found);
        assert!(off.translation().norm() < 0.2, "{relation:?} {off:?}");
    }
}

#[cfg(feature = "serde")]
#[test]
fn a_stored_state_continues_with_the_same_bits() {
    let drive = drive(41.0);
    let mut whole = slam();
    run(&mut whole, &drive);
    // Once between key scans, and once after the loop is closed.
    for at in [33, 265] {
        let mut killed = slam();
        run(&mut killed, &drive[..at]);
        let text = serde_json::to_string(&killed).unwrap();
        let mut resumed: GraphSlam = serde_json::from_str(&text).unwrap();
        run(&mut resumed, &drive[at..]);
        assert!(resumed.trajectory().eq(whole.trajectory()), "{at}");
        assert_eq!(resumed.map().unwrap(), whole.map().unwrap());
    }
    // And after a correction that no closure asked for.
    let mut killed = slam();
    run(&mut killed, &drive[..262]);
    killed.correct().unwrap();
    let mut resumed: GraphSlam = serde_json::from_str(&serde_json::to_string(&killed).unwrap()).unwrap();
    for slam in [&mut killed, &mut resumed] {
        run(slam, &drive[262..]);
    }
    assert!(resumed.trajectory().eq(killed.trajectory()));
    let mut value = serde_json::to_value(&whole).unwrap();
    for (pointer, bad) in [("/anchor", 100_000.into()), ("/way/3/key", 9999.into()), ("/path", serde_json::Value::Null)]
    {
        let good = std::mem::replace(value.pointer_mut(pointer).unwrap(), bad);
        assert!(serde_json::from_value::<GraphSlam>(value.clone()).is_err(), "{pointer}");
        *value.pointer_mut(pointer).unwrap() = good;
    }
}

/// Killed while closures wait for others that agree with them.
#[cfg(feature = "serde")]
#[test]
fn a_stored_state_remembers_the_closures_that_wait() {
    let drive = drive(44.0);
    // What is stored with the first two key scans after which closures wait, and how many are believed from then on.
    let stored_within = |limit: f64| {
        let agreement = agv_core::geometry::PoseSigma { translation: limit, rotation: 0.4 * limit };
        let closure = super::ClosureParams { agreement, ..super::ClosureParams::default() };
        let mut whole = GraphSlam::new(GraphSlamParams { closure, ..GraphSlamParams::default() }).unwrap();
        let (mut waiting, mut believed) = (Vec::new(), 0);
        for (i, moment) in drive.iter().enumerate() {
            let step = whole.process(&moment.scan, Some(&moment.odometry)).unwrap();
            believed += if waiting.is_empty() { 0 } else { step.closures };
            if !whole.pending.is_empty() && step.key.is_some() && waiting.len() < 2 {
                waiting.push((i + 1, serde_json::to_string(&whole).unwrap()));
            }
        }
        (waiting.len() == 2 && believed > 0).then_some((waiting, whole))
    };
    // Closures that are where the graph expects them do not wait: what counts as that is narrowed until some do.
    let limits = [0.03, 0.02, 0.015, 0.01, 0.007, 0.005];
    let (waiting, whole) = limits.into_iter().find_map(stored_within).expect("the drive must make closures wait");
    for (at, text) in waiting {
        let mut resumed: GraphSlam = serde_json::from_str(&text).unwrap();
        assert!(!resumed.pending.is_empty());
        run(&mut resumed, &drive[at..]);
        assert!(resumed.trajectory().eq(whole.trajectory()), "{at}");
        assert_eq!(serde_json::to_string(&resumed).unwrap(), serde_json::to_string(&whole).unwrap(), "{at}");
    }
}

#[test]
fn bad_input_is_named_or_skipped() {
    let good = GraphSlamParams::default();
    let closure = good.closure;
    for (name, bad) in [
        ("resolution", GraphSlamParams { resolution: 0.0, ..good }),
        ("max_range", GraphSlamParams { max_range: f64::NAN, ..good }),
        ("max_range (cells of the matcher)", GraphSlamParams { max_range: 205.0, ..good }),
        ("key_distance", GraphSlamParams { key_distance: -1.0, ..good }),
        ("key_angle", GraphSlamParams { key_angle: f64::INFINITY, ..good }),
        ("chain", GraphSlamParams { chain: 0, ..good }),
        ("good_fit", GraphSlamParams { good_fit: 1.5, ..good }),
        ("min_score", GraphSlamParams { closure: super::ClosureParams { min_score: 2.0, ..closure }, ..good }),
        ("confirmations", GraphSlamParams { closure: super::ClosureParams { confirmations: 0, ..closure }, ..good }),
        ("drift", GraphSlamParams { closure: super::ClosureParams { drift: f64::NAN, ..closure }, ..good }),
        ("jump", GraphSlamParams { odometry: super::OdometryTrust { jump: 0.0, ..good.odometry }, ..good }),
    ] {
        let error = GraphSlam::new(bad).unwrap_err();
        assert!(error.to_string().starts_with(name), "{name}: {error}");
    }

    // Scans that say nothing come first, in between, and at the end.
    let drive = drive(3.0);
    let blind = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![f32::NAN; 50]).unwrap();
    let empty = LaserScan::new(Stamp::default(), ScanGeometry::default(), vec![]).unwrap();
    let mut slam = slam();
    assert_eq!(slam.relocate(&blind, None).unwrap(), None);
    assert!(slam.correct().is_ok() && slam.map().is_ok());
    for moment in &drive {
        let before = (slam.map_from_base(), slam.trajectory().len());
        assert!(slam.process(&moment.scan, Some(&Se2::new(f64::NAN, 0.0, 0.0))).is_err());
        assert_eq!((slam.map_from_base(), slam.trajectory().len()), before);
        for scan in [&blind, &empty] {
            let step = slam.process(scan, Some(&moment.odometry)).unwrap();
            assert_eq!((step.outcome, step.key), (TrackingOutcome::TooFewReadings, None));
        }
        slam.process(&moment.scan, Some(&moment.odometry)).unwrap();
    }
    assert!(slam.relocate(&drive[0].scan, Some(&Se2::new(0.0, f64::INFINITY, 0.0))).is_err());
    let last = drive[0].truth.between(&drive[drive.len() - 1].truth);
    assert!((slam.map_from_base().translation() - last.translation()).norm() < 0.1);
}
