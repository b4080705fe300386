//! What ants leave, against the sheet of paper 002 by hand.

use super::*;
use crate::aco::TrailLimits;

/// Pheromone, after one iteration, on the first steps of three ants with ways of 10, 10.4 and 20 cells; ρ = 0.3, Q = 1, one at
/// first.
fn after(deposit: Deposit) -> [f64; 3] {
    let limits = TrailLimits::Fixed { floor: Trail::LEAST, ceiling: Trail::GREATEST };
    let params = ColonyParams { ants: 3, deposit, limits, ..ColonyParams::aco() };
    let mut colony = Colony::new(params, Seed(1)).unwrap();
    colony.trail.reset(20, 1.0);
    for (step, (ant, length)) in colony.squads[0].ants.iter_mut().zip([10.0, 10.4, 20.0]).enumerate() {
        (ant.steps, ant.length, ant.taken) = (vec![step as u8], Some(length), 1);
    }
    let ends = colony.take_down(0);
    assert_eq!(ends, Some((0, 2)));
    colony.leave(7, &[1, 2, 3, 4, 5, 6, 7, 8], ends);
    colony.trail.raise(1.0, (0.0, 1e6), &[1.0; 8]);
    let row = colony.trail.powers()[7];
    assert!((row[5] - 0.7).abs() < 1e-6, "the rest evaporates");
    [0, 1, 2].map(|step| f64::from(row[step]))
}

fn assert_near(found: [f64; 3], expected: [f64; 3]) {
    assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?} {expected:?}");
}

/// Eqs. 2 to 4.
#[test]
fn every_ant_leaves_what_its_way_is_worth() {
    assert_near(after(Deposit::EveryAnt), [0.7 + 1.0 / 10.0, 0.7 + 1.0 / 10.4, 0.7 + 1.0 / 20.0]);
}

/// Eqs. 10 to 17: fitness 1 (first level), 0.96 (second) and 0.5 (third), the best and the worst way beside.
#[test]
fn grades_reward_the_best_and_punish_the_worst() {
    let (best, mean, worst) = (0.1, 3.0 / 40.4, 0.05);
    let first = 0.3 * (best + mean - worst) + best;
    let fitness = 10.0 / 10.4;
    let second = 0.3 * fitness * (2.0 / 10.4 - worst);
    assert_near(after(Deposit::Graded { threshold: 0.95 }), [0.7 + first, 0.7 + second, 0.7 - worst]);
    // With a threshold above it the second ant leaves nothing.
    assert_near(after(Deposit::Graded { threshold: 0.97 }), [0.7 + first, 0.7, 0.7 - worst]);
}
