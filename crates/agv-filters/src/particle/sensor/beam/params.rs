//! What the beam model is made of.

use crate::particle::ScanForm;
use agv_core::{Error, check, grid::UnknownSpace, sensors::LaserScan};

/// Parameters of a [`BeamModel`](super::BeamModel).
///
/// The four shares are relative: they are scaled to sum to one.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BeamModelParams {
    /// Share of beams that measure what the map shows.
    pub z_hit: f64,
    /// Share of beams that something unmapped stops before.
    pub z_short: f64,
    /// Share of beams that do not come back though there is something.
    pub z_max: f64,
    /// Share of beams that measure anything.
    pub z_rand: f64,
    /// Standard deviation of a hit, in metres; covers the map's error as well as the scanner's.
    pub sigma_hit: f64,
    /// How thickly unmapped things stand along a beam, in 1/m.
    pub lambda_short: f64,
    /// Most beams of a scan that are used, evenly spread.
    pub max_beams: usize,
    /// Fewest hits among them for the scan to count.
    pub min_hits: usize,
    /// Range beyond which nothing is looked for, in metres: readings beyond it count as no return. A scanner's own range
    /// counts where it is shorter.
    pub max_range: f64,
    /// What unobserved space does to a beam: [`UnknownSpace::Free`] lets it pass, [`UnknownSpace::Obstacle`] stops it, and
    /// with [`UnknownSpace::Uniform`] it ends anywhere beyond, or not at all, one as likely as the other.
    pub unknown: UnknownSpace,
    /// How the beams make one likelihood.
    pub form: ScanForm,
    /// A beam counts as explained by a pose if it differs by no more from what the map shows, in metres.
    pub explained_within: f64,
}

impl Default for BeamModelParams {
    /// Shares, deviation and rate of `nav2_amcl`; unobserved space is passed, as there. Range, beams and their combination as
    /// [`LikelihoodFieldModelParams`](crate::particle::LikelihoodFieldModelParams).
    fn default() -> Self {
        Self {
            z_hit: 0.5,
            z_short: 0.05,
            z_max: 0.05,
            z_rand: 0.5,
            sigma_hit: 0.2,
            lambda_short: 0.1,
            max_beams: 60,
            min_hits: 5,
            max_range: 30.0,
            unknown: UnknownSpace::Free,
            form: ScanForm::Product { independent_beams: 18.0 },
            explained_within: 0.2,
        }
    }
}

impl BeamModelParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// A `z_hit` or `z_short` that is negative, another field that is not finite and positive (without random beams one
    /// unmapped obstacle would make every pose impossible, without lost ones one dark surface), or no beams, or more than
    /// [`LaserScan::MAX_BEAMS`].
    pub fn validate(&self) -> Result<(), Error> {
        check::non_negative("z_hit", self.z_hit)?;
        check::non_negative("z_short", self.z_short)?;
        check::positive("z_max", self.z_max)?;
        check::positive("z_rand", self.z_rand)?;
        check::finite("sum of the shares", self.z_hit + self.z_short + self.z_max + self.z_rand)?;
        check::positive("sigma_hit", self.sigma_hit)?;
        check::positive("lambda_short", self.lambda_short)?;
        check::in_range("max_beams", self.max_beams as f64, 1.0, LaserScan::MAX_BEAMS as f64)?;
        check::positive("max_range", self.max_range)?;
        check::in_range("z_rand / max_range", self.z_rand / self.max_range, 1e-30, 1e30)?;
        check::positive("explained_within", self.explained_within)?;
        self.form.validate()
    }
}
