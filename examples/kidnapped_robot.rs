//! A vehicle is carried away while it drives: how long does each filter take to notice and to find itself again?
//!
//! ```text
//! cargo run --release --example kidnapped_robot                                    # ten seeds in the room and the warehouse
//! cargo run --release --example kidnapped_robot -- --seeds 100
//! cargo run --release --example kidnapped_robot -- --map warehouse.yaml --seeds 200   # switched on anywhere in a map
//! ```
//!
//! The places are paper 001's room of 10 x 10 m and a warehouse of 40 x 30 m. The vehicle drives laps on a route with a code on the
//! floor each metre, of which one in five is damaged, at 0.8 m/s, and stops each 7 m. At a random time it is put to another place of
//! the route, up to 60° askew. Six filters follow the same drives: a fixed number of particles, KLD sampling, that with
//! `w_slow`/`w_fast` (`nav2_amcl`'s recovery), the crate's default with search by the scan's likelihood, and the last two with codes.
//!
//! You will see a table of recovery times and of errors at the stops, and pictures of the first seed in
//! `target/agv/kidnapped_robot/`. Ten seeds take some seconds.

#[path = "kidnapped_robot/drive.rs"]
mod drive;
#[path = "kidnapped_robot/filters.rs"]
mod filters;
#[path = "kidnapped_robot/judge.rs"]
mod judge;
#[path = "kidnapped_robot/site.rs"]
mod site;

use agv_nav::{core::metrics::Statistics, prelude::*};
use agv_support::{
    cli::{CommonArgs, Report},
    plot::{Color, Scene, TimeSeries},
    progress::Progress,
    timing::Timings,
};
use clap::Parser;
use drive::{DT, Drive};
use filters::Kind;
use judge::{CENSORED, Outcome, follow};
use site::Site;
use std::{
    path::{Path as FilePath, PathBuf},
    process::ExitCode,
};

/// Carry a vehicle away, and see which filter finds it.
#[derive(Parser)]
struct Args {
    /// Number of seeds, from `--seed` on
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: u64,
    /// Place to drive in [default: both]
    #[arg(long)]
    site: Option<String>,
    /// Instead of a kidnap, start anywhere in this map (yaml and pgm), without knowing where
    #[arg(long)]
    map: Option<PathBuf>,
    /// Start there from a swarm that the first scan has drawn, instead of from anywhere
    #[arg(long, requires = "map")]
    improved_swarm: bool,
    /// Metres to drive then
    #[arg(long, default_value_t = 15.0)]
    length: f64,
    #[command(flatten)]
    common: CommonArgs,
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let out = args.common.out_folder("kidnapped_robot")?;
        let mut report = match &args.map {
            Some(map) => switched_on(&args, &Site::of_file(map)?, &out)?,
            None => kidnaps(&args, &out)?,
        };
        report.count("seeds", args.seeds as usize);
        Ok::<_, Box<dyn std::error::Error>>(report.print(args.common.json)?)
    })
}

impl Args {
    fn seeds(&self) -> impl Iterator<Item = Seed> {
        self.common.seeds(self.seeds)
    }
}

/// All filters in all places.
fn kidnaps(args: &Args, out: &FilePath) -> Result<Report> {
    let mut sites = vec![Site::room()?, Site::warehouse()?];
    sites.retain(|site| args.site.as_ref().is_none_or(|name| *name == site.name));
    let progress = Progress::new(sites.len() * args.seeds as usize, "carrying away");
    let mut report = Report::new("Kidnapped vehicle");
    for site in &sites {
        let mut outcomes: Vec<Vec<Outcome>> = Kind::ALL.iter().map(|_| Vec::new()).collect();
        let mut tracked: Vec<Vec<(f64, f64)>> = outcomes.iter().map(|_| Vec::new()).collect();
        for seed in progress.over(args.seeds()) {
            let drive = drive::kidnapped(site, seed)?;
            for (index, kind) in Kind::ALL.into_iter().enumerate() {
                let mut filter = kind.build(site, &filters::around(drive.start)?, seed, args.common.par())?;
                let outcome = follow(filter.as_mut(), &drive)?;
                tracked[index].push(outcome.tracking(drive.kidnap.unwrap_or_default()));
                outcomes[index].push(outcome);
            }
            if seed.0 == args.common.seed {
                draw(out, site, &drive, &outcomes)?;
            }
        }
        let rows = Kind::ALL.iter().zip(&outcomes).zip(&tracked);
        let rows: Vec<Report> = rows.map(|((kind, outcomes), tracked)| row(*kind, outcomes, tracked)).collect();
        if !args.common.json {
            println!("{}", table(&site.name, &rows));
        }
        add_ratios(&mut report, &site.name, &outcomes);
        report.reports(&site.name, rows);
    }
    Ok(report)
}

