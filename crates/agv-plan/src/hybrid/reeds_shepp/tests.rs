use super::*;
use crate::hybrid::{Dubins, Turn};
use agv_core::geometry::{LieGroup, wrap_angle};
use proptest::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI};

fn car() -> ReedsShepp {
    ReedsShepp::new(1.0).unwrap()
}

/// Lengths computed by OMPL.
fn references() -> impl Iterator<Item = (Se2, f64, f64)> {
    include_str!("../../../tests/fixtures/curves.csv").lines().filter(|line| !line.starts_with('#')).map(|line| {
        let v: Vec<f64> = line.split(',').map(|field| field.parse().unwrap()).collect();
        (Se2::new(v[0], v[1], v[2]), v[3], v[4])
    })
}

fn miss(curve: &Curve, goal: &Se2) -> f64 {
    let miss = curve.start_from_end().inverse() * *goal;
    miss.translation().norm().max(miss.yaw().abs())
}

/// Poses of all kinds, many of them on the lines where words change.
fn pose() -> impl Strategy<Value = Se2> {
    let length =
        prop_oneof![-6.0..6.0_f64, -0.5..0.5_f64, -1e-6..1e-6_f64, (-8..9_i32).prop_map(|n| f64::from(n) / 2.0)];
    let yaw = prop_oneof![-PI..PI, (-4..5_i32).prop_map(|n| f64::from(n) * FRAC_PI_2), -1e-7..1e-7_f64];
    (length.clone(), length, yaw).prop_map(|(x, y, yaw)| Se2::new(x, y, yaw))
}

