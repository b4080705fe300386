//! Two rounds through an orchard whose trees all look alike, with a laser that finds their stems.

use agv_nav::{
    core::compute::Stream,
    nalgebra::{Matrix3, Vector2},
    prelude::*,
};
use agv_support::landmark_log::{LandmarkLog, LandmarkStep, Seen, SeenAs};
use rand::RngExt as _;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;

/// Steps of a round, and rounds.
const STEPS: usize = 360;
const ROUNDS: usize = 2;
/// Half axes of the way, in metres.
const WAY: [f64; 2] = [30.0, 18.0];
const TREES: u32 = 60;
/// How far the laser sees stems, in metres, and how far to either side.
const VIEW: (f64, f64) = (12.0, 1.7);
/// Deviations of range and bearing.
const SIGHTING: [f64; 2] = [0.02, 0.004];

/// Simulates the log. The noise of the odometry is stated in it.
pub(crate) fn drive(seed: Seed) -> LandmarkLog {
    let mut stream = seed.stream(0, 0);
    let landmarks = trees(&mut stream);
    let mut log = LandmarkLog { landmarks, ..LandmarkLog::default() };
    let sigmas = [0.02, 0.01, 0.004];
    let covariance = Matrix3::from_diagonal(&sigmas.map(|sigma| sigma * sigma).into());
    for step in 0..=STEPS * ROUNDS {
        let truth = on_the_way(step);
        let stamp = Stamp::from_seconds(0.5 * step as f64);
        let mut record = LandmarkStep { stamp, motion: Se2::default(), covariance: Matrix3::zeros(), seen: Vec::new() };
        if let Some((_, last)) = log.reference.last() {
            let noise = agv_nav::nalgebra::Vector3::from(sigmas.map(|sigma| sigma * normal(&mut stream)));
            (record.motion, record.covariance) = (last.between(&truth).plus(&noise), covariance);
        }
        for (id, tree) in &log.landmarks {
            let seen = truth.inverse().act(tree);
            let bearing = seen.y.atan2(seen.x);
            if seen.norm() < VIEW.0 && bearing.abs() < VIEW.1 && stream.random_bool(0.9) {
                let range = seen.norm() + SIGHTING[0] * normal(&mut stream);
                let bearing = bearing + SIGHTING[1] * normal(&mut stream);
                record.seen.push(Seen { id: Some(*id), measured: SeenAs::RangeBearing(range, bearing) });
            }
        }
        log.reference.push((stamp, truth));
        log.steps.push(record);
    }
    log
}

/// Along an ellipse.
fn on_the_way(step: usize) -> Se2 {
    let at = |angle: f64| Vector2::new(WAY[0] * angle.sin(), -WAY[1] * angle.cos());
    let angle = TAU * step as f64 / STEPS as f64;
    let (place, ahead) = (at(angle), at(angle + 1e-4) - at(angle - 1e-4));
    Se2::new(place.x, place.y, ahead.y.atan2(ahead.x))
}

/// On either side of the way, and a metre and a half apart at least.
fn trees(stream: &mut Stream) -> Vec<(u32, Vector2<f64>)> {
    let mut trees: Vec<(u32, Vector2<f64>)> = Vec::new();
    while trees.len() < TREES as usize {
        let angle = stream.random_range(0.0..TAU);
        let (factor, away) = (if stream.random_bool(0.5) { 1.0 } else { -1.0 }, stream.random_range(2.0..8.0));
        let place = Vector2::new((WAY[0] + factor * away) * angle.sin(), -(WAY[1] + factor * away) * angle.cos());
        if trees.iter().all(|(_, tree)| (tree - place).norm() > 1.5) {
            trees.push((trees.len() as u32 + 1, place));
        }
    }
    trees
}

fn normal(stream: &mut Stream) -> f64 {
    StandardNormal.sample(stream)
}
