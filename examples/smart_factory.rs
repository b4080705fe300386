//! A smart factory, as paper 003 has it: one drive maps a hall in 3D, and from then on a vehicle localises, plans and drives in it.
//!
//! ```text
//! cargo run --release --example smart_factory
//! cargo run --release --example smart_factory -- --speeds 2,3,4,5 --runs 10     # the paper's Figs 6 and 16; some minutes
//! ```
//!
//! 1. **Map**: a tugger with a 16-line lidar, wheel odometry and an inertial unit is driven once through a generated hall of pallet
//!    racks; clouds are matched with the map of those before, and make a 3D map and a 2D grid.
//! 2. **Localise**: laps at several speeds, in that map and in one of true poses. With `--features serde` the map is written to `tiles/`
//!    too, a file for each tile, and a lap is localised with only the tiles in memory that are around the vehicle.
//! 3. **Plan**: A* and Dijkstra on the grid, with and without obstacles in the way.
//! 4. **Drive**: put somewhere in the hall, the vehicle finds out where it is, and drives to two goals by A* and TEB, past goods
//!    that the map does not know.
//!
//! You will see a table of errors and times, and pictures in `target/agv/smart_factory/`; it takes about twenty seconds.

#[path = "smart_factory/drive.rs"]
mod drive;
#[path = "smart_factory/hall.rs"]
mod hall;
#[path = "smart_factory/localization.rs"]
mod localization;
#[path = "smart_factory/mapping.rs"]
mod mapping;
#[path = "smart_factory/navigation.rs"]
mod navigation;
#[path = "smart_factory/pictures.rs"]
mod pictures;
#[cfg(feature = "serde")]
#[path = "smart_factory/tiles.rs"]
mod tiles;

use agv_support::cli::{CommonArgs, Report};
use clap::Parser;
use std::process::ExitCode;

/// Map a factory, localise in it, plan, and drive.
#[derive(Parser)]
struct Args {
    /// Greatest speeds of the laps that are localised, in metres per second
    #[arg(long, value_delimiter = ',', default_value = "2,5", value_parser = speed)]
    speeds: Vec<f64>,
    /// Laps at each speed, with other noise
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=1000))]
    runs: u64,
    /// Standard deviation of a range, in metres
    #[arg(long, default_value_t = 0.02, value_parser = sigma)]
    range_sigma: f64,
    /// Directions of the lidar in a turn
    #[arg(long, default_value_t = 600, value_parser = clap::value_parser!(u16).range(90..=3600))]
    columns: u16,
    #[command(flatten)]
    common: CommonArgs,
}

fn within(text: &str, least: f64, greatest: f64) -> std::result::Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is not a number"))?;
    if value >= least && value <= greatest { Ok(value) } else { Err(format!("must lie in [{least}, {greatest}]")) }
}

fn speed(text: &str) -> std::result::Result<f64, String> {
    within(text, 0.5, 6.0)
}

fn sigma(text: &str) -> std::result::Result<f64, String> {
    within(text, 0.0, 0.2)
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let out = args.common.out_folder("smart_factory")?;
        let mut report = Report::new("A smart factory");
        let hall = hall::Hall::new(&args)?;
        let mapped = mapping::run(&args, &hall, &mut report)?;
        let laps = localization::run(&args, &hall, &mapped, &mut report)?;
        #[cfg(feature = "serde")]
        tiles::run(&args, &hall, &mapped, &out, &mut report)?;
        let driven = navigation::run(&args, &hall, &mapped, &mut report)?;
        pictures::write(&out, &mapped, &laps, &driven)?;
        report.print(args.common.json)?;
        Result::Ok(())
    })
}
