//! The drive, from files or as shipped.

use super::{Args, Result};
use agv_nav::{
    core::{metrics::Relation, sensors::ScanGeometry},
    prelude::*,
};
use agv_support::{
    Input,
    log::{LogEntry, OdometryEntry, ScanLog, StampedPose, csv},
    relations,
};
use std::path::Path;

/// What is to be mapped.
pub(crate) struct Drive {
    pub(crate) entries: Vec<LogEntry>,
    /// Poses that are held for true: one for each scan, or with stamps of the same clock.
    pub(crate) reference: Vec<StampedPose>,
    pub(crate) relations: Vec<Relation<Se2>>,
}

/// Reads what the arguments name.
pub(crate) fn read(args: &Args) -> Result<Drive> {
    let mut drive = match &args.scans {
        Some(scans) => recorded(scans)?,
        None => shipped()?,
    };
    if drive.entries.is_empty() {
        return Err("the drive has no scans".into());
    }
    if let Some(reference) = &args.reference {
        drive.reference = read_reference(reference)?;
    }
    if let Some(file) = &args.relations {
        drive.relations = relations::read(file)?.iter().map(planar).collect();
    }
    if args.upside_down {
        for entry in &mut drive.entries {
            let seen = *entry.scan.geometry();
            let turned = ScanGeometry { angle_min: -seen.angle_min, angle_increment: -seen.angle_increment, ..seen };
            entry.scan = LaserScan::new(entry.scan.stamp(), turned, entry.scan.ranges().to_vec())?;
        }
    }
    Ok(drive)
}

/// A log, with its raw odometry. Poses that a SLAM program wrote into it become the reference.
fn recorded(path: &Path) -> Result<Drive> {
    let mut log = ScanLog::read(path)?;
    // Such programs write their pose as odometry too; the raw one is left in the readings between the scans.
    let overwritten = log.entries.iter().all(|entry| entry.corrected == Some(entry.odom_from_base));
    let is_raw =
        |reading: &OdometryEntry| log.entries.iter().all(|entry| entry.corrected != Some(reading.odom_from_base));
    if overwritten && log.odometry.iter().filter(|reading| is_raw(reading)).count() > log.entries.len() {
        log = log.with_odometry_readings();
    }
    let poses = log.entries.iter().map(|entry| Some((entry, entry.corrected?)));
    let corrected: Option<Vec<(&LogEntry, Se2)>> = poses.collect();
    // A logger may repeat its odometry there, moved to the laser: that is no reference.
    let mount = |(entry, pose): &(&LogEntry, Se2)| entry.odom_from_base.between(pose);
    let reference = corrected
        .filter(|poses| poses.iter().any(|at| mount(at).between(&mount(&poses[0])).translation().norm() > 0.01))
        .unwrap_or_default()
        .into_iter()
        .map(|(entry, pose)| StampedPose { stamp: entry.scan.stamp(), pose })
        .collect();
    Ok(Drive { entries: log.entries, reference, relations: Vec::new() })
}

/// The shipped drive: once around the corridors.
fn shipped() -> Result<Drive> {
    let folder = Path::new("data/intel");
    let log = ScanLog::read(folder.join("drive_scans.csv.gz"))?;
    let reference = csv::read_reference(folder.join("drive_reference.csv.gz"))?;
    Ok(Drive { entries: log.entries, reference, relations: Vec::new() })
}

/// Reference poses: CSV with a header, or `t x y yaw` per line.
fn read_reference(path: &Path) -> Result<Vec<StampedPose>> {
    let input = Input::read(path)?;
    let first = input.data_lines().next().transpose()?;
    if first.is_some_and(|(_, text)| text.contains(',')) {
        return Ok(csv::parse_reference(&input)?);
    }
    let mut poses = Vec::new();
    for line in input.data_lines() {
        let (number, text) = line?;
        let values: Vec<f64> = text.split_ascii_whitespace().map_while(|word| word.parse().ok()).collect();
        let [t, x, y, yaw] = values[..] else {
            return Err(format!("{}:{number}: expected `t x y yaw`", path.display()).into());
        };
        if ![t, x, y, yaw].iter().all(|value: &f64| value.is_finite()) {
            return Err(format!("{}:{number}: a number is not finite", path.display()).into());
        }
        poses.push(StampedPose { stamp: Stamp::from_seconds(t), pose: Se2::new(x, y, yaw) });
    }
    Ok(poses)
}

fn planar(relation: &relations::Relation) -> Relation<Se2> {
    let translation = relation.first_from_second.translation();
    let (_, _, yaw) = relation.first_from_second.rotation().roll_pitch_yaw();
    Relation { from: relation.first, to: relation.second, from_from_to: Se2::new(translation.x, translation.y, yaw) }
}
