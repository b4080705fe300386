//! Optimisers on functions that the literature tests them with: how many of 20 seeds get within a small distance of the
//! minimum. Over 500 seeds the rates are 1 on sphere and Rosenbrock; 0.998, 0.992, 0.866 on Rastrigin and 1, 0.996, 0.8 on
//! Griewank for swarm, differential evolution and CMA-ES; the bounds lie at least three standard deviations below.

use agv_control::{
    Objective,
    evolution::{CmaEs, CmaEsParams, DifferentialEvolution, DifferentialEvolutionParams},
    optimize::{Optimizer, Search, SearchSpace, Stopping, Termination},
    pso::{Swarm, SwarmParams},
};
use agv_core::compute::Seed;
use std::f64::consts::TAU;

fn sphere(p: &[f64]) -> f64 {
    p.iter().map(|x| x * x).sum()
}

fn rosenbrock(p: &[f64]) -> f64 {
    p.windows(2).map(|w| 100.0 * (w[1] - w[0] * w[0]).powi(2) + (1.0 - w[0]).powi(2)).sum()
}

fn rastrigin(p: &[f64]) -> f64 {
    p.iter().map(|x| x * x - 10.0 * (TAU * x).cos() + 10.0).sum()
}

fn griewank(p: &[f64]) -> f64 {
    let waves: f64 = p.iter().zip(1..).map(|(x, i)| (x / f64::from(i).sqrt()).cos()).product();
    sphere(p) / 4000.0 - waves + 1.0
}

/// Successes of 20 seeds.
fn successes<O: Optimizer, F: Objective>(
    f: &F,
    half: f64,
    target: f64,
    budget: usize,
    make: impl Fn(Seed) -> O,
) -> usize {
    let stopping = Stopping { target, max_evaluations: budget, ..Stopping::default() };
    // Off the middle of the box, which centred draws would favour.
    let run = |seed| {
        let optimizer = make(Seed(seed));
        let space = SearchSpace::cube(optimizer.dimension(), -half, 0.7 * half).unwrap();
        Search::new(space, optimizer).unwrap().run(f, &stopping).unwrap().termination == Termination::Target
    };
    (0..20).filter(|&seed| run(seed)).count()
}

fn improved(dimension: usize) -> impl Fn(Seed) -> Swarm {
    move |seed| Swarm::new(dimension, SwarmParams::improved(), seed).unwrap()
}

fn differential(dimension: usize) -> impl Fn(Seed) -> DifferentialEvolution {
    move |seed| DifferentialEvolution::new(dimension, DifferentialEvolutionParams::default(), seed).unwrap()
}

fn cma_es(dimension: usize) -> impl Fn(Seed) -> CmaEs {
    move |seed| CmaEs::new(dimension, CmaEsParams::default(), seed).unwrap()
}

#[test]
fn minima_are_found_on_bowls_in_valleys_and_among_peaks() {
    type Function = fn(&[f64]) -> f64;
    // Dimension, half of the box, target, budget, and the least number of successes of each.
    type Row = (&'static str, Function, usize, f64, f64, usize, [usize; 3]);
    let table: [Row; 4] = [
        ("sphere", sphere, 5, 100.0, 1e-3, 6000, [20, 20, 20]),
        ("Rosenbrock", rosenbrock, 3, 5.0, 1e-2, 6000, [20, 20, 20]),
        ("Rastrigin", rastrigin, 2, 5.12, 1e-3, 3000, [18, 18, 12]),
        ("Griewank", griewank, 2, 600.0, 1e-2, 6000, [18, 18, 10]),
    ];
    for (name, f, dimension, half, target, budget, least) in table {
        let found = [
            successes(&f, half, target, budget, improved(dimension)),
            successes(&f, half, target, budget, differential(dimension)),
            successes(&f, half, target, budget, cma_es(dimension)),
        ];
        let enough = found.iter().zip(least).all(|(&found, least)| found >= least);
        assert!(enough, "{name}: swarm, differential evolution, CMA-ES found it {found:?} times of 20");
    }
}
