//! Velocity and acceleration limits of a vehicle, and the twists that respect them.
//!
//! Two clamps keep the path: [`TwistLimits::clamp`] scales all components by one factor, so that the curvature stays
//! what the planner chose, and [`TwistLimits::step`] does so within what one time step can change. Acceleration and
//! deceleration are told apart by whether the speed grows, with a step through zero paid in two parts: time to stop at
//! the deceleration, the rest at the acceleration.

use super::{
    axis::{Axis, TOLERANCE},
    finite_twist,
};
use crate::{Error, check, geometry::Twist2};

/// Limits on the twist of the base and on its change; magnitudes, all at least zero.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TwistLimits {
    /// Greatest forward speed, in metres per second.
    pub forward_speed: f64,
    /// Greatest reverse speed, in metres per second; zero forbids reversing.
    pub reverse_speed: f64,
    /// Greatest sideways speed, in metres per second; zero for all but omnidirectional vehicles.
    pub lateral_speed: f64,
    /// Greatest turn rate, in radians per second.
    pub yaw_rate: f64,
    /// Greatest increase of speed, in metres per second squared.
    pub acceleration: f64,
    /// Greatest decrease of speed, in metres per second squared.
    pub deceleration: f64,
    /// Greatest change of the turn rate, in radians per second squared.
    pub yaw_acceleration: f64,
}

impl Default for TwistLimits {
    /// An indoor AGV with a load: 1 m/s, 1 rad/s, half a metre per second squared (paper 001, section 4).
    fn default() -> Self {
        Self {
            forward_speed: 1.0,
            reverse_speed: 0.3,
            lateral_speed: 0.0,
            yaw_rate: 1.0,
            acceleration: 0.5,
            deceleration: 0.5,
            yaw_acceleration: 1.0,
        }
    }
}

impl TwistLimits {
    /// Checks all fields.
    ///
    /// # Errors
    /// [`Error::Negative`](crate::Error::Negative) or [`Error::NotPositive`](crate::Error::NotPositive) names the
    /// first field that is out of its range.
    pub fn validate(&self) -> Result<(), Error> {
        check::non_negative("forward_speed", self.forward_speed)?;
        check::non_negative("reverse_speed", self.reverse_speed)?;
        check::non_negative("lateral_speed", self.lateral_speed)?;
        check::non_negative("yaw_rate", self.yaw_rate)?;
        check::positive("acceleration", self.acceleration)?;
        check::positive("deceleration", self.deceleration)?;
        check::positive("yaw_acceleration", self.yaw_acceleration)?;
        Ok(())
    }

    /// The fastest twist along the same path that respects the speed limits: all components scaled by one factor.
    ///
    /// A sideways part is left out first where `lateral_speed` is zero. A twist that needs a motion that is forbidden
    /// (reversing, turning) becomes rest.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for a twist that is not, and what [`validate`](Self::validate) says.
    ///
    /// ```
    /// use agv_core::geometry::Twist2;
    /// use agv_core::kinematics::TwistLimits;
    ///
    /// let twist = TwistLimits::default().clamp(&Twist2::new(4.0, 0.0, 1.0))?;
    /// assert_eq!(twist, Twist2::new(1.0, 0.0, 0.25)); // still the circle of 4 m radius
    /// # Ok::<(), agv_core::Error>(())
    /// ```
    pub fn clamp(&self, twist: &Twist2) -> Result<Twist2, Error> {
        self.validate()?;
        finite_twist("twist", twist)?;
        Ok(self.clamped(twist))
    }

    /// [`clamp`](Self::clamp) of values that were checked.
    pub(super) fn clamped(&self, twist: &Twist2) -> Twist2 {
        let vy = if self.lateral_speed == 0.0 { 0.0 } else { twist.vy };
        let forward_or_back = if twist.vx < 0.0 { self.reverse_speed } else { self.forward_speed };
        let scale = [(twist.vx, forward_or_back), (vy, self.lateral_speed), (twist.yaw_rate, self.yaw_rate)]
            .iter()
            .filter(|(value, limit)| value.abs() > limit + TOLERANCE)
            .fold(1.0_f64, |scale, (value, limit)| scale.min(limit / value.abs()));
        Twist2::new(scale * twist.vx, scale * vy, scale * twist.yaw_rate)
    }

