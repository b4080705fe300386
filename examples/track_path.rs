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
//! 1 cm and half a degree of white noise, which a Kalman filter joins with the odometry of its encoders; `--feedback measured`
//! shows what the trackers do without that filter. They know the lag, and learn the slip by themselves.
//!
//! You will see a table of true errors, distances of the base from the path, from the start at rest to the end, over all
//! seeds, and pictures of the first seed in `target/agv/track_path/`; it takes a few seconds.

use agv_nav::{
    control::track::{
        FollowerParams, Lqr, LqrParams, Mpc, MpcParams, PidTracker, PidTrackerParams, PurePursuit, PurePursuitParams,
        Stanley, StanleyParams,
    },
    core::path::shapes,
    filters::kalman::{PoseFilter, PoseFilterParams},
    nalgebra::Vector2,
    prelude::*,
};
use agv_sim::{PathRun, PathRunParams, PathRunSample, PoseLocalizer};
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
    #[arg(long, default_value = "filtered")]
    feedback: FeedbackName,
    /// Time constant by which the drives really lag, in seconds; the trackers believe in 0.15 s
    #[arg(long, default_value_t = 0.15)]
    lag: f64,
    /// Share of every turn that is lost on the floor
    #[arg(long, default_value_t = 0.03)]
    yaw_slip: f64,
    /// Length over which the trackers read the path's turns as a bend, in metres: shorter is truer, and slower into corners
    #[arg(long, default_value_t = 0.2)]
    bend_window: f64,
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
    Stanley,
    Lqr,
    Mpc,
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
    /// The pose that a Kalman filter makes of it and the odometry
    Filtered,
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let out = args.common.out_folder("track_path")?;
        let trackers = args.tracker.map_or_else(|| TrackerName::value_variants().to_vec(), |one| vec![one]);
        let driven = |path: &PathName| args.path.map_or(*path != PathName::Bay, |one| one == *path);
        let paths: Vec<_> = PathName::value_variants().iter().copied().filter(driven).collect();
        let vehicle = vehicle(&args)?;
        let progress = Progress::new(trackers.len() * paths.len() * args.seeds as usize, "driving");
        let mut rows = Vec::new();
        for path in paths {
            let mut first_runs = Vec::new();
            for tracker in &trackers {
                let mut runs = drive(&args, &vehicle, *tracker, path, &progress)?;
                rows.push((*tracker, path, Figures::of(&runs, vehicle.dt)));
                first_runs.push((*tracker, runs.swap_remove(0)));
            }
            draw(&out, path, &first_runs)?;
        }
        drop(progress);
        report(&args, &rows)
    })
}

/// The vehicle that is asked for, as lazy and as slippery as it is asked for.
fn vehicle(args: &Args) -> Result<PathRunParams> {
    let mut params = match args.vehicle {
        VehicleName::Differential => PathRunParams::differential(),
        VehicleName::Ackermann => PathRunParams::ackermann()?,
        VehicleName::Omnidirectional => PathRunParams::omnidirectional()?,
    };
    (params.vehicle.time_constant, params.vehicle.steering_time_constant) = (args.lag, args.lag);
    params.vehicle.slip.yaw = args.yaw_slip;
    Ok(params)
}

/// One run per seed.
fn drive(
    args: &Args,
    vehicle: &PathRunParams,
    tracker: TrackerName,
    path: PathName,
    progress: &Progress,
) -> Result<Vec<PathRun>> {
    let path = path.path()?;
    let seeds = (0..args.seeds).map(|i| Seed(args.common.seed.wrapping_add(i)));
    let run = |seed| {
        let (mut tracker, mut filter) = (tracker.build(args)?, PoseFilter::new(PoseFilterParams::default())?);
        let localizer = (args.feedback == FeedbackName::Filtered).then_some(&mut filter as &mut PoseLocalizer);
        Ok(vehicle.drive(tracker.as_mut(), localizer, &path, seed)?)
    };
    progress.over(seeds).map(run).collect()
}

impl TrackerName {
    /// The tracker with its defaults, but for what all share: a short window for bends that the path states point by point, and
    /// no care for what it carries.
    fn build(self, args: &Args) -> Result<Box<dyn PathTracker>> {
        let follower =
            FollowerParams { bend_window: args.bend_window, lateral_acceleration: 2.0, ..FollowerParams::default() };
        Ok(match self {
            Self::PurePursuit => {
                Box::new(PurePursuit::new(PurePursuitParams { follower, ..PurePursuitParams::default() })?)
            }
            Self::Pid => Box::new(PidTracker::new(PidTrackerParams { follower, ..PidTrackerParams::default() })?),
            Self::Stanley => Box::new(Stanley::new(StanleyParams { follower, ..StanleyParams::default() })?),
            Self::Lqr => Box::new(Lqr::new(LqrParams { follower, ..LqrParams::default() })?),
            Self::Mpc => Box::new(Mpc::new(MpcParams { follower, ..MpcParams::default() })?),
        })
    }

