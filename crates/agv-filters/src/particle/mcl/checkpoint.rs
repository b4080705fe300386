//! The state of a running filter, to store and to resume from.

use super::{
    MclDiagnostics,
    belief::{Belief, Known, LastDrawn},
    filter::Mcl,
};
use crate::particle::{ParticleSet, excursion::Excursion, per_sensor::PerSensor};
use agv_core::{Error, check, compute::Seed, geometry::Se2, odometry::OdometryIncrement, roles::StatusMonitor};

/// All of a filter that changes as it runs: particles, weights, seed and step, pending odometry, what each sensor has seen
/// last, status, diagnostics.
///
/// Models, map and policies are not in it: they are the caller's, and large. A filter that is built with the same ones and
/// [`restore`](Mcl::restore)d continues with the same bits, provided the format keeps every `f64` exactly (`serde_json` does with
/// its feature `float_roundtrip`).
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MclCheckpoint {
    seed: Seed,
    step: u64,
    begun: u64,
    capacity: usize,
    poses: Vec<Se2>,
    /// None for a particle that an observation ruled out: texts have no number for −∞.
    log_weights: Vec<Option<f64>>,
    weights: Vec<f64>,
    known: Option<Known>,
    pending: Option<OdometryIncrement>,
    odom_from_base: Se2,
    applied: PerSensor<Excursion>,
    drawn: LastDrawn,
    monitor: StatusMonitor,
    diagnostics: MclDiagnostics,
}

impl<M, S, R, P, U, N> Mcl<M, S, R, P, U, N> {
    /// The state of the filter.
    pub fn checkpoint(&self) -> MclCheckpoint {
        let Belief { particles, step, begun, known, pending, odom_from_base, applied, drawn, monitor, diagnostics } =
            &self.belief;
        MclCheckpoint {
            seed: self.seed,
            step: *step,
            begun: *begun,
            capacity: particles.capacity(),
            poses: particles.states().to_vec(),
            log_weights: particles.log_weights().iter().map(|&w| (w > f64::NEG_INFINITY).then_some(w)).collect(),
            weights: particles.weights().to_vec(),
            known: *known,
            pending: *pending,
            odom_from_base: *odom_from_base,
            applied: applied.clone(),
            drawn: *drawn,
            monitor: *monitor,
            diagnostics: *diagnostics,
        }
    }

    /// Puts the filter into a stored state; number of particles, seed and thresholds of the status become those of the
    /// checkpoint.
    ///
    /// # Errors
    /// No particles or too many, a covariance that is not finite, or weights that do not sum to one; the filter is then as
    /// it was.
    pub fn restore(&mut self, checkpoint: &MclCheckpoint) -> Result<(), Error> {
        let mut particles = ParticleSet::new(checkpoint.poses.clone())?.with_capacity(checkpoint.capacity)?;
        let log_weights: Vec<f64> = checkpoint.log_weights.iter().map(|w| w.unwrap_or(f64::NEG_INFINITY)).collect();
        particles.restore_weights(&log_weights, &checkpoint.weights)?;
        if let Some(motion) = &checkpoint.pending {
            check::all_finite("covariance", motion.covariance.iter())?;
        }
        self.log_likelihoods.resize(particles.capacity(), 0.0);
        let mut applied = PerSensor::new();
        applied.assign(&checkpoint.applied);
        self.belief = Belief {
            particles,
            step: checkpoint.step,
            begun: checkpoint.begun,
            known: checkpoint.known,
            pending: checkpoint.pending,
            odom_from_base: checkpoint.odom_from_base,
            applied,
            drawn: checkpoint.drawn,
            monitor: checkpoint.monitor,
            diagnostics: checkpoint.diagnostics,
        };
        self.seed = checkpoint.seed;
        Ok(())
    }
}
