//! How thoroughly a scan is searched for.

use crate::particle::PoseBins;
use agv_core::{Error, check};
use nalgebra::Vector3;

/// Parameters of a [`LikelihoodSearch`](super::LikelihoodSearch).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LikelihoodSearchParams {
    /// Candidates per square metre of free space.
    pub density: f64,
    /// Most candidates of a search.
    pub max_candidates: usize,
    /// Bins of which one candidate each is refined.
    pub bins: PoseBins,
    /// Most candidates that are refined.
    pub refined: usize,
    /// Rounds of refinement.
    pub rounds: u32,
    /// Poses that are tried around each in a round.
    pub trials: usize,
    /// Standard deviation of the first round's trials, in metres; it halves from round to round.
    pub spread: f64,
    /// The same of the heading, in radians.
    pub turn: f64,
    /// By how much the log-likelihood of a place may fall short of the estimate's and still be proposed: a search that finds
    /// nothing as good disturbs nothing.
    pub margin: f64,
    /// Power of the likelihood that poses are drawn in proportion to, in [0, 1].
    pub power: f64,
    /// Poses that a search may try in an update, per particle, as long as the belief is narrow and the estimate explains the
    /// observation: what was found so far is carried on to the next one.
    pub effort: f64,
    /// Share of explained readings below which the vehicle is lost, in [0, 1], and the search is done at once.
    pub explained: f64,
}

impl Default for LikelihoodSearchParams {
    /// A candidate each 0.5 m and 10°, 144 per square metre, of which at most 30 000 are tried at once: 60 beams of them
    /// take some milliseconds, and a search that misses is repeated with the next scan. 100 are refined, to 3 cm and 1°.
    /// What is twenty times less likely than the estimate is not proposed. An estimate that explains 0.6 of the readings
    /// ([`RecoveryParams::explained`](crate::particle::RecoveryParams)) leaves time: the search then takes no longer than the weighing.
    fn default() -> Self {
        Self {
            density: 144.0,
            max_candidates: 30_000,
            bins: PoseBins::default(),
            refined: 100,
            rounds: 4,
            trials: 12,
            spread: 0.2,
            turn: 0.1,
            margin: 3.0,
            power: 0.2,
            effort: 1.0,
            explained: 0.6,
        }
    }
}

impl LikelihoodSearchParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// A density, spread or turn that is not finite and positive; no candidates, or more than 16 million of them, of refined
    /// ones or of trials; more than 30 rounds; a negative margin; an effort that is not positive; a power or a share outside [0, 1].
    pub fn validate(&self) -> Result<(), Error> {
        const MOST: f64 = 16e6;
        check::positive("search density", self.density)?;
        check::in_range("max_candidates", self.max_candidates as f64, 1.0, MOST)?;
        check::in_range("refined", self.refined as f64, 1.0, MOST)?;
        check::in_range("trials", self.refined as f64 * self.trials as f64, 0.0, MOST)?;
        check::in_range("rounds", f64::from(self.rounds), 0.0, 30.0)?;
        check::positive("search spread", self.spread)?;
        check::positive("search turn", self.turn)?;
        check::non_negative("search margin", self.margin)?;
        check::in_range("search power", self.power, 0.0, 1.0)?;
        check::positive("search effort", self.effort)?;
        check::in_range("search explained", self.explained, 0.0, 1.0)?;
        self.bins.validate()
    }

    /// Standard deviations of a round's trials.
    pub(super) fn scale(&self, round: u32) -> Vector3<f64> {
        Vector3::new(self.spread, self.spread, self.turn) * 0.5_f64.powi(round as i32)
    }
}
