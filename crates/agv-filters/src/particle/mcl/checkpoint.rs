//! The state of a running filter, to store and to resume from.

use super::filter::{Belief, Mcl, MclDiagnostics};
use crate::particle::ParticleSet;
use agv_core::{
    Error, check, compute::Seed, geometry::Se2, odometry::OdometryIncrement, roles::PoseEstimate, time::Stamp,
};
use nalgebra::{Matrix3, UnitComplex, Vector2};

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
    poses: Vec<RawPose>,
    log_weights: Vec<f64>,
    weights: Vec<f64>,
    pending: Option<RawIncrement>,
    moments: Option<(RawPose, Matrix3<f64>)>,
    diagnostics: MclDiagnostics,
}

/// x, y, cosine and sine: an angle would not bring back the same bits.
type RawPose = [f64; 4];

/// An odometry increment, field by field.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
struct RawIncrement {
    start: Stamp,
    end: Stamp,
    start_from_end: RawPose,
    covariance: Matrix3<f64>,
}

fn to_raw(pose: &Se2) -> RawPose {
    [pose.x(), pose.y(), pose.rotation().cos(), pose.rotation().sin()]
}

fn from_raw(raw: &RawPose) -> Result<Se2, Error> {
    let [x, y, cos, sin] = *raw;
    check::all_finite("pose", raw)?;
    check::in_range("cos² + sin²", cos * cos + sin * sin, 1.0 - 1e-6, 1.0 + 1e-6)?;
    Ok(Se2::from_parts(Vector2::new(x, y), UnitComplex::from_cos_sin_unchecked(cos, sin).into()))
}

impl<M, S, R, P, U> Mcl<M, S, R, P, U> {
    /// The state of the filter.
    pub fn checkpoint(&self) -> MclCheckpoint {
        let Belief { particles, initialized, step, pending, due, moments, diagnostics } = &self.belief;
        MclCheckpoint {
            seed: self.seed,
            step: *step,
            initialized: *initialized,
            due: *due,
            poses: particles.poses().iter().map(to_raw).collect(),
            log_weights: particles.log_weights().to_vec(),
            weights: particles.weights().to_vec(),
            pending: pending.map(|motion| RawIncrement {
                start: motion.start,
                end: motion.end,
                start_from_end: to_raw(&motion.start_from_end),
                covariance: motion.covariance,
            }),
            moments: moments.map(|estimate| (to_raw(&estimate.map_from_base), estimate.covariance)),
            diagnostics: *diagnostics,
        }
    }

    /// Puts the filter into a stored state; number of particles and seed become those of the checkpoint.
    ///
    /// # Errors
    /// A number that is not finite, a rotation that is not one, or weights that do not sum to one; the filter is then
    /// as it was.
    pub fn restore(&mut self, checkpoint: &MclCheckpoint) -> Result<(), Error> {
        let poses: Vec<Se2> = checkpoint.poses.iter().map(from_raw).collect::<Result<_, _>>()?;
        let mut particles = ParticleSet::new(poses)?;
        particles.restore_weights(&checkpoint.log_weights, &checkpoint.weights)?;
        let restore_motion = |raw: &RawIncrement| {
            check::all_finite("odometry covariance", raw.covariance.iter())?;
            let start_from_end = from_raw(&raw.start_from_end)?;
            Ok(OdometryIncrement { start: raw.start, end: raw.end, start_from_end, covariance: raw.covariance })
        };
        let restore_moments = |(raw, covariance): &(RawPose, Matrix3<f64>)| {
            check::all_finite("covariance", covariance.iter())?;
            Ok::<_, Error>(PoseEstimate { map_from_base: from_raw(raw)?, covariance: *covariance })
        };
        let belief = Belief {
            particles,
            initialized: checkpoint.initialized,
            step: checkpoint.step,
            pending: checkpoint.pending.as_ref().map(restore_motion).transpose()?,
            due: checkpoint.due,
            moments: checkpoint.moments.as_ref().map(restore_moments).transpose()?,
            diagnostics: checkpoint.diagnostics,
        };
        self.log_likelihoods.resize(belief.particles.len(), 0.0);
        self.belief = belief;
        self.seed = checkpoint.seed;
        Ok(())
    }
}
