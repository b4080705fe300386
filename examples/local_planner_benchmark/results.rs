//! Figures of all runs, and per class where there are several.

use crate::{
    Args,
    run::{End, Run},
    worlds::Trial,
};
use agv_support::{cli::Report, timing::Timings};
use clap::ValueEnum as _;
use std::collections::BTreeMap;

/// The report of the runs.
pub(crate) fn report(args: &Args, trials: &[Trial], runs: &[Run]) -> Report {
    let mut report = Report::new("Local planners in unknown worlds");
    let name = args.planner.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
    report.text("planner", name);
    let all: Vec<&Run> = runs.iter().collect();
    figures(&mut report, &all);
    let (mut cycles, mut sight) = (Timings::default(), Timings::default());
    for run in runs {
        cycles.append(run.cycles.clone());
        sight.append(run.sight.clone());
    }
    report
        .number("cycle_ms_p50", cycles.milliseconds(50.0))
        .number("cycle_ms_p99", cycles.milliseconds(99.0))
        .number("cycle_ms_mean", cycles.total_milliseconds() / cycles.count().max(1) as f64)
        .number("cycle_ms_max", cycles.milliseconds(100.0))
        .number("sight_ms_p50", sight.milliseconds(50.0))
        .number("sight_ms_p99", sight.milliseconds(99.0));
    let mut classes: BTreeMap<&str, Vec<&Run>> = BTreeMap::new();
    for (trial, run) in trials.iter().zip(runs) {
        classes.entry(&trial.class).or_default().push(run);
    }
    if classes.len() > 1 {
        let class = |(name, runs): (&&str, &Vec<&Run>)| {
            let mut report = Report::new(*name);
            report.text("class", *name);
            figures(&mut report, runs);
            report
        };
        report.reports("classes", classes.iter().map(class).collect());
    }
    let failure = |(trial, run): (&Trial, &Run)| {
        let mut report = Report::new("failure");
        report
            .text("world", &*trial.name)
            .text("end", format!("{:?}", run.end))
            .text("status", format!("{:?}", run.status));
        report.number("time_s", run.time);
        report
    };
    let failed = trials.iter().zip(runs).filter(|(_, run)| run.end != End::Success);
    report.reports("failures", failed.map(failure).collect());
    report
}

fn figures(report: &mut Report, runs: &[&Run]) {
    let count = |end: End| runs.iter().filter(|run| run.end == end).count();
    let succeeded: Vec<_> = runs.iter().filter(|run| run.end == End::Success).collect();
    let mean =
        |of: &dyn Fn(&Run) -> f64| succeeded.iter().map(|run| of(run)).sum::<f64>() / succeeded.len().max(1) as f64;
    let score = runs.iter().map(|run| run.score).sum::<f64>() / runs.len().max(1) as f64;
    // A vehicle that gave up, or stands elsewhere, did not arrive in time, either.
    report
        .count("worlds", runs.len())
        .count("success", succeeded.len())
        .count("collision", count(End::Collision))
        .count("timeout", count(End::Timeout) + count(End::GaveUp) + count(End::Missed))
        .count("gave_up", count(End::GaveUp))
        .count("missed", count(End::Missed))
        .number("score_mean", score)
        .number("time_mean_s", mean(&|run| run.time))
        .number("length_mean_m", mean(&|run| run.length))
        .number("speed_mean_mps", mean(&|run| run.length / run.time))
        .number("acceleration_mean_mps2", mean(&|run| run.smoothness))
        .number("endangered_share", runs.iter().map(|run| run.danger).sum::<f64>() / runs.len().max(1) as f64)
        .number("clearance_min_m", runs.iter().map(|run| run.clearance).fold(f64::INFINITY, f64::min))
        .count("recoveries", runs.iter().map(|run| run.recoveries).sum())
        .count("evading_cycles", runs.iter().map(|run| run.evasions).sum());
}
