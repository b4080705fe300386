//! What every tracker must do, on paths as vehicles meet them.

use agv_control::track::{
    Lqr, LqrParams, Mpc, MpcParams, PidTracker, PidTrackerParams, PurePursuit, PurePursuitParams, Stanley,
    StanleyParams,
};
use agv_core::{
    compute::Seed,
    geometry::{Se2, Twist2},
    kinematics::{MotionLimits, TwistLimits},
    nalgebra::Vector2,
    path::{Gear, Path, PathPoint},
    roles::{PathTracker, TrackStatus, VehicleState, laws},
};
use rand_distr::{Distribution, Normal};
use std::f64::consts::FRAC_PI_2;

fn trackers() -> [(&'static str, Box<dyn PathTracker>); 5] {
    [
        ("pure pursuit", Box::new(PurePursuit::new(PurePursuitParams::default()).unwrap())),
        ("stanley", Box::new(Stanley::new(StanleyParams::default()).unwrap())),
        ("lqr", Box::new(Lqr::new(LqrParams::default()).unwrap())),
        ("mpc", Box::new(Mpc::new(MpcParams::default()).unwrap())),
        ("pid", Box::new(PidTracker::new(PidTrackerParams::default()).unwrap())),
    ]
}

fn path(points: &[(f64, f64)]) -> Path {
    Path::from_positions(&points.iter().map(|&(x, y)| Vector2::new(x, y)).collect::<Vec<_>>()).unwrap()
}

/// Lemniscate of Gerono, 3 m half-width.
fn eight() -> Path {
    let points: Vec<_> = (0..=600)
        .map(|i| {
            let t = f64::from(i) / 600.0 * std::f64::consts::TAU;
            (3.0 * t.sin(), 3.0 * t.sin() * t.cos())
        })
        .collect();
    path(&points)
}

/// A path that every vehicle can drive: an S of two quarter circles of 2 m radius between lines.
fn gentle() -> Path {
    let mut points: Vec<(f64, f64)> = vec![(-1.0, 0.0)];
    points.extend((0..=40).map(|i| f64::from(i) / 40.0 * FRAC_PI_2).map(|t| (2.0 * t.sin(), 2.0 - 2.0 * t.cos())));
    points
        .extend((1..=40).map(|i| f64::from(i) / 40.0 * FRAC_PI_2).map(|t| (4.0 - 2.0 * t.cos(), 2.0 + 2.0 * t.sin())));
    points.push((6.0, 4.0));
    path(&points)
}

#[test]
fn trackers_obey_the_laws_of_their_role() {
    let sharp = path(&[(0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (0.0, 3.0)]);
    let mut turned = path(&[(0.0, 0.0), (2.0, 0.0)]);
    turned.push_turn(FRAC_PI_2).unwrap();
    turned.push(PathPoint { pose: Se2::new(2.0, 1.5, FRAC_PI_2), gear: Gear::Forward }).unwrap();
    turned.push_turn(-2.0).unwrap();
    for (vehicle, limits) in laws::vehicles() {
        let steers = !limits.turns_on_the_spot();
        for path in [path(&[(0.0, 0.0), (5.0, 0.0)]), gentle(), eight(), sharp.clone(), turned.clone()] {
            // Corners and turns on the spot are beyond a vehicle that steers.
            if steers && (path == sharp || path == turned || path.len() > 600) {
                continue;
            }
            let (tolerance, heading_tolerance) = if steers { (0.05, 0.05) } else { (0.02, 0.02) };
            for (name, mut tracker) in trackers() {
                laws::path_tracker(tracker.as_mut(), &path, &limits, 0.05, tolerance, heading_tolerance)
                    .unwrap_or_else(|error| panic!("{name}, {vehicle}, {} points: {error}", path.len()));
            }
        }
    }
}

/// Numbers near the end of their range may be refused, but neither panic nor leave anything behind: the next drive is as ever.
#[test]
fn absurd_states_leave_no_trace() {
    let limits = MotionLimits::default();
    let absurd = [1e160, 1e300, f64::MAX].map(|x| {
        [(x, 0.0, 0.0), (0.0, x, 0.0), (0.0, 0.0, x), (-x, 0.0, -x)].map(|(vx, vy, w)| Twist2::new(vx, vy, w))
    });
    for (name, mut tracker) in trackers() {
        let path = gentle();
        for dt in [0.05, 1e300] {
            for twist in absurd.iter().flatten() {
                tracker.set_path(&path).unwrap();
                for place in [Se2::new(-1.0, 0.0, 0.0), Se2::new(1e150, 0.0, 1.0)] {
                    if let Ok(command) = tracker.command(&VehicleState::new(place, *twist), &limits, dt) {
                        assert!(command.motion.is_finite(), "{name}: {twist:?}");
                    }
                }
            }
        }
        tracker.set_path(&path).unwrap();
        let mut state = VehicleState::new(path.points()[0].pose, Twist2::ZERO);
        // Long enough that the drives have come to rest, by any lag.
        tracker.command(&state, &limits, 1e4).unwrap();
        let arrived = (0..2000).any(|_| {
            let command = tracker.command(&state, &limits, 0.02).unwrap();
            assert!(command.cross_track_error.abs() < 0.05, "{name}: {command:?}");
            state = state.after(&command.motion, 0.02);
            command.status == TrackStatus::Arrived
        });
        assert!(arrived, "{name}: {state:?}");
    }
}

#[test]
fn a_vehicle_that_cannot_turn_on_the_spot_says_so() {
    let mut path = path(&[(0.0, 0.0), (2.0, 0.0)]);
    path.push_turn(1.0).unwrap();
    let (_, limits) = laws::vehicles()[1];
    for (name, mut tracker) in trackers() {
        tracker.set_path(&path).unwrap();
        let mut state = VehicleState { steering: Some(0.0), ..VehicleState::default() };
        let mut status = TrackStatus::Tracking;
        for _ in 0..300 {
            let command = tracker.command(&state, &limits, 0.05).unwrap();
            assert!(limits.allows_step(&state.motion(), &command.motion, 0.05), "{name}");
            assert_ne!(command.status, TrackStatus::Arrived, "{name}");
            (state, status) = (state.after(&command.motion, 0.05), command.status);
        }
        assert_eq!((status, state.twist), (TrackStatus::OffPath, Twist2::ZERO), "{name}");
        assert!((state.map_from_base.x() - 2.0).abs() < 0.03, "{name}");
    }
}

#[test]
fn a_vehicle_that_faces_away_turns_first() {
    for (name, mut tracker) in trackers() {
        tracker.set_path(&path(&[(0.0, 0.0), (4.0, 0.0)])).unwrap();
        let mut state = VehicleState::new(Se2::new(0.0, 0.0, 3.0), Twist2::ZERO);
        let mut farthest: f64 = 0.0;
        let arrived = (0..2000).any(|_| {
            let command = tracker.command(&state, &MotionLimits::default(), 0.05).unwrap();
            state = state.after(&command.motion, 0.05);
            farthest = farthest.max(state.map_from_base.y().abs());
            command.status == TrackStatus::Arrived
        });
        assert!(arrived && farthest < 0.1, "{name}: {farthest} m off");
    }
}

#[test]
fn a_vehicle_beside_the_end_has_not_arrived() {
    for (name, mut tracker) in trackers() {
        for (x, y) in [(9.0, 0.0), (4.0, 0.5), (4.5, 0.0)] {
            tracker.set_path(&path(&[(0.0, 0.0), (3.0, 0.0), (4.0, 0.0)])).unwrap();
            let state = VehicleState::new(Se2::new(x, y, 0.0), Twist2::ZERO);
            // The progress is searched a little ahead only: as many calls as it takes to come to the end.
            let statuses: Vec<_> =
                (0..20).map(|_| tracker.command(&state, &MotionLimits::default(), 0.05).unwrap().status).collect();
            assert!(statuses.iter().all(|s| *s != TrackStatus::Arrived), "{name} at ({x}, {y}): {statuses:?}");
            assert_eq!(statuses.last(), Some(&TrackStatus::OffPath), "{name} at ({x}, {y})");
        }
    }
}

#[test]
fn a_cusp_is_driven_in_both_gears() {
    let mut path = Path::new();
    for (x, y, gear) in [(0.0, 0.0, Gear::Forward), (2.0, 0.0, Gear::Forward), (1.0, 0.0, Gear::Reverse)] {
        path.push(PathPoint { pose: Se2::new(x, y, 0.0), gear }).unwrap();
    }
    for (name, mut tracker) in trackers() {
        tracker.set_path(&path).unwrap();
        let mut state = VehicleState::default();
        let mut reversed = false;
        let arrived = (0..2000).any(|_| {
            let command = tracker.command(&state, &MotionLimits::default(), 0.05).unwrap();
            state = state.after(&command.motion, 0.05);
            reversed |= command.motion.twist.vx < -0.1;
            command.status == TrackStatus::Arrived
        });
        let end = state.map_from_base;
        assert!(arrived && reversed && (end.x() - 1.0).abs() < 0.03 && end.yaw().abs() < 0.1, "{name}: {end:?}");
    }
}

/// Actuator lag, pose noise and yaw slip as in the tracking experiments: no tracker may leave the path.
#[test]
fn trackers_hold_the_path_against_noise_and_lag() {
    let (dt, lag, slip) = (0.02, 0.15, 1.03);
    let limits = MotionLimits::from(TwistLimits { yaw_rate: 2.0, yaw_acceleration: 4.0, ..TwistLimits::default() });
    let (position_noise, yaw_noise) =
        (Normal::new(0.0, 0.01).unwrap(), Normal::new(0.0, 0.5_f64.to_radians()).unwrap());
    for seed in 0..5 {
        for (name, mut tracker) in trackers() {
            let path = eight();
            tracker.set_path(&path).unwrap();
            let mut noise = Seed(seed).stream(0, 0);
            let start = path.points()[0].pose;
            let (mut pose, mut twist, mut command) = (start, Twist2::ZERO, Twist2::ZERO);
            let (mut square, mut worst, mut cycles, mut arrived) = (0.0, 0.0_f64, 0.0, false);
            for _ in 0..10_000 {
                let measured = Se2::new(
                    pose.x() + position_noise.sample(&mut noise),
                    pose.y() + position_noise.sample(&mut noise),
                    pose.yaw() + yaw_noise.sample(&mut noise),
                );
                let reply = tracker.command(&VehicleState::new(measured, command), &limits, dt).unwrap();
                assert_ne!(reply.status, TrackStatus::OffPath, "{name} {reply:?} {pose:?} {seed}");
                command = reply.motion.twist;
                let blend = 1.0 - (-dt / lag).exp();
                twist.vx += (command.vx - twist.vx) * blend;
                twist.yaw_rate += (command.yaw_rate - twist.yaw_rate) * blend;
                pose = pose * Twist2::new(twist.vx, 0.0, twist.yaw_rate * slip).integrate(dt);
                // The true pose against the curve, not what the tracker says of the noisy one.
                let nearest = path.points().iter().map(|p| (p.pose.translation() - pose.translation()).norm());
                let error = nearest.fold(f64::INFINITY, f64::min);
                square += error * error;
                worst = worst.max(error);
                cycles += 1.0;
                arrived = reply.status == TrackStatus::Arrived;
                if arrived {
                    break;
                }
            }
            let rmse = f64::sqrt(square / cycles);
            assert!(arrived && rmse < 0.03 && worst < 0.1, "{name}: arrived {arrived}, rmse {rmse} m, worst {worst} m");
        }
    }
}
