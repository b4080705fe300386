//! How wheels move a vehicle, and what a vehicle can do.
//!
//! | vehicle | commands | base frame |
//! |---|---|---|
//! | [`DifferentialDrive`] | two wheel speeds | middle of the axle |
//! | [`Ackermann`] | speed of the rear axle, front steering | middle of the rear axle |
//! | [`DoubleAckermann`] | speed of the rear axle, front and rear steering | anywhere between the axles |
//! | [`Tricycle`] | speed and steering of the front wheel | middle of the rear axle |
//! | [`Mecanum`] | four wheel speeds | middle of the four wheels |
//!
//! Wheel speeds are radians per second, positive forwards; steering angles are radians, positive to the left. The
//! motion of a time step is [`Twist2::integrate`], exact on arcs; [`euler_step`] is what the papers print.

mod ackermann;
mod axis;
mod axle;
mod differential;
mod double_ackermann;
mod euler;
mod limits;
mod motion;
mod omnidirectional;
mod steering;
mod tricycle;

use crate::{Error, check, geometry::Twist2};

pub use ackermann::{Ackermann, AckermannParams, AckermannWheels};
pub use axis::{approach, rise};
pub use axle::{AckermannAxle, AxleAngles};
pub use differential::{DifferentialDrive, DifferentialParams, DifferentialWheels};
pub use double_ackermann::{DoubleAckermann, DoubleAckermannParams, DoubleAckermannWheels};
pub use euler::euler_step;
pub use limits::{TwistLimits, stopping_speed};
pub use motion::{Motion, MotionLimits};
pub use omnidirectional::{Mecanum, MecanumParams, MecanumWheels};
pub use steering::SteeringLimits;
pub use tricycle::{Tricycle, TricycleParams, TricycleWheels};

/// The relation between wheel commands and the twist of the base.
///
/// Laws: `inverse` of a twist that the vehicle can do is undone by `forward`; `forward` is linear in the wheel speeds.
pub trait Kinematics {
    /// Speeds and steering angles of the wheels.
    type Wheels;

    /// Twist of the base for these wheel speeds and steering angles.
    fn forward(&self, wheels: &Self::Wheels) -> Twist2;

    /// Wheel speeds and steering angles for the twist.
    ///
    /// Components that the vehicle cannot do (sideways motion of a differential drive) are left out, as every vehicle
    /// does; a twist that has no solution at all is an error.
    ///
    /// # Errors
    /// A twist that is not finite, or that no wheel command comes near to.
    fn inverse(&self, twist: &Twist2) -> Result<Self::Wheels, Error>;
}

/// Refuses a twist that is not finite.
pub(crate) fn finite_twist(name: &'static str, twist: &Twist2) -> Result<(), Error> {
    check::all_finite(name, &[twist.vx, twist.vy, twist.yaw_rate])
}

#[cfg(test)]
mod laws {
    use super::*;

    /// `forward` undoes `inverse` for a twist that the vehicle can do, and bad twists are refused.
    pub(super) fn round_trip<K: Kinematics>(vehicle: &K, twist: &Twist2) {
        let wheels = vehicle.inverse(twist).unwrap();
        let back = vehicle.forward(&wheels);
        for (a, b) in [(back.vx, twist.vx), (back.vy, twist.vy), (back.yaw_rate, twist.yaw_rate)] {
            assert!((a - b).abs() < 1e-11, "{back:?} {twist:?}");
        }
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for twist in [Twist2::new(bad, 0.0, 0.0), Twist2::new(0.0, bad, 0.0), Twist2::new(0.0, 0.0, bad)] {
                assert!(vehicle.inverse(&twist).is_err());
            }
        }
    }
}
