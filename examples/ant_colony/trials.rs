//! Runs over maps and seeds, and what they come to.

use super::{
    Args, Result,
    cases::{Case, Set},
    methods::{Row, Search},
};
use agv_nav::{
    core::{
        compute::{Par, Seed},
        metrics::{PathQuality, PathQualityParams},
        path::Path,
        roles::{GlobalPlanner, PlanOutcome},
    },
    plan::{
        aco::{AntColony, Iteration, Run, SparrowSearch},
        grid::GridPlannerParams,
        smooth::{KeyNodes, LineOfSightParams},
    },
};
use agv_support::{cli::Report, progress::Progress};
use std::time::Instant;

/// One run.
#[derive(Clone)]
struct Trial {
    path: Path,
    converged: usize,
    milliseconds: f64,
    best_so_far: Vec<f64>,
}

/// Least, mean and greatest; NaN of nothing.
pub(crate) struct Spread {
    pub(crate) least: f64,
    pub(crate) mean: f64,
    pub(crate) greatest: f64,
}

impl Spread {
    fn of(values: &[f64]) -> Self {
        let fold = |f: fn(f64, f64) -> f64| values.iter().copied().reduce(f).unwrap_or(f64::NAN);
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        Self { least: fold(f64::min), mean, greatest: fold(f64::max) }
    }
}

/// A line of a table.
pub(crate) struct Summary {
    pub(crate) name: &'static str,
    pub(crate) runs: usize,
    pub(crate) found: usize,
    pub(crate) length: Spread,
    /// To the shortest octile path without cut corners.
    pub(crate) ratio: Spread,
    /// To the shortest path of any angle.
    pub(crate) any_angle: Spread,
    pub(crate) turns: Spread,
    pub(crate) iterations: Spread,
    pub(crate) milliseconds: f64,
}

impl Summary {
    /// Part of the runs that found a path.
    pub(crate) fn solved(&self) -> f64 {
        self.found as f64 / self.runs.max(1) as f64
    }

    pub(crate) fn report(&self) -> Report {
        let mut report = Report::new(self.name);
        report.text("algorithm", self.name).count("runs", self.runs).count("solved", self.found);
        for (key, spread) in [
            ("length_m", &self.length),
            ("ratio", &self.ratio),
            ("any_angle_ratio", &self.any_angle),
            ("turns", &self.turns),
            ("iterations", &self.iterations),
        ] {
            report.number(&format!("{key}_best"), spread.least);
            report.number(&format!("{key}_mean"), spread.mean);
            report.number(&format!("{key}_worst"), spread.greatest);
        }
        report.number("ms_mean", self.milliseconds);
        report
    }
}

/// What a picture shows of an algorithm on the first map of a set: its shortest path, and how it came there.
pub(crate) struct Shown {
    pub(crate) name: &'static str,
    pub(crate) path: Path,
    /// Best length so far by iteration, mean over the seeds.
    pub(crate) convergence: Vec<f64>,
}

/// All runs of a set.
pub(crate) struct Trials {
    pub(crate) summaries: Vec<Summary>,
    pub(crate) shown: Vec<Shown>,
}

impl Trials {
    pub(crate) fn run(set: &Set, rows: &[Row], args: &Args, progress: &Progress) -> Result<Self> {
        let mut searched: Vec<Vec<Option<Trial>>> = Vec::new();
        let (mut summaries, mut shown) = (Vec::new(), Vec::new());
        for row in rows {
            if row.is_new_search() {
                searched.clear();
                for case in &set.cases {
                    searched.push(search(case, row, args, progress)?);
                }
            }
            let trials = cut_down(&set.cases, &searched, row)?;
            summaries.push(summarise(&set.cases, &trials, row, args.common.par()));
            let best = trials[0].iter().flatten().min_by(|a, b| a.path.length().total_cmp(&b.path.length()));
            if let Some(best) = best {
                let found = trials[0].iter().flatten().count() as f64;
                let at =
                    |i: usize| trials[0].iter().flatten().filter_map(|t| t.best_so_far.get(i)).sum::<f64>() / found;
                let convergence = (0..best.best_so_far.len()).map(at).collect();
                shown.push(Shown { name: row.name, path: best.path.clone(), convergence });
            }
        }
        Ok(Self { summaries, shown })
    }
}