/// The figures of one filter in one place.
fn row(kind: Kind, outcomes: &[Outcome], tracked: &[(f64, f64)]) -> Report {
    let recoveries = Statistics::new(outcomes.iter().map(Outcome::recovery_or_censored).collect()).ok();
    let stops = Statistics::new(outcomes.iter().flat_map(|o| o.stop_errors.iter().copied()).collect()).ok();
    let percentile = |s: &Option<Statistics>, p| s.as_ref().map_or(f64::NAN, |s| s.percentile(p));
    let rms = |of: &dyn Fn(&(f64, f64)) -> f64| {
        (tracked.iter().map(|t| of(t).powi(2)).sum::<f64>() / tracked.len() as f64).sqrt()
    };
    let mut timings = Timings::default();
    for outcome in outcomes {
        timings.append(outcome.timings.clone());
    }
    let counts: Vec<usize> = outcomes.iter().flat_map(|outcome| outcome.counts.iter().copied()).collect();
    let mut report = Report::new(kind.name());
    report
        .text("filter", kind.name())
        .count("found_within_20_s", outcomes.iter().filter(|o| o.recovery.is_some_and(|s| s <= 20.0)).count())
        .count("not_found", outcomes.iter().filter(|o| o.recovery.is_none()).count())
        .number("recovery_s_p50", percentile(&recoveries, 50.0))
        .number("recovery_s_p90", percentile(&recoveries, 90.0))
        .number("recovery_s_mean", recoveries.as_ref().map_or(f64::NAN, Statistics::mean))
        .number("recovery_s_max", percentile(&recoveries, 100.0))
        .number("stop_error_m_mean", stops.as_ref().map_or(f64::NAN, Statistics::mean))
        .number("stop_error_m_p50", percentile(&stops, 50.0))
        .number("tracking_rmse_m", rms(&|t| t.0))
        .number("tracking_heading_rmse_deg", rms(&|t| t.1).to_degrees())
        .number("particles_mean", counts.iter().sum::<usize>() as f64 / counts.len() as f64)
        .number("update_ms_p50", timings.milliseconds(50.0))
        .number("update_ms_p99", timings.milliseconds(99.0))
        .number("deceived", outcomes.iter().map(|o| o.deceived).sum::<f64>() / outcomes.len() as f64);
    report
}

/// What is gained over `w_slow` and `w_fast` without codes, as paper 001 claims it; and what the codes alone bring to each filter.
fn add_ratios(report: &mut Report, site: &str, outcomes: &[Vec<Outcome>]) {
    let of = |kind: Kind| &outcomes[Kind::ALL.iter().position(|&k| k == kind).unwrap_or_default()];
    let median = |kind: Kind| {
        let times = of(kind).iter().map(Outcome::recovery_or_censored).collect();
        Statistics::new(times).map_or(f64::NAN, |s| s.percentile(50.0))
    };
    let stop = |kind: Kind| {
        let errors = of(kind).iter().flat_map(|outcome| outcome.stop_errors.iter().copied()).collect();
        Statistics::new(errors).map_or(f64::NAN, |s| s.mean())
    };
    let less = |with: f64, without: f64| 100.0 * (1.0 - with / without);
    for (name, with, without) in [
        ("codes", Kind::Codes, Kind::Augmented),
        ("amcl", Kind::Search, Kind::Augmented),
        ("amcl_codes", Kind::SearchAndCodes, Kind::Augmented),
        ("amcl_codes_over_amcl", Kind::SearchAndCodes, Kind::Search),
    ] {
        let faster = less(median(with), median(without));
        let nearer = less(stop(with), stop(without));
        report.number(&format!("{site}_{name}_recovery_faster_percent"), faster);
        report.number(&format!("{site}_{name}_stop_error_lower_percent"), nearer);
    }
}

fn table(site: &str, rows: &[Report]) -> String {
    let mut text = format!("{site}: recovery in s (censored at {CENSORED} s), errors in m\n");
    for row in rows {
        text += &row.to_table();
    }
    text
}

