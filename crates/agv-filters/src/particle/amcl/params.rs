//! What is set once.

use crate::particle::{
    EffectiveSampleSizeBelow, Hysteresis, KldParams, MclParams, MotionThreshold, ParticleSet, RecoveryParams,
    TemperingParams,
};
use agv_core::{Error, check, roles::StatusParams};

/// Parameters of an [`Amcl`](super::Amcl).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AmclParams {
    /// Particles of a belief around a pose, until the first set is drawn; a belief over all free space has as many as there
    /// is room for ([`KldParams::max_particles`]).
    pub particles: usize,
    /// When an observation is taken in.
    pub update: MotionThreshold,
    /// When a new set is drawn.
    pub resample: EffectiveSampleSizeBelow,
    /// How many particles it has.
    pub kld: KldParams,
    /// When, and how many of them, are drawn elsewhere.
    pub recovery: RecoveryParams,
    /// Which hypothesis is the estimate.
    pub hysteresis: Hysteresis,
    /// When an observation is taken in by degrees.
    pub tempering: TemperingParams,
    /// Whether the estimate is brought from the particles' mean to the peak of the observation's likelihood, where the belief is
    /// narrow and the sensor can tell.
    pub refine: bool,
    /// When the estimate counts as tracking, and when as lost.
    pub status: StatusParams,
}

impl Default for AmclParams {
    /// The defaults of the parts; 2000 particles around a start, as [`MclParams`].
    fn default() -> Self {
        let MclParams { particles, update, resample, tempering, refine, status } = MclParams::default();
        Self {
            particles,
            update,
            resample,
            kld: KldParams::default(),
            recovery: RecoveryParams::default(),
            hysteresis: Hysteresis::default(),
            tempering,
            refine,
            status,
        }
    }
}

impl AmclParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// What the parts' `validate` refuse, or more particles around a pose than there is room for.
    pub fn validate(&self) -> Result<(), Error> {
        self.mcl().validate()?;
        self.kld.validate()?;
        ParticleSet::check_count(self.particles)?;
        check::in_range("particles", self.particles as f64, 1.0, self.kld.max_particles as f64)?;
        self.recovery.validate()?;
        self.hysteresis.validate()
    }

    /// Those of the filter inside.
    pub(super) const fn mcl(&self) -> MclParams {
        let Self { particles, update, resample, tempering, refine, status, .. } = *self;
        MclParams { particles, update, resample, tempering, refine, status }
    }
}