    /// The twist after one time step from `current` towards `target`, within the limits of speed and acceleration.
    ///
    /// `target` is clamped along its curvature first. If it cannot be reached in `dt` seconds, the result is the
    /// multiple of it nearest to one that can be, so the curvature is the target's. On the way to rest each component
    /// brakes as hard as it may, so that [`stopping_distance`](Self::stopping_distance) is kept whatever the vehicle turns.
    /// Where no multiple can be reached (the vehicle is on another curvature), each component goes as near
    /// to the target as it can. Repeated steps reach the target. From a `current` that exceeds the speed limits the
    /// step brakes as hard as allowed.
    ///
    /// # Errors
    /// [`Error::NotFinite`] for a twist that is not, [`Error::Negative`] for `dt`, and what
    /// [`validate`](Self::validate) says.
    pub fn step(&self, current: &Twist2, target: &Twist2, dt: f64) -> Result<Twist2, Error> {
        finite_twist("current twist", current)?;
        check::non_negative("dt", dt)?;
        Ok(self.stepped(current, &self.clamp(target)?, dt))
    }

    /// [`step`](Self::step) between values that were checked, to a target that was clamped.
    pub(super) fn stepped(&self, current: &Twist2, target: &Twist2, dt: f64) -> Twist2 {
        let axes = self.axes(current, target, dt);
        if axes.iter().all(Axis::reaches_target) {
            return *target;
        }
        let along = [target.vx, target.vy, target.yaw_rate];
        let (least, greatest) = axes
            .iter()
            .zip(along)
            .map(|(axis, along)| axis.multiples(along))
            .fold((f64::NEG_INFINITY, f64::INFINITY), |(a, b), (c, d)| (a.max(c), b.min(d)));
        let [vx, vy, yaw_rate] = if *target != Twist2::ZERO && least <= greatest && least < f64::INFINITY {
            let multiple = 1.0_f64.clamp(least, greatest);
            along.map(|along| multiple * along)
        } else {
            // Rest has no curvature of its own, and keeping the present one would let a slow turn delay the stop.
            along
        };
        // Also after the multiple, whose rounding may lead a hair out of reach.
        let [x, y, yaw] = axes;
        Twist2::new(x.nearest(vx), y.nearest(vy), yaw.nearest(yaw_rate))
    }

    /// Whether the twist keeps to the speed limits, up to rounding.
    pub fn allows(&self, twist: &Twist2) -> bool {
        self.axes(twist, twist, 0.0).iter().all(Axis::keeps_speed)
    }

    /// Whether a vehicle can go from one twist to the other in `dt` seconds, up to rounding, within the limits of
    /// speed and acceleration: what [`step`](Self::step) returns, and what any command must be. From a twist that
    /// exceeds a speed limit (the limit was lowered) braking as hard as allowed is allowed.
    pub fn allows_step(&self, from: &Twist2, to: &Twist2, dt: f64) -> bool {
        self.axes(from, to, dt).iter().all(Axis::reaches_target)
    }

    /// The components of a step from `current` to `target`.
    ///
    /// A vehicle that cannot move sideways has no such component: what is measured of it is slip, not for it to brake.
    pub(super) fn axes(&self, current: &Twist2, target: &Twist2, dt: f64) -> [Axis; 3] {
        let (a, d, yaw) = (self.acceleration, self.deceleration, self.yaw_acceleration);
        let sideways = if self.lateral_speed == 0.0 { 0.0 } else { current.vy };
        [
            Axis::new(target.vx, current.vx, a, d, dt, (-self.reverse_speed, self.forward_speed)),
            Axis::new(target.vy, sideways, a, d, dt, (-self.lateral_speed, self.lateral_speed)),
            Axis::new(target.yaw_rate, current.yaw_rate, yaw, yaw, dt, (-self.yaw_rate, self.yaw_rate)),
        ]
    }

    /// Distance covered until rest from `speed` m/s, after `reaction_time` seconds at that speed, in metres:
    /// `v t + v² / (2 deceleration)`.
    ///
    /// # Errors
    /// A speed that is not finite, a negative reaction time, and what [`validate`](Self::validate) says.
    pub fn stopping_distance(&self, speed: f64, reaction_time: f64) -> Result<f64, Error> {
        self.validate()?;
        let speed = check::finite("speed", speed)?.abs();
        let reaction_time = check::non_negative("reaction_time", reaction_time)?;
        Ok(speed * reaction_time + 0.5 * speed * speed / self.deceleration)
    }

