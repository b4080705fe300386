//! The drives of a vehicle: from a twist to what each wheel is told, and from what the wheels do to a twist.

use agv_core::{
    geometry::Twist2,
    kinematics::{
        Ackermann, AckermannWheels, DifferentialDrive, DifferentialWheels, DoubleAckermann, DoubleAckermannWheels,
        Kinematics, Mecanum, MecanumWheels, Tricycle, TricycleWheels,
    },
};

/// What all wheels of a vehicle do, whatever its kind; what it does not have stays zero.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WheelStates {
    /// Speeds in radians per second: left and right; front left, front right, rear left and rear right (mecanum); or
    /// the one driven axle or wheel.
    pub speeds: [f64; 4],
    /// Angles of the front and the rear axle in radians, positive to the left.
    pub steering: [f64; 2],
}

/// The kinematics of a simulated vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drive {
    /// Two driven wheels.
    Differential(DifferentialDrive),
    /// A driven rear axle and a steered front axle.
    Ackermann(Ackermann),
    /// Two steered axles.
    DoubleAckermann(DoubleAckermann),
    /// One wheel in front that drives and steers.
    Tricycle(Tricycle),
    /// Four mecanum wheels.
    Mecanum(Mecanum),
}

impl Default for Drive {
    /// The small indoor AGV of the default [`DifferentialDrive`].
    fn default() -> Self {
        Self::Differential(DifferentialDrive::default())
    }
}

impl Drive {
    /// Twist of the base that rolling wheels make.
    pub fn twist(&self, wheels: &WheelStates) -> Twist2 {
        let ([a, b, c, d], [front_steering, rear_steering]) = (wheels.speeds, wheels.steering);
        match self {
            Self::Differential(drive) => drive.forward(&DifferentialWheels { left: a, right: b }),
            Self::Ackermann(drive) => drive.forward(&AckermannWheels { drive: a, steering: front_steering }),
            Self::DoubleAckermann(drive) => {
                drive.forward(&DoubleAckermannWheels { drive: a, front_steering, rear_steering })
            }
            Self::Tricycle(drive) => drive.forward(&TricycleWheels { drive: a, steering: front_steering }),
            Self::Mecanum(drive) => {
                drive.forward(&MecanumWheels { front_left: a, front_right: b, rear_left: c, rear_right: d })
            }
        }
    }

    /// What the wheels are told for a finite twist: the nearest that they can do. A steered axle stops at its greatest
    /// angle, and stays at `now` where the vehicle is to rest.
    pub(crate) fn wheels(&self, twist: &Twist2, now: &WheelStates) -> Result<WheelStates, agv_core::Error> {
        let one = |speed: f64, steering: [f64; 2]| WheelStates { speeds: [speed, 0.0, 0.0, 0.0], steering };
        Ok(match self {
            Self::Differential(drive) => {
                let wheels = drive.inverse(twist)?;
                WheelStates { speeds: [wheels.left, wheels.right, 0.0, 0.0], steering: [0.0; 2] }
            }
            Self::Mecanum(drive) => {
                let wheels = drive.inverse(twist)?;
                let speeds = [wheels.front_left, wheels.front_right, wheels.rear_left, wheels.rear_right];
                WheelStates { speeds, steering: [0.0; 2] }
            }
            Self::Ackermann(drive) => {
                let p = drive.params();
                let angle = steered(p.wheelbase * twist.yaw_rate, twist.vx, p.max_steering, now.steering[0]);
                one(twist.vx / p.wheel_radius, [angle, 0.0])
            }
            Self::DoubleAckermann(drive) => {
                let p = drive.params();
                let front_sideways = twist.vy + p.front * twist.yaw_rate;
                let rear_sideways = twist.vy - p.rear * twist.yaw_rate;
                let front = steered(front_sideways, twist.vx, p.max_front_steering, now.steering[0]);
                let rear = steered(rear_sideways, twist.vx, p.max_rear_steering, now.steering[1]);
                one(twist.vx / (p.wheel_radius * rear.cos()), [front, rear])
            }
            Self::Tricycle(drive) => {
                let p = drive.params();
                let sideways = p.wheelbase * twist.yaw_rate;
                let sign = if twist.vx < 0.0 { -1.0 } else { 1.0 };
                let angle = if twist.vx == 0.0 && sideways == 0.0 {
                    now.steering[0]
                } else {
                    (sign * sideways).atan2(twist.vx.abs()).clamp(-p.max_steering, p.max_steering)
                };
                // The wanted velocity of the wheel, as far as it points along its heading.
                let (sin, cos) = angle.sin_cos();
                one((twist.vx * cos + sideways * sin) / p.wheel_radius, [angle, 0.0])
            }
        })
    }
}

