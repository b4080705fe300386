//! What a steered axle can do: angle, rate, and the turning radius that follows.
//!
//! ```text
//! curvature = tan(angle) / wheelbase            turning radius = 1 / curvature
//! ```

use super::finite_twist;
use crate::{Error, check, geometry::Twist2};
use std::f64::consts::FRAC_PI_2;

/// Rounding that a clamped steering angle may carry, in radians.
pub(super) const SLACK: f64 = 1e-12;

/// Limits of a steered axle.
///
/// ```
/// use agv_core::geometry::Twist2;
/// use agv_core::kinematics::SteeringLimits;
///
/// let limits = SteeringLimits::for_turning_radius(1.2, 2.0, 0.5)?;
/// let twist = limits.clamp(&Twist2::new(1.0, 0.0, 3.0))?;
/// assert_eq!((twist.vx, twist.yaw_rate), (1.0, 0.5)); // same speed, the tightest circle
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SteeringLimits {
    /// Distance between the axles, in metres.
    pub wheelbase: f64,
    /// Greatest steering angle to either side, in radians; above zero and below a quarter turn.
    pub max_angle: f64,
    /// Greatest rate of the steering angle, in radians per second.
    pub max_rate: f64,
}

impl Default for SteeringLimits {
    /// The tugger of [`AckermannParams`](super::AckermannParams); 0.5 rad/s turn the wheels from stop to stop in 2.4 s.
    fn default() -> Self {
        Self { wheelbase: 1.2, max_angle: 35_f64.to_radians(), max_rate: 0.5 }
    }
}

impl SteeringLimits {
    /// The limits of a vehicle whose least turning radius at the rear axle is `radius` metres.
    ///
    /// # Errors
    /// [`Error::NotPositive`] names the argument that is not finite and positive.
    pub fn for_turning_radius(wheelbase: f64, radius: f64, max_rate: f64) -> Result<Self, Error> {
        check::positive("radius", radius)?;
        let limits = Self { wheelbase, max_angle: (wheelbase / radius).atan(), max_rate };
        limits.validate().map(|()| limits)
    }

    /// The limits of a vehicle that steers both axles against each other, so that its base frame does not move sideways.
    ///
    /// The angle is then that of the front axle, `a` ahead of the base, and the rear one, `b` behind it, follows with
    /// `tan(rear) = -b/a tan(front)`: the bicycle model with a wheelbase of `a`. Both axles keep their greatest angle and
    /// `max_rate` (radians per second).
    ///
    /// # Errors
    /// A geometry that is none, or one without a steered front axle ahead of the base.
    pub fn for_double_ackermann(params: &super::DoubleAckermannParams, max_rate: f64) -> Result<Self, Error> {
        super::DoubleAckermann::new(*params)?;
        let super::DoubleAckermannParams { front, rear, max_front_steering, max_rear_steering, .. } = *params;
        let ratio = rear / check::positive("front", front)?;
        let tan =
            max_front_steering.tan().min(if rear == 0.0 { f64::INFINITY } else { max_rear_steering.tan() / ratio });
        // The rear axle turns `ratio (1 + t²) / (1 + ratio² t²)` times as fast as the front one, most at one end of t.
        let faster = |t: f64| ratio * (1.0 + t * t) / (1.0 + ratio * ratio * t * t);
        let rear_rate = faster(0.0).max(faster(tan)).max(1.0);
        let limits = Self { wheelbase: front, max_angle: tan.atan(), max_rate: max_rate / rear_rate };
        limits.validate().map(|()| limits)
    }

    /// Checks all fields.
    ///
    /// # Errors
    /// [`Error::NotPositive`] or [`Error::OutOfRange`] names the first field that is out of its range.
    pub fn validate(&self) -> Result<(), Error> {
        check::positive("wheelbase", self.wheelbase)?;
        check::in_range("max_angle", self.max_angle, f64::MIN_POSITIVE, FRAC_PI_2.next_down())?;
        check::positive("max_rate", self.max_rate)?;
        Ok(())
    }

    /// Greatest curvature of the rear axle's path, in radians per metre.
    pub fn max_curvature(&self) -> f64 {
        self.max_angle.tan() / self.wheelbase
    }

    /// Least turning radius of the rear axle, in metres.
    pub fn min_turning_radius(&self) -> f64 {
        self.wheelbase / self.max_angle.tan()
    }

    /// Curvature of the rear axle's path for a steering angle in radians.
    pub fn curvature(&self, angle: f64) -> f64 {
        angle.tan() / self.wheelbase
    }

    /// The same speed on the nearest curvature that the steering allows. Sideways motion is left out, and a turn on
    /// the spot becomes rest.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for a twist that is not, and what [`validate`](Self::validate) says.
    pub fn clamp(&self, twist: &Twist2) -> Result<Twist2, Error> {
        self.validate()?;
        finite_twist("twist", twist)?;
        Ok(self.clamped(twist))
    }

