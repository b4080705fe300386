//! Evolution: differential evolution and CMA-ES, what a swarm is to be compared with.

mod cholesky;
mod cma_es;
mod differential;

pub use cma_es::{CmaEs, CmaEsParams};
pub use differential::{DifferentialEvolution, DifferentialEvolutionParams};
