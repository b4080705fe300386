//! The map and the drive, from files or as shipped.

use super::{Args, Result, simulate};
use agv_nav::{
    core::{
        grid::{EvidenceGrid, InverseModelParams, OccupancyThresholds},
        metrics::Relation,
    },
    prelude::*,
};
use agv_support::{
    log::{ScanLog, StampedPose, csv},
    map,
    progress::Progress,
    relations,
};
use rand::RngExt;
use std::path::Path;

/// What is to be localised, and where.
pub(crate) struct Drive {
    pub(crate) map: Grid<CellState>,
    pub(crate) log: ScanLog,
    /// One pose for each scan; none if there is no reference.
    pub(crate) reference: Vec<StampedPose>,
    pub(crate) relations: Vec<Relation<Se2>>,
}

/// Edge of a cell of the map that is made, in metres.
const RESOLUTION: f64 = 0.05;

/// Error of the odometry in a jump: in metres, in any direction, and in radians, to either side.
const JUMP: (f64, f64) = (0.3, 9.0_f64.to_radians());

/// Reads what the arguments name.
pub(crate) fn read(args: &Args) -> Result<Drive> {
    let mut drive = match (&args.map, &args.scans) {
        (Some(map), Some(scans)) => Drive {
            map: map::read(map)?,
            log: ScanLog::read(scans)?,
            reference: args.reference.as_ref().map(csv::read_reference).transpose()?.unwrap_or_default(),
            relations: args
                .relations
                .as_ref()
                .map(relations::read)
                .transpose()?
                .unwrap_or_default()
                .iter()
                .map(planar)
                .collect(),
        },
        (Some(map), None) => simulate::drive(map::read(map)?, args.travel, args.common.seed().derive(8))?,
        _ => shipped()?,
    };
    let (scans, poses) = (drive.log.entries.len(), drive.reference.len());
    if scans == 0 {
        return Err("the drive has no scans".into());
    }
    if poses != scans && poses > 0 {
        return Err(format!("{poses} reference poses for {scans} scans").into());
    }
    if poses == 0 && !args.global {
        return Err(
            "tracking starts at the first reference pose: name a --reference, or start anywhere by --global".into()
        );
    }
    if let Some(every) = args.jumps {
        jump(&mut drive.log, every, args.common.seed().derive(9));
    }
    Ok(drive)
}

/// The shipped drive in a map of the shipped mapping drive.
fn shipped() -> Result<Drive> {
    let folder = Path::new("data/intel");
    let read = |part: &str| -> Result<_> {
        let log = ScanLog::read(folder.join(format!("{part}_scans.csv.gz")))?;
        Ok((log, csv::read_reference(folder.join(format!("{part}_reference.csv.gz")))?))
    };
    let (mapped, poses) = read("map")?;
    let seed = GridLayout::new(64, 64, RESOLUTION, Se2::default())?;
    let mut grid = EvidenceGrid::new(seed, InverseModelParams::default())?;
    let progress = Progress::new(poses.len(), "mapping");
    for (entry, reference) in progress.over(mapped.entries.iter().zip(&poses)) {
        grid.insert_scan(&entry.scan, &reference.pose)?;
    }
    let (log, reference) = read("drive")?;
    Ok(Drive { map: grid.states(&OccupancyThresholds::default()), log, reference, relations: Vec::new() })
}

fn planar(relation: &relations::Relation) -> Relation<Se2> {
    let translation = relation.first_from_second.translation();
    let (_, _, yaw) = relation.first_from_second.rotation().roll_pitch_yaw();
    Relation { from: relation.first, to: relation.second, from_from_to: Se2::new(translation.x, translation.y, yaw) }
}

/// Puts jumps into the odometry: once in `every` scans, it is off by [`JUMP`] from then on.
fn jump(log: &mut ScanLog, every: u32, seed: Seed) {
    let (mut stream, mut last, mut jumped) = (seed.stream(0, 0), Se2::default(), Se2::default());
    for (index, entry) in log.entries.iter_mut().enumerate() {
        let raw = entry.odom_from_base;
        if index > 0 {
            jumped = jumped * last.between(&raw);
            if stream.random_range(0..every) == 0 {
                let (sin, cos) = stream.random_range(0.0..std::f64::consts::TAU).sin_cos();
                let side = if stream.random::<bool>() { 1.0 } else { -1.0 };
                jumped = jumped * Se2::new(JUMP.0 * cos, JUMP.0 * sin, side * JUMP.1);
            }
        } else {
            jumped = raw;
        }
        (last, entry.odom_from_base) = (raw, jumped);
    }
}