#[test]
fn lengths_are_those_of_an_independent_implementation() {
    let dubins = Dubins::new(1.0).unwrap();
    for (goal, shortest, forward) in references() {
        let curve = car().shortest(&Se2::default(), &goal).unwrap();
        assert!((curve.length() - shortest).abs() < 1e-6, "{goal:?} {} {shortest}", curve.length());
        assert!(miss(&curve, &goal) < 1e-9 * (1.0 + shortest), "{goal:?} {curve:?}");
        let curve = dubins.shortest(&Se2::default(), &goal).unwrap();
        assert!((curve.length() - forward).abs() < 1e-6, "{goal:?} {} {forward}", curve.length());
        assert!(miss(&curve, &goal) < 1e-9 * (1.0 + forward), "{goal:?} {curve:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, ..Default::default() })]

    #[test]
    fn curves_end_at_the_goal(goal in pose(), start in pose(), radius in prop_oneof![0.01..0.1_f64, 0.5..5.0_f64]) {
        for curve in [
            ReedsShepp::new(radius).unwrap().shortest(&start, &(start * goal)).unwrap(),
            Dubins::new(radius).unwrap().shortest(&start, &(start * goal)).unwrap(),
        ] {
            prop_assert!(miss(&curve, &goal) < 1e-8 * (1.0 + radius), "{curve:?}");
            prop_assert!(curve.length() >= goal.translation().norm() - 1e-9);
            prop_assert!(curve.length() >= radius * goal.yaw().abs() - 1e-8);
        }
    }

    /// All words lead to the goal, the shortest is among them, and no bound dropped it.
    #[test]
    fn all_words_end_at_the_goal(goal in pose()) {
        let mut least = f64::INFINITY;
        let mut misses = 0.0_f64;
        car().for_each_word(&Se2::default(), &goal, |curve| {
            misses = misses.max(miss(&curve, &goal));
            least = least.min(curve.length());
        }).unwrap();
        prop_assert!(misses < 1e-8);
        prop_assert!((car().cost(&Se2::default(), &goal).unwrap() - least).abs() < 1e-9);
        prop_assert!((car().shortest(&Se2::default(), &goal).unwrap().length() - least).abs() < 1e-9);
    }

    /// Driving the other way, a mirror, and swapping the ends change no length.
    #[test]
    fn symmetries_keep_the_length(goal in pose()) {
        let length = |goal: &Se2| car().cost(&Se2::default(), goal).unwrap();
        let (x, y, yaw) = (goal.x(), goal.y(), goal.yaw());
        let known = length(&goal);
        for same in [Se2::new(-x, y, -yaw), Se2::new(x, -y, -yaw), Se2::new(-x, -y, yaw), goal.inverse()] {
            prop_assert!((length(&same) - known).abs() < 1e-7, "{} {known}", length(&same));
        }
        let forward = |goal: &Se2| Dubins::new(1.0).unwrap().length(&Se2::default(), goal).unwrap();
        prop_assert!(forward(&goal) >= known - 1e-7);
    }

    /// No detour is shorter: a curve over any pose between is at least as long, and no random sequence of arcs and lines
    /// that ends at a pose beats the curve to it.
    #[test]
    fn nothing_is_shorter(
        via in pose(), goal in pose(),
        pieces in prop::collection::vec((0..3_i32, prop_oneof![-3.0..3.0_f64, -0.3..0.3_f64]), 1..7),
    ) {
        let start = Se2::default();
        let direct = car().cost(&start, &goal).unwrap();
        let detour = car().cost(&start, &via).unwrap() + car().cost(&via, &goal).unwrap();
        prop_assert!(direct <= detour + 1e-7, "{direct} {detour}");
        let (mut pose, mut driven) = (start, 0.0);
        for (turn, length) in pieces {
            let twist = agv_core::geometry::Twist2::new(length, 0.0, length * f64::from(turn - 1));
            pose = pose * twist.integrate(1.0);
            driven += length.abs();
        }
        prop_assert!(car().cost(&start, &pose).unwrap() <= driven + 1e-7);
    }

    /// Weights never make a curve shorter or dearer than the shortest one would be, and hold for what is returned.
    #[test]
    fn weighted_curves_are_cheapest(goal in pose(), reverse in 1.0..5.0_f64, gear_change in 0.0..9.0_f64) {
        let weights = CurveWeights { reverse, gear_change };
        let weighted = car().with_weights(weights).unwrap();
        let curve = weighted.shortest(&Se2::default(), &goal).unwrap();
        let shortest = car().shortest(&Se2::default(), &goal).unwrap();
        prop_assert!(miss(&curve, &goal) < 1e-8);
        prop_assert!(curve.length() >= shortest.length() - 1e-9);
        prop_assert!(curve.cost(&weights) <= shortest.cost(&weights) + 1e-9);
        prop_assert!((weighted.cost(&Se2::default(), &goal).unwrap() - curve.cost(&weights)).abs() < 1e-9);
        let forward = Dubins::new(1.0).unwrap().shortest(&Se2::default(), &goal).unwrap();
        prop_assert!(curve.cost(&weights) <= forward.length() + 1e-9);
        let mut least = f64::INFINITY;
        weighted.for_each_word(&Se2::default(), &goal, |word| least = least.min(word.cost(&weights))).unwrap();
        prop_assert!((curve.cost(&weights) - least).abs() < 1e-9);
    }
}

#[test]
fn the_length_is_nearly_that_of_the_line_far_away() {
    let far = Se2::new(3e6, -4e6, 0.3);
    let curve = car().shortest(&Se2::default(), &far).unwrap();
    assert!((curve.length() - 5e6).abs() < 10.0 && miss(&curve, &far) < 1e-6);
}

#[test]
fn nowhere_to_go_is_no_curve() {
    for pose in [Se2::default(), Se2::new(17.3, -4.1, 2.2)] {
        for curve in [car().shortest(&pose, &pose).unwrap(), Dubins::new(1.0).unwrap().shortest(&pose, &pose).unwrap()]
        {
            assert!(curve.length() < 1e-9 && curve.gear_changes() == 0);
            assert!(curve.samples(0.1).unwrap().next().is_none());
        }
    }
    // A hair ahead and aside is no reason for a loop.
    let curve = car().shortest(&Se2::default(), &Se2::new(1e-7, 1e-10, 0.0)).unwrap();
    assert!(curve.length() < 1e-3, "{curve:?}");
    let ahead = Dubins::new(1.0).unwrap().shortest(&Se2::default(), &Se2::new(3.0, 1e-13, -1e-13)).unwrap();
    assert!((ahead.length() - 3.0).abs() < 1e-9);
}

#[test]
fn parking_beside_takes_two_cusps_and_a_loop_none() {
    let curve = car().shortest(&Se2::default(), &Se2::new(0.0, 0.3, 0.0)).unwrap();
    assert!(curve.gear_changes() >= 2 && curve.pieces().iter().any(|piece| piece.turn == Turn::Right));
    assert!(wrap_angle(curve.start_from_end().yaw()).abs() < 1e-9);
}

#[test]
fn bad_input_is_refused() {
    for radius in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(ReedsShepp::new(radius).is_err() && Dubins::new(radius).is_err());
    }
    for bad in [
        Se2::new(f64::NAN, 0.0, 0.0),
        Se2::new(0.0, f64::INFINITY, 0.0),
        Se2::new(0.0, 0.0, f64::NAN),
        Se2::new(1e13, 0.0, 0.0),
    ] {
        let good = Se2::default();
        for (a, b) in [(&good, &bad), (&bad, &good)] {
            assert!(car().shortest(a, b).is_err() && car().cost(a, b).is_err());
            assert!(car().for_each_word(a, b, |_| ()).is_err());
            let dubins = Dubins::new(1.0).unwrap();
            assert!(dubins.shortest(a, b).is_err() && dubins.length(a, b).is_err());
        }
    }
    assert!(car().with_weights(CurveWeights { reverse: 0.5, gear_change: 0.0 }).is_err());
}
