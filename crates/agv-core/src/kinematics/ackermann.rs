//! The bicycle model of a vehicle that steers with its front axle.
//!
//! The front wheel rolls along its own heading and the rear wheel along the vehicle's, so with the base frame in the
//! middle of the rear axle (Rajamani 2012, section 2.2, without slip)
//!
//! ```text
//! v = r w            yaw rate = v tan(steering) / wheelbase
//! ```

use super::{Kinematics, SteeringLimits, finite_twist};
use crate::{Error, check, geometry::Twist2};

/// Geometry of a vehicle with a driven rear axle and a steered front axle.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AckermannParams {
    /// Distance between the axles, in metres.
    pub wheelbase: f64,
    /// Radius of the driven wheels, in metres.
    pub wheel_radius: f64,
    /// Greatest steering angle to either side, in radians; below a quarter turn.
    pub max_steering: f64,
}

impl Default for AckermannParams {
    /// A tugger of 1.2 m wheelbase that steers by 35°: 1.7 m turning radius, which fits a 4 m aisle.
    fn default() -> Self {
        Self { wheelbase: 1.2, wheel_radius: 0.15, max_steering: 35_f64.to_radians() }
    }
}

/// Commands of an Ackermann vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AckermannWheels {
    /// Speed of the driven rear axle (the mean of its wheels), in radians per second.
    pub drive: f64,
    /// Angle of the imagined middle front wheel, in radians; [`AckermannAxle`](super::AckermannAxle) has the real two.
    pub steering: f64,
}

/// A car-like vehicle. The base frame is in the middle of the rear axle.
///
/// ```
/// use agv_core::geometry::Twist2;
/// use agv_core::kinematics::{Ackermann, AckermannParams, Kinematics};
///
/// let truck = Ackermann::new(AckermannParams::default())?;
/// let wheels = truck.inverse(&Twist2::new(-1.0, 0.0, 0.5))?; // backwards on a circle of 2 m radius
/// assert!(wheels.drive < 0.0 && (wheels.steering + 0.6_f64.atan()).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ackermann {
    params: AckermannParams,
}

impl Ackermann {
    /// A vehicle of this geometry.
    ///
    /// # Errors
    /// [`Error::NotPositive`] for a length, [`Error::OutOfRange`] for a steering angle outside (0, π/2).
    pub fn new(params: AckermannParams) -> Result<Self, Error> {
        check::positive("wheel_radius", params.wheel_radius)?;
        SteeringLimits { wheelbase: params.wheelbase, max_angle: params.max_steering, max_rate: 1.0 }.validate()?;
        Ok(Self { params })
    }

    /// The geometry it was built with.
    pub const fn params(&self) -> &AckermannParams {
        &self.params
    }
}

impl Kinematics for Ackermann {
    type Wheels = AckermannWheels;

    #[inline]
    fn forward(&self, wheels: &Self::Wheels) -> Twist2 {
        let v = self.params.wheel_radius * wheels.drive;
        Twist2::new(v, 0.0, v * wheels.steering.tan() / self.params.wheelbase)
    }

    /// Sideways motion is left out; at rest the wheels point straight ahead.
    ///
    /// # Errors
    /// A twist that is not finite, or [`Error::OutOfRange`] for a turn that is tighter than the steering allows, such
    /// as one on the spot: [`SteeringLimits::clamp`] gives the nearest that can be driven.
    #[inline]
    fn inverse(&self, twist: &Twist2) -> Result<Self::Wheels, Error> {
        finite_twist("twist", twist)?;
        let AckermannParams { wheelbase, wheel_radius, max_steering } = self.params;
        let steering = if twist.yaw_rate == 0.0 { 0.0 } else { (wheelbase * twist.yaw_rate / twist.vx).atan() };
        check::in_range(
            "steering",
            steering,
            -max_steering - super::steering::SLACK,
            max_steering + super::steering::SLACK,
        )?;
        Ok(AckermannWheels { drive: twist.vx / wheel_radius, steering })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::laws;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn forward_undoes_inverse(v in prop_oneof![-3.0..-0.01_f64, 0.01..3.0_f64], curvature in -0.58..0.58_f64) {
            laws::round_trip(&Ackermann::new(AckermannParams::default()).unwrap(), &Twist2::new(v, 0.0, v * curvature));
        }

        /// Both axles roll without slip: the velocity of a point at the front axle is along the front wheel.
        #[test]
        fn the_front_wheel_does_not_slip(drive in -9.0..9.0_f64, steering in -0.6..0.6_f64) {
            let truck = Ackermann::new(AckermannParams::default()).unwrap();
            let twist = truck.forward(&AckermannWheels { drive, steering });
            let sideways = twist.yaw_rate * truck.params().wheelbase * steering.cos() - twist.vx * steering.sin();
            prop_assert!(sideways.abs() < 1e-12);
        }
    }

    #[test]
    fn a_turn_on_the_spot_is_refused_and_rest_is_not() {
        let truck = Ackermann::new(AckermannParams::default()).unwrap();
        assert!(matches!(truck.inverse(&Twist2::new(0.0, 0.0, 0.1)), Err(Error::OutOfRange { name: "steering", .. })));
        assert_eq!(truck.inverse(&Twist2::ZERO), Ok(AckermannWheels::default()));
    }

    #[test]
    fn bad_geometry_is_named() {
        let good = AckermannParams::default();
        for bad in [0.0, -0.1, f64::NAN, f64::INFINITY] {
            for (name, params) in [
                ("wheelbase", AckermannParams { wheelbase: bad, ..good }),
                ("wheel_radius", AckermannParams { wheel_radius: bad, ..good }),
                ("max_angle", AckermannParams { max_steering: bad, ..good }),
            ] {
                let error = Ackermann::new(params).unwrap_err();
                assert!(error.to_string().starts_with(name), "{error}");
            }
        }
    }
}
