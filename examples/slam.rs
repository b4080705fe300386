//! A map from a recorded drive: 2D SLAM on laser scans and raw odometry.
//!
//! ```text
//! cargo run --release --example slam                                    # the shipped drive, by graph SLAM
//! cargo run --release --example slam -- --scans drive.csv.gz --relations drive.relations.gz
//! cargo run --release --example slam -- --scans drive.log.gz --no-odometry
//! cargo run --release --example slam -- --scans drive.csv.gz --method rbpf --seed 3
//! ```
//!
//! The log may be of any format of `docs/formats.md`; the settings are the library's defaults for every log. Without one it runs on
//! the drive around the corridors of the Intel Research Lab that the repository has (`data/intel/README.md`).
//!
//! You will see how many scans a second that is, how much memory it took, and the errors against relations (Kümmerle et al.,
//! *On measuring the accuracy of SLAM algorithms*, 2009) and reference poses, as far as there are any. In `target/agv/slam/`:
//! `map.yaml` and `map.pgm`, which ROS's `map_server` loads, `trajectory.tum` with a pose for each scan, and `map.png`, the map with the
//! way. It takes some seconds.

#[path = "slam/graph.rs"]
mod graph;
#[path = "slam/judge.rs"]
mod judge;
#[path = "slam/load.rs"]
mod load;
#[path = "slam/methods.rs"]
mod methods;
#[path = "slam/particles.rs"]
mod particles;
#[path = "slam/pictures.rs"]
mod pictures;

use agv_support::cli::{CommonArgs, Report};
use clap::Parser;
use std::{path::PathBuf, process::ExitCode};

/// Make a map of a recorded drive.
#[derive(Parser)]
struct Args {
    /// Scans and odometry [default: the shipped drive]
    #[arg(long)]
    scans: Option<PathBuf>,
    /// What makes the map
    #[arg(long, value_enum, default_value_t = methods::Kind::Graph)]
    method: methods::Kind,
    /// Relations between moments of the drive (Kümmerle et al.)
    #[arg(long)]
    relations: Option<PathBuf>,
    /// Reference poses of the drive: one per scan, or with the same clock
    #[arg(long, requires = "scans")]
    reference: Option<PathBuf>,
    /// Leave the odometry out: scans alone
    #[arg(long)]
    no_odometry: bool,
    /// Particles of the filter
    #[arg(long, default_value_t = 30)]
    particles: usize,
    /// The laser is mounted upside down, and the log does not know
    #[arg(long)]
    upside_down: bool,
    #[command(flatten)]
    common: CommonArgs,
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let out = args.common.out_folder("slam")?;
        let drive = load::read(&args)?;
        let run = methods::run(&args, &drive)?;
        let mut report = Report::new("A map of a recorded drive");
        judge::report(&drive, &run, &mut report)?;
        pictures::write(&out, &drive, &run)?;
        report.print(args.common.json)?;
        Result::Ok(())
    })
}
