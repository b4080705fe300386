//! What a vehicle can do, all of it: speeds, accelerations, steering and the acceleration to the side, together.
//!
//! | vehicle | how to state it |
//! |---|---|
//! | differential drive, tricycle | [`TwistLimits`] alone |
//! | Ackermann | with [`SteeringLimits`] |
//! | double Ackermann | with [`SteeringLimits::for_double_ackermann`] |
//! | omnidirectional | [`TwistLimits`] with a lateral speed |
//!
//! A vehicle that steers has speed and steering angle as its two degrees of freedom. Its turn rate is their product,
//!
//! ```text
//! yaw rate = v tan(angle) / wheelbase
//! ```
//!
//! so how fast it may change follows from the acceleration and the steering rate: `yaw_acceleration` is for vehicles that
//! turn by their wheels' speeds, and braking in a bend need not wait for it.
//!
//! The limits are told apart by what can wait. How fast speed and angle change is the vehicle's own and always holds. Where
//! the present motion is beyond a speed, an angle or the lateral acceleration (a limit was lowered, a floor was slippery),
//! the motion goes back as fast as the rates allow: [`MotionLimits::step`] does so, and [`MotionLimits::allows_step`] accepts
//! no less.

use super::{
    SteeringLimits, TwistLimits,
    axis::{Axis, TOLERANCE},
    finite_twist,
};
use crate::{Error, check, geometry::Twist2};

/// What a vehicle does at a moment.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Motion {
    /// Velocity in the base frame.
    pub twist: Twist2,
    /// Angle of the (middle) steered wheel, in radians, positive to the left; none for a vehicle that does not steer, and
    /// where it is not known: it is then read off the twist, and straight ahead at rest.
    pub steering: Option<f64>,
}

impl Motion {
    /// Rest, the wheels wherever they are.
    pub const REST: Self = Self { twist: Twist2::ZERO, steering: None };

    /// Whether the twist and the angle are finite.
    pub fn is_finite(&self) -> bool {
        self.twist.is_finite() && self.steering.is_none_or(f64::is_finite)
    }

    fn check(&self, name: &'static str) -> Result<(), Error> {
        finite_twist(name, &self.twist)?;
        check::all_finite("steering", self.steering.iter())
    }
}

impl From<Twist2> for Motion {
    fn from(twist: Twist2) -> Self {
        Self { twist, steering: None }
    }
}

/// All limits of a vehicle's motion.
///
/// ```
/// use agv_core::geometry::Twist2;
/// use agv_core::kinematics::{Motion, MotionLimits, SteeringLimits, TwistLimits};
///
/// let truck = MotionLimits { steering: Some(SteeringLimits::default()), ..TwistLimits::default().into() };
/// let straight = Motion { twist: Twist2::new(1.0, 0.0, 0.0), steering: Some(0.0) };
/// let left = truck.step(&straight, &Twist2::new(1.0, 0.0, 0.5).into(), 0.1)?;
/// assert_eq!(left.steering, Some(0.05)); // as far as the wheels turn in a tenth of a second
/// assert!(truck.allows_step(&straight, &left, 0.1));
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MotionLimits {
    /// Speeds and accelerations.
    pub twist: TwistLimits,
    /// What the steered axle can do; none for a vehicle that turns by its wheels' speeds.
    pub steering: Option<SteeringLimits>,
    /// Greatest acceleration to the side, speed times turn rate, in metres per second squared; none for no limit.
    pub lateral_acceleration: Option<f64>,
}

impl From<TwistLimits> for MotionLimits {
    /// A vehicle that turns by its wheels' speeds, with no limit to its lateral acceleration.
    fn from(twist: TwistLimits) -> Self {
        Self { twist, steering: None, lateral_acceleration: None }
    }
}