/// The crate's default filter, switched on anywhere in a map; beside it, on the same drives, one that is told where it starts: what
/// that one does not follow to the end is no failure of the start.
fn switched_on(args: &Args, site: &Site, out: &FilePath) -> Result<Report> {
    let progress = Progress::new(args.seeds as usize, "switching on");
    let (mut found, mut followed, mut times, mut lost, mut timings, mut counts) =
        (0, 0, Vec::new(), Vec::new(), Timings::default(), 0.0);
    for seed in progress.over(args.seeds()) {
        let mut drive = drive::wandering(site, args.length, seed)?;
        let mut filter = Kind::Search.build(site, &PoseBelief::Anywhere, seed, args.common.par())?;
        let mut told = Kind::Search.build(site, &filters::around(drive.start)?, seed, args.common.par())?;
        let told = follow(told.as_mut(), &drive)?;
        followed += usize::from(told.ends_right());
        if args.improved_swarm && drive.steps.len() > 1 {
            filter.start_by(&drive.steps.remove(0).scan)?;
        }
        let outcome = follow(filter.as_mut(), &drive)?;
        found += usize::from(outcome.ends_right());
        if !outcome.ends_right() {
            lost.push(seed.0 as f64);
            let [off, told_off] = [&outcome, &told].map(|outcome| outcome.errors.last().copied().unwrap_or(f64::NAN));
            eprintln!("seed {}: {off:.2} m off ({told_off:.2} m if told the start), {:?}", seed.0, filter.status());
        }
        let wrong = (0..outcome.errors.len()).rev().find(|&index| !outcome.is_right(index));
        let first_right = wrong.map_or(0, |index| index + 1);
        times.push(first_right as f64 * DT);
        counts += outcome.counts.iter().sum::<usize>() as f64 / outcome.counts.len() as f64;
        timings.append(outcome.timings.clone());
        if seed.0 == args.common.seed {
            draw(out, site, &drive, &[vec![outcome]])?;
        }
    }
    let mut report = Report::new("Switched on anywhere");
    let times = Statistics::new(times).ok();
    let percentile = |p| times.as_ref().map_or(f64::NAN, |s| s.percentile(p));
    report
        .text("map", site.name.clone())
        .number("free_space_m2", site.free_space.area())
        .count("found", found)
        .number("found_percent", 100.0 * found as f64 / args.seeds as f64)
        .count("followed_if_told", followed)
        .number("right_from_s_p50", percentile(50.0))
        .number("right_from_s_p90", percentile(90.0))
        .number("particles_mean", counts / args.seeds as f64)
        .number("update_ms_p50", timings.milliseconds(50.0))
        .number("update_ms_p99", timings.milliseconds(99.0))
        .number("update_ms_max", timings.milliseconds(100.0))
        .numbers("lost_seeds", &lost);
    Ok(report)
}

const COLORS: [Color; 6] = [Color::Grey, Color::Sky, Color::Orange, Color::Blue, Color::Red, Color::Green];

/// Draws the last run of each filter: from above, and the errors over time.
fn draw(out: &FilePath, site: &Site, drive: &Drive, outcomes: &[Vec<Outcome>]) -> Result<()> {
    let mut scene = Scene::new(format!("Driven: {}", site.name)).map(&site.map);
    for code in &site.codes {
        scene = scene.mark("", Color::Grey, code.map_from_code.translation());
    }
    scene = scene.trajectory("truth", Color::Black, drive.steps.iter().map(|step| &step.truth));
    let mut errors = TimeSeries::new(format!("Distance from the truth: {}", site.name), "time, s", "error, m");
    let mut counts = TimeSeries::new(format!("Particles: {}", site.name), "time, s", "particles");
    for ((kind, outcomes), color) in Kind::ALL.iter().zip(outcomes).zip(COLORS) {
        let name = if site.route.is_empty() { Kind::Search.name() } else { kind.name() };
        let Some(outcome) = outcomes.last() else { continue };
        let times = || drive.steps.iter().map(|step| step.time);
        scene = scene.trajectory(name, color, &outcome.estimates);
        errors = errors.curve(name, color, times().zip(outcome.errors.iter().copied()));
        counts = counts.curve(name, color, times().zip(outcome.counts.iter().map(|&count| count as f64)));
    }
    scene.write(out.join(format!("{}.png", site.name)))?;
    errors.write(out.join(format!("{}_error.png", site.name)))?;
    counts.write(out.join(format!("{}_particles.png", site.name)))?;
    Ok(())
}
