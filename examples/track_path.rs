//! How well do path trackers track? Every tracker on a line, an S-curve, a figure of eight and through a warehouse aisle, with
//! lagging drives, slip and a noisy pose.
//!
//! ```text
//! cargo run --release --example track_path                                            # all trackers on all paths, one seed
//! cargo run --release --example track_path -- --tracker lqr --path eight --seeds 100
//! cargo run --release --example track_path -- --vehicle ackermann --path bay
//! ```
//!
//! The vehicle drives at 1 m/s where its path allows: at most 1 m/s² along, 2 rad/s and 4 rad/s² about, 2 m/s² to the side; 0.5 m/s
//! in reverse. Its drives lag by 0.15 s, 3 % of every turn is lost on the floor, and its pose is measured 50 times a second with
//! 1 cm and half a degree of white noise. A Kalman filter joins those poses with the wheels' odometry, and the tracker steers
//! the pose led by the lag; `--feedback measured` shows what it would do without.
//!
//! You will see a table of true errors, distances of the base from the path, from the start at rest to the end, over all
//! seeds, and pictures of the first seed in `target/agv/track_path/`; it takes a few seconds.

use agv_nav::{
    control::track::{FollowerParams, PidTracker, PidTrackerParams, PurePursuit, PurePursuitParams},
    core::path::shapes,
    filters::kalman::{PoseFilter, PoseFilterParams},
    nalgebra::Vector2,
    prelude::*,
};
use agv_sim::{Feedback, PathRun, PathRunParams, PoseLocalizer};
use agv_support::{
    cli::{CommonArgs, Report},
    plot::{Color, Scene, TimeSeries},
    progress::Progress,
};
use clap::{Parser, ValueEnum};
use std::{path::Path as FilePath, process::ExitCode};

/// Let path trackers drive, and judge them by the ground truth.
#[derive(Parser)]
struct Args {
    /// Path tracker [default: all]
    #[arg(long)]
    tracker: Option<TrackerName>,
    /// Path to drive [default: all but `bay`]
    #[arg(long)]
    path: Option<PathName>,
    /// Vehicle that drives
    #[arg(long, default_value = "differential")]
    vehicle: VehicleName,
    /// What the tracker is fed with
    #[arg(long, default_value = "led")]
    feedback: FeedbackName,
    /// Number of seeds, from `--seed` on
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: u64,
    #[command(flatten)]
    common: CommonArgs,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
#[value(rename_all = "snake_case")]
enum TrackerName {
    PurePursuit,
    Pid,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum PathName {
    /// 5 m straight on
    Line,
    /// A change of lane by 2 m over 6 m
    S,
    /// The lemniscate of Gerono, 6 m wide
    Eight,
    /// Warehouse aisles with 90° corners of 0.6 m radius
    Aisle,
    /// Ahead, and tail first into a bay, with a cusp
    Bay,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum VehicleName {
    /// Two driven wheels
    Differential,
    /// A steered front axle, half a metre of wheelbase
    Ackermann,
    /// Four mecanum wheels
    Omnidirectional,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum FeedbackName {
    /// The pose as it is measured
    Measured,
    /// The pose after the Kalman filter
    Filtered,
    /// The filtered pose, led by the lag of the drives
    Led,
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let out = args.common.out_folder("track_path")?;
        let trackers = args.tracker.map_or_else(|| TrackerName::value_variants().to_vec(), |one| vec![one]);
        let driven = |path: &PathName| args.path.map_or(*path != PathName::Bay, |one| one == *path);
        let paths: Vec<_> = PathName::value_variants().iter().copied().filter(driven).collect();
        let vehicle = args.vehicle.params()?;
        let progress = Progress::new(trackers.len() * paths.len() * args.seeds as usize, "driving");
        let mut rows = Vec::new();
        for path in paths {
            for tracker in &trackers {
                let runs = drive(&args, &vehicle, *tracker, path, &progress)?;
                draw(&out, &args, *tracker, path, &runs)?;
                rows.push((*tracker, path, Figures::of(&runs)));
            }
        }
        drop(progress);
        report(&args, &rows)
    })
}

/// One run per seed.
fn drive(
    args: &Args,
    vehicle: &PathRunParams,
    tracker: TrackerName,
    path: PathName,
    progress: &Progress,
) -> Result<Vec<PathRun>> {
    let (path, mut tracker) = (path.path()?, tracker.build()?);
    let mut filter = PoseFilter::new(PoseFilterParams::default())?;
    let seeds = (0..args.seeds).map(|i| Seed(args.common.seed.wrapping_add(i)));
    let run = |seed| {
        let localizer = (args.feedback != FeedbackName::Measured).then_some(&mut filter as &mut PoseLocalizer);
        let lead = if args.feedback == FeedbackName::Led { vehicle.vehicle.time_constant } else { 0.0 };
        Ok(vehicle.drive(tracker.as_mut(), Feedback { localizer, lead }, &path, seed)?)
    };
    progress.over(seeds).map(run).collect()
}

impl TrackerName {
    /// The tracker with its defaults, but for what all share: a short window for bends that the path states point by point, and
    /// no care for what it carries.
    fn build(self) -> Result<Box<dyn PathTracker>> {
        let follower = FollowerParams { bend_window: 0.2, lateral_acceleration: 2.0, ..FollowerParams::default() };
        Ok(match self {
            Self::PurePursuit => {
                Box::new(PurePursuit::new(PurePursuitParams { follower, ..PurePursuitParams::default() })?)
            }
            Self::Pid => Box::new(PidTracker::new(PidTrackerParams { follower, ..PidTrackerParams::default() })?),
        })
    }

