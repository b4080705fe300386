//! CMA-ES read from a checkpoint: as long as one made anew, and of numbers that can go on.

use super::super::cholesky::CholeskyFactor;
use super::{CmaEs, CmaEsParams, Rates};
use crate::optimize::stored_costs;
use agv_core::{Error, check, compute::Seed};

#[derive(serde::Deserialize)]
pub(super) struct RawCmaEs {
    params: CmaEsParams,
    dimension: usize,
    seed: Seed,
    generation: u64,
    population: usize,
    mean: Vec<f64>,
    sigma: f64,
    factor: CholeskyFactor,
    path_sigma: Vec<f64>,
    path_c: Vec<f64>,
    age: usize,
    stalled: usize,
    #[serde(with = "stored_costs::single")]
    best_of_start: f64,
    samples: Vec<f64>,
    normals: Vec<f64>,
    best: Vec<f64>,
    #[serde(with = "stored_costs::single")]
    best_cost: f64,
}

impl TryFrom<RawCmaEs> for CmaEs {
    type Error = Error;

    fn try_from(raw: RawCmaEs) -> Result<Self, Error> {
        // Lengths before anything is made of them: a checkpoint must not ask for more memory than it fills.
        let (n, count) = (raw.dimension, raw.population);
        check::at_least("population", count, 4)?;
        check::length("samples", raw.samples.len(), count.saturating_mul(n))?;
        check::length("normals", raw.normals.len(), raw.samples.len())?;
        check::length("mean", raw.mean.len(), n)?;
        check::length("best", raw.best.len(), n)?;
        check::length("path_sigma", raw.path_sigma.len(), n)?;
        check::length("path_c", raw.path_c.len(), n)?;
        raw.factor.check(n)?;
        check::positive("sigma", raw.sigma)?;
        check::all_finite("state", raw.path_sigma.iter().chain(&raw.path_c).chain(&raw.normals))?;
        for &x in raw.samples.iter().chain(&raw.mean).chain(&raw.best) {
            check::in_range("coordinate", x, 0.0, 1.0)?;
        }
        // The scratch of a restart grows with its population, which the samples have shown to be there.
        check::in_range("population", count as f64, 4.0, raw.params.max_population as f64)?;
        let fresh = Self::new(n, CmaEsParams { population: count, ..raw.params }, raw.seed)?;
        Ok(Self {
            params: raw.params,
            generation: raw.generation,
            rates: Rates::new(n, count),
            mean: raw.mean,
            sigma: raw.sigma,
            factor: raw.factor,
            path_sigma: raw.path_sigma,
            path_c: raw.path_c,
            age: raw.age,
            stalled: raw.stalled,
            best_of_start: raw.best_of_start,
            samples: raw.samples,
            normals: raw.normals,
            best: raw.best,
            best_cost: raw.best_cost,
            ..fresh
        })
    }
}
