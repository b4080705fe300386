//! Optimisers and the tuner that works while the vehicle drives.

use crate::counter;
use agv_nav::{
    control::{
        evolution::{CmaEs, CmaEsParams, DifferentialEvolution, DifferentialEvolutionParams},
        optimize::{Optimizer, Search},
        plant::StandIn,
        pso::{Sensing, Swarm, SwarmParams},
        tune::{OnlineTuner, OnlineTunerParams, gain_space},
    },
    core::compute::Seed,
};

fn generations(optimizer: impl Optimizer) -> usize {
    let test = StandIn::P1.step_test().unwrap();
    let mut search = Search::new(gain_space([50.0; 3].into()).unwrap(), optimizer).unwrap();
    search.advance(&test, usize::MAX).unwrap();
    counter::count(|| {
        for _ in 0..30 {
            search.advance(&test, usize::MAX).unwrap();
        }
    })
}

#[test]
fn generations_allocate_nothing() {
    let sensing = SwarmParams { sensing: Some(Sensing::frugal()), ..SwarmParams::improved() };
    for params in [SwarmParams::improved(), SwarmParams::paper(30), sensing] {
        assert_eq!(generations(Swarm::new(3, params, Seed(1)).unwrap()), 0);
    }
    let params = DifferentialEvolutionParams::default();
    assert_eq!(generations(DifferentialEvolution::new(3, params, Seed(1)).unwrap()), 0);
    // Restarts with more samples need more room.
    let params = CmaEsParams { max_population: 8, ..CmaEsParams::default() };
    assert_eq!(generations(CmaEs::new(3, params, Seed(1)).unwrap()), 0);
}

#[test]
fn cycles_of_a_tuner_allocate_nothing_even_when_the_plant_changes() {
    let tests = [StandIn::P1, StandIn::P2].map(|plant| plant.step_test().unwrap());
    let space = gain_space([5.0; 3].into()).unwrap();
    let mut tuner = OnlineTuner::new(space, &[1.0; 3], OnlineTunerParams::default(), Seed(1)).unwrap();
    for _ in 0..3 {
        tuner.cycle(&tests[0]).unwrap();
    }
    let count = counter::count(|| {
        for test in &tests {
            for _ in 0..30 {
                tuner.cycle(test).unwrap();
            }
        }
    });
    assert_eq!((count, tuner.changes()), (0, 1));
}
