//! Differential evolution: candidates are moved by the difference of two others, and replaced by what is better.
//!
//! Storn and Price, *Differential evolution, a simple and efficient heuristic for global optimization over continuous
//! spaces* (1997), strategy rand/1/bin with a factor drawn anew for every generation (dither, Price, Storn and Lampinen
//! 2005, section 2.5.2).

use crate::optimize::{Optimizer, comparable, inside, spread_of, three_others};
use agv_core::{
    Error, check,
    compute::{Seed, Stream},
};
use rand::RngExt;

/// What differential evolution is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DifferentialEvolutionParams {
    /// Candidates in a generation, at least four.
    pub population: usize,
    /// Least factor on differences.
    pub factor_min: f64,
    /// Greatest factor on differences.
    pub factor_max: f64,
    /// Probability with which a coordinate is taken from the moved candidate.
    pub crossover: f64,
}

impl Default for DifferentialEvolutionParams {
    /// The dither and crossover that Price, Storn and Lampinen advise for coordinates that depend on one another, and the
    /// population of the swarms.
    fn default() -> Self {
        Self { population: 20, factor_min: 0.5, factor_max: 1.0, crossover: 0.9 }
    }
}

/// Differential evolution; the [`Optimizer`] role.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "RawDifferentialEvolution")
)]
pub struct DifferentialEvolution {
    params: DifferentialEvolutionParams,
    dimension: usize,
    seed: Seed,
    generation: u64,
    /// What is asked for, and what has survived.
    trials: Vec<f64>,
    survivors: Vec<f64>,
    #[cfg_attr(feature = "serde", serde(with = "crate::optimize::stored_costs"))]
    costs: Vec<f64>,
    leader: usize,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawDifferentialEvolution {
    params: DifferentialEvolutionParams,
    dimension: usize,
    seed: Seed,
    generation: u64,
    trials: Vec<f64>,
    survivors: Vec<f64>,
    #[serde(with = "crate::optimize::stored_costs")]
    costs: Vec<f64>,
    leader: usize,
}

#[cfg(feature = "serde")]
impl TryFrom<RawDifferentialEvolution> for DifferentialEvolution {
    type Error = Error;

    fn try_from(raw: RawDifferentialEvolution) -> Result<Self, Error> {
        // Lengths before anything is made of them: a checkpoint must not ask for more memory than it fills.
        let RawDifferentialEvolution { params, dimension, seed, generation, trials, survivors, costs, leader } = raw;
        check::length("costs", costs.len(), params.population)?;
        check::length("trials", trials.len(), params.population.saturating_mul(dimension))?;
        check::length("survivors", survivors.len(), trials.len())?;
        check::in_range("leader", leader as f64, 0.0, params.population as f64 - 1.0)?;
        for &x in trials.iter().chain(&survivors) {
            check::in_range("coordinate", x, 0.0, 1.0)?;
        }
        let fresh = Self::new(dimension, params, seed)?;
        Ok(Self { generation, trials, survivors, costs, leader, ..fresh })
    }
}

impl DifferentialEvolution {
    /// Random candidates in the unit cube of `dimension` coordinates.
    ///
    /// # Errors
    /// No dimension, fewer than four candidates, or the first parameter that is out of range.
    pub fn new(dimension: usize, params: DifferentialEvolutionParams, seed: Seed) -> Result<Self, Error> {
        check::at_least("dimension", dimension, 1)?;
        check::at_least("population", params.population, 4)?;
        check::in_range("factor_max", params.factor_max, f64::MIN_POSITIVE, 2.0)?;
        check::in_range("factor_min", params.factor_min, 0.0, params.factor_max)?;
        check::in_range("crossover", params.crossover, 0.0, 1.0)?;
        let mut stream = seed.stream(0, 0);
        let trials: Vec<f64> = (0..params.population * dimension).map(|_| stream.random()).collect();
        let costs = vec![f64::INFINITY; params.population];
        Ok(Self { params, dimension, seed, generation: 0, survivors: trials.clone(), trials, costs, leader: 0 })
    }

