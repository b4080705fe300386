use super::*;
use proptest::prelude::*;

/// An ellipsoid of condition 10⁶ along a diagonal, with its minimum at 0.4.
fn needle(p: &[f64]) -> f64 {
    let (along, across) = (p[0] + p[1] - 0.8, p[0] - p[1]);
    along * along + 1e6 * across * across
}

fn evaluate(cma: &mut CmaEs, cost: impl Fn(&[f64]) -> f64) {
    let costs: Vec<f64> = cma.ask().chunks_exact(cma.dimension()).map(cost).collect();
    cma.tell(&costs).unwrap();
}

/// With its rate of a linear convergence the strategy needs about a hundred generations of eight; one that did not learn
/// the shape would need some hundred times as many.
#[test]
fn learns_the_shape_of_a_needle() {
    for seed in 0..5 {
        let mut cma = CmaEs::new(2, CmaEsParams { restart_deviation: 0.0, ..Default::default() }, Seed(seed)).unwrap();
        for _ in 0..150 {
            evaluate(&mut cma, needle);
        }
        assert!(cma.best().unwrap().1 < 1e-9, "seed {seed}: {}", cma.best().unwrap().1);
    }
}

#[test]
fn finds_a_minimum_in_a_corner() {
    let mut cma = CmaEs::new(3, CmaEsParams::default(), Seed(3)).unwrap();
    for _ in 0..100 {
        evaluate(&mut cma, |p| p[0] - p[1] + (p[2] - 0.5) * (p[2] - 0.5));
    }
    let (place, cost) = cma.best().unwrap();
    assert!(cost + 1.0 < 1e-6, "{place:?} costs {cost}");
}

/// With many samples in few dimensions all of the matrix would be learnt anew in each generation: what is left of the old one must
/// not vanish, or the strategy starts again and again.
#[test]
fn many_samples_do_not_wipe_out_the_matrix() {
    for (dimension, population) in [(1, 64), (2, 128), (3, 256)] {
        let params =
            CmaEsParams { population, max_population: population, restart_deviation: 0.0, ..Default::default() };
        let mut cma = CmaEs::new(dimension, params, Seed(1)).unwrap();
        for generation in 1..=20 {
            evaluate(&mut cma, |p| p.iter().map(|x| (x - 0.3) * (x - 0.3)).sum());
            assert_eq!(cma.age, generation, "{dimension} x {population}");
        }
        assert!(cma.best().unwrap().1 < 1e-9);
    }
}

#[test]
fn a_plateau_makes_it_start_again_with_more_samples() {
    let mut cma = CmaEs::new(2, CmaEsParams::default(), Seed(3)).unwrap();
    for population in [8, 16, 32, 64, 64] {
        assert_eq!(cma.population, population);
        for _ in 0..31 {
            evaluate(&mut cma, |_| 1.0);
        }
    }
    assert!(cma.mean.iter().all(|x| (0.0..=1.0).contains(x)));
}

proptest! {
    /// Whatever the costs: samples stay in the cube, and the best cost is the least that was told.
    #[test]
    fn laws(seed in 0_u64..1000, costs in prop::collection::vec(prop::num::f64::ANY, 8 * 25)) {
        let params = CmaEsParams { max_population: 8, ..Default::default() };
        let mut cma = CmaEs::new(3, params, Seed(seed)).unwrap();
        let mut least = f64::INFINITY;
        for costs in costs.chunks_exact(8) {
            cma.tell(costs).unwrap();
            least = costs.iter().filter(|c| !c.is_nan()).fold(least, |a, &b| a.min(b));
            prop_assert_eq!(cma.best().unwrap().1, least);
            prop_assert!(cma.ask().iter().all(|x| (0.0..=1.0).contains(x)));
        }
    }
}

#[test]
fn bad_parameters_are_named_and_bad_costs_change_nothing() {
    let good = CmaEsParams::default();
    for (name, params) in [
        ("population", CmaEsParams { population: 3, ..good }),
        ("initial_deviation", CmaEsParams { initial_deviation: f64::NAN, ..good }),
        ("restart_deviation", CmaEsParams { restart_deviation: 0.5, ..good }),
        ("restart_stall", CmaEsParams { restart_stall: 0, ..good }),
        ("max_population", CmaEsParams { max_population: 7, ..good }),
    ] {
        let error = CmaEs::new(2, params, Seed(0)).unwrap_err();
        assert!(error.to_string().starts_with(name), "{name}: {error}");
    }
    assert!(CmaEs::new(0, good, Seed(0)).is_err());
    let mut cma = CmaEs::new(2, good, Seed(0)).unwrap();
    let before = cma.clone();
    assert!(cma.tell(&[1.0; 7]).is_err());
    assert_eq!(cma, before);
}
