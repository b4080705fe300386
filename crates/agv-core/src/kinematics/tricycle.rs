//! One wheel in front that both drives and steers, as pallet trucks have it.
//!
//! The front wheel rolls along its own heading, the rear axle along the vehicle's; with the base frame in the middle of
//! the rear axle
//!
//! ```text
//! v = r w cos(steering)            yaw rate = r w sin(steering) / wheelbase
//! ```
//!
//! which stays finite at a quarter turn of the wheel: the vehicle then turns on the spot.

use super::{Kinematics, finite_twist, steering::SLACK};
use crate::{Error, check, geometry::Twist2};
use std::f64::consts::FRAC_PI_2;

/// Geometry of a tricycle.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TricycleParams {
    /// Distance from the rear axle to the front wheel, in metres.
    pub wheelbase: f64,
    /// Radius of the front wheel, in metres.
    pub wheel_radius: f64,
    /// Greatest steering angle to either side, in radians; at most a quarter turn.
    pub max_steering: f64,
}

impl Default for TricycleParams {
    /// A pallet truck: 1.3 m wheelbase, 23 cm wheel, steering to a quarter turn.
    fn default() -> Self {
        Self { wheelbase: 1.3, wheel_radius: 0.115, max_steering: FRAC_PI_2 }
    }
}

/// Commands of a tricycle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TricycleWheels {
    /// Speed of the front wheel, in radians per second.
    pub drive: f64,
    /// Angle of the front wheel, in radians.
    pub steering: f64,
}

/// A vehicle with a driven and steered front wheel. The base frame is in the middle of the rear axle.
///
/// ```
/// use agv_core::geometry::Twist2;
/// use agv_core::kinematics::{Kinematics, Tricycle, TricycleParams};
///
/// let truck = Tricycle::new(TricycleParams::default())?;
/// let spin = truck.inverse(&Twist2::new(0.0, 0.0, 0.5))?;
/// assert_eq!(spin.steering, std::f64::consts::FRAC_PI_2);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tricycle {
    params: TricycleParams,
}

impl Tricycle {
    /// A vehicle of this geometry.
    ///
    /// # Errors
    /// [`Error::NotPositive`] for a length, [`Error::OutOfRange`] for a steering angle outside (0, π/2].
    pub fn new(params: TricycleParams) -> Result<Self, Error> {
        check::positive("wheelbase", params.wheelbase)?;
        check::positive("wheel_radius", params.wheel_radius)?;
        check::in_range("max_steering", params.max_steering, f64::MIN_POSITIVE, FRAC_PI_2)?;
        Ok(Self { params })
    }

    /// The geometry it was built with.
    pub const fn params(&self) -> &TricycleParams {
        &self.params
    }
}

impl Kinematics for Tricycle {
    type Wheels = TricycleWheels;

    #[inline]
    fn forward(&self, wheels: &Self::Wheels) -> Twist2 {
        let rim = self.params.wheel_radius * wheels.drive;
        let (sin, cos) = wheels.steering.sin_cos();
        Twist2::new(rim * cos, 0.0, rim * sin / self.params.wheelbase)
    }

    /// Sideways motion is left out; the wheel runs backwards for reverse motion instead of turning around, and points
    /// straight ahead at rest.
    ///
    /// # Errors
    /// A twist that is not finite, or [`Error::OutOfRange`] for a turn that is tighter than the steering allows.
    #[inline]
    fn inverse(&self, twist: &Twist2) -> Result<Self::Wheels, Error> {
        finite_twist("twist", twist)?;
        let TricycleParams { wheelbase, wheel_radius, max_steering } = self.params;
        let lateral = wheelbase * twist.yaw_rate;
        let sign = if twist.vx < 0.0 { -1.0 } else { 1.0 };
        let steering = if lateral == 0.0 { 0.0 } else { (sign * lateral).atan2(twist.vx.abs()) };
        check::in_range("steering", steering, -max_steering - SLACK, max_steering + SLACK)?;
        Ok(TricycleWheels { drive: sign * twist.vx.hypot(lateral) / wheel_radius, steering })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::laws;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn forward_undoes_inverse(v in -2.0..2.0_f64, w in -2.0..2.0_f64) {
            laws::round_trip(&Tricycle::new(TricycleParams::default()).unwrap(), &Twist2::new(v, 0.0, w));
        }

        /// The steering angle is continuous through rest: driving off backwards needs no half turn of the wheel.
        #[test]
        fn reverse_motion_mirrors_the_drive(v in 0.01..2.0_f64, w in -2.0..2.0_f64) {
            let truck = Tricycle::new(TricycleParams::default()).unwrap();
            let (a, b) = (truck.inverse(&Twist2::new(v, 0.0, w)).unwrap(), truck.inverse(&Twist2::new(-v, 0.0, -w)).unwrap());
            prop_assert_eq!((a.drive, a.steering), (-b.drive, b.steering));
        }
    }

    #[test]
    fn a_limited_wheel_refuses_tight_turns() {
        let params = TricycleParams { max_steering: 1.0, ..Default::default() };
        let truck = Tricycle::new(params).unwrap();
        assert!(matches!(truck.inverse(&Twist2::new(0.0, 0.0, 0.5)), Err(Error::OutOfRange { name: "steering", .. })));
    }

    #[test]
    fn bad_geometry_is_named() {
        let good = TricycleParams::default();
        for bad in [0.0, -0.1, f64::NAN, f64::INFINITY] {
            for (name, params) in [
                ("wheelbase", TricycleParams { wheelbase: bad, ..good }),
                ("wheel_radius", TricycleParams { wheel_radius: bad, ..good }),
                ("max_steering", TricycleParams { max_steering: bad, ..good }),
            ] {
                let error = Tricycle::new(params).unwrap_err();
                assert!(error.to_string().starts_with(name), "{error}");
            }
        }
    }
}
