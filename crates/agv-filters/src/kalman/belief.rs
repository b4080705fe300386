//! What a Kalman filter knows.

use super::{Manifold, matrix};
use agv_core::{
    Error, check,
    geometry::{Se2, UncertainPose},
};
use nalgebra::SMatrix;

/// A Gaussian over a state: its mean and the covariance of the increment `δ` in `mean ⊞ δ`.
///
/// The covariance is symmetric and positive semi-definite: zero variances are fine, they mean known exactly.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(
        try_from = "RawBelief<X, N>",
        bound(serialize = "X: serde::Serialize", deserialize = "X: Manifold<N> + serde::Deserialize<'de>")
    )
)]
pub struct GaussianBelief<X, const N: usize> {
    pub(super) state: X,
    pub(super) covariance: SMatrix<f64, N, N>,
}

/// A belief as it is stored, before it is checked.
#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawBelief<X, const N: usize> {
    state: X,
    covariance: SMatrix<f64, N, N>,
}

#[cfg(feature = "serde")]
impl<X: Manifold<N>, const N: usize> TryFrom<RawBelief<X, N>> for GaussianBelief<X, N> {
    type Error = Error;

    fn try_from(raw: RawBelief<X, N>) -> Result<Self, Error> {
        Self::new(raw.state, raw.covariance)
    }
}

impl<X: Manifold<N>, const N: usize> GaussianBelief<X, N> {
    /// A belief around a state.
    ///
    /// # Errors
    /// [`Error::NotFinite`]; [`Error::NotCovariance`] unless symmetric and positive semi-definite.
    pub fn new(state: X, covariance: SMatrix<f64, N, N>) -> Result<Self, Error> {
        finite_state("state", &state)?;
        check::covariance("covariance", &covariance)?;
        Ok(Self { state, covariance: (covariance + covariance.transpose()) * 0.5 })
    }

    /// Best estimate.
    #[inline]
    pub const fn state(&self) -> &X {
        &self.state
    }

    /// Covariance of the increment from the best estimate to the truth, in the products of the components' units.
    #[inline]
    pub const fn covariance(&self) -> &SMatrix<f64, N, N> {
        &self.covariance
    }

    /// Standard deviation of a component of the increment; NaN if there is none of that index.
    pub fn sigma(&self, index: usize) -> f64 {
        self.covariance.get((index, index)).map_or(f64::NAN, |variance| variance.sqrt())
    }

    /// Normalised estimation error squared `eᵀ P⁻¹ e`, `e = truth ⊟ state`: chi-square with `N` degrees of freedom if the
    /// belief is consistent (Bar-Shalom, Li and Kirubarajan 2001, section 5.4).
    ///
    /// # Errors
    /// [`Error::NotFinite`] for the truth; [`Error::NotCovariance`] if the covariance has no inverse.
    pub fn nees(&self, truth: &X) -> Result<f64, Error> {
        finite_state("truth", truth)?;
        Ok(matrix::Ldl::new("covariance", &self.covariance)?.squared_norm(&truth.boxminus(&self.state)))
    }

    /// The belief after a step of a filter, if its numbers can be one.
    #[inline]
    pub(super) fn stepped(state: X, covariance: SMatrix<f64, N, N>) -> Result<Self, Error> {
        finite_state("state", &state)?;
        if !matrix::is_finite(&covariance) {
            return Err(Error::NotFinite { name: "covariance", value: f64::NAN });
        }
        for i in 0..N {
            if covariance[(i, i)] < 0.0 {
                return Err(Error::NotCovariance { name: "covariance", pivot: covariance[(i, i)] });
            }
        }
        Ok(Self { state, covariance })
    }
}

impl TryFrom<GaussianBelief<Se2, 3>> for UncertainPose<Se2> {
    type Error = Error;

    fn try_from(belief: GaussianBelief<Se2, 3>) -> Result<Self, Error> {
        Self::new(belief.state, belief.covariance)
    }
}

/// Accepts a state whose numbers are finite.
#[inline]
pub(super) fn finite_state<X: Manifold<N>, const N: usize>(name: &'static str, state: &X) -> Result<(), Error> {
    if state.is_finite() { Ok(()) } else { Err(Error::NotFinite { name, value: f64::NAN }) }
}
