//! How trackers come back to a path and stop at its end, against the linearised laws.

use agv_control::track::{
    Facing, FollowerParams, Lqr, LqrParams, PidTracker, PidTrackerParams, PurePursuit, PurePursuitParams, Stanley,
    StanleyParams,
};
use agv_core::{
    geometry::{Se2, Twist2, wrap_angle},
    kinematics::{MotionLimits, TwistLimits},
    nalgebra::Vector2,
    path::{Gear, Path, PathPoint},
    roles::{PathTracker, TrackStatus, VehicleState},
};

/// A vehicle that does as it is told, but for the lag of its drives.
fn follower(response_time: f64) -> FollowerParams {
    FollowerParams { response_time, max_yaw_slip: 0.0, lateral_acceleration: 10.0, ..FollowerParams::default() }
}

fn agile() -> MotionLimits {
    MotionLimits::from(TwistLimits {
        reverse_speed: 1.0,
        yaw_rate: 10.0,
        yaw_acceleration: 100.0,
        ..TwistLimits::default()
    })
}

fn trackers(follower: FollowerParams) -> [(&'static str, Box<dyn PathTracker>); 3] {
    let pure_pursuit = PurePursuitParams { look_ahead_min: 0.7, look_ahead_max: 0.7, follower, ..Default::default() };
    let stanley = StanleyParams { softening: 0.0, gain: 1.5, follower, ..Default::default() };
    let pid = PidTrackerParams { proportional: 0.8, integral: 0.0, heading_gain: 3.2, follower, ..Default::default() };
    [
        ("pure pursuit", Box::new(PurePursuit::new(pure_pursuit).unwrap())),
        ("stanley", Box::new(Stanley::new(stanley).unwrap())),
        ("pid", Box::new(PidTracker::new(pid).unwrap())),
    ]
}

fn line(gear: Gear) -> Path {
    let mut path = Path::new();
    for x in [0.0, 20.0] {
        let yaw = if gear == Gear::Forward { 0.0 } else { std::f64::consts::PI };
        path.push(PathPoint { pose: Se2::new(x, 0.0, yaw), gear }).unwrap();
    }
    path
}

/// Share of an initial offset that is left after `t` seconds at 1 m/s, by the linearised law. Of Stanley the front axle's.
fn theory(name: &str, t: f64) -> f64 {
    match name {
        // Poles at (-1 ± i) v / look-ahead.
        "pure pursuit" => (-t / 0.7).exp() * ((t / 0.7).cos() + (t / 0.7).sin()),
        "stanley" => (-1.5 * t).exp(),
        // A double pole at half the heading gain.
        _ => (-1.6 * t).exp() * (1.0 + 1.6 * t),
    }
}

/// With a lag the *predicted* offset is what the theory says, and the offset follows it by the lag.
#[test]
fn offsets_die_away_as_the_linearised_law_says() {
    let (dt, offset) = (0.002, 0.02);
    for lag in [0.0, 0.15] {
        for gear in [Gear::Forward, Gear::Reverse] {
            for (name, mut tracker) in trackers(follower(lag)) {
                tracker.set_path(&line(gear)).unwrap();
                let start = line(gear).points()[0].pose;
                let ahead = if gear == Gear::Forward { 1.0 } else { -1.0 };
                let mut pose = Se2::new(1.0, offset, start.yaw());
                let (mut told, mut twist) = (Twist2::new(ahead, 0.0, 0.0), Twist2::new(ahead, 0.0, 0.0));
                for cycle in 0..2000 {
                    let front = if name == "stanley" { 0.3 } else { 0.0 };
                    let sin = (pose.yaw() - start.yaw()).sin();
                    // The lag moves the point that converges ahead of the vehicle.
                    let predicted_sin = sin + lag * twist.yaw_rate;
                    let error = pose.y() + lag * sin + front * predicted_sin;
                    let expected = offset * theory(name, f64::from(cycle) * dt);
                    assert!(
                        (error - expected).abs() < 0.03 * offset,
                        "{name}, lag {lag}, {gear:?}, {cycle}: {error} {expected}"
                    );
                    let command = tracker.command(&VehicleState::new(pose, told), &agile(), dt).unwrap();
                    told = command.motion.twist;
                    let left = if lag > 0.0 { (-dt / lag).exp() } else { 0.0 };
                    twist = Twist2::new(told.vx, 0.0, told.yaw_rate + left * (twist.yaw_rate - told.yaw_rate));
                    pose = pose * twist.integrate(dt);
                }
            }
        }
    }
}

/// Nav2's users report oscillation at the goal (navigation2 #3081): the vehicle here comes straight in and slows down all the way.
#[test]
fn the_goal_is_approached_evenly() {
    let (dt, limits) = (0.02, MotionLimits::default());
    for lag in [0.0, 0.15] {
        for (name, mut tracker) in trackers(FollowerParams { response_time: lag, ..FollowerParams::default() }) {
            let path = Path::from_positions(&[Vector2::zeros(), Vector2::new(3.0, 0.0)]).unwrap();
            tracker.set_path(&path).unwrap();
            let (mut pose, mut told, mut twist) = (Se2::new(0.0, 0.05, 0.1), Twist2::ZERO, Twist2::ZERO);
            let (mut remaining, mut arrived, mut slowing) = (f64::INFINITY, false, false);
            for _ in 0..1000 {
                let command = tracker.command(&VehicleState::new(pose, told), &limits, dt).unwrap();
                assert!(command.remaining <= remaining + 1e-12, "{name}: away from the goal");
                let next = command.motion.twist;
                slowing |= next.vx < told.vx;
                assert!(!slowing || next.vx <= told.vx + 1e-12, "{name}: faster again");
                assert!(next.vx >= 0.0 && (pose.x() < 2.5 || next.yaw_rate.abs() < 0.1), "{name}: {next:?}");
                (remaining, told) = (command.remaining, next);
                let left = if lag > 0.0 { (-dt / lag).exp() } else { 0.0 };
                let lagged = |told: f64, before: f64| told + left * (before - told);
                twist = Twist2::new(lagged(told.vx, twist.vx), 0.0, lagged(told.yaw_rate, twist.yaw_rate));
                pose = pose * twist.integrate(dt);
                arrived = command.status == TrackStatus::Arrived;
                if arrived {
                    break;
                }
            }
            assert!(arrived && (pose.x() - 3.0).abs() < 0.02 && pose.y().abs() < 0.01, "{name}, {lag}: {pose:?}");
        }
    }
}

/// A crate that moves sideways keeps its nose where the path says, and its way on the path.
#[test]
fn an_omnidirectional_vehicle_faces_as_the_path_says() {
    let limits = MotionLimits::from(TwistLimits { lateral_speed: 0.5, ..TwistLimits::default() });
    let mut path = Path::new();
    for (x, y, yaw) in [(0.0, 0.0, 0.3), (2.0, 0.0, 0.3), (2.0, 2.0, 0.3), (2.0, 4.0, 1.3)] {
        path.push(PathPoint { pose: Se2::new(x, y, yaw), gear: Gear::Forward }).unwrap();
    }
    let follower = FollowerParams { facing: Facing::Path, response_time: 0.0, ..FollowerParams::default() };
    let lqr = Lqr::new(LqrParams { follower, ..LqrParams::default() }).unwrap();
    let all = trackers(follower).into_iter().chain([("lqr", Box::new(lqr) as Box<dyn PathTracker>)]);
    for (name, mut tracker) in all {
        tracker.set_path(&path).unwrap();
        let mut state = VehicleState::new(Se2::new(0.0, 0.1, 0.5), Twist2::ZERO);
        let (mut arrived, mut worst) = (false, 0.0_f64);
        for cycle in 0..2000 {
            let command = tracker.command(&state, &limits, 0.02).unwrap();
            assert!(limits.allows_step(&state.motion(), &command.motion, 0.02), "{name}");
            state = state.after(&command.motion, 0.02);
            let pose = state.map_from_base;
            if cycle > 200 && pose.y() < 1.5 {
                assert!(wrap_angle(pose.yaw() - 0.3).abs() < 0.03, "{name}: {pose:?}");
            }
            if cycle > 200 {
                worst = worst.max(command.cross_track_error.abs());
            }
            arrived = command.status == TrackStatus::Arrived;
            if arrived {
                break;
            }
        }
        let pose = state.map_from_base;
        let end = (pose.translation() - Vector2::new(2.0, 4.0)).norm();
        assert!(arrived && end < 0.02 && (pose.yaw() - 1.3).abs() < 0.03 && worst < 0.15, "{name}: {worst} {pose:?}");
    }
}

/// Points that are given twice change no command.
#[test]
fn repeated_points_change_nothing() {
    let positions: Vec<_> = (0..40).map(|i| Vector2::new(0.1 * f64::from(i), (0.1 * f64::from(i)).sin())).collect();
    let twice: Vec<_> = positions.iter().flat_map(|p| [*p; 3]).collect();
    let (once, twice) = (Path::from_positions(&positions).unwrap(), Path::from_positions(&twice).unwrap());
    for ((name, mut a), (_, mut b)) in
        trackers(FollowerParams::default()).into_iter().zip(trackers(FollowerParams::default()))
    {
        a.set_path(&once).unwrap();
        b.set_path(&twice).unwrap();
        let mut state = VehicleState::new(once.points()[0].pose, Twist2::ZERO);
        for _ in 0..400 {
            let command = a.command(&state, &MotionLimits::default(), 0.02).unwrap();
            assert_eq!(Ok(command), b.command(&state, &MotionLimits::default(), 0.02), "{name}");
            state = state.after(&command.motion, 0.02);
        }
    }
}
