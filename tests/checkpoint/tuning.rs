//! Searches: one that was stored goes on with the same bits.

use crate::table::{assert_kept, assert_refused, restored};
use agv_nav::{
    control::{
        evolution::{CmaEs, CmaEsParams, DifferentialEvolution, DifferentialEvolutionParams},
        optimize::{Interval, Optimizer, Search, SearchSpace},
        pso::{Sensing, Swarm, SwarmParams},
        tune::{OnlineTuner, OnlineTunerParams},
    },
    core::compute::Seed,
};
use serde::{Serialize, de::DeserializeOwned};
use serde_json::json;

/// Half of the space has no cost, so that infinity is among what is stored.
fn cost(p: &[f64]) -> f64 {
    if p[0] > 3.0 { f64::NAN } else { (p[0] - 1.0).powi(2) + (p[1] - 0.5).powi(2) }
}

fn space() -> SearchSpace {
    SearchSpace::new(vec![Interval::gain(6.0), Interval::log(0.1, 10.0)]).unwrap()
}

fn goes_on<O: Optimizer + Serialize + DeserializeOwned>(name: &str, optimizer: O) {
    let mut search = Search::new(space(), optimizer).unwrap();
    for _ in 0..40 {
        assert_kept(name, &search);
        let mut again = restored(&search);
        // A generation that was begun is evaluated again.
        search.advance(&cost, 3).unwrap();
        while !search.advance(&cost, usize::MAX).unwrap() {}
        again.advance(&cost, usize::MAX).unwrap();
        let [a, b] = [&search, &again].map(|s| s.optimizer().ask().iter().map(|x| x.to_bits()).collect::<Vec<_>>());
        assert_eq!(a, b, "{name}");
        assert_eq!(search.best(), again.best(), "{name}");
        assert_eq!((search.evaluations(), search.iterations()), (again.evaluations(), again.iterations()), "{name}");
    }
}

fn swarm(sensing: Option<Sensing>) -> Swarm {
    Swarm::new(2, SwarmParams { sensing, ..SwarmParams::improved() }, Seed(3)).unwrap()
}

#[test]
fn searches_go_on_with_the_same_bits() {
    goes_on("Swarm", swarm(None));
    goes_on("Swarm with sensing", swarm(Some(Sensing::frugal())));
    goes_on("CmaEs", CmaEs::new(2, CmaEsParams { restart_stall: 5, ..Default::default() }, Seed(3)).unwrap());
    let params = DifferentialEvolutionParams::default();
    goes_on("DifferentialEvolution", DifferentialEvolution::new(2, params, Seed(3)).unwrap());
}

#[test]
fn a_tuner_goes_on_with_the_same_bits() {
    let mut tuner = OnlineTuner::new(space(), &[1.0, 1.0], OnlineTunerParams::default(), Seed(4)).unwrap();
    for _ in 0..10 {
        for _ in 0..3 {
            tuner.cycle(&cost).unwrap();
        }
        assert_kept("OnlineTuner", &tuner);
        assert_eq!(restored(&tuner).values(), tuner.values());
    }
}

#[test]
fn spoilt_searches_are_refused() {
    let mut search = Search::new(space(), swarm(Some(Sensing::frugal()))).unwrap();
    for _ in 0..3 {
        search.advance(&cost, usize::MAX).unwrap();
    }
    assert_refused(
        "Swarm",
        &search,
        &[
            ("/space", json!([])),
            ("/space/0/upper", json!(-1.0)),
            ("/optimizer/dimension", json!(3)),
            ("/optimizer/params/particles", json!(1_000_000_000)),
            ("/optimizer/places/0", json!(1.5)),
            ("/optimizer/places/0", json!(null)),
            ("/optimizer/velocities/0", json!(2.0)),
            ("/optimizer/best_costs", json!([])),
            ("/optimizer/links/0", json!(20)),
            ("/optimizer/leader", json!(20)),
            ("/optimizer/sensed", json!([])),
            ("/optimizer/age", json!(0)),
        ],
    );
    let mut cma = CmaEs::new(2, CmaEsParams::default(), Seed(1)).unwrap();
    cma.tell(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]).unwrap();
    assert_refused(
        "CmaEs",
        &cma,
        &[
            ("/dimension", json!(0)),
            ("/dimension", json!(3)),
            ("/population", json!(9)),
            ("/sigma", json!(0.0)),
            ("/samples/0", json!(-0.1)),
            ("/factor/rows/0", json!(0.0)),
            ("/factor/rows/1", json!(0.5)),
            ("/factor/rows", json!([1.0])),
        ],
    );
    let evolution = DifferentialEvolution::new(2, DifferentialEvolutionParams::default(), Seed(1)).unwrap();
    assert_refused(
        "DifferentialEvolution",
        &evolution,
        &[
            ("/dimension", json!(3)),
            ("/params/population", json!(4_000_000_000_u64)),
            ("/survivors/0", json!(2.0)),
            ("/costs", json!([])),
            ("/leader", json!(20)),
        ],
    );
    let tuner = OnlineTuner::new(space(), &[1.0, 1.0], OnlineTunerParams::default(), Seed(4)).unwrap();
    assert_refused(
        "OnlineTuner",
        &tuner,
        &[("/values", json!([1.0])), ("/values/0", json!(null)), ("/params/evaluations_per_cycle", json!(0))],
    );
}
