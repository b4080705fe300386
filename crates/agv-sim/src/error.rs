//! The crate's one error type.

/// Why a world, a sensor or a call was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value was refused.
    #[error(transparent)]
    Core(#[from] agv_core::Error),
    /// A path tracker refused a call.
    #[error(transparent)]
    Track(#[from] agv_core::roles::TrackError),
    /// A localizer refused a call.
    #[error(transparent)]
    Localization(#[from] agv_core::roles::LocalizationError),
    /// A polygon must be simple and enclose an area, and a segment must have a length.
    #[error("shape {index} is degenerate: {what}")]
    Degenerate {
        /// Place of the shape in the list that was given.
        index: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// Values must increase from each to the next.
    #[error("{name} must increase: entry {index} is {value}, not above the one before it")]
    NotIncreasing {
        /// What was given.
        name: &'static str,
        /// Place of the offending entry.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// Two sensors of one kind on one vehicle must have different numbers, or nobody can tell their readings apart.
    #[error("there is a {kind} with the number of {sensor} already")]
    SensorTaken {
        /// What kind of sensor it is.
        kind: &'static str,
        /// Its number.
        sensor: agv_core::sensors::SensorId,
    },
    /// The hall is too small for what should stand in it.
    #[error("{name} needs {needed} m, the hall leaves {available} m")]
    NoRoom {
        /// What does not fit.
        name: &'static str,
        /// Length needed, in metres.
        needed: f64,
        /// Length available, in metres.
        available: f64,
    },
}
