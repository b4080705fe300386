//! Every tracker on the tracking experiments' disturbances: drives that lag by 0.15 s, poses with 1 cm and 0.5° of noise at 50 Hz, and
//! 3 % more yaw than commanded.

use agv_control::track::{PidTracker, PidTrackerParams, PurePursuit, PurePursuitParams, Stanley, StanleyParams};
use agv_core::{
    compute::Seed,
    geometry::{LieGroup, Se2, Twist2},
    kinematics::{MotionLimits, TwistLimits},
    nalgebra::Vector2,
    path::Path,
    roles::{PathTracker, TrackStatus, VehicleState},
};
use rand_distr::{Distribution, Normal};

const DT: f64 = 0.02;
const LAG: f64 = 0.15;
const SLIP: f64 = 1.03;

fn trackers() -> [(&'static str, Box<dyn PathTracker>); 3] {
    [
        ("pure pursuit", Box::new(PurePursuit::new(PurePursuitParams::default()).unwrap())),
        ("stanley", Box::new(Stanley::new(StanleyParams::default()).unwrap())),
        ("pid", Box::new(PidTracker::new(PidTrackerParams::default()).unwrap())),
    ]
}

/// Lemniscate of Gerono, 3 m half-width.
fn eight() -> Path {
    let angles = (0..=1000).map(|i| f64::from(i) / 1000.0 * std::f64::consts::TAU);
    Path::from_positions(&angles.map(|t| Vector2::new(3.0 * t.sin(), 3.0 * t.sin() * t.cos())).collect::<Vec<_>>())
        .unwrap()
}

/// Around two racks: lines joined by quarter circles of 0.6 m radius, to the left and to the right.
fn aisle() -> Path {
    let (mut at, mut yaw) = (Vector2::new(0.0, 0.0), 0.0_f64);
    let mut points = vec![at];
    for (length, turn) in [(4.0, 1.0), (3.0, 1.0), (3.0, -1.0), (2.0, -1.0), (4.0, 0.0)] {
        let along = Vector2::new(yaw.cos(), yaw.sin());
        for _ in 0..(length / 0.02) as usize {
            at += along * 0.02;
            points.push(at);
        }
        let center = at + Vector2::new(-along.y, along.x) * 0.6 * turn;
        for i in 1..=45 {
            if turn == 0.0 {
                break;
            }
            let angle = yaw - turn * std::f64::consts::FRAC_PI_2 + turn * f64::from(i) * 2_f64.to_radians();
            at = center + Vector2::new(angle.cos(), angle.sin()) * 0.6;
            points.push(at);
        }
        yaw += turn * std::f64::consts::FRAC_PI_2;
    }
    Path::from_positions(&points).unwrap()
}

/// What came of a drive, in metres.
#[derive(Debug)]
struct Outcome {
    rmse: f64,
    worst: f64,
    /// Distance from the end of the path, and angle from its heading in radians.
    end: f64,
    end_heading: f64,
}

fn drive(tracker: &mut dyn PathTracker, path: &Path, limits: &MotionLimits, seed: u64) -> Outcome {
    let (position_noise, yaw_noise) =
        (Normal::new(0.0, 0.01).unwrap(), Normal::new(0.0, 0.5_f64.to_radians()).unwrap());
    tracker.set_path(path).unwrap();
    let mut noise = Seed(seed).stream(0, 0);
    let (mut pose, mut twist, mut command) = (path.points()[0].pose, Twist2::ZERO, Twist2::ZERO);
    let (mut square, mut worst, mut nearest) = (0.0, 0.0_f64, 0);
    let points: Vec<_> = path.points().iter().map(|p| p.pose.translation()).collect();
    for cycle in 1..10_000 {
        let measured = Se2::new(
            pose.x() + position_noise.sample(&mut noise),
            pose.y() + position_noise.sample(&mut noise),
            pose.yaw() + yaw_noise.sample(&mut noise),
        );
        let state = VehicleState::new(measured, command);
        let reply = tracker.command(&state, limits, DT).unwrap();
        assert_ne!(reply.status, TrackStatus::OffPath, "{reply:?} {pose:?} {seed}");
        assert!(limits.allows_step(&state.motion(), &reply.motion, DT));
        command = reply.motion.twist;
        // Exact first-order lag, position by the twist's mean over the cycle.
        let before = twist;
        let blend = 1.0 - (-DT / LAG).exp();
        twist.vx += (command.vx - twist.vx) * blend;
        twist.yaw_rate += (command.yaw_rate - twist.yaw_rate) * blend;
        let mean = Twist2::new(0.5 * (before.vx + twist.vx), 0.0, 0.5 * SLIP * (before.yaw_rate + twist.yaw_rate));
        pose = pose * mean.integrate(DT);
        // The true pose against the curve, in order.
        let position = pose.translation();
        let distance = |i: usize| {
            let (a, b) = (points[i], points[i + 1]);
            let share = ((position - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
            (a + (b - a) * share - position).norm()
        };
        nearest = (nearest..(nearest + 30).min(points.len() - 1))
            .min_by(|&i, &j| distance(i).total_cmp(&distance(j)))
            .unwrap();
        let error = distance(nearest);
        square += error * error;
        worst = worst.max(error);
        if reply.status == TrackStatus::Arrived {
            let end = path.points()[path.len() - 1].pose.inverse() * pose;
            let rmse = (square / f64::from(cycle)).sqrt();
            return Outcome { rmse, worst, end: end.translation().norm(), end_heading: end.yaw().abs() };
        }
    }
    panic!("not arrived: {pose:?}");
}

/// The issue asks for 5 cm of every tracker, and for 0.7 cm and 2 cm at most of the best on the eight.
#[test]
fn every_tracker_keeps_to_the_centimetre_over_a_hundred_seeds() {
    let limits = MotionLimits::from(TwistLimits { yaw_rate: 2.0, yaw_acceleration: 4.0, ..TwistLimits::default() });
    for (path_name, path, rmse, worst) in [("eight", eight(), 0.007, 0.02), ("aisle", aisle(), 0.01, 0.03)] {
        for (name, mut tracker) in trackers() {
            let outcomes: Vec<_> = (0..100).map(|seed| drive(tracker.as_mut(), &path, &limits, seed)).collect();
            let most = |of: fn(&Outcome) -> f64| outcomes.iter().map(of).fold(0.0, f64::max);
            let figures = [most(|o| o.rmse), most(|o| o.worst), most(|o| o.end), most(|o| o.end_heading)];
            println!("{path_name}, {name}: rmse, worst, end, heading at most {figures:.4?}");
            assert!(figures[0] < rmse && figures[1] < worst, "{name} on {path_name}: {figures:?}");
            // The end is that of noisy poses: two centimetres of noise, and a degree.
            assert!(figures[2] < 0.04 && figures[3] < 0.03, "{name} on {path_name}: {figures:?}");
        }
    }
}
