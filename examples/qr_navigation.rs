//! What do codes on the floor bring? Laps through a ring of QR codes by laser, by codes, and by both (paper 001, Tables 2, 4
//! and 5, Figs. 19 and 20).
//!
//! ```text
//! cargo run --release --example qr_navigation                    # ten seeds, two laps each
//! cargo run --release --example qr_navigation -- --seeds 100     # the figures of docs/experiments.md; half a minute
//! cargo run --release --example qr_navigation -- --damaged 0.5
//! ```
//!
//! A differential vehicle drives laps of 18.3 m in a room of 10 m by 10 m, within the paper's limits (1 m/s, 1 rad/s, 0.5 m/s²,
//! 0.5 rad/s²), and stops at a station after each; before the first lap it is turned off the path by 60°. Its laser (320°, 10 m,
//! 2 cm) feeds a particle filter of 1500 particles; its camera looks at codes of 10 cm every half a metre, one in five of
//! which cannot be read and is known by its place, where the pose is known well enough. The pixels of their finder patterns are simulated, half a pixel of noise, and everything from there
//! on is what a vehicle would do. At the station, vehicles with codes stop once more, over the code.
//!
//! You will see a table for each way of localising, and pictures of the first seed in `target/agv/qr_navigation/`; it takes
//! some seconds.

#[path = "qr_navigation/fusion.rs"]
mod fusion;
#[path = "qr_navigation/laps.rs"]
mod laps;
#[path = "qr_navigation/pilot.rs"]
mod pilot;
#[path = "qr_navigation/site.rs"]
mod site;

use agv_nav::prelude::*;
use agv_support::{
    cli::{CommonArgs, Report},
    plot::{Color, Scene, TimeSeries},
    progress::Progress,
};
use clap::{Parser, ValueEnum as _};
use laps::{Lap, Moment, Run, Runs};
use pilot::Variant;
use site::Site;
use std::{path::Path as FilePath, process::ExitCode};

/// Drive laps through a ring of floor codes, localised by laser, codes, or both.
#[derive(Parser)]
struct Args {
    /// Way of localising [default: all]
    #[arg(long)]
    variant: Option<Variant>,
    /// Number of seeds, from `--seed` on
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: u64,
    /// Laps of each seed
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u16).range(1..=1000))]
    laps: u16,
    /// Distance between codes, in metres
    #[arg(long, default_value_t = 0.5)]
    spacing: f64,
    /// Share of the codes that cannot be read
    #[arg(long, default_value_t = 0.2)]
    damaged: f64,
    /// Leave out the codes that cannot be read, instead of knowing them by their places
    #[arg(long)]
    leave_unread: bool,
    /// How far the vehicle is turned off the path before the first lap, in degrees
    #[arg(long, default_value_t = 60.0)]
    yaw_offset: f64,
    #[command(flatten)]
    common: CommonArgs,
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        if !(0.1..=5.0).contains(&args.spacing) {
            return Err("--spacing must be from 0.1 to 5 metres".into());
        }
        let out = args.common.out_folder("qr_navigation")?;
        let site = Site::new(args.spacing)?;
        let variants = args.variant.map_or_else(|| Variant::value_variants().to_vec(), |one| vec![one]);
        let progress = Progress::new(variants.len() * args.seeds as usize, "driving");
        let mut driven = Vec::new();
        for variant in variants {
            driven.push((variant, drive(&args, &site, variant, &progress)?));
        }
        drop(progress);
        draw(&out, &site, &driven)?;
        report(&args, &driven)
    })
}

/// One run per seed.
fn drive(args: &Args, site: &Site, variant: Variant, progress: &Progress) -> Result<Vec<Run>> {
    let runs = Runs {
        laps: usize::from(args.laps),
        damaged: args.damaged,
        yaw_offset: args.yaw_offset.to_radians(),
        uses_unread: !args.leave_unread,
        par: args.common.par(),
    };
    progress.over(args.common.seeds(args.seeds)).map(|seed| Run::new(site, runs, variant, seed)).collect()
}

/// Mean and greatest value.
fn figures(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let count = values.clone().count() as f64;
    (values.clone().sum::<f64>() / count, values.fold(f64::NEG_INFINITY, f64::max))
}

