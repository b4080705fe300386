//! Global and local planning as one: the fusions of papers 000, 002 and 003 among obstacles that no map knows.
//!
//! ```text
//! cargo run --release --example fused_navigation
//! cargo run --release --example fused_navigation -- --case hall --seed 3
//! ```
//!
//! - **grid** (paper 000): 25 by 25 cells, A* and its key nodes, the dynamic window, the vehicle of Table 1 (0.48 m/s, 0.2 m/s²,
//!   0.3 rad/s, 1.3 rad/s²); four obstacles stand on the path that no map shows, and one crosses it.
//! - **detour**, **near** (paper 002): to (17.5, 11.5) and to (9.5, 12.5), a goal close to obstacles, by the dynamic window alone: the
//!   classic critics against the improved ones; and **ants**: improved ants and improved dynamic window together.
//! - **hall** (paper 003): a factory hall, A* or Dijkstra and the timed elastic band, a vehicle that steers.
//!
//! The papers' maps exist as figures only: these are seeded ones of their size and kind. You will see a table, and pictures of the
//! map, the first path with its key nodes, the way that was driven, and speed, turn rate and heading over time in
//! `target/agv/fused_navigation/`.

#[path = "fused_navigation/cases.rs"]
mod cases;
#[path = "fused_navigation/drive.rs"]
mod drive;
#[path = "fused_navigation/pictures.rs"]
mod pictures;

use agv_support::cli::{CommonArgs, Report};
use clap::Parser;
use std::process::ExitCode;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// Drives the fusions of three papers among obstacles that no map knows.
#[derive(Parser)]
struct Args {
    /// Which experiment [default: all]
    #[arg(long, value_enum)]
    case: Option<cases::Experiment>,
    #[command(flatten)]
    common: CommonArgs,
}

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let out = args.common.out_folder("fused_navigation")?;
        let mut runs = Vec::new();
        for case in cases::all(args.case, args.common.seed())? {
            let (name, drive) = (case.name.clone(), drive::drive(case, args.common.seed())?);
            pictures::draw(&out, &name, &drive)?;
            runs.push(drive.report(&name));
        }
        let mut report = Report::new("Fused navigation");
        if !args.common.json {
            for run in &runs {
                println!("{}", run.to_table());
            }
        }
        report.reports("runs", runs).print(args.common.json)?;
        Result::Ok(())
    })
}
