//! Validation, written once: each function returns the value it accepted, or an [`Error`] that names the value.
//!
//! ```
//! use agv_core::{Error, check};
//!
//! assert_eq!(check::positive("resolution", 0.05), Ok(0.05));
//! assert_eq!(check::positive("resolution", 0.0), Err(Error::NotPositive { name: "resolution", value: 0.0 }));
//! ```

use crate::Error;

/// Accepts a finite value.
///
/// # Errors
/// [`Error::NotFinite`].
pub fn finite(name: &'static str, value: f64) -> Result<f64, Error> {
    if value.is_finite() { Ok(value) } else { Err(Error::NotFinite { name, value }) }
}

/// Accepts values that are all finite.
///
/// # Errors
/// [`Error::NotFinite`] with the first value that is not.
pub fn all_finite<'a>(name: &'static str, values: impl IntoIterator<Item = &'a f64>) -> Result<(), Error> {
    values.into_iter().try_for_each(|&value| finite(name, value).map(|_| ()))
}

/// Accepts a finite value above zero.
///
/// # Errors
/// [`Error::NotPositive`].
pub fn positive(name: &'static str, value: f64) -> Result<f64, Error> {
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err(Error::NotPositive { name, value }) }
}

/// Accepts a finite value of at least zero.
///
/// # Errors
/// [`Error::Negative`].
pub fn non_negative(name: &'static str, value: f64) -> Result<f64, Error> {
    if value.is_finite() && value >= 0.0 { Ok(value) } else { Err(Error::Negative { name, value }) }
}

/// Accepts a value in the closed interval `[min, max]`.
///
/// # Errors
/// [`Error::OutOfRange`].
pub fn in_range(name: &'static str, value: f64, min: f64, max: f64) -> Result<f64, Error> {
    if value >= min && value <= max { Ok(value) } else { Err(Error::OutOfRange { name, value, min, max }) }
}

/// Accepts a probability strictly between 0 and 1, as log-odds need it.
///
/// # Errors
/// [`Error::OutOfRange`].
pub fn open_probability(name: &'static str, value: f64) -> Result<f64, Error> {
    if value > 0.0 && value < 1.0 { Ok(value) } else { Err(Error::OutOfRange { name, value, min: 0.0, max: 1.0 }) }
}

/// Accepts a collection of at least `min` entries.
///
/// # Errors
/// [`Error::TooFew`].
pub fn at_least(name: &'static str, len: usize, min: usize) -> Result<usize, Error> {
    if len >= min { Ok(len) } else { Err(Error::TooFew { name, len, min }) }
}

/// Accepts a collection of exactly `expected` entries.
///
/// # Errors
/// [`Error::LengthMismatch`].
pub fn length(name: &'static str, len: usize, expected: usize) -> Result<usize, Error> {
    if len == expected { Ok(len) } else { Err(Error::LengthMismatch { name, len, expected }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_check_refuses_what_is_not_a_number() {
        let nan = f64::NAN;
        assert!(finite("v", nan).is_err());
        assert!(all_finite("v", &[0.0, nan]).is_err());
        assert!(positive("v", nan).is_err());
        assert!(non_negative("v", nan).is_err());
        assert!(in_range("v", nan, 0.0, 1.0).is_err());
        assert!(open_probability("v", nan).is_err());
        assert!(positive("v", f64::INFINITY).is_err());
        assert!(non_negative("v", f64::INFINITY).is_err());
    }

    #[test]
    fn limits_are_inclusive_or_not_as_documented() {
        assert_eq!(non_negative("v", 0.0), Ok(0.0));
        assert!(positive("v", 0.0).is_err());
        assert_eq!(in_range("v", 1.0, 0.0, 1.0), Ok(1.0));
        assert!(open_probability("v", 1.0).is_err());
        assert_eq!(at_least("v", 2, 2), Ok(2));
        assert_eq!(length("v", 2, 3), Err(Error::LengthMismatch { name: "v", len: 2, expected: 3 }));
    }
}
