//! The map, the trajectory, and a picture of both.

use super::{Result, load::Drive, methods::Run};
use agv_nav::prelude::*;
use agv_support::{
    log::StampedPose,
    map,
    plot::{Color, Scene},
    trajectory::write_tum,
};
use std::path::Path;

/// Writes what a run gave.
pub(crate) fn write(out: &Path, drive: &Drive, run: &Run) -> Result<()> {
    map::write(out.join("map.yaml"), &run.map)?;
    let upright =
        |pose: &Se2| Se3::from_parts(pose.translation().push(0.0), So3::from_roll_pitch_yaw(0.0, 0.0, pose.yaw()));
    let way: Vec<_> = run.way.iter().map(|at| StampedPose { stamp: at.stamp, pose: upright(&at.pose) }).collect();
    write_tum(out.join("trajectory.tum"), &way)?;
    let poses: Vec<Se2> = run.way.iter().map(|at| at.pose).collect();
    let title = format!("{} scans", drive.entries.len());
    Scene::new(title).width(1600).map(&run.map).trajectory("way", Color::Blue, &poses).write(out.join("map.png"))?;
    Ok(())
}
