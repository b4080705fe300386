//! Where can a vehicle go that cannot turn on the spot? Hybrid A* through a warehouse, and three tight manoeuvres.
//!
//! ```text
//! cargo run --release --example ackermann                                     # a generated warehouse, 100 queries
//! cargo run --release --example ackermann -- --vehicle both                   # front and rear steering
//! cargo run --release --example ackermann -- --map site.yaml --queries 200    # random queries on a map of one's own
//! cargo run --release --example ackermann -- --map site.yaml --start 1,2,0 --goal 8,3,1.57
//! ```
//!
//! The vehicle is a tugger of 2.0 x 0.8 m whose rear axle is 0.4 m from its tail; it turns within 1.7 m (0.86 m with both axles
//! steered). Each path is checked by means that the planner does not have: densely, outline against cells, curvature from
//! point to point.
//!
//! You will see how many queries were solved, why the others were not, times and path lengths against a lower bound, and in
//! `target/agv/ackermann/` pictures of paths, blue forwards and red backwards, with the outline along them. It takes some
//! seconds.

#[path = "ackermann/check.rs"]
mod check;
#[path = "ackermann/manoeuvres.rs"]
mod manoeuvres;
#[path = "ackermann/pictures.rs"]
mod pictures;
#[path = "ackermann/run.rs"]
mod run;
#[path = "ackermann/site.rs"]
mod site;

use agv_core::geometry::Se2;
use agv_support::cli::{CommonArgs, Report};
use clap::{Parser, ValueEnum};
use std::{path::PathBuf, process::ExitCode};

/// Plan for a vehicle that steers, and see whether it can drive what was planned.
#[derive(Parser)]
struct Args {
    /// Map (map_server's YAML) [default: a generated warehouse]
    #[arg(long)]
    map: Option<PathBuf>,
    /// Start as x,y,yaw in metres and radians
    #[arg(long, value_parser = pose, requires = "goal", allow_hyphen_values = true)]
    start: Option<Se2>,
    /// Goal as x,y,yaw in metres and radians
    #[arg(long, value_parser = pose, requires = "start", allow_hyphen_values = true)]
    goal: Option<Se2>,
    /// Random queries between places where the vehicle can stand
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    queries: u32,
    /// What steers
    #[arg(long, value_enum, default_value_t = Vehicle::Front)]
    vehicle: Vehicle,
    /// What the dearest cell of an inflated costmap costs beside a free one, without unit
    #[arg(long, default_value_t = 0.0)]
    cost_weight: f64,
    #[command(flatten)]
    common: CommonArgs,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Vehicle {
    /// The front axle, driving both ways
    Front,
    /// The front axle, driving forwards only
    Forward,
    /// Both axles, against each other or alike
    Both,
}

fn pose(text: &str) -> std::result::Result<Se2, String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|field| field.trim().parse().map_err(|_| format!("`{field}` is not a number")))
        .collect::<std::result::Result<_, _>>()?;
    match numbers[..] {
        [x, y, yaw] if numbers.iter().all(|v| v.is_finite()) => Ok(Se2::new(x, y, yaw)),
        _ => Err("x,y,yaw are needed".into()),
    }
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let out = args.common.out_folder("ackermann")?;
        let mut report = Report::new("Hybrid A*");
        let site = site::load(&args)?;
        let runs = run::queries(&args, &site)?;
        run::report(&runs, &mut report);
        pictures::write(&out, &site, &runs)?;
        if args.map.is_none() {
            manoeuvres::run(&args, &out, &mut report)?;
        }
        report.print(args.common.json)?;
        Result::Ok(())
    })
}
