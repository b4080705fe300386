//! What the Kalman filters of papers 000 and 001 reach: simulated as printed, beside what theory says.
//!
//! ```text
//! cargo run --release --example ekf_simulation                  # all three experiments, 20 runs each
//! cargo run --release --example ekf_simulation -- --seeds 100
//! ```
//!
//! - `pose`: paper 000, Eqs. 15 and 16, a vehicle whose pose is measured with 25 cm of noise, in both readings of its process
//!   noise: per step as printed, and multiplied by the time step. Errors beside the steady state of the Riccati equation.
//! - `turn`: paper 000, Figs. 41 to 43, the errors at the end of one turn back to the start: wheel odometry, an extended filter
//!   of odometry and an IMU's heading, Monte Carlo localisation.
//! - `growth`: paper 001, Eq. 9, the test of van der Merwe et al. (2000): a strongly bent reading and noise that is never
//!   negative, by particles, by the extended and by the unscented filter.
//!
//! You will see tables, and pictures of one run of each in `target/agv/ekf_simulation/`; it takes some seconds, most of them for particles.

#[path = "ekf_simulation/growth.rs"]
mod growth;
#[path = "ekf_simulation/pose.rs"]
mod pose;
#[path = "ekf_simulation/turn.rs"]
mod turn;

use agv_support::cli::{CommonArgs, Report};
use clap::Parser;
use std::process::ExitCode;

/// Run the Kalman filters' experiments of papers 000 and 001.
#[derive(Parser)]
struct Args {
    /// Runs of each experiment, from `--seed` on
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(2..=100_000))]
    seeds: u64,
    #[command(flatten)]
    common: CommonArgs,
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let out = args.common.out_folder("ekf_simulation")?;
        let seeds: Vec<_> = args.common.seeds(args.seeds).collect();
        let mut report = Report::new("Kalman filters of papers 000 and 001");
        report.count("seeds", args.seeds as usize);
        report.reports("pose", pose::experiment(&seeds, &out)?);
        report.reports("turn", turn::experiment(&seeds, &out)?);
        report.reports("growth", growth::experiment(&seeds, &out)?);
        report.print(args.common.json)?;
        Result::Ok(())
    })
}

/// Mean of the values and its standard error, from their own spread.
fn mean_and_error(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    (mean, (variance / count).sqrt())
}
