//! Two driven wheels on one axle.
//!
//! ```text
//! v = (r_r w_r + r_l w_l) / 2            yaw rate = (r_r w_r - r_l w_l) / track
//! ```
//!
//! Paper 000, Eq. 2 prints the product of the wheel speeds in the turn rate: a lost minus sign. The radii are kept
//! apart because calibration finds them apart (see [`crate::odometry::UmbMark`]).

use super::{Kinematics, finite_twist};
use crate::{Error, check, geometry::Twist2};

/// Geometry of a differential drive.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DifferentialParams {
    /// Radius of the left wheel, in metres.
    pub left_radius: f64,
    /// Radius of the right wheel, in metres.
    pub right_radius: f64,
    /// Distance between the contact points of the two wheels, in metres.
    pub track: f64,
}

impl Default for DifferentialParams {
    /// A small indoor AGV: 20 cm wheels, half a metre apart (the 0.5 m vehicle of paper 001, section 4).
    fn default() -> Self {
        Self { left_radius: 0.1, right_radius: 0.1, track: 0.5 }
    }
}

/// Wheel speeds of a differential drive; or wheel angles, where an increment is meant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DifferentialWheels {
    /// Speed of the left wheel, in radians per second.
    pub left: f64,
    /// Speed of the right wheel, in radians per second.
    pub right: f64,
}

/// A vehicle with two driven wheels and casters. The base frame is in the middle between the driven wheels.
///
/// ```
/// use agv_core::geometry::Twist2;
/// use agv_core::kinematics::{DifferentialDrive, DifferentialParams, Kinematics};
///
/// let drive = DifferentialDrive::new(DifferentialParams::default())?;
/// let wheels = drive.inverse(&Twist2::new(1.0, 0.0, 0.4))?;
/// assert!((wheels.left - 9.0).abs() < 1e-12 && (wheels.right - 11.0).abs() < 1e-12);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DifferentialDrive {
    params: DifferentialParams,
}

impl DifferentialDrive {
    /// A vehicle of this geometry.
    ///
    /// # Errors
    /// [`Error::NotPositive`] names the first length that is not finite and positive.
    pub fn new(params: DifferentialParams) -> Result<Self, Error> {
        check::positive("left_radius", params.left_radius)?;
        check::positive("right_radius", params.right_radius)?;
        check::positive("track", params.track)?;
        Ok(Self { params })
    }

    /// The geometry it was built with.
    pub const fn params(&self) -> &DifferentialParams {
        &self.params
    }
}

impl Kinematics for DifferentialDrive {
    type Wheels = DifferentialWheels;

    #[inline]
    fn forward(&self, wheels: &Self::Wheels) -> Twist2 {
        let (left, right) = (self.params.left_radius * wheels.left, self.params.right_radius * wheels.right);
        Twist2::new(0.5 * (right + left), 0.0, (right - left) / self.params.track)
    }

    /// Sideways motion is left out.
    #[inline]
    fn inverse(&self, twist: &Twist2) -> Result<Self::Wheels, Error> {
        finite_twist("twist", twist)?;
        let half = 0.5 * self.params.track * twist.yaw_rate;
        Ok(DifferentialWheels {
            left: (twist.vx - half) / self.params.left_radius,
            right: (twist.vx + half) / self.params.right_radius,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinematics::laws;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn forward_undoes_inverse(v in -3.0..3.0_f64, w in -3.0..3.0_f64, ratio in 0.9..1.1_f64) {
            let params = DifferentialParams { left_radius: 0.1 * ratio, ..Default::default() };
            laws::round_trip(&DifferentialDrive::new(params).unwrap(), &Twist2::new(v, 0.0, w));
        }
    }

    /// The larger wheel runs farther: equal speeds turn the vehicle towards the smaller one.
    #[test]
    fn equal_speeds_turn_towards_the_smaller_wheel() {
        let params = DifferentialParams { right_radius: 0.11, ..Default::default() };
        let twist = DifferentialDrive::new(params).unwrap().forward(&DifferentialWheels { left: 1.0, right: 1.0 });
        assert!(twist.yaw_rate > 0.0 && twist.vx > 0.0);
    }

    #[test]
    fn bad_geometry_is_named() {
        let good = DifferentialParams::default();
        for bad in [0.0, -0.1, f64::NAN, f64::INFINITY] {
            for (name, params) in [
                ("left_radius", DifferentialParams { left_radius: bad, ..good }),
                ("right_radius", DifferentialParams { right_radius: bad, ..good }),
                ("track", DifferentialParams { track: bad, ..good }),
            ] {
                let error = DifferentialDrive::new(params).unwrap_err();
                assert!(error.to_string().starts_with(name), "{error}");
            }
        }
    }
}
