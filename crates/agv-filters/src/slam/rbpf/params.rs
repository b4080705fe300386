//! What is set once.

use super::beams::FARTHEST;
use crate::{
    matching::{CorrelativeParams, SearchWindow},
    particle::{EffectiveSampleSizeBelow, MotionThreshold, ParticleSet},
};
use agv_core::{
    Error, check,
    grid::{InverseModelParams, NoReturn},
};

/// Parameters of an [`Rbpf`](super::Rbpf).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RbpfParams {
    /// Number of particles.
    pub particles: usize,
    /// Edge of a map's cell, in metres.
    pub resolution: f64,
    /// How far the vehicle moves from one scan that is taken in to the next.
    pub update: MotionThreshold,
    /// When a new set of particles is drawn.
    pub resample: EffectiveSampleSizeBelow,
    /// Greatest range that is used, in metres: a longer beam is free up to there.
    pub max_range: f64,
    /// What a beam without a return says.
    pub no_return: NoReturn,
    /// How scans are matched, and what they are worth.
    pub matching: ScanFitParams,
    /// How the motion is found by matching a scan with those before it, ahead of the particles; none to trust the odometry.
    pub scan_odometry: Option<CorrelativeParams>,
}

/// How a scan fits a particle's map.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ScanFitParams {
    /// Standard deviation of a beam's end from the map's surfaces, in metres.
    pub sigma: f64,
    /// Most that a beam may cost, as minus the logarithm of its likelihood: that of one that meets nothing.
    pub outlier: f64,
    /// As many independent beams a scan is worth where it places the particle, if it has as many: neighbouring beams err together.
    pub independent_beams: f64,
    /// Exponent on the likelihood where particles are weighed against each other, at most one: the reciprocal of `GMapping`'s gain.
    pub weight_exponent: f64,
    /// Most beams that are matched, evenly spread.
    pub max_beams: usize,
    /// Fewest beams with a surface for a scan to be taken in.
    pub min_beams: usize,
    /// Least share of the matched beams that must meet the map, for the match to place the particle and not the odometry alone.
    pub min_explained: f64,
    /// Most steps of a match.
    pub max_iterations: usize,
    /// Poses around the match at which the proposal is fitted.
    pub samples: usize,
}

impl Default for RbpfParams {
    /// 30 particles on cells of 0.05 m, as `GMapping` has them; a scan each 0.3 m or 0.25 rad; resampling below half the effective
    /// sample size (Grisetti et al. 2007, section III-B).
    fn default() -> Self {
        Self {
            particles: 30,
            resolution: 0.05,
            update: MotionThreshold { distance: 0.3, angle: 0.25 },
            resample: EffectiveSampleSizeBelow::default(),
            max_range: 40.0,
            no_return: NoReturn::default(),
            matching: ScanFitParams::default(),
            scan_odometry: Some(CorrelativeParams {
                window: SearchWindow { distance: 0.3, angle: 0.2 },
                ..CorrelativeParams::default()
            }),
        }
    }
}

impl Default for ScanFitParams {
    /// An indoor scanner on a map of 0.05 m cells.
    fn default() -> Self {
        Self {
            sigma: 0.05,
            outlier: 3.0,
            independent_beams: 60.0,
            weight_exponent: 0.15,
            max_beams: 180,
            min_beams: 20,
            min_explained: 0.4,
            max_iterations: 15,
            samples: 12,
        }
    }
}

impl RbpfParams {
    /// Most particles: each may hold a map of its own.
    pub const MAX_PARTICLES: usize = 1 << 14;

    /// Checks all fields.
    ///
    /// # Errors
    /// The first field that is out of its range.
    pub fn validate(&self) -> Result<(), Error> {
        if ParticleSet::check_count(self.particles)? > Self::MAX_PARTICLES {
            return Err(Error::TooMany { name: "particles", len: self.particles, max: Self::MAX_PARTICLES });
        }
        check::in_range("resolution", self.resolution, 1e-3, 10.0)?;
        self.update.validate()?;
        self.resample.validate()?;
        check::in_range("max_range (cells)", self.max_range / self.resolution, 1.0, 0.5 * FARTHEST)?;
        self.inverse_model().map(|_| ())?;
        self.matching.validate()?;
        self.scan_odometry.map_or(Ok(()), |matching| matching.validate())
    }

    /// What beams say of cells.
    pub(super) fn inverse_model(&self) -> Result<agv_core::grid::InverseModel, Error> {
        agv_core::grid::InverseModel::new(InverseModelParams {
            max_range: Some(self.max_range),
            no_return: self.no_return,
            ..InverseModelParams::default()
        })
    }
}

impl ScanFitParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// The first field that is out of its range.
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("sigma", self.sigma)?;
        check::positive("outlier", self.outlier)?;
        check::positive("independent_beams", self.independent_beams)?;
        check::in_range("weight_exponent", self.weight_exponent, f64::MIN_POSITIVE, 1.0)?;
        check::at_least("max_beams", self.max_beams, 1)?;
        check::at_least("min_beams", self.min_beams, 3)?;
        check::in_range("min_explained", self.min_explained, 0.0, 1.0)?;
        check::in_range("samples", self.samples as f64, 6.0, super::proposal::MAX_SAMPLES as f64)?;
        Ok(())
    }
}
