//! The cost of PID gains on a linear plant.

use super::kernel::{LANES, MAX_DELAY, Test, itae};
use crate::Error;
use crate::plant::LinearPlant;
use agv_core::check;

/// The three gains of a PID controller.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PidGains {
    /// Kp, output per error.
    pub proportional: f64,
    /// Ki, output per error and second.
    pub integral: f64,
    /// Kd, output per error rate (error per second).
    pub derivative: f64,
}

impl From<[f64; 3]> for PidGains {
    fn from([proportional, integral, derivative]: [f64; 3]) -> Self {
        Self { proportional, integral, derivative }
    }
}

impl From<PidGains> for [f64; 3] {
    fn from(gains: PidGains) -> Self {
        [gains.proportional, gains.integral, gains.derivative]
    }
}

/// How a step test is run.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StepTestParams {
    /// Set-point after the step, in the measurement's unit.
    pub set_point: f64,
    /// Sampling time of the controller, in seconds.
    pub dt: f64,
    /// Length of the test, in seconds.
    pub horizon: f64,
    /// Tf, time constant of the derivative's filter, in seconds; zero for none.
    pub filter_time: f64,
}

impl Default for StepTestParams {
    /// The test of the stand-in plant [`P1`](crate::plant::StandIn::P1).
    fn default() -> Self {
        Self { set_point: 1.0, dt: 0.01, horizon: 10.0, filter_time: 0.02 }
    }
}

/// The step test of a linear plant under a plain PID controller without anti-windup, and its cost
///
/// ```text
/// ITAE = Σ t_k |e_k| dt,      t_k = k dt,  k = 1 .. horizon / dt
/// ```
///
/// The loop starts at rest with its last error equal to the first one, so that the step does not kick the derivative,
/// which makes it the derivative of the measurement. Unstable loops are simulated to the end of the horizon; a cost
/// beyond all numbers, and that of gains that are not numbers, is infinite, never NaN.
///
/// ```
/// use agv_control::plant::StandIn;
///
/// let test = StandIn::P1.step_test()?;
/// let cost = test.cost([3.18, 3.4, 1.61].into());
/// assert!((cost - 1.03717).abs() < 1e-5);
/// # Ok::<(), agv_control::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct StepTest {
    params: StepTestParams,
    test: Test,
    plain: bool,
}

impl StepTest {
    /// The test of a plant, from rest, whatever its state.
    ///
    /// # Errors
    /// A parameter out of its range, a horizon of no sample or of more than a million, a dead time of more than a
    /// thousand, or a plant that cannot be discretised.
    pub fn new(plant: &LinearPlant, params: StepTestParams) -> Result<Self, Error> {
        let StepTestParams { set_point, dt, horizon, filter_time } = params;
        check::finite("set_point", set_point)?;
        check::positive("dt", dt)?;
        check::non_negative("filter_time", filter_time)?;
        check::positive("horizon", horizon)?;
        let steps = check::in_range("horizon / dt", (horizon / dt).round(), 1.0, 1e6)? as u32;
        let (discrete, actuator) = (plant.discretise(dt)?, *plant.actuator());
        check::in_range("dead_time / dt", discrete.delay as f64, 0.0, MAX_DELAY as f64)?;
        let plain = plant.dead_time() == 0.0 && discrete.d == 0.0 && actuator.rate == f64::MAX;
        Ok(Self { params, test: Test { plant: discrete, actuator, set_point, filter_time, steps }, plain })
    }

    /// How the test is run.
    pub const fn params(&self) -> &StepTestParams {
        &self.params
    }

    /// ITAE of one set of gains.
    pub fn cost(&self, gains: PidGains) -> f64 {
        let [kp, ki, kd] = gains.into();
        finish(self.run([[kp], [ki], [kd]]))[0]
    }

    /// ITAE of many sets of gains, eight at a time; the same bits as [`cost`](Self::cost) of each.
    ///
    /// # Errors
    /// Slices of different lengths.
    pub fn cost_batch(&self, gains: &[PidGains], costs: &mut [f64]) -> Result<(), Error> {
        check::length("costs", costs.len(), gains.len())?;
        for (gains, costs) in gains.chunks(LANES).zip(costs.chunks_mut(LANES)) {
            let mut lanes = [[0.0; LANES]; 3];
            for (l, gain) in gains.iter().enumerate() {
                let gain: [f64; 3] = (*gain).into();
                (0..3).for_each(|i| lanes[i][l] = gain[i]);
            }
            let all = finish(self.run(lanes));
            costs.copy_from_slice(&all[..costs.len()]);
        }
        Ok(())
    }

    fn run<const L: usize>(&self, gains: [[f64; L]; 3]) -> [f64; L] {
        let test = &self.test;
        macro_rules! order {
            ($($n:literal)*) => {
                match (self.test.plant.order, self.plain) {
                    $(($n, true) => itae::<$n, L, true>(test, &gains), ($n, false) => itae::<$n, L, false>(test, &gains),)*
                    _ => itae::<8, L, false>(test, &gains),
                }
            };
        }
        order!(1 2 3 4 5 6)
    }
}

/// Costs that are no numbers lose.
fn finish<const L: usize>(costs: [f64; L]) -> [f64; L] {
    costs.map(|cost| if cost.is_finite() { cost } else { f64::INFINITY })
}

#[cfg(test)]
mod tests {
    use crate::plant::StandIn;

    #[test]
    fn the_fixed_point_of_p1() {
        let cost = StandIn::P1.step_test().unwrap().cost([3.18, 3.4, 1.61].into());
        assert!((cost - 1.03717).abs() < 1e-5, "{cost}");
    }
}
