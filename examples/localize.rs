//! Where was the robot? Localisation on a recorded drive in a given map, by laser and raw odometry.
//!
//! ```text
//! cargo run --release --example localize                         # the shipped drive, from a known start
//! cargo run --release --example localize -- --global             # the same, switched on anywhere
//! cargo run --release --example localize -- --starts 200         # switched on anywhere, at 200 places of the drive
//! cargo run --release --example localize -- --map site.yaml --scans drive.csv.gz --reference poses.csv.gz
//! cargo run --release --example localize -- --map site.yaml      # a simulated drive through any map
//! ```
//!
//! The filter is the ready adaptive particle filter with its defaults, none of them made for a log. It starts at the first
//! reference pose with deviations of 0.5 m and 15°, or, with `--global`, anywhere in the free space of the map. The odometry is
//! the log's, its jumps included (`--jumps` adds some); a scan is taken in after each 0.2 m or 0.2 rad. The errors are those of
//! the estimate right after each of these updates, against the reference pose of that scan, without alignment.
//!
//! You will see errors, times and numbers of particles, and in `target/agv/localize/` pictures of the way, of the errors and of the
//! number of particles over time, and `particles.csv.gz`, the particle clouds frame by frame for an animation. It takes some seconds.
//! The files may be of any format of `docs/formats.md`; without them it runs on two drives through the Intel Research Lab
//! (`data/intel/README.md`), one for the map, one to localise.

#[path = "localize/follow.rs"]
mod follow;
#[path = "localize/global.rs"]
mod global;
#[path = "localize/judge.rs"]
mod judge;
#[path = "localize/load.rs"]
mod load;
#[path = "localize/pictures.rs"]
mod pictures;
#[path = "localize/simulate.rs"]
mod simulate;

use agv_support::cli::{CommonArgs, Report};
use clap::Parser;
use std::{path::PathBuf, process::ExitCode};

/// Localise a recorded drive in a map.
#[derive(Parser)]
struct Args {
    /// Map (map_server's YAML) [default: one made of the shipped mapping drive]
    #[arg(long)]
    map: Option<PathBuf>,
    /// Drive to localise: scans and raw odometry [default: the shipped one, in a map that is named a simulated one]
    #[arg(long, requires = "map")]
    scans: Option<PathBuf>,
    /// Reference poses of the drive, one per scan
    #[arg(long, requires = "scans")]
    reference: Option<PathBuf>,
    /// Relations between moments of the drive (Kümmerle et al.)
    #[arg(long, requires = "scans")]
    relations: Option<PathBuf>,
    /// Start anywhere instead of at the first reference pose
    #[arg(long)]
    global: bool,
    /// Start anywhere at so many random places of the drive, each followed for 15 m
    #[arg(long, conflicts_with = "global", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    starts: Option<u32>,
    /// Let the odometry jump by 0.3 m and 9° once in so many scans
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    jumps: Option<u32>,
    /// Length of a simulated drive, in metres
    #[arg(long, default_value_t = 150.0, value_parser = metres)]
    travel: f64,
    #[command(flatten)]
    common: CommonArgs,
}

fn metres(text: &str) -> std::result::Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number")?;
    if (1.0..=1e5).contains(&value) { Ok(value) } else { Err("1 to 100000 metres".into()) }
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let out = args.common.out_folder("localize")?;
        let drive = load::read(&args)?;
        let mut report = Report::new("Localisation of a recorded drive");
        if let Some(starts) = args.starts {
            global::run(&args, &drive, starts, &mut report)?;
        } else {
            let run = follow::run(&args, &drive)?;
            judge::report(&drive, &run, &mut report)?;
            pictures::write(&out, &drive, &run)?;
        }
        report.print(args.common.json)?;
        Result::Ok(())
    })
}
