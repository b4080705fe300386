//! A side that was chosen is kept.

use super::{
    scenes::{disc, footprint, hall},
    worlds::barn_limits,
};
use agv_core::{
    compute::Seed,
    geometry::{Se2, Twist2},
    grid::{Costmap, LocalMap, LocalMapParams},
    nalgebra::Vector2,
    obstacle::MovingObstacle,
    path::Path,
    roles::{LocalPlanRequest, LocalPlanStatus, LocalPlanner, VehicleState},
};
use agv_plan::{
    local::moving::{Stretch, touches},
    teb::{Teb, TebParams},
};
use rand_distr::{Distribution, Normal};

/// A post right on the path, seen anew in each cycle with noise, by a vehicle that knows its place with noise: the band passes it on
/// one side, and changes sides at most once.
#[test]
fn a_symmetrical_obstacle_is_passed_on_one_side() {
    let clear = hall(9.0, 6.0);
    let path = Path::from_positions(&[Vector2::new(1.0, 3.0), Vector2::new(8.0, 3.0)]).unwrap();
    let limits = barn_limits();
    let noise = Normal::new(0.0, 0.01).unwrap();
    let mut costmap = clear.clone();
    let mut map = LocalMap::new(&clear, LocalMapParams::default()).unwrap();
    let mut left = 0;
    for seed in 0..100 {
        let mut stream = Seed(seed).stream(0, 0);
        let mut teb = Teb::new(TebParams::for_footprint(footprint())).unwrap();
        let mut state = VehicleState::new(Se2::new(1.0, 3.0, 0.0), Twist2::ZERO);
        let (mut side, mut changes, mut arrived) = (None, 0, false);
        for cycle in 0..300 {
            let mut draw = || noise.sample(&mut stream);
            // Seen from somewhat nearer in every cycle, in the middle up to the noise.
            if cycle % 4 == 0 {
                redraw(&mut costmap, &clear, Vector2::new(4.5 + draw(), 3.0 + draw()));
                map.update(&costmap).unwrap();
            }
            let at = state.map_from_base;
            let seen =
                VehicleState { map_from_base: Se2::new(at.x() + draw(), at.y() + draw(), at.yaw() + draw()), ..state };
            let request =
                LocalPlanRequest { state: seen, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.05 };
            let plan = teb.plan(request).unwrap();
            if let Some(band) = plan.band {
                let beside = (0..band.len()).filter_map(|i| band.pose(i)).find(|pose| pose.x() >= 4.5);
                if let (Some(beside), true) = (beside, at.x() < 4.4) {
                    let now = beside.y() > 3.0;
                    changes += i32::from(side.is_some_and(|side| side != now));
                    side = Some(now);
                }
            }
            let command = plan.command;
            state = state.after(&command.motion, 0.05);
            if command.status == LocalPlanStatus::Arrived && state.twist == Twist2::ZERO {
                arrived = true;
                break;
            }
        }
        assert!(arrived, "{seed}: {state:?}");
        left += i32::from(side == Some(true));
        assert!(changes <= 1, "{seed}: {changes} changes");
    }
    assert!((20..=80).contains(&left), "neither side is preferred: {left}");
}

fn redraw(costmap: &mut Costmap, clear: &Costmap, center: Vector2<f64>) {
    costmap.costs_mut().copy_from_slice(clear.costs());
    disc(costmap, center, 0.3);
}

