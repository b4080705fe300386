//! A cost that moves: 1200 environments of 100 iterations, with and without sensitive particles.

use super::{Args, Result, methods::Method, stand_in::median};
use agv_nav::{
    control::{
        optimize::Search,
        pso::{MovingPeaks, MovingPeaksParams, Sensing, Swarm, SwarmParams},
    },
    core::compute::Seed,
};
use agv_support::{
    cli::Report,
    plot::{Color, TimeSeries},
    timing::Timings,
};
use std::path::Path;

/// Environments, as in the paper.
const CHANGES: usize = 1200;

/// Errors of the best place against the optimum of its environment.
struct Track {
    /// At the end of each environment.
    before_change: Vec<f64>,
    /// Mean over the environments after each iteration.
    after_change: Vec<f64>,
    noticed: usize,
    evaluations: usize,
    best: Vec<f64>,
}

pub(crate) fn run(args: &Args, out: &Path, report: &mut Report) -> Result<()> {
    let Some(params) = args.method.swarm(args) else { return Ok(()) };
    let sensing = if args.method == Method::Paper { Sensing::paper() } else { Sensing::frugal() };
    let mut timings = Timings::default();
    let with = timings.time(|| follow(args, SwarmParams { sensing: Some(sensing), ..params }))?;
    let without = follow(args, params)?;

    let share = |track: &Track| {
        track.before_change.iter().filter(|error| **error < 0.01).count() as f64 / track.before_change.len() as f64
    };
    let mean = |track: &Track| track.before_change.iter().sum::<f64>() / track.before_change.len() as f64;
    // Costs are errors before the change, as parts of the optimum; a success is one below 1 %.
    report
        .number("success_rate", share(&with))
        .number("best_cost", with.before_change.iter().copied().fold(f64::INFINITY, f64::min))
        .number("median_cost", median(with.before_change.iter().copied()))
        .count("evaluations", with.evaluations)
        .number("run_ms_median", timings.milliseconds(50.0))
        .numbers("gains", &with.best)
        .count("changes", CHANGES * args.seeds() as usize)
        .count("changes_noticed", with.noticed)
        .number("error_before_change_mean", mean(&with))
        .number("error_before_change_mean_without_sensing", mean(&without))
        .number("success_rate_without_sensing", share(&without));

    let curve =
        |track: &Track| track.after_change.iter().enumerate().map(|(k, e)| (k as f64 + 1.0, *e)).collect::<Vec<_>>();
    TimeSeries::new("Moving peaks: error after a change", "iteration after the change", "error / optimum")
        .curve("without sensitive particles", Color::Orange, curve(&without))
        .curve("with sensitive particles", Color::Blue, curve(&with))
        .write(out.join("peaks_error.png"))?;
    Ok(())
}

fn follow(args: &Args, params: SwarmParams) -> Result<Track> {
    let iterations = usize::from(args.iterations);
    let mut track = Track {
        before_change: Vec::new(),
        after_change: vec![0.0; iterations],
        noticed: 0,
        evaluations: 0,
        best: Vec::new(),
    };
    for seed in args.common.seed..args.common.seed + args.seeds() {
        let mut peaks = MovingPeaks::new(MovingPeaksParams::default(), Seed(seed).derive(1))?;
        let mut search = Search::new(MovingPeaks::space()?, Swarm::new(2, params, Seed(seed))?)?;
        for _ in 0..CHANGES {
            for mean in &mut track.after_change {
                search.advance(&peaks, usize::MAX)?;
                let error = search.best().map_or(f64::NAN, |(place, _)| peaks.relative_error(place));
                *mean += error / (CHANGES as u64 * args.seeds()) as f64;
            }
            track.before_change.extend(search.best().map(|(place, _)| peaks.relative_error(place)));
            peaks.change();
        }
        track.noticed += search.optimizer().changes();
        track.evaluations += search.evaluations();
        track.best = search.best().map_or_else(Vec::new, |(place, _)| place.to_vec());
    }
    Ok(track)
}
