//! The way and the landmarks, as files and as a picture.

use super::{Result, replay::Run};
use agv_nav::{
    core::metrics::{TrajectoryAlignment, absolute_error, associate},
    nalgebra::Vector2,
    prelude::*,
};
use agv_support::{
    input,
    landmark_log::LandmarkLog,
    log::StampedPose,
    plot::{Color, Scene},
    trajectory,
};
use std::{f64::consts::TAU, fmt::Write as _, path::Path as FilePath};

/// Deviations of the ellipses: 95 % of them hold the truth.
const SIGMAS: f64 = 2.45;

/// Writes them into a folder.
pub(crate) fn write(out: &FilePath, log: &LandmarkLog, run: &Run) -> Result<()> {
    let poses: Vec<_> =
        run.way.iter().map(|(stamp, pose)| StampedPose { stamp: *stamp, pose: Se3::from(*pose) }).collect();
    trajectory::write_tum(out.join("trajectory.tum"), &poses)?;
    let mut text = String::from("# landmark x y\n");
    for landmark in &run.landmarks {
        let _ = writeln!(text, "{} {} {}", landmark.key, landmark.place.x, landmark.place.y);
    }
    input::write(out.join("landmarks.txt"), text.as_bytes())?;
    draw(log, run)?.write(out.join("landmarks.svg"))?;
    Ok(())
}

fn draw(log: &LandmarkLog, run: &Run) -> Result<Scene> {
    let odometry: Vec<Se2> = log
        .steps
        .iter()
        .scan(Se2::default(), |pose, step| {
            *pose = pose.compose(&step.motion);
            Some(*pose)
        })
        .collect();
    let mut scene = Scene::new("Landmarks and the way").trajectory("odometry", Color::Grey, &odometry).trajectory(
        "estimate",
        Color::Blue,
        run.way.iter().map(|(_, pose)| pose),
    );
    let pairs = associate(&log.reference, &run.way, 0.15)?;
    if pairs.len() > 2 {
        let map_from_world = absolute_error(&pairs, TrajectoryAlignment::Rigid)?.reference_from_estimate.inverse();
        let truth: Vec<_> = log.reference.iter().map(|(_, pose)| map_from_world.compose(pose)).collect();
        scene = scene.trajectory("truth", Color::Green, &truth);
        for (i, (_, place)) in log.landmarks.iter().enumerate() {
            scene = scene.mark(if i == 0 { "true landmarks" } else { "" }, Color::Green, map_from_world.act(place));
        }
    }
    for (i, landmark) in run.landmarks.iter().filter(|landmark| landmark.confirmed).enumerate() {
        let label = if i == 0 { "landmarks, 95 %" } else { "" };
        scene = scene.mark(label, Color::Red, landmark.place);
        let eigen = landmark.covariance.symmetric_eigen();
        let axes = eigen.eigenvalues.map(|variance| SIGMAS * variance.max(0.0).sqrt());
        let ellipse = (0..=32).map(|i| {
            let (sin, cos) = (TAU * f64::from(i) / 32.0).sin_cos();
            landmark.place + eigen.eigenvectors * Vector2::new(axes.x * cos, axes.y * sin)
        });
        scene = scene.line("", Color::Red, ellipse);
    }
    Ok(scene)
}
