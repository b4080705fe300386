//! A discrete PID controller.
//!
//! Paper 000, Eq. 25 in its right form, `u = Kp e + Ki ∫e + Kd de/dt`, as industrial controllers write it (Åström and
//! Murray, *Feedback Systems*, 2nd ed., section 11.5):
//!
//! ```text
//! u = Kp (β r - y) + I - D,      I' = Ki (r - y) + (u_limited - u) / Tt,      D = Kd s / (1 + Tf s) y
//! ```
//!
//! The derivative acts on the measurement, so that a step of the set-point does not kick the actuator; the filter
//! `Tf` is discretised by backward differences, which is stable for every `dt`. The integral holds `Ki ∫e`, not `∫e`,
//! so that a change of `Ki` does not move the output.

use agv_core::{
    Error, check,
    roles::{ControlError, Controller},
};

/// How the integral is kept from growing while the output is limited.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum AntiWindup {
    /// The integral stands still while it would push the output farther beyond its limit.
    Clamping,
    /// The integral is drawn back by the excess over a tracking time, in seconds.
    BackCalculation {
        /// Tracking time `Tt`, in seconds; about the square root of integral time times derivative time.
        tracking_time: f64,
    },
}

/// Gains and limits of a [`Pid`]; the output's unit is the actuator's, the error's unit the measurement's.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PidParams {
    /// Kp, output per error.
    pub proportional: f64,
    /// Ki, output per error and second.
    pub integral: f64,
    /// Kd, output per error rate (error per second).
    pub derivative: f64,
    /// Tf, time constant of the derivative's filter, in seconds; zero for none.
    pub filter_time: f64,
    /// β, share of the set-point that the proportional term sees, 0 to 1; below 1 it overshoots less.
    pub set_point_weight: f64,
    /// Least output.
    pub output_min: f64,
    /// Greatest output.
    pub output_max: f64,
    /// Greatest change of the output per second.
    pub output_rate: f64,
    /// What keeps the integral in bounds.
    pub anti_windup: AntiWindup,
}

impl Default for PidParams {
    /// A proportional controller of gain one without limits: the start of every tuning. No limit is the greatest number
    /// rather than infinity, which texts cannot store.
    fn default() -> Self {
        Self {
            proportional: 1.0,
            integral: 0.0,
            derivative: 0.0,
            filter_time: 0.0,
            set_point_weight: 1.0,
            output_min: f64::MIN,
            output_max: f64::MAX,
            output_rate: f64::MAX,
            anti_windup: AntiWindup::Clamping,
        }
    }
}

/// A PID controller; the [`Controller`] role.
///
/// ```
/// use agv_control::pid::{Pid, PidParams};
/// use agv_core::roles::Controller;
///
/// // Heat a body that cools at 0.1 per second to 1.0, with at most 0.2 per second of heating.
/// let params = PidParams { proportional: 2.0, integral: 0.5, output_min: 0.0, output_max: 0.2, ..Default::default() };
/// let (mut pid, mut temperature) = (Pid::new(params)?, 0.0);
/// for _ in 0..1000 {
///     let heating = pid.update(1.0, temperature, 0.1)?;
///     temperature += (heating - 0.1 * temperature) * 0.1;
/// }
/// assert!((temperature - 1.0).abs() < 1e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "RawPid"))]
pub struct Pid {
    params: PidParams,
    /// `Ki ∫e`, in the output's unit.
    integral: f64,
    /// Filtered derivative of the measurement, per second.
    rate: f64,
    /// Last measurement and last output; none after a reset.
    last: Option<(f64, f64)>,
}

#[cfg(feature = "serde")]
#[derive(serde::Deserialize)]
struct RawPid {
    params: PidParams,
    integral: f64,
    rate: f64,
    last: Option<(f64, f64)>,
}

#[cfg(feature = "serde")]
impl TryFrom<RawPid> for Pid {
    type Error = Error;

