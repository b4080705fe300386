//! The obstacle tracker in simulated worlds: what moves is found and its covariance is honest; what stands is never taken for
//! moving, however the vehicle drives.

use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2, Twist2},
    grid::{CellState, Grid, GridLayout},
    nalgebra::{Vector2, Vector4},
    sensors::{ConstantTwist, LaserScan, ScanGeometry, SensorId},
    time::Stamp,
};
use agv_filters::tracking::{ObstacleTracker, TrackedObstacle, TrackerParams};
use agv_sim::{KeyFrame, Laser, LaserParams, MovingDisc, MovingDiscs, Populated, Shape, World2d};
use rand::RngExt;
use rand_distr::StandardNormal;

/// The benchmark's scanner: 270°, 720 beams, 10 m, 1 cm, at 20 Hz; a sweep takes three quarters of the period if it takes time.
fn laser(sweeps: bool, seed: u64) -> Laser {
    let time_increment = if sweeps { 0.75 / (20.0 * 720.0) } else { 0.0 };
    let geometry = ScanGeometry {
        range_max: 10.0,
        time_increment,
        base_from_sensor: Se2::new(0.2, 0.0, 0.0),
        ..ScanGeometry::default()
    };
    let params = LaserParams { geometry, ..LaserParams::default() }.with_beams(720, 270_f64.to_radians());
    Laser::new(params, Seed(seed)).unwrap()
}

/// A room of 20 m by 14 m with poles of 0.15 m, as BARN's cylinders, kept off the band in which things move.
fn world(poles: usize, band: f64, seed: u64) -> World2d {
    let mut stream = Seed(seed).stream(0, 0);
    let mut shapes = Shape::room(Vector2::new(-10.0, -7.0), Vector2::new(10.0, 7.0)).to_vec();
    while shapes.len() < poles + 4 {
        let center = Vector2::new(stream.random_range(-9.5..9.5_f64), stream.random_range(-6.5..6.5_f64));
        if center.y.abs() > band {
            shapes.push(Shape::Circle { center, radius: 0.075 });
        }
    }
    World2d::new(shapes).unwrap()
}

/// Goes to and fro along a segment at a constant speed.
fn shuttle(from: (f64, f64), to: (f64, f64), speed: f64, radius: f64) -> MovingDisc {
    let (a, b) = (Vector2::new(from.0, from.1), Vector2::new(to.0, to.1));
    let time = (b - a).norm() / speed;
    let frame = |time, position| KeyFrame { time, position };
    MovingDisc::new(radius, 2.0 * time, vec![frame(0.0, a), frame(time, b), frame(2.0 * time, a)]).unwrap()
}

#[derive(Debug, Default)]
struct Tally {
    cycles: usize,
    /// Mover-cycles in which a mover stood in plain sight for a second, and in which it was told.
    due: usize,
    told: usize,
    /// Told obstacles that no mover explains.
    false_ones: usize,
    /// Told obstacles that were lost, and are expected where no mover is.
    coasting: usize,
    nees: Vec<f64>,
    position_errors: Vec<f64>,
    velocity_errors: Vec<f64>,
    ids: Vec<u64>,
}

