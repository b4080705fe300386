//! Ant colonies on grids: the ladder of paper 002 from the traditional colony to the improved one, beside the optimum.
//!
//! ```text
//! cargo run --release --example ant_colony                                # seeded maps of the paper's sizes and densities
//! cargo run --release --example ant_colony -- --maps ../shared/data/gridplan/aco    # every map of a folder with its reference.csv
//! cargo run --release --example ant_colony -- --options                   # what the options and additions do
//! ```
//!
//! The paper's maps exist as pictures only, so that its lengths cannot be met to the digit; orderings and ratios can. The sets are
//! its Table 1 (20 x 20, corner to corner), Tables 3 and 4 (20 x 20 and 50 x 50, their start and goal), and 50 x 50 from corner to
//! corner. The shipped map of Table 1 is the first of its seeds whose shortest path has the paper's 29.7990 m.
//!
//! You will see, per set and algorithm over the seeds: solved runs, length, ratio to the shortest octile path that cuts no corner
//! and to the exact any-angle one, turns, iterations to the final length, and time (with one thread; with more the runs are spread
//! over them and not timed). In `target/agv/ant_colony/`: convergence and paths as in Figs. 6, 7, 10 and 11. It takes some seconds; the
//! folder takes a minute or two.

#[path = "ant_colony/cases.rs"]
mod cases;
#[path = "ant_colony/methods.rs"]
mod methods;
#[path = "ant_colony/pictures.rs"]
mod pictures;
#[path = "ant_colony/trials.rs"]
mod trials;

use agv_support::{
    cli::{CommonArgs, Report},
    progress::Progress,
};
use cases::Set;
use clap::Parser;
use methods::{LADDER, OPTIONS, Row};
use std::{path::PathBuf, process::ExitCode};
use trials::{Summary, Trials};

/// Plan by ant colonies, and see how near they come to the optimum.
#[derive(Parser)]
struct Args {
    /// Folder of .map files with a reference.csv that names them, their start, goal and optima
    #[arg(long)]
    maps: Option<PathBuf>,
    /// Runs per map and algorithm, each with a seed of its own
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: u64,
    /// The options and additions, each alone, instead of the ladder
    #[arg(long)]
    options: bool,
    #[command(flatten)]
    common: CommonArgs,
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> ExitCode {
    let args = Args::parse();
    agv_support::run(|| {
        let sets = match &args.maps {
            Some(folder) => cases::read(folder)?,
            None => cases::shipped()?,
        };
        let rows: &[Row] = if args.options { &OPTIONS } else { &LADDER };
        let searches = rows.iter().filter(|row| row.is_new_search()).count();
        let work: usize = sets.iter().map(|set| set.cases.len() * searches).sum();
        let progress = Progress::new(work * args.seeds as usize, "ants");
        let out = args.common.out_folder("ant_colony")?;
        let mut report = Report::new("Ant colonies");
        report.count("seeds", args.seeds as usize);
        for set in sets {
            let trials = Trials::run(&set, rows, &args, &progress)?;
            show(&set, &trials.summaries, &mut report, args.common.json);
            pictures::draw(&set, &trials, &out)?;
        }
        drop(progress);
        report.print(args.common.json)?;
        Result::Ok(())
    })
}

/// The set as a table on the terminal, and as figures of the report.
fn show(set: &Set, summaries: &[Summary], report: &mut Report, json: bool) {
    if !json {
        println!("{}", set.table(summaries));
    }
    report.reports(set.key, summaries.iter().map(Summary::report).collect());
    let named = |name: &str| summaries.iter().find(|summary| summary.name == name);
    for (name, key) in [("pheromone (IACO)", "iaco"), ("refined", "refined")] {
        if let Some(summary) = named(name) {
            report.number(&format!("{}_{key}_solved_percent", set.key), 100.0 * summary.solved());
            report.number(&format!("{}_{key}_ratio", set.key), summary.ratio.mean);
        }
    }
    for (theirs, under) in [("ACO", ""), ("ACO, goal seen", "_goal_seen")] {
        let Some(aco) = named(theirs) else { continue };
        for (name, key) in [("IACO, key nodes", "point"), ("IACO, key nodes, 0.3 m", "radius")] {
            if let Some(summary) = named(name) {
                let less = |ours: f64, theirs: f64| 100.0 * (1.0 - ours / theirs);
                let [turns, length] =
                    ["turns", "length"].map(|what| format!("{}_{key}_{what}_less{under}_percent", set.key));
                report.number(&turns, less(summary.turns.mean, aco.turns.mean));
                report.number(&length, less(summary.length.mean, aco.length.mean));
            }
        }
    }
}
