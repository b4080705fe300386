//! The crate's one error type: which value, and why.

/// Why a value was refused. Every variant carries the name and the number that a user needs to mend the call.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value must be neither NaN nor infinite.
    #[error("{name} must be finite, got {value}")]
    NotFinite {
        /// What was given.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// A value must be finite and greater than zero.
    #[error("{name} must be finite and positive, got {value}")]
    NotPositive {
        /// What was given.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// A value must be finite and at least zero.
    #[error("{name} must be finite and not negative, got {value}")]
    Negative {
        /// What was given.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// A value must lie in a closed interval.
    #[error("{name} must lie in [{min}, {max}], got {value}")]
    OutOfRange {
        /// What was given.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Least value allowed.
        min: f64,
        /// Greatest value allowed.
        max: f64,
    },
    /// A collection must not be empty.
    #[error("{name} must not be empty")]
    Empty {
        /// What was given.
        name: &'static str,
    },
    /// A collection is shorter than the operation needs.
    #[error("{name} needs at least {min} entries, got {len}")]
    TooFew {
        /// What was given.
        name: &'static str,
        /// Its length.
        len: usize,
        /// Least length allowed.
        min: usize,
    },
    /// A collection is longer than the implementation holds.
    #[error("{name} has {len} entries, at most {max} are allowed")]
    TooMany {
        /// What was given.
        name: &'static str,
        /// Its length.
        len: usize,
        /// Greatest length allowed.
        max: usize,
    },
    /// Two collections that belong together differ in length.
    #[error("{name} has {len} entries, expected {expected}")]
    LengthMismatch {
        /// What was given.
        name: &'static str,
        /// Its length.
        len: usize,
        /// The length it must have.
        expected: usize,
    },
    /// A covariance must be symmetric and positive (semi-)definite.
    #[error("{name} is not a covariance: symmetric and positive definite is needed, least pivot {pivot}")]
    NotCovariance {
        /// What was given.
        name: &'static str,
        /// Least pivot found, or the asymmetry if there was one.
        pivot: f64,
    },
    /// A linear system has no unique solution.
    #[error("{name} is singular: pivot {pivot} in row {row}")]
    Singular {
        /// Which system.
        name: &'static str,
        /// Row of the offending pivot.
        row: usize,
        /// Its value.
        pivot: f64,
    },
    /// Time ran backwards.
    #[error("time runs backwards: {later_ns} ns came after {earlier_ns} ns")]
    TimeBackwards {
        /// The stamp that was known, in nanoseconds.
        earlier_ns: i64,
        /// The stamp that followed it, in nanoseconds.
        later_ns: i64,
    },
    /// A point lies outside a grid.
    #[error("({x}, {y}) lies outside the grid")]
    OutsideGrid {
        /// Coordinate along x, in metres.
        x: f64,
        /// Coordinate along y, in metres.
        y: f64,
    },
    /// Two grids that are to be combined have different layouts.
    #[error("grids differ in {name}: {left} and {right}")]
    LayoutMismatch {
        /// What differs.
        name: &'static str,
        /// Its value in the first grid.
        left: f64,
        /// Its value in the second grid.
        right: f64,
    },
}
