//! How close a loop comes to instability: its greatest sensitivity.
//!
//! `Ms = max |1 / (1 + C(jω) G(jω))|` is the inverse of the least distance of the loop's Nyquist curve from -1 (Åström and
//! Murray, *Feedback Systems*, 2nd ed., section 12.5). Loops are usually designed for 1.2 to 2; 2 leaves a gain margin of
//! at least 2 and a phase margin of at least 29°.

use crate::plant::LinearPlant;
use crate::step_response::PidGains;
use agv_core::{Error, check};
use nalgebra::Complex;
use std::f64::consts::PI;

/// Frequencies that are looked at; between neighbours lie 9 %.
const FREQUENCIES: usize = 128;

/// Decades below the Nyquist frequency that are covered.
const DECADES: f64 = 5.0;

/// The frequency response of a plant, ready to be closed with any gains.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopSensitivity {
    filter_time: f64,
    /// `jω` and `G(jω)`, delays included.
    responses: Vec<(Complex<f64>, Complex<f64>)>,
}

impl LoopSensitivity {
    /// The plant, sampled every `dt` seconds, under a controller whose derivative is filtered over `filter_time` seconds.
    /// Sampling counts as a delay of half a period; limits of the actuator are left out, the loop is linear.
    ///
    /// # Errors
    /// A `dt` that is not positive, or a negative filter time.
    pub fn new(plant: &LinearPlant, filter_time: f64, dt: f64) -> Result<Self, Error> {
        check::positive("dt", dt)?;
        check::non_negative("filter_time", filter_time)?;
        let delay = plant.dead_time() + 0.5 * dt;
        let transfer = plant.transfer_function();
        let respond = |k: usize| {
            let omega = PI / dt * 10_f64.powf(-DECADES * (1.0 - k as f64 / (FREQUENCIES - 1) as f64));
            let s = Complex::new(0.0, omega);
            let value = |ascending: &[f64]| ascending.iter().rev().fold(Complex::new(0.0, 0.0), |sum, &c| sum * s + c);
            let late = Complex::new((omega * delay).cos(), -(omega * delay).sin());
            (s, value(transfer.numerator()) / value(transfer.denominator()) * late)
        };
        Ok(Self { filter_time, responses: (0..FREQUENCIES).map(respond).collect() })
    }

    /// `Ms` under the given gains. It says nothing of whether the loop is stable: a step test does.
    pub fn greatest(&self, gains: PidGains) -> f64 {
        let sensitivity = |&(s, plant): &(Complex<f64>, Complex<f64>)| {
            let controller = s.inv() * gains.integral + s * gains.derivative / (s * self.filter_time + 1.0);
            ((controller + gains.proportional) * plant + 1.0).norm_sqr().recip()
        };
        self.responses.iter().map(sensitivity).fold(0.0, f64::max).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::TransferFunction;

    fn sensitivity(numerator: &[f64], denominator: &[f64], gains: [f64; 3]) -> f64 {
        let plant = LinearPlant::new(TransferFunction::new(numerator, denominator).unwrap()).unwrap();
        LoopSensitivity::new(&plant, 0.0, 1e-3).unwrap().greatest(gains.into())
    }

    /// Under proportional gain k, `1 / (s + 1)²` has `|S|² = (1 + x)² / ((1 + k - x)² + 4 x)` with `x = ω²`; a dense search
    /// of the formula says how great it becomes.
    #[test]
    fn second_order_loops_have_the_sensitivity_of_their_formula() {
        for k in [0.5, 3.0, 20.0] {
            let formula = |x: f64| ((1.0 + x).powi(2) / ((1.0 + k - x).powi(2) + 4.0 * x)).sqrt();
            let expected = (1..200_000).map(|i| formula(f64::from(i) * 1e-3)).fold(0.0, f64::max);
            let found = sensitivity(&[1.0], &[1.0, 2.0, 1.0], [k, 0.0, 0.0]);
            assert!((found - expected).abs() < 0.02 * expected, "k {k}: {found} instead of {expected}");
        }
    }

    #[test]
    fn an_integrator_under_proportional_gain_is_never_near_the_edge() {
        let found = sensitivity(&[1.0], &[1.0, 0.0], [1.0, 0.0, 0.0]);
        assert!((1.0 - 1e-3..1.01).contains(&found), "{found}");
    }

    #[test]
    fn a_lag_under_integral_gain_is_as_sensitive_as_its_formula_with_its_gain() {
        // L = k / (s (s + 1)): |S|² = x (x + 1) / ((k - x)² + x).
        let formula = |x: f64| (x * (x + 1.0) / ((4.0 - x).powi(2) + x)).sqrt();
        let expected = (1..200_000).map(|i| formula(f64::from(i) * 1e-3)).fold(0.0, f64::max);
        let found = sensitivity(&[1.0], &[1.0, 1.0], [0.0, 4.0, 0.0]);
        assert!((found - expected).abs() < 0.02 * expected, "{found} instead of {expected}");
    }
}
