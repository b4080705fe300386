//! What a reading said that the filter did not know, and what became of it.

use super::{Manifold, MeasurementModel, matrix::Ldl};
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
    /// Logarithm of the reading's likelihood: by its density, `-½ (ν² + ln det S + M ln 2π)`. What hypotheses are weighed with.
    /// Components that are masked add a constant. -∞ if `S` is singular.
    pub fn log_likelihood(&self) -> f64 {
        Ldl::new("innovation", &self.covariance)
            .map_or(f64::NEG_INFINITY, |factor| -0.5 * (self.nis + factor.log_determinant() + M as f64 * TAU.ln()))
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
    #[inline]
    pub(super) fn new<X: Manifold<N>, H: MeasurementModel<X, N, M>>(
        state: &X,
        covariance: &SMatrix<f64, N, N>,
        model: &H,
        measured: &H::Value,
    ) -> Result<Self, Error> {
        let expected = model.linearize(state);
        let residual = model.residual(measured, &expected.value);
        let cross = super::matrix::times_transposed(covariance, &expected.jacobian);
        let spread = super::matrix::product_plus(&expected.jacobian, &cross, &expected.noise);
        Self::of(residual, spread, cross, expected.jacobian, expected.noise, model.degrees())
    }

    #[inline]
    fn of(
        residual: SVector<f64, M>,
        covariance: SMatrix<f64, M, M>,
        cross: SMatrix<f64, N, M>,
        jacobian: SMatrix<f64, M, N>,
        noise: SMatrix<f64, M, M>,
        degrees: usize,
    ) -> Result<Self, Error> {
        if !super::matrix::is_finite(&residual) {
            return Err(Error::NotFinite { name: "innovation", value: residual.sum() });
        }
        let factor = Ldl::new("covariance of the innovation", &covariance)?;
        // A residual that is finite may have a square that is not.
        let nis = check::finite("normalised innovation squared", factor.squared_norm(&residual))?;
        Ok(Self { innovation: Innovation { residual, covariance, nis, degrees }, cross, jacobian, noise, factor })
    }
}