/// Angle of a wheel that moves sideways while it rolls, within the greatest; the present one at rest.
fn steered(sideways: f64, ahead: f64, greatest: f64, now: f64) -> f64 {
    if ahead == 0.0 { now } else { (sideways / ahead).atan().clamp(-greatest, greatest) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::kinematics::{AckermannParams, DoubleAckermannParams, MecanumParams, TricycleParams};
    use proptest::prelude::*;

    fn drives() -> [Drive; 5] {
        [
            Drive::default(),
            Drive::Ackermann(Ackermann::new(AckermannParams::default()).unwrap()),
            Drive::DoubleAckermann(DoubleAckermann::new(DoubleAckermannParams::default()).unwrap()),
            Drive::Tricycle(Tricycle::new(TricycleParams::default()).unwrap()),
            Drive::Mecanum(Mecanum::new(MecanumParams::default()).unwrap()),
        ]
    }

    proptest! {
        /// Wheels that do as they are told make the twist, where every vehicle can: gentle bends.
        #[test]
        fn wheels_make_the_twist(v in -2.0..2.0_f64, curvature in -0.4..0.4_f64) {
            let twist = Twist2::new(v, 0.0, v * curvature);
            for drive in drives() {
                let made = drive.twist(&drive.wheels(&twist, &WheelStates::default()).unwrap());
                let off = Twist2::new(made.vx - twist.vx, made.vy, made.yaw_rate - twist.yaw_rate);
                prop_assert!(off.speed() + off.yaw_rate.abs() < 1e-12, "{:?} {:?}", drive, made);
            }
        }

        /// Beyond what the steering can do, the speed stays and the bend is the tightest.
        #[test]
        fn steering_stops_at_its_greatest_angle(v in 0.1..1.0_f64, rate in 3.0..9.0_f64) {
            let truck = Ackermann::new(AckermannParams::default()).unwrap();
            let wheels = Drive::Ackermann(truck).wheels(&Twist2::new(v, 0.0, rate), &WheelStates::default()).unwrap();
            prop_assert_eq!(wheels.steering[0], truck.params().max_steering);
            prop_assert!((wheels.speeds[0] * truck.params().wheel_radius - v).abs() < 1e-12);
        }
    }

    #[test]
    fn steering_stays_at_rest_and_a_tricycle_turns_on_the_spot() {
        let now = WheelStates { steering: [0.3, -0.2], ..Default::default() };
        for drive in drives() {
            let wheels = drive.wheels(&Twist2::ZERO, &now).unwrap();
            assert_eq!(wheels.speeds, [0.0; 4], "{drive:?}");
            assert!(wheels.steering == [0.0; 2] || wheels.steering[0] == 0.3, "{drive:?}");
        }
        let tricycle = drives()[3];
        let spin = Twist2::new(0.0, 0.0, -0.5);
        let made = tricycle.twist(&tricycle.wheels(&spin, &now).unwrap());
        assert!(made.vx.abs() < 1e-12 && (made.yaw_rate + 0.5).abs() < 1e-12, "{made:?}");
    }
}
