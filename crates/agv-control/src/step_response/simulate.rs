//! A closed loop in time, of any controller and any plant.

use super::figures::{ErrorSums, finite_or_infinite};
use super::{StepFigures, StepMetrics, StepMetricsParams};
use crate::{Error, plant::Plant};
use agv_core::{
    check,
    roles::{ControlError, Controller},
};

/// A step response: what was measured and commanded at `t_k = k dt`.
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StepResponse {
    /// Set-point after the step.
    pub set_point: f64,
    /// Sampling time, in seconds.
    pub dt: f64,
    /// Outputs of the plant, `outputs[k]` at `k dt`; the first one is that before the step.
    pub outputs: Vec<f64>,
    /// Inputs, `inputs[k]` held from `k dt` to `(k + 1) dt`, before the actuator; one less than outputs.
    pub inputs: Vec<f64>,
    /// Whether the loop left the range of numbers; the response then ends before.
    pub diverged: bool,
}

impl StepResponse {
    /// Metrics of the response.
    ///
    /// # Errors
    /// As [`StepMetrics::new`].
    pub fn metrics(&self, params: StepMetricsParams) -> Result<StepMetrics, Error> {
        StepMetrics::new(&self.outputs, self.set_point, self.dt, params)
    }

    /// Sums of the response, as a [`StepTest`](super::StepTest) gives them (with the inputs before the actuator): the
    /// cost of a loop that no step test can run.
    pub fn figures(&self) -> StepFigures {
        if self.diverged {
            return StepFigures::DIVERGED;
        }
        let errors = || self.outputs.iter().skip(1).map(|y| self.set_point - y);
        let ErrorSums { iae, ise, itae, itse } = ErrorSums::of(errors(), self.dt);
        if finite_or_infinite(itae) == f64::INFINITY {
            return StepFigures::DIVERGED;
        }
        let beyond = errors().map(|e| if self.set_point < 0.0 { e } else { -e });
        let mut figures = StepFigures {
            iae,
            ise,
            itae,
            itse,
            overshoot: beyond.fold(0.0, f64::max),
            final_error: errors().next_back().map_or(0.0, f64::abs),
            ..StepFigures::default()
        };
        let mut last = 0.0;
        for u in &self.inputs {
            figures.control_energy += u * u * self.dt;
            figures.control_travel += (u - last).abs();
            last = *u;
        }
        figures
    }
}

/// Runs the step test of `controller` on `plant`: both start at rest, `response` takes `horizon / dt` samples after the
/// step and keeps its buffers. The loop may diverge, which is an outcome.
///
/// ```
/// use agv_control::pid::{Pid, PidParams};
/// use agv_control::plant::{LinearPlant, TransferFunction};
/// use agv_control::step_response::{StepMetricsParams, StepResponse, simulate_step};
///
/// let mut plant = LinearPlant::new(TransferFunction::new(&[1.0], &[1.0, 1.0])?)?.with_dead_time(0.1)?;
/// let mut pid = Pid::new(PidParams { proportional: 2.0, integral: 2.0, ..PidParams::default() })?;
/// let mut response = StepResponse::default();
/// simulate_step(&mut plant, &mut pid, 1.0, 0.01, 10.0, &mut response)?;
/// let metrics = response.metrics(StepMetricsParams::default())?;
/// assert!(metrics.overshoot < 0.05 && metrics.settling_time.is_some_and(|t| t < 2.5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A set-point that is not finite, a `dt` or horizon that is not positive, more than a million samples, or a `dt` that
/// the plant cannot be discretised for.
pub fn simulate_step(
    plant: &mut dyn Plant,
    controller: &mut dyn Controller,
    set_point: f64,
    dt: f64,
    horizon: f64,
    response: &mut StepResponse,
) -> Result<(), Error> {
    check::finite("set_point", set_point)?;
    check::positive("dt", dt)?;
    check::positive("horizon", horizon)?;
    let steps = check::in_range("horizon / dt", (horizon / dt).round(), 1.0, 1e6)? as usize;
    plant.reset();
    controller.reset();
    (response.set_point, response.dt, response.diverged) = (set_point, dt, false);
    response.outputs.clear();
    response.inputs.clear();
    response.outputs.push(plant.output());
    for _ in 0..steps {
        let input = match controller.update(set_point, plant.output(), dt) {
            Ok(input) => input,
            // Good arguments are refused only at the end of the number range.
            Err(ControlError::Invalid(agv_core::Error::NotFinite { .. })) => {
                response.diverged = true;
                break;
            }
            Err(ControlError::Invalid(error)) => return Err(error.into()),
            Err(_) => return Err(Error::Overflow { name: "controller" }),
        };
        let output = plant.step(input, dt)?;
        if !output.is_finite() {
            response.diverged = true;
            break;
        }
        response.inputs.push(input);
        response.outputs.push(output);
    }
    Ok(())
}