    const fn name(self) -> &'static str {
        match self {
            Self::PurePursuit => "pure_pursuit",
            Self::Pid => "pid",
            Self::Stanley => "stanley",
            Self::Lqr => "lqr",
            Self::Mpc => "mpc",
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
    /// Root mean square of how far off the vehicle believed itself to be, in metres.
    estimate_rmse: f64,
    mean_speed: f64,
    max_yaw_rate: f64,
    /// Root mean square of the change of the commanded turn rate, in rad/s²: what the drives have to work.
    yaw_acceleration: f64,
    violations: usize,
}

impl Figures {
    fn of(runs: &[PathRun], dt: f64) -> Self {
        let greatest = |of: &dyn Fn(&PathRun) -> f64| runs.iter().map(of).fold(0.0, f64::max);
        let samples = || runs.iter().flat_map(|run| &run.samples);
        let mean = |of: &dyn Fn(&PathRunSample) -> f64| samples().map(of).sum::<f64>() / samples().count() as f64;
        let changes = runs.iter().flat_map(|run| run.samples.windows(2));
        let changes = changes.map(|pair| (pair[1].command.twist.yaw_rate - pair[0].command.twist.yaw_rate) / dt);
        let yaw_acceleration = (changes.map(|change| change * change).sum::<f64>() / samples().count() as f64).sqrt();
        Self {
            runs: runs.len(),
            arrived: runs.iter().filter(|run| run.arrived).count(),
            rmse: mean(&|sample| sample.cross_track.powi(2)).sqrt(),
            rmse_worst: greatest(&PathRun::rmse),
            max: greatest(&PathRun::max),
            final_position_error: greatest(&PathRun::final_position_error),
            final_heading_error: greatest(&PathRun::final_heading_error),
            estimate_rmse: mean(&|sample| (sample.estimate.translation() - sample.truth.translation()).norm_squared())
                .sqrt(),
            mean_speed: mean(&|sample| sample.twist.speed()),
            max_yaw_rate: samples().map(|sample| sample.command.twist.yaw_rate.abs()).fold(0.0, f64::max),
            yaw_acceleration,
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
            .number("estimate_rmse_m", self.estimate_rmse)
            .number("mean_speed_mps", self.mean_speed)
            .number("max_yaw_rate_rad_per_s", self.max_yaw_rate)
            .number("yaw_acceleration_rms_rad_per_s2", self.yaw_acceleration)
            .count("limit_violations", self.violations);
    }
}

/// The whole of one combination, or a line for each of several.
fn report(args: &Args, rows: &[(TrackerName, PathName, Figures)]) -> Result<()> {
    let vehicle = args.vehicle.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default();
    if args.common.json || rows.len() == 1 {
        let of = |(tracker, path, figures): &(TrackerName, PathName, Figures)| {
            let mut report = Report::new("Tracking a path");
            report.text("tracker", tracker.name()).text("path", path.name()).text("vehicle", vehicle.clone());
            figures.add_to(&mut report);
            report
        };
        let mut reports: Vec<Report> = rows.iter().map(of).collect();
        let mut all = Report::new("Tracking paths");
        let report = if reports.len() == 1 { &reports.remove(0) } else { all.reports("runs", reports) };
        return Ok(report.print(args.common.json)?);
    }
    println!("Tracking paths: {vehicle}, {} seed(s) from {}; errors in cm and degrees", args.seeds, args.common.seed);
    println!("  path   tracker        rmse   worst     max | end, cm   deg | m/s  rad/s  rad/s² | arrived  violations");
    for (tracker, path, f) in rows {
        println!(
            "  {:6} {:12} {:6.2}  {:6.2}  {:6.2} |  {:6.2} {:5.2} | {:4.2}  {:5.2}  {:6.2} | {:>7}  {:>10}",
            path.name(),
            tracker.name(),
            100.0 * f.rmse,
            100.0 * f.rmse_worst,
            100.0 * f.max,
            100.0 * f.final_position_error,
            f.final_heading_error.to_degrees(),
            f.mean_speed,
            f.max_yaw_rate,
            f.yaw_acceleration,
            format!("{}/{}", f.arrived, f.runs),
            f.violations,
        );
    }
    Ok(())
}

const COLORS: [Color; 5] = [Color::Purple, Color::Orange, Color::Green, Color::Blue, Color::Red];

/// Draws the first run of each tracker: from above and the errors; of a tracker that runs alone also what was told and done.
fn draw(out: &FilePath, path: PathName, runs: &[(TrackerName, PathRun)]) -> Result<()> {
    let alone = (runs.len() == 1).then_some(&runs[0]);
    let name = alone.map_or(path.name().to_owned(), |(tracker, _)| format!("{}_{}", path.name(), tracker.name()));
    let over_time = |run: &PathRun, of: &dyn Fn(&PathRunSample) -> f64| -> Vec<(f64, f64)> {
        run.samples.iter().map(|sample| (sample.time, of(sample))).collect()
    };
    let planned: Vec<Se2> = path.path()?.points().iter().map(|point| point.pose).collect();
    let mut scene = Scene::new(format!("Driven: {name}")).trajectory("path", Color::Grey, &planned);
    let mut errors = TimeSeries::new(format!("Distance from the path: {name}"), "time, s", "cross-track, cm");
    for ((tracker, run), color) in runs.iter().zip(COLORS) {
        scene = scene.trajectory(tracker.name(), color, run.samples.iter().map(|sample| &sample.truth));
        errors = errors.curve(tracker.name(), color, over_time(run, &|sample| 100.0 * sample.cross_track));
    }
    if let (Some(first), Some(last)) = (planned.first(), planned.last()) {
        scene = scene.mark("start", Color::Sky, first.translation()).mark("end", Color::Black, last.translation());
    }
    scene.write(out.join(format!("{name}.png")))?;
    errors.write(out.join(format!("{name}_error.png")))?;
    if let Some((_, run)) = alone {
        TimeSeries::new(format!("Told and done: {name}"), "time, s", "m/s, rad/s")
            .curve("speed told", Color::Sky, over_time(run, &|sample| sample.command.twist.vx))
            .curve("speed", Color::Blue, over_time(run, &|sample| sample.twist.vx))
            .curve("turn rate told", Color::Orange, over_time(run, &|sample| sample.command.twist.yaw_rate))
            .curve("turn rate", Color::Red, over_time(run, &|sample| sample.twist.yaw_rate))
            .write(out.join(format!("{name}_twist.png")))?;
    }
    Ok(())
}
