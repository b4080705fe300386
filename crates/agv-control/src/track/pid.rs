//! Cross-track and heading errors in cascade (the PID path tracker of paper 000, section 3).
//!
//! A PID controller turns the cross-track error into an angle at which to approach the path, and a proportional one
//! turns the error of the heading into a turn rate:
//!
//! ```text
//! approach = clamp(PID(0 - cross_track), ± max_approach)        ω = k (direction + approach - heading) + feed-forward
//! ```
//!
//! Acting on the heading, the outer loop is the integrator `y' = v sin(approach)` whatever the vehicle does, so its
//! gains hold for every vehicle; they are per metre, so that the way back has the same shape at every speed.

use super::{
    follower::{Follower, FollowerParams},
    steering::{Steering, SteeringInput},
};
use crate::pid::{Pid, PidParams};
use agv_core::{
    Error, check,
    geometry::{Twist2, wrap_angle},
    roles::{ControlError, Controller, TrackError},
};

/// Parameters of [`PidTracker`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PidTrackerParams {
    /// Approach angle per cross-track error, in radians per metre.
    pub proportional: f64,
    /// Approach angle per integrated cross-track error, in radians per metre and second.
    pub integral: f64,
    /// Approach angle per rate of the cross-track error, in radians per metre per second.
    pub derivative: f64,
    /// Time constant of the derivative's filter, in seconds.
    pub filter_time: f64,
    /// Greatest approach angle, in radians.
    pub max_approach: f64,
    /// Turn rate per heading error, in 1/s.
    pub heading_gain: f64,
    /// What all trackers share.
    pub follower: FollowerParams,
}

impl Default for PidTrackerParams {
    /// The errors that the law sees follow its command without lag (see [`SteeringInput::predicted`]), so the loop is
    /// `s² + k s + k Kp v`, critically damped where `k = 4 Kp v`: here at 0.7 m/s; at 1 m/s the damping is 0.83, and in
    /// slow bends more. A heading gain of
    /// `1 / (2 τ)` keeps a damping of 0.7 even if a lag of `τ` = 0.15 s were there and not compensated. The integral is slow
    /// enough not to matter for that: it mends what slip leaves.
    fn default() -> Self {
        Self {
            proportional: 1.2,
            integral: 0.05,
            derivative: 0.0,
            filter_time: 0.05,
            max_approach: 0.7,
            heading_gain: 3.33,
            follower: FollowerParams::default(),
        }
    }
}

/// The steering law of [`PidTracker`].
#[derive(Debug, Clone, PartialEq)]
pub struct PidSteering {
    cross_track: Pid,
    heading_gain: f64,
}

/// The PID tracker.
pub type PidTracker = Follower<PidSteering>;

impl PidTracker {
    /// A tracker from its parameters.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: PidTrackerParams) -> Result<Self, Error> {
        check::in_range("max_approach", params.max_approach, 0.01, std::f64::consts::FRAC_PI_2)?;
        check::positive("heading_gain", params.heading_gain)?;
        let cross_track = Pid::new(PidParams {
            proportional: params.proportional,
            integral: params.integral,
            derivative: params.derivative,
            filter_time: params.filter_time,
            output_min: -params.max_approach,
            output_max: params.max_approach,
            ..PidParams::default()
        })?;
        let PidTrackerParams { heading_gain, .. } = params;
        Self::with_steering(params.follower, PidSteering { cross_track, heading_gain })
    }
}

impl Steering for PidSteering {
    fn twist(&mut self, input: &SteeringInput<'_>) -> Result<Twist2, TrackError> {
        let predicted = input.predicted()?;
        let approach = match self.cross_track.update(0.0, predicted.cross_track, input.dt) {
            Ok(approach) => approach,
            Err(ControlError::Invalid(error)) => return Err(error.into()),
            Err(_) => 0.0,
        };
        if let Some(facing) = input.facing {
            return input.sideways(facing, &predicted, approach);
        }
        let yaw_rate = input.speed * predicted.curvature
            + input.turn_rate(wrap_angle(approach - predicted.heading_error), self.heading_gain);
        Ok(Twist2::new(input.speed, 0.0, yaw_rate))
    }

    fn reset(&mut self) {
        self.cross_track.reset();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_parameters_are_named() {
        let good = PidTrackerParams::default();
        for (name, params) in [
            ("max_approach", PidTrackerParams { max_approach: 2.0, ..good }),
            ("heading_gain", PidTrackerParams { heading_gain: 0.0, ..good }),
            ("proportional", PidTrackerParams { proportional: f64::NAN, ..good }),
        ] {
            assert!(PidTracker::new(params).unwrap_err().to_string().starts_with(name), "{name}");
        }
    }
}
