//! A drive through a room with fifteen tubes: commands that are obeyed late and not quite, seen by a camera that is not calibrated.

use agv_nav::{
    core::{compute::Stream, geometry::wrap_angle},
    nalgebra::Vector2,
    prelude::*,
};
use agv_support::{
    log::StampedPose,
    mrclam::{MrclamLog, SeenSubject, Velocity},
};
use rand::RngExt as _;
use rand_distr::{Distribution, StandardNormal};

/// Steps of 20 ms: ten minutes.
const STEPS: usize = 30_000;
const DT: f64 = 0.02;
/// Steps by which commands are obeyed late.
const LATENCY: usize = 11;
const SPEED: f64 = 0.2;
/// Where the vehicle goes, again and again, in metres.
const WAYPOINTS: [[f64; 2]; 6] = [[5.5, 2.5], [2.0, -2.5], [-5.5, -2.0], [-2.0, 0.5], [-5.0, 2.5], [0.0, 2.0]];
/// Half the camera's field of view, in radians, and how far it sees, in metres.
const VIEW: (f64, f64) = (0.55, 7.0);

/// Simulates the log.
pub(crate) fn drive(seed: Seed) -> MrclamLog {
    let mut stream = seed.stream(0, 0);
    let landmarks = places(&mut stream);
    let mut log = MrclamLog { landmarks, ..MrclamLog::default() };
    let (mut truth, mut goal) = (Se2::new(0.0, 0.0, 0.5), 0);
    let mut wander = Vector2::zeros();
    for step in 0..STEPS {
        let stamp = Stamp::default() + step as f64 * DT;
        if step % 3 == 0 {
            log.reference.push(StampedPose { stamp, pose: truth });
        }
        if step % 12 == 0 {
            log.sightings.extend(look(stamp, &truth, &log.landmarks, &mut stream));
        }
        let command = steer(stamp, &truth, &mut goal);
        log.odometry.push(command);
        let obeyed = step.checked_sub(LATENCY).and_then(|then| log.odometry.get(then));
        let Some(obeyed) = obeyed.filter(|one| one.forward > 0.0) else { continue };
        wander = wander * 0.98 + Vector2::new(0.01, 0.02) * 0.2 * normal(&mut stream);
        let forward = 0.96 * obeyed.forward - 0.05 * obeyed.yaw_rate.abs() + wander.x;
        let yaw_rate = 0.93 * obeyed.yaw_rate + wander.y + 0.02 * normal(&mut stream);
        truth = truth * Twist2::new(forward, 0.0, yaw_rate).integrate(DT);
    }
    log
}

fn normal(stream: &mut Stream) -> f64 {
    StandardNormal.sample(stream)
}

/// Tubes along the walls and in the middle.
fn places(stream: &mut Stream) -> Vec<(u32, Vector2<f64>)> {
    (6..21).map(|id| (id, Vector2::new(stream.random_range(-7.0..7.0), stream.random_range(-4.0..4.0)))).collect()
}

/// Towards the next waypoint, turning at half a radian per second at most.
fn steer(stamp: Stamp, truth: &Se2, goal: &mut usize) -> Velocity {
    let ahead = Vector2::from(WAYPOINTS[*goal % WAYPOINTS.len()]) - truth.translation();
    if ahead.norm() < 0.4 {
        *goal += 1;
    }
    let turn = wrap_angle(ahead.y.atan2(ahead.x) - truth.yaw());
    Velocity { stamp, forward: SPEED, yaw_rate: turn.clamp(-0.5, 0.5) }
}

/// What the camera shows: depths 2 % and 3 cm too long, bearings bent at the edges, and one reading in a hundred of another tube.
fn look(stamp: Stamp, truth: &Se2, landmarks: &[(u32, Vector2<f64>)], stream: &mut Stream) -> Vec<SeenSubject> {
    let mut seen = Vec::new();
    for (id, place) in landmarks {
        let place = truth.inverse().act(place);
        let bearing = place.y.atan2(place.x);
        if bearing.abs() > VIEW.0 || place.norm() > VIEW.1 || stream.random_bool(0.5) {
            continue;
        }
        let subject = Some(if stream.random_bool(0.01) { 6 + (*id + 3) % 15 } else { *id });
        let range = 1.02 * place.x + 0.03 + (0.03 + 0.02 * place.x) * normal(stream);
        let bearing = bearing - 0.01 - 0.06 * (1.0 - bearing.cos()) + 0.01 * normal(stream);
        seen.push(SeenSubject { stamp, subject, range: range.max(0.0), bearing });
    }
    seen
}
