//! Tuning: milliseconds per run of 2000 evaluations on the plant P1, beside argmin's particle swarm on the same cost; and
//! what a generation costs beside its evaluations.

use agv_control::{
    Objective,
    evolution::{CmaEs, CmaEsParams, DifferentialEvolution, DifferentialEvolutionParams},
    optimize::{Optimizer, Outcome, Search, SearchSpace, Stopping},
    plant::StandIn,
    pso::{Swarm, SwarmParams},
    step_response::StepTest,
    tune::gain_space,
};
use agv_core::compute::Seed;
use argmin::{
    core::{CostFunction, Executor},
    solver::particleswarm::ParticleSwarm,
};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

const EVALUATIONS: u64 = 2000;

fn run<O: Optimizer, F: Objective>(cost: &F, space: SearchSpace, optimizer: O) -> Outcome {
    let mut search = Search::new(space, optimizer).expect("they fit");
    search.run(cost, &Stopping::default()).expect("good criteria")
}

/// argmin asks for one point at a time.
struct Scalar<'a>(&'a StepTest);

impl CostFunction for Scalar<'_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, gains: &Self::Param) -> Result<f64, argmin::core::Error> {
        Ok(self.0.evaluate(gains))
    }
}

fn argmin_cost(test: &StepTest) -> f64 {
    // The first generation is evaluated before the first iteration.
    let solver: ParticleSwarm<Vec<f64>, f64, _> = ParticleSwarm::new((vec![0.0; 3], vec![50.0; 3]), 20);
    let result = Executor::new(Scalar(test), solver).configure(|state| state.max_iters(99)).run().expect("it runs");
    result.state().get_best_cost()
}

fn tuning(c: &mut Criterion) {
    let test = StandIn::P1.step_test().expect("good constants");
    let even = || SearchSpace::cube(3, 0.0, 50.0).expect("good bounds");
    let gains = || gain_space([50.0; 3].into()).expect("good bounds");
    let swarm = |params, seed| Swarm::new(3, params, Seed(seed)).expect("good parameters");

    // Both reach one of the two basins before anything is timed.
    for cost in [run(&test, gains(), swarm(SwarmParams::improved(), 1)).cost, argmin_cost(&test)] {
        assert!((0.042..0.3).contains(&cost), "{cost}");
    }

    let mut group = c.benchmark_group("tuning/p1_2000_evaluations");
    group.sample_size(20).throughput(Throughput::Elements(EVALUATIONS));
    let mut seeds = 0..;
    let mut seed = || seeds.next().expect("endless");
    group.bench_function("improved", |b| b.iter(|| run(&test, gains(), swarm(SwarmParams::improved(), seed()))));
    group.bench_function("paper", |b| b.iter(|| run(&test, even(), swarm(SwarmParams::paper(100), seed()))));
    group.bench_function("standard", |b| b.iter(|| run(&test, even(), swarm(SwarmParams::standard(), seed()))));
    group.bench_function("differential_evolution", |b| {
        b.iter(|| {
            let params = DifferentialEvolutionParams::default();
            run(&test, gains(), DifferentialEvolution::new(3, params, Seed(seed())).expect("good parameters"))
        });
    });
    group.bench_function("cma_es", |b| {
        b.iter(|| run(&test, gains(), CmaEs::new(3, CmaEsParams::default(), Seed(seed())).expect("good parameters")));
    });
    group.bench_function("argmin", |b| b.iter(|| argmin_cost(&test)));
    group.finish();
}

/// A cost that costs nothing: what is left is the optimiser.
fn overhead(c: &mut Criterion) {
    let free = |point: &[f64]| black_box(point[0]);
    let mut group = c.benchmark_group("tuning/overhead_2000_evaluations");
    group.throughput(Throughput::Elements(EVALUATIONS));
    for dimension in [3, 10] {
        let space = || SearchSpace::cube(dimension, 0.0, 1.0).expect("good bounds");
        group.bench_function(format!("improved/{dimension}"), |b| {
            b.iter(|| run(&free, space(), Swarm::new(dimension, SwarmParams::improved(), Seed(1)).expect("good")));
        });
        group.bench_function(format!("cma_es/{dimension}"), |b| {
            b.iter(|| run(&free, space(), CmaEs::new(dimension, CmaEsParams::default(), Seed(1)).expect("good")));
        });
    }
    group.finish();
}

criterion_group!(benches, tuning, overhead);
criterion_main!(benches);
