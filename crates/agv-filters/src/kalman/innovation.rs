//! What a reading said that the filter did not know, and what became of it.

use super::{
    Manifold, MeasurementModel,
    matrix::{self, Ldl},
};
use agv_core::{
    Error, check,
    roles::{SkipReason, UpdateOutcome, UpdateReport},
};
use nalgebra::{SMatrix, SVector};
use std::f64::consts::TAU;

/// The difference between a reading and what was expected of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation<const M: usize> {
    /// `ν`: the reading less the expected one, wrapped by its model.
    pub residual: SVector<f64, M>,
    /// `S = H P Hᵀ + R`: covariance that it should have.
    pub covariance: SMatrix<f64, M, M>,
    /// `νᵀ S⁻¹ ν`: normalised innovation squared, the squared Mahalanobis distance.
    pub nis: f64,
    /// Degrees of freedom of [`nis`](Self::nis): components that are not masked.
    pub degrees: usize,
}

impl<const M: usize> Innovation<M> {
    /// Logarithm of the reading's likelihood: by its density, `-½ (NIS + ln det S + k ln 2π)`, with `k` degrees of freedom.
    /// What hypotheses are weighed with. -∞ if `S` is singular.
    pub fn log_likelihood(&self) -> f64 {
        Ldl::new("innovation", &self.covariance).map_or(f64::NEG_INFINITY, |factor| {
            -0.5 * (self.nis + factor.log_determinant() + self.degrees as f64 * TAU.ln())
        })
    }
}

/// What became of a reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correction<const M: usize> {
    /// What the reading said that the filter did not know.
    pub innovation: Innovation<M>,
    /// Greatest normalised innovation squared that the gate lets through.
    pub limit: f64,
    /// Whether the belief has taken the reading in; it is as it was otherwise.
    pub accepted: bool,
}

impl<const M: usize> From<Correction<M>> for UpdateOutcome {
    /// A reading within the gate counts as explained.
    fn from(correction: Correction<M>) -> Self {
        let nis = correction.innovation.nis;
        if !correction.accepted {
            return Self::Skipped(SkipReason::Gated { nis, limit: correction.limit });
        }
        let mut report = UpdateReport::explaining(1.0);
        report.nis = Some(nis);
        Self::Applied(report)
    }
}

/// An innovation with what a correction needs beside it.
pub(super) struct Surprise<const N: usize, const M: usize> {
    pub(super) innovation: Innovation<M>,
    /// `P Hᵀ`.
    pub(super) cross: SMatrix<f64, N, M>,
    pub(super) jacobian: SMatrix<f64, M, N>,
    pub(super) noise: SMatrix<f64, M, M>,
    pub(super) factor: Ldl<M>,
}

impl<const N: usize, const M: usize> Surprise<N, M> {
    /// The reading against a Gaussian, by the model's Jacobian.
    #[inline(always)]
    #[expect(clippy::inline_always, reason = "the model's constants fold only here")]
    pub(super) fn new<X: Manifold<N>, H: MeasurementModel<X, N, M>>(
        state: &X,
        covariance: &SMatrix<f64, N, N>,
        model: &H,
        measured: &H::Value,
    ) -> Result<Self, Error> {
        let expected = model.linearize(state);
        let residual = model.residual(measured, &expected.value);
        Self::of(residual, expected.jacobian, expected.noise, covariance, model.degrees())
    }

    /// The same, linearised at `state ⊞ increment`; the covariance and the Jacobian are those of increments at `state`.
    pub(super) fn after<X: Manifold<N>, H: MeasurementModel<X, N, M>>(
        state: &X,
        increment: &SVector<f64, N>,
        covariance: &SMatrix<f64, N, N>,
        model: &H,
        measured: &H::Value,
    ) -> Result<Self, Error> {
        let expected = model.linearize(&state.boxplus(increment));
        let residual = model.residual(measured, &expected.value);
        let jacobian = match X::reset_jacobian(increment) {
            Some(reset) => expected.jacobian * reset,
            None => expected.jacobian,
        };
        Self::of(residual, jacobian, expected.noise, covariance, model.degrees())
    }

    #[inline(always)]
    #[expect(clippy::inline_always, reason = "as above")]
    fn of(
        residual: SVector<f64, M>,
        jacobian: SMatrix<f64, M, N>,
        noise: SMatrix<f64, M, M>,
        covariance: &SMatrix<f64, N, N>,
        degrees: usize,
    ) -> Result<Self, Error> {
        if !matrix::is_finite(&residual) {
            return Err(Error::NotFinite { name: "innovation", value: residual.sum() });
        }
        let cross = matrix::times_transposed(covariance, &jacobian);
        let spread = matrix::product_plus(&jacobian, &cross, &noise);
        let factor = Ldl::new("covariance of the innovation", &spread)?;
        // A residual that is finite may have a square that is not.
        let nis = check::finite("normalised innovation squared", factor.squared_norm(&residual))?;
        Ok(Self {
            innovation: Innovation { residual, covariance: spread, nis, degrees },
            cross,
            jacobian,
            noise,
            factor,
        })
    }
}