impl MotionLimits {
    /// Checks all fields.
    ///
    /// # Errors
    /// The first field that is out of its range, by name.
    pub fn validate(&self) -> Result<(), Error> {
        self.twist.validate()?;
        self.steering.as_ref().map_or(Ok(()), SteeringLimits::validate)?;
        self.lateral_acceleration.map_or(Ok(()), |a| check::non_negative("lateral_acceleration", a).map(|_| ()))
    }

    /// Whether the vehicle can turn on the spot.
    pub fn turns_on_the_spot(&self) -> bool {
        self.steering.is_none() && self.twist.yaw_rate > 0.0
    }

    /// Whether the vehicle can drive in any direction, whichever way it faces; one that steers an axle cannot, whatever its lateral
    /// speed may be.
    #[inline]
    pub fn is_holonomic(&self) -> bool {
        self.steering.is_none() && self.twist.lateral_speed > 0.0
    }

    /// Greatest curvature that the vehicle can drive, in 1/m; infinite for one that turns on the spot.
    pub fn max_curvature(&self) -> f64 {
        self.steering.as_ref().map_or(f64::INFINITY, SteeringLimits::max_curvature)
    }

    /// Greatest speed at which turn rate and lateral acceleration allow a curvature (in 1/m, of either sign), in metres per
    /// second; infinite on a straight line.
    #[inline]
    pub fn speed_in_bend(&self, curvature: f64) -> f64 {
        let curvature = curvature.abs();
        if curvature == 0.0 {
            return f64::INFINITY;
        }
        let sideways = self.lateral_acceleration.map_or(f64::INFINITY, |a| (a / curvature).sqrt());
        sideways.min(self.twist.yaw_rate / curvature)
    }

    /// The fastest twist along the same path that a vehicle can drive on for ever: the curvature is brought to what the
    /// steering allows, then all components are scaled by one factor.
    ///
    /// A vehicle that steers cannot turn on the spot: that becomes rest.
    ///
    /// # Errors
    /// A twist that is not finite, and what [`validate`](Self::validate) says.
    pub fn clamp(&self, twist: &Twist2) -> Result<Twist2, Error> {
        self.validate()?;
        finite_twist("twist", twist)?;
        Ok(self.clamped(twist))
    }

    /// [`clamp`](Self::clamp) of values that were checked.
    fn clamped(&self, twist: &Twist2) -> Twist2 {
        let steered = self.steering.map_or(*twist, |steering| steering.clamped(twist));
        let slow = self.twist.clamped(&steered);
        let Some(limit) = self.lateral_acceleration else { return slow };
        let sideways = slow.speed() * slow.yaw_rate.abs();
        if sideways <= limit + TOLERANCE {
            return slow;
        }
        let scale = (limit / sideways).sqrt();
        Twist2::new(scale * slow.vx, scale * slow.vy, scale * slow.yaw_rate)
    }

    /// The motion after one time step from `current` towards `target`, within all limits at once; see
    /// [`TwistLimits::step`] for how curvature is kept and rest is reached.
    ///
    /// A target without a steering angle means the angle that its twist needs, and the present one at rest; a target at rest
    /// with an angle turns the wheels on the spot. The speed gives way where a bend would be too fast for it, and where
    /// that does not suffice the bend does. Repeated steps reach the target.
    ///
    /// # Errors
    /// A motion that is not finite, a negative `dt`, and what [`validate`](Self::validate) says.
    pub fn step(&self, current: &Motion, target: &Motion, dt: f64) -> Result<Motion, Error> {
        self.validate()?;
        current.check("current twist")?;
        target.check("target twist")?;
        check::non_negative("dt", dt)?;
        Ok(self.step_checked(current, target, dt))
    }

    /// [`step`](Self::step) of values that it would accept, without asking again: for loops that checked limits once. Of others the
    /// result means nothing.
    pub fn step_checked(&self, current: &Motion, target: &Motion, dt: f64) -> Motion {
        match &self.steering {
            Some(steering) => self.step_steered(steering, current, target, dt),
            None => self.step_free(current, target, dt),
        }
    }

