//! Validation, written once: each function returns the value it accepted, or an [`Error`] that names the value.
//!
//! ```
//! use agv_core::{Error, check};
//!
//! assert_eq!(check::positive("resolution", 0.05), Ok(0.05));
//! assert_eq!(check::positive("resolution", 0.0), Err(Error::NotPositive { name: "resolution", value: 0.0 }));
//! ```

use crate::Error;
use nalgebra::SMatrix;

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

/// Accepts a symmetric, positive semi-definite matrix: a covariance, whose entries may differ in unit. Zero variances
/// are fine, they mean known exactly.
///
/// # Errors
/// [`Error::NotFinite`], or [`Error::NotCovariance`] with the asymmetry or the negative pivot.
pub fn covariance<const N: usize>(name: &'static str, matrix: &SMatrix<f64, N, N>) -> Result<(), Error> {
    least_pivot(name, matrix, -ROUNDING)
}

/// Accepts a symmetric, positive definite matrix: a covariance that can be inverted, or an information matrix.
///
/// # Errors
/// [`Error::NotFinite`], or [`Error::NotCovariance`] with the asymmetry or the least pivot.
pub fn positive_definite<const N: usize>(name: &'static str, matrix: &SMatrix<f64, N, N>) -> Result<(), Error> {
    least_pivot(name, matrix, f64::EPSILON)
}

/// Rounding that a covariance may carry, relative to its diagonal.
const ROUNDING: f64 = 1e-10;

/// `L D Lᵀ` in place, without pivoting; entries of `D` below `limit` times the diagonal are refused. Relative to the
/// diagonal, so that metres and radians do not mix.
fn least_pivot<const N: usize>(name: &'static str, matrix: &SMatrix<f64, N, N>, limit: f64) -> Result<(), Error> {
    all_finite(name, matrix.iter())?;
    let mut rest = *matrix;
    for j in 0..N {
        let (scale, pivot) = (matrix[(j, j)], rest[(j, j)]);
        if scale < 0.0 || pivot < limit * scale || (limit > 0.0 && pivot <= 0.0) {
            return Err(Error::NotCovariance { name, pivot });
        }
        // A pivot that is only rounding leaves nothing to eliminate, but its column must then vanish as well.
        let noise = ROUNDING * scale;
        for i in j + 1..N {
            let (size, rest_size) = ((scale * matrix[(i, i)].abs()).sqrt(), noise.max(pivot) * rest[(i, i)].abs());
            let asymmetry = (matrix[(i, j)] - matrix[(j, i)]).abs();
            if asymmetry > 1e-9 * size {
                return Err(Error::NotCovariance { name, pivot: asymmetry });
            }
            if rest[(i, j)].abs() > rest_size.sqrt() * (1.0 + ROUNDING) + ROUNDING * size {
                let determinant = pivot * rest[(i, i)] - rest[(i, j)] * rest[(i, j)];
                return Err(Error::NotCovariance { name, pivot: determinant / scale.max(f64::MIN_POSITIVE) });
            }
        }
        if pivot > noise {
            for i in j + 1..N {
                let factor = rest[(i, j)] / pivot;
                for k in j + 1..=i {
                    rest[(i, k)] -= factor * rest[(k, j)];
                }
            }
        }
    }
    Ok(())
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
    fn covariances_may_be_singular_but_not_indefinite() {
        let mixed = nalgebra::Matrix3::new(4.0, 2e-6, 0.0, 2e-6, 1e-12, 0.0, 0.0, 0.0, 0.0);
        assert_eq!(covariance("c", &mixed), Ok(()), "rank one, units far apart, and a zero variance");
        assert!(positive_definite("c", &mixed).is_err());
        assert_eq!(positive_definite("c", &nalgebra::Matrix3::from_diagonal_element(1e-12)), Ok(()));
        for bad in [
            [1.0, 0.5, 0.4, 1.0],  // not symmetric
            [1.0, 2.0, 2.0, 1.0],  // correlation beyond one
            [1.0, 0.0, 0.0, -1.0], // negative variance
            [0.0, 0.1, 0.1, 1.0],  // correlated with a constant
            [1.0, 1.0 + 1e-6, 1.0 + 1e-6, 1.0],
        ] {
            let matrix = nalgebra::Matrix2::from_column_slice(&bad);
            assert!(matches!(covariance("c", &matrix), Err(Error::NotCovariance { .. })), "{bad:?}");
            assert!(matches!(positive_definite("c", &matrix), Err(Error::NotCovariance { .. })), "{bad:?}");
        }
        let nan = nalgebra::Matrix2::from_element(f64::NAN);
        assert!(matches!(covariance("c", &nan), Err(Error::NotFinite { .. })));
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