/// One way of localising, over all laps of all seeds.
fn figures_of(variant: Variant, runs: &[Run]) -> Report {
    let mut report = Report::new(format!("Laps by {}", variant.name()));
    let laps = || runs.iter().flat_map(|run| &run.laps);
    let arrived = || laps().filter(|lap| lap.arrived);
    let moments = || runs.iter().flat_map(|run| &run.moments);
    let rmse = |of: &dyn Fn(&Moment) -> f64| (moments().map(of).sum::<f64>() / moments().count() as f64).sqrt();
    let (stop_mean, stop_max) = figures(arrived().map(|lap| lap.stop_error));
    let (angle_mean, angle_max) = figures(arrived().map(|lap| lap.offset_angle.to_degrees()));
    let centred = || laps().filter_map(|lap| lap.centred_error);
    report
        .text("variant", variant.name())
        .count("laps", laps().count())
        .count("arrived", arrived().count())
        .count("contacts", runs.iter().map(|run| run.contacts).sum())
        .number("lap_time_s", figures(arrived().map(|lap| lap.time)).0)
        .number("offset_angle_mean_deg", angle_mean)
        .number("offset_angle_max_deg", angle_max)
        .number("offset_right_m", figures(arrived().map(|lap| -lap.offset.0)).1)
        .number("offset_left_m", figures(arrived().map(|lap| lap.offset.1)).1)
        .number("stop_error_mean_m", stop_mean)
        .number("stop_error_max_m", stop_max)
        .number("position_rmse_m", rmse(&|m| (m.estimate.translation() - m.truth.translation()).norm_squared()))
        .number("heading_rmse_deg", rmse(&|m| m.estimate.minus(&m.truth).z.to_degrees().powi(2)));
    if variant != Variant::Laser {
        let (mean, max) = figures(centred());
        report
            .count("centred", centred().count())
            .number("centred_error_mean_m", mean)
            .number("centred_error_max_m", max)
            .number("by_codes_ratio", figures(runs.iter().map(|run| run.by_codes)).0);
        fusion::measured(runs, &mut report);
    }
    report
}

/// The table of each way, and what one saves against the other.
fn report(args: &Args, driven: &[(Variant, Vec<Run>)]) -> Result<()> {
    let reports: Vec<_> = driven.iter().map(|(variant, runs)| figures_of(*variant, runs)).collect();
    let mut all = Report::new(format!("Laps through codes, {} seed(s) from {}", args.seeds, args.common.seed));
    all.count("seeds", args.seeds as usize);
    let mean_of = |variant: Variant, of: &dyn Fn(&Lap) -> Option<f64>| {
        let (_, runs) = driven.iter().find(|(name, _)| *name == variant)?;
        let values: Vec<f64> = runs.iter().flat_map(|run| &run.laps).filter(|lap| lap.arrived).filter_map(of).collect();
        Some(figures(values.iter().copied()).0)
    };
    let stop = |lap: &Lap| Some(lap.stop_error);
    if let (Some(laser), Some(both)) = (mean_of(Variant::Laser, &stop), mean_of(Variant::Both, &stop)) {
        all.number("stop_error_saved_ratio", 1.0 - both / laser);
        if let Some(centred) = mean_of(Variant::Both, &|lap| lap.centred_error) {
            all.number("stop_error_saved_by_centring_ratio", 1.0 - centred / laser);
        }
        let time = |lap: &Lap| Some(lap.time);
        if let (Some(laser), Some(both)) = (mean_of(Variant::Laser, &time), mean_of(Variant::Both, &time)) {
            all.number("lap_time_saved_ratio", 1.0 - both / laser);
        }
    }
    fusion::of_the_papers_size(20_000, args.common.seed(), &mut all)?;
    if args.common.json {
        return Ok(all.reports("variants", reports).print(true)?);
    }
    reports.iter().chain([&all]).try_for_each(|report| report.print(false))?;
    Ok(())
}

const COLORS: [Color; 3] = [Color::Orange, Color::Green, Color::Blue];

/// Draws the first seed of each way: from above, distances from the path, errors of the estimate, and speeds.
fn draw(out: &FilePath, site: &Site, driven: &[(Variant, Vec<Run>)]) -> Result<()> {
    let codes = site.codes.iter().map(|code| &code.map_from_code);
    let mut scene = Scene::new("Laps through a ring of codes").map(&site.map).particles("codes", Color::Black, codes);
    let mut offsets = TimeSeries::new("Distance from the path", "time, s", "to the left, cm");
    let mut errors = TimeSeries::new("Error of the estimated position", "time, s", "error, cm");
    let mut speeds = TimeSeries::new("Speed and turn rate", "time, s", "m/s, rad/s");
    for ((variant, runs), color) in driven.iter().zip(COLORS) {
        let Some(run) = runs.first() else { continue };
        let over_time =
            |of: &dyn Fn(&Moment) -> f64| run.moments.iter().map(|m| (m.time, of(m))).collect::<Vec<(f64, f64)>>();
        scene = scene.trajectory(variant.name(), color, run.moments.iter().map(|moment| &moment.truth));
        offsets = offsets.curve(variant.name(), color, over_time(&|m| 100.0 * m.cross_track));
        let error = |m: &Moment| 100.0 * (m.estimate.translation() - m.truth.translation()).norm();
        errors = errors.curve(variant.name(), color, over_time(&error));
        speeds = speeds.curve(variant.name(), color, over_time(&|m| m.twist.vx));
        speeds = speeds.curve(&format!("{}, turn", variant.name()), color, over_time(&|m| m.twist.yaw_rate));
    }
    scene.mark("station", Color::Red, site.station().translation()).write(out.join("laps.png"))?;
    offsets.write(out.join("offsets.png"))?;
    errors.write(out.join("errors.png"))?;
    speeds.write(out.join("speeds.png"))?;
    Ok(())
}