    /// [`clamp`](Self::clamp) of values that were checked.
    pub(super) fn clamped(&self, twist: &Twist2) -> Twist2 {
        // Apart at rest, where an absurdly short wheelbase would make it NaN.
        let limit = if twist.vx == 0.0 { 0.0 } else { self.max_curvature() * twist.vx.abs() };
        Twist2::new(twist.vx, 0.0, twist.yaw_rate.max(-limit).min(limit))
    }

    /// The steering angle nearest to `target` that can be reached from `current` in `dt` seconds, within the limits.
    ///
    /// A `current` beyond the greatest angle is brought back at the greatest rate.
    ///
    /// # Errors
    /// An angle that is not finite, a negative `dt`, and what [`validate`](Self::validate) says.
    pub fn step(&self, current: f64, target: f64, dt: f64) -> Result<f64, Error> {
        self.validate()?;
        check::finite("current steering", current)?;
        check::finite("target steering", target)?;
        let reach = self.max_rate * check::non_negative("dt", dt)?;
        Ok(target.clamp(-self.max_angle, self.max_angle).clamp(current - reach, current + reach))
    }

    /// The twist at the same speed with the steering as near to the wanted one as `dt` seconds allow, and that
    /// steering angle. At a speed of zero the wheels stay.
    ///
    /// # Errors
    /// As [`step`](Self::step) and [`clamp`](Self::clamp).
    pub fn clamp_step(&self, current: f64, twist: &Twist2, dt: f64) -> Result<(Twist2, f64), Error> {
        let wanted = self.clamp(twist)?;
        let target = if wanted.vx == 0.0 { current } else { (self.wheelbase * wanted.yaw_rate / wanted.vx).atan() };
        let angle = self.step(current, target, dt)?;
        Ok((Twist2::new(wanted.vx, 0.0, wanted.vx * self.curvature(angle)), angle))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn clamping_respects_the_radius_and_is_idempotent(v in -3.0..3.0_f64, w in -3.0..3.0_f64) {
            let limits = SteeringLimits::default();
            let twist = limits.clamp(&Twist2::new(v, 0.0, w)).unwrap();
            prop_assert_eq!(twist.vx, v);
            prop_assert!(twist.yaw_rate.abs() * limits.min_turning_radius() <= v.abs() + 1e-12);
            prop_assert_eq!(limits.clamp(&twist).unwrap(), twist);
        }

        #[test]
        fn steps_respect_rate_and_angle_and_arrive(start in -0.6..0.6_f64, target in -0.6..0.6_f64) {
            let limits = SteeringLimits::default();
            let mut angle = start;
            for _ in 0..30 {
                let next = limits.step(angle, target, 0.1).unwrap();
                prop_assert!((next - angle).abs() <= 0.05 + 1e-12 && next.abs() <= limits.max_angle);
                angle = next;
            }
            prop_assert_eq!(angle, target);
        }

        /// The twist of a step is on the arc of the angle that is returned with it.
        #[test]
        fn a_clamped_step_is_consistent(current in -0.6..0.6_f64, v in -2.0..2.0_f64, w in -2.0..2.0_f64) {
            let limits = SteeringLimits::default();
            let (twist, angle) = limits.clamp_step(current, &Twist2::new(v, 0.0, w), 0.1).unwrap();
            prop_assert!((twist.yaw_rate * limits.wheelbase - twist.vx * angle.tan()).abs() < 1e-12);
            prop_assert!((angle - current).abs() <= 0.05 + 1e-12);
        }
    }

    #[test]
    fn radius_and_angle_are_two_names_of_one_limit() {
        let limits = SteeringLimits::for_turning_radius(1.2, 2.0, 0.5).unwrap();
        assert!((limits.min_turning_radius() - 2.0).abs() < 1e-12 && (limits.max_curvature() - 0.5).abs() < 1e-12);
    }

    #[test]
    fn bad_input_is_refused() {
        let good = SteeringLimits::default();
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(SteeringLimits { wheelbase: bad, ..good }.validate().is_err());
            assert!(SteeringLimits { max_angle: bad, ..good }.validate().is_err());
            assert!(SteeringLimits { max_rate: bad, ..good }.validate().is_err());
            assert!(SteeringLimits::for_turning_radius(1.2, bad, 0.5).is_err());
        }
        for bad in [f64::NAN, f64::INFINITY] {
            assert!(good.clamp(&Twist2::new(1.0, 0.0, bad)).is_err());
            assert!(
                good.step(bad, 0.0, 0.1).is_err()
                    && good.step(0.0, bad, 0.1).is_err()
                    && good.step(0.0, 0.0, bad).is_err()
            );
        }
        assert!(good.step(0.0, 0.0, -0.1).is_err());
        let broken = SteeringLimits { max_angle: -1.0, ..good };
        assert!(broken.clamp(&Twist2::ZERO).is_err() && broken.step(0.0, 0.0, 0.1).is_err());
    }
}
