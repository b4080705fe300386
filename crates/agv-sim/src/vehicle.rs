//! A vehicle on a floor: what it was told, what its wheels did, and where it really went.
//!
//! ```text
//! command -> ramp within the limits -> inverse kinematics -> every wheel and steered axle lags on its own
//!         -> forward kinematics -> wheel twist -> slip -> true motion
//!                                      |
//!                                      +-> scale errors, noise -> odometry
//! ```
//!
//! The odometry knows the wheels and nothing of the slip. Its noise is that of the odometry motion model (paper 001,
//! Eqs. 2-5; Thrun, Burgard and Fox 2005, Table 5.6): the motion is taken apart into rotation, translation, rotation,
//! each with a variance that grows with the motion, and put together again. [`WheelEncoders`](crate::WheelEncoders)
//! count what the wheels turn, for an odometry of one's own.

use crate::noise::{Part, normal, own_seed};
use crate::{Error, VehicleParams, WheelStates};
use agv_core::{
    check,
    compute::Seed,
    geometry::{Se2, Twist2},
    odometry::OdometryIncrement,
    sensors::SensorId,
    time::Stamp,
};

/// What a vehicle really does: nothing that its computer could know.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroundTruth {
    /// When.
    pub stamp: Stamp,
    /// Pose of the base in the map.
    pub map_from_base: Se2,
    /// Twist of the base in its own frame.
    pub twist: Twist2,
    /// Change of the twist over the last step, in m/s² and rad/s².
    pub acceleration: Twist2,
    /// Speeds of the wheels and angles of the steered axles.
    pub wheels: WheelStates,
    /// What the floor took: twist that the wheels made less the one of the base.
    pub slip: Twist2,
}

/// A simulated vehicle with its ground truth.
///
/// ```
/// use agv_core::compute::Seed;
/// use agv_core::geometry::{Se2, Twist2};
/// use agv_sim::{Vehicle, VehicleParams};
///
/// let mut vehicle = Vehicle::new(VehicleParams::default(), Se2::default(), Seed(1))?;
/// for _ in 0..100 {
///     let odometry = vehicle.step(&Twist2::new(0.8, 0.0, 0.2), 0.05)?; // what a localizer gets
///     assert_eq!(odometry.dt(), 0.05);
/// }
/// let error = vehicle.odom_from_base().translation() - vehicle.map_from_base().translation();
/// assert!(vehicle.map_from_base().x() > 1.0 && error.norm() < 1.0);
/// # Ok::<(), agv_sim::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Vehicle {
    params: VehicleParams,
    seed: Seed,
    step: u64,
    now: Stamp,
    /// Where the ramp towards the command is.
    setpoint: Twist2,
    wheels: WheelStates,
    /// How far each wheel has turned, in radians.
    rolled: [f64; 4],
    /// What the wheels do.
    wheel_twist: Twist2,
    /// What the base does.
    twist: Twist2,
    acceleration: Twist2,
    map_from_base: Se2,
    odom_from_base: Se2,
}

impl Vehicle {
    /// A vehicle at rest at `map_from_base`, at time zero.
    ///
    /// # Errors
    /// A parameter out of its range, or a pose that is not finite.
    pub fn new(params: VehicleParams, map_from_base: Se2, seed: Seed) -> Result<Self, Error> {
        params.validate()?;
        check::all_finite("map_from_base", &[map_from_base.x(), map_from_base.y(), map_from_base.yaw()])?;
        Ok(Self {
            params,
            seed: own_seed(seed, Part::Vehicle, SensorId::default()),
            step: 0,
            now: Stamp::default(),
            setpoint: Twist2::ZERO,
            wheels: WheelStates::default(),
            rolled: [0.0; 4],
            wheel_twist: Twist2::ZERO,
            twist: Twist2::ZERO,
            acceleration: Twist2::ZERO,
            map_from_base,
            odom_from_base: Se2::default(),
        })
    }

