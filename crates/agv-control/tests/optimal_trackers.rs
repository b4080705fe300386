//! What the optimal trackers must reach on a vehicle that lags, slips and is localised with noise.

use agv_control::track::{Lqr, LqrParams, Mpc, MpcParams};
use agv_core::{
    compute::Seed,
    geometry::{Se2, Twist2},
    kinematics::{MotionLimits, TwistLimits},
    nalgebra::Vector2,
    path::Path,
    roles::{PathTracker, TrackStatus, VehicleState},
};
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::{FRAC_PI_2, TAU};

/// Time between two commands, and time constant of the drives, in seconds.
const DT: f64 = 0.02;
const LAG: f64 = 0.15;

fn path(points: &[(f64, f64)]) -> Path {
    Path::from_positions(&points.iter().map(|&(x, y)| Vector2::new(x, y)).collect::<Vec<_>>()).unwrap()
}

/// Lemniscate of Gerono, 3 m half-width.
fn eight() -> Path {
    let points: Vec<_> =
        (0..=1000).map(|i| f64::from(i) / 1000.0 * TAU).map(|t| (3.0 * t.sin(), 3.0 * t.sin() * t.cos())).collect();
    path(&points)
}

/// Two aisles and the way between them: lines of 4, 3 and 4 m with quarter circles of 0.6 m radius.
fn aisle() -> Path {
    let (r, mut at, mut yaw) = (0.6, Vector2::new(0.0, 0.0), 0.0_f64);
    let mut points = vec![(0.0, 0.0)];
    for (line, turn) in [(4.0, 1.0), (3.0, -1.0), (4.0, 0.0)] {
        for _ in 0..(line / 0.02) as usize {
            at += 0.02 * Vector2::new(yaw.cos(), yaw.sin());
            points.push((at.x, at.y));
        }
        for _ in 0..if turn == 0.0 { 0 } else { 48 } {
            let step: f64 = FRAC_PI_2 / 48.0;
            let chord = 2.0 * r * (0.5 * step).sin();
            let along = yaw + 0.5 * turn * step;
            at += chord * Vector2::new(along.cos(), along.sin());
            yaw += turn * step;
            points.push((at.x, at.y));
        }
    }
    path(&points)
}

/// RMSE and greatest distance of the true vehicle from the path, in metres; none if it did not arrive.
fn drive(tracker: &mut dyn PathTracker, path: &Path, seed: u64) -> Option<(f64, f64)> {
    let limits = MotionLimits::from(TwistLimits { yaw_rate: 2.0, yaw_acceleration: 4.0, ..TwistLimits::default() });
    let mut stream = Seed(seed).stream(0, 0);
    let mut noise = |sigma: f64| -> f64 { sigma * Distribution::<f64>::sample(&StandardNormal, &mut stream) };
    let mut pose = path.points()[0].pose;
    let (mut actual, mut command) = (Twist2::ZERO, Twist2::ZERO);
    let (mut square, mut worst, mut cycles, mut nearest) = (0.0, 0.0_f64, 0.0, 0);
    tracker.set_path(path).unwrap();
    let points = path.points();
    for _ in 0..10_000 {
        let measured =
            Se2::new(pose.x() + noise(0.01), pose.y() + noise(0.01), pose.yaw() + noise(0.5_f64.to_radians()));
        let state = VehicleState::new(measured, command);
        let reply = tracker.command(&state, &limits, DT).unwrap();
        assert!(limits.allows_step(&state.motion(), &reply.motion, DT));
        if reply.status == TrackStatus::OffPath {
            return None;
        }
        command = reply.motion.twist;
        // Ten steps for each command, so that the lag is seen as it is.
        for _ in 0..10 {
            let dt = 0.1 * DT;
            let share = 1.0 - (-dt / LAG).exp();
            actual.vx += share * (command.vx - actual.vx);
            actual.yaw_rate += share * (command.yaw_rate - actual.yaw_rate);
            pose = pose * Twist2::new(actual.vx, 0.0, 0.97 * actual.yaw_rate).integrate(dt);
        }
        // To the nearest segment from the last one on: the path crosses itself.
        let distance = |k: usize| {
            let (a, b) = (points[k].pose.translation(), points[k + 1].pose.translation());
            // How far it rolls on at the end is another matter.
            let last = if k + 2 == points.len() { f64::INFINITY } else { 1.0 };
            let share = ((pose.translation() - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, last);
            (pose.translation() - a - (b - a) * share).norm()
        };
        let window = nearest..(nearest + 40).min(points.len() - 1);
        nearest = window.min_by(|&a, &b| distance(a).total_cmp(&distance(b))).unwrap();
        let error = distance(nearest);
        square += error * error;
        worst = worst.max(error);
        cycles += 1.0;
        if reply.status == TrackStatus::Arrived {
            return Some((f64::sqrt(square / cycles), worst));
        }
    }
    None
}

fn figure(name: &str, tracker: &mut dyn PathTracker, seeds: u64) {
    for (on, path) in [("eight", eight()), ("aisle", aisle())] {
        let runs: Vec<_> = (0..seeds).map(|seed| drive(tracker, &path, seed)).collect();
        let good: Vec<_> = runs.iter().flatten().collect();
        let mean = good.iter().map(|r| r.0).sum::<f64>() / good.len() as f64;
        let worst = good.iter().map(|r| r.0).fold(0.0, f64::max);
        let max = good.iter().map(|r| r.1).fold(0.0, f64::max);
        println!("{name} {on}: {} of {}, rmse mean {mean:.4} worst {worst:.4}, max {max:.4}", good.len(), runs.len());
    }
}

#[test]
fn figures() {
    let seeds = std::env::var("SEEDS").map_or(5, |s| s.parse().unwrap());
    figure("lqr", &mut Lqr::new(LqrParams::default()).unwrap(), seeds);
    figure("mpc", &mut Mpc::new(MpcParams::default()).unwrap(), seeds);
}
