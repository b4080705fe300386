//! The positional form.

use super::timing::Timing;
use super::{AntiWindup, PidParams};
use crate::plant::actuator::{at_least, at_most};
use agv_core::{
    Error, check,
    roles::{ControlError, Controller},
};

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
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "State", into = "State"))]
pub struct Pid {
    params: PidParams,
    integral: f64,
    rate: f64,
    /// What depends on `dt` only.
    timing: Timing,
    last: Option<Call>,
}

/// What a checkpoint holds.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct State {
    params: PidParams,
    /// `Ki ∫e`, in the output's unit.
    integral: f64,
    /// Filtered derivative of the measurement, per second.
    rate: f64,
    /// Last call; none after a reset.
    last: Option<Call>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Call {
    set_point: f64,
    measurement: f64,
    output: f64,
}

impl From<Pid> for State {
    fn from(pid: Pid) -> Self {
        let Pid { integral, params, rate, last, .. } = pid;
        Self { params, integral, rate, last }
    }
}

impl TryFrom<State> for Pid {
    type Error = Error;

    fn try_from(state: State) -> Result<Self, Error> {
        check::all_finite("PID state", &[state.integral, state.rate])?;
        if let Some(Call { set_point, measurement, output }) = &state.last {
            check::all_finite("PID state", [set_point, measurement, output])?;
        }
        let State { params, integral, rate, last } = state;
        Ok(Self { integral, rate, last, ..Self::new(params)? })
    }
}

/// Equal controllers go on alike; what is kept of the last `dt` to save time does not count.
impl PartialEq for Pid {
    fn eq(&self, other: &Self) -> bool {
        let of = |pid: &Self| (pid.integral, pid.params, pid.rate, pid.last);
        of(self) == of(other)
    }
}

impl Pid {
    /// Checks the parameters once.
    ///
    /// # Errors
    /// As [`PidParams::validate`].
    pub fn new(params: PidParams) -> Result<Self, Error> {
        params.validate()?;
        Ok(Self { params, integral: 0.0, rate: 0.0, timing: Timing::UNSET, last: None })
    }

    /// Gains and limits.
    pub const fn params(&self) -> &PidParams {
        &self.params
    }

    /// The integral term `Ki ∫e`, in the output's unit.
    pub const fn integral(&self) -> f64 {
        self.integral
    }

    /// The filtered derivative of the measurement, per second.
    pub const fn rate(&self) -> f64 {
        self.rate
    }

    /// Takes new gains and limits without a bump: the integral takes over what the other terms lose, so that the output
    /// goes on from where it was. New gains without integral action forget the integral instead, since nothing would
    /// ever remove it.
    ///
    /// # Errors
    /// As [`PidParams::validate`]; the old ones are then kept.
    pub fn set_params(&mut self, params: PidParams) -> Result<(), Error> {
        params.validate()?;
        let integral = match self.last {
            _ if params.integral == 0.0 => 0.0,
            Some(last) => {
                let direct = |params: &PidParams| direct(params, last.set_point, last.measurement, self.rate);
                check::finite("integral", self.integral + (direct(&self.params) - direct(&params)))?
            }
            None => self.integral,
        };
        (self.params, self.integral, self.timing) = (params, integral, Timing::UNSET);
        Ok(())
    }

    /// Follows an output that is given by hand (or by another controller) and returns it within the limits. The integral
    /// is set so that [`update`](Controller::update) goes on from there without a bump; a controller without integral
    /// action cannot do that.
    ///
    /// # Errors
    /// A value that is not finite, or a `dt` that is not positive; nothing is then changed.
    pub fn follow(&mut self, output: f64, set_point: f64, measurement: f64, dt: f64) -> Result<f64, ControlError> {
        check::finite("output", output)?;
        check::finite("set_point", set_point)?;
        check::finite("measurement", measurement)?;
        self.set_timing(dt)?;
        let Self { params, rate, last, .. } = &*self;
        let rate = last.map_or(0.0, |last| self.timing.rate(*rate, measurement - last.measurement));
        let output = output.clamp(params.output_min, params.output_max);
        let integral = match params.integral {
            0.0 => 0.0,
            _ => check::finite("integral", output - direct(params, set_point, measurement, rate))?,
        };
        (self.integral, self.rate) = (integral, rate);
        self.last = Some(Call { set_point, measurement, output });
        Ok(output)
    }

    /// As [`update`](Controller::update), with `feed_forward` added to the output before it is limited.
    ///
    /// # Errors
    /// A value that is not finite, or a `dt` that is not positive; nothing is then changed.
    #[inline]
    pub fn update_with(
        &mut self,
        set_point: f64,
        measurement: f64,
        feed_forward: f64,
        dt: f64,
    ) -> Result<f64, ControlError> {
        if dt != self.timing.dt {
            self.set_timing(dt)?;
        }
        let Self { params, timing, .. } = &*self;
        // The first call changes nothing of a rate that is zero.
        let rate =
            timing.rate(self.rate, measurement - self.last.as_ref().map_or(measurement, |last| last.measurement));
        let growth = timing.integral_step * (set_point - measurement);
        let full = self.integral + growth;
        let wanted = full + (direct(params, set_point, measurement, rate) + feed_forward);

        let mut output = wanted;
        if let (Some(last), true) = (&self.last, timing.limits_rate) {
            output = at_most(at_least(output, last.output - timing.output_step), last.output + timing.output_step);
        }
        // The range comes last: it holds even where it was just narrowed.
        output = at_most(at_least(output, params.output_min), params.output_max);
        let excess = output - wanted;
        let integral = match params.anti_windup {
            AntiWindup::Clamping if growth * excess < 0.0 => self.integral,
            AntiWindup::Clamping | AntiWindup::Off => full,
            AntiWindup::BackCalculation { .. } => full + excess * timing.tracking_share,
        };
        // One test for all: whatever is not finite makes the output so, for zero times infinity is not a number.
        if !(wanted.is_finite() && integral.is_finite()) {
            return Err(refusal(set_point, measurement, feed_forward, wanted));
        }
        (self.integral, self.rate) = (integral, rate);
        self.last = Some(Call { set_point, measurement, output });
        Ok(output)
    }

    #[cold]
    fn set_timing(&mut self, dt: f64) -> Result<(), Error> {
        self.timing = Timing::new(&self.params, dt)?;
        Ok(())
    }
}

/// The terms without memory.
#[inline]
fn direct(params: &PidParams, set_point: f64, measurement: f64, rate: f64) -> f64 {
    params.proportional * (params.set_point_weight * set_point - measurement) - params.derivative * rate
}

/// Names the value that is not finite; none is if the output is near the end of the number range.
#[cold]
pub(super) fn refusal(set_point: f64, measurement: f64, feed_forward: f64, output: f64) -> ControlError {
    let inputs = [("set_point", set_point), ("measurement", measurement), ("feed_forward", feed_forward)];
    let (name, value) = inputs.into_iter().find(|(_, value)| !value.is_finite()).unwrap_or(("output", output));
    Error::NotFinite { name, value }.into()
}

impl Controller for Pid {
    #[inline]
    fn update(&mut self, set_point: f64, measurement: f64, dt: f64) -> Result<f64, ControlError> {
        self.update_with(set_point, measurement, 0.0, dt)
    }

    fn reset(&mut self) {
        (self.integral, self.rate, self.last) = (0.0, 0.0, None);
    }
}
