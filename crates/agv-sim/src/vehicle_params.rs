//! What a vehicle is like: its drive, how its wheels lag, and how the floor lets it down.

use crate::{Drive, Error, OdometryErrors, WheelStates};
use agv_core::{check, kinematics::TwistLimits};

/// Speed below which a wheel that is told to stand does so, in radians per second: a lag alone never would.
const STANDING: f64 = 1e-3;

/// How the floor lets a vehicle down, as fractions of what the wheels do.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct SlipParams {
    /// Share of the speed that the wheels spin away: 0.02 drives 2 % less than they turn.
    pub longitudinal: f64,
    /// Share of the turn rate that is lost in scrubbing.
    pub yaw: f64,
    /// Sideways drift outwards in bends: metres per second of drift for each m/s² of centripetal acceleration.
    pub lateral: f64,
    /// Standard deviation of the turn rate's disturbance by the floor, in radians per √second.
    pub yaw_disturbance: f64,
}

/// What a vehicle is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VehicleParams {
    /// How its wheels move it.
    pub drive: Drive,
    /// What the vehicle's controller lets through, in m/s, rad/s and their rates.
    pub limits: TwistLimits,
    /// Time constant of the wheels' speed controllers, in seconds; zero follows at once.
    pub time_constant: f64,
    /// Time constant of the steering, in seconds; zero follows at once, within its rate.
    pub steering_time_constant: f64,
    /// Greatest rate of a steering angle, in radians per second.
    pub steering_rate: f64,
    /// What the floor does.
    pub slip: SlipParams,
    /// What the odometry gets wrong.
    pub odometry: OdometryErrors,
}

impl VehicleParams {
    /// A vehicle of this kind with the default limits, wheels that settle in about a third of a second, a steering as
    /// fast as that and turned by 0.5 rad/s at most, a floor without slip, and the default odometry.
    pub fn new(drive: Drive) -> Self {
        Self {
            drive,
            limits: TwistLimits::default(),
            time_constant: 0.1,
            steering_time_constant: 0.1,
            steering_rate: 0.5,
            slip: SlipParams::default(),
            odometry: OdometryErrors::default(),
        }
    }

    /// The same vehicle on an ideal floor with ideal drives and odometry: it does what it is told, within its limits.
    #[must_use]
    pub fn ideal(self) -> Self {
        Self {
            time_constant: 0.0,
            steering_time_constant: 0.0,
            slip: SlipParams::default(),
            odometry: OdometryErrors::NONE,
            ..self
        }
    }

    pub(crate) fn validate(&self) -> Result<(), Error> {
        self.limits.validate()?;
        check::non_negative("time_constant", self.time_constant)?;
        check::non_negative("steering_time_constant", self.steering_time_constant)?;
        check::positive("steering_rate", self.steering_rate)?;
        check::in_range("longitudinal slip", self.slip.longitudinal, -1.0, 1.0)?;
        check::in_range("yaw slip", self.slip.yaw, -1.0, 1.0)?;
        check::non_negative("lateral slip", self.slip.lateral)?;
        check::non_negative("yaw_disturbance", self.slip.yaw_disturbance)?;
        self.odometry.validate()
    }

    /// What the wheels do `dt` seconds later, each on its own way to what it is told.
    pub(crate) fn lag(&self, now: &WheelStates, told: &WheelStates, dt: f64) -> WheelStates {
        // Share of the way to the target that a first-order lag goes in dt, exactly.
        let share = |constant: f64| if constant > 0.0 { 1.0 - (-dt / constant).exp() } else { 1.0 };
        let (speed_share, steering_share) = (share(self.time_constant), share(self.steering_time_constant));
        let reach = self.steering_rate * dt;
        let mut next = *now;
        for (speed, target) in next.speeds.iter_mut().zip(told.speeds) {
            *speed += (target - *speed) * speed_share;
            if target == 0.0 && speed.abs() < STANDING {
                *speed = 0.0;
            }
        }
        for (angle, target) in next.steering.iter_mut().zip(told.steering) {
            *angle += ((target - *angle) * steering_share).clamp(-reach, reach);
        }
        next
    }
}

impl Default for VehicleParams {
    /// The default differential drive.
    fn default() -> Self {
        Self::new(Drive::default())
    }
}
