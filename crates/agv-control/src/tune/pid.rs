//! Gains of a PID controller.

use crate::optimize::{Interval, Outcome, Search, SearchSpace, Stopping, Termination};
use crate::pso::{Swarm, SwarmParams};
use crate::step_response::{PidGains, StepTest};
use crate::{BATCH, Error, Objective};
use agv_core::compute::Seed;

/// A step test is an objective of the three gains Kp, Ki, Kd; its cost is the ITAE. Missing gains are zero.
impl Objective for StepTest {
    fn evaluate(&self, point: &[f64]) -> f64 {
        self.cost(gains_of(point))
    }

    fn evaluate_batch(&self, points: &[f64], costs: &mut [f64]) {
        for_each_batch(points, costs, |gains, costs| {
            // The slices are of one length.
            if self.cost_batch(gains, costs).is_err() {
                costs.fill(f64::INFINITY);
            }
        });
    }
}

/// Passes on points of any dimension as gains, a [`BATCH`] at a time, with the costs to be filled in.
pub(super) fn for_each_batch(points: &[f64], costs: &mut [f64], mut evaluate: impl FnMut(&[PidGains], &mut [f64])) {
    let dimension = (points.len() / costs.len().max(1)).max(1);
    let mut gains = [PidGains::default(); BATCH];
    for (points, costs) in points.chunks(dimension * BATCH).zip(costs.chunks_mut(BATCH)) {
        for (gains, point) in gains.iter_mut().zip(points.chunks_exact(dimension)) {
            *gains = gains_of(point);
        }
        evaluate(&gains[..costs.len()], costs);
    }
}

pub(super) fn gains_of(point: &[f64]) -> PidGains {
    let gain = |at: usize| point.get(at).copied().unwrap_or(0.0);
    PidGains { proportional: gain(0), integral: gain(1), derivative: gain(2) }
}

/// Gains found by a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TunedPid {
    /// The best gains.
    pub gains: PidGains,
    /// Their cost.
    pub cost: f64,
    /// Evaluations of the cost.
    pub evaluations: usize,
    /// Why the search ended.
    pub termination: Termination,
}

impl From<Outcome> for TunedPid {
    fn from(outcome: Outcome) -> Self {
        let Outcome { point, cost, evaluations, termination, .. } = outcome;
        Self { gains: gains_of(&point), cost, evaluations, termination }
    }
}

/// The space of gains from zero to the greatest ones, each on the scale of [`Interval::gain`]: good gains of one plant may
/// differ by decades, and an even scale loses the small ones (on the plant P1 it leaves most searches in a trap).
///
/// # Errors
/// A greatest gain that is not positive.
pub fn gain_space(greatest: PidGains) -> Result<SearchSpace, Error> {
    Ok(SearchSpace::new(<[f64; 3]>::from(greatest).map(Interval::gain).to_vec())?)
}

/// Searches the gains of least cost by the improved swarm, in 2000 evaluations: the short form of a [`Search`] in
/// [`gain_space`].
///
/// # Errors
/// A greatest gain that is not positive.
pub fn tune_pid<F: Objective + ?Sized>(cost: &F, greatest: PidGains, seed: Seed) -> Result<TunedPid, Error> {
    let swarm = Swarm::new(3, SwarmParams::improved(), seed)?;
    Ok(Search::new(gain_space(greatest)?, swarm)?.run(cost, &Stopping::default())?.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::StandIn;

    /// The bar is 98 of 100 seeds, which the example shows. At the measured rate of 0.996, 20 seeds miss two or more once in
    /// 300 draws of seeds.
    #[test]
    fn the_trap_of_p1_is_avoided() {
        let test = StandIn::P1.step_test().unwrap();
        let found = (0..20).filter(|&seed| {
            let tuned = tune_pid(&test, [50.0; 3].into(), Seed(seed)).unwrap();
            assert!(tuned.evaluations <= 2000);
            assert_eq!(tuned.cost, test.cost(tuned.gains));
            tuned.cost <= 0.0451
        });
        assert!(found.count() >= 19);
    }

    #[test]
    fn batches_have_the_bits_of_single_runs() {
        for plant in StandIn::ALL {
            let test = plant.step_test().unwrap();
            // Fewer gains are P and PI controllers.
            for dimension in 1..=3 {
                let points: Vec<f64> = (0..dimension * 11).map(|k| (k * 7 % 13) as f64 * 0.3).collect();
                let mut costs = [0.0; 11];
                test.evaluate_batch(&points, &mut costs);
                for (point, cost) in points.chunks_exact(dimension).zip(costs) {
                    assert_eq!(test.evaluate(point), cost);
                }
            }
        }
    }

    #[test]
    fn bad_gains_are_refused_or_cost_everything() {
        let test = StandIn::P1.step_test().unwrap();
        for greatest in [[0.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, f64::NAN], [f64::INFINITY, 1.0, 1.0]] {
            assert!(tune_pid(&test, greatest.into(), Seed(0)).is_err());
        }
        assert_eq!(test.evaluate(&[f64::NAN, 1.0, 1.0]), f64::INFINITY);
    }
}
