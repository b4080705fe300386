//! A vehicle whose load changes while it drives: its speed controller is tuned on, a few evaluations in every cycle.
//!
//! The vehicle is a [`DrivePlant`] with dry friction, driven by a [`Pid`] that takes each proposal without a bump. The tuner's
//! model is linear and has no friction; it knows the load, as from the scale of the fork.

use super::{Args, Result, stand_in::median};
use agv_nav::{
    control::{
        Objective,
        optimize::SearchSpace,
        pid::{Pid, PidParams},
        plant::{DriveParams, DrivePlant, Plant},
        pso::SwarmParams,
        step_response::{PidGains, StepTestParams},
        tune::{OnlineTuner, OnlineTunerParams, StepCost, StepCostParams, gain_space, tune_pid},
    },
    core::{compute::Seed, roles::Controller},
};
use agv_support::{
    cli::Report,
    plot::{Color, TimeSeries},
    timing::Timings,
};
use rand::RngExt;
use std::path::Path;

/// How often the load changes, and control cycles between two changes: two seconds at 100 Hz.
const CHANGES: usize = 40;
const CYCLES: usize = 200;
const DT: f64 = 0.01;

/// Speeds that are asked for in turn, in m/s, for as many cycles each: a step after each change of the load, and three more.
const SPEEDS: [f64; 4] = [1.0, 0.6, 1.2, 0.8];
const HOLD: usize = CYCLES / SPEEDS.len();

/// Greatest gains: V per m/s, per m, per m/s².
const GREATEST: [f64; 3] = [500.0, 2000.0, 50.0];

/// A load, its cost of gains, and the least cost that is known.
struct Stage {
    load: f64,
    cost: StepCost,
    best: f64,
}

pub(crate) fn run(args: &Args, out: &Path, report: &mut Report) -> Result<()> {
    let stages = stages(args)?;
    let empty = tune_pid(&stages[0].cost, GREATEST.into(), args.common.seed())?;
    let start = <[f64; 3]>::from(empty.gains);
    let with = OnlineTunerParams::default();
    let without = OnlineTunerParams { swarm: SwarmParams { sensing: None, ..with.swarm }, ..with };

    let mut timings = Timings::default();
    let tuned = drive(args, &stages, &start, Some(with), &mut timings)?;
    let blind = drive(args, &stages, &start, Some(without), &mut Timings::default())?;
    let fixed = drive(args, &stages, &start, None, &mut Timings::default())?;

    // Costs are parts of the best that is known for the load of the moment.
    let ends: Vec<f64> = tuned.ratios.iter().skip(CYCLES - 1).step_by(CYCLES).copied().collect();
    let within = |stage: &[f64]| stage.iter().position(|ratio| *ratio <= 1.05).map(|cycle| cycle as f64 + 1.0);
    let mean = |ratios: &[f64]| ratios.iter().sum::<f64>() / ratios.len() as f64;
    report
        .number("success_rate", ends.iter().filter(|ratio| **ratio <= 1.05).count() as f64 / ends.len() as f64)
        .number("best_cost", ends.iter().copied().fold(f64::INFINITY, f64::min))
        .number("median_cost", median(ends.iter().copied()))
        .count("evaluations", tuned.evaluations)
        .number("run_ms_median", timings.milliseconds(50.0))
        .numbers("gains", &tuned.gains)
        .count("changes", CHANGES)
        .count("changes_noticed", tuned.noticed)
        .number("cycles_to_success_median", median(tuned.ratios.chunks(CYCLES).filter_map(within)))
        .number("cost_ratio_mean", mean(&tuned.ratios))
        .number("cost_ratio_mean_without_sensing", mean(&blind.ratios))
        .number("cost_ratio_mean_fixed_gains", mean(&fixed.ratios))
        .number("speed_error_mean", mean(&tuned.errors))
        .number("speed_error_mean_without_sensing", mean(&blind.errors))
        .number("speed_error_mean_fixed_gains", mean(&fixed.errors))
        .number("cycle_ms_p99", timings.milliseconds(99.0));
    draw(out, &stages, &tuned, &fixed, &blind)
}

/// The loads: empty at first, then anything up to 800 kg.
fn stages(args: &Args) -> Result<Vec<Stage>> {
    let mut stream = args.common.seed().derive(1).stream(0, 0);
    let test = StepTestParams { horizon: 3.0, ..StepTestParams::default() };
    let weights = StepCostParams { overshoot_weight: 2.0, travel_weight: 1e-4, ..StepCostParams::default() };
    let mut stages = Vec::new();
    for change in 0..CHANGES {
        let load = if change == 0 { 0.0 } else { 800.0 * stream.random::<f64>() };
        let cost = StepCost::new(&[DriveParams::default().linear(load)?], test, weights)?;
        let found = (0..2).map(|seed| tune_pid(&cost, GREATEST.into(), Seed(seed)).map(|tuned| tuned.cost));
        let best = found.collect::<std::result::Result<Vec<_>, _>>()?.into_iter().fold(f64::INFINITY, f64::min);
        stages.push(Stage { load, cost, best });
    }
    Ok(stages)
}

