//! Gains and limits of a PID controller.

use agv_core::{Error, check};

/// How the integral is kept from growing while the output is limited.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum AntiWindup {
    /// The integral grows as it likes: for outputs without limits, and to compare with.
    Off,
    /// The integral stands still while it would push the output farther beyond its limit.
    Clamping,
    /// The integral is drawn back by the excess over a tracking time, in seconds.
    BackCalculation {
        /// Tracking time `Tt`, in seconds; about the square root of integral time times derivative time.
        tracking_time: f64,
    },
}

/// Gains and limits of a [`Pid`](super::Pid); the output's unit is the actuator's, the error's unit the measurement's.
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

impl PidParams {
    /// Checks that a controller can be built.
    ///
    /// # Errors
    /// The first gain that is not finite, a negative filter or rate, or limits in the wrong order.
    pub fn validate(&self) -> Result<(), Error> {
        check::finite("proportional", self.proportional)?;
        check::finite("integral", self.integral)?;
        check::finite("derivative", self.derivative)?;
        check::non_negative("filter_time", self.filter_time)?;
        check::in_range("set_point_weight", self.set_point_weight, 0.0, 1.0)?;
        check::finite("output_max", self.output_max)?;
        check::in_range("output_min", self.output_min, f64::MIN, self.output_max)?;
        check::positive("output_rate", self.output_rate)?;
        if let AntiWindup::BackCalculation { tracking_time } = self.anti_windup {
            check::positive("tracking_time", tracking_time)?;
        }
        Ok(())
    }
}
