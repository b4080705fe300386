//! CMA-ES: a normal distribution that learns the shape of the valley that it is in.
//!
//! Hansen, *The CMA evolution strategy: a tutorial* (arXiv 1604.00772, 2016), whose equations and default weights are
//! used; the covariance is kept as its Cholesky factor, updated in O(μ n²), as Krause, Arbonès and Igel show (*CMA-ES with
//! optimal covariance update and storage complexity*, 2016). A sample outside of the cube is drawn back to its surface,
//! and learned from where it was drawn back to. A distribution that has contracted is started elsewhere with twice the
//! samples (Auger and Hansen, IPOP, 2005).

use super::cholesky::CholeskyFactor;
use crate::optimize::{Optimizer, comparable};
use agv_core::{
    Error, check,
    compute::{Seed, Stream},
};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

/// What CMA-ES is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CmaEsParams {
    /// Samples in a generation; zero for the `4 + 3 ln n` of the tutorial, filled up to whole batches of eight.
    pub population: usize,
    /// First standard deviation, as a part of the edge of the space.
    pub initial_deviation: f64,
    /// Standard deviation below which the search starts again elsewhere.
    pub restart_deviation: f64,
    /// Generations without a lower cost in this start after which the search starts again elsewhere.
    pub restart_stall: usize,
    /// Most samples in a generation, which restarts double.
    pub max_population: usize,
}

impl Default for CmaEsParams {
    /// A third of the space at first, as the tutorial advises.
    fn default() -> Self {
        Self { population: 0, initial_deviation: 0.3, restart_deviation: 1e-5, restart_stall: 30, max_population: 64 }
    }
}

/// Rates that follow from the dimension and the number of samples (tutorial, Table 1).
#[derive(Debug, Clone, PartialEq)]
struct Rates {
    /// Weights of the better half; they sum to one.
    weights: Vec<f64>,
    mu_eff: f64,
    c_sigma: f64,
    d_sigma: f64,
    c_c: f64,
    c_1: f64,
    c_mu: f64,
}

impl Rates {
    fn new(dimension: usize, population: usize) -> Self {
        let (n, half) = (dimension as f64, f64::midpoint(population as f64, 1.0));
        let mut weights: Vec<f64> = (1..=population / 2).map(|i| half.ln() - (i as f64).ln()).collect();
        let sum: f64 = weights.iter().sum();
        for weight in &mut weights {
            *weight /= sum;
        }
        let mu_eff = 1.0 / weights.iter().map(|w| w * w).sum::<f64>();
        let c_sigma = (mu_eff + 2.0) / (n + mu_eff + 5.0);
        let d_sigma = 1.0 + 2.0 * (((mu_eff - 1.0) / (n + 1.0)).sqrt() - 1.0).max(0.0) + c_sigma;
        let c_c = (4.0 + mu_eff / n) / (n + 4.0 + 2.0 * mu_eff / n);
        let c_1 = 2.0 / ((n + 1.3) * (n + 1.3) + mu_eff);
        // Something of the old matrix stays, however great the population.
        let c_mu = (0.9 * (1.0 - c_1)).min(2.0 * (mu_eff - 2.0 + 1.0 / mu_eff) / ((n + 2.0) * (n + 2.0) + mu_eff));
        Self { weights, mu_eff, c_sigma, d_sigma, c_c, c_1, c_mu: c_mu.max(0.0) }
    }
}

/// The covariance matrix adaptation evolution strategy with restarts; the [`Optimizer`] role.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "checkpoint::RawCmaEs"))]
pub struct CmaEs {
    params: CmaEsParams,
    dimension: usize,
    seed: Seed,
    generation: u64,
    population: usize,
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    rates: Rates,
    mean: Vec<f64>,
    sigma: f64,
    factor: CholeskyFactor,
    path_sigma: Vec<f64>,
    path_c: Vec<f64>,
    /// Generations of this start, and those since it last found better.
    age: usize,
    stalled: usize,
    #[cfg_attr(feature = "serde", serde(with = "crate::optimize::stored_costs::single"))]
    best_of_start: f64,
    samples: Vec<f64>,
    /// The samples in the distribution's own axes.
    normals: Vec<f64>,
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    order: Vec<usize>,
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    scratch: Vec<f64>,
    #[cfg_attr(feature = "serde", serde(skip_serializing))]
    step: Vec<f64>,
    best: Vec<f64>,
    #[cfg_attr(feature = "serde", serde(with = "crate::optimize::stored_costs::single"))]
    best_cost: f64,
}

