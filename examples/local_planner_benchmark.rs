//! Local planners in worlds that they have never seen: BARN, `DynaBARN`, MRPB, or generated ones.
//!
//! ```text
//! cargo run --release --example local_planner_benchmark -- --planner dwa
//! cargo run --release --example local_planner_benchmark -- --planner teb --worlds barn_worlds.csv \
//!     --cylinders barn_cylinders.csv.gz --paths barn_paths.csv.gz
//! cargo run --release --example local_planner_benchmark -- --planner dwa --keyframes dynabarn_keyframes.csv.gz
//! cargo run --release --example local_planner_benchmark -- --planner dwa --map maze.pgm.gz --tests tests.csv
//! ```
//!
//! A differential vehicle of 0.508 m by 0.43 m drives from start to goal. It knows what its scanner shows (270°, 720 beams, 20 Hz,
//! 10 m, 1 cm of noise) and what its odometry says (scale errors of distances and of turns, normal with 1 % standard deviation,
//! drawn once a run, and 1 % of noise in each cycle), and nothing else: a rolling costmap and tracked obstacles,
//! `agv_nav::pipeline::Navigation` with A* and the chosen local planner. A run succeeds within a metre of the goal; it fails at the
//! first contact, judged by the exact outline along the motion, after 100 s, or where the vehicle gives up or stands where it
//! wrongly believes the goal to be (`gave_up` and `missed`, both of them also in `timeout`). The score is BARN's: the least time
//! over the time that it took, held between two and eight times the least, so at most a half.
//!
//! You will see a table, and pictures of the first run and of each failure in `target/agv/local_planner_benchmark/`. Without
//! arguments it drives through the six worlds of BARN in `data/barn`, within some seconds; `--generated n` makes others of their kind.

#[path = "local_planner_benchmark/contact.rs"]
mod contact;
#[path = "local_planner_benchmark/pictures.rs"]
mod pictures;
#[path = "local_planner_benchmark/planners.rs"]
mod planners;
#[path = "local_planner_benchmark/results.rs"]
mod results;
#[path = "local_planner_benchmark/run.rs"]
mod run;
#[path = "local_planner_benchmark/sight.rs"]
mod sight;
#[path = "local_planner_benchmark/worlds.rs"]
mod worlds;

use agv_support::cli::CommonArgs;
use clap::Parser;
use std::process::ExitCode;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error + Send + Sync>>;

/// What is otherwise than it should be, for comparison.
#[derive(clap::Args)]
struct Comparison {
    /// Let the dynamic window's time follow speed and room (paper 000), for comparison
    #[arg(long)]
    adaptive_window: bool,
    /// Take obstacles that move to stand where they are seen: planning without a sense of time, for comparison
    #[arg(long)]
    frozen: bool,
    /// Tell the planner what truly moves, instead of what is tracked in the scans, for comparison
    #[arg(long)]
    oracle: bool,
}

/// Lets a local planner drive through worlds that it has never seen.
#[derive(Parser)]
struct Args {
    /// Local planner
    #[arg(long, value_enum, default_value = "dwa")]
    planner: planners::Planner,
    #[command(flatten)]
    worlds: worlds::WorldArgs,
    /// Greatest speed, in metres per second
    #[arg(long, default_value_t = 2.0, value_parser = positive)]
    v_max: f64,
    /// When a run ends at the latest, in seconds
    #[arg(long, default_value_t = 100.0, value_parser = positive)]
    timeout: f64,
    /// Distance from obstacles that counts as safe, in metres, at most one
    #[arg(long, default_value_t = 0.3, value_parser = positive)]
    safe_distance: f64,
    /// At most so many worlds, spread over all
    #[arg(long)]
    limit: Option<usize>,
    #[command(flatten)]
    compare: Comparison,
    /// Pictures of all runs, not of the first and of failures only
    #[arg(long)]
    all_pictures: bool,
    #[command(flatten)]
    common: CommonArgs,
}

fn positive(text: &str) -> std::result::Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err(format!("{value} is not positive")) }
}

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let out = args.common.out_folder("local_planner_benchmark")?;
        let trials = worlds::some_of(args.worlds.load(args.common.seed())?, args.limit);
        let runs = run::all(&trials, &args)?;
        pictures::draw(&out, &trials, &runs, args.all_pictures)?;
        results::report(&args, &trials, &runs).print(args.common.json)?;
        Result::Ok(())
    })
}
