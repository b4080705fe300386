//! How to move: the part in which trackers differ.

use super::{
    course::{Course, Projection},
    speed::SpeedProfile,
};
use agv_core::{
    geometry::{So2, Twist2},
    kinematics::MotionLimits,
    path::Gear,
    roles::{TrackError, VehicleState},
};

/// What a steering law knows in one cycle.
///
/// Everything but `state` is in the direction of travel: on a reverse section the vehicle's tail leads, and `heading` is the
/// tail's.
#[derive(Debug, Clone, Copy)]
pub struct SteeringInput<'a> {
    /// The path, with [`Course::point_at`] for points ahead.
    pub course: &'a Course,
    /// Greatest speed for the bends ahead, by arc length, for laws that look ahead.
    pub profile: &'a SpeedProfile,
    /// The vehicle's place on the path.
    pub projection: Projection,
    /// The vehicle's position in the map, in metres.
    pub position: nalgebra::Vector2<f64>,
    /// Direction that the vehicle's leading end points to, in the map.
    pub heading: So2,
    /// Heading of the leading end relative to the path, in radians.
    pub heading_error: f64,
    /// Velocity in the frame of the leading end.
    pub twist: Twist2,
    /// Speed that is planned for this cycle, in metres per second, not negative: bends, the stop ahead and the limits allow it.
    pub speed: f64,
    /// The vehicle as it is, in its base frame.
    pub state: VehicleState,
    /// How the section is driven.
    pub gear: Gear,
    /// What the vehicle can do.
    pub limits: &'a MotionLimits,
    /// Time until the next cycle, in seconds.
    pub dt: f64,
}

/// How to move along a path: the part in which trackers differ.
pub trait Steering {
    /// Twist that is wanted for the next cycle, in the frame of the leading end.
    ///
    /// The follower slows it down along its curvature to the planned speed, and steps towards it within the limits.
    ///
    /// # Errors
    /// Whatever the law's parts refuse; the follower then commands nothing.
    fn twist(&mut self, input: &SteeringInput<'_>) -> Result<Twist2, TrackError>;

    /// Forgets the past: there is a new path, or a new section of it.
    fn reset(&mut self);
}
