//! Pictures of runs: what stood there, what was planned, and what was driven.

use crate::{
    Result,
    planners::SIZE,
    run::{CYCLE, End, Run},
    worlds::Trial,
};
use agv_nav::{
    nalgebra::Vector2,
    prelude::{LieGroup as _, Se2},
};
use agv_sim::Clutter;
use agv_support::plot::{Color, Scene, TimeSeries, circle};
use std::{
    fs,
    io::ErrorKind,
    path::{Path, PathBuf},
};

/// Draws the first run and each failure, or all runs; pictures of these worlds from an earlier call go.
pub(crate) fn draw(out: &Path, trials: &[Trial], runs: &[Run], all: bool) -> Result<()> {
    for file in trials.iter().flat_map(|trial| files(out, trial)) {
        if let Err(error) = fs::remove_file(file)
            && error.kind() != ErrorKind::NotFound
        {
            return Err(error.into());
        }
    }
    for (index, (trial, run)) in trials.iter().zip(runs).enumerate() {
        // One of the good ones, too, to see how it looks.
        if run.end != End::Success || all || index == 0 {
            draw_one(out, trial, run)?;
        }
    }
    Ok(())
}

/// The scene of a run, and its motion over time.
fn files(out: &Path, trial: &Trial) -> [PathBuf; 2] {
    [out.join(format!("{}.png", trial.name)), out.join(format!("{}_speed.png", trial.name))]
}

fn draw_one(out: &Path, trial: &Trial, run: &Run) -> Result<()> {
    let [picture, speeds] = files(out, trial);
    let title = format!("{}: {:?} after {:.1} s, {:?}", trial.name, run.end, run.time, run.status);
    let mut scene = Scene::new(title).width(900);
    if let Some(map) = &trial.map {
        scene = scene.map(map);
    }
    // A line of many pieces is one layer.
    for disc in &trial.discs {
        scene = scene.line("", Color::Black, circle(disc, Clutter::RADIUS));
    }
    for obstacle in &run.obstacles {
        scene = scene.line("", Color::Purple, circle(&obstacle.position, obstacle.radius));
    }
    if !trial.reference.is_empty() {
        scene = scene.line("the set's path", Color::Grey, trial.reference.iter().copied());
    }
    if let Some(first) = run.paths.first() {
        scene = scene.line("first path", Color::Sky, first.iter().copied());
    }
    if let Some(last) = run.paths.last().filter(|_| run.paths.len() > 1) {
        scene = scene.line("last path", Color::Orange, last.iter().copied());
    }
    scene = scene.trajectory("driven", Color::Blue, &run.track);
    if let Some(end) = run.track.last() {
        let color = if run.end == End::Success { Color::Green } else { Color::Red };
        scene = scene.line("vehicle", color, outline(end));
    }
    scene.mark("goal", Color::Green, trial.goal.translation()).write(picture)?;

    let pairs = || run.track.windows(2).enumerate();
    let motion = |(index, pair): (usize, &[Se2])| (index as f64 * CYCLE, pair[0].between(&pair[1]));
    TimeSeries::new(&*trial.name, "time (s)", "m/s, rad/s")
        .curve("speed", Color::Blue, pairs().map(motion).map(|(t, step)| (t, step.x() / CYCLE)))
        .curve("turn rate", Color::Orange, pairs().map(motion).map(|(t, step)| (t, step.yaw() / CYCLE)))
        .write(speeds)?;
    Ok(())
}

fn outline(pose: &Se2) -> impl Iterator<Item = Vector2<f64>> {
    let pose = *pose;
    let corners = [(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5), (0.5, 0.5)];
    corners.into_iter().map(move |(x, y)| pose * Vector2::new(x * SIZE.0, y * SIZE.1))
}