    /// Drives for `dt` seconds under a command and returns what the odometry says of it.
    ///
    /// The covariance of the increment is zero: its noise is that of [`OdometryErrors`](crate::OdometryErrors), for the
    /// consumer's motion model to state.
    ///
    /// # Errors
    /// A command that is not finite, or a `dt` that is not finite and positive; the vehicle is then as it was.
    pub fn step(&mut self, command: &Twist2, dt: f64) -> Result<OdometryIncrement, Error> {
        check::all_finite("command", &[command.vx, command.vy, command.yaw_rate])?;
        check::positive("dt", dt)?;
        let setpoint = self.params.limits.step(&self.setpoint, command, dt)?;
        let mut told = self.params.drive.wheels(&setpoint, &self.wheels)?;
        if *command == Twist2::ZERO {
            // Rest has no curvature of its own: the vehicle brakes on the circle that it is on.
            told.steering = self.wheels.steering;
        }
        let mut stream = self.seed.stream(self.step, 0);
        self.step += 1;
        self.setpoint = setpoint;
        self.wheels = self.params.lag(&self.wheels, &told, dt);
        for (angle, speed) in self.rolled.iter_mut().zip(self.wheels.speeds) {
            *angle += speed * dt;
        }
        self.wheel_twist = self.params.drive.twist(&self.wheels);
        let wheels = self.wheel_twist;

        let slip = self.params.slip;
        let disturbance = normal(slip.yaw_disturbance, &mut stream) / dt.sqrt();
        // In a left bend the vehicle drifts to the right.
        let drift = -slip.lateral * wheels.vx * wheels.yaw_rate;
        let twist = Twist2::new(
            wheels.vx * (1.0 - slip.longitudinal),
            wheels.vy * (1.0 - slip.longitudinal) + drift,
            wheels.yaw_rate * (1.0 - slip.yaw) + if wheels == Twist2::ZERO { 0.0 } else { disturbance },
        );
        self.acceleration = Twist2::new(
            (twist.vx - self.twist.vx) / dt,
            (twist.vy - self.twist.vy) / dt,
            (twist.yaw_rate - self.twist.yaw_rate) / dt,
        );
        self.twist = twist;
        self.map_from_base = self.map_from_base * twist.integrate(dt);

        let start_from_end = self.params.odometry.distort(&wheels.integrate(dt), &mut stream);
        self.odom_from_base = self.odom_from_base * start_from_end;
        let start = self.now;
        self.now = start + dt;
        let covariance = nalgebra::Matrix3::zeros();
        Ok(OdometryIncrement { start, end: self.now, start_from_end, covariance })
    }

    /// What the vehicle is like.
    pub const fn params(&self) -> &VehicleParams {
        &self.params
    }

    /// Time since the start, as a stamp.
    pub const fn now(&self) -> Stamp {
        self.now
    }

    /// Ground truth, all of it.
    pub fn truth(&self) -> GroundTruth {
        let (wheels, base) = (self.wheel_twist, self.twist);
        GroundTruth {
            stamp: self.now,
            map_from_base: self.map_from_base,
            twist: base,
            acceleration: self.acceleration,
            wheels: self.wheels,
            slip: Twist2::new(wheels.vx - base.vx, wheels.vy - base.vy, wheels.yaw_rate - base.yaw_rate),
        }
    }

    /// Ground truth: speeds of the wheels and angles of the steered axles.
    pub const fn wheels(&self) -> &WheelStates {
        &self.wheels
    }

    /// Ground truth: how far each wheel has turned since the start, in radians, in the order of [`WheelStates`].
    pub const fn wheel_angles(&self) -> &[f64; 4] {
        &self.rolled
    }

    /// Ground truth: pose of the base in the map.
    pub const fn map_from_base(&self) -> Se2 {
        self.map_from_base
    }

    /// Ground truth: twist of the base in its own frame.
    pub const fn twist(&self) -> Twist2 {
        self.twist
    }

    /// Ground truth: change of the twist over the last step, in m/s² and rad/s².
    pub const fn acceleration(&self) -> Twist2 {
        self.acceleration
    }

    /// Twist that the wheels made, which the odometry believes in.
    pub const fn wheel_twist(&self) -> Twist2 {
        self.wheel_twist
    }

