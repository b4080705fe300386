//! The plants that stand still: three of the paper's sheet, and twenty random ones.

use super::{
    Args, Plant, Result,
    methods::{Method, Scale},
    name_of,
};
use agv_nav::{
    control::{
        optimize::{History, Outcome},
        pid::Pid,
        plant::{ActuatorLimits, LinearPlant, StandIn, TransferFunction},
        step_response::{
            PidGains, StepMetrics, StepMetricsParams, StepResponse, StepTest, StepTestParams, simulate_step,
        },
    },
    core::compute::Seed,
};
use agv_support::{
    cli::Report,
    plot::{Color, TimeSeries},
    timing::Timings,
};
use rand::RngExt;
use std::path::Path;

/// Long searches that find the best cost that is known.
const LONG: usize = 10_000;

/// A plant and what is to be reached on it.
struct Problem {
    plant: LinearPlant,
    test: StepTest,
    greatest: f64,
    /// A cost that is a success.
    target: f64,
}

impl Problem {
    fn new(args: &Args, plant: LinearPlant, test: StepTestParams, greatest: f64) -> Result<Self> {
        let test = StepTest::new(&plant, test)?;
        let mut problem = Self { plant, test, greatest, target: f64::INFINITY };
        let gain_scale = Args { scale: Some(Scale::Gain), common: args.common.clone(), ..*args };
        for method in [Method::Improved, Method::De, Method::CmaEs] {
            for seed in 0..3 {
                let seed = Seed(seed).derive(1);
                let found =
                    method.search(&gain_scale, (&problem.test, greatest), LONG, seed, &mut Timings::default())?;
                problem.target = problem.target.min(1.05 * found.0.cost);
            }
        }
        Ok(problem)
    }
}

/// What a method did over the seeds.
struct Results {
    runs: Vec<(Outcome, History)>,
    timings: Timings,
    target: f64,
}

impl Results {
    fn of(args: &Args, method: Method, problem: &Problem) -> Result<Self> {
        let mut timings = Timings::default();
        let one = |timings: &mut Timings, seed: u64| {
            method.search(args, (&problem.test, problem.greatest), args.budget(), Seed(seed), timings)
        };
        let seeds = args.common.seed..args.common.seed + args.seeds();
        let runs = seeds.map(|seed| one(&mut timings, seed)).collect::<Result<_>>()?;
        Ok(Self { runs, timings, target: problem.target })
    }

    fn success_rate(&self) -> f64 {
        self.runs.iter().filter(|(outcome, _)| outcome.cost <= self.target).count() as f64 / self.runs.len() as f64
    }

    /// The run of least cost.
    fn best(&self) -> Option<&(Outcome, History)> {
        self.runs.iter().min_by(|a, b| a.0.cost.total_cmp(&b.0.cost))
    }

    /// The run of median cost: what to expect of one seed.
    fn typical(&self) -> Option<&(Outcome, History)> {
        let mut runs: Vec<_> = self.runs.iter().collect();
        runs.sort_by(|a, b| a.0.cost.total_cmp(&b.0.cost));
        runs.get(runs.len().saturating_sub(1) / 2).copied()
    }

    fn median_cost(&self) -> f64 {
        median(self.runs.iter().map(|(outcome, _)| outcome.cost))
    }

    /// Median over the successful runs.
    fn evaluations_to_success(&self) -> f64 {
        median(self.runs.iter().filter_map(|(_, history)| history.evaluations_to(self.target)).map(|n| n as f64))
    }

    /// Median number of iterations until a run is within 1 % of its own end: what the paper calls settled.
    fn iterations_to_own_end(&self) -> f64 {
        let own = |(outcome, history): &(Outcome, History)| history.iterations_to(1.01 * outcome.cost);
        median(self.runs.iter().filter_map(own).map(|n| n as f64))
    }
}

