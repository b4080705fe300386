//! The state of a running filter, to store and to resume from.

use super::filter::{Belief, Mcl, MclDiagnostics};
use crate::particle::ParticleSet;
use agv_core::{
    Error, check, compute::Seed, geometry::Se2, odometry::OdometryIncrement, roles::PoseEstimate, time::Stamp,
};

/// All of a filter that changes as it runs: particles, weights, seed and step, pending odometry, diagnostics.
///
/// Models, map and policies are not in it: they are the caller's, and large. A filter that is built with the same ones and
/// [`restore`](Mcl::restore)d continues with the same bits, provided the format keeps every `f64` exactly (`serde_json` does with
/// its feature `float_roundtrip`).
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MclCheckpoint {
    seed: Seed,
    step: u64,
    initialized: bool,
    due: bool,
    poses: Vec<Se2>,
    /// None for a particle that an observation ruled out: texts have no number for −∞.
    log_weights: Vec<Option<f64>>,
    weights: Vec<f64>,
    pending: Option<OdometryIncrement>,
    stamp: Option<Stamp>,
    moments: Option<PoseEstimate<Se2>>,
    diagnostics: MclDiagnostics,
}

impl<M, S, R, P, U> Mcl<M, S, R, P, U> {
    /// The state of the filter.
    pub fn checkpoint(&self) -> MclCheckpoint {
        let Belief { particles, initialized, step, pending, stamp, due, moments, diagnostics } = &self.belief;
        MclCheckpoint {
            seed: self.seed,
            step: *step,
            initialized: *initialized,
            due: *due,
            poses: particles.poses().to_vec(),
            log_weights: particles.log_weights().iter().map(|&w| (w > f64::NEG_INFINITY).then_some(w)).collect(),
            weights: particles.weights().to_vec(),
            pending: *pending,
            stamp: *stamp,
            moments: *moments,
            diagnostics: *diagnostics,
        }
    }

    /// Puts the filter into a stored state; number of particles and seed become those of the checkpoint.
    ///
    /// # Errors
    /// No particles or too many, a covariance that is not finite, or weights that do not sum to one; the filter is then as
    /// it was.
    pub fn restore(&mut self, checkpoint: &MclCheckpoint) -> Result<(), Error> {
        let MclCheckpoint { pending, moments, .. } = checkpoint;
        let mut particles = ParticleSet::new(checkpoint.poses.clone())?;
        let log_weights: Vec<f64> = checkpoint.log_weights.iter().map(|w| w.unwrap_or(f64::NEG_INFINITY)).collect();
        particles.restore_weights(&log_weights, &checkpoint.weights)?;
        let covariances = [pending.map(|motion| motion.covariance), moments.map(|estimate| estimate.covariance)];
        for covariance in covariances.iter().flatten() {
            check::all_finite("covariance", covariance.iter())?;
        }
        let belief = Belief {
            particles,
            initialized: checkpoint.initialized,
            step: checkpoint.step,
            pending: *pending,
            stamp: checkpoint.stamp,
            due: checkpoint.due,
            moments: *moments,
            diagnostics: checkpoint.diagnostics,
        };
        self.log_likelihoods.resize(belief.particles.len(), 0.0);
        self.belief = belief;
        self.seed = checkpoint.seed;
        Ok(())
    }
}