    /// Dead reckoning: pose of the base in the odometry frame, which began where the vehicle started.
    pub const fn odom_from_base(&self) -> Se2 {
        self.odom_from_base
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Drive, SlipParams};
    use agv_core::geometry::LieGroup;
    use agv_core::kinematics::{Ackermann, AckermannParams, TwistLimits};
    use proptest::prelude::*;

    fn vehicle(params: VehicleParams) -> Vehicle {
        Vehicle::new(params, Se2::new(2.0, 1.0, 0.3), Seed(5)).unwrap()
    }

    /// Limits that let a command through at once.
    fn unlimited() -> VehicleParams {
        let limits =
            TwistLimits { acceleration: 1e6, deceleration: 1e6, yaw_acceleration: 1e6, ..TwistLimits::default() };
        VehicleParams { limits, ..VehicleParams::default().ideal() }
    }

    proptest! {
        /// Whatever is commanded, the wheels stay within the limits of speed and of its change.
        #[test]
        fn limits_hold_always(commands in prop::collection::vec((-3.0..3.0_f64, -3.0..3.0_f64), 1..40), lag in 0.0..0.5_f64) {
            let params = VehicleParams { time_constant: lag, ..Default::default() };
            let (mut vehicle, limits, dt) = (vehicle(params), params.limits, 0.05);
            for (vx, rate) in commands {
                let before = vehicle.wheel_twist();
                vehicle.step(&Twist2::new(vx, 1.0, rate), dt).unwrap();
                let now = vehicle.wheel_twist();
                prop_assert!(now.vx <= limits.forward_speed + 1e-12 && now.vx >= -limits.reverse_speed - 1e-12);
                prop_assert!(now.yaw_rate.abs() <= limits.yaw_rate + 1e-12 && now.vy == 0.0);
                prop_assert!((now.vx - before.vx).abs() <= 0.5 * dt + 1e-12);
                prop_assert!((now.yaw_rate - before.yaw_rate).abs() <= dt + 1e-12);
            }
        }
    }

    #[test]
    fn an_ideal_vehicle_drives_the_arc_it_was_told() {
        let mut ideal = vehicle(unlimited());
        let twist = Twist2::new(0.8, 0.0, 0.4);
        for _ in 0..40 {
            ideal.step(&twist, 0.05).unwrap();
        }
        let expected = Se2::new(2.0, 1.0, 0.3) * twist.integrate(2.0);
        assert!(ideal.map_from_base().minus(&expected).norm() < 1e-12);
        assert!(ideal.odom_from_base().minus(&twist.integrate(2.0)).norm() < 1e-12);
        assert!((ideal.now().seconds() - 2.0).abs() < 1e-9);
    }

    /// The lag's solution, `v (1 - exp(-t / T))`, whatever the step.
    #[test]
    fn the_lag_is_exact() {
        for steps in [1_u32, 7, 50] {
            let mut lagging = vehicle(VehicleParams { time_constant: 0.4, ..unlimited() });
            for _ in 0..steps {
                lagging.step(&Twist2::new(1.0, 0.0, 0.0), 0.8 / f64::from(steps)).unwrap();
            }
            assert!((lagging.twist().vx - (1.0 - (-2_f64).exp())).abs() < 1e-12);
        }
    }

