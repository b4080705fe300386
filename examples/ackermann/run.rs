//! All queries, one after another, and what came of them.

use crate::{
    Args, Result,
    check::{Verdict, check},
    site::{self, Site},
};
use agv_core::{
    geometry::Se2,
    grid::{CellState, Costmap, Footprint, Grid, Inflation, InflationParams},
    metrics::Statistics,
    path::Path,
    roles::{GlobalPlanner as _, NoPathReason, PlanOutcome},
};
use agv_plan::{
    grid::{CornerRule, GridParams, GridSpace, Potential},
    hybrid::{HybridAStar, HybridAStarParams, ReedsShepp},
};
use agv_support::{cli::Report, progress::Progress, timing::Timings};

/// One query and its answer.
pub(crate) struct Run {
    pub(crate) query: (Se2, Se2),
    pub(crate) path: Path,
    pub(crate) outcome: PlanOutcome,
    pub(crate) verdict: Verdict,
    /// Length against a lower bound on it.
    pub(crate) ratio: f64,
}

pub(crate) struct Runs {
    pub(crate) answers: Vec<Run>,
    pub(crate) timings: Timings,
    pub(crate) footprint: Footprint,
    radius: f64,
}

pub(crate) fn queries(args: &Args, site: &Site) -> Result<Runs> {
    let (params, footprint) = site::vehicle(args)?;
    let mut planner = HybridAStar::new(params, footprint.clone())?;
    let mut bound = Bound::new(&site.map, &footprint, &params)?;
    let (mut runs, mut timings) = (Vec::new(), Timings::default());
    // The map is taken in once, as a vehicle does when it starts.
    let (anywhere, mut path) = (site.queries[0].0, Path::new());
    let _ = planner.plan_into(&site.costmap, &anywhere, &anywhere, &mut path);
    let progress = Progress::new(site.queries.len(), "planning");
    for &query in progress.over(&site.queries) {
        let mut path = Path::new();
        let outcome = timings.time(|| planner.plan_into(&site.costmap, &query.0, &query.1, &mut path))?;
        let verdict = check(&site.map, &footprint, &path, params.spacing);
        let least = bound.between(query)?;
        let ratio =
            if matches!(outcome, PlanOutcome::Found { .. }) && least > 0.0 { path.length() / least } else { f64::NAN };
        runs.push(Run { query, path, outcome, verdict, ratio });
    }
    Ok(Runs { answers: runs, timings, footprint, radius: params.turning_radius })
}

/// No path is shorter: neither than the curve without obstacles, nor than the way of a circle around them.
struct Bound {
    space: GridSpace,
    potential: Potential,
    curves: ReedsShepp,
    crabs: bool,
}

impl Bound {
    fn new(map: &Grid<CellState>, footprint: &Footprint, params: &HybridAStarParams) -> Result<Self> {
        // Cells whose every pose collides, no others: hence the half diagonal.
        let radius = (footprint.inscribed_radius() - 0.71 * map.layout().resolution()).max(1e-3);
        let circle =
            InflationParams { inscribed_radius: radius, inflation_radius: radius, ..InflationParams::default() };
        let costmap: Costmap = Inflation::new(circle)?.inflate(map)?;
        let mut space = GridSpace::new(GridParams { corner_rule: CornerRule::Free, ..GridParams::default() })?;
        space.update(&costmap);
        let curves = ReedsShepp::new(params.turning_radius)?;
        Ok(Self { space, potential: Potential::default(), curves, crabs: params.crab_angle > 0.0 })
    }

    fn between(&mut self, (start, goal): (Se2, Se2)) -> Result<f64> {
        let layout = *self.space.layout().ok_or("no map")?;
        let node = |pose: &Se2| layout.cell_at(&pose.translation()).and_then(|cell| self.space.node(cell));
        let (Some(from), Some(to)) = (node(&start), node(&goal)) else { return Ok(f64::NAN) };
        self.potential.compute(&self.space, to)?;
        // Eight directions are up to 8 % longer than any, and cells are left and entered at a corner.
        let cells = (self.potential.distance(from).unwrap_or(0.0) * std::f64::consts::FRAC_PI_8.cos() - 2.0).max(0.0);
        let curve = if self.crabs { 0.0 } else { self.curves.cost(&start, &goal)? };
        Ok((cells * layout.resolution()).max(curve))
    }
}

pub(crate) fn report(all: &Runs, report: &mut Report) {
    let runs = &all.answers;
    let unsolved = |wanted: NoPathReason| {
        let is = |run: &&Run| matches!(run.outcome, PlanOutcome::NoPath { reason, .. } if reason == wanted);
        runs.iter().filter(is).count()
    };
    let expansions: Vec<f64> = runs
        .iter()
        .map(|run| match run.outcome {
            PlanOutcome::Found { expansions, .. } | PlanOutcome::NoPath { expansions, .. } => expansions as f64,
            _ => 0.0,
        })
        .collect();
    let solved = runs.iter().filter(|run| matches!(run.outcome, PlanOutcome::Found { .. }));
    report.count("queries", runs.len()).count("solved", solved.clone().count());
    report.count("unsolved_start_blocked", unsolved(NoPathReason::StartBlocked));
    report.count("unsolved_goal_blocked", unsolved(NoPathReason::GoalBlocked));
    report.count("unsolved_disconnected", unsolved(NoPathReason::Disconnected));
    report.count("unsolved_budget", unsolved(NoPathReason::Budget));
    report.number("mean_ms", all.timings.total_milliseconds() / all.timings.count() as f64);
    report.number("median_ms", all.timings.milliseconds(50.0)).number("p99_ms", all.timings.milliseconds(99.0));
    report.number("max_ms", all.timings.milliseconds(100.0));
    if let Ok(expansions) = Statistics::new(expansions) {
        report.number("expansions_mean", expansions.mean()).number("expansions_p99", expansions.percentile(99.0));
    }
    if let Ok(ratios) = Statistics::new(solved.clone().map(|run| run.ratio).filter(|r| r.is_finite()).collect()) {
        report.number("length_ratio_mean", ratios.mean()).number("length_ratio_max", ratios.max());
    }
    let sum = |of: fn(&Verdict) -> usize| runs.iter().map(|run| of(&run.verdict)).sum::<usize>();
    report.number("path_length_m", solved.map(|run| run.path.length()).sum());
    report
        .count("cusps", sum(|v| v.cusps))
        .count("collisions", sum(|v| v.collisions))
        .count("faults", sum(|v| v.faults));
    let tightest = runs.iter().map(|run| run.verdict.curvature).fold(0.0, f64::max);
    report.number("curvature_max_per_m", tightest).number("curvature_limit_per_m", 1.0 / all.radius);
}
