//! Stanley: steer the front axle back to its track.
//!
//! Hoffmann, Tomlin, Montemerlo and Thrun, *Autonomous automobile trajectory tracking for off-road driving*, 2007: the front
//! wheels point along the path, and into it by the front axle's error `e` from its track, with damping of the yaw rate `r` and of
//! the steering angle,
//!
//! ```text
//! δ = δ_path - ψ - atan(k e / (k_soft + v)) - k_yaw (r - v κ) + k_steer (δ_last - δ)
//! ```
//!
//! so that the error dies away as `e' = -v sin(atan(k e / (k_soft + v)))`: like `exp(-k t)` near the path, where the vehicle is
//! fast, and from far away at a right angle. The heading follows at the rate `v / wheelbase`.
//!
//! Hoffmann's path is that of the front axle; ours, as every tracker's here, is that of the base. So the error is the distance
//! from where the front axle would be if the base kept its path, `e = y + wheelbase sin ψ`, and `δ_path = atan(wheelbase κ)`. A
//! vehicle that turns by its wheels' speeds has a front axle that is only thought, and so has one that reverses, ahead of its
//! leading end.

use super::{
    follower::{Follower, FollowerParams},
    steering::{Steering, SteeringInput},
};
use agv_core::{
    Error, check,
    geometry::{Twist2, wrap_angle},
    path::Gear,
    roles::TrackError,
};
use std::f64::consts::FRAC_PI_3;

/// Parameters of [`Stanley`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StanleyParams {
    /// k, how fast the front axle's error dies away, in 1/s.
    pub gain: f64,
    /// Speed that is added to the vehicle's, so that a slow one does not steer hard on noise; in metres per second.
    pub softening: f64,
    /// Steering per error of the yaw rate, in seconds.
    pub yaw_damping: f64,
    /// Steering per change of the steering since the last cycle.
    pub steering_damping: f64,
    /// Distance of the front axle ahead of the base, in metres, for vehicles that do not steer and for reversing: the heading is
    /// mended within this way.
    pub virtual_wheelbase: f64,
    /// What all trackers share.
    pub follower: FollowerParams,
}

impl Default for StanleyParams {
    /// The error of the front axle dies away as fast as the heading is mended at half a metre per second, the speed of bends, so
    /// that the two act as a critically damped pair there; both are well slower than the lag of 0.15 s, and so stable even if
    /// that is not compensated. No damping beyond: the prediction of the heading damps the yaw rate already.
    fn default() -> Self {
        Self {
            gain: 2.5,
            softening: 0.25,
            yaw_damping: 0.0,
            steering_damping: 0.0,
            virtual_wheelbase: 0.3,
            follower: FollowerParams::default(),
        }
    }
}

/// The steering law of [`Stanley`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StanleySteering {
    params: StanleyParams,
    /// The last steering angle; none at the beginning of a section.
    last: Option<f64>,
}

/// The Stanley tracker.
pub type Stanley = Follower<StanleySteering>;

impl Stanley {
    /// A tracker from its parameters.
    ///
    /// # Errors
    /// The first parameter that is out of its range.
    pub fn new(params: StanleyParams) -> Result<Self, Error> {
        check::positive("gain", params.gain)?;
        check::non_negative("softening", params.softening)?;
        check::non_negative("yaw_damping", params.yaw_damping)?;
        check::non_negative("steering_damping", params.steering_damping)?;
        check::positive("virtual_wheelbase", params.virtual_wheelbase)?;
        Self::with_steering(params.follower, StanleySteering { params, last: None })
    }
}

/// Greatest steering of an axle that is only thought, in radians.
const MAX_VIRTUAL_ANGLE: f64 = FRAC_PI_3;

impl Steering for StanleySteering {
    fn twist(&mut self, input: &SteeringInput<'_>) -> Result<Twist2, TrackError> {
        let p = &self.params;
        let predicted = input.predicted()?;
        // Without softening a vehicle that stands would have 0/0.
        let speed = (input.actual.vx.max(0.0) + p.softening).max(f64::MIN_POSITIVE);
        let approach = |error: f64| -(p.gain * error / speed).atan();
        if let Some(facing) = input.facing {
            return input.sideways(facing, &predicted, approach(predicted.cross_track));
        }
        let (wheelbase, most) = match (&input.limits.steering, input.gear) {
            (Some(steering), Gear::Forward) => (steering.wheelbase, steering.max_angle),
            _ => (p.virtual_wheelbase, MAX_VIRTUAL_ANGLE),
        };
        let front = predicted.cross_track + wheelbase * predicted.heading_error.sin();
        let turning = input.actual.yaw_rate - input.actual.vx * input.course.curvature_at(input.projection.arc_length);
        let along = (wheelbase * predicted.curvature).atan();
        let angle = along + wrap_angle(approach(front) - predicted.heading_error) - p.yaw_damping * turning;
        let angle = (angle + p.steering_damping * (self.last.unwrap_or(angle) - angle)).clamp(-most, most);
        self.last = Some(angle);
        Ok(Twist2::new(input.speed, 0.0, input.speed * angle.tan() / wheelbase))
    }

    fn reset(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_parameters_are_named() {
        let good = StanleyParams::default();
        for (name, params) in [
            ("gain", StanleyParams { gain: 0.0, ..good }),
            ("softening", StanleyParams { softening: -0.1, ..good }),
            ("yaw_damping", StanleyParams { yaw_damping: f64::NAN, ..good }),
            ("steering_damping", StanleyParams { steering_damping: f64::INFINITY, ..good }),
            ("virtual_wheelbase", StanleyParams { virtual_wheelbase: 0.0, ..good }),
        ] {
            assert!(Stanley::new(params).unwrap_err().to_string().starts_with(name), "{name}");
        }
    }
}
