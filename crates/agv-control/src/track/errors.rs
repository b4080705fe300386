//! The vehicle relative to its course, as the optimal trackers see it: by the filtered pose, not the measured one.

use super::{
    follower::{in_gear, leading_end},
    observer::Observer,
    steering::SteeringInput,
};
use agv_core::{
    geometry::{LieGroup, Twist2},
    path::Course,
    roles::TrackError,
};

/// Errors of the vehicle, and what it does, in the frame of the leading end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TrackingErrors {
    /// Arc length of the nearest point of the course.
    pub(super) arc_length: f64,
    pub(super) cross_track: f64,
    pub(super) heading: f64,
    /// What the wheels do.
    pub(super) actual: Twist2,
    /// What they steer to, where they do.
    pub(super) steering: Option<f64>,
    /// Turn rate of the vehicle per turn rate of its wheels.
    pub(super) slip: f64,
}

/// Farthest that the filtered pose is looked for from the projection of the measured one, in metres.
const NEAR: f64 = 0.25;

impl TrackingErrors {
    /// Projects what an observer, which has seen the state, says.
    pub(super) fn of(observer: &Observer, input: &SteeringInput<'_>) -> Result<Self, TrackError> {
        let (pose, motion) = observer.estimate();
        let heading = leading_end(pose.rotation(), input.gear);
        let measured = input.projection.arc_length;
        let mut arc_length = measured;
        let mut cross_track = 0.0;
        for _ in 0..4 {
            let (point, direction) = input.course.point_at(arc_length).ok_or(TrackError::NoPath)?;
            let offset = direction.inverse().act(&(pose.translation() - point));
            arc_length = (arc_length + offset.x).clamp(measured - NEAR, measured + NEAR);
            cross_track = offset.y;
        }
        Ok(Self {
            arc_length,
            cross_track,
            heading: input.course.angle_from(arc_length, heading).ok_or(TrackError::NoPath)?,
            actual: in_gear(&motion.twist, input.gear),
            steering: motion.steering,
            slip: observer.slip(),
        })
    }
}

/// Curvature of the section that is being driven; beyond its end it goes on straight.
pub(super) fn curvature(course: &Course, arc_length: f64) -> f64 {
    if arc_length > course.section_end() { 0.0 } else { course.curvature_at(arc_length) }
}

/// The twist that the vehicle can reach in this cycle which has the speed nearest to a wanted one, and then the turn rate.
///
/// The follower would keep the curvature of one that is out of reach; a feedback wants the turn rate kept.
pub(super) fn reachable(input: &SteeringInput<'_>, speed: f64, yaw_rate: f64) -> Twist2 {
    let (limits, now, dt) = (input.limits, input.twist, input.dt);
    let vx = reachable_speed(input, speed);
    if let Some(steering) = &limits.steering {
        let most = steering.max_curvature() * vx.abs();
        return Twist2::new(vx, 0.0, yaw_rate.max(-most).min(most));
    }
    let change = limits.twist.yaw_acceleration * dt;
    let sideways = limits.lateral_acceleration.map_or(f64::INFINITY, |a| a / vx.abs());
    let most = limits.twist.yaw_rate.min(sideways);
    Twist2::new(vx, 0.0, yaw_rate.clamp(-most, most).clamp(now.yaw_rate - change, now.yaw_rate + change))
}

/// The speed nearest to a wanted one that the vehicle can reach in this cycle.
pub(super) fn reachable_speed(input: &SteeringInput<'_>, speed: f64) -> f64 {
    let (limits, now) = (&input.limits.twist, input.twist.vx);
    let slow = limits.deceleration * input.dt;
    let fast = if now < 0.0 { slow } else { limits.acceleration * input.dt };
    speed.clamp(now - slow, now + fast)
}