    const fn name(self) -> &'static str {
        match self {
            Self::PurePursuit => "pure_pursuit",
            Self::Pid => "pid",
        }
    }
}

impl PathName {
    /// The path, a point every 2 cm.
    fn path(self) -> Result<Path> {
        let spacing = 0.02;
        Ok(match self {
            Self::Line => shapes::line(5.0, spacing)?,
            Self::S => shapes::s_curve(6.0, 2.0, spacing)?,
            Self::Eight => shapes::lemniscate(3.0, spacing)?,
            Self::Aisle => {
                let corners = [(0.0, 0.0), (5.0, 0.0), (5.0, 2.5), (0.0, 2.5), (0.0, 5.0), (5.0, 5.0)];
                shapes::rounded(&corners.map(|(x, y)| Vector2::new(x, y)), 0.6, spacing)?
            }
            Self::Bay => shapes::reverse_into_bay(1.5, 0.8, spacing)?,
        })
    }

    const fn name(self) -> &'static str {
        match self {
            Self::Line => "line",
            Self::S => "s",
            Self::Eight => "eight",
            Self::Aisle => "aisle",
            Self::Bay => "bay",
        }
    }
}

impl VehicleName {
    fn params(self) -> Result<PathRunParams> {
        Ok(match self {
            Self::Differential => PathRunParams::differential(),
            Self::Ackermann => PathRunParams::ackermann()?,
            Self::Omnidirectional => PathRunParams::omnidirectional()?,
        })
    }
}

/// What a tracker did on a path, over all seeds.
struct Figures {
    runs: usize,
    arrived: usize,
    /// Root mean square over all cycles of all runs, in metres.
    rmse: f64,
    /// Root mean square of the worst run, in metres.
    rmse_worst: f64,
    /// Greatest of all errors, in metres.
    max: f64,
    final_position_error: f64,
    final_heading_error: f64,
    mean_speed: f64,
    max_yaw_rate: f64,
    violations: usize,
}

impl Figures {
    fn of(runs: &[PathRun]) -> Self {
        let greatest = |of: &dyn Fn(&PathRun) -> f64| runs.iter().map(of).fold(0.0, f64::max);
        let samples = || runs.iter().flat_map(|run| &run.samples);
        let mean =
            |of: &dyn Fn(&agv_sim::PathRunSample) -> f64| samples().map(of).sum::<f64>() / samples().count() as f64;
        Self {
            runs: runs.len(),
            arrived: runs.iter().filter(|run| run.arrived).count(),
            rmse: mean(&|sample| sample.cross_track.powi(2)).sqrt(),
            rmse_worst: greatest(&PathRun::rmse),
            max: greatest(&PathRun::max),
            final_position_error: greatest(&PathRun::final_position_error),
            final_heading_error: greatest(&PathRun::final_heading_error),
            mean_speed: mean(&|sample| sample.twist.speed()),
            max_yaw_rate: samples().map(|sample| sample.command.twist.yaw_rate.abs()).fold(0.0, f64::max),
            violations: runs.iter().map(|run| run.violations).sum(),
        }
    }