impl CmaEs {
    /// A distribution around a random point of the unit cube of `dimension` coordinates.
    ///
    /// # Errors
    /// No dimension, or the first parameter that is out of range.
    pub fn new(dimension: usize, params: CmaEsParams, seed: Seed) -> Result<Self, Error> {
        check::at_least("dimension", dimension, 1)?;
        check::in_range("initial_deviation", params.initial_deviation, f64::MIN_POSITIVE, 1.0)?;
        check::in_range("restart_deviation", params.restart_deviation, 0.0, params.initial_deviation)?;
        check::at_least("restart_stall", params.restart_stall, 1)?;
        let population = match params.population {
            0 => ((4.0 + 3.0 * (dimension as f64).ln()) as usize).next_multiple_of(8),
            given => check::at_least("population", given, 4)?,
        };
        check::at_least("max_population", params.max_population, population)?;
        let mut cma = Self {
            params,
            dimension,
            seed,
            generation: 0,
            population,
            rates: Rates::new(dimension, population),
            mean: vec![0.0; dimension],
            sigma: params.initial_deviation,
            factor: CholeskyFactor::identity(dimension),
            path_sigma: vec![0.0; dimension],
            path_c: vec![0.0; dimension],
            age: 0,
            stalled: 0,
            best_of_start: f64::INFINITY,
            samples: Vec::new(),
            normals: Vec::new(),
            order: Vec::new(),
            scratch: vec![0.0; dimension],
            step: vec![0.0; dimension],
            best: vec![0.0; dimension],
            best_cost: f64::INFINITY,
        };
        let mut stream = seed.stream(0, 0);
        cma.mean.fill_with(|| stream.random());
        cma.sample(&mut stream);
        Ok(cma)
    }

    fn sample(&mut self, stream: &mut Stream) {
        let n = self.dimension;
        self.samples.resize(self.population * n, 0.0);
        self.normals.resize(self.population * n, 0.0);
        for (sample, normal) in self.samples.chunks_exact_mut(n).zip(self.normals.chunks_exact_mut(n)) {
            normal.fill_with(|| StandardNormal.sample(stream));
            self.factor.apply(normal, sample);
            let mut outside = false;
            for (x, &mean) in sample.iter_mut().zip(&self.mean) {
                let free = mean + self.sigma * *x;
                *x = free.clamp(0.0, 1.0);
                outside |= *x != free;
            }
            if outside {
                for ((z, &x), &mean) in normal.iter_mut().zip(sample.iter()).zip(&self.mean) {
                    *z = (x - mean) / self.sigma;
                }
                self.factor.solve(normal);
            }
        }
    }

