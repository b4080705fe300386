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
    geometry::{LieGroup, So2, Twist2},
    kinematics::stopping_speed,
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
    /// Time by which the path's curvature is read ahead, in seconds: the lag of the vehicle's turn rate.
    pub preview_time: f64,
    /// What all trackers share.
    pub follower: FollowerParams,
}

impl Default for PidTrackerParams {
    /// The heading loop four times as fast as the cross-track loop at 1 m/s, a preview of the heading loop's lag.
    fn default() -> Self {
        Self {
            proportional: 1.2,
            integral: 0.05,
            derivative: 0.0,
            filter_time: 0.05,
            max_approach: 0.7,
            heading_gain: 4.0,
            preview_time: 0.15,
            follower: FollowerParams::default(),
        }
    }
}

/// The steering law of [`PidTracker`].
#[derive(Debug, Clone, PartialEq)]
pub struct PidSteering {
    cross_track: Pid,
    heading_gain: f64,
    preview_time: f64,
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
        check::non_negative("preview_time", params.preview_time)?;
        let cross_track = Pid::new(PidParams {
            proportional: params.proportional,
            integral: params.integral,
            derivative: params.derivative,
            filter_time: params.filter_time,
            output_min: -params.max_approach,
            output_max: params.max_approach,
            ..PidParams::default()
        })?;
        let PidTrackerParams { heading_gain, preview_time, .. } = params;
        Self::with_steering(params.follower, PidSteering { cross_track, heading_gain, preview_time })
    }
}

impl Steering for PidSteering {
    fn twist(&mut self, input: &SteeringInput<'_>) -> Result<Twist2, TrackError> {
        let here = input.projection.arc_length;
        let ahead = here + input.speed * self.preview_time;
        let direction = input.course.direction_at(here).ok_or(TrackError::NoPath)?;
        let feed_forward = input.speed * input.course.curvature_at(ahead);
        let approach = match self.cross_track.update(0.0, input.projection.cross_track, input.dt) {
            Ok(approach) => approach,
            Err(ControlError::Invalid(error)) => return Err(error.into()),
            Err(_) => 0.0,
        };
        let wanted = direction.compose(&So2::from_angle(approach));
        let error = input.heading.inverse().compose(&wanted).angle();
        // A turn that the yaw acceleration cannot end in time would swing past the direction.
        let stoppable = stopping_speed(error.abs(), BRAKING_SHARE * input.limits.twist.yaw_acceleration, input.dt);
        let yaw_rate = feed_forward + (self.heading_gain * error).clamp(-stoppable, stoppable);
        Ok(Twist2::new(input.speed, 0.0, yaw_rate))
    }

    fn reset(&mut self) {
        self.cross_track.reset();
    }
}

/// Share of the yaw acceleration that ending a turn may take; the rest is there for the lag of the actuators.
const BRAKING_SHARE: f64 = 0.5;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_parameters_are_named() {
        let good = PidTrackerParams::default();
        for (name, params) in [
            ("max_approach", PidTrackerParams { max_approach: 2.0, ..good }),
            ("heading_gain", PidTrackerParams { heading_gain: 0.0, ..good }),
            ("preview_time", PidTrackerParams { preview_time: -0.1, ..good }),
            ("proportional", PidTrackerParams { proportional: f64::NAN, ..good }),
        ] {
            assert!(PidTracker::new(params).unwrap_err().to_string().starts_with(name), "{name}");
        }
    }
}