    #[test]
    fn odometry_does_not_see_slip() {
        let slip = SlipParams { longitudinal: 0.1, yaw: 0.2, lateral: 0.05, yaw_disturbance: 0.0 };
        let mut slipping = vehicle(VehicleParams { slip, ..unlimited() });
        let odometry = slipping.step(&Twist2::new(1.0, 0.0, 0.5), 1.0).unwrap();
        assert!(odometry.start_from_end.minus(&Twist2::new(1.0, 0.0, 0.5).integrate(1.0)).norm() < 1e-12);
        let (truth, slip) = (slipping.twist(), slipping.truth().slip);
        for (found, expected) in [
            ([truth.vx, truth.vy, truth.yaw_rate], [0.9, -0.025, 0.4]),
            ([slip.vx, slip.vy, slip.yaw_rate], [0.1, 0.025, 0.1]),
        ] {
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}");
        }
    }

    /// A steered axle turns at its rate and lags behind, and the bend follows it, not the command.
    #[test]
    fn the_steering_lags_and_the_bend_with_it() {
        let truck = Ackermann::new(AckermannParams::default()).unwrap();
        let free = TwistLimits { yaw_rate: 9.0, ..unlimited().limits };
        let params = VehicleParams { limits: free, drive: Drive::Ackermann(truck), ..VehicleParams::default().ideal() };
        for (constant, rate) in [(0.0, 0.4), (0.3, 100.0)] {
            let params = VehicleParams { steering_time_constant: constant, steering_rate: rate, ..params };
            let (mut vehicle, target) = (vehicle(params), 0.6_f64.atan());
            for step in 1..=20 {
                vehicle.step(&Twist2::new(1.0, 0.0, 0.5), 0.05).unwrap();
                let (time, angle) = (0.05 * f64::from(step), vehicle.wheels().steering[0]);
                let lag = if constant > 0.0 { target * (1.0 - (-time / constant).exp()) } else { target };
                assert!((angle - lag.min(rate * time)).abs() < 1e-9, "{constant} {time} {angle}");
                assert!((vehicle.twist().yaw_rate - angle.tan() / 1.2).abs() < 1e-12);
            }
        }
    }

    /// Told to stand, a vehicle that steers brakes on its circle.
    #[test]
    fn braking_keeps_the_steering() {
        let truck = Drive::Ackermann(Ackermann::new(AckermannParams::default()).unwrap());
        let mut vehicle = vehicle(VehicleParams::new(truck));
        for _ in 0..100 {
            vehicle.step(&Twist2::new(0.8, 0.0, 0.3), 0.05).unwrap();
        }
        let turned = vehicle.wheels().steering;
        assert!((turned[0] - (1.2_f64 * 0.3 / 0.8).atan()).abs() < 1e-6, "{turned:?}");
        while vehicle.wheel_twist() != Twist2::ZERO {
            vehicle.step(&Twist2::ZERO, 0.05).unwrap();
            assert_eq!(vehicle.wheels().steering, turned);
        }
    }

    /// What the wheels turned is what they moved, whatever the drive.
    #[test]
    fn wheels_turn_as_far_as_they_drive() {
        let mut driving = vehicle(VehicleParams::default());
        let mut way = 0.0;
        for _ in 0..50 {
            driving.step(&Twist2::new(0.6, 0.0, 0.3), 0.02).unwrap();
            way += driving.wheel_twist().vx * 0.02;
        }
        let [left, right, ..] = *driving.wheel_angles();
        assert!((0.05 * (left + right) - way).abs() < 1e-12 && right > left);
        for _ in 0..200 {
            driving.step(&Twist2::ZERO, 0.02).unwrap();
        }
        assert_eq!(driving.wheel_twist(), Twist2::ZERO);
    }

    #[test]
    fn bad_vehicles_and_commands_are_refused() {
        let good = VehicleParams::default();
        for bad in [
            VehicleParams { time_constant: -1.0, ..good },
            VehicleParams { steering_time_constant: f64::NAN, ..good },
            VehicleParams { steering_rate: 0.0, ..good },
            VehicleParams { slip: SlipParams { longitudinal: 1.5, ..good.slip }, ..good },
            VehicleParams { slip: SlipParams { yaw: f64::NAN, ..good.slip }, ..good },
            VehicleParams { slip: SlipParams { lateral: -0.1, ..good.slip }, ..good },
            VehicleParams { slip: SlipParams { yaw_disturbance: f64::INFINITY, ..good.slip }, ..good },
            VehicleParams { limits: TwistLimits { acceleration: 0.0, ..good.limits }, ..good },
        ] {
            assert!(Vehicle::new(bad, Se2::default(), Seed(0)).is_err(), "{bad:?}");
        }
        assert!(Vehicle::new(good, Se2::new(f64::NAN, 0.0, 0.0), Seed(0)).is_err());
        let mut vehicle = vehicle(good);
        let before = vehicle.clone();
        for (command, dt) in [(Twist2::new(f64::NAN, 0.0, 0.0), 0.1), (Twist2::ZERO, 0.0), (Twist2::ZERO, f64::NAN)] {
            assert!(vehicle.step(&command, dt).is_err());
        }
        assert_eq!(vehicle, before);
    }
}
