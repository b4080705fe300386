//! Optimisers: how a generation is spread over threads is not part of a result.

use crate::digest::{Digest, assert_same_bits};
use agv_nav::{
    control::{
        evolution::{CmaEs, CmaEsParams, DifferentialEvolution, DifferentialEvolutionParams},
        optimize::{Optimizer, Search, Stopping},
        plant::StandIn,
        pso::{Swarm, SwarmParams},
        tune::gain_space,
    },
    core::compute::{Par, Seed},
};

fn search(par: Par, optimizer: impl Optimizer) -> Digest {
    let test = StandIn::P1.step_test().unwrap();
    let mut search = Search::new(gain_space([50.0; 3].into()).unwrap(), optimizer).unwrap().with_parallelism(par);
    let stopping = Stopping { max_evaluations: 600, ..Stopping::default() };
    let outcome = search.run(&test, &stopping).unwrap();
    let last = search.optimizer().ask().iter();
    Digest::new().bits(outcome.point.iter().chain([&outcome.cost]).chain(last).map(|x| x.to_bits()))
}

#[test]
fn tuning_does_not_depend_on_threads() {
    // Neither a multiple of a batch nor of the threads.
    let particles = SwarmParams { particles: 37, ..SwarmParams::improved() };
    assert_same_bits("Swarm", |par| search(par, Swarm::new(3, particles, Seed(2)).unwrap()));
    let params = DifferentialEvolutionParams::default();
    assert_same_bits("DifferentialEvolution", |par| {
        search(par, DifferentialEvolution::new(3, params, Seed(2)).unwrap())
    });
    assert_same_bits("CmaEs", |par| search(par, CmaEs::new(3, CmaEsParams::default(), Seed(2)).unwrap()));
}
