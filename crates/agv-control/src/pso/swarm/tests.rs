use super::*;
use crate::pso::{Acceleration, Inertia, Sensing, Threshold};
use proptest::prelude::*;

fn sphere(place: &[f64]) -> f64 {
    place.iter().map(|x| (x - 0.3) * (x - 0.3)).sum()
}

fn kinds() -> [SwarmParams; 6] {
    let improved = SwarmParams::improved();
    [
        SwarmParams::standard(),
        SwarmParams { boundary: Boundary::Reflect, velocity_limit: 1.0, ..SwarmParams::paper(20) },
        SwarmParams { topology: Topology::Ring { neighbours: 2 }, ..improved },
        SwarmParams {
            inertia: Inertia::Constriction,
            acceleration: Acceleration::Fixed { cognitive: 2.05, social: 2.05 },
            ..improved
        },
        SwarmParams { inertia: Inertia::AsPrinted { start: 0.9, end: 0.4, iterations: 30 }, ..SwarmParams::paper(30) },
        SwarmParams { sensing: Some(Sensing::default()), ..improved },
    ]
}

/// Tells the costs of one generation.
fn step(swarm: &mut Swarm, cost: impl Fn(&[f64]) -> f64) {
    let costs: Vec<f64> = swarm.ask().chunks_exact(swarm.dimension()).map(cost).collect();
    swarm.tell(&costs).unwrap();
}

#[test]
fn every_kind_of_swarm_comes_together_at_the_minimum() {
    for params in kinds() {
        let mut swarm = Swarm::new(3, params, Seed(4)).unwrap();
        for _ in 0..150 {
            step(&mut swarm, sphere);
        }
        let (_, cost) = swarm.best().unwrap();
        assert!(cost < 1e-4 && swarm.spread() < 0.1, "{params:?}: {cost}, {}", swarm.spread());
    }
}

proptest! {
    /// Whatever the costs, NaN and infinity included: places stay in the cube, velocities in their limit, and the best
    /// cost is the least that was told.
    #[test]
    fn laws_of_the_swarm(kind in 0_usize..6, seed in 0_u64..1000, costs in prop::collection::vec(prop::num::f64::ANY, 23 * 12)) {
        let params = SwarmParams { sensing: None, ..kinds()[kind] };
        let mut swarm = Swarm::new(2, params, Seed(seed)).unwrap();
        let mut least = f64::INFINITY;
        for generation in costs.chunks_exact(23) {
            let costs = &generation[..params.particles];
            swarm.tell(costs).unwrap();
            least = costs.iter().filter(|c| !c.is_nan()).fold(least, |a, &b| a.min(b));
            let (place, best) = swarm.best().unwrap();
            prop_assert_eq!(best, least);
            prop_assert!(place.iter().chain(swarm.ask()).all(|x| (0.0..=1.0).contains(x)));
            prop_assert!(swarm.velocities.iter().all(|v| v.abs() <= params.velocity_limit));
        }
    }
}

#[test]
fn nan_loses() {
    // A quarter of the cube has a cost; NaN everywhere else must not draw the swarm.
    let mut swarm = Swarm::new(2, SwarmParams::improved(), Seed(1)).unwrap();
    for _ in 0..60 {
        step(&mut swarm, |p| if p[0] < 0.5 || p[1] < 0.5 { f64::NAN } else { p[0] + p[1] });
    }
    assert!(swarm.best().unwrap().1 < 1.01);
    let mut lost = Swarm::new(2, SwarmParams::improved(), Seed(1)).unwrap();
    step(&mut lost, |_| f64::NAN);
    assert_eq!(lost.best().unwrap().1, f64::INFINITY);
}

#[test]
fn the_same_seed_draws_the_same_swarm() {
    let run = |seed| {
        let mut swarm = Swarm::new(4, SwarmParams::improved(), Seed(seed)).unwrap();
        (0..20).for_each(|_| step(&mut swarm, sphere));
        swarm.ask().to_vec()
    };
    assert_eq!(run(7), run(7));
    assert_ne!(run(7), run(8));
}

#[test]
fn a_change_is_noticed_and_the_memories_of_before_are_dropped() {
    let sensing = Sensing { threshold: Threshold::Absolute(0.05), particles: 5, ..Sensing::paper() };
    let params = SwarmParams { sensing: Some(sensing), ..SwarmParams::improved() };
    let mut swarm = Swarm::new(2, params, Seed(2)).unwrap();
    for _ in 0..40 {
        step(&mut swarm, sphere);
    }
    assert_eq!((swarm.changes(), swarm.spread() < 0.05), (0, true));
    // A small change below the threshold, then a shift of the minimum.
    step(&mut swarm, |p| sphere(p) + 0.04);
    assert_eq!(swarm.changes(), 0);
    let shifted = |p: &[f64]| 1.0 + p.iter().map(|x| (x - 0.9) * (x - 0.9)).sum::<f64>();
    step(&mut swarm, shifted);
    assert_eq!(swarm.changes(), 1);
    assert!(swarm.best().unwrap().1 >= 1.0 && swarm.spread() > 0.15);
    for _ in 0..40 {
        step(&mut swarm, shifted);
    }
    let (place, cost) = swarm.best().unwrap();
    assert!(cost < 1.0 + 1e-4, "{place:?} costs {cost}");
    assert_eq!(swarm.changes(), 1);
}

