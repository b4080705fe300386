//! A map of landmarks from a drive: SLAM with trees, tubes or radio beacons.
//!
//! ```text
//! cargo run --release --example landmark_slam                                      # a simulated drive among trees that look alike
//! cargo run --release --example landmark_slam -- --data victoria_park.txt.gz
//! cargo run --release --example landmark_slam -- --data Plaza1_DR.txt.gz --reference plaza1.tum
//! cargo run --release --example landmark_slam -- --data mrpt_kfslam_demo_rb.txt.gz --association known
//! ```
//!
//! The log is of one of the formats of `docs/formats.md`, told apart by their lines; files that belong together are found side by side. How much
//! odometry and sensor err is found by the log itself, without the truth. `--association joint` and `nearest` do not look at the landmarks' names, except to judge.
//!
//! You will see how long an update takes, how many landmarks there are, and the errors against the truth as far as it is known. In
//! `target/agv/landmark_slam/`: `trajectory.tum`, `landmarks.txt` (number, x, y) and `landmarks.svg`. It takes a second or two.

#[path = "landmark_slam/calibrate.rs"]
mod calibrate;
#[path = "landmark_slam/graph.rs"]
mod graph;
#[path = "landmark_slam/judge.rs"]
mod judge;
#[path = "landmark_slam/pictures.rs"]
mod pictures;
#[path = "landmark_slam/replay.rs"]
mod replay;
#[path = "landmark_slam/settings.rs"]
mod settings;
#[path = "landmark_slam/simulation.rs"]
mod simulation;

use agv_support::{
    cli::{CommonArgs, Report},
    landmark_log::{self, LandmarkFormat, LandmarkLog},
    trajectory,
};
use clap::Parser;
use std::{path::PathBuf, process::ExitCode};

/// Map landmarks on the way.
#[derive(Parser)]
struct Args {
    /// A file of the log [default: a simulated drive]
    #[arg(long)]
    data: Option<PathBuf>,
    /// Format of the log [default: told by its lines]
    #[arg(long, value_enum, requires = "data")]
    format: Option<LandmarkFormat>,
    /// What makes the map
    #[arg(long, value_enum, default_value_t = replay::Method::Ekf)]
    method: replay::Method,
    /// How sightings find their landmarks [default: known for ranges, else joint]
    #[arg(long, value_enum)]
    association: Option<settings::Finding>,
    /// Reference poses (TUM) with the log's clock
    #[arg(long, requires = "data")]
    reference: Option<PathBuf>,
    /// True places of the landmarks: number, x, y
    #[arg(long, requires = "data")]
    landmarks: Option<PathBuf>,
    /// Believe the deviations that the log states, or the defaults, in place of those that the log itself tells
    #[arg(long)]
    stated_noise: bool,
    /// Hold errors in each coordinate by itself, as textbooks do, for comparison
    #[arg(long)]
    additive: bool,
    #[command(flatten)]
    common: CommonArgs,
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let out = args.common.out_folder("landmark_slam")?;
        let log = load(&args)?;
        let mut settings = settings::of(&log, &args)?;
        if !args.stated_noise {
            settings = calibrate::calibrate(&log, &settings)?;
        }
        let mut report = Report::new("A map of landmarks");
        let run = match args.method {
            replay::Method::Ekf => replay::run(&log, &settings)?,
            replay::Method::Graph => {
                let (run, merged) = graph::run(&log, &settings)?;
                report.count("landmarks_merged", merged);
                run
            }
        };
        judge::report(&log, &run, &mut report)?;
        report.numbers("noise_factors", &settings.factors);
        pictures::write(&out, &log, &run)?;
        report.print(args.common.json)?;
        Result::Ok(())
    })
}

fn load(args: &Args) -> Result<LandmarkLog> {
    let Some(path) = &args.data else { return Ok(simulation::drive(args.common.seed())) };
    let mut log = landmark_log::read(path, args.format)?;
    if let Some(path) = &args.reference {
        let poses = trajectory::read_tum(path)?;
        log.reference = poses.into_iter().map(|at| (at.stamp, at.pose.to_planar())).collect();
    }
    if let Some(path) = &args.landmarks {
        log.landmarks = landmark_log::read_places(path)?;
    }
    if log.steps.is_empty() {
        return Err("the log has no steps".into());
    }
    Ok(log)
}
