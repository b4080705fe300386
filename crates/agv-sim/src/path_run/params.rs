//! What the vehicles of the tracking experiments are like.

use crate::{Drive, Error, OdometryErrors, PoseSensorParams, SlipParams, VehicleParams, WheelEncodersParams};
use agv_core::{
    check,
    kinematics::{
        Ackermann, AckermannParams, DifferentialDrive, Mecanum, MecanumParams, MotionLimits, SteeringLimits,
        TwistLimits,
    },
    odometry::WheelNoise,
    path::Path,
};

/// A vehicle, its sensors and its limits on a path; [`drive`](Self::drive) drives it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathRunParams {
    /// The vehicle.
    pub vehicle: VehicleParams,
    /// What its commands keep to.
    pub limits: MotionLimits,
    /// Its encoders.
    pub encoders: WheelEncodersParams,
    /// What the odometry says of its own errors.
    pub wheel_noise: WheelNoise,
    /// Where its pose comes from.
    pub pose_sensor: PoseSensorParams,
    /// Time of a cycle, in seconds: encoders, pose sensor and tracker run at one rate.
    pub dt: f64,
}

/// Speeds and accelerations of all vehicles of the experiments: 1 m/s, 0.5 m/s in reverse, 2 rad/s, 1 m/s² and 4 rad/s² (what 1 m/s²
/// makes of a track of half a metre).
const LIMITS: TwistLimits = TwistLimits {
    forward_speed: 1.0,
    reverse_speed: 0.5,
    lateral_speed: 0.0,
    yaw_rate: 2.0,
    acceleration: 1.0,
    deceleration: 1.0,
    yaw_acceleration: 4.0,
};

/// Time constant of all drives of the experiments, in seconds.
const LAG: f64 = 0.15;

/// Share of the turn rate that the floor takes in the experiments.
const YAW_SLIP: f64 = 0.03;

impl PathRunParams {
    /// Drives that lag by 0.15 s, 3 % of yaw slip, the pose to 1 cm and 0.5° at 50 Hz, odometry by encoders alone.
    fn new(drive: Drive, limits: MotionLimits) -> Self {
        let steering_sigma = 0.2_f64.to_radians();
        let vehicle = VehicleParams {
            limits: limits.twist,
            time_constant: LAG,
            steering_time_constant: LAG,
            steering_rate: limits.steering.map_or(0.5, |steering| steering.max_rate),
            slip: SlipParams { yaw: YAW_SLIP, ..SlipParams::default() },
            odometry: OdometryErrors::NONE,
            ..VehicleParams::new(drive)
        };
        Self {
            vehicle,
            limits,
            encoders: WheelEncodersParams { steering_sigma, ..WheelEncodersParams::default() },
            wheel_noise: WheelNoise { steering_sigma, ..WheelNoise::default() },
            pose_sensor: PoseSensorParams::default(),
            dt: 0.02,
        }
    }

    /// The default differential drive with the limits of the tracking experiments: 1 m/s, 0.5 m/s in reverse, 1 m/s², 2 rad/s,
    /// 4 rad/s², and no limit to the side.
    pub fn differential() -> Self {
        Self::new(Drive::Differential(DifferentialDrive::default()), LIMITS.into())
    }

    /// A small vehicle that steers, of half a metre of wheelbase, by 45° at most and 2 rad/s: it turns on a radius of half a metre.
    ///
    /// # Errors
    /// None; the geometry is a sound one.
    pub fn ackermann() -> Result<Self, Error> {
        let steering = SteeringLimits { wheelbase: 0.5, max_angle: 45_f64.to_radians(), max_rate: 2.0 };
        let geometry = AckermannParams { wheelbase: 0.5, wheel_radius: 0.1, max_steering: steering.max_angle };
        let limits = MotionLimits { steering: Some(steering), ..LIMITS.into() };
        let mut params = Self::new(Drive::Ackermann(Ackermann::new(geometry)?), limits);
        // How fast it turns follows from speed and steering; the vehicle's own ramp is not to limit it once more.
        params.vehicle.limits.yaw_acceleration = 100.0;
        Ok(params)
    }

    /// The default mecanum vehicle, half a metre per second sideways.
    ///
    /// # Errors
    /// None; the geometry is a sound one.
    pub fn omnidirectional() -> Result<Self, Error> {
        let limits = TwistLimits { lateral_speed: 0.5, ..LIMITS };
        Ok(Self::new(Drive::Mecanum(Mecanum::new(MecanumParams::default())?), limits.into()))
    }

    pub(super) fn validate(&self) -> Result<(), Error> {
        self.vehicle.validate()?;
        self.limits.validate()?;
        check::positive("dt", self.dt)?;
        Ok(())
    }

    /// Time after which a run ends all the same: the path at a tenth of the speed, and half a minute, in seconds.
    pub(super) fn timeout_for(&self, path: &Path) -> f64 {
        let speed = self.limits.twist.forward_speed.max(self.limits.twist.reverse_speed).max(0.01);
        (10.0 * path.length() / speed).min(1e5) + 30.0
    }
}

impl Default for PathRunParams {
    /// The differential drive.
    fn default() -> Self {
        Self::differential()
    }
}
