//! What is set once, and what is reported of each update.

use super::temper::TemperingParams;
use crate::particle::{EffectiveSampleSizeBelow, MotionThreshold, ParticleSet, WeightSummary};
use agv_core::{Error, roles::StatusParams};

/// Parameters of an [`Mcl`](super::Mcl).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MclParams {
    /// Number of particles.
    pub particles: usize,
    /// When an observation is taken in.
    pub update: MotionThreshold,
    /// When a new set is drawn.
    pub resample: EffectiveSampleSizeBelow,
    /// When an observation is taken in by degrees.
    pub tempering: TemperingParams,
    /// Whether the estimate is brought from the particles' mean to the peak of the observation's likelihood, where the belief is
    /// narrow and the sensor can tell.
    pub refine: bool,
    /// When the estimate counts as tracking, and when as lost.
    pub status: StatusParams,
}

impl Default for MclParams {
    /// 2000 particles, `nav2_amcl`'s upper limit; updates each 0.2 m or 0.2 rad; resampling below half the effective
    /// sample size.
    fn default() -> Self {
        Self {
            particles: 2000,
            update: MotionThreshold::default(),
            resample: EffectiveSampleSizeBelow::default(),
            tempering: TemperingParams::default(),
            refine: true,
            status: StatusParams::default(),
        }
    }
}

impl MclParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// Zero or more than [`ParticleSet::MAX_PARTICLES`] particles, or a policy or a threshold out of range.
    pub fn validate(&self) -> Result<(), Error> {
        ParticleSet::check_count(self.particles)?;
        self.update.validate()?;
        self.resample.validate()?;
        self.tempering.validate()?;
        self.status.validate()
    }
}

/// How the last update went.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MclDiagnostics {
    /// The weights after the last update, before resampling.
    pub weights: WeightSummary,
    /// Whether the set was resampled then.
    pub resampled: bool,
    /// In how many degrees the last observation was taken in: one unless the weights collapsed, and one too in a belief so wide
    /// that only part of it was taken in ([`TemperingParams::widest`]).
    #[cfg_attr(feature = "serde", serde(default))]
    pub degrees: usize,
    /// Updates applied since the belief was initialised.
    pub updates: u64,
    /// Particles that were drawn elsewhere than around the old ones then.
    #[cfg_attr(feature = "serde", serde(default))]
    pub fresh: usize,
}

impl MclDiagnostics {
    /// Those of `count` particles that were just drawn.
    pub(super) fn fresh(count: usize) -> Self {
        Self { weights: WeightSummary::uniform(count), resampled: false, degrees: 0, updates: 0, fresh: 0 }
    }
}
