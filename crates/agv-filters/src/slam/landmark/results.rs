//! What landmark SLAM answers.

use agv_core::geometry::UncertainVector;

/// A landmark of a map, as long as it is there: keys are not used again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LandmarkKey(pub(super) u32);

impl LandmarkKey {
    /// The number.
    pub const fn number(self) -> u32 {
        self.0
    }
}

/// A landmark that was mapped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MappedLandmark {
    /// Its name here.
    pub key: LandmarkKey,
    /// The identity that the sensor read, if it reads any.
    pub id: Option<u32>,
    /// Where it is in the map, in metres.
    pub place: UncertainVector<2>,
    /// How often it was seen.
    pub sightings: u32,
    /// Whether it was seen often enough to be believed.
    pub confirmed: bool,
}

/// What became of a sighting.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[non_exhaustive]
pub enum SightingOutcome {
    /// It is of a landmark of the map.
    Matched(LandmarkKey),
    /// It is of a new landmark, which was added.
    Added(LandmarkKey),
    /// It is a range of a landmark whose place is not known yet.
    Waiting,
    /// Its landmark is known, and nowhere near.
    Rejected,
    /// It may be of several landmarks, or of a new one next to a known one, or the map is full.
    Ambiguous,
}

/// What became of an update.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct LandmarkUpdate {
    /// Sightings that corrected the estimate.
    pub matched: usize,
    /// Landmarks that were added.
    pub added: usize,
    /// Landmarks that were forgotten: not believed yet, and missed too often.
    pub removed: usize,
    /// Sightings that were left out.
    pub left_out: usize,
    /// Sum of the normalised squares of the innovations that were taken in, and their degrees of freedom.
    pub innovation_square: f64,
    /// See [`innovation_square`](Self::innovation_square).
    pub innovation_degrees: usize,
    /// Logarithm of the likelihood of the innovations that were taken in, but for its constant: to compare settings by.
    pub log_likelihood: f64,
}
