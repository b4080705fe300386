//! Four mecanum wheels with rollers at 45°.
//!
//! With the rollers of the wheels pointing to the vehicle's middle where seen from above as an X (the usual mounting)
//! and `l = (wheelbase + track) / 2`, the rim speeds are (Taheri, Qiao and Ghaeminezhad 2015, Eq. 20)
//!
//! ```text
//! front left  = vx - vy - l yaw_rate        front right = vx + vy + l yaw_rate
//! rear left   = vx + vy - l yaw_rate        rear right  = vx - vy + l yaw_rate
//! ```
//!
//! Four speeds, three unknowns: the columns are orthogonal, so least squares is three signed means, and what is left
//! over has the one direction (1, 1, -1, -1) in which the wheels fight each other.

use super::{Kinematics, finite_twist};
use crate::{Error, check, geometry::Twist2};

/// Geometry of a mecanum vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MecanumParams {
    /// Radius of the wheels, in metres.
    pub wheel_radius: f64,
    /// Distance between the front and rear wheels, in metres.
    pub wheelbase: f64,
    /// Distance between the left and right wheels, in metres.
    pub track: f64,
}

impl Default for MecanumParams {
    /// A load carrier on 8-inch wheels.
    fn default() -> Self {
        Self { wheel_radius: 0.1016, wheelbase: 0.6, track: 0.5 }
    }
}

/// Wheel speeds of a mecanum vehicle, in radians per second; or wheel angles, where an increment is meant.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MecanumWheels {
    /// Front left wheel.
    pub front_left: f64,
    /// Front right wheel.
    pub front_right: f64,
    /// Rear left wheel.
    pub rear_left: f64,
    /// Rear right wheel.
    pub rear_right: f64,
}

/// A vehicle that moves in any direction. The base frame is in the middle of the four wheels.
///
/// ```
/// use agv_core::geometry::Twist2;
/// use agv_core::kinematics::{Kinematics, Mecanum, MecanumParams};
///
/// let carrier = Mecanum::new(MecanumParams::default())?;
/// let mut wheels = carrier.inverse(&Twist2::new(0.0, 0.5, 0.0))?; // to the left
/// assert!(wheels.front_left < 0.0 && wheels.rear_left > 0.0);
/// assert!(carrier.slip(&wheels).abs() < 1e-12);
///
/// wheels.front_left += 1.0; // one wheel spins
/// assert!(carrier.slip(&wheels).abs() > 0.02);
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mecanum {
    params: MecanumParams,
    /// `(wheelbase + track) / 2`, the lever of a wheel in rotation.
    lever: f64,
}

impl Mecanum {
    /// A vehicle of this geometry.
    ///
    /// # Errors
    /// [`Error::NotPositive`] names the first length that is not finite and positive.
    pub fn new(params: MecanumParams) -> Result<Self, Error> {
        check::positive("wheel_radius", params.wheel_radius)?;
        check::positive("wheelbase", params.wheelbase)?;
        check::positive("track", params.track)?;
        Ok(Self { params, lever: 0.5 * (params.wheelbase + params.track) })
    }

    /// The geometry it was built with.
    pub const fn params(&self) -> &MecanumParams {
        &self.params
    }

    /// Rim speed, in metres per second, that no motion of the vehicle explains: each wheel slips by this amount, the
    /// front ones forwards and the rear ones backwards where it is positive.
    pub fn slip(&self, wheels: &MecanumWheels) -> f64 {
        let fight = wheels.front_left + wheels.front_right - wheels.rear_left - wheels.rear_right;
        0.25 * self.params.wheel_radius * fight
    }
}

impl Kinematics for Mecanum {
    type Wheels = MecanumWheels;

    /// The twist that explains the four speeds best in the sense of least squares; [`Mecanum::slip`] is what is left.
    #[inline]
    fn forward(&self, wheels: &Self::Wheels) -> Twist2 {
        let MecanumWheels { front_left, front_right, rear_left, rear_right } = *wheels;
        let quarter = 0.25 * self.params.wheel_radius;
        Twist2::new(
            quarter * (front_left + front_right + rear_left + rear_right),
            quarter * (front_right - front_left + rear_left - rear_right),
            quarter * (front_right - front_left - rear_left + rear_right) / self.lever,
        )
    }

    #[inline]
    fn inverse(&self, twist: &Twist2) -> Result<Self::Wheels, Error> {
        finite_twist("twist", twist)?;
        let (turn, radius) = (self.lever * twist.yaw_rate, self.params.wheel_radius);
        Ok(MecanumWheels {
            front_left: (twist.vx - twist.vy - turn) / radius,
            front_right: (twist.vx + twist.vy + turn) / radius,
            rear_left: (twist.vx + twist.vy - turn) / radius,
            rear_right: (twist.vx - twist.vy + turn) / radius,
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
        fn forward_undoes_inverse(vx in -2.0..2.0_f64, vy in -2.0..2.0_f64, w in -2.0..2.0_f64) {
            laws::round_trip(&Mecanum::new(MecanumParams::default()).unwrap(), &Twist2::new(vx, vy, w));
        }

        /// Least squares: what the best twist leaves over is the slip, and it is orthogonal to every motion.
        #[test]
        fn the_residual_is_the_slip(speeds in prop::array::uniform4(-20.0..20.0_f64)) {
            let carrier = Mecanum::new(MecanumParams::default()).unwrap();
            let [front_left, front_right, rear_left, rear_right] = speeds;
            let wheels = MecanumWheels { front_left, front_right, rear_left, rear_right };
            let best = carrier.inverse(&carrier.forward(&wheels)).unwrap();
            let slip = carrier.slip(&wheels) / carrier.params().wheel_radius;
            for (measured, explained, sign) in [
                (front_left, best.front_left, 1.0),
                (front_right, best.front_right, 1.0),
                (rear_left, best.rear_left, -1.0),
                (rear_right, best.rear_right, -1.0),
            ] {
                prop_assert!((measured - explained - sign * slip).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn bad_geometry_is_named() {
        let good = MecanumParams::default();
        for bad in [0.0, -0.1, f64::NAN, f64::INFINITY] {
            for (name, params) in [
                ("wheel_radius", MecanumParams { wheel_radius: bad, ..good }),
                ("wheelbase", MecanumParams { wheelbase: bad, ..good }),
                ("track", MecanumParams { track: bad, ..good }),
            ] {
                let error = Mecanum::new(params).unwrap_err();
                assert!(error.to_string().starts_with(name), "{error}");
            }
        }
    }
}