    fn mutate(&mut self, stream: &mut Stream) {
        let (dimension, count, params) = (self.dimension, self.params.population, self.params);
        let factor = stream.random_range(params.factor_min..=params.factor_max);
        for (i, trial) in self.trials.chunks_exact_mut(dimension).enumerate() {
            let [a, b, c] = three_others(i, count, stream);
            let always = stream.random_range(0..dimension);
            for (d, x) in trial.iter_mut().enumerate() {
                let at = |candidate: usize| self.survivors[candidate * dimension + d];
                *x = at(i);
                if d == always || stream.random::<f64>() < params.crossover {
                    *x = inside(at(a) + factor * (at(b) - at(c)), at(a));
                }
            }
        }
    }
}

impl Optimizer for DifferentialEvolution {
    fn dimension(&self) -> usize {
        self.dimension
    }

    fn ask(&self) -> &[f64] {
        &self.trials
    }

    fn tell(&mut self, costs: &[f64]) -> Result<(), Error> {
        check::length("costs", costs.len(), self.costs.len())?;
        let dimension = self.dimension;
        for (i, &cost) in costs.iter().enumerate() {
            let cost = comparable(cost);
            // Of equals the younger one stays, so that plateaus are crossed.
            if cost <= self.costs[i] {
                self.costs[i] = cost;
                let (survivor, trial) = (&mut self.survivors[i * dimension..], &self.trials[i * dimension..]);
                survivor[..dimension].copy_from_slice(&trial[..dimension]);
            }
            if self.costs[i] < self.costs[self.leader] {
                self.leader = i;
            }
        }
        self.generation += 1;
        let mut stream = self.seed.stream(self.generation, 0);
        self.mutate(&mut stream);
        Ok(())
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        let best = &self.survivors[self.leader * self.dimension..][..self.dimension];
        (self.generation > 0).then_some((best, self.costs[self.leader]))
    }

    fn spread(&self) -> f64 {
        spread_of(&self.survivors, self.dimension)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Whatever the costs: trials stay in the cube, and the best cost is the least that was told.
        #[test]
        fn laws(seed in 0_u64..1000, costs in prop::collection::vec(prop::num::f64::ANY, 6 * 12)) {
            let params = DifferentialEvolutionParams { population: 6, ..Default::default() };
            let mut evolution = DifferentialEvolution::new(3, params, Seed(seed)).unwrap();
            let mut least = f64::INFINITY;
            for costs in costs.chunks_exact(6) {
                evolution.tell(costs).unwrap();
                least = costs.iter().filter(|c| !c.is_nan()).fold(least, |a, &b| a.min(b));
                prop_assert_eq!(evolution.best().unwrap().1, least);
                prop_assert!(evolution.ask().iter().all(|x| (0.0..=1.0).contains(x)));
            }
        }
    }

    #[test]
    fn bad_parameters_are_named_and_bad_costs_change_nothing() {
        let good = DifferentialEvolutionParams::default();
        for (name, params) in [
            ("population", DifferentialEvolutionParams { population: 3, ..good }),
            ("factor_max", DifferentialEvolutionParams { factor_max: f64::NAN, ..good }),
            ("factor_min", DifferentialEvolutionParams { factor_min: 1.5, ..good }),
            ("crossover", DifferentialEvolutionParams { crossover: -0.1, ..good }),
        ] {
            let error = DifferentialEvolution::new(2, params, Seed(0)).unwrap_err();
            assert!(error.to_string().starts_with(name), "{name}: {error}");
        }
        assert!(DifferentialEvolution::new(0, good, Seed(0)).is_err());
        let mut evolution = DifferentialEvolution::new(2, good, Seed(0)).unwrap();
        let before = evolution.clone();
        assert!(evolution.tell(&[1.0; 19]).is_err());
        assert_eq!(evolution, before);
    }
}