    fn try_from(raw: RawPid) -> Result<Self, Error> {
        let (measurement, output) = raw.last.unwrap_or_default();
        check::all_finite("PID state", &[raw.integral, raw.rate, measurement, output])?;
        Ok(Self { integral: raw.integral, rate: raw.rate, last: raw.last, ..Self::new(raw.params)? })
    }
}

impl Pid {
    /// Checks the parameters once.
    ///
    /// # Errors
    /// The first gain that is not finite, a negative filter or rate, or limits in the wrong order.
    pub fn new(params: PidParams) -> Result<Self, Error> {
        check::finite("proportional", params.proportional)?;
        check::finite("integral", params.integral)?;
        check::finite("derivative", params.derivative)?;
        check::non_negative("filter_time", params.filter_time)?;
        check::in_range("set_point_weight", params.set_point_weight, 0.0, 1.0)?;
        check::finite("output_max", params.output_max)?;
        check::in_range("output_min", params.output_min, f64::MIN, params.output_max)?;
        check::positive("output_rate", params.output_rate)?;
        if let AntiWindup::BackCalculation { tracking_time } = params.anti_windup {
            check::positive("tracking_time", tracking_time)?;
        }
        Ok(Self { params, integral: 0.0, rate: 0.0, last: None })
    }

    /// Gains and limits.
    pub const fn params(&self) -> &PidParams {
        &self.params
    }

    /// The integral term `Ki ∫e`, in the output's unit.
    pub const fn integral(&self) -> f64 {
        self.integral
    }
}

impl Controller for Pid {
    fn update(&mut self, set_point: f64, measurement: f64, dt: f64) -> Result<f64, ControlError> {
        check::finite("set_point", set_point)?;
        check::finite("measurement", measurement)?;
        check::positive("dt", dt)?;
        let p = &self.params;
        let error = set_point - measurement;

        let rate = match self.last {
            // Backward difference of Tf d' + d = y', so that any dt is stable.
            Some((last, _)) => (p.filter_time * self.rate + (measurement - last)) / (p.filter_time + dt),
            None => 0.0,
        };
        let direct = p.proportional * (p.set_point_weight * set_point - measurement) - p.derivative * rate;
        let integral = self.integral + p.integral * error * dt;
        let wanted = direct + integral;
        // Values near the end of the number range, not a state that a later call could mend.
        check::finite("output", wanted)?;

        let mut output = wanted.clamp(p.output_min, p.output_max);
        if let Some((_, last)) = self.last {
            output = output.clamp(last - p.output_rate * dt, last + p.output_rate * dt);
        }
        let excess = output - wanted;
        self.integral = match p.anti_windup {
            AntiWindup::Clamping if excess != 0.0 && (integral - self.integral) * excess < 0.0 => self.integral,
            AntiWindup::Clamping => integral,
            // The correction of a whole tracking time at most: a longer dt would overshoot.
            AntiWindup::BackCalculation { tracking_time } => integral + excess * (dt / tracking_time).min(1.0),
        };
        self.rate = rate;
        self.last = Some((measurement, output));
        Ok(output)
    }