/// What a tuner did.
struct Drive {
    /// Cost of the gains in use in every cycle, as a part of the best.
    ratios: Vec<f64>,
    /// Speed of the vehicle in every cycle, in m/s, and its distance from what was asked for.
    speeds: Vec<f64>,
    errors: Vec<f64>,
    evaluations: usize,
    noticed: usize,
    gains: Vec<f64>,
}

fn drive(
    args: &Args,
    stages: &[Stage],
    start: &[f64; 3],
    params: Option<OnlineTunerParams>,
    timings: &mut Timings,
) -> Result<Drive> {
    let space: SearchSpace = gain_space(GREATEST.into())?;
    let mut tuner = OnlineTuner::new(space, start, params.unwrap_or_default(), args.common.seed())?;
    let mut pid = Pid::new(speed_controller((*start).into()))?;
    let mut vehicle = DrivePlant::new(DriveParams::default())?;
    let (mut ratios, mut speeds, mut errors) = (Vec::new(), Vec::new(), Vec::new());
    for stage in stages {
        vehicle.set_load(stage.load)?;
        for cycle in 0..CYCLES {
            if params.is_some() && timings.time(|| tuner.cycle(&stage.cost).map(|proposal| proposal.moved))? {
                pid.set_params(speed_controller(<[f64; 3]>::try_from(tuner.values())?.into()))?;
            }
            ratios.push(stage.cost.evaluate(tuner.values()) / stage.best);
            let asked = SPEEDS[cycle / HOLD];
            let voltage = pid.update(asked, vehicle.output(), DT)?;
            let speed = vehicle.step(voltage, DT)?;
            speeds.push(speed);
            errors.push((asked - speed).abs());
        }
    }
    let gains = tuner.values().to_vec();
    Ok(Drive { ratios, speeds, errors, evaluations: tuner.search().evaluations(), noticed: tuner.changes(), gains })
}

/// The controller that the vehicle runs: gains, the model's filter, and the supply's limits.
fn speed_controller(gains: PidGains) -> PidParams {
    let supply = DriveParams::default().supply;
    PidParams {
        proportional: gains.proportional,
        integral: gains.integral,
        derivative: gains.derivative,
        filter_time: StepTestParams::default().filter_time,
        output_min: -supply,
        output_max: supply,
        ..PidParams::default()
    }
}

fn draw(out: &Path, stages: &[Stage], tuned: &Drive, fixed: &Drive, blind: &Drive) -> Result<()> {
    let shown = 10 * CYCLES;
    let curve = |ratios: &[f64]| {
        ratios.iter().take(shown).enumerate().map(|(k, ratio)| (k as f64 * DT, ratio.log10())).collect::<Vec<_>>()
    };
    TimeSeries::new("Speed control under changing load: cost of the gains in use", "time [s]", "log10 of cost / best")
        .curve("tuned without sensitive particles", Color::Orange, curve(&blind.ratios))
        .curve("tuned with sensitive particles", Color::Blue, curve(&tuned.ratios))
        .write(out.join("load_cost.png"))?;
    let over_time = |speeds: &[f64]| {
        speeds.iter().take(5 * CYCLES).enumerate().map(|(k, speed)| (k as f64 * DT, *speed)).collect::<Vec<_>>()
    };
    TimeSeries::new("Speed control under changing load", "time [s]", "speed [m/s]")
        .curve("asked for", Color::Grey, (0..5 * CYCLES).map(|k| (k as f64 * DT, SPEEDS[k % CYCLES / HOLD])))
        .curve("gains of the empty vehicle", Color::Orange, over_time(&fixed.speeds))
        .curve("tuned while it drives", Color::Blue, over_time(&tuned.speeds))
        .write(out.join("load_speed.png"))?;
    let loads = stages.iter().enumerate().take(10).flat_map(|(k, stage)| [(k, stage.load), (k + 1, stage.load)]);
    TimeSeries::new("Load", "time [s]", "load [kg]")
        .curve("", Color::Blue, loads.map(|(k, load)| ((k * CYCLES) as f64 * DT, load)))
        .write(out.join("load_load.png"))?;
    Ok(())
}
