//! A vehicle that steers with both axles.
//!
//! With the front axle `a` ahead of the base frame and the rear axle `b` behind it, rolling without slip at both says
//!
//! ```text
//! vy + a yaw_rate = vx tan(front)        vy - b yaw_rate = vx tan(rear)
//! ```
//!
//! Equal angles move the vehicle sideways without turning (crab), opposite ones halve the turning radius.

use super::{Kinematics, finite_twist, steering::SLACK};
use crate::{Error, check, geometry::Twist2};
use std::f64::consts::FRAC_PI_2;

/// Geometry of a vehicle with two steered axles and a driven rear axle.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DoubleAckermannParams {
    /// Distance of the front axle ahead of the base frame, in metres.
    pub front: f64,
    /// Distance of the rear axle behind the base frame, in metres.
    pub rear: f64,
    /// Radius of the driven rear wheels, in metres.
    pub wheel_radius: f64,
    /// Greatest angle of the front wheels to either side, in radians; below a quarter turn.
    pub max_front_steering: f64,
    /// Greatest angle of the rear wheels to either side, in radians; zero for a vehicle with a rigid rear axle.
    pub max_rear_steering: f64,
}

impl Default for DoubleAckermannParams {
    /// The 1.2 m tugger of [`AckermannParams`](super::AckermannParams) with a second steered axle.
    fn default() -> Self {
        let steering = 35_f64.to_radians();
        Self { front: 0.6, rear: 0.6, wheel_radius: 0.15, max_front_steering: steering, max_rear_steering: steering }
    }
}

/// Commands of a vehicle with two steered axles.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DoubleAckermannWheels {
    /// Speed of the driven rear wheels along their own heading, in radians per second.
    pub drive: f64,
    /// Angle of the imagined middle front wheel, in radians.
    pub front_steering: f64,
    /// Angle of the imagined middle rear wheel, in radians.
    pub rear_steering: f64,
}

/// A vehicle that steers with both axles; it can move sideways, but only while it moves forwards or backwards.
///
/// ```
/// use agv_core::geometry::Twist2;
/// use agv_core::kinematics::{DoubleAckermann, DoubleAckermannParams, Kinematics};
///
/// let carrier = DoubleAckermann::new(DoubleAckermannParams::default())?;
/// let crab = carrier.inverse(&Twist2::new(1.0, 0.5, 0.0))?;
/// assert_eq!(crab.front_steering, crab.rear_steering);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DoubleAckermann {
    params: DoubleAckermannParams,
}

impl DoubleAckermann {
    /// A vehicle of this geometry.
    ///
    /// # Errors
    /// A length that is not positive (one of the axle distances may be zero), or a steering angle outside [0, π/2).
    pub fn new(params: DoubleAckermannParams) -> Result<Self, Error> {
        check::non_negative("front", params.front)?;
        check::non_negative("rear", params.rear)?;
        check::positive("front + rear", params.front + params.rear)?;
        check::positive("wheel_radius", params.wheel_radius)?;
        check::in_range("max_front_steering", params.max_front_steering, 0.0, FRAC_PI_2.next_down())?;
        check::in_range("max_rear_steering", params.max_rear_steering, 0.0, FRAC_PI_2.next_down())?;
        Ok(Self { params })
    }

    /// The geometry it was built with.
    pub const fn params(&self) -> &DoubleAckermannParams {
        &self.params
    }
}

impl Kinematics for DoubleAckermann {
    type Wheels = DoubleAckermannWheels;

    #[inline]
    fn forward(&self, wheels: &Self::Wheels) -> Twist2 {
        let DoubleAckermannParams { front: a, rear: b, wheel_radius, .. } = self.params;
        let vx = wheel_radius * wheels.drive * wheels.rear_steering.cos();
        let (front, rear) = (wheels.front_steering.tan(), wheels.rear_steering.tan());
        Twist2::new(vx, vx * (a * rear + b * front) / (a + b), vx * (front - rear) / (a + b))
    }