    /// Tutorial, Eqs. 38 to 49.
    fn learn(&mut self) {
        let (n, rates) = (self.dimension, &self.rates);
        let dimension = n as f64;
        self.scratch.fill(0.0);
        for (&w, &i) in rates.weights.iter().zip(&self.order) {
            self.scratch.iter_mut().zip(&self.normals[i * n..]).for_each(|(sum, z)| *sum += w * z);
        }
        // The mean step in the distribution's axes, then in those of the space.
        let gain = (rates.c_sigma * (2.0 - rates.c_sigma) * rates.mu_eff).sqrt();
        for (path, z) in self.path_sigma.iter_mut().zip(&self.scratch) {
            *path = (1.0 - rates.c_sigma) * *path + gain * z;
        }
        self.factor.apply(&self.scratch, &mut self.step);
        for (mean, step) in self.mean.iter_mut().zip(&self.step) {
            *mean = (*mean + self.sigma * step).clamp(0.0, 1.0);
        }
        let norm = self.path_sigma.iter().map(|p| p * p).sum::<f64>().sqrt();
        let expected = dimension.sqrt() * (1.0 - 1.0 / (4.0 * dimension) + 1.0 / (21.0 * dimension * dimension));
        let fading = 1.0 - (1.0 - rates.c_sigma).powi(2 * (self.age as i32 + 1));
        let steady = norm / fading.sqrt() < (1.4 + 2.0 / (dimension + 1.0)) * expected;
        let gain = if steady { (rates.c_c * (2.0 - rates.c_c) * rates.mu_eff).sqrt() } else { 0.0 };
        for (path, step) in self.path_c.iter_mut().zip(&self.step) {
            *path = (1.0 - rates.c_c) * *path + gain * step;
        }
        let old = &mut self.normals;
        for &i in &self.order[..rates.weights.len()] {
            // What is learned is in the axes of the factor before its update.
            self.factor.apply(&old[i * n..][..n], &mut self.scratch);
            old[i * n..][..n].copy_from_slice(&self.scratch);
        }
        let lost = if steady { 0.0 } else { rates.c_1 * rates.c_c * (2.0 - rates.c_c) };
        self.factor.scale((1.0 - rates.c_1 - rates.c_mu + lost).sqrt());
        self.scratch.copy_from_slice(&self.path_c);
        self.factor.add_rank_one(rates.c_1, &mut self.scratch);
        for (&w, &i) in rates.weights.iter().zip(&self.order) {
            self.factor.add_rank_one(rates.c_mu * w, &mut old[i * n..][..n]);
        }
        self.sigma *= (rates.c_sigma / rates.d_sigma * (norm / expected - 1.0)).exp().min(2.0);
        self.sigma = self.sigma.min(1.0);
    }

    fn restart(&mut self, stream: &mut Stream) {
        self.population = (2 * self.population).min(self.params.max_population);
        self.rates = Rates::new(self.dimension, self.population);
        self.mean.fill_with(|| stream.random());
        self.sigma = self.params.initial_deviation;
        self.factor.reset();
        self.path_sigma.fill(0.0);
        self.path_c.fill(0.0);
        (self.age, self.stalled, self.best_of_start) = (0, 0, f64::INFINITY);
    }
}

impl Optimizer for CmaEs {
    fn dimension(&self) -> usize {
        self.dimension
    }

    fn ask(&self) -> &[f64] {
        &self.samples
    }

    fn tell(&mut self, costs: &[f64]) -> Result<(), Error> {
        check::length("costs", costs.len(), self.population)?;
        let n = self.dimension;
        self.order.clear();
        self.order.extend(0..self.population);
        self.order.sort_unstable_by(|&a, &b| comparable(costs[a]).total_cmp(&comparable(costs[b])).then(a.cmp(&b)));
        let leader = self.order[0];
        let cost = comparable(costs[leader]);
        if cost < self.best_cost || self.generation == 0 {
            self.best_cost = cost;
            self.best.copy_from_slice(&self.samples[leader * n..][..n]);
        }
        self.stalled = if cost < self.best_of_start { 0 } else { self.stalled + 1 };
        self.best_of_start = self.best_of_start.min(cost);
        self.learn();
        self.generation += 1;
        self.age += 1;
        let mut stream = self.seed.stream(self.generation, 0);
        // Also when numbers have got lost: a comparison with NaN is false.
        let alive = self.sigma * self.factor.max_deviation() > self.params.restart_deviation;
        if !alive || self.stalled >= self.params.restart_stall {
            self.restart(&mut stream);
        }
        self.sample(&mut stream);
        Ok(())
    }

    fn best(&self) -> Option<(&[f64], f64)> {
        (self.generation > 0).then_some((self.best.as_slice(), self.best_cost))
    }

    fn spread(&self) -> f64 {
        self.sigma * self.factor.max_deviation()
    }
}

#[cfg(feature = "serde")]
mod checkpoint;
#[cfg(test)]
mod tests;
