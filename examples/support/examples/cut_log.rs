//! Cuts a part out of a scan log and its reference, thins it, and draws it. `data/intel` was made with it.
//!
//! A row is kept when the reference has moved by `--distance` or turned by `--angle` since the row kept before; odometry
//! is absolute in the log, so leaving rows out loses none of it. Rows count from 0, as the data rows of the input.

use agv_core::{
    geometry::{LieGroup, Se2},
    grid::{CellState, Grid, GridLayout},
    nalgebra::Vector2,
    sensors::{Beam, LaserScan},
};
use agv_support::{
    Error,
    cli::Report,
    log::{ScanLog, csv},
    plot::{Color, Scene},
};
use clap::Parser;
use std::{ops::Range, path::PathBuf, process::ExitCode};

/// Cuts, thins and draws a scan log.
#[derive(Parser)]
struct Args {
    /// Scan log
    #[arg(long)]
    scans: PathBuf,
    /// Reference poses, one per scan
    #[arg(long)]
    reference: PathBuf,
    /// First row
    #[arg(long, default_value_t = 0)]
    from: usize,
    /// Row after the last
    #[arg(long)]
    to: Option<usize>,
    /// Rows to leave out, as `FROM..TO`: a part to be localised in the map of the rest
    #[arg(long, value_parser = rows)]
    without: Option<Range<usize>>,
    /// Row that parts the picture's trajectory in two colours
    #[arg(long)]
    part: Option<usize>,
    /// Least way between rows, in metres
    #[arg(long, default_value_t = 0.1)]
    distance: f64,
    /// Least turn between rows, in degrees
    #[arg(long, default_value_t = 5.0)]
    angle: f64,
    /// Folder to write `scans.csv.gz`, `reference.csv.gz` and `cut.png` to
    #[arg(long, default_value = "target/agv/cut_log")]
    out: PathBuf,
    /// Print one JSON object instead of the table
    #[arg(long)]
    json: bool,
}

fn rows(text: &str) -> Result<Range<usize>, String> {
    let ends = text.split_once("..").and_then(|(from, to)| Some(from.parse().ok()?..to.parse().ok()?));
    ends.ok_or_else(|| "two row numbers are needed, as 10..20".to_owned())
}

fn main() -> ExitCode {
    agv_support::run(|| cut(&Args::parse()))
}

fn cut(args: &Args) -> Result<(), Error> {
    let mut log = ScanLog::read(&args.scans)?;
    let mut poses = csv::read_reference(&args.reference)?;
    if poses.len() != log.entries.len() {
        let reason = format!("{} poses for {} scans", poses.len(), log.entries.len());
        return Err(Error::file(&args.reference, reason));
    }
    let to = args.to.unwrap_or(poses.len());
    let mut last: Option<Se2> = None;
    let mut kept = Vec::new();
    for (row, entry) in poses.iter().enumerate().take(to).skip(args.from) {
        if args.without.as_ref().is_some_and(|without| without.contains(&row)) {
            continue;
        }
        let moved = last.is_none_or(|last| {
            let step = last.between(&entry.pose);
            step.translation().norm() >= args.distance || step.yaw().abs().to_degrees() >= args.angle
        });
        if moved {
            last = Some(entry.pose);
            kept.push(row);
        }
    }
    let part = kept.partition_point(|&row| row < args.part.unwrap_or(to));
    log.entries = kept.iter().map(|&row| log.entries[row].clone()).collect();
    poses = kept.iter().map(|&row| poses[row]).collect();
    csv::write(args.out.join("scans.csv.gz"), &log)?;
    csv::write_reference(args.out.join("reference.csv.gz"), &poses)?;

    let poses: Vec<Se2> = poses.iter().map(|entry| entry.pose).collect();
    let scans: Vec<&LaserScan> = log.entries.iter().map(|entry| &entry.scan).collect();
    let mut scene = Scene::new("Cut of the log, at its reference poses").map(&sketch(&poses[..part], &scans[..part])?);
    scene = scene.trajectory("first part", Color::Blue, &poses[..part]);
    scene = scene.trajectory("second part", Color::Red, &poses[part..]);
    for (label, color, pose) in [("start", Color::Green, poses.first()), ("end", Color::Orange, poses.last())] {
        if let Some(pose) = pose {
            scene = scene.mark(label, color, pose.translation());
        }
    }
    scene.write(args.out.join("cut.png"))?;

    let length = poses.windows(2).map(|pair| pair[0].between(&pair[1]).translation().norm()).sum();
    let mut report = Report::new("Cut");
    report.count("rows", kept.len()).count("rows_first_part", part).number("path_length_m", length);
    report.print(args.json)
}

/// A rough picture of the rooms: cells where a fifth of the beams end are walls.
fn sketch(poses: &[Se2], scans: &[&LaserScan]) -> Result<Grid<CellState>, Error> {
    const RESOLUTION: f64 = 0.05;
    let (low, high) = poses.iter().fold((Vector2::repeat(f64::MAX), Vector2::repeat(f64::MIN)), |(low, high), pose| {
        (low.inf(&pose.translation()), high.sup(&pose.translation()))
    });
    let size = (high - low + Vector2::repeat(30.0)) / RESOLUTION;
    let origin = Se2::new(low.x - 15.0, low.y - 15.0, 0.0);
    let layout = GridLayout::new(size.x.max(1.0) as usize, size.y.max(1.0) as usize, RESOLUTION, origin)?;
    let mut counts = Grid::filled(layout, (0_u32, 0_u32));
    for (pose, scan) in poses.iter().zip(scans) {
        let mount = *pose * scan.geometry().base_from_sensor;
        for (angle, beam) in scan.beams() {
            let Beam::Hit(range) = beam else { continue };
            let direction = Vector2::new(angle.cos(), angle.sin());
            let steps = (range.min(15.0) / RESOLUTION) as usize;
            for step in 0..=steps {
                let point = mount.act(&(direction * (step as f64 * RESOLUTION).min(range)));
                let ends = step == steps && range < 15.0;
                let point = if ends { mount.act(&(direction * range)) } else { point };
                if let Some(index) = layout.cell_at(&point).and_then(|cell| layout.index(cell)) {
                    let (hits, passes) = &mut counts.values_mut()[index];
                    *(if ends { hits } else { passes }) += 1;
                }
            }
        }
    }
    Ok(counts.map(|&(hits, passes)| match (hits, passes) {
        (0, 0) => CellState::Unknown,
        (hits, passes) if hits > 1 && 4 * hits > passes => CellState::Occupied,
        _ => CellState::Free,
    }))
}
