//! A measured vector with its covariance.

use crate::{Error, check};
use nalgebra::{SMatrix, SVector};

/// A vector with a covariance: rates, forces, positions, a range and a bearing. Poses have
/// [`UncertainPose`](super::UncertainPose).
///
/// ```
/// use agv_core::geometry::UncertainVector;
/// use agv_core::nalgebra::{Matrix2, Vector2};
///
/// let position = UncertainVector::new(Vector2::new(3.0, 1.0), Matrix2::new(0.04, 0.01, 0.01, 0.09))?;
/// // The same seen from a frame that is turned by a quarter.
/// let turned = position.transformed(&Matrix2::new(0.0, 1.0, -1.0, 0.0));
/// assert_eq!((turned.mean().x, turned.covariance()[(0, 0)]), (1.0, 0.09));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawVector<N>"))]
pub struct UncertainVector<const N: usize> {
    mean: SVector<f64, N>,
    covariance: SMatrix<f64, N, N>,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawVector<const N: usize> {
    mean: SVector<f64, N>,
    covariance: SMatrix<f64, N, N>,
}

#[cfg(feature = "serde")]
impl<const N: usize> TryFrom<RawVector<N>> for UncertainVector<N> {
    type Error = Error;

    fn try_from(raw: RawVector<N>) -> Result<Self, Error> {
        Self::new(raw.mean, raw.covariance)
    }
}

impl<const N: usize> UncertainVector<N> {
    /// A vector with its covariance, in the products of the entries' units.
    ///
    /// # Errors
    /// [`Error::NotFinite`]; [`Error::NotCovariance`] unless symmetric and positive semi-definite.
    pub fn new(mean: SVector<f64, N>, covariance: SMatrix<f64, N, N>) -> Result<Self, Error> {
        check::all_finite("vector", mean.iter())?;
        check::covariance("covariance", &covariance)?;
        Ok(Self { mean, covariance: (covariance + covariance.transpose()) * 0.5 })
    }

    /// A vector whose entries err independently, with these standard deviations.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for the vector, [`Error::Negative`] for a deviation.
    pub fn from_sigmas(mean: SVector<f64, N>, sigmas: &SVector<f64, N>) -> Result<Self, Error> {
        sigmas.iter().try_for_each(|&sigma| check::non_negative("sigma", sigma).map(|_| ()))?;
        Self::new(mean, SMatrix::from_diagonal(&sigmas.component_mul(sigmas)))
    }

    /// The vector.
    pub const fn mean(&self) -> &SVector<f64, N> {
        &self.mean
    }

    /// Its covariance.
    pub const fn covariance(&self) -> &SMatrix<f64, N, N> {
        &self.covariance
    }

    /// Another vector with the same covariance; the caller sees to it that it is finite.
    pub(crate) const fn with_mean(mut self, mean: SVector<f64, N>) -> Self {
        self.mean = mean;
        self
    }

    /// `A x`, with the covariance `A Σ Aᵀ`: another frame, another unit, or fewer entries. `A` must be finite.
    #[must_use]
    pub fn transformed<const M: usize>(&self, a: &SMatrix<f64, M, N>) -> UncertainVector<M> {
        let spread = a * self.covariance * a.transpose();
        UncertainVector { mean: a * self.mean, covariance: (spread + spread.transpose()) * 0.5 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    #[test]
    fn bad_vectors_are_refused() {
        let (zero, unit) = (Vector2::zeros(), Matrix2::identity());
        for bad in [f64::NAN, f64::INFINITY] {
            assert!(matches!(UncertainVector::new(Vector2::new(0.0, bad), unit), Err(Error::NotFinite { .. })));
            assert!(UncertainVector::new(zero, unit * bad).is_err());
            assert!(UncertainVector::from_sigmas(zero, &Vector2::new(bad, 0.0)).is_err());
            assert!(UncertainVector::from_sigmas(Vector2::new(bad, 0.0), &zero).is_err());
        }
        assert!(matches!(UncertainVector::new(zero, -unit), Err(Error::NotCovariance { .. })));
        assert!(UncertainVector::new(zero, Matrix2::new(1.0, 0.5, 0.2, 1.0)).is_err());
        assert!(UncertainVector::from_sigmas(zero, &Vector2::new(0.1, -0.1)).is_err());
        assert!(UncertainVector::from_sigmas(zero, &zero).is_ok(), "known exactly, or not stated");
    }
}