    fn add_to(&self, report: &mut Report) {
        report
            .count("seeds", self.runs)
            .count("arrived", self.arrived)
            .number("rmse_m", self.rmse)
            .number("rmse_worst_run_m", self.rmse_worst)
            .number("max_m", self.max)
            .number("final_position_error_m", self.final_position_error)
            .number("final_heading_error_rad", self.final_heading_error)
            .number("mean_speed_mps", self.mean_speed)
            .number("max_yaw_rate_rad_per_s", self.max_yaw_rate)
            .count("limit_violations", self.violations);
    }
}

/// The whole of one combination, or a line for each of several.
fn report(args: &Args, rows: &[(TrackerName, PathName, Figures)]) -> Result<()> {
    let vehicle = args.vehicle.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default();
    if args.common.json || rows.len() == 1 {
        for (tracker, path, figures) in rows {
            let mut report = Report::new("Tracking a path");
            report.text("tracker", tracker.name()).text("path", path.name()).text("vehicle", vehicle.clone());
            figures.add_to(&mut report);
            report.print(args.common.json)?;
        }
        return Ok(());
    }
    println!("Tracking paths: {vehicle}, {} seed(s) from {}; errors in cm and degrees", args.seeds, args.common.seed);
    println!("  path   tracker        rmse   worst     max | end, cm   deg | m/s  rad/s | arrived  violations");
    for (tracker, path, f) in rows {
        println!(
            "  {:6} {:12} {:6.2}  {:6.2}  {:6.2} |  {:6.2} {:5.2} | {:4.2}  {:4.2} | {:>7}  {:>10}",
            path.name(),
            tracker.name(),
            100.0 * f.rmse,
            100.0 * f.rmse_worst,
            100.0 * f.max,
            100.0 * f.final_position_error,
            f.final_heading_error.to_degrees(),
            f.mean_speed,
            f.max_yaw_rate,
            format!("{}/{}", f.arrived, f.runs),
            f.violations,
        );
    }
    Ok(())
}

/// Draws the first run: from above, its error, and what was commanded and done.
fn draw(out: &FilePath, args: &Args, tracker: TrackerName, path: PathName, runs: &[PathRun]) -> Result<()> {
    let Some(run) = runs.first() else { return Ok(()) };
    let (name, vehicle) = (format!("{}_{}", path.name(), tracker.name()), args.vehicle.to_possible_value());
    let vehicle = vehicle.map(|value| value.get_name().to_owned()).unwrap_or_default();
    let title = format!("{} on {}, {vehicle}", tracker.name(), path.name());
    let over_time = |of: &dyn Fn(&agv_sim::PathRunSample) -> f64| -> Vec<(f64, f64)> {
        run.samples.iter().map(|sample| (sample.time, of(sample))).collect()
    };
    let planned: Vec<Se2> = path.path()?.points().iter().map(|point| point.pose).collect();
    let driven: Vec<Se2> = run.samples.iter().map(|sample| sample.truth).collect();
    let mut scene = Scene::new(title.clone()).trajectory("path", Color::Orange, &planned);
    scene = scene.trajectory("driven", Color::Blue, &driven);
    if let (Some(first), Some(last)) = (planned.first(), planned.last()) {
        scene = scene.mark("start", Color::Green, first.translation()).mark("end", Color::Red, last.translation());
    }
    scene.write(out.join(format!("{name}.png")))?;
    TimeSeries::new(format!("{title}: distance from the path"), "time, s", "cross-track, cm")
        .curve("", Color::Blue, over_time(&|sample| 100.0 * sample.cross_track))
        .write(out.join(format!("{name}_error.png")))?;
    TimeSeries::new(format!("{title}: commanded and driven"), "time, s", "m/s, rad/s")
        .curve("speed told", Color::Sky, over_time(&|sample| sample.command.twist.vx))
        .curve("speed", Color::Blue, over_time(&|sample| sample.twist.vx))
        .curve("turn rate told", Color::Orange, over_time(&|sample| sample.command.twist.yaw_rate))
        .curve("turn rate", Color::Red, over_time(&|sample| sample.twist.yaw_rate))
        .write(out.join(format!("{name}_twist.png")))?;
    Ok(())
}