/// Somebody crosses: the vehicle gives way or passes, and touches nobody.
#[test]
fn who_crosses_is_not_touched() {
    let map = LocalMap::new(&hall(9.0, 6.0), LocalMapParams::default()).unwrap();
    let path = Path::from_positions(&[Vector2::new(1.0, 3.0), Vector2::new(8.0, 3.0)]).unwrap();
    let limits = barn_limits();
    for case in 0..40 {
        let mut teb = Teb::new(TebParams::for_footprint(footprint())).unwrap();
        let mut state = VehicleState::new(Se2::new(1.0, 3.0, 0.0), Twist2::ZERO);
        let from = f64::from(case % 8);
        let speed = 0.4 + 0.2 * f64::from(case / 8);
        let velocity = if case % 2 == 0 { Vector2::new(0.0, speed) } else { Vector2::new(-0.5 * speed, -speed) };
        let start =
            if case % 2 == 0 { Vector2::new(4.5, 3.0 - from * 0.4) } else { Vector2::new(6.0, 3.0 + from * 0.4) };
        let mut arrived = false;
        for cycle in 0..400 {
            let time = 0.05 * f64::from(cycle);
            let mover = MovingObstacle::new(start + velocity * time, velocity, 0.3).unwrap();
            let request =
                LocalPlanRequest { state, path: &path, map: &map, obstacles: &[mover], limits: &limits, dt: 0.05 };
            let command = teb.command(request).unwrap();
            let stretch =
                Stretch { map_from_base: state.map_from_base, twist: command.motion.twist, begin: 0.0, duration: 0.05 };
            let hit = touches(&footprint(), &mover, &stretch) && command.motion.twist != Twist2::ZERO;
            assert!(!hit, "{case}: cycle {cycle} at {state:?}");
            state = state.after(&command.motion, 0.05);
            if command.status == LocalPlanStatus::Arrived && state.twist == Twist2::ZERO {
                arrived = true;
                break;
            }
        }
        assert!(arrived, "{case}: {state:?}");
    }
}

/// Somebody stands on the path, walks along it slowly or comes along it: passed in little more time than the way alone takes.
#[test]
fn who_is_slower_is_passed() {
    let map = LocalMap::new(&hall(9.0, 6.0), LocalMapParams::default()).unwrap();
    let path = Path::from_positions(&[Vector2::new(1.0, 3.0), Vector2::new(8.0, 3.0)]).unwrap();
    let limits = barn_limits();
    for (speed, aside) in [(0.0, 0.0), (0.0, 0.15), (0.3, -0.1), (-0.3, 0.0), (-0.6, 0.05)] {
        let mut teb = Teb::new(TebParams::for_footprint(footprint())).unwrap();
        let mut state = VehicleState::new(Se2::new(1.0, 3.0, 0.0), Twist2::ZERO);
        let mut arrived = None;
        for cycle in 0..300 {
            let time = 0.05 * f64::from(cycle);
            let velocity = Vector2::new(speed, 0.0);
            let mover = MovingObstacle::new(Vector2::new(4.0, 3.0 + aside) + velocity * time, velocity, 0.3).unwrap();
            let request =
                LocalPlanRequest { state, path: &path, map: &map, obstacles: &[mover], limits: &limits, dt: 0.05 };
            let command = teb.command(request).unwrap();
            state = state.after(&command.motion, 0.05);
            if command.status == LocalPlanStatus::Arrived && state.twist == Twist2::ZERO {
                arrived = Some(time);
                break;
            }
        }
        assert!(arrived.is_some_and(|time| time < 8.0), "{speed} {aside}: {arrived:?} {state:?}");
    }
}

/// A post in a small window that the path leads out of: the vehicle passes it as far as the window shows.
#[test]
fn a_path_out_of_the_map_has_ways_around() {
    let mut costmap = hall(4.5, 6.0);
    disc(&mut costmap, Vector2::new(2.5, 3.0), 0.3);
    let map = LocalMap::new(&costmap, LocalMapParams::default()).unwrap();
    let path = Path::from_positions(&[Vector2::new(1.0, 3.0), Vector2::new(12.0, 3.0)]).unwrap();
    let limits = barn_limits();
    let mut teb = Teb::new(TebParams::for_footprint(footprint())).unwrap();
    let mut state = VehicleState::new(Se2::new(1.0, 3.0, 0.0), Twist2::ZERO);
    for _ in 0..300 {
        let request = LocalPlanRequest { state, path: &path, map: &map, obstacles: &[], limits: &limits, dt: 0.05 };
        let command = teb.command(request).unwrap();
        state = state.after(&command.motion, 0.05);
        assert_ne!(command.status, LocalPlanStatus::InCollision, "{state:?}");
    }
    assert!(state.map_from_base.x() > 3.0, "{state:?}");
}
