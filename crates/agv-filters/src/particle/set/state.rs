//! What a particle is a sample of.

use agv_core::geometry::{LieGroup, Se2, Se3};
use nalgebra::SVector;

/// What a particle is a sample of: a pose, or the state vector of a process model.
pub trait ParticleState: Copy + Send + Sync {
    /// Whether all numbers in it are finite.
    fn is_finite(&self) -> bool;
}

impl ParticleState for Se2 {
    fn is_finite(&self) -> bool {
        LieGroup::is_finite(self)
    }
}

impl ParticleState for Se3 {
    fn is_finite(&self) -> bool {
        LieGroup::is_finite(self)
    }
}

impl<const N: usize> ParticleState for SVector<f64, N> {
    fn is_finite(&self) -> bool {
        self.iter().all(|value| value.is_finite())
    }
}
