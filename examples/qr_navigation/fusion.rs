//! Table 5 of paper 001: the position by the particles, by the camera, and by both, beside what can be had at best.

use super::{Result, laps::Run};
use agv_nav::{
    core::geometry::UncertainPose,
    filters::marker::fuse_poses,
    nalgebra::{Matrix3, Vector3},
    prelude::*,
};
use agv_support::cli::Report;
use rand::RngExt;
use std::f64::consts::TAU;

/// Mean errors of the table's rows, in metres: particles, camera and what the paper says of both together.
const PAPER: [f64; 3] = [0.0333, 0.0360, 0.0069];

/// Root mean square errors of particles, camera and filter where codes were seen, and the bound.
pub(crate) fn measured(runs: &[Run], report: &mut Report) {
    let sightings = || runs.iter().flat_map(|run| &run.sightings);
    let count = sightings().count().max(1) as f64;
    let error = |pose: &Se2, truth: &Se2| (pose.translation() - truth.translation()).norm_squared();
    let laser = (sightings().map(|s| error(s.by_laser.mean(), &s.truth)).sum::<f64>() / count).sqrt();
    let codes = (sightings().map(|s| error(s.by_codes.mean(), &s.truth)).sum::<f64>() / count).sqrt();
    let fused = (sightings().map(|s| error(&s.fused, &s.truth)).sum::<f64>() / count).sqrt();
    report
        .count("sightings", sightings().count())
        .number("sighting_laser_rmse_m", laser)
        .number("sighting_codes_rmse_m", codes)
        .number("sighting_fused_rmse_m", fused)
        .number("sighting_bound_m", bound(laser, codes));
}

/// What two independent errors leave at best when they are weighted by their information.
fn bound(a: f64, b: f64) -> f64 {
    (a.powi(-2) + b.powi(-2)).powf(-0.5)
}

/// Errors of the sizes that the table states for particles and camera, independent and without bias, fused.
pub(crate) fn of_the_papers_size(draws: u32, seed: Seed, report: &mut Report) -> Result<()> {
    let mut stream = seed.stream(0, 0);
    // Of two equal Gaussian errors the distance has the mean σ √(π/2).
    let [laser, camera] = [PAPER[0], PAPER[1]].map(|mean| mean / (TAU / 4.0).sqrt());
    let mut draw = |sigma: f64, truth: &Se2| {
        // Box and Muller.
        let (radius, angle) =
            ((-2.0 * (1.0 - stream.random::<f64>()).ln()).sqrt() * sigma, TAU * stream.random::<f64>());
        let spread = Matrix3::from_diagonal(&Vector3::new(sigma * sigma, sigma * sigma, 1e-4));
        let pose = Se2::new(truth.x() + radius * angle.cos(), truth.y() + radius * angle.sin(), truth.yaw());
        UncertainPose::new(pose, spread)
    };
    let truth = Se2::new(0.0, 3.75, 0.0);
    let mut means = [0.0; 3];
    for _ in 0..draws {
        let (a, b) = (draw(laser, &truth)?, draw(camera, &truth)?);
        let fused = fuse_poses(&a, &b)?.pose;
        for (mean, pose) in means.iter_mut().zip([a, b, fused]) {
            *mean += (pose.mean().translation() - truth.translation()).norm() / f64::from(draws);
        }
    }
    report
        .number("paper_size_laser_mean_m", means[0])
        .number("paper_size_camera_mean_m", means[1])
        .number("paper_size_fused_mean_m", means[2])
        .number("paper_size_bound_m", bound(PAPER[0], PAPER[1]))
        .number("paper_stated_fused_m", PAPER[2]);
    Ok(())
}
