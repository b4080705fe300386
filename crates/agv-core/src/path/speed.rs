//! How fast to drive: the greatest speed at every place of a course from which all bends ahead can be entered.
//!
//! One backward pass over the course per path and set of limits,
//!
//! ```text
//! v(s)² = min( bend(s)², v(s + Δ)² + 2 deceleration Δ )
//! ```
//!
//! and a look-up per cycle. There is no forward pass: how fast the vehicle gets there is the limits' affair, and its speed at the
//! beginning is its own.

use super::course::{Bend, Course};
use crate::kinematics::MotionLimits;

/// Greatest speed along a course.
///
/// ```
/// use agv_core::kinematics::MotionLimits;
/// use agv_core::nalgebra::Vector2;
/// use agv_core::path::{Course, Path, SpeedProfile};
///
/// let mut course = Course::new(0.5);
/// course.set(&Path::from_positions(&[Vector2::new(0.0, 0.0), Vector2::new(9.0, 0.0), Vector2::new(9.0, 9.0)])?)?;
/// let mut profile = SpeedProfile::default();
/// profile.update(&course, &MotionLimits::default());
/// assert!(profile.speed_at(9.0) < profile.speed_at(4.0), "it slows down for the corner");
/// # Ok::<(), agv_core::Error>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SpeedProfile {
    per_metre: f64,
    /// Squared speed at each knot of the course, in m²/s².
    squares: Vec<f64>,
}

impl SpeedProfile {
    /// Greatest speed at an arc length, in metres per second, so that every bend ahead can be entered by braking; the stop at
    /// the end of a section is not in it. O(1).
    #[inline]
    pub fn speed_at(&self, arc_length: f64) -> f64 {
        let Some(last) = self.squares.len().checked_sub(1) else { return 0.0 };
        let place = (arc_length * self.per_metre).clamp(0.0, last as f64);
        let knot = place as usize;
        let at = |i: usize| self.squares.get(i.min(last)).copied().unwrap_or(0.0);
        // Squares, so that between two knots the speed is that of braking, too.
        let share = place - knot as f64;
        (at(knot) * (1.0 - share) + at(knot + 1) * share).sqrt()
    }

    /// Forgets the speeds and makes room for those of another course.
    pub fn make_room(&mut self, course: &Course) {
        self.squares.clear();
        self.squares.reserve(course.bends().len());
    }

    /// Computes the speeds; the limits are taken as valid. O(length of the course).
    pub fn update(&mut self, course: &Course, limits: &MotionLimits) {
        self.per_metre = 1.0 / course.knot_spacing();
        let braking = 2.0 * limits.twist.deceleration * course.knot_spacing();
        let top = limits.twist.forward_speed.max(limits.twist.reverse_speed);
        self.squares.clear();
        self.squares.extend(course.bends().iter().map(|bend| bend_speed(bend, limits).min(top).powi(2)));
        let mut ahead = f64::INFINITY;
        for square in self.squares.iter_mut().rev() {
            ahead = square.min(ahead + braking);
            *square = ahead;
        }
    }
}

/// Speed allowed in a bend by turn rate and lateral acceleration, and, where the bend begins or ends, by how fast the vehicle can
/// change its turn: by the yaw acceleration, `v² dκ/ds`, or by the steering rate, `v dκ/ds wheelbase / (1 + (wheelbase κ)²)`.
///
/// A bend too tight for the steering is driven as slowly as the tightest there is.
fn bend_speed(bend: &Bend, limits: &MotionLimits) -> f64 {
    let curvature = bend.curvature.abs().min(limits.max_curvature());
    let limit = |limit: f64, per: f64| if per > 0.0 { limit / per } else { f64::INFINITY };
    let entering = match &limits.steering {
        Some(steering) => {
            let slope = steering.wheelbase * curvature;
            limit(steering.max_rate * (1.0 + slope * slope), steering.wheelbase * bend.change)
        }
        None => limit(limits.twist.yaw_acceleration, bend.change).sqrt(),
    };
    limits.speed_in_bend(curvature).min(entering)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        kinematics::{SteeringLimits, TwistLimits},
        nalgebra::Vector2,
        path::Path,
    };
    use proptest::prelude::*;

    proptest! {
        /// Nowhere faster than the bend there, and nowhere so fast that the next place cannot be reached by braking.
        #[test]
        fn every_bend_can_be_entered(
            turns in prop::collection::vec((-2.5..2.5_f64, 0.05..3.0_f64), 1..20), deceleration in 0.1..2.0_f64, steered: bool,
        ) {
            let (mut at, mut yaw) = (Vector2::zeros(), 0.0_f64);
            let mut positions = vec![at];
            for (turn, ahead) in turns {
                yaw += turn;
                at += Vector2::new(yaw.cos(), yaw.sin()) * ahead;
                positions.push(at);
            }
            let mut course = Course::new(0.5);
            course.set(&Path::from_positions(&positions).unwrap()).unwrap();
            let limits = MotionLimits {
                twist: TwistLimits { deceleration, ..TwistLimits::default() },
                steering: steered.then(SteeringLimits::default),
                lateral_acceleration: Some(0.4),
            };
            let mut profile = SpeedProfile::default();
            profile.update(&course, &limits);
            let step = 0.01;
            for i in 0..(course.length() / step) as usize {
                let s = i as f64 * step;
                let (here, next) = (profile.speed_at(s), profile.speed_at(s + step));
                prop_assert!(here * here <= next * next + 2.0 * deceleration * step + 1e-9, "{s}: {here} {next}");
                prop_assert!(here <= 1.0);
            }
            for (i, bend) in course.bends().iter().enumerate() {
                let speed = profile.speed_at(i as f64 * course.knot_spacing());
                prop_assert!(speed <= bend_speed(bend, &limits) + 1e-9);
            }
        }
    }

    #[test]
    fn each_limit_of_the_vehicle_slows_it() {
        let twist = TwistLimits { yaw_rate: 1.0, yaw_acceleration: 0.5, ..TwistLimits::default() };
        let limits = |a| MotionLimits { lateral_acceleration: Some(a), ..twist.into() };
        assert_eq!(bend_speed(&Bend { curvature: 0.0, change: 0.0 }, &limits(0.5)), f64::INFINITY);
        assert_eq!(bend_speed(&Bend { curvature: -4.0, change: 0.0 }, &limits(100.0)), 0.25);
        assert_eq!(bend_speed(&Bend { curvature: 0.5, change: 0.0 }, &limits(0.125)), 0.5);
        assert_eq!(bend_speed(&Bend { curvature: 0.1, change: 8.0 }, &limits(100.0)), 0.25);
        // 0.5 rad/s of steering on a wheelbase of 1.2 m change the curvature by 0.42 1/m a second.
        let truck = MotionLimits { steering: Some(SteeringLimits::default()), ..limits(100.0) };
        let speed = bend_speed(&Bend { curvature: 0.0, change: 1.0 }, &truck);
        assert!((speed - 0.5 / 1.2).abs() < 1e-12);
    }

    #[test]
    fn there_is_no_speed_without_a_course() {
        assert_eq!(SpeedProfile::default().speed_at(1.0), 0.0);
    }
}
