//! A set of particles as it is stored.

use super::{ParticleSet, ParticleState};
use agv_core::Error;

/// States and weights, before they are checked.
#[derive(serde::Serialize, serde::Deserialize)]
pub(super) struct StoredSet<X> {
    capacity: usize,
    states: Vec<X>,
    /// None for a particle that an observation ruled out: texts have no number for −∞.
    log_weights: Vec<Option<f64>>,
    weights: Vec<f64>,
}

impl<X: ParticleState> From<ParticleSet<X>> for StoredSet<X> {
    fn from(set: ParticleSet<X>) -> Self {
        Self {
            capacity: set.capacity(),
            states: set.states().to_vec(),
            log_weights: set.log_weights().iter().map(|&w| (w > f64::NEG_INFINITY).then_some(w)).collect(),
            weights: set.weights().to_vec(),
        }
    }
}

impl<X: ParticleState> TryFrom<StoredSet<X>> for ParticleSet<X> {
    type Error = Error;

    fn try_from(stored: StoredSet<X>) -> Result<Self, Error> {
        let mut set = Self::new(stored.states)?.with_capacity(stored.capacity)?;
        let log_weights: Vec<f64> = stored.log_weights.iter().map(|w| w.unwrap_or(f64::NEG_INFINITY)).collect();
        set.restore_weights(&log_weights, &stored.weights)?;
        Ok(set)
    }
}
