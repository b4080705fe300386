//! Pictures of a run, and its particle clouds for an animation.

use super::{Result, follow::Run, judge, load::Drive};
use agv_nav::prelude::*;
use agv_support::{
    input,
    plot::{Color, Scene, TimeSeries},
};
use std::{fmt::Write as _, path::Path};

/// Draws the way, the errors and the number of particles, and writes the clouds.
pub(crate) fn write(out: &Path, drive: &Drive, run: &Run) -> Result<()> {
    let entries = &drive.log.entries;
    let start = drive.reference.first().map_or(run.way[0], |first| first.pose);
    let map_from_odom = start * entries[0].odom_from_base.inverse();
    let odometry: Vec<Se2> = entries.iter().map(|entry| map_from_odom * entry.odom_from_base).collect();
    let reference: Vec<Se2> = drive.reference.iter().map(|reference| reference.pose).collect();
    let estimates: Vec<Se2> = run.updates.iter().map(|update| update.map_from_base).collect();
    let mut scene = Scene::new("Localisation").map(&drive.map).trajectory("raw odometry", Color::Grey, &odometry);
    if !reference.is_empty() {
        scene = scene.trajectory("reference", Color::Green, &reference);
    }
    scene.trajectory("estimate", Color::Blue, &estimates).write(out.join("way.png"))?;

    // Time stamps of logs step backwards: updates are counted instead.
    let errors = judge::errors(drive, run);
    let curve =
        |values: &dyn Fn(usize) -> f64, count: usize| (0..count).map(|i| (i as f64, values(i))).collect::<Vec<_>>();
    TimeSeries::new("Localisation error", "update", "error, cm or deg")
        .curve("position, cm", Color::Blue, curve(&|i| 100.0 * errors[i].0, errors.len()))
        .curve("heading, deg", Color::Orange, curve(&|i| errors[i].1.to_degrees(), errors.len()))
        .write(out.join("error.svg"))?;
    TimeSeries::new("Number of particles", "update", "particles")
        .curve("particles", Color::Purple, curve(&|i| run.updates[i].particles as f64, run.updates.len()))
        .write(out.join("particles.svg"))?;
    clouds(out, drive, run)
}

/// `frame,t,x,y,yaw,weight`: some hundred frames of some hundred particles each.
fn clouds(out: &Path, drive: &Drive, run: &Run) -> Result<()> {
    let mut text = String::from("frame,t,x,y,yaw,weight\n");
    let begin = drive.log.entries[0].scan.stamp();
    for (index, frame) in run.frames.iter().enumerate() {
        let t = drive.log.entries[frame.row].scan.stamp() - begin;
        for (pose, weight) in frame.poses.iter().zip(&frame.weights) {
            writeln!(text, "{index},{t:.3},{:.3},{:.3},{:.4},{weight:.3e}", pose.x(), pose.y(), pose.yaw())?;
        }
    }
    input::write(out.join("particles.csv.gz"), text.as_bytes())?;
    Ok(())
}
