//! A measured distance with its uncertainty.

/// A range with its standard deviation, both in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct RangeReading {
    /// Distance along the beam.
    pub range: f64,
    /// One standard deviation of [`range`](Self::range).
    pub sigma: f64,
}