    fn reset(&mut self) {
        self.integral = 0.0;
        self.rate = 0.0;
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::roles::laws;
    use proptest::prelude::*;

    fn full() -> PidParams {
        PidParams { proportional: 2.0, integral: 1.0, derivative: 0.3, filter_time: 0.05, ..Default::default() }
    }

    #[test]
    fn obeys_the_laws_of_its_role() {
        laws::controller(&mut Pid::new(full()).unwrap()).unwrap();
        let limited = PidParams { output_min: -1.0, output_max: 0.5, output_rate: 3.0, ..full() };
        laws::controller(&mut Pid::new(limited).unwrap()).unwrap();
    }

    /// The closed loop of an integrator `y' = u` under PI has the poles of `s² + Kp s + Ki`: with Kp = 2 and Ki = 1 a
    /// double pole at -1, whose step response is known.
    #[test]
    fn matches_the_continuous_loop() {
        let dt = 1e-4;
        let params = PidParams { proportional: 2.0, integral: 1.0, ..Default::default() };
        let (mut pid, mut y) = (Pid::new(params).unwrap(), 0.0);
        for k in 0..50_000 {
            let t = f64::from(k) * dt;
            let expected = 1.0 - (1.0 - t) * (-t).exp();
            assert!((y - expected).abs() < 5e-4, "{t} s: {y} instead of {expected}");
            y += pid.update(1.0, y, dt).unwrap() * dt;
        }
    }

    #[test]
    fn a_step_of_the_set_point_does_not_kick_the_derivative() {
        let mut pid = Pid::new(PidParams { proportional: 0.0, derivative: 1.0, ..Default::default() }).unwrap();
        pid.update(0.0, 0.0, 0.01).unwrap();
        assert_eq!(pid.update(1.0, 0.0, 0.01).unwrap(), 0.0);
        assert!((pid.update(1.0, 0.02, 0.01).unwrap() + 2.0).abs() < 1e-12);
    }

    #[test]
    fn the_integral_does_not_wind_up() {
        for anti_windup in [AntiWindup::Clamping, AntiWindup::BackCalculation { tracking_time: 0.5 }] {
            let params = PidParams { output_min: -1.0, output_max: 1.0, anti_windup, ..full() };
            let mut pid = Pid::new(params).unwrap();
            for _ in 0..10_000 {
                assert_eq!(pid.update(10.0, 0.0, 0.01).unwrap(), 1.0);
            }
            // Released, the output leaves its limit within a second; wound up it would take a hundred.
            let back = (0..100).any(|_| pid.update(0.0, 0.5, 0.01).unwrap() < 0.0);
            assert!(back, "{anti_windup:?}");
        }
    }

    proptest! {
        #[test]
        fn output_respects_limit_and_rate(inputs in prop::collection::vec((-5.0..5.0_f64, -5.0..5.0_f64, 0.001..0.2_f64), 1..60)) {
            let params = PidParams { output_min: -1.5, output_max: 2.0, output_rate: 4.0, ..full() };
            let mut pid = Pid::new(params).unwrap();
            let mut last: Option<f64> = None;
            for (set_point, measurement, dt) in inputs {
                let output = pid.update(set_point, measurement, dt).unwrap();
                prop_assert!((-1.5..=2.0).contains(&output));
                if let Some(last) = last {
                    prop_assert!((output - last).abs() <= 4.0 * dt + 1e-12);
                }
                last = Some(output);
            }
        }
    }

    #[test]
    fn bad_parameters_are_named() {
        for (name, params) in [
            ("proportional", PidParams { proportional: f64::NAN, ..full() }),
            ("integral", PidParams { integral: f64::INFINITY, ..full() }),
            ("derivative", PidParams { derivative: f64::NAN, ..full() }),
            ("filter_time", PidParams { filter_time: -1.0, ..full() }),
            ("set_point_weight", PidParams { set_point_weight: 1.5, ..full() }),
            ("output_min", PidParams { output_min: 1.0, output_max: 0.0, ..full() }),
            ("output_max", PidParams { output_max: f64::NAN, ..full() }),
            ("output_rate", PidParams { output_rate: 0.0, ..full() }),
            ("output_rate", PidParams { output_rate: f64::INFINITY, ..full() }),
            ("tracking_time", PidParams { anti_windup: AntiWindup::BackCalculation { tracking_time: 0.0 }, ..full() }),
        ] {
            let error = Pid::new(params).unwrap_err();
            assert!(error.to_string().starts_with(name), "{name}: {error}");
        }
    }

    #[test]
    fn an_output_beyond_all_numbers_is_an_error_and_changes_nothing() {
        let mut pid = Pid::new(PidParams { proportional: f64::MAX, ..Default::default() }).unwrap();
        assert!(pid.update(1e10, 0.0, 0.1).is_err());
        assert_eq!(pid, Pid::new(*pid.params()).unwrap());
    }
}