/// `p1`, `p2` and `p3`.
pub(crate) fn run(args: &Args, out: &Path, report: &mut Report) -> Result<()> {
    let plant = match args.plant {
        Plant::P2 => StandIn::P2,
        Plant::P3 => StandIn::P3,
        _ => StandIn::P1,
    };
    let test = *plant.step_test()?.params();
    let mut problem = Problem::new(args, plant.plant()?, test, plant.greatest_gain())?;
    if plant == StandIn::P1 {
        problem.target = 0.0451;
    }
    if args.method == Method::All {
        return table(args, &problem, report);
    }
    let results = Results::of(args, args.method, &problem)?;
    let standard = Results::of(args, Method::Pso, &problem)?;
    let (Some(best), Some(typical), Some(classic)) = (results.best(), results.typical(), standard.typical()) else {
        return Ok(());
    };
    report
        .number("success_rate", results.success_rate())
        .number("best_cost", best.0.cost)
        .number("median_cost", results.median_cost())
        .count("evaluations", best.0.evaluations)
        .number("run_ms_median", results.timings.milliseconds(50.0))
        .numbers("gains", &best.0.point)
        .number("target_cost", problem.target)
        .number("evaluations_to_success", results.evaluations_to_success())
        .number("iterations_to_own_end", results.iterations_to_own_end());
    let (_, metrics) = respond(&problem, &best.0.point)?;
    report
        .number("settling_time_s", metrics.settling_time.unwrap_or(f64::NAN))
        .number("rise_time_s", metrics.rise_time.unwrap_or(f64::NAN))
        .number("overshoot_percent", 100.0 * metrics.overshoot);
    draw(args, out, &problem, &results, [classic, typical])
}

/// Figs. 30 to 34: cost and gains over the iterations, and step responses.
fn draw(
    args: &Args,
    out: &Path,
    problem: &Problem,
    results: &Results,
    [classic, typical]: [&(Outcome, History); 2],
) -> Result<()> {
    let plant = name_of(&args.plant).to_uppercase();
    let method = name_of(&args.method);
    let file = |what: &str| out.join(format!("{}_{what}.png", plant.to_lowercase()));

    let title = format!("{plant}: cost over the evaluations, {method} in every seed");
    let mut costs = TimeSeries::new(title, "evaluations", "log10 of ITAE");
    let curve = |history: &History| -> Vec<_> {
        history.records().map(|record| (record.evaluations as f64, record.cost.log10())).collect()
    };
    for (_, history) in &results.runs {
        costs = costs.curve("", Color::Sky, curve(history));
    }
    let end = args.budget() as f64;
    costs
        .curve("success", Color::Grey, [(0.0, problem.target.log10()), (end, problem.target.log10())])
        .curve("standard, median seed", Color::Orange, curve(&classic.1))
        .curve(&format!("{method}, median seed"), Color::Blue, curve(&typical.1))
        .write(file("convergence"))?;

    for (at, gain) in ["kp", "ki", "kd"].into_iter().enumerate() {
        let curve =
            |history: &History| history.records().map(|r| (r.iteration as f64, r.point[at])).collect::<Vec<_>>();
        TimeSeries::new(format!("{plant}: {gain} of the best particle, median seed"), "iteration", gain)
            .curve("standard", Color::Orange, curve(&classic.1))
            .curve(&method, Color::Blue, curve(&typical.1))
            .write(file(gain))?;
    }

    let unit = if args.plant == Plant::P2 { "y [m]" } else { "y" };
    let mut steps = TimeSeries::new(format!("{plant}: step responses, median seed"), "time [s]", unit);
    for (label, color, (outcome, _)) in [("standard", Color::Orange, classic), (method.as_str(), Color::Blue, typical)]
    {
        let (response, _) = respond(problem, &outcome.point)?;
        let points = response.outputs.iter().enumerate().map(|(k, y)| (k as f64 * response.dt, *y));
        steps = steps.curve(label, color, points);
    }
    steps.write(file("step"))?;
    Ok(())
}

/// The step response of some gains, by the controller that a vehicle would run.
fn respond(problem: &Problem, gains: &[f64]) -> Result<(StepResponse, StepMetrics)> {
    let (test, gains) = (problem.test.params(), PidGains::from([gains[0], gains[1], gains[2]]));
    let mut pid = Pid::new(problem.test.controller(gains))?;
    let mut response = StepResponse::default();
    simulate_step(&mut problem.plant.clone(), &mut pid, test.set_point, test.dt, test.horizon, &mut response)?;
    let metrics = response.metrics(StepMetricsParams::default())?;
    Ok((response, metrics))
}