    /// At rest the wheels point straight ahead.
    ///
    /// # Errors
    /// A twist that is not finite, or [`Error::OutOfRange`] for one that needs more steering than there is.
    #[inline]
    fn inverse(&self, twist: &Twist2) -> Result<Self::Wheels, Error> {
        finite_twist("twist", twist)?;
        let DoubleAckermannParams { front: a, rear: b, wheel_radius, max_front_steering, max_rear_steering } =
            self.params;
        let angle = |sideways: f64| if sideways == 0.0 { 0.0 } else { (sideways / twist.vx).atan() };
        let front_steering = angle(twist.vy + a * twist.yaw_rate);
        let rear_steering = angle(twist.vy - b * twist.yaw_rate);
        check::in_range("front_steering", front_steering, -max_front_steering - SLACK, max_front_steering + SLACK)?;
        check::in_range("rear_steering", rear_steering, -max_rear_steering - SLACK, max_rear_steering + SLACK)?;
        let drive = twist.vx / (wheel_radius * rear_steering.cos());
        Ok(DoubleAckermannWheels { drive, front_steering, rear_steering })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::{Ackermann, AckermannParams, AckermannWheels, laws};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn forward_undoes_inverse(
            drive in prop_oneof![-9.0..-0.1_f64, 0.1..9.0_f64], front in -0.6..0.6_f64, rear in -0.6..0.6_f64,
        ) {
            let vehicle = DoubleAckermann::new(DoubleAckermannParams { front: 0.8, rear: 0.5, ..Default::default() }).unwrap();
            let twist = vehicle.forward(&DoubleAckermannWheels { drive, front_steering: front, rear_steering: rear });
            laws::round_trip(&vehicle, &twist);
        }

        /// With the base at a rigid rear axle it is the ordinary Ackermann vehicle.
        #[test]
        fn a_rigid_rear_axle_is_the_ordinary_vehicle(drive in -9.0..9.0_f64, steering in -0.6..0.6_f64) {
            let double = DoubleAckermannParams { front: 1.2, rear: 0.0, max_rear_steering: 0.0, ..Default::default() };
            let double = DoubleAckermann::new(double).unwrap();
            let single = Ackermann::new(AckermannParams::default()).unwrap();
            let a = double.forward(&DoubleAckermannWheels { drive, front_steering: steering, rear_steering: 0.0 });
            let b = single.forward(&AckermannWheels { drive, steering });
            prop_assert!((a.vx - b.vx).abs() < 1e-12 && a.vy.abs() < 1e-12 && (a.yaw_rate - b.yaw_rate).abs() < 1e-12);
        }
    }

    #[test]
    fn what_the_steering_cannot_do_is_refused() {
        let vehicle = DoubleAckermann::new(DoubleAckermannParams::default()).unwrap();
        for twist in [Twist2::new(0.0, 0.5, 0.0), Twist2::new(0.0, 0.0, 0.5), Twist2::new(0.5, 1.0, 0.0)] {
            assert!(matches!(vehicle.inverse(&twist), Err(Error::OutOfRange { .. })), "{twist:?}");
        }
        assert_eq!(vehicle.inverse(&Twist2::ZERO), Ok(DoubleAckermannWheels::default()));
    }

    #[test]
    fn bad_geometry_is_refused() {
        let good = DoubleAckermannParams::default();
        for bad in [-0.1, f64::NAN, f64::INFINITY] {
            for params in [
                DoubleAckermannParams { front: bad, ..good },
                DoubleAckermannParams { rear: bad, ..good },
                DoubleAckermannParams { wheel_radius: bad, ..good },
                DoubleAckermannParams { max_front_steering: bad, ..good },
                DoubleAckermannParams { max_rear_steering: bad, ..good },
                DoubleAckermannParams { front: 0.0, rear: 0.0, ..good },
            ] {
                assert!(DoubleAckermann::new(params).is_err(), "{params:?}");
            }
        }
    }
}
