//! Asks the queries, times the answers and judges them.

use super::{
    Args, lines,
    planners::Planner,
    site::{Query, Site},
};
use agv_nav::core::{metrics::Statistics, path::Path, roles::PlanOutcome};
use agv_support::{cli::Report, progress::Progress};
use std::time::Instant;

/// How far a length may be from the stated optimum, in cells: older sets state five digits.
const TOLERANCE: f64 = 1e-2;

/// What came of all queries.
#[derive(Default)]
pub(crate) struct Tally {
    queries: usize,
    unsolved: usize,
    mismatches: usize,
    first_mismatch: Option<String>,
    /// Of the first query without a path.
    reason: Option<String>,
    prepare_ms: f64,
    micros: Vec<f64>,
    expansions: u64,
    lengths: f64,
    /// Lengths over stated optima.
    ratios: Vec<f64>,
}

pub(crate) fn all(args: &Args, site: &Site, planner: &mut dyn Planner) -> Tally {
    let mut tally = Tally { queries: site.queries.len(), ..Default::default() };
    let mut path = Path::new();
    // The way from a place to itself: the planner sees the map, and nothing is searched.
    if let Some(Query { start, .. }) = site.queries.first() {
        let begin = Instant::now();
        // A place off the map is refused, once the map was seen; the queries say so.
        let _ = planner.plan_into(&site.costmap, start, start, &mut path);
        tally.prepare_ms = begin.elapsed().as_secs_f64() * 1e3;
    }
    let repeats = if args.algorithm.remembers() { 1 } else { args.repeats };
    let progress = Progress::new(site.queries.len(), "planning");
    for (number, query) in progress.over(site.queries.iter().enumerate()) {
        let (mut fastest, mut outcome) = (f64::INFINITY, None);
        for _ in 0..repeats {
            let begin = Instant::now();
            let answer = planner.plan_into(&site.costmap, &query.start, &query.goal, &mut path);
            fastest = fastest.min(begin.elapsed().as_secs_f64() * 1e6);
            outcome = Some(answer);
        }
        tally.micros.push(fastest);
        match outcome {
            Some(Ok(PlanOutcome::Found { cost, expansions })) => {
                tally.expansions += expansions;
                tally.lengths += cost;
                let length = cost / site.resolution();
                tally.judge(args, site, (number, query), length, &path);
            }
            Some(Ok(PlanOutcome::NoPath { reason, expansions })) => {
                tally.expansions += expansions;
                tally.unsolved += 1;
                tally.reason.get_or_insert_with(|| format!("{reason:?}"));
            }
            Some(Err(refusal)) => {
                tally.unsolved += 1;
                tally.reason.get_or_insert_with(|| refusal.to_string());
            }
            _ => tally.unsolved += 1,
        }
    }
    tally
}

impl Tally {
    /// Holds a length, in cells, against the stated one, and the path against its length and the map.
    fn judge(&mut self, args: &Args, site: &Site, (number, query): (usize, &Query), length: f64, path: &Path) {
        let measured = path.length() / site.resolution();
        let free = |pose: &agv_nav::core::geometry::Se2| {
            let cell = site.costmap.layout().cell_at(&pose.translation());
            cell.is_some_and(|cell| site.costmap.is_traversable(cell))
        };
        let any_angle = args.algorithm.is_any_angle();
        let lines_are_free = || lines::are_free(args.algorithm, &site.costmap, path);
        let fault = if (measured - length).abs() > TOLERANCE && query.optimum.is_some() {
            Some(format!("the path measures {measured} cells, not {length}"))
        } else if !(if any_angle { lines_are_free() } else { path.points().iter().all(|point| free(&point.pose)) }) {
            Some("the path enters a blocked cell".to_owned())
        } else {
            query.optimum.and_then(|optimum| {
                let direct = (query.goal.translation() - query.start.translation()).norm() / site.resolution();
                // The integers of the search round each line up by a thousandth of a cell.
                let good = if any_angle {
                    length >= direct - TOLERANCE && length <= optimum * (1.0 + 1e-3) + TOLERANCE
                } else {
                    (length - optimum).abs() <= TOLERANCE
                };
                self.ratios.extend((optimum > 0.0).then(|| length / optimum));
                (!good).then(|| format!("{length} cells instead of {optimum}"))
            })
        };
        if let Some(fault) = fault {
            self.mismatches += 1;
            self.first_mismatch.get_or_insert_with(|| format!("query {}: {fault}", number + 1));
        }
    }

    pub(crate) fn holds(&self) -> bool {
        self.mismatches == 0 && self.unsolved == 0
    }

    pub(crate) fn report(&self, args: &Args, report: &mut Report) {
        let total: f64 = self.micros.iter().sum();
        let times = Statistics::new(self.micros.clone());
        let percentile = |percent| times.as_ref().map_or(f64::NAN, |times| times.percentile(percent));
        report.text("algorithm", args.algorithm.name());
        report.count("queries", self.queries).count("mismatches", self.mismatches).count("unsolved", self.unsolved);
        report.number("mean_us", total / self.queries as f64);
        report.number("median_us", percentile(50.0)).number("p99_us", percentile(99.0));
        report.count("expansions", self.expansions as usize);
        report.number("ns_per_expansion", total * 1e3 / self.expansions as f64);
        report.number("prepare_ms", self.prepare_ms).number("length_total_m", self.lengths);
        if let Ok(ratios) = Statistics::new(self.ratios.clone()).as_ref() {
            let mean = ratios.sorted().iter().sum::<f64>() / ratios.count() as f64;
            report.number("ratio_mean", mean).number("ratio_min", ratios.min()).number("ratio_max", ratios.max());
        }
        if let Some(reason) = &self.reason {
            report.text("reason", reason);
        }
        if let Some(mismatch) = &self.first_mismatch {
            report.text("first_mismatch", mismatch);
        }
    }
}
