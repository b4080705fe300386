//! Which beams of a scan the likelihood-field model uses, and how they go together.

use crate::particle::sensor::ScanForm;
use agv_core::{Error, check, sensors::LaserScan};

/// Parameters of a [`LikelihoodFieldModel`](super::LikelihoodFieldModel).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LikelihoodFieldModelParams {
    /// Most beams of a scan that are used, evenly spread.
    pub max_beams: usize,
    /// Fewest usable hits among them for the scan to count.
    pub min_hits: usize,
    /// Hits beyond this range say nothing, in metres: far end points swing with the heading's error.
    pub max_range: f64,
    /// How the beams make one likelihood.
    pub form: ScanForm,
    /// A beam counts as explained by a pose if it ends this near to what the map shows, in metres; less than the field's
    /// `max_distance`.
    pub explained_within: f64,
}

impl Default for LikelihoodFieldModelParams {
    /// 60 beams, as `nav2_amcl`, of which 5 must hit within 30 m. A scan counts as 18 independent beams: on the Intel log
    /// the position is then better by 3 mm of 58 than with 60, and of the particles more stay alive. Beams within
    /// 0.2 m, the field's usual deviation, are explained.
    fn default() -> Self {
        Self {
            max_beams: 60,
            min_hits: 5,
            max_range: 30.0,
            form: ScanForm::Product { independent_beams: 18.0 },
            explained_within: 0.2,
        }
    }
}

impl LikelihoodFieldModelParams {
    /// Checks all fields.
    ///
    /// # Errors
    /// Zero or more than [`LaserScan::MAX_BEAMS`] beams, or a range, a distance or a number of independent beams that is
    /// not finite and positive.
    pub fn validate(&self) -> Result<(), Error> {
        check::in_range("max_beams", self.max_beams as f64, 1.0, LaserScan::MAX_BEAMS as f64)?;
        check::positive("max_range", self.max_range)?;
        check::positive("explained_within", self.explained_within)?;
        self.form.validate()
    }
}