/// The watched best place is the first point asked for; what it is worth after a change is known, and kept if it is best.
#[test]
fn the_best_place_is_watched() {
    let sensing = Sensing { particles: 0, ..Sensing::frugal() };
    let mut swarm = Swarm::new(2, SwarmParams { sensing: Some(sensing), ..SwarmParams::improved() }, Seed(2)).unwrap();
    for _ in 0..20 {
        step(&mut swarm, sphere);
        assert_eq!(swarm.best().unwrap().0, &swarm.ask()[..2]);
    }
    let old = swarm.best().unwrap().0.to_vec();
    let mut costs = vec![9.0; 21];
    costs[0] = 3.0;
    swarm.tell(&costs).unwrap();
    assert_eq!((swarm.changes(), swarm.best().unwrap()), (1, (old.as_slice(), 3.0)));
}

#[test]
fn as_many_particles_are_scattered_as_was_asked_for() {
    for (reseed, scattered) in [(0.0, 0), (0.25, 5), (1.0, 20)] {
        let sensing = Sensing { particles: 1, reseed, ..Sensing::paper() };
        let params = SwarmParams { sensing: Some(sensing), differential: 0.0, ..SwarmParams::improved() };
        let mut swarm = Swarm::new(1, params, Seed(2)).unwrap();
        for _ in 0..200 {
            step(&mut swarm, sphere);
        }
        step(&mut swarm, |p| 5.0 + sphere(p));
        let far = swarm.particles().iter().filter(|x| (*x - 0.3).abs() > 0.01).count();
        assert!(far <= scattered && far + 2 >= scattered, "{far} of {scattered}");
    }
}

#[test]
fn costs_of_the_wrong_number_change_nothing() {
    let mut swarm = Swarm::new(2, SwarmParams::improved(), Seed(1)).unwrap();
    let before = swarm.clone();
    for count in [0, 19, 21] {
        assert!(swarm.tell(&vec![1.0; count]).is_err());
    }
    assert_eq!(swarm, before);
    assert_eq!(swarm.best(), None);
}

#[test]
fn bad_parameters_are_named() {
    let good = SwarmParams::improved();
    let linear = |start, end, iterations| Inertia::Linear { start, end, iterations };
    let sensing = |sensing| SwarmParams { sensing: Some(sensing), ..good };
    for (name, params) in [
        ("particles", SwarmParams { particles: 1, ..good }),
        ("inertia", SwarmParams { inertia: Inertia::Constant(1.1), ..good }),
        ("inertia", SwarmParams { inertia: Inertia::Constant(f64::NAN), ..good }),
        ("inertia end", SwarmParams { inertia: linear(0.4, 0.9, 10), ..good }),
        ("inertia start", SwarmParams { inertia: linear(f64::INFINITY, 0.9, 10), ..good }),
        ("inertia iterations", SwarmParams { inertia: linear(0.9, 0.4, 0), ..good }),
        (
            "inertia start - end",
            SwarmParams { inertia: Inertia::AsPrinted { start: 0.4, end: 0.4, iterations: 9 }, ..good },
        ),
        ("cognitive + social - 4", SwarmParams { inertia: Inertia::Constriction, ..good }),
        ("social", SwarmParams { acceleration: Acceleration::Fixed { cognitive: 1.0, social: f64::NAN }, ..good }),
        ("neighbours", SwarmParams { topology: Topology::Ring { neighbours: 0 }, ..good }),
        ("informants", SwarmParams { topology: Topology::Random { informants: 21 }, ..good }),
        ("velocity_limit", SwarmParams { velocity_limit: 0.0, ..good }),
        ("velocity_limit", SwarmParams { velocity_limit: f64::NAN, ..good }),
        ("differential", SwarmParams { differential: 1.5, ..good }),
        ("sensitive particles", sensing(Sensing { particles: 0, ..Sensing::paper() })),
        ("reseed", sensing(Sensing { reseed: f64::NAN, ..Sensing::default() })),
        ("threshold", sensing(Sensing { threshold: Threshold::Relative(-1.0), ..Sensing::default() })),
    ] {
        let error = Swarm::new(2, params, Seed(0)).unwrap_err();
        assert!(error.to_string().starts_with(name), "{name}: {error}");
    }
    assert!(Swarm::new(0, good, Seed(0)).is_err());
}