/// All methods side by side, on standard error: standard output is for the report.
fn table(args: &Args, problem: &Problem, report: &mut Report) -> Result<()> {
    eprintln!(
        "| method | success | median cost | best cost | evaluations to success | iterations to own end | rise s | settling s | overshoot % | ms |"
    );
    eprintln!("|---|---|---|---|---|---|---|---|---|---|");
    for method in Method::EACH {
        let results = Results::of(args, method, problem)?;
        let Some((best, _)) = results.best() else { continue };
        let (_, metrics) = respond(problem, &best.point)?;
        let name = name_of(&method);
        eprintln!(
            "| {name} | {:.2} | {:.5} | {:.5} | {:.0} | {:.1} | {:.2} | {:.2} | {:.2} | {:.2} |",
            results.success_rate(),
            results.median_cost(),
            best.cost,
            results.evaluations_to_success(),
            results.iterations_to_own_end(),
            metrics.rise_time.unwrap_or(f64::NAN),
            metrics.settling_time.unwrap_or(f64::NAN),
            100.0 * metrics.overshoot,
            results.timings.milliseconds(50.0),
        );
        report.number(&format!("success_rate_{}", name.replace('-', "_")), results.success_rate());
    }
    report.number("target_cost", problem.target);
    Ok(())
}

/// Twenty plants `k ω² / (s² + 2 ζ ω s + ω²)` with gains over a decade, frequencies over 0.9 and any damping; limits, test
/// and gains as on P1.
pub(crate) fn run_random(args: &Args, report: &mut Report) -> Result<()> {
    let methods: &[Method] = if args.method == Method::All { &Method::EACH } else { &[args.method] };
    let mut stream = Seed(20).stream(0, 0);
    let mut problems = Vec::new();
    for _ in 0..20 {
        let gain = 0.3 * 10_f64.powf(stream.random());
        let frequency = 0.5 * 8_f64.powf(stream.random());
        let damping = 0.1 + 1.4 * stream.random::<f64>();
        let square = frequency * frequency;
        let transfer = TransferFunction::new(&[gain * square], &[1.0, 2.0 * damping * frequency, square])?;
        let plant = LinearPlant::new(transfer)?.with_actuator(ActuatorLimits::symmetric(10.0))?;
        problems.push(Problem::new(args, plant, StepTestParams::default(), StandIn::P1.greatest_gain())?);
    }
    for &method in methods {
        let mut timings = Timings::default();
        let (mut rates, mut ratios, mut gains) = (Vec::new(), Vec::new(), Vec::new());
        for problem in &problems {
            let results = Results::of(args, method, problem)?;
            rates.push(results.success_rate());
            ratios.extend(results.runs.iter().map(|(outcome, _)| 1.05 * outcome.cost / problem.target));
            gains = results.best().map_or(gains, |(outcome, _)| outcome.point.clone());
            timings.append(results.timings);
        }
        let mean = rates.iter().sum::<f64>() / rates.len() as f64;
        let worst = rates.iter().copied().fold(1.0, f64::min);
        if args.method == Method::All {
            let key = name_of(&method).replace('-', "_");
            report.number(&format!("success_rate_{key}"), mean).number(&format!("worst_plant_{key}"), worst);
            continue;
        }
        // Costs are parts of the best that is known of each plant.
        report
            .number("success_rate", mean)
            .number("success_rate_worst_plant", worst)
            .number("best_cost", ratios.iter().copied().fold(f64::INFINITY, f64::min))
            .number("median_cost", median(ratios))
            .count("evaluations", args.budget())
            .number("run_ms_median", timings.milliseconds(50.0))
            .numbers("gains", &gains);
    }
    Ok(())
}

/// NaN of nothing.
pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len().saturating_sub(1) / 2).copied().unwrap_or(f64::NAN)
}
