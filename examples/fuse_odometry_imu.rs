//! What does an IMU bring? Paper 000, Figs. 13 to 16: a vehicle drives from (3, 3) by (9, -3) to (12, 0) with odometry that turns
//! away from the truth; a Kalman filter joins it with an IMU, and a particle filter with a laser moves by one or the other.
//!
//! ```text
//! cargo run --release --example fuse_odometry_imu                  # ten seeds
//! cargo run --release --example fuse_odometry_imu -- --seeds 100
//! cargo run --release --example fuse_odometry_imu -- --imu-delay 0.1
//! cargo run --release --example fuse_odometry_imu -- --mean-of-particles
//! cargo run --release --example fuse_odometry_imu -- --resolution 0.02
//! ```
//!
//! The paper does not state the noise. Here the odometry reads turns 3 % too large and adds 0.02 rad per metre, beside white noise;
//! the IMU's heading has 0.01 rad of white noise. There are two lasers, of 1 m range as the paper prints it, and of 10 m.
//!
//! You will see the largest errors of each estimate over the drive, the mean over all seeds and the worst, how often the fused
//! prior does worse than the odometry, and pictures of the first seed in `target/agv/fuse_odometry_imu/`; it takes some seconds.

#[path = "fuse_odometry_imu/drive.rs"]
mod drive;
#[path = "fuse_odometry_imu/estimates.rs"]
mod estimates;

use agv_nav::{core::metrics::Statistics, prelude::*};
use agv_support::{
    cli::{CommonArgs, Report},
    plot::{Color, Scene, TimeSeries},
    progress::Progress,
};
use clap::Parser;
use drive::{Drive, Hall};
use estimates::{Errors, Estimates, LASERS};
use std::{path::Path as FilePath, process::ExitCode};

/// Join odometry and IMU, and move a particle filter by what they say together.
#[derive(Parser)]
struct Args {
    /// Number of seeds, from `--seed` on
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: u64,
    /// Particles of the particle filters
    #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    particles: u32,
    /// Least deviation of a motion that the Kalman filter hands to the particles, as a share of it
    #[arg(long, default_value_t = 0.02)]
    prior_share: f64,
    /// How late the samples of the IMU reach the Kalman filter, in seconds
    #[arg(long, default_value_t = 0.0)]
    imu_delay: f64,
    /// Take the mean of the particles, as the paper does, instead of the peak of the scan's likelihood near it
    #[arg(long)]
    mean_of_particles: bool,
    /// Edge of a cell of the map, in metres: the estimates are off by up to half of it
    #[arg(long, default_value_t = 0.05, value_parser = cell_edge)]
    resolution: f64,
    #[command(flatten)]
    common: CommonArgs,
}

/// So short that a box has cells.
fn cell_edge(text: &str) -> std::result::Result<f64, String> {
    match text.parse() {
        Ok(edge) if (0.005..=0.2).contains(&edge) => Ok(edge),
        _ => Err("not from 0.005 to 0.2 m".into()),
    }
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let out = args.common.out_folder("fuse_odometry_imu")?;
        let hall = Hall::new(args.resolution)?;
        let (mut errors, mut first) = (Vec::new(), None);
        let progress = Progress::new(args.seeds as usize, "driving");
        for seed in progress.over(args.common.seeds(args.seeds)) {
            let drive = Drive::new(&hall, seed)?;
            let estimates = Estimates::of(&drive, &hall, &args, seed)?;
            errors.push(estimates.errors(&drive)?);
            first.get_or_insert((drive, estimates));
        }
        drop(progress);
        if let Some((drive, estimates)) = &first {
            draw(&out, &hall, drive, estimates)?;
        }
        report(&args, &errors)
    })
}