/// Drives at a twist of time and compares what the tracker tells with the truth.
fn drive(
    world: &World2d,
    discs: &MovingDiscs,
    start: Se2,
    twist_at: impl Fn(f64) -> Twist2,
    sweeps: bool,
    seconds: f64,
    seed: u64,
) -> Tally {
    let mut laser = laser(sweeps, seed);
    let mut tracker = ObstacleTracker::new(TrackerParams::default()).unwrap();
    let (mut pose, mut tally, mut movers) = (start, Tally::default(), Vec::new());
    let mut in_sight = vec![0; discs.discs().len()];
    for step in 0..(seconds * 20.0) as usize {
        let time = 0.05 * step as f64;
        let (stamp, twist) = (Stamp::from_seconds(time), twist_at(time));
        discs.states_into(time, &mut movers);
        let scan = laser.scan(&Populated { world, obstacles: &movers }, &pose, &twist, stamp).unwrap();
        if sweeps {
            let motion = ConstantTwist::planar(stamp, &twist).unwrap();
            tracker.update_along(scan, &pose, &motion).unwrap();
        } else {
            tracker.update(scan, &pose).unwrap();
        }
        tally.cycles += 1;
        let hits: Vec<Vector2<f64>> = scan.points_in_base().map(|p| pose.act(&p)).collect();
        for (disc, sight) in movers.iter().zip(&mut in_sight) {
            let seen = hits.iter().filter(|p| ((*p - disc.position).norm() - disc.radius).abs() < 0.06).count() >= 8;
            *sight = if seen { *sight + 1 } else { 0 };
            // A second after a turn, too.
            let turned = (0..20).any(|back| {
                let mut then = Vec::new();
                discs.states_into(time - 0.05 * f64::from(back), &mut then);
                then.iter().all(|other| (other.velocity - disc.velocity).norm() > 1e-9)
            });
            // At the end of its range the scanner cannot tell what is free behind.
            if *sight < 20 || turned || (disc.position - pose.translation()).norm() > 8.5 {
                continue;
            }
            tally.due += 1;
            let near = |o: &Vector2<f64>| (o - disc.position).norm() < 0.6;
            if let Some(found) = tracker.tracks().find(|t| t.moving && near(&t.obstacle.position)) {
                tally.told += 1;
                let (dp, dv) = (found.obstacle.position - disc.position, found.obstacle.velocity - disc.velocity);
                let error = Vector4::new(dp.x, dp.y, dv.x, dv.y);
                tally.nees.push(error.dot(&(found.covariance.try_inverse().unwrap() * error)));
                tally.position_errors.push(dp.norm());
                tally.velocity_errors.push(dv.norm());
                tally.ids.push(found.obstacle.id.0);
            }
        }
        let explained = |p: &Vector2<f64>| movers.iter().any(|m| (m.position - p).norm() < m.radius + 0.5);
        for track in tracker.tracks().filter(|t| t.moving && !explained(&t.obstacle.position)) {
            if track.unseen_for > 0.0 {
                tally.coasting += 1;
            } else {
                tally.false_ones += 1;
            }
        }
        pose = pose * twist.integrate(0.05);
    }
    tally.ids.sort_unstable();
    tally.ids.dedup();
    tally
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// A loop of 2 m/s and up to 2 rad/s within the room.
fn wild(time: f64) -> Twist2 {
    Twist2::new(1.5 + 0.5 * (0.7 * time).sin(), 0.0, 1.6 + 0.4 * (1.3 * time).sin())
}

#[test]
fn movers_are_told_with_an_honest_covariance() {
    for (speed, seed) in [(0.5, 1), (1.0, 2), (2.0, 3)] {
        let discs = MovingDiscs::new(vec![
            shuttle((-4.0, 1.5), (8.0, 1.5), speed, 0.5),
            shuttle((5.0, -1.5), (5.0, 1.0), speed, 0.5),
        ]);
        let creep = |_: f64| Twist2::new(0.1, 0.0, 0.0);
        let tally = drive(&world(30, 2.3, seed), &discs, Se2::new(-6.0, 0.0, 0.0), creep, false, 40.0, seed);
        let (told, nees) = (tally.told as f64 / tally.due as f64, mean(&tally.nees));
        println!(
            "{speed} m/s: due {} told {told:.3} nees {nees:.2} position {:.4} velocity {:.4} false {} ids {}",
            tally.due,
            mean(&tally.position_errors),
            mean(&tally.velocity_errors),
            tally.false_ones,
            tally.ids.len()
        );
        assert!(tally.due > 100 && told > 0.95, "{tally:?}");
        // Four degrees of freedom; the filter allows for people, who wander more than these discs: it must not be too sure.
        assert!(nees < 4.6, "{nees}");
        assert!(mean(&tally.position_errors) < 0.05 && mean(&tally.velocity_errors) < 0.15);
        assert_eq!(tally.false_ones, 0);
    }
}

#[test]
fn a_vehicle_that_turns_fast_tells_the_same() {
    for sweeps in [false, true] {
        let discs = MovingDiscs::new(vec![
            shuttle((-8.0, 2.5), (8.0, 2.5), 1.0, 0.5),
            shuttle((-8.0, -3.0), (8.0, -3.0), 2.0, 0.5),
        ]);
        let tally = drive(&world(30, 3.6, 5), &discs, Se2::new(0.0, -1.0, 0.0), wild, sweeps, 60.0, 7);
        println!(
            "sweeps {sweeps}: due {} told {} nees {:.2} position {:.3} velocity {:.3} false {}",
            tally.due,
            tally.told,
            mean(&tally.nees),
            mean(&tally.position_errors),
            mean(&tally.velocity_errors),
            tally.false_ones
        );
        assert!(tally.due > 200 && tally.told as f64 > 0.85 * tally.due as f64);
        assert!(mean(&tally.position_errors) < 0.08 && mean(&tally.velocity_errors) < 0.25);
        assert_eq!(tally.false_ones, 0);
    }
}

#[test]
fn what_stands_is_not_moving() {
    let mut minutes = 0.0;
    let mut false_ones = 0;
    for seed in 0..4 {
        for sweeps in [false, true] {
            let world = world(180, 0.0, 100 + seed);
            let tally = drive(&world, &MovingDiscs::default(), Se2::new(0.0, -1.0, 0.0), wild, sweeps, 30.0, seed);
            (minutes, false_ones) = (minutes + 0.5, false_ones + tally.false_ones);
        }
    }
    println!("{false_ones} cycles with a false mover in {minutes} minutes");
    assert_eq!(false_ones, 0);
}

/// The visible ends of walls move with the shadows of those who pass.
#[test]
fn shadows_on_walls_are_not_moving() {
    // A wall in pieces with gaps, behind two who pass.
    let mut shapes = Shape::room(Vector2::new(-10.0, -7.0), Vector2::new(10.0, 7.0)).to_vec();
    for i in -4..4 {
        let x = 2.0 * f64::from(i);
        shapes.push(Shape::Segment { a: Vector2::new(x, 4.0), b: Vector2::new(x + 1.6, 4.0) });
    }
    let world = World2d::new(shapes).unwrap();
    let discs =
        MovingDiscs::new(vec![shuttle((-6.0, 2.0), (6.0, 2.0), 1.0, 0.5), shuttle((6.0, 3.0), (-6.0, 3.0), 0.7, 0.3)]);
    let tally = drive(&world, &discs, Se2::new(0.0, -2.0, 1.57), |_| Twist2::ZERO, false, 60.0, 3);
    println!("due {} told {} false {}", tally.due, tally.told, tally.false_ones);
    assert!(tally.told as f64 > 0.9 * tally.due as f64);
    assert_eq!(tally.false_ones, 0);
}

/// Movers that are as the filter believes: their velocity wanders.
#[test]
fn the_covariance_is_that_of_the_errors() {
    let room = World2d::new(Shape::room(Vector2::new(-10.0, -7.0), Vector2::new(10.0, 7.0)).to_vec()).unwrap();
    let params = TrackerParams { surface_sigma: 0.01, ..TrackerParams::default() };
    let (step, duration) = (0.005, 8.0);
    let mut nees = Vec::new();
    let mut seed = 0;
    while nees.len() < 1500 {
        seed += 1;
        let mut stream = Seed(seed).stream(1, 0);
        let (mut position, mut velocity, mut frames) = (Vector2::new(-3.0, 0.0), Vector2::new(0.8, 0.0), Vec::new());
        let mut time = 0.0;
        while time < duration {
            frames.push(KeyFrame { time, position });
            position += velocity * step;
            velocity += Vector2::from_fn(|_, _| params.wander * step.sqrt() * stream.sample::<f64, _>(StandardNormal));
            time += step;
        }
        if frames.iter().any(|frame| frame.position.x.abs() > 6.0 || (frame.position.y - 1.0).abs() > 4.0) {
            continue;
        }
        let disc = MovingDisc::new(0.4, duration, frames).unwrap();
        let (mut laser, mut tracker) = (laser(false, seed), ObstacleTracker::new(params).unwrap());
        let pose = Se2::new(0.0, -5.5, 1.57);
        for cycle in 0..(duration / 0.05) as u32 {
            let time = 0.05 * f64::from(cycle);
            let mover = disc.at(time).unwrap();
            let stamp = Stamp::from_seconds(time);
            let scan =
                laser.scan(&Populated { world: &room, obstacles: &[mover] }, &pose, &Twist2::ZERO, stamp).unwrap();
            tracker.update(scan, &pose).unwrap();
            let found = tracker.tracks().find(|t| t.moving && (t.obstacle.position - mover.position).norm() < 0.6);
            if let Some(found) = found.filter(|_| cycle > 40) {
                let (dp, dv) = (found.obstacle.position - mover.position, found.obstacle.velocity - mover.velocity);
                let error = Vector4::new(dp.x, dp.y, dv.x, dv.y);
                nees.push(error.dot(&(found.covariance.try_inverse().unwrap() * error)));
            }
        }
    }
    println!("NEES {:.2} of {} in {seed} runs", mean(&nees), nees.len());
    assert!((2.0..4.6).contains(&mean(&nees)), "{}", mean(&nees));
}

/// Two lasers that look fore and aft see one thing as one, and a map takes out what it explains.
#[test]
fn two_lasers_and_a_map_make_no_difference() {
    let room = world(0, 0.0, 1);
    let layout = GridLayout::new(410, 290, 0.05, Se2::new(-10.25, -7.25, 0.0)).unwrap();
    let mut map = Grid::filled(layout, CellState::Free);
    for index in 0..layout.len() {
        let center = layout.center(layout.cell(index));
        if center.x.abs() > 10.0 || center.y.abs() > 7.0 {
            map.set(layout.cell(index), CellState::Occupied);
        }
    }
    let disc = shuttle((-7.0, 1.5), (7.0, 1.5), 1.0, 0.4);
    let mount = |id, x, yaw| {
        let geometry =
            ScanGeometry { sensor: SensorId(id), base_from_sensor: Se2::new(x, 0.0, yaw), ..ScanGeometry::default() };
        Laser::new(LaserParams { geometry, ..LaserParams::default() }, Seed(4)).unwrap()
    };
    let mut lasers = [mount(0, 0.3, 0.0), mount(1, -0.3, 3.1)];
    let mut tracker = ObstacleTracker::new(TrackerParams::default()).unwrap().with_static_map(&map).unwrap();
    let pose = Se2::new(0.0, -2.0, 0.2);
    for cycle in 0..160 {
        let time = 0.05 * f64::from(cycle);
        let mover = disc.at(time).unwrap();
        for laser in &mut lasers {
            let scan = laser.scan(
                &Populated { world: &room, obstacles: &[mover] },
                &pose,
                &Twist2::ZERO,
                Stamp::from_seconds(time),
            );
            tracker.update(scan.unwrap(), &pose).unwrap();
        }
        assert!(tracker.tracks().count() <= 1, "{time}");
        if time > 1.0 {
            let [told] = tracker.obstacles() else { panic!("{time}: {:?}", tracker.obstacles()) };
            assert!((told.position - mover.position).norm() < 0.1, "{time}");
            let scan = tracker.scan();
            for (beam, (angle, _)) in scan.beams().enumerate().filter(|(beam, _)| tracker.is_moving_beam(*beam)) {
                let at = (pose * scan.geometry().base_from_sensor)
                    .act(&(Vector2::new(angle.cos(), angle.sin()) * f64::from(scan.ranges()[beam])));
                assert!((at - mover.position).norm() < 0.6, "{time} {beam}");
            }
        }
    }
}

fn one_scan(seconds: f64, ranges: Vec<f32>) -> LaserScan {
    LaserScan::new(Stamp::from_seconds(seconds), ScanGeometry::default(), ranges).unwrap()
}

#[test]
fn bad_input_is_named_and_changes_nothing() {
    let good = TrackerParams::default();
    for (name, bad) in [
        ("max_extent", TrackerParams { max_extent: 0.0, ..good }),
        ("surface_sigma", TrackerParams { surface_sigma: f64::NAN, ..good }),
        ("initial_speed_sigma", TrackerParams { initial_speed_sigma: -1.0, ..good }),
        ("coast_time", TrackerParams { coast_time: f64::INFINITY, ..good }),
        ("memory", TrackerParams { memory: 0.0, ..good }),
        ("map_tolerance", TrackerParams { map_tolerance: 0.0, ..good }),
        ("wander", TrackerParams { wander: -0.1, ..good }),
        ("min_speed", TrackerParams { min_speed: f64::NAN, ..good }),
        ("free_margin", TrackerParams { free_margin: -0.1, ..good }),
        ("gate_probability", TrackerParams { gate_probability: 1.0, ..good }),
        ("speed_confidence", TrackerParams { speed_confidence: 0.0, ..good }),
        ("confirm_hits", TrackerParams { confirm_hits: 0, ..good }),
    ] {
        let error = ObstacleTracker::new(bad).unwrap_err();
        assert!(error.to_string().starts_with(name), "{name}: {error}");
    }
    let mut tracker = ObstacleTracker::new(good).unwrap();
    let mut ranges = vec![5.0; 1081];
    ranges[500..540].fill(2.0);
    tracker.update(&one_scan(1.0, ranges.clone()), &Se2::default()).unwrap();
    let before: Vec<TrackedObstacle> = tracker.tracks().collect();
    assert_eq!(before.len(), 1);
    for bad in [f64::NAN, f64::INFINITY, 1e300] {
        assert!(tracker.update(&one_scan(1.05, ranges.clone()), &Se2::new(bad, 0.0, 0.0)).is_err());
    }
    assert!(tracker.update(&one_scan(0.5, ranges.clone()), &Se2::default()).is_err(), "too old");
    assert_eq!(tracker.tracks().collect::<Vec<_>>(), before);
    // Scans that say nothing, a burst of noise, and one far in the future.
    for (seconds, ranges) in
        [(1.05, vec![]), (1.1, vec![f32::NAN; 1081]), (1.15, vec![f32::INFINITY; 7]), (1.2, vec![0.03; 1081])]
    {
        tracker.update(&one_scan(seconds, ranges), &Se2::default()).unwrap();
        assert!(tracker.obstacles().is_empty());
    }
    tracker.update(&one_scan(1e9, ranges), &Se2::default()).unwrap();
    assert_eq!(tracker.tracks().count(), 1);
}

#[cfg(feature = "serde")]
#[test]
fn a_stored_tracker_goes_on_with_the_same_bits() {
    let (room, disc) = (world(20, 2.5, 2), shuttle((-7.0, 1.5), (7.0, 1.5), 1.0, 0.4));
    let (mut laser, pose) = (laser(true, 1), Se2::new(-1.0, -1.0, 0.6));
    let mut tracker = ObstacleTracker::new(TrackerParams::default()).unwrap();
    let mut see = |cycle: u32, trackers: &mut [&mut ObstacleTracker]| {
        let time = 0.05 * f64::from(cycle);
        let mover = disc.at(time).unwrap();
        let scan = laser
            .scan(&Populated { world: &room, obstacles: &[mover] }, &pose, &Twist2::ZERO, Stamp::from_seconds(time))
            .unwrap();
        for tracker in trackers {
            tracker.update(scan, &pose).unwrap();
        }
    };
    for cycle in 0..50 {
        see(cycle, &mut [&mut tracker]);
    }
    let mut loaded: ObstacleTracker = serde_json::from_str(&serde_json::to_string(&tracker).unwrap()).unwrap();
    assert_eq!(loaded.obstacles(), tracker.obstacles());
    for cycle in 50..70 {
        see(cycle, &mut [&mut tracker, &mut loaded]);
        assert_eq!(loaded.obstacles(), tracker.obstacles());
        assert!(loaded.tracks().eq(tracker.tracks()));
    }
    assert_eq!(tracker.obstacles().len(), 1);
}

#[cfg(feature = "serde")]
#[test]
fn a_stored_tracker_that_cannot_be_is_refused() {
    let mut ranges = vec![8.0; 1081];
    ranges[520..560].fill(2.0);
    let mut tracker = ObstacleTracker::new(TrackerParams::default()).unwrap();
    for seconds in [1.0, 1.05] {
        tracker.update(&one_scan(seconds, ranges.clone()), &Se2::default()).unwrap();
    }
    let stored = serde_json::to_value(&tracker).unwrap();
    let load = |pointer: &str, value: serde_json::Value| {
        let mut stored = stored.clone();
        *stored.pointer_mut(pointer).unwrap() = value;
        serde_json::from_value::<ObstacleTracker>(stored)
    };
    for (pointer, value) in [
        ("/next_id", 0.into()),
        ("/next_id", stored.pointer("/tracks/0/id").unwrap().clone()),
        ("/now", serde_json::Value::Null),
        ("/now", stored.pointer("/views/0/stamp").unwrap().as_i64().map(|stamp| stamp - 1).into()),
        ("/tracks/0/id", u64::MAX.into()),
        ("/tracks/0/radius/0", (-0.1).into()),
        ("/tracks/0/radius/1", 0.0.into()),
        ("/tracks/0/absent", (-1.0).into()),
        ("/tracks/0/score", u32::MAX.into()),
        ("/tracks/0/seen", i64::MAX.into()),
    ] {
        assert!(load(pointer, value.clone()).is_err(), "{pointer} {value}");
    }
    // The last identity there is: whatever comes is followed, without an overflow.
    let mut last = load("/next_id", u64::MAX.into()).unwrap();
    ranges[100..140].fill(2.0);
    ranges[900..940].fill(2.0);
    last.update(&one_scan(1.1, ranges), &Se2::default()).unwrap();
    assert!(last.tracks().count() >= 3);
}
