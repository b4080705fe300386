//! Where is a vehicle among known landmarks, if neither its odometry nor its camera is calibrated?
//!
//! ```text
//! cargo run --release --example landmarks                                    # a simulated drive
//! cargo run --release --example landmarks -- --dir mrclam6 --robot 1         # a log of the MRCLAM data set
//! ```
//!
//! The filter starts at the true pose and learns from the sightings the odometry's scales and bias, what is lost in turns, the
//! latency between odometry and camera, and the camera's range and bearing errors. It is told that a camera measures depth and
//! that the odometry is what the drives were commanded; all else are the defaults of the library. The robots of the data set
//! share one make of drive: what its robot 1 taught is the prior of them all (`--uncalibrated`: nothing is known).
//!
//! The simulated vehicle is also switched on at 200 places where one image must do: above codes of the floor of which not one can be
//! read, and before a tag on a wall.
//!
//! You will see the errors against the truth, what was learnt, and pictures in `target/agv/landmarks/`; it takes a second.

use agv_nav::{core::metrics::Statistics, filters::landmark::Parameter};
use agv_support::{
    cli::{CommonArgs, Report},
    mrclam::MrclamLog,
    plot::{Color, Scene, TimeSeries},
};
use clap::Parser;
use std::{
    path::{Path as FilePath, PathBuf},
    process::ExitCode,
};

#[path = "landmarks/replay.rs"]
mod replay;
#[path = "landmarks/settings.rs"]
mod settings;
#[path = "landmarks/simulation.rs"]
mod simulation;
#[path = "landmarks/standing.rs"]
mod standing;

use replay::Replay;

/// Localise by landmarks, calibrating odometry and camera on the way.
#[derive(Parser)]
struct Args {
    /// Folder of an MRCLAM data set [default: a simulated drive]
    #[arg(long)]
    dir: Option<PathBuf>,
    /// Which robot of the data set
    #[arg(long, default_value_t = 1)]
    robot: u32,
    /// Start without what another robot of the make has taught
    #[arg(long)]
    uncalibrated: bool,
    #[command(flatten)]
    common: CommonArgs,
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let log = match &args.dir {
            Some(folder) => MrclamLog::read(folder, args.robot)?,
            None => simulation::drive(args.common.seed()),
        };
        let taught = args.dir.is_some() && !args.uncalibrated;
        let replay = replay::replay(&log, &settings::of_the_make(taught))?;
        let mut report = report(&replay)?;
        if args.dir.is_none() {
            standing::report(args.common.seed(), &mut report)?;
        }
        report.print(args.common.json)?;
        draw(&args.common.out_folder("landmarks")?, &log, &replay)
    })
}

fn report(replay: &Replay) -> Result<Report> {
    let statistics = |of: fn(&replay::Sample) -> f64| Statistics::new(replay.samples.iter().map(of).collect());
    let position = statistics(|one| one.error.x.hypot(one.error.y))?;
    let heading = statistics(|one| one.error.z)?;
    let mut report = Report::new("Localisation by landmarks");
    report
        .number("position_rmse_m", position.rmse())
        .number("position_median_m", position.median())
        .number("position_max_m", position.max())
        .number("heading_rmse_rad", heading.rmse())
        .number("nees_mean", statistics(|one| one.nees)?.mean())
        .number("nees_median", statistics(|one| one.nees)?.median())
        .count("used", replay.used)
        .count("rejected", replay.rejected);
    for (key, parameter) in [
        ("speed_scale", Parameter::SpeedScale),
        ("turn_loss_m", Parameter::TurnLoss),
        ("yaw_scale", Parameter::YawScale),
        ("yaw_bias_radps", Parameter::YawBias),
        ("latency_s", Parameter::Latency),
        ("range_scale", Parameter::RangeScale),
        ("range_bias_m", Parameter::RangeBias),
        ("bearing_bias_rad", Parameter::BearingBias),
        ("bearing_sine_rad", Parameter::BearingSine),
        ("bearing_cosine_rad", Parameter::BearingCosine),
    ] {
        if let Some(learnt) = replay.filter.learnt(parameter) {
            report.numbers(key, &[learnt.value, learnt.sigma]);
        }
    }
    Ok(report)
}

fn draw(out: &FilePath, log: &MrclamLog, replay: &Replay) -> Result<()> {
    let mut scene = Scene::new("Landmarks, truth and estimate")
        .trajectory("truth", Color::Green, replay.samples.iter().map(|one| &one.truth))
        .trajectory("estimate", Color::Blue, replay.samples.iter().map(|one| &one.estimate));
    for (index, (_, place)) in log.landmarks.iter().enumerate() {
        // One name for all of them.
        scene = scene.mark(if index == 0 { "landmarks" } else { "" }, Color::Red, *place);
    }
    scene.write(out.join("landmarks.svg"))?;
    TimeSeries::new("Error of the position", "time, s", "error, m")
        .curve("error", Color::Blue, replay.samples.iter().map(|one| (one.time, one.error.x.hypot(one.error.y))))
        .curve("standard deviation", Color::Grey, replay.samples.iter().map(|one| (one.time, one.position_sigma)))
        .write(out.join("landmarks_error.svg"))?;
    Ok(())
}
