//! Sums over a step test.

use super::kernel::Sums;

/// What a step test sums up as it runs. With `e` the error and `u` the input of the plant (after its actuator), sums run
/// over the samples `t_k = k dt` after the step.
///
/// A loop whose ITAE exceeds 1e100 has diverged, and so has one of gains that are no numbers: all its figures are
/// infinite, never NaN, so that it loses every comparison.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StepFigures {
    /// `Σ |e| dt`.
    pub iae: f64,
    /// `Σ e² dt`.
    pub ise: f64,
    /// `Σ t |e| dt`.
    pub itae: f64,
    /// `Σ t e² dt`.
    pub itse: f64,
    /// Greatest excess over the set-point, in the measurement's unit; zero if there was none.
    pub overshoot: f64,
    /// `|e|` at the last sample.
    pub final_error: f64,
    /// `Σ u² dt`.
    pub control_energy: f64,
    /// `Σ |u_k - u_{k-1}|`, from an input of zero: what the actuator wears by.
    pub control_travel: f64,
}

impl StepFigures {
    /// Of a loop that diverged.
    pub const DIVERGED: Self = Self {
        iae: f64::INFINITY,
        ise: f64::INFINITY,
        itae: f64::INFINITY,
        itse: f64::INFINITY,
        overshoot: f64::INFINITY,
        final_error: f64::INFINITY,
        control_energy: f64::INFINITY,
        control_travel: f64::INFINITY,
    };
}

impl From<Sums<f64>> for StepFigures {
    fn from(sums: Sums<f64>) -> Self {
        if finite_or_infinite(sums.itae) == f64::INFINITY {
            return Self::DIVERGED;
        }
        Self {
            iae: sums.iae,
            ise: sums.ise,
            itae: sums.itae,
            itse: sums.itse,
            overshoot: sums.overshoot,
            final_error: sums.last_error,
            control_energy: sums.energy,
            control_travel: sums.travel,
        }
    }
}

/// Sums of the errors `e_k` at `t_k = k dt`, `k` from one on.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct ErrorSums {
    pub(super) iae: f64,
    pub(super) ise: f64,
    pub(super) itae: f64,
    pub(super) itse: f64,
}

impl ErrorSums {
    pub(super) fn of(errors: impl Iterator<Item = f64>, dt: f64) -> Self {
        let mut sums = Self::default();
        for (k, e) in errors.enumerate() {
            let t = (k as f64 + 1.0) * dt;
            sums.iae += e.abs() * dt;
            sums.ise += e * e * dt;
            sums.itae += t * e.abs() * dt;
            sums.itse += t * e * e * dt;
        }
        sums
    }
}

/// The cost, or infinity if the loop diverged. Below the bound no intermediate value is near the end of the numbers, so
/// that lanes and single runs agree.
pub(super) fn finite_or_infinite(cost: f64) -> f64 {
    if cost <= DIVERGED { cost } else { f64::INFINITY }
}

/// Cost, and magnitude of a gain, beyond which a loop counts as diverged.
pub(super) const DIVERGED: f64 = 1e100;