fn report(args: &Args, runs: &[Errors]) -> Result<()> {
    let all = |of: &dyn Fn(&Errors) -> f64| Statistics::new(runs.iter().map(of).collect::<Vec<_>>());
    let (odometry, fused) = (all(&|run| run.odometry)?, all(&|run| run.fused)?);
    let mut report = Report::new("Odometry and IMU, joined");
    report
        .count("seeds", runs.len())
        .number("odometry_max_m", odometry.mean())
        .number("ekf_max_m", fused.mean())
        .number("ekf_worst_m", fused.max())
        .number("ekf_reduction_percent", 100.0 * (1.0 - fused.mean() / odometry.mean()))
        .number("ekf_reduction_least_percent", 100.0 * all(&|run| 1.0 - run.fused / run.odometry)?.min())
        .number("odometry_heading_max_deg", all(&|run| run.odometry_heading)?.mean())
        .number("ekf_heading_max_deg", all(&|run| run.fused_heading)?.mean());
    for (i, (name, _)) in LASERS.iter().enumerate() {
        let (alone, with_prior) = (all(&|run| run.alone[i])?, all(&|run| run.with_prior[i])?);
        let (alone_rms, with_prior_rms) = (all(&|run| run.alone_rms[i])?, all(&|run| run.with_prior_rms[i])?);
        let worse =
            |a: &dyn Fn(&Errors) -> f64, b: &dyn Fn(&Errors) -> f64| runs.iter().filter(|run| a(run) > b(run)).count();
        report
            .number(&format!("mcl_{name}_max_m"), alone.mean())
            .number(&format!("mcl_{name}_worst_m"), alone.max())
            .number(&format!("mcl_ekf_{name}_max_m"), with_prior.mean())
            .number(&format!("mcl_ekf_{name}_worst_m"), with_prior.max())
            .count(&format!("mcl_ekf_{name}_worse"), worse(&|run| run.with_prior[i], &|run| run.alone[i]))
            .number(&format!("mcl_ekf_{name}_worse_by_m"), all(&|run| run.with_prior[i] - run.alone[i])?.max())
            .number(&format!("mcl_{name}_rmse_m"), alone_rms.mean())
            .number(&format!("mcl_ekf_{name}_rmse_m"), with_prior_rms.mean())
            .count(&format!("mcl_ekf_{name}_rmse_worse"), worse(&|run| run.with_prior_rms[i], &|run| run.alone_rms[i]));
    }
    report.print(args.common.json)?;
    Ok(())
}

/// The paper's Figs. 13 to 16: tracks without and with the filter, and headings over time.
fn draw(out: &FilePath, hall: &Hall, drive: &Drive, estimates: &Estimates) -> Result<()> {
    let truth = drive.truths();
    let scene = |title: &str| Scene::new(title).map(&hall.map).trajectory("truth", Color::Green, &truth);
    scene("Odometry alone").trajectory("odometry", Color::Red, &estimates.odometry).write(out.join("odometry.png"))?;
    scene("Odometry and IMU, joined")
        .trajectory("odometry", Color::Grey, &estimates.odometry)
        .trajectory("Kalman filter", Color::Blue, &estimates.fused)
        .write(out.join("fused.png"))?;
    for (i, (name, range)) in LASERS.iter().enumerate() {
        scene(&format!("Particle filter with a laser of {range} m"))
            .trajectory("moved by odometry", Color::Orange, &estimates.alone[i])
            .trajectory("moved by the Kalman filter", Color::Blue, &estimates.with_prior[i])
            .write(out.join(format!("mcl_{name}.png")))?;
    }
    let times = drive.steps.iter().map(|step| step.truth.stamp.seconds());
    let over_time = |values: Vec<f64>| times.clone().zip(values).collect::<Vec<_>>();
    let headings = |poses: &[Se2]| over_time(poses.iter().map(|pose| pose.yaw().to_degrees()).collect());
    TimeSeries::new("Heading", "time, s", "heading, deg")
        .curve("truth", Color::Green, headings(&truth))
        .curve("odometry", Color::Red, headings(&estimates.odometry))
        .curve("Kalman filter", Color::Blue, headings(&estimates.fused))
        .write(out.join("heading.svg"))?;
    let errors = |poses: &[Se2]| over_time(estimates::distances(poses, &truth));
    TimeSeries::new("Error of the position", "time, s", "error, m")
        .curve("odometry", Color::Red, errors(&estimates.odometry))
        .curve("Kalman filter", Color::Blue, errors(&estimates.fused))
        .curve("particles by odometry, 1 m", Color::Orange, errors(&estimates.alone[0]))
        .curve("particles by the filter, 1 m", Color::Purple, errors(&estimates.with_prior[0]))
        .write(out.join("errors.svg"))?;
    Ok(())
}
