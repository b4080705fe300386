//! The velocity form.

use super::PidParams;
use super::controller::refusal;
use super::timing::Timing;
use crate::plant::actuator::{at_least, at_most};
use agv_core::{
    Error, check,
    roles::{ControlError, Controller},
};

/// A PID controller in velocity form: it computes changes of the output,
///
/// ```text
/// Δu = Kp Δ(β r - y) + Ki (r - y) dt - Kd Δ(dy/dt) + Δf,      u = limited(u + Δu)
/// ```
///
/// with what is fed forward as `f`, and its memory is the output itself. It cannot wind up, and goes on without a bump from whatever output it is given
/// ([`follow`](Self::follow)) and under new gains; [`PidParams::anti_windup`] has no meaning to it. It needs integral
/// action, without which nothing ties the output to the set-point.
///
/// ```
/// use agv_control::pid::{PidParams, VelocityPid};
/// use agv_core::roles::Controller;
///
/// let params = PidParams { integral: 2.0, output_min: 0.0, output_max: 5.0, ..Default::default() };
/// let mut pid = VelocityPid::new(params)?;
/// pid.follow(3.0, 1.0, 1.0)?; // an operator held the valve at 3
/// assert_eq!(pid.update(1.0, 1.0, 0.1)?, 3.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(try_from = "State", into = "State"))]
pub struct VelocityPid {
    state: State,
    timing: Timing,
}

/// What a checkpoint holds.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct State {
    params: PidParams,
    output: f64,
    /// Filtered derivative of the measurement, per second.
    rate: f64,
    /// Last set-point and measurement; none after a reset.
    last: Option<(f64, f64)>,
    /// What was fed forward last.
    feed_forward: f64,
}

impl From<VelocityPid> for State {
    fn from(pid: VelocityPid) -> Self {
        pid.state
    }
}

impl TryFrom<State> for VelocityPid {
    type Error = Error;

    fn try_from(state: State) -> Result<Self, Error> {
        let (set_point, measurement) = state.last.unwrap_or_default();
        check::all_finite("PID state", &[state.rate, set_point, measurement, state.feed_forward])?;
        check::in_range("PID output", state.output, state.params.output_min, state.params.output_max)?;
        Ok(Self { state, ..Self::new(state.params)? })
    }
}

/// Equal controllers go on alike; what is kept of the last `dt` to save time does not count.
impl PartialEq for VelocityPid {
    fn eq(&self, other: &Self) -> bool {
        self.state == other.state
    }
}

impl VelocityPid {
    /// Checks the parameters once. The output starts at zero, or the limit next to it.
    ///
    /// # Errors
    /// As [`PidParams::validate`], and an integral gain of zero.
    pub fn new(params: PidParams) -> Result<Self, Error> {
        validate(&params)?;
        let output = 0.0_f64.clamp(params.output_min, params.output_max);
        Ok(Self { state: State { params, output, rate: 0.0, last: None, feed_forward: 0.0 }, timing: Timing::UNSET })
    }

    /// Gains and limits.
    pub const fn params(&self) -> &PidParams {
        &self.state.params
    }

    /// Takes new gains and limits; the output goes on from where it was, within the new limits.
    ///
    /// # Errors
    /// As [`new`](Self::new); the old ones are then kept.
    pub fn set_params(&mut self, params: PidParams) -> Result<(), Error> {
        validate(&params)?;
        (self.state.params, self.timing) = (params, Timing::UNSET);
        self.state.output = self.state.output.clamp(params.output_min, params.output_max);
        Ok(())
    }

    /// Follows an output that is given by hand and returns it within the limits; the next update goes on from there. The
    /// derivative starts anew.
    ///
    /// # Errors
    /// A value that is not finite; nothing is then changed.
    pub fn follow(&mut self, output: f64, set_point: f64, measurement: f64) -> Result<f64, ControlError> {
        check::finite("output", output)?;
        check::finite("set_point", set_point)?;
        check::finite("measurement", measurement)?;
        let output = output.clamp(self.state.params.output_min, self.state.params.output_max);
        self.state = State { output, rate: 0.0, last: Some((set_point, measurement)), ..self.state };
        Ok(output)
    }

    /// As [`update`](Controller::update), with the change of `feed_forward` since the last call added before the output is
    /// limited; after a reset all of it is a change.
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
        let (timing, state) = (&self.timing, &self.state);
        let params = &state.params;
        // The first call starts from rest: the whole proportional term is a change.
        let (last_set_point, last_measurement) = state.last.unwrap_or((0.0, measurement));
        let last_weighted = match state.last {
            Some(_) => params.set_point_weight * last_set_point - last_measurement,
            None => 0.0,
        };
        let rate = timing.rate(state.rate, measurement - last_measurement);
        let change = params.proportional * (params.set_point_weight * set_point - measurement - last_weighted)
            + timing.integral_step * (set_point - measurement)
            - params.derivative * (rate - state.rate)
            + (feed_forward - state.feed_forward);
        let wanted = state.output + change;
        if !wanted.is_finite() {
            return Err(refusal(set_point, measurement, feed_forward, wanted));
        }
        let mut output = wanted;
        if state.last.is_some() && timing.limits_rate {
            output = at_most(at_least(output, state.output - timing.output_step), state.output + timing.output_step);
        }
        output = at_most(at_least(output, params.output_min), params.output_max);
        self.state = State { output, rate, last: Some((set_point, measurement)), feed_forward, ..self.state };
        Ok(output)
    }

    #[cold]
    fn set_timing(&mut self, dt: f64) -> Result<(), Error> {
        self.timing = Timing::new(&self.state.params, dt)?;
        Ok(())
    }
}

fn validate(params: &PidParams) -> Result<(), Error> {
    params.validate()?;
    if params.integral == 0.0 { Err(Error::NotPositive { name: "integral", value: 0.0 }) } else { Ok(()) }
}

impl Controller for VelocityPid {
    #[inline]
    fn update(&mut self, set_point: f64, measurement: f64, dt: f64) -> Result<f64, ControlError> {
        self.update_with(set_point, measurement, 0.0, dt)
    }

    fn reset(&mut self) {
        let output = 0.0_f64.clamp(self.state.params.output_min, self.state.params.output_max);
        self.state = State { output, rate: 0.0, last: None, feed_forward: 0.0, ..self.state };
    }
}
