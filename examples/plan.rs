//! Paths on grids: every query of a scenario, beside its stated optimum.
//!
//! ```text
//! cargo run --release --example plan                                      # the shipped warehouse, by A*
//! cargo run --release --example plan -- --algorithm jps --map arena.map.gz --scen arena.map.scen.gz
//! cargo run --release --example plan -- --map depot.yaml --radius 0.3 --start 4,2 --goal 20,9
//! cargo run --release --example plan -- --compare                         # A* and Dijkstra in a factory, as paper 003 has them
//! ```
//!
//! Maps are MovingAI's `.map` or map_server's YAML, scenarios MovingAI's `.scen`, plain or gzipped. `--start` and `--goal` are
//! column and row from the top in a `.map`, as in its scenarios, and metres in the map frame of a YAML. Paths along the grid are
//! compared with the stated optimum to 0.01 cells, the precision of the older sets; ways at any angle, which may be shorter, by
//! their ratio to it.
//!
//! A time is that of the call that a user makes, from two poses to a path of poses, on a map that the planner has seen: the
//! fastest of `--repeats` (of D* Lite, which remembers, the first). What a map costs once, tables of its own included, is `prepare_ms`.
//!
//! You will see how many queries missed their optimum, times and expansions, and in `target/agv/plan/path.svg` the longest path
//! with the cells that were looked at. Exit code 1 if a query missed its optimum or has no path, 2 if the input is bad.

#[path = "plan/ask.rs"]
mod ask;
#[path = "plan/compare.rs"]
mod compare;
#[path = "plan/lines.rs"]
mod lines;
#[path = "plan/pictures.rs"]
mod pictures;
#[path = "plan/planners.rs"]
mod planners;
#[path = "plan/site.rs"]
mod site;

use agv_support::cli::{CommonArgs, Report};
use clap::Parser;
use planners::Algorithm;
use std::{path::PathBuf, process::ExitCode};

/// Plan paths on a grid and compare them with stated optima.
#[derive(Parser)]
struct Args {
    /// Map: MovingAI's .map or map_server's YAML
    #[arg(long, default_value = "data/planning/warehouse.map")]
    map: PathBuf,
    /// Queries with their optima [default: the shipped ones of the shipped map]
    #[arg(long, conflicts_with_all = ["start", "goal"])]
    scen: Option<PathBuf>,
    /// Where a single path starts, as x,y: cells from the top left in a .map, metres in a YAML's map frame
    #[arg(long, requires = "goal", value_parser = site::point, allow_hyphen_values = true)]
    start: Option<[f64; 2]>,
    /// Where it ends
    #[arg(long, requires = "start", value_parser = site::point, allow_hyphen_values = true)]
    goal: Option<[f64; 2]>,
    /// Who plans
    #[arg(long, value_enum, default_value_t = Algorithm::Astar)]
    algorithm: Algorithm,
    /// Radius of the vehicle in metres: cells whose centre is no farther from a blocked one's are blocked too
    #[arg(long, default_value_t = 0.0, value_parser = site::radius)]
    radius: f64,
    /// How often each query is asked; the fastest counts
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=1000))]
    repeats: u16,
    /// A* and Dijkstra with 4 and 8 directions, with and without obstacles, in a generated factory
    #[arg(long, conflicts_with_all = ["map", "scen", "start", "goal", "algorithm", "radius"])]
    compare: bool,
    #[command(flatten)]
    common: CommonArgs,
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::judge(|| {
        let mut report = Report::new("Paths on grids");
        if args.compare {
            return compare::run(&args, report);
        }
        let site = site::load(&args)?;
        let mut planner = args.algorithm.planner()?;
        let tally = ask::all(&args, &site, planner.as_mut());
        tally.report(&args, &mut report);
        // The figures first: they are not lost if the picture cannot be written.
        report.print(args.common.json)?;
        let out = args.common.out_folder("plan")?;
        pictures::longest(&out.join("path.svg"), &args, &site, planner.as_mut())?;
        Result::Ok(tally.holds())
    })
}