    /// Greatest speed, in metres per second, from which the vehicle comes to rest within `distance` metres: the
    /// inverse of [`stopping_distance`](Self::stopping_distance). Zero if there is no room.
    ///
    /// # Errors
    /// A distance or a reaction time that is not finite and at least zero, and what [`validate`](Self::validate) says.
    pub fn stopping_speed(&self, distance: f64, reaction_time: f64) -> Result<f64, Error> {
        self.validate()?;
        check::non_negative("distance", distance)?;
        check::non_negative("reaction_time", reaction_time)?;
        Ok(stopping_speed(distance, self.deceleration, reaction_time))
    }
}

/// Greatest rate from which a stop within `distance` is possible at `deceleration` when `reaction_time` seconds pass at
/// it first: the root of `v²/(2 d) + v t = s`. Serves metres and radians alike; zero if there is no room.
#[inline]
pub fn stopping_speed(distance: f64, deceleration: f64, reaction_time: f64) -> f64 {
    if distance <= 0.0 {
        return 0.0;
    }
    // Written so that nothing cancels for small distances.
    let lag = deceleration * reaction_time;
    2.0 * deceleration * distance / ((lag * lag + 2.0 * deceleration * distance).sqrt() + lag)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn limits() -> TwistLimits {
        TwistLimits { lateral_speed: 0.5, deceleration: 0.8, ..Default::default() }
    }

    fn twists() -> impl Strategy<Value = Twist2> {
        (-3.0..3.0_f64, -1.5..1.5_f64, -3.0..3.0_f64).prop_map(|(vx, vy, w)| Twist2::new(vx, vy, w))
    }

    fn within_speeds(t: &Twist2, l: &TwistLimits) -> bool {
        t.vx <= l.forward_speed + 1e-12
            && t.vx >= -l.reverse_speed - 1e-12
            && t.vy.abs() <= l.lateral_speed + 1e-12
            && t.yaw_rate.abs() <= l.yaw_rate + 1e-12
    }

    /// Time that the change of one component needs, braking and accelerating each at its own rate.
    fn time_needed(from: f64, to: f64, acceleration: f64, deceleration: f64) -> f64 {
        if from * to < 0.0 {
            return from.abs() / deceleration + to.abs() / acceleration;
        }
        let growth = to.abs() - from.abs();
        if growth > 0.0 { growth / acceleration } else { -growth / deceleration }
    }

    proptest! {
        #[test]
        fn clamping_respects_limits_keeps_the_path_and_is_idempotent(twist in twists()) {
            let l = limits();
            let clamped = l.clamp(&twist).unwrap();
            prop_assert!(within_speeds(&clamped, &l));
            prop_assert!((clamped.vx * twist.yaw_rate - clamped.yaw_rate * twist.vx).abs() < 1e-12);
            prop_assert!((clamped.vy * twist.yaw_rate - clamped.yaw_rate * twist.vy).abs() < 1e-12);
            prop_assert_eq!(l.clamp(&clamped).unwrap(), clamped);
            if within_speeds(&twist, &l) {
                prop_assert_eq!(clamped, twist);
            }
        }

        #[test]
        fn steps_respect_every_limit_and_are_idempotent(current in twists(), target in twists(), dt in 0.01..0.5_f64) {
            let l = limits();
            let current = l.clamp(&current).unwrap();
            let next = l.step(&current, &target, dt).unwrap();
            prop_assert!(within_speeds(&next, &l), "{:?}", next);
            for (from, to, a, d) in [
                (current.vx, next.vx, l.acceleration, l.deceleration),
                (current.vy, next.vy, l.acceleration, l.deceleration),
                (current.yaw_rate, next.yaw_rate, l.yaw_acceleration, l.yaw_acceleration),
            ] {
                prop_assert!(time_needed(from, to, a, d) <= dt + 1e-11, "{} -> {}", from, to);
            }
            prop_assert_eq!(l.step(&current, &next, dt).unwrap(), next);
        }

        /// Speeding up or slowing down on one curvature never leaves it, through any number of steps.
        #[test]
        fn one_curvature_is_kept(curvature in -2.0..2.0_f64, from in 0.0..1.0_f64, to in 0.01..1.0_f64) {
            let l = limits();
            let mut twist = l.clamp(&Twist2::new(from, 0.0, from * curvature)).unwrap();
            let target = Twist2::new(to, 0.0, to * curvature);
            for _ in 0..60 {
                twist = l.step(&twist, &target, 0.1).unwrap();
                prop_assert!((twist.yaw_rate - curvature * twist.vx).abs() < 1e-9, "{:?}", twist);
            }
            let reached = l.clamp(&target).unwrap();
            prop_assert!((twist.vx - reached.vx).abs() < 1e-9, "{:?} {:?}", twist, reached);
        }

        /// Braking step by step stays within the stopping distance, whatever the vehicle turns and slides.
        #[test]
        fn braking_keeps_the_stopping_distance(twist in twists(), yaw_acceleration in 0.1..3.0_f64, dt in 0.01..0.5_f64) {
            let l = TwistLimits { yaw_acceleration, ..limits() };
            let mut twist = l.clamp(&twist).unwrap();
            let promised = l.stopping_distance(twist.speed(), dt).unwrap();
            let mut travelled = 0.0;
            // From the fastest, 1.1 m/s, in the shortest steps, of 0.008 m/s each.
            for _ in 0..200 {
                travelled += twist.speed() * dt;
                twist = l.step(&twist, &Twist2::ZERO, dt).unwrap();
            }
            prop_assert_eq!(twist.speed(), 0.0);
            prop_assert!(travelled <= promised + 1e-12, "{} beyond {}", travelled, promised);
        }

        /// From anywhere the target is reached, and stays.
        #[test]
        fn steps_arrive(current in twists(), target in twists()) {
            let l = limits();
            let (mut twist, goal) = (l.clamp(&current).unwrap(), l.clamp(&target).unwrap());
            for _ in 0..100 {
                twist = l.step(&twist, &target, 0.1).unwrap();
            }
            prop_assert_eq!(twist, goal);
        }

        #[test]
        fn stopping_distance_and_speed_are_inverse(speed in 0.01..3.0_f64, reaction in 0.0..1.0_f64) {
            let distance = limits().stopping_distance(speed, reaction).unwrap();
            prop_assert!((limits().stopping_speed(distance, reaction).unwrap() - speed).abs() < 1e-12);
        }
    }

    #[test]
    fn a_step_through_zero_brakes_then_accelerates() {
        // 0.08 m/s are braked in 0.1 s at 0.8 m/s²; the other 0.1 s accelerate to -0.05 m/s at 0.5 m/s².
        let next = limits().step(&Twist2::new(0.08, 0.0, 0.0), &Twist2::new(-0.3, 0.0, 0.0), 0.2).unwrap();
        assert!((next.vx + 0.05).abs() < 1e-12, "{next:?}");
    }

    #[test]
    fn a_vehicle_above_its_limits_brakes_as_hard_as_allowed() {
        let next = limits().step(&Twist2::new(2.0, 0.0, 0.0), &Twist2::new(2.0, 0.0, 0.0), 0.1).unwrap();
        assert!((next.vx - 1.92).abs() < 1e-12, "{next:?}");
    }

    #[test]
    fn what_is_forbidden_becomes_rest_and_sideways_is_left_out() {
        let l = TwistLimits { reverse_speed: 0.0, lateral_speed: 0.0, ..Default::default() };
        assert_eq!(l.clamp(&Twist2::new(-0.5, 0.0, 0.3)).unwrap().speed(), 0.0);
        assert_eq!(l.clamp(&Twist2::new(0.5, 0.3, 0.0)), Ok(Twist2::new(0.5, 0.0, 0.0)));
    }

    #[test]
    fn bad_input_is_refused() {
        let (l, ok) = (limits(), Twist2::ZERO);
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let twist = Twist2::new(0.0, bad, 0.0);
            assert!(l.clamp(&twist).is_err() && l.step(&twist, &ok, 0.1).is_err() && l.step(&ok, &twist, 0.1).is_err());
            assert!(l.step(&ok, &ok, bad).is_err());
            assert!(l.stopping_distance(bad, 0.0).is_err() && l.stopping_speed(bad, 0.0).is_err());
            assert!(l.stopping_distance(1.0, bad).is_err() && l.stopping_speed(1.0, bad).is_err());
        }
        assert!(l.step(&ok, &ok, -0.1).is_err() && l.stopping_speed(-1.0, 0.0).is_err());
        for limits in [
            TwistLimits { yaw_acceleration: f64::NAN, ..l },
            TwistLimits { deceleration: 0.0, ..l },
            TwistLimits { forward_speed: -1.0, ..l },
        ] {
            assert!(limits.validate().is_err() && limits.clamp(&ok).is_err() && limits.step(&ok, &ok, 0.1).is_err());
            assert!(limits.stopping_distance(1.0, 0.0).is_err() && limits.stopping_speed(1.0, 0.0).is_err());
        }
    }
}
