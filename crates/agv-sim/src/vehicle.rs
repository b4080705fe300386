//! A vehicle on a floor: what it was told, what its wheels did, and where it really went.
//!
//! ```text
//! command -> limits -> first-order lag -> wheel twist -> slip  -> true motion
//!                                             |
//!                                             +-> scale errors, noise -> odometry
//! ```
//!
//! The odometry knows the wheels and nothing of the slip. Its noise is that of the odometry motion model (paper 001,
//! Eqs. 2-5; Thrun, Burgard and Fox 2005, Table 5.6): the motion is taken apart into rotation, translation, rotation,
//! each with a variance that grows with the motion, and put together again.

use crate::noise::normal;
use crate::{Error, odometry_noise::OdometryErrors};
use agv_core::{
    check,
    compute::Seed,
    geometry::{Se2, Twist2},
    kinematics::{Kinematics, TwistLimits},
    odometry::OdometryIncrement,
    time::Stamp,
};

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
    /// What the drive can do, in m/s, rad/s and their rates.
    pub limits: TwistLimits,
    /// Time constant of the speed controllers, in seconds; zero follows the command at once, within the limits.
    pub time_constant: f64,
    /// What the floor does.
    pub slip: SlipParams,
    /// What the odometry gets wrong.
    pub odometry: OdometryErrors,
}

impl Default for VehicleParams {
    /// The default limits, drives that settle in about a third of a second, a floor without slip, and the default
    /// odometry.
    fn default() -> Self {
        Self {
            limits: TwistLimits::default(),
            time_constant: 0.1,
            slip: SlipParams::default(),
            odometry: OdometryErrors::default(),
        }
    }
}

impl VehicleParams {
    /// The same vehicle on an ideal floor with ideal drives and odometry: it does what it is told, within its limits.
    #[must_use]
    pub fn ideal(self) -> Self {
        Self { time_constant: 0.0, slip: SlipParams::default(), odometry: OdometryErrors::NONE, ..self }
    }

    fn validate(&self) -> Result<(), Error> {
        self.limits.validate()?;
        check::non_negative("time_constant", self.time_constant)?;
        check::in_range("longitudinal slip", self.slip.longitudinal, -1.0, 1.0)?;
        check::in_range("yaw slip", self.slip.yaw, -1.0, 1.0)?;
        check::non_negative("lateral slip", self.slip.lateral)?;
        check::non_negative("yaw_disturbance", self.slip.yaw_disturbance)?;
        self.odometry.validate()
    }
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
            seed,
            step: 0,
            now: Stamp::default(),
            wheel_twist: Twist2::ZERO,
            twist: Twist2::ZERO,
            acceleration: Twist2::ZERO,
            map_from_base,
            odom_from_base: Se2::default(),
        })
    }

    /// Drives for `dt` seconds under a command and returns what the odometry says of it.
    ///
    /// The covariance of the increment is zero: its noise is that of [`OdometryErrors`], for the consumer's motion
    /// model to state.
    ///
    /// # Errors
    /// A command that is not finite, or a `dt` that is not finite and positive; the vehicle is then as it was.
    pub fn step(&mut self, command: &Twist2, dt: f64) -> Result<OdometryIncrement, Error> {
        check::all_finite("command", &[command.vx, command.vy, command.yaw_rate])?;
        check::positive("dt", dt)?;
        let mut stream = self.seed.stream(self.step, 0);
        self.step += 1;
        self.wheel_twist = self.params.drive(&self.wheel_twist, command, dt);
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

    /// As [`step`](Self::step), with the command turned into wheel commands and back: the vehicle is told what its
    /// wheels can do and no more.
    ///
    /// # Errors
    /// As `step`, or a command that the kinematics refuses.
    pub fn step_with<K: Kinematics>(
        &mut self,
        kinematics: &K,
        command: &Twist2,
        dt: f64,
    ) -> Result<OdometryIncrement, Error> {
        self.step(&kinematics.forward(&kinematics.inverse(command)?), dt)
    }

    /// What the vehicle is like.
    pub const fn params(&self) -> &VehicleParams {
        &self.params
    }

    /// Time since the start, as a stamp.
    pub const fn now(&self) -> Stamp {
        self.now
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

impl VehicleParams {
    /// Twist of the wheels `dt` seconds later.
    fn drive(&self, now: &Twist2, command: &Twist2, dt: f64) -> Twist2 {
        let limits = &self.limits;
        // Share of the way to the command that a first-order lag goes in dt, exactly.
        let share = if self.time_constant > 0.0 { 1.0 - (-dt / self.time_constant).exp() } else { 1.0 };
        let linear = |now: f64, target: f64| {
            // Rates are named by what happens to the speed: towards zero is braking.
            let speeding = target.abs() > now.abs() && target * now >= 0.0;
            let rate = if speeding { limits.acceleration } else { limits.deceleration };
            now + ((target - now) * share).clamp(-rate * dt, rate * dt)
        };
        let turn = limits.yaw_acceleration * dt;
        let yaw_target = command.yaw_rate.clamp(-limits.yaw_rate, limits.yaw_rate);
        Twist2::new(
            linear(now.vx, command.vx.clamp(-limits.reverse_speed, limits.forward_speed)),
            linear(now.vy, command.vy.clamp(-limits.lateral_speed, limits.lateral_speed)),
            now.yaw_rate + ((yaw_target - now.yaw_rate) * share).clamp(-turn, turn),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::geometry::LieGroup;
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
                prop_assert!(now.vx <= limits.forward_speed && now.vx >= -limits.reverse_speed && now.vy == 0.0);
                prop_assert!(now.yaw_rate.abs() <= limits.yaw_rate);
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
        assert_eq!(odometry.start_from_end, Twist2::new(1.0, 0.0, 0.5).integrate(1.0));
        assert_eq!(slipping.twist(), Twist2::new(0.9, -0.025, 0.4));
    }

    #[test]
    fn wheels_pass_on_what_they_can_do() {
        /// Cannot turn.
        struct Tram;
        impl Kinematics for Tram {
            type Wheels = f64;
            fn forward(&self, wheels: &f64) -> Twist2 {
                Twist2::new(*wheels, 0.0, 0.0)
            }
            fn inverse(&self, twist: &Twist2) -> Result<f64, agv_core::Error> {
                check::finite("vx", twist.vx)
            }
        }
        let mut tram = vehicle(unlimited());
        tram.step_with(&Tram, &Twist2::new(0.5, 0.0, 0.9), 1.0).unwrap();
        assert_eq!(tram.twist(), Twist2::new(0.5, 0.0, 0.0));
        assert!(tram.step_with(&Tram, &Twist2::new(f64::NAN, 0.0, 0.0), 1.0).is_err());
    }

    #[test]
    fn bad_vehicles_and_commands_are_refused() {
        let good = VehicleParams::default();
        for bad in [
            VehicleParams { time_constant: -1.0, ..good },
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