    /// As [`step`](Self::step) towards rest, the wheels staying as they are: braking as hard as allowed.
    ///
    /// # Errors
    /// As [`step`](Self::step).
    pub fn brake(&self, current: &Motion, dt: f64) -> Result<Motion, Error> {
        self.step(current, &Motion::REST, dt)
    }

    /// Whether a vehicle can go from one motion to the other in `dt` seconds, up to rounding, within all limits: what
    /// [`step`](Self::step) returns, and what any command must be.
    ///
    /// Steering angles that are not given are read off the twists; at rest the wheels point straight ahead before the step,
    /// and stay as they are in it.
    pub fn allows_step(&self, from: &Motion, to: &Motion, dt: f64) -> bool {
        self.steering.as_ref().map_or_else(
            || self.allows_unsteered(&from.twist, &to.twist, dt),
            |steering| self.allows_steered(steering, from, to, dt),
        )
    }

    fn allows_steered(&self, steering: &SteeringLimits, from: &Motion, to: &Motion, dt: f64) -> bool {
        let twist = to.twist;
        let reach = Reach::new(self, steering, from, twist.vx, dt);
        let (low, high) = (reach.angle.least - TOLERANCE, reach.angle.greatest + TOLERANCE);
        // Without an angle, any in reach that makes the twist will do.
        let (low, high) = to.steering.map_or((low, high), |angle| (angle.max(low), angle.min(high)));
        let lateral = twist.yaw_rate * steering.wheelbase;
        let (a, b) = (twist.vx * low.tan(), twist.vx * high.tan());
        let tolerance = TOLERANCE * (1.0 + lateral.abs());
        reach.speed.reaches_target()
            && to.steering.is_none_or(|angle| angle >= low && angle <= high)
            && twist.vy == 0.0
            && lateral >= a.min(b) - tolerance
            && lateral <= a.max(b) + tolerance
            && twist.yaw_rate.abs() <= exceed(self.twist.yaw_rate.max(reach.least_yaw_rate()))
            && self.lateral_acceleration.is_none_or(|limit| {
                let least = reach.speed.slowest().abs() * reach.least_yaw_rate();
                (twist.vx * twist.yaw_rate).abs() <= exceed(limit.max(least))
            })
    }

    fn allows_unsteered(&self, from: &Twist2, to: &Twist2, dt: f64) -> bool {
        let axes = self.twist.axes(from, to, dt);
        axes.iter().all(Axis::reaches_target)
            && self.lateral_acceleration.is_none_or(|limit| {
                let [x, y, yaw] = axes.map(|axis| axis.slowest());
                to.speed() * to.yaw_rate.abs() <= exceed(limit.max(x.hypot(y) * yaw.abs()))
            })
    }

    /// Distance covered until rest from `speed` m/s, after `reaction_time` seconds at that speed, in metres. No limit but
    /// the deceleration delays a stop.
    ///
    /// # Errors
    /// As [`TwistLimits::stopping_distance`].
    pub fn stopping_distance(&self, speed: f64, reaction_time: f64) -> Result<f64, Error> {
        self.twist.stopping_distance(speed, reaction_time)
    }

    /// Greatest speed, in metres per second, from which the vehicle comes to rest within `distance` metres.
    ///
    /// # Errors
    /// As [`TwistLimits::stopping_speed`].
    pub fn stopping_speed(&self, distance: f64, reaction_time: f64) -> Result<f64, Error> {
        self.twist.stopping_speed(distance, reaction_time)
    }

