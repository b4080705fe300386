//! The dynamic window: which velocities the vehicle can reach in a time, and samples of them.

use super::lead::steering_angle;
use agv_core::{
    kinematics::{Motion, MotionLimits, rise},
    path::Gear,
};

/// Least and greatest reachable value of each component: forward and sideways speed, and turn rate, or curvature for a vehicle that steers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    /// Forward speed, in metres per second.
    pub forward: (f64, f64),
    /// Sideways speed, in metres per second.
    pub lateral: (f64, f64),
    /// Turn rate, in radians per second, or curvature, in 1/m.
    pub turn: (f64, f64),
}

impl Window {
    /// What can be reached from `current` within `time` seconds, and is within the limits; `cap` is the greatest speed in the gear
    /// that the way ahead allows.
    ///
    /// ```
    /// use agv_core::geometry::Twist2;
    /// use agv_core::kinematics::MotionLimits;
    /// use agv_core::path::Gear;
    /// use agv_plan::local::Window;
    ///
    /// let limits = MotionLimits::default();
    /// let window = Window::new(&Twist2::new(0.5, 0.0, 0.0).into(), &limits, 0.2, Gear::Forward, 0.55);
    /// assert_eq!(window.forward, (0.4, 0.55));
    /// assert_eq!(window.turn, (-0.2, 0.2));
    /// ```
    pub fn new(current: &Motion, limits: &MotionLimits, time: f64, gear: Gear, cap: f64) -> Self {
        let (twist, at_most) = (&limits.twist, |limit: f64, on: bool| if on { limit.min(cap) } else { limit });
        let (up, down) = (twist.acceleration, twist.deceleration);
        let top = at_most(twist.forward_speed, gear == Gear::Forward);
        let back = at_most(twist.reverse_speed, gear == Gear::Reverse);
        let forward = reach(current.twist.vx, up, down, time, (-back, top));
        let side = twist.lateral_speed.min(cap);
        let lateral =
            if limits.is_holonomic() { reach(current.twist.vy, up, down, time, (-side, side)) } else { (0.0, 0.0) };
        let turn = if let Some(steering) = &limits.steering {
            let angle = steering_angle(current, limits);
            let rate = steering.max_rate;
            let (low, high) = reach(angle, rate, rate, time, (-steering.max_angle, steering.max_angle));
            (steering.curvature(low), steering.curvature(high))
        } else {
            let change = twist.yaw_acceleration;
            reach(current.twist.yaw_rate, change, change, time, (-twist.yaw_rate, twist.yaw_rate))
        };
        Self { forward, lateral, turn }
    }
}

/// What a value can become in a time, its magnitude growing at `up` and shrinking at `down`, within limits if these are in reach.
fn reach(now: f64, up: f64, down: f64, time: f64, (least, most): (f64, f64)) -> (f64, f64) {
    let (lowest, highest) = (-rise(-now, up, down, time), rise(now, up, down, time));
    (lowest.max(least).min(highest), highest.min(most).max(lowest))
}

/// Calls `each` with `count` values from the least to the greatest, and with zero and `present` if they are in between.
pub(crate) fn samples((low, high): (f64, f64), count: usize, present: f64, mut each: impl FnMut(f64)) {
    if high <= low {
        return each(low);
    }
    for i in 0..count {
        each(if i + 1 == count { high } else { low + (high - low) * (i as f64 / (count - 1).max(1) as f64) });
    }
    let spacing = (high - low) / (count - 1).max(1) as f64;
    let is_sampled = |value: f64| {
        let place = (value - low) / spacing;
        (place - place.round()).abs() < 1e-9
    };
    for (value, wanted) in [(0.0, true), (present, present != 0.0)] {
        if wanted && value > low && value < high && !is_sampled(value) {
            each(value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use agv_core::{geometry::Twist2, roles::laws};
    use proptest::prelude::*;

    proptest! {
        /// The window's corners are what the limits allow a step of that time to reach.
        #[test]
        fn corners_can_be_reached(
            vx in -0.3..1.0_f64, yaw_rate in -1.0..1.0_f64, vehicle in 0..4_usize, time in 0.05..1.0_f64,
            acceleration in 0.2..2.0_f64, deceleration in 0.2..2.0_f64,
        ) {
            let mut limits = laws::vehicles()[vehicle].1;
            limits.lateral_acceleration = None;
            (limits.twist.acceleration, limits.twist.deceleration) = (acceleration, deceleration);
            let current = limits.step(&Motion::REST, &Twist2::new(vx, 0.0, yaw_rate).into(), 9.0).unwrap();
            let window = Window::new(&current, &limits, time, Gear::Forward, f64::INFINITY);
            for vx in [window.forward.0, window.forward.1] {
                for turn in [window.turn.0, window.turn.1] {
                    let motion = match &limits.steering {
                        Some(steering) => {
                            let angle = (turn * steering.wheelbase).atan();
                            let yaw_rate = (vx * turn).clamp(-1.0, 1.0);
                            prop_assume!(yaw_rate == vx * turn);
                            Motion { twist: Twist2::new(vx, 0.0, yaw_rate), steering: Some(angle) }
                        }
                        None => Twist2::new(vx, 0.0, turn).into(),
                    };
                    prop_assert!(limits.allows_step(&current, &motion, time * (1.0 + 1e-9)), "{current:?} {motion:?}");
                }
            }
        }

        #[test]
        fn edges_zero_and_the_present_are_sampled(low in -2.0..1.0_f64, width in 0.0..2.0_f64, count in 2..20_usize, at in 0.0..1.0_f64) {
            let (high, present) = (low + width, low + at * width);
            let mut values = Vec::new();
            samples((low, high), count, present, |value| values.push(value));
            let has = |value: f64| values.iter().any(|v| (v - value).abs() < 1e-8);
            prop_assert!(has(low) && has(high) && has(present) && (has(0.0) || low > 0.0 || high < 0.0));
            prop_assert!(values.len() <= count + 2 && values.iter().all(|v| (low..=high).contains(v)));
        }
    }
}