/// All seeds on one map; none where no path was found.
fn search(case: &Case, row: &Row, args: &Args, progress: &Progress) -> Result<Vec<Option<Trial>>> {
    let one = |seed: usize| {
        let trial = run(case, row, args.common.seed().derive(seed as u64)).map_err(|error| error.to_string());
        progress.step();
        vec![trial]
    };
    let join = |mut a: Vec<_>, b: Vec<_>| {
        a.extend(b);
        a
    };
    let all = args.common.par().map_reduce(args.seeds as usize, one, join).unwrap_or_default();
    Ok(all.into_iter().collect::<std::result::Result<_, String>>()?)
}

fn run(case: &Case, row: &Row, seed: Seed) -> Result<Option<Trial>> {
    let grid = GridPlannerParams::default();
    match row.search {
        Search::Colony(params) => {
            timed(case, AntColony::new(grid, params, seed)?, |p| (*p.solver().run(), p.solver().history().to_vec()))
        }
        Search::Sparrows(params) => {
            timed(case, SparrowSearch::new(grid, params, seed)?, |p| (*p.solver().run(), p.solver().history().to_vec()))
        }
    }
}

fn timed<P: GlobalPlanner>(
    case: &Case,
    mut planner: P,
    told: impl Fn(&P) -> (Run, Vec<Iteration>),
) -> Result<Option<Trial>> {
    let mut path = Path::new();
    let start = Instant::now();
    let outcome = planner.plan_into(&case.costmap, &case.start, &case.goal, &mut path)?;
    let milliseconds = start.elapsed().as_secs_f64() * 1e3;
    let PlanOutcome::Found { .. } = outcome else { return Ok(None) };
    let (run, history) = told(&planner);
    let best_so_far = history.iter().map(|iteration| iteration.best_so_far).collect();
    Ok(Some(Trial { path, converged: run.converged, milliseconds, best_so_far }))
}

/// The paths cut down to their key nodes, if the row wants that.
fn cut_down(cases: &[Case], searched: &[Vec<Option<Trial>>], row: &Row) -> Result<Vec<Vec<Option<Trial>>>> {
    let mut trials = searched.to_vec();
    let Some(margin) = row.key_nodes else { return Ok(trials) };
    let key_nodes = KeyNodes::new(LineOfSightParams { margin, ..Default::default() })?;
    for (case, trials) in cases.iter().zip(&mut trials) {
        for trial in trials.iter_mut().flatten() {
            let start = Instant::now();
            let mut short = Path::new();
            key_nodes.shorten_into(&case.costmap, &trial.path, &mut short)?;
            trial.milliseconds += start.elapsed().as_secs_f64() * 1e3;
            trial.path = short;
        }
    }
    Ok(trials)
}

fn summarise(cases: &[Case], trials: &[Vec<Option<Trial>>], row: &Row, par: Par) -> Summary {
    let found: Vec<(&Case, &Trial)> = cases
        .iter()
        .zip(trials)
        .flat_map(|(case, trials)| trials.iter().flatten().map(move |trial| (case, trial)))
        .collect();
    let spread =
        |of: &dyn Fn(&Case, &Trial) -> f64| Spread::of(&found.iter().map(|(c, t)| of(c, t)).collect::<Vec<_>>());
    // Times of runs that share the machine say nothing.
    let milliseconds = if par == Par::Seq { spread(&|_, trial| trial.milliseconds).mean } else { f64::NAN };
    Summary {
        name: row.name,
        runs: trials.iter().map(Vec::len).sum(),
        found: found.len(),
        length: spread(&|_, trial| trial.path.length()),
        ratio: spread(&|case, trial| trial.path.length() / case.octile),
        any_angle: spread(&|case, trial| trial.path.length() / case.any_angle),
        turns: spread(&|_, trial| turns(&trial.path) as f64),
        iterations: spread(&|_, trial| trial.converged as f64),
        milliseconds,
    }
}

/// Points where the direction changes.
fn turns(path: &Path) -> usize {
    PathQuality::of(path, PathQualityParams::default(), |_| 0.0).map_or(0, |quality| quality.turns)
}