    fn step_free(&self, current: &Motion, target: &Motion, dt: f64) -> Motion {
        let target = self.clamped(&target.twist);
        let wanted = self.twist.stepped(&current.twist, &target, dt);
        let Some(limit) = self.lateral_acceleration else { return wanted.into() };
        let sideways = wanted.speed() * wanted.yaw_rate.abs();
        if sideways <= limit {
            return wanted.into();
        }
        // On the same curvature if that is in reach, else less of a turn, else less speed too.
        let scale = (limit / sideways).sqrt();
        let [x, y, yaw] = self.twist.axes(&current.twist, &target, dt);
        let (vx, vy) = (x.nearest(scale * wanted.vx), y.nearest(scale * wanted.vy));
        let speed = vx.hypot(vy);
        let most = limit / speed.max(f64::MIN_POSITIVE);
        let yaw_rate = yaw.nearest((scale * wanted.yaw_rate).clamp(-most, most));
        if speed * yaw_rate.abs() <= limit {
            return Twist2::new(vx, vy, yaw_rate).into();
        }
        // The speed is convex along the way to the slowest, so at this share it is low enough.
        let (slow_x, slow_y) = (x.slowest(), y.slowest());
        let excess = speed - limit / yaw_rate.abs();
        let share = (excess / (speed - slow_x.hypot(slow_y)).max(f64::MIN_POSITIVE)).min(1.0);
        let mix = |from: f64, to: f64| from + share * (to - from);
        Twist2::new(x.nearest(mix(vx, slow_x)), y.nearest(mix(vy, slow_y)), yaw_rate).into()
    }

    fn step_steered(&self, steering: &SteeringLimits, current: &Motion, target: &Motion, dt: f64) -> Motion {
        let wanted = self.clamped(&target.twist);
        let reach = Reach::new(self, steering, current, wanted.vx, dt);
        let angle = match target.steering {
            Some(angle) => angle,
            None if wanted.vx != 0.0 => (steering.wheelbase * wanted.yaw_rate / wanted.vx).atan(),
            None => reach.present,
        };
        let angle = reach.angle.nearest(angle.clamp(-steering.max_angle, steering.max_angle));
        let vx = reach.speed.nearest(wanted.vx);
        // Slower on the same bend; where braking does not suffice, on a wider one.
        let most = self.speed_in_bend(steering.curvature(angle));
        let vx = reach.speed.nearest(vx.clamp(-most, most));
        let sideways = self.lateral_acceleration.map_or(f64::INFINITY, |a| a / (vx * vx));
        let most = (steering.wheelbase * sideways.min(self.twist.yaw_rate / vx.abs())).atan();
        // At rest any angle will do, and 0/0 is no bound.
        let angle = if vx == 0.0 { angle } else { reach.angle.nearest(angle.clamp(-most, most)) };
        let twist = Twist2::new(vx, 0.0, vx * steering.curvature(angle));
        Motion { twist, steering: Some(angle) }
    }
}

/// A hair more, for what was rounded on the way.
fn exceed(limit: f64) -> f64 {
    limit * (1.0 + 1e-9) + TOLERANCE
}

/// What a vehicle that steers can reach in one step.
struct Reach {
    speed: Axis,
    angle: Axis,
    /// Its steering angle now.
    present: f64,
    wheelbase: f64,
}

impl Reach {
    fn new(limits: &MotionLimits, steering: &SteeringLimits, from: &Motion, target_speed: f64, dt: f64) -> Self {
        let (vx, yaw_rate) = (from.twist.vx, from.twist.yaw_rate);
        let read = if vx == 0.0 { 0.0 } else { (steering.wheelbase * yaw_rate / vx).atan() };
        let present = from.steering.unwrap_or(read);
        let (limit, rate) = (steering.max_angle, steering.max_rate);
        let [speed, ..] = limits.twist.axes(&from.twist, &Twist2::new(target_speed, 0.0, 0.0), dt);
        let angle = Axis::new(present, present, rate, rate, dt, (-limit, limit));
        Self { speed, angle, present, wheelbase: steering.wheelbase }
    }

    /// Turn rate after braking and straightening as hard as allowed, unsigned.
    fn least_yaw_rate(&self) -> f64 {
        (self.speed.slowest() * self.angle.slowest().tan() / self.wheelbase).abs()
    }
}

#[cfg(test)]
mod tests;
