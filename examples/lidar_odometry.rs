//! Where does the lidar go? Scans in order become a trajectory and a map.
//!
//! ```text
//! cargo run --release --example lidar_odometry                                            # a simulated drive with 16 lines
//! cargo run --release --example lidar_odometry -- --seconds 60                            # the whole of it
//! cargo run --release --example lidar_odometry -- --laps 2 --loops --target last          # two laps around a rack, and loop closure
//! cargo run --release --example lidar_odometry -- --scans run/*.pcd --poses run.tum --method loam
//! cargo run --release --example lidar_odometry -- --scans os0_0*.xyz.i16mm2.gz --poses os0_poses.csv --method gicp
//! ```
//!
//! Scans are PLY, PCD, KITTI's `.bin`, or raw rows as `agv_support::cloud` says, given in order. Poses are a table whose rows begin with
//! the number of a scan and its time, matched by the last number in the files' names, or KITTI's and TUM's lines in the order of the
//! scans.
//!
//! With `--loops`, key frames are kept, places that are met again are recognised, and all poses are corrected: the `corrected_` errors
//! are those of the trajectory as it is known in the end, which is also what is written.
//!
//! You will see how far the trajectory is from the poses, step by step and in the end, and how long a scan takes. `trajectory.tum`,
//! `trajectory.kitti` and a picture of the map are written to the output folder. The drive takes a few seconds.

#[path = "lidar_odometry/judge.rs"]
mod judge;
#[path = "lidar_odometry/load.rs"]
mod load;
#[path = "lidar_odometry/loops.rs"]
mod loops;
#[path = "lidar_odometry/methods.rs"]
mod methods;
#[path = "lidar_odometry/pictures.rs"]
mod pictures;
#[path = "lidar_odometry/simulate.rs"]
mod simulate;

use agv_nav::core::geometry::Se3;
use agv_support::{
    cli::{CommonArgs, Report},
    progress::Progress,
    timing::Timings,
};
use clap::Parser;
use methods::Method;
use std::{path::PathBuf, process::ExitCode};

/// Follow a lidar.
#[derive(Parser)]
struct Args {
    /// Scans in order [default: a simulated drive]
    #[arg(long, num_args = 1..)]
    scans: Vec<PathBuf>,
    /// Reference poses of the scans: a table with scan numbers, KITTI or TUM
    #[arg(long, requires = "scans")]
    poses: Option<PathBuf>,
    /// Who follows
    #[arg(long, value_enum, default_value_t = Method::Loam)]
    method: Method,
    /// What loam aligns scans with
    #[arg(long, value_enum, default_value_t = methods::Target::Map)]
    target: methods::Target,
    /// Whether loam solves for height, roll and pitch first, then for x, y and yaw
    #[arg(long)]
    two_step: bool,
    /// Laser lines of the simulated drive
    #[arg(long, value_enum, default_value_t = simulate::Lines::L16)]
    lines: simulate::Lines,
    /// How long the simulated drive takes at most, in seconds: the whole of it takes 51
    #[arg(long, default_value_t = 15.0)]
    seconds: f64,
    /// Laps around the rack instead, with no other end
    #[arg(long, conflicts_with = "scans", value_parser = clap::value_parser!(u8).range(1..=20))]
    laps: Option<u8>,
    /// Whether loops are closed
    #[arg(long)]
    loops: bool,
    #[command(flatten)]
    common: CommonArgs,
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    // In a pool of its own: a call from outside of any wakes a thread up for each loop.
    let threads = usize::from(args.common.threads);
    agv_support::run(|| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        Ok(pool.install(|| run(&args).map_err(|error| error.to_string()))?) as Result<()>
    })
}

fn run(args: &Args) -> Result<()> {
    let drive = if args.scans.is_empty() { simulate::drive(args)? } else { load::load(args)? };
    if drive.scans.is_empty() {
        return Err(
            "there is no scan to follow: the simulated lidar turns ten times a second, so --seconds must be longer"
                .into(),
        );
    }
    let mut method = args.method.build(args)?;
    let (mut times, mut poses, mut unmatched) = (Timings::default(), Vec::<Se3>::new(), 0);
    let mut loops = args.loops.then(|| loops::Loops::new(args)).transpose()?;
    let progress = Progress::new(drive.scans.len(), "following");
    for scan in progress.over(&drive.scans) {
        let step = times.time(|| method.process(scan, None))?;
        unmatched += usize::from(step.alignment.is_some_and(|alignment| !alignment.converged()));
        poses.push(step.odom_from_base);
        if let Some(loops) = &mut loops {
            loops.process(&step, scan)?;
        }
    }
    drop(progress);
    let folder = args.common.out_folder("lidar_odometry")?;
    let corrected = loops.as_ref().map(loops::Loops::poses);
    pictures::write(&drive, corrected.as_ref().unwrap_or(&poses), &folder)?;
    let mut report = Report::new("Lidar odometry");
    report.text("method", args.method.name());
    report.count("scans", poses.len()).count("unmatched", unmatched);
    report.number("scan_ms_min", times.milliseconds(0.0));
    report.number("scan_ms_p50", times.milliseconds(50.0)).number("scan_ms_p99", times.milliseconds(99.0));
    judge::errors(&drive, &poses, &mut report)?;
    if let Some(loops) = &loops {
        loops.report(&drive, &mut report)?;
    }
    report.print(args.common.json)?;
    Ok(())
}
