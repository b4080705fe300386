//! Velocity and acceleration limits of a vehicle.

use crate::{Error, check, geometry::Twist2};

/// Limits on the twist of the base and on its change; magnitudes, all at least zero.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TwistLimits {
    /// Greatest forward speed, in metres per second.
    pub forward_speed: f64,
    /// Greatest reverse speed, in metres per second; zero forbids reversing.
    pub reverse_speed: f64,
    /// Greatest sideways speed, in metres per second; zero for all but omnidirectional vehicles.
    pub lateral_speed: f64,
    /// Greatest turn rate, in radians per second.
    pub yaw_rate: f64,
    /// Greatest increase of speed, in metres per second squared.
    pub acceleration: f64,
    /// Greatest decrease of speed, in metres per second squared.
    pub deceleration: f64,
    /// Greatest change of the turn rate, in radians per second squared.
    pub yaw_acceleration: f64,
}

impl Default for TwistLimits {
    /// An indoor AGV with a load: 1 m/s, 1 rad/s, half a metre per second squared (paper 001, section 4).
    fn default() -> Self {
        Self {
            forward_speed: 1.0,
            reverse_speed: 0.3,
            lateral_speed: 0.0,
            yaw_rate: 1.0,
            acceleration: 0.5,
            deceleration: 0.5,
            yaw_acceleration: 1.0,
        }
    }
}

impl TwistLimits {
    /// Checks all fields.
    ///
    /// # Errors
    /// [`Error::Negative`](crate::Error::Negative) or [`Error::NotPositive`](crate::Error::NotPositive) names the
    /// first field that is out of its range.
    pub fn validate(&self) -> Result<(), Error> {
        check::non_negative("forward_speed", self.forward_speed)?;
        check::non_negative("reverse_speed", self.reverse_speed)?;
        check::non_negative("lateral_speed", self.lateral_speed)?;
        check::non_negative("yaw_rate", self.yaw_rate)?;
        check::positive("acceleration", self.acceleration)?;
        check::positive("deceleration", self.deceleration)?;
        check::positive("yaw_acceleration", self.yaw_acceleration)?;
        Ok(())
    }

    /// Whether the twist keeps to the velocity limits, up to rounding.
    pub fn allows(&self, twist: &Twist2) -> bool {
        let slack = 1.0 + ROUNDING;
        twist.vx <= self.forward_speed * slack
            && -twist.vx <= self.reverse_speed * slack
            && twist.vy.abs() <= self.lateral_speed * slack
            && twist.yaw_rate.abs() <= self.yaw_rate * slack
    }

    /// Whether a vehicle can go from one twist to the other in `dt` seconds, up to rounding, and the new one is
    /// allowed. A twist that was beyond a limit before (the limit was lowered) may brake towards it.
    pub fn allows_step(&self, from: &Twist2, to: &Twist2, dt: f64) -> bool {
        let reachable = |from: f64, to: f64, limit: f64| {
            let braking = to.abs() < from.abs() && to * from >= 0.0;
            let change = if braking { self.deceleration } else { self.acceleration.max(self.deceleration) };
            let within = to.abs() <= limit * (1.0 + ROUNDING) || braking;
            within && (to - from).abs() <= change * dt * (1.0 + ROUNDING) + ROUNDING
        };
        let turned = (to.yaw_rate - from.yaw_rate).abs() <= self.yaw_acceleration * dt * (1.0 + ROUNDING) + ROUNDING;
        reachable(from.vx, to.vx, if to.vx < 0.0 { self.reverse_speed } else { self.forward_speed })
            && reachable(from.vy, to.vy, self.lateral_speed)
            && turned
            && (to.yaw_rate.abs() <= self.yaw_rate * (1.0 + ROUNDING) || to.yaw_rate.abs() < from.yaw_rate.abs())
    }
}

/// Relative slack of the checks above: clamping and checking round differently.
const ROUNDING: f64 = 1e-9;
