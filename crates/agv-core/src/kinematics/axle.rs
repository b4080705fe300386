//! The two wheels of a real steered axle.
//!
//! All wheels roll about one centre, a distance `R = wheelbase / tan(steering)` to the left of the rear axle's middle;
//! the inner front wheel must turn more than the outer one:
//!
//! ```text
//! tan(left) = wheelbase / (R - track/2)        tan(right) = wheelbase / (R + track/2)
//! ```
//!
//! which is Ackermann's condition `cot(outer) - cot(inner) = track / wheelbase`.

use crate::{Error, check};

/// A front axle whose wheels turn as Ackermann's condition says.
///
/// ```
/// use agv_core::kinematics::AckermannAxle;
///
/// let axle = AckermannAxle::new(1.2, 0.8)?;
/// let angles = axle.wheel_angles(0.4)?;
/// assert!(angles.left > 0.4 && angles.right < 0.4); // a left turn: the left wheel is the inner one
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AckermannAxle {
    wheelbase: f64,
    track: f64,
}

/// Angles of the two wheels of an axle.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AxleAngles {
    /// Angle of the left wheel, in radians.
    pub left: f64,
    /// Angle of the right wheel, in radians.
    pub right: f64,
}

impl AckermannAxle {
    /// An axle of `track` metres between its steering pivots, `wheelbase` metres ahead of the rear axle.
    ///
    /// # Errors
    /// [`Error::NotPositive`] names the length that is not finite and positive.
    pub fn new(wheelbase: f64, track: f64) -> Result<Self, Error> {
        check::positive("wheelbase", wheelbase)?;
        check::positive("track", track)?;
        Ok(Self { wheelbase, track })
    }

    /// Greatest angle of the imagined middle wheel: there the inner wheel stands across, and the vehicle turns about
    /// its inner rear wheel. In radians.
    pub fn max_steering(&self) -> f64 {
        (2.0 * self.wheelbase / self.track).atan()
    }

    /// Angles of both wheels for the angle of the imagined middle wheel, in radians.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] beyond [`max_steering`](Self::max_steering), and for NaN.
    pub fn wheel_angles(&self, steering: f64) -> Result<AxleAngles, Error> {
        let limit = self.max_steering();
        check::in_range("steering", steering, -limit, limit)?;
        let lift = self.wheelbase * steering.tan();
        let shift = 0.5 * self.track * steering.tan();
        // The denominators are not negative up to the limit, so that atan2 stays in its middle branch.
        Ok(AxleAngles { left: lift.atan2(self.wheelbase - shift), right: lift.atan2(self.wheelbase + shift) })
    }

    /// Angle of the imagined middle wheel for measured wheel angles: the mean of the two curvatures that they state.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for an angle at or beyond a quarter turn, and for NaN.
    pub fn steering(&self, angles: &AxleAngles) -> Result<f64, Error> {
        let limit = std::f64::consts::FRAC_PI_2;
        check::in_range("left", angles.left, -limit, limit)?;
        check::in_range("right", angles.right, -limit, limit)?;
        let half = 0.5 * self.track;
        // Curvature from one wheel: sin / (wheelbase cos ± track/2 sin), finite up to a wheel that stands across.
        let curvature = |angle: f64, half: f64| angle.sin() / (self.wheelbase * angle.cos() + half * angle.sin());
        let mean = 0.5 * (curvature(angles.left, half) + curvature(angles.right, -half));
        Ok((self.wheelbase * mean).atan())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn ackermanns_condition_holds_and_angles_round_trip(steering in 0.01..1.2_f64, left in any::<bool>()) {
            let axle = AckermannAxle::new(1.2, 0.8).unwrap();
            let angles = axle.wheel_angles(if left { steering } else { -steering }).unwrap();
            let (inner, outer) = if left { (angles.left, angles.right) } else { (-angles.right, -angles.left) };
            prop_assert!((1.0 / outer.tan() - 1.0 / inner.tan() - 0.8 / 1.2).abs() < 1e-9);
            prop_assert!((axle.steering(&angles).unwrap().abs() - steering).abs() < 1e-12);
        }
    }

    #[test]
    fn straight_is_straight() {
        let axle = AckermannAxle::new(1.2, 0.8).unwrap();
        assert_eq!(axle.wheel_angles(0.0), Ok(AxleAngles::default()));
        assert_eq!(axle.steering(&AxleAngles::default()), Ok(0.0));
    }

    #[test]
    fn at_the_limit_the_inner_wheel_stands_across() {
        let axle = AckermannAxle::new(1.2, 0.8).unwrap();
        let angles = axle.wheel_angles(axle.max_steering()).unwrap();
        assert!((angles.left - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    }

    #[test]
    fn bad_input_is_refused() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(AckermannAxle::new(bad, 0.8).is_err());
            assert!(AckermannAxle::new(1.2, bad).is_err());
        }
        let axle = AckermannAxle::new(1.2, 0.8).unwrap();
        for bad in [2.0, -2.0, f64::NAN, f64::INFINITY] {
            assert!(axle.wheel_angles(bad).is_err());
            assert!(axle.steering(&AxleAngles { left: bad, right: 0.0 }).is_err());
            assert!(axle.steering(&AxleAngles { left: 0.0, right: bad }).is_err());
        }
    }
}
